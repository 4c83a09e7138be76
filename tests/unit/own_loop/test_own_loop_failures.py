"""What must not happen in a loop of one's own: steps of torque, faults that are lost, copies, lost changes."""

import copy
import math
import pickle

import numpy as np
import pytest

import friction_hil as fh
from friction_hil import recordings
from friction_hil.config import from_dict
from friction_hil.drive.codes import code_of
from friction_hil.replay.verify import verify
from tests.own_loops import LIMITS, PERIOD_S, STRIBECK, axis, configuration, loop, motion, steps


@pytest.mark.parametrize("what", ["dt", "clock"])
def test_whatever_fails_in_a_call_the_output_makes_no_step(what):
    """A jump to zero, and back in the next cycle, would be one of the torque that is left."""
    slow, times = axis(compensation={"fade_s": 0.4}), iter([*range(1, 202), None])
    one, inputs = fh.Compensator(configuration(slow), clock=lambda: next(times) * 10**6), motion(260, 1)
    before = steps(one, 200, **inputs)[-1]
    if what == "dt":
        one.step(inputs["q"][200], dt=10**400)
        assert one.fault is None
    else:
        after = [one.step(inputs["q"][200]).copy() for _ in range(10)]  # no clock any more
        assert code_of(one.fault) == "FH-111"
        assert np.abs(np.diff([before, *after], axis=0)).max() <= LIMITS["torque_slew"] * PERIOD_S
        assert np.abs(after[-1]) > 0.01
        assert not [one.step(inputs["q"][200]).copy() for _ in range(300)][-1].any()


def test_a_fault_stays_in_force_whatever_another_thread_does_in_the_same_moment():
    """`fade_in` clears the fault, the loop's thread finds the next one, `fade_in` switches on."""
    one, inputs = loop(), motion(300, 3)
    steps(one, 100, **inputs)
    one._fault, one._joints.loop["is_on"] = "the next one", 1.0
    assert not steps(one, 100, **{name: values[100:] for name, values in inputs.items()})[-1].any()


@pytest.mark.parametrize("how", [copy.copy, copy.deepcopy, pickle.dumps])
def test_a_compensator_is_not_copied(how):
    with pytest.raises(TypeError, match="load another one"):
        how(loop(axis()))


@pytest.mark.parametrize(
    ("name", "value", "word"),
    [
        ("fresh", [math.nan], ""),
        ("fresh", ["False"], "fresh must be"),
        ("load", [1j], "load must be"),
    ],
)
def test_what_is_not_known_is_not_taken_for_a_value(name, value, word):
    one = loop(axis())
    one.step([0.0])
    one.step(**{"q": [0.0], name: value})
    assert not one._joints.limits["is_usable"].any()
    assert (one.fault or "").startswith(word)


def test_changes_at_once_and_after_many_faults_are_verified(tmp_path):
    """Two of one cycle, and one before more events than are kept."""
    one, inputs = loop(axis(), axis(limits=LIMITS | {"position": [-1.0, 1.0]}), record_s=6.0), motion(200, 2)
    steps(one, 100, **inputs)
    one.set("j0", gain=0.3)
    one.set("j1", model={"axis": "rotary", "friction": STRIBECK})
    one.set("j1", gain=0.5)
    steps(one, 100, **{name: values[100:] for name, values in inputs.items()})
    for k in range(1100):
        one.step([0.0, min(1.0 + 0.01 * k, 1.5)], dt=PERIOD_S)
        one.fade_in()
    for recording in recordings.read_all(one.save(tmp_path / "run.mcap")).values():
        assert (verify(recording).reason, len(recording)) == ("", 1300)


def test_of_many_changes_those_are_kept_with_which_rows_in_memory_were_computed(tmp_path):
    config = from_dict({"version": 1, "period_s": 0.02, "axes": {"j0": axis(), "j1": axis()}}, "test")
    one, inputs = fh.Compensator(config, record_s=1.0), motion(400, 2)
    one.set("j1", model={"axis": "rotary", "friction": STRIBECK})
    for k in range(400):
        one.set("j0", gain=0.5 + 1e-3 * k)
        one.step(0.1 * inputs["q"][k], q_des=0.1 * inputs["q_des"][k], dt=0.02)
    assert 100 <= len(one._memory._changes) < 160
    for recording in recordings.read_all(one.save(tmp_path / "run.mcap")).values():
        assert verify(recording).reason == ""
