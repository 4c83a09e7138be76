"""Speed and torque until a motion has confirmed the velocity that a drive reports: whole runs in cst, and the parts."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from friction_hil.daemon.safety import LoopState
from friction_hil.daemon.velocity_trust import FirstTorque, VelocityTrust
from tests.loop_run import MODES
from tests.servo_drives import PERIOD_S
from tests.unit.canopen.test_canopen_first_motion import LIMITS, NO_UNIT, Run

CST = {**MODES["cst"], "limits": LIMITS | {"torque": 0.6}}
OF_DRIVE = {"fade_s": 0.1, "velocity": "drive"}
STICKING = {
    "friction": {"model": "coulomb", "parameters": {"coulomb": 0.3, "static": 0.45}},
    "motor": {"rated_torque": 0.64, "peak_torque": 2.0},
}


@pytest.mark.parametrize("assumed", [None, "rpm"])
def test_a_velocity_in_another_unit_moves_no_axis_faster_than_its_path(assumed):
    """Reported in rpm and taken for counts/s: too small to damp; the other way round: far too much."""
    unit = "rpm" if assumed is None else "counts/s"
    run = Run({"velocity_unit": unit}, NO_UNIT, velocity_unit=assumed, compensation=OF_DRIVE, **CST)
    assert run.fastest < 2.0  # it was 5.3; the path has 1.9 rad/s
    assert run.codes == ["FH-119"]


def test_a_velocity_that_no_fault_finds_wrong_is_told_and_not_used():
    limits = LIMITS | {"torque": 0.6, "velocity": 30.0}  # a tenth of it is tolerated
    run = Run({"velocity_unit": "rpm"}, NO_UNIT, compensation=OF_DRIVE, **(CST | {"limits": limits}))
    assert run.result.faults == []
    assert run.fastest < 2.3
    (warning,) = run.result.warnings
    assert "times the derivative of its position: it is not used" in warning


def test_the_drives_own_velocity_counts_once_a_motion_has_confirmed_it():
    run = Run({"velocity_unit": "rpm"}, NO_UNIT, velocity_unit="rpm", compensation=OF_DRIVE, **CST)
    assert run.result.faults == run.result.warnings == []
    seen = np.array(run.sink.column("x", "velocity"))
    steps = seen[-300:] / (2.0 * np.pi / 60.0)
    assert np.allclose(steps, np.round(steps), atol=1e-6)  # whole rpm, which a derivative of the position is not
    assert np.abs(steps).max() >= 10


def test_torque_rises_slowly_until_the_axis_moves_and_an_axis_that_sticks_comes_loose():
    run = Run(servo=STICKING, **CST)
    assert run.result.faults == []
    running = run.state == LoopState.RUNNING
    torque = np.abs(np.array(run.sink.column("x", "command"))[running])
    position = np.array(run.sink.column("x", "position"))[running]
    moves = np.flatnonzero(np.abs(position - position[0]) > 0.01)[0]
    assert np.all(torque[:moves] <= 0.6 * (np.arange(moves) + 1) * PERIOD_S / 0.1 + 1e-3)
    assert torque[:moves].max() > 0.44
    assert run.moved() > 0.25


@given(st.floats(-20.0, 20.0), st.sampled_from([0.0, 1e-3, 0.1, 0.5, 2.0, 9.55, 6900.0, -1.0]))
def test_only_a_velocity_that_is_that_of_the_position_is_confirmed(speed, ratio):
    trust = VelocityTrust(PERIOD_S, 1e-5, 1e-3)
    for k in range(300):
        position = 1e-5 * round(speed * k * PERIOD_S / 1e-5)
        trust.take(position, ratio * speed, 1)
        if not trust.is_confirmed:
            assert abs(trust.velocity - speed) <= (abs(speed) if k == 0 else 0.0) + 2e-5 / PERIOD_S
    assert not trust.is_confirmed
    again = VelocityTrust(PERIOD_S, 1e-5, 1e-3)
    for k in range(300):
        again.take(1e-5 * round(speed * k * PERIOD_S / 1e-5), speed, 1)
    if abs(speed) > 0.1 or abs(speed) < 1e-4:
        assert again.is_confirmed == (abs(speed) > 0.1)


@given(st.lists(st.tuples(st.booleans(), st.integers(1, 20)), min_size=1, max_size=60))
def test_the_bound_rises_only_while_the_axis_does_not_follow(cycles):
    first, position = FirstTorque(0.6, 10.0, PERIOD_S, 1e-5), 0.0
    first.next(position, 0.1, 1)
    before = first.next(position, 0.1, 1)
    for is_moving, periods in cycles:
        position += 0.02 if is_moving else 0.0
        bound = first.next(position, 0.1, periods)
        assert before <= bound <= min(before + 0.6 * PERIOD_S / 0.1 + 1e-12, 0.6)
        if is_moving:
            assert bound == before
        before = bound
    for _ in range(300):
        bound = first.next(position, 0.1, 1)
    assert bound == 0.6


def test_a_load_that_falls_gets_all_of_the_torque_at_once():
    first = FirstTorque(0.6, 10.0, PERIOD_S, 1e-5)
    assert first.next(0.0, 0.1, 1) < 0.01
    assert first.next(-2e-3, 0.1, 1) == 0.6
