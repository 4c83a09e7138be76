"""What learning has on trial is taken back whoever dies or intervenes: real processes, and a recording that replays."""

import contextlib
import os
import signal
import subprocess
import sys

import numpy as np
import pytest
import yaml

import friction_hil as fh
from friction_hil.cli import main
from friction_hil.daemon.control.ask import ask
from friction_hil.daemon.control.names import find
from friction_hil.errors import FrictionHilError
from friction_hil.replay.verify import verify
from tests.integration.test_runtime_control import STRIBECK, answered, children, until
from tests.launcher import start
from tests.servo_drives import axis_dict

pytestmark = pytest.mark.deep

BUS = {"interface": "socketcan", "channel": "can0"}
PATH = {"kind": "sine", "amplitude": 0.3, "frequency": 2.0, "ramp_s": 0.1}
OTHER = {**STRIBECK, "fit": None}


@contextlib.contextmanager
def judge():
    """A process in the place of the one that learns."""
    with subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE) as process:
        try:
            yield process
        finally:
            process.kill()


def settings():
    """Gain and model of both axes, and the number of the last change."""
    found = ask(find("mill"), {"do": "status"})["axes"]
    return [(axis["gain"], axis["model"]) for axis in found.values()]


class Learner:
    """Requests as the process that learns makes them."""

    def __init__(self, process, upon=0):
        self.process, self.upon = process.pid, upon

    def words(self, axes):
        return {"process": self.process, "upon": self.upon, "axes": axes}

    def set(self, values, axes):
        request = {"do": "set", "values": values, "reason": "learning tries", "learning": self.words(axes)}
        self.upon = ask(find("mill"), request)["change"]

    def keep(self, axes=()):
        ask(find("mill"), {"do": "tell", "text": "learning keeps", "learning": self.words([*axes])})


@pytest.fixture(scope="module")
def done(tmp_path_factory):
    """What was in force after each intervention, by its name, and the recording."""
    folder = tmp_path_factory.mktemp("t")
    axes = {name: axis_dict(node=node, trajectory=PATH) for node, name in enumerate("xy", 1)}
    config, record, found = folder / "mill.yaml", folder / "run.mcap", {}
    values = {"version": 1, "period_s": 2e-3, "bus": BUS, "realtime": {"priority": 0}, "axes": axes}
    config.write_text(yaml.safe_dump(values))
    words = ("run", "--simulate", config, "--pace", "sync", "--record", record)
    with start(*words, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as daemon:
        try:
            until(lambda: (answered("mill", {"do": "status"}) or {}).get("state") == "running")
            found["at first"] = before = settings()
            with judge() as process:
                learner = Learner(process)
                learner.set({"x.gain": 0.6, "x.model": OTHER}, ["x"])
                learner.set({"x.gain": 0.7}, ["x"])  # all of a change after a third of it
                found["trial"] = settings()
            found["death"] = until(lambda: (now := settings()) == before and now)
            with judge() as process:
                learner = Learner(process)
                with pytest.raises(FrictionHilError, match="were changed meanwhile"):
                    learner.set({"x.gain": 0.6}, ["x"])
                learner.upon = 3
                learner.set({"x.gain": 0.6, "x.model": OTHER}, ["x"])
                found["set"] = main(["set", "mill", "y.gain=0.5"]), settings()
                learner.upon += 1
                learner.set({"x.gain": 0.6, "x.model": OTHER, "y.gain": 0.4}, ["x", "y"])
                learner.keep(["x"])  # y is proven, x is not yet
                [control] = children(daemon.pid, "friction_hil.daemon.control")
                os.kill(control, signal.SIGKILL)
                until(lambda: children(daemon.pid, "friction_hil.daemon.control") not in ([], [control]))
                found["death of the control socket"] = until(
                    lambda: answered("mill", {"do": "status"}) and (now := settings())[0] == before[0] and now
                )
                learner.upon += 2  # what it kept was told under a number, too
                learner.set({"x.gain": 0.55}, ["x"])
                found["own key"] = main(["set", "mill", "x.gain=0.65"]), settings()
                learner.upon += 1
                learner.set({"x.model": OTHER}, ["x"])
                learner.keep()
            with pytest.raises(FrictionHilError, match="which would judge the trial"):
                learner.set({"x.gain": 0.2}, ["x"])
            found["kept"] = settings()
            daemon.send_signal(signal.SIGINT)
            assert daemon.wait(60) == 0
        finally:
            daemon.kill()
    return found, {name: fh.recordings.read(record, name) for name in "xy"}


def test_what_is_on_trial_is_taken_back_when_its_judge_dies(done):
    found, _ = done
    assert found["trial"] == [(0.7, "stribeck"), found["at first"][1]]
    assert found["death"] == found["at first"]


def test_a_change_of_any_axis_takes_back_what_is_on_trial(done):
    found, _ = done
    assert found["set"] == (0, [found["at first"][0], (0.5, found["at first"][1][1])])
    assert found["own key"] == (0, [(0.65, found["at first"][0][1]), (0.4, found["at first"][1][1])])


def test_the_death_of_the_control_socket_takes_back_what_is_on_trial_and_not_what_is_proven(done):
    found, _ = done
    assert found["death of the control socket"] == [found["at first"][0], (0.4, found["at first"][1][1])]


def test_what_was_kept_stays(done):
    found, _ = done
    assert found["kept"] == [(0.65, "stribeck"), (0.4, found["at first"][1][1])]


def test_every_bit_of_it_is_reproduced(done):
    _, recordings = done
    for recording in recordings.values():
        assert np.unique(recording["change"]).size == 11
        result = verify(recording)
        assert (result.is_verified, result.reason, result.tolerance) == (True, "", 0.0)
    told = [event.text for event in recordings["x"].events if event.name == "notice"]
    assert sum("what was on trial of x is taken back" in text for text in told) == 4
