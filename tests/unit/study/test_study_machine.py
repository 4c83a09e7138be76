"""What compensation does on a machine: the study, and the benchmark, at the motor and at the load."""

import json
import math

import numpy as np
import pytest
import yaml

from friction_hil.cli import main
from friction_hil.config import load
from friction_hil.rehearsal import Rehearsal, simulated_machines
from friction_hil.study.machine import Course, MotionResult, scored, study_machine
from friction_hil.tuning.rehearsal_motions import simulated_motions
from tools.benchmarks import compensation
from tools.benchmarks.compensation import OTHERS, run_machines
from tools.benchmarks.compensation import load as load_grid

LEVEL, STIFFNESS, HZ = 0.05, 40.0, 2.0
BRISTLES = {"sigma0": 2000.0, "sigma1": 1.0, "sigma2": 2e-3, "stribeck_velocity": 0.2, "damping_velocity": 0.2}


def lugre(coulomb):
    """LuGre friction with this level, and a static one of 0.02 more."""
    return {"model": "lugre", "parameters": BRISTLES | {"coulomb": coulomb, "static": round(coulomb + 0.02, 12)}}


LOAD = {"inertia": 1e-4, "stiffness": STIFFNESS, "damping": 5e-3}
LOAD_FRICTION = {"model": "coulomb", "parameters": {"coulomb": LEVEL}}
AXIS = {
    **{"driver": "canopen", "node": 1, "mode": "csp", "limits": {"torque": 0.4, "velocity": 30.0}},
    "model": {"axis": "rotary", "friction": lugre(0.12), "mechanics": {"inertia": 2e-4, "torque_lag_s": 3e-4}},
    "compensation": {"fade_s": 0.2},
    "trajectory": {"kind": "sine", "amplitude": 0.3, "frequency": HZ},
    "simulation": {
        "mechanics": {"inertia": 1e-4, "load": LOAD | {"friction": LOAD_FRICTION}},
        "friction": lugre(0.08),
        "loops": {"position_gain": 80.0, "velocity_gain": 0.1},
    },
}
BUS = {"interface": "udp_multicast", "channel": "239.74.163.2", "port": 43999, "hop_limit": 0}
MACHINE = {"version": 1, "period_s": 1e-3, "bus": BUS, "axes": {"x": AXIS}}


@pytest.fixture(scope="module")
def machine(tmp_path_factory):
    path = tmp_path_factory.mktemp("machine") / "small.yaml"
    path.write_text(yaml.safe_dump(MACHINE))
    return path


@pytest.fixture(scope="module")
def studied(machine, tmp_path_factory):
    """Folder and JSON of the command."""
    folder = tmp_path_factory.mktemp("study")
    with pytest.MonkeyPatch.context() as patch:
        said = []
        patch.setattr("friction_hil.cli.work.study_machine.print_json", said.append)
        assert main(["study", str(machine), "--output", str(folder), "--json"]) == 0
    return folder, said[0]


@pytest.fixture(scope="module")
def benched(machine, tmp_path_factory):
    """Results of two motions: with the true friction, the model of the file, and one that was found before."""
    folder = tmp_path_factory.mktemp("identified")
    (folder / "small").mkdir()
    content = AXIS["model"] | {"version": 1, "friction": lugre(0.13)}
    (folder / "small/x.yaml").write_text(yaml.safe_dump(content))
    grid = load_grid(OTHERS)
    conditions = {name: grid.conditions[name] for name in ("exact", "two_cycles", "encoder_14")}
    grid = grid.model_copy(update={"conditions": conditions})
    with pytest.MonkeyPatch.context() as patch:
        some = {"own", "triangle"}
        motions = "tools.benchmarks.compensation.machines.simulated_motions"
        patch.setattr(motions, lambda one: {k: v for k, v in simulated_motions(one).items() if k in some})
        return run_machines([machine], grid, folder)


def only_axis(machine):
    """The axis of a file, and its triangle."""
    [simulated] = simulated_machines(load(machine))
    [axis] = simulated.axes
    [motion] = simulated_motions(simulated)["triangle"]
    return axis, motion


def course(motor, load, gain_factor=1.0):
    motor, load = np.asarray(motor, float), np.asarray(load, float)
    return Course(1e-3 * np.arange(motor.size), np.zeros(motor.size), motor, load, gain_factor)


def test_figures_leave_out_the_constant_part_of_an_error_and_what_diverges_reduces_nothing():
    errors = course([1.0, 3.0, 1.0, 3.0], [-5.0, -5.0, -4.0, -4.0]).errors
    assert (errors("motor"), errors("load")) == ((1.0, 1.0), (0.5, 0.5))
    result = MotionResult(course([1.0, -1.0], [1.0, -1.0]), course([np.inf, 0.0], [np.nan, 0.0]))
    assert result.compensated.errors("load") == (math.inf, math.inf)
    assert result.reduction("load").rms == 0.0
    trace = {name: np.arange(10.0) for name in ("error", "gain_factor", "demand", "load_error")}
    found = scored(trace, 0.5, 2.0)  # the end of a rehearsal
    assert (found.motor.tolist(), found.time_s.tolist()) == ([6.0, 7.0, 8.0, 9.0], [0.0, 0.5, 1.0, 1.5])


def test_a_study_makes_each_motion_without_and_with_compensation():
    calls = []

    def run(is_compensated):
        calls.append(is_compensated)
        return course([1.0, -1.0], [2.0, -2.0]) if not is_compensated else course([0.1, -0.1], [1.0, -1.0])

    study = study_machine({"x": "rad"}, {"x": {"own": run}})
    assert calls == [False, True]
    assert study.facts["x"]["own"]["motor"]["reduction"] == {"rms": pytest.approx(10.0), "peak": pytest.approx(10.0)}
    assert study.facts["x"]["own"]["load"]["reduction"]["rms"] == pytest.approx(2.0)


def test_the_load_stays_behind_its_encoder_by_friction_over_stiffness(machine):
    axis, motion = only_axis(machine)
    trace = Rehearsal(axis.config, axis.facts, axis.period_s).trace(axis.servo, axis.config.model, motion)
    assert scored(trace, axis.period_s, motion.duration_s).unseen == pytest.approx(LEVEL / STIFFNESS, rel=0.1)


def test_a_rehearsal_shifts_the_motor_as_the_daemon_does(machine):
    axis, motion = only_axis(machine)
    behind = {"inertia": 1e-4, "stiffness": STIFFNESS, "friction": LEVEL}
    content = axis.config.model.model_dump() | {"friction": lugre(0.08 + LEVEL)}  # of motor and load
    content["mechanics"]["load"] = behind
    model = type(axis.config.model).model_validate(content)

    def load_error(transmission):
        compensation = axis.config.compensation.model_copy(update={"transmission": transmission})
        config = axis.config.model_copy(update={"compensation": compensation, "model": model})
        trace = Rehearsal(config, axis.facts, axis.period_s).trace(axis.servo, model, motion)
        return scored(trace, axis.period_s, motion.duration_s).errors("load").rms

    offset = type(axis.config).model_fields["compensation"].annotation.model_fields["transmission"]
    given = next(each for each in offset.annotation.__args__ if each is not type(None))(acceleration=200.0)
    assert load_error(given) < 0.3 * load_error(None)


def test_the_study_compares_motor_and_load(studied):
    _, facts = studied
    assert list(facts) == ["x"]
    assert set(facts["x"]) >= {"own", "slow"}
    for motion in facts["x"].values():
        for side in ("motor", "load"):
            without, compensated = motion[side]["without"], motion[side]["compensated"]
            assert motion[side]["reduction"]["rms"] == pytest.approx(without["rms"] / compensated["rms"])
            assert without["peak"] >= without["rms"] > compensated["rms"] > 0.0
        assert motion["load"]["compensated"]["rms"] > motion["motor"]["compensated"]["rms"]


def test_the_report_has_a_picture_of_each_motion_and_a_former_one_is_replaced(studied, machine, capsys):
    folder, facts = studied
    text = (folder / "report.html").read_text()
    assert text.count("<img ") == len(facts["x"])
    assert "What compensation does on small.yaml" in text
    assert "deviates from the encoder" in text
    assert main(["study", str(machine), "--output", str(folder)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert sum(line.startswith("x ") for line in lines) == 2 * len(facts["x"]), "motor and load"
    assert lines[-1] == f"report: {folder / 'report.html'}"


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda axis: axis.pop("simulation"), "no axis has a section 'simulation'"),
        (lambda axis: axis.update(trajectory={"kind": "hold"}), "there is no motion to simulate"),
    ],
)
def test_a_machine_that_cannot_be_studied_is_refused(change, said, tmp_path, capsys):
    content = yaml.safe_load(yaml.safe_dump(MACHINE))
    change(content["axes"]["x"])
    path = tmp_path / "machine.yaml"
    path.write_text(yaml.safe_dump(content))
    assert main(["study", str(path), "--output", str(tmp_path / "out")]) == 2
    assert said in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_the_true_friction_reduces_more_than_a_level_that_is_half_too_high(benched):
    by_condition = {}
    for each in benched:
        by_condition.setdefault(each.case.condition, {})[each.case.drive, each.case.motion] = each
    assert list(by_condition) == ["file", "identified", "exact", "two_cycles"]
    assert list(by_condition["exact"]) == [("own", "own"), ("own", "triangle"), ("soft", "own"), ("soft", "triangle")]
    for case, exact in by_condition["exact"].items():
        assert exact.reduction["motor"].rms > 1.0
        assert exact.reduction["motor"].rms > by_condition["file"][case].reduction["motor"].rms
    own = {name: each["own", "own"].reduction["motor"].rms for name, each in by_condition.items()}
    assert own["identified"] != own["file"]
    assert own["two_cycles"] > 0.5 * own["exact"]  # commands act later, and are sent as much earlier


def test_the_command_takes_machines_and_simulates_only_them(benched, machine, tmp_path, capsys, monkeypatch):
    asked = []
    monkeypatch.setattr(compensation, "run_machines", lambda *given: asked.append(given) or benched)
    compensation.command.main([str(machine), "--identified", str(tmp_path), "--json"], standalone_mode=False)
    found = json.loads(capsys.readouterr().out)
    assert set(found) == {"machine", "machines"}
    [(files, _, identified)] = asked
    assert (files, identified) == ([machine], tmp_path)
