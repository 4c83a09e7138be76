"""`compensation.learning` through real processes: handed over by the journal, recorded, reproduced bit for bit."""

import json
import re

import numpy as np
import pytest
import yaml

import friction_hil as fh
from friction_hil.daemon.learning_board import first_report
from friction_hil.replay.verify import verify
from tests.processes import run
from tests.servo_drives import TRUE_FRICTION, axis_dict

CAN0 = {"interface": "socketcan", "channel": "can0"}
SINE = {"kind": "sine", "amplitude": 0.3, "frequency": 1.0, "ramp_s": 0.1}


def write(folder):
    """A configuration of two simulated axes whose models are 30 % off: one learns, the other only proposes."""
    axes = {}
    for node, (name, learning) in enumerate((("x", "on"), ("y", "propose")), 1):
        axis = axis_dict(node=node, trajectory=SINE, compensation={"fade_s": 0.1, "learning": learning})
        true = {"model": "lugre", "parameters": dict(TRUE_FRICTION)}
        axis["simulation"] = {"mechanics": {"inertia": 2e-4}, "friction": true}
        axis["model"]["friction"]["parameters"]["coulomb"] *= 0.7
        axes[name] = axis
    values = {"version": 1, "period_s": 2e-3, "bus": CAN0, "realtime": {"priority": 0}, "axes": axes}
    path = folder / "machine.yaml"
    path.write_text(yaml.safe_dump(values))
    return path


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    """What a run has printed, and its recordings."""
    folder = tmp_path_factory.mktemp("learning")
    record = folder / "run.mcap"
    words = ("run", "--simulate", write(folder), "--pace", "sync", "--duration", "8.25", "--json", "--record", record)
    printed = run(*words)
    return json.loads(printed.stdout)["learning"]["axes"], {name: fh.recordings.read(record, name) for name in "xy"}


@pytest.mark.deep
def test_parameters_are_handed_over_and_every_bit_is_reproduced(done):
    found, recording = done[0]["x"], done[1]["x"]
    assert found["mode"] == "on"
    assert found.keys() == first_report("on", "rad", 0.9).keys()
    assert abs(found["parameters"]["coulomb"] / TRUE_FRICTION["coulomb"] - 1.0) < 0.05  # it was 0.3
    assert found["in_use"]["coulomb"] == pytest.approx(found["parameters"]["coulomb"], rel=0.02)
    assert np.unique(recording["change"]).size == 3  # the model file, a third of the change, and all of it
    told = [event.text for event in recording.events if event.name == "change"]
    assert re.search(r"x: learning tries coulomb \+4\d %.*: torque changes by \d", told[0])
    result = verify(recording)
    assert (result.is_verified, result.reason, result.tolerance) == (True, "", 0.0)


@pytest.mark.deep
def test_the_uncertainty_of_what_was_handed_over_is_recorded(done):
    found, recording = done[0]["x"], done[1]["x"]
    uncertainty, change = recording["compensation_uncertainty"], recording["change"]
    assert np.isnan(uncertainty[change == 0.0]).all()  # the file has no standard errors
    expected = found["relative_errors"]["coulomb"] * found["parameters"]["coulomb"]
    assert 0.2 * expected < np.median(uncertainty[change == 1.0]) < 5.0 * expected


@pytest.mark.deep
def test_an_axis_that_only_proposes_says_so_and_stays_as_it_is(done):
    found, recording = done[0]["y"], done[1]["y"]
    notice = next(event.text for event in recording.events if event.name == "notice" and event.text.startswith("y:"))
    assert re.fullmatch(r"y: learning would try coulomb \+4\d %.*: torque changes by .*gain 0\.90 -> \d.*", notice)
    assert found["proposed"]["parameters"]["coulomb"] == pytest.approx(TRUE_FRICTION["coulomb"], rel=0.05)
    assert (found["last"], found["gain"], found["re_identified"]) == (notice.removeprefix("y: "), 0.9, 0)
    assert found["in_use"]["coulomb"] == pytest.approx(0.7 * TRUE_FRICTION["coulomb"])
    assert "compensation_uncertainty" not in recording
