"""What a configuration tells about adaptation before a run, compared with what runs say at their end."""

import json

import pytest
import yaml

from friction_hil.cli import main
from friction_hil.daemon.adaptation_check import adaptation_problem
from friction_hil.daemon.notices import adaptation_notice
from friction_hil.servo.config import Encoder, ServoConfig
from tests.servo_drives import PERIOD_S, ServoDrives, axis_dict, configuration, make_loop

ADAPTING = {"fade_s": 0.1, "adaptation": {"time_s": 5.0}}
SINE = {"kind": "sine", "ramp_s": 0.25}
TRIANGLE = {"kind": "triangle"}
MOTIONS = {
    "fast": {**SINE, "amplitude": 0.5, "frequency": 0.5},
    "slow": {**SINE, "amplitude": 0.05, "frequency": 0.5},
    "short": {**SINE, "amplitude": 0.02, "frequency": 20.0},
    "steady": {**TRIANGLE, "amplitude": 0.5, "frequency": 0.5},
    "creeping": {**TRIANGLE, "amplitude": 0.1, "frequency": 0.5},
    "hold": {"kind": "hold"},
    "strokes": {"kind": "strokes", "stroke": 0.5, "frequency": 0.5, "rest": 0.2},
}


def adapting(trajectory, bits, **changes):
    changes = {"compensation": ADAPTING, "simulation": {"encoder": {"counts": 2**bits}}, **changes}
    return configuration(x=axis_dict(trajectory=trajectory, **changes))


@pytest.mark.deep
@pytest.mark.parametrize("bits", [14, 20])
@pytest.mark.parametrize("name", MOTIONS)
def test_it_is_said_before_a_run_what_the_run_says_at_its_end(name, bits) -> None:
    config = adapting(MOTIONS[name], bits)
    drives = ServoDrives(config, servo=ServoConfig(encoder=Encoder(counts=2**bits)))
    loop, _, [axis] = make_loop(config, drives, duration_s=2.5)
    loop.run()

    notice = adaptation_notice("x", "rad", axis.compensator)
    problem = adaptation_problem("x", config.axes["x"], PERIOD_S)

    assert (problem is None) == (notice is None)
    if problem is not None:
        assert problem.partition(": ")[2] == notice.partition("nothing: ")[2], "the same words"


@pytest.mark.parametrize(
    ("trajectory", "bits", "changes"),
    [
        (MOTIONS["slow"], 14, {"compensation": {"fade_s": 0.1}}),
        (MOTIONS["slow"], 14, {"simulation": None}),
        (MOTIONS["slow"], 14, {"compensation": {**ADAPTING, "enabled": False}}),
        (MOTIONS["slow"], 14, {"counts_per_unit": 1e6}),  # they come before those of a simulation
        ({"kind": "none"}, 14, {"mode": "cst", "limits": {"torque": 0.3, "velocity": 30.0}}),
        ({"kind": "experiment", "velocity": 1e-3, "travel": 1e-3, "duration_s": 10.0}, 10, {}),
    ],
)
def test_nothing_is_said_where_it_is_not_known(trajectory, bits, changes) -> None:
    assert adaptation_problem("x", adapting(trajectory, bits, **changes).axes["x"], PERIOD_S) is None
    assert adaptation_problem("x", adapting(MOTIONS["slow"], 14).axes["x"], PERIOD_S) is not None


def test_config_check_has_a_note_with_the_line_and_succeeds(tmp_path, capsys) -> None:
    simulation = {"encoder": {"counts": 16384}}
    axis = axis_dict(compensation=ADAPTING, trajectory=MOTIONS["slow"], simulation=simulation)
    bus = {"interface": "virtual", "channel": "adaptation-check"}
    file = tmp_path / "machine.yaml"
    file.write_text(yaml.safe_dump({"version": 1, "period_s": 1e-3, "bus": bus, "axes": {"x": axis}}, sort_keys=False))
    [line] = [k for k, text in enumerate(file.read_text().splitlines(), 1) if "adaptation:" in text]

    assert main(["config", "check", str(file)]) == 0
    text = " ".join(capsys.readouterr().out.split())
    assert f"note: {file}:{line}: axes.x.compensation.adaptation: " in text
    assert main(["config", "check", "--json", str(file)]) == 0
    [found] = json.loads(capsys.readouterr().out)["files"]
    assert [(each["line"], each["field"]) for each in found["notes"]] == [(line, "axes.x.compensation.adaptation")]
