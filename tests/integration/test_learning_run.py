"""`compensation.learning` through real processes: handed over by the mailbox, recorded, reproduced bit for bit."""

import json

import numpy as np
import yaml

import friction_hil as fh
from friction_hil.replay.verify import verify
from tests.processes import run
from tests.servo_drives import TRUE_FRICTION, axis_dict

CAN0 = {"interface": "socketcan", "channel": "can0"}
SINE = {"kind": "sine", "amplitude": 0.3, "frequency": 1.0, "ramp_s": 0.1}


def write(folder, learning):
    """A configuration of one simulated axis whose model is 30 % off."""
    axis = axis_dict(trajectory=SINE, compensation={"fade_s": 0.1, "learning": learning})
    true = {"model": "lugre", "parameters": dict(TRUE_FRICTION)}
    axis["simulation"] = {"mechanics": {"inertia": 2e-4}, "friction": true}
    axis["model"]["friction"]["parameters"]["coulomb"] *= 0.7
    values = {"version": 1, "period_s": 2e-3, "bus": CAN0, "realtime": {"priority": 0}, "axes": {"x": axis}}
    path = folder / "machine.yaml"
    path.write_text(yaml.safe_dump(values))
    return path


def test_parameters_are_handed_over_and_every_bit_is_reproduced(tmp_path):
    record = tmp_path / "run.mcap"
    words = ("run", "--simulate", write(tmp_path, "on"), "--pace", "sync", "--duration", "8", "--json")
    done = run(*words, "--record", record)
    found = json.loads(done.stdout)["learning"]["axes"]["x"]
    assert found["mode"] == "on"
    assert abs(found["parameters"]["coulomb"] / TRUE_FRICTION["coulomb"] - 1.0) < 0.05  # it was 0.3
    recording = fh.recordings.read(record, "x")
    assert set(np.unique(recording["change"])) == {0.0, 1.0, 2.0}
    told = [event.text for event in recording.events if event.name == "change"]
    assert "x: learning: parameters refined" in told[0]
    result = verify(recording)
    assert (result.is_verified, result.reason, result.tolerance) == (True, "", 0.0)
