"""Limits and plausibility: what counts as a fault, what may be reset, and what contradicts a reported velocity."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from friction_hil.daemon.safety import MAX_STALE_CYCLES, LoopState, SafetyLimits, Standstill, Supervisor
from friction_hil.daemon.velocity_check import VelocityCheck
from friction_hil.drive import DriveState, Feedback
from tests.examples import THOROUGH
from tests.messages import codes_in

thorough = settings(max_examples=THOROUGH)

PERIOD_S = 1e-3
ENABLED = DriveState.OPERATION_ENABLED
LIMITS = SafetyLimits(torque=0.3, velocity=10.0, following_error=0.1, position_low=-1.0, position_high=1.0)
MOVING = (LoopState.RUNNING, LoopState.STOPPING)
LIMITED = (*MOVING, LoopState.FIRST_MOTION)

any_float = st.floats(allow_nan=True, allow_infinity=True)


def supervisor(limits=LIMITS, position=0.0, **changes):
    one = Supervisor("x", limits, PERIOD_S, 1e-5, **changes)
    if position is not None:
        assert one.take(heard(position))
    return one


def heard(position=0.0, velocity=0.0, torque=0.0, state=ENABLED, is_fresh=True, error="", message="", missing=""):
    return Feedback(position, velocity, torque, state, is_fresh, error, message, missing)


@thorough
@given(any_float, any_float, any_float, st.booleans())
def test_only_fresh_finite_feedback_is_used_and_remembered(position, velocity, torque, is_fresh):
    one = supervisor(position=None)
    assert math.isnan(one.position)
    is_good = is_fresh and all(map(math.isfinite, (position, velocity, torque)))
    assert one.take(heard(position, velocity, torque, is_fresh=is_fresh)) is is_good
    assert one.is_current is is_good
    assert one.position == position if is_good else math.isnan(one.position)


@pytest.mark.parametrize("number", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("name", ["position", "velocity", "torque"])
def test_a_number_that_is_not_finite_is_not_used_and_told_as_such_and_not_as_a_jump(name, number):
    one, broken = supervisor(), heard(**{name: number})
    for _ in range(MAX_STALE_CYCLES + 1):
        assert not one.take(broken)
        assert (one.position, one.is_current) == (0.0, False)
    fault = one.find_fault(broken, LoopState.RUNNING, 0.0, 0.0)
    assert codes_in(fault) == "x FH-103"
    assert f"its {name} is {number}" in fault


@thorough
@given(st.floats(-1e3, 1e3), st.integers(0, 20))
def test_a_position_may_jump_as_far_as_twice_the_velocity_limit_reaches_since_the_last_one(jump, missed):
    one = supervisor()
    for _ in range(missed):
        assert not one.take(heard(is_fresh=False))
    reach = 2.0 * 10.0 * PERIOD_S * (missed + 1) + 10.0 * 1e-5
    assert one.take(heard(jump)) is (abs(jump) <= reach)
    assert one.position == (jump if abs(jump) <= reach else 0.0)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_position_may_jump_to_the_end_of_its_reach_and_not_a_step_further(sign):
    """In numbers that floats hold exactly."""
    step, reach = 2.0**-20, 2.0 * 8.0 * 2.0**-10 + 10.0 * 2.0**-20
    for jump, is_usable in ((reach, True), (reach + step, False)):
        one = Supervisor("x", SafetyLimits(torque=0.3, velocity=8.0), 2.0**-10, step)
        one.take(heard())
        assert one.take(heard(sign * jump)) is is_usable


@pytest.mark.parametrize(
    ("position", "state"), [*((0.0, state) for state in LoopState), (None, LoopState.IDLE), (None, LoopState.ENABLING)]
)
@pytest.mark.parametrize("limit", [MAX_STALE_CYCLES, 3])
def test_feedback_may_be_missing_for_some_cycles_and_no_longer_in_any_state(position, limit, state):
    one, missing = supervisor(position=position, max_stale_cycles=limit), heard(is_fresh=False)
    assert one.has_position is (position is not None)
    seen = []
    for _ in range(limit + 1):
        one.take(missing)
        seen.append((one.is_silent, one.find_fault(missing, state, 0.0, 0.0)))
    *bridged, (is_silent, fault) = seen
    assert bridged == [(False, None)] * limit
    assert (is_silent, codes_in(fault)) == (True, "x FH-103")
    assert f"more than {limit} cycles" in fault
    one.take(heard())
    assert (one.has_position, one.is_silent) == (True, False)


@pytest.mark.parametrize("state", [LoopState.ENABLING, LoopState.FIRST_MOTION, LoopState.RUNNING, LoopState.STOPPING])
@pytest.mark.parametrize(("missing", "before"), [("", MAX_STALE_CYCLES - 1), ("TPDO 1 did not arrive in time", 0)])
def test_a_drive_out_of_reach_is_a_fault_that_does_not_tell_a_state_of_the_drive(missing, before, state):
    """Cycles that were missed or long: the time is over before the number of cycles is; and one gap is one fault."""
    one, lost, reason = supervisor(), heard(is_fresh=False, missing=missing), missing and f": {missing}"
    lost.is_reachable, lost.state = False, DriveState.UNKNOWN
    for cycle in range(before + 2 * MAX_STALE_CYCLES):
        one.take(lost)
        if cycle >= before:
            fault = one.find_fault(lost, state, 0.0, 0.0)
            assert fault == f"x: commands do not reach the drive any more{reason} [FH-103]"


def test_feedback_that_stays_away_is_one_fault_however_its_reasons_change():
    """On a line full of noise each cycle has other bytes to tell of."""
    one, said = supervisor(), []
    for reasons in ("abc", "de"):
        for _ in range(MAX_STALE_CYCLES):
            one.take(heard(is_fresh=False))
        for reason in reasons:
            one.take(heard(is_fresh=False))
            said.append(one.find_fault(heard(is_fresh=False, missing=reason), LoopState.RUNNING, 0.0, 0.0))
        one.take(heard())
        assert one.find_fault(heard(), LoopState.RUNNING, 0.0, 0.0) is None
    text = f"x: no usable feedback for more than {MAX_STALE_CYCLES} cycles"
    assert said == [f"{text}: a [FH-103]"] * 3 + [f"{text}: d [FH-103]"] * 2


@pytest.mark.parametrize("is_told", [False, True])
def test_missed_periods_are_no_contradiction_of_velocity_and_position(is_told):
    """Of four periods three had no cycle. Without that the position changes four times as fast as is reported."""
    one, faults = supervisor(position=-0.9), set()
    for cycle in range(56):
        feedback = heard(8.0 * 4 * PERIOD_S * cycle - 0.9, velocity=8.0)
        one.take(feedback, 3 if is_told else 0)
        faults.add(one.find_fault(feedback, LoopState.RUNNING, 8.0, math.nan))
    assert ([text for text in faults if text] == []) is is_told


def test_a_position_that_jumps_once_is_passed_over_and_one_that_goes_on_is_told():
    """As with the words of a counter in the wrong order."""
    one = supervisor()
    assert not one.take(heard(5.0))
    assert not one.is_current
    assert one.find_fault(heard(5.0), LoopState.RUNNING, 0.0, 0.0) is None
    assert one.take(heard(0.001))
    assert one.is_current
    for k in range(MAX_STALE_CYCLES + 1):
        jumping = heard(65536.0 * (-1) ** k)
        assert not one.take(jumping)
    fault = one.find_fault(jumping, LoopState.RUNNING, 0.0, 0.0)
    assert codes_in(fault) == "x FH-104"
    assert "6.554e+04 rad" in fault


def test_cycles_with_feedback_between_start_the_count_anew():
    one = supervisor()
    for _ in range(10):
        for _ in range(MAX_STALE_CYCLES):
            one.take(heard(math.nan))
        assert one.find_fault(heard(), LoopState.RUNNING, 0.0, 0.0) is None
        one.take(heard())


@pytest.mark.parametrize("state", LoopState)
def test_what_the_driver_says_and_a_drives_fault_count_in_every_state(state):
    one = supervisor()
    assert codes_in(one.find_fault(heard(message="no heartbeat"), state, 0.0, 0.0)) == "x FH-118"
    for reaction in (DriveState.FAULT, DriveState.FAULT_REACTION_ACTIVE):
        text = one.find_fault(heard(state=reaction, error="8611h following error"), state, 0.0, 0.0)
        assert codes_in(text) == "x FH-105"
        assert "8611h following error" in text
        assert ("--reset-fault" in text) is (state in (LoopState.IDLE, LoopState.ENABLING))
    assert "no error code" in one.find_fault(heard(state=DriveState.FAULT), state, 0.0, 0.0)


@pytest.mark.parametrize("state", MOVING)
@pytest.mark.parametrize("drive", [state for state in DriveState if state is not ENABLED])
def test_a_drive_that_leaves_operation_enabled_in_motion_is_a_fault(state, drive):
    assert supervisor().find_fault(heard(state=drive), state, 0.0, 0.0) is not None
    assert supervisor().find_fault(heard(), state, 0.0, 0.0) is None


@pytest.mark.parametrize("state", MOVING)
@pytest.mark.parametrize(
    ("position", "velocity", "demand", "code", "words"),
    [
        (0.0, 10.0, 0.0, None, None),
        (0.0, 10.001, 0.0, "x FH-107", "10 rad/s"),
        (0.0, -11.0, 0.0, "x FH-107", "velocity -11 "),
        (0.0, math.nan, 0.0, "x FH-107", "velocity nan "),
        (0.0, math.inf, 0.0, "x FH-107", "velocity inf "),
        (1.0, 0.0, 1.0, None, None),
        (-1.0, 0.0, -1.0, None, None),
        (1.001, 0.0, 1.0, "x FH-108", "1.001 rad is outside [-1, 1] rad"),
        (-1.001, 0.0, -1.0, "x FH-108", "-1.001 rad"),
        (0.0, 0.0, 0.1, None, None),
        (0.0, 0.0, 0.1001, "x FH-109", "0.1001 rad is beyond its limit of 0.1 rad"),
        (0.0, 0.0, -0.2, "x FH-109", "-0.2 rad"),
        (0.0, 0.0, math.nan, None, None),  # there is no set-point
    ],
)
def test_each_limit_trips_just_beyond_it(state, position, velocity, demand, code, words):
    reported = velocity if math.isfinite(velocity) else 0.0
    text = supervisor(position=position).find_fault(heard(position, reported), state, velocity, demand)
    assert text is None if code is None else (codes_in(text), words in text) == (code, True)


@pytest.mark.parametrize("is_fresh", [True, False])
def test_a_velocity_that_the_drive_does_not_confirm_is_a_fault_in_the_third_cycle_in_a_row(is_fresh):
    one = supervisor()

    def find(velocity, is_fresh=True, reported=9.0):
        feedback = heard(0.0, reported, is_fresh=is_fresh)
        one.take(feedback)
        return one.find_fault(feedback, LoopState.RUNNING, velocity, 0.0)

    for velocity in (10.5, 12.0, 10.0, -11.0, 11.0, 9.0):
        assert find(velocity) is None
    assert [find(velocity, is_fresh) for velocity in (10.5, 10.5)] == [None, None]
    fault = find(10.5, is_fresh)
    assert (codes_in(fault), "velocity 10.5 " in fault) == ("x FH-107", True)
    one = supervisor()
    assert find(10.5, reported=10.0) is None, "a drive at its limit confirms nothing"
    assert find(10.5, reported=10.001) is not None


def faults_of(one, cycles):
    """The faults, cycle by cycle, of (position, reported velocity); no estimate is beyond its limit."""
    found = []
    for position, velocity in cycles:
        one.take(heard(position, velocity))
        found.append(one.find_fault(heard(position, velocity), LoopState.RUNNING, 0.0, math.nan))
    return found


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_three_velocities_in_a_row_beyond_the_limit_are_a_fault_as_reported_and_by_the_positions(sign):
    fast, slow = sign * 10.1, sign * 10.0
    found = faults_of(supervisor(), [(0.0, each) for each in (slow, fast, fast, slow, fast, fast, slow)])
    assert found == [None] * 7
    found = faults_of(supervisor(), [(0.0, each) for each in (slow, fast, fast, fast)])
    assert found[:3] == [None] * 3
    assert "the drive reports" in found[3]
    assert faults_of(supervisor(), [(0.0, slow)] * 5) == [None] * 5, "the limit itself is allowed"
    found = faults_of(supervisor(), [(sign * 0.012 * k, 0.0) for k in range(1, 4)])
    assert found[:2] == [None, None]
    assert f"velocity {sign * 12:.4g} by its positions" in found[2]


def test_a_lasting_contradiction_of_velocity_and_position_is_a_fault():
    found = faults_of(supervisor(), [(0.0, 8.0)] * 60)
    first = next(k for k, fault in enumerate(found) if fault)
    assert 35 <= first <= 45, "two windows of 20 ms"
    assert codes_in(found[first]) == ("x FH-119")
    assert faults_of(supervisor(), [(0.002 * k, 2.0) for k in range(60)]) == [None] * 60


@pytest.mark.parametrize("missed", [0, 3])
def test_until_a_motion_has_confirmed_the_velocity_it_is_that_of_the_position(missed):
    one, other = (supervisor(position=None, is_velocity_trusted=False) for _ in range(2))
    way = 2.0 * PERIOD_S * (missed + 1)
    assert one.take_doubt() is None
    for k in range(300):
        feedback = heard(way * k, 2.0 * 9.55)
        one.take(feedback, missed if k else 0)
    assert one.velocity(feedback) == pytest.approx(2.0)
    assert "9.55 times" in one.take_doubt()
    assert one.take_doubt() is None, "once"
    assert not one.is_velocity_confirmed
    for k in range(100):
        other.take(heard(way * k, 2.0), missed if k else 0)
    assert other.is_velocity_confirmed
    trusted = supervisor()
    trusted.take(heard(0.001, 7.0))
    assert trusted.velocity(heard(0.001, 7.0)) == 7.0
    assert other.take_doubt() is trusted.take_doubt() is None


@thorough
@given(st.floats(-10.0, 10.0), st.floats(-1.0, 1.0), st.floats(-0.1, 0.1), st.sampled_from(LIMITED))
def test_inside_all_limits_there_is_no_fault(velocity, position, error, state):
    demand = position + 0.999 * error
    assert supervisor(position=position).find_fault(heard(position), state, velocity, demand) is None


@pytest.mark.parametrize("state", [state for state in LoopState if state not in LIMITED])
def test_limits_of_motion_do_not_count_while_nothing_is_commanded_to_move(state):
    assert supervisor(position=5.0).find_fault(heard(5.0, state=DriveState.SWITCHED_ON), state, 99.0, 77.0) is None


def test_an_axis_without_the_optional_limits_has_none_and_a_linear_one_its_unit():
    one = supervisor(SafetyLimits(torque=1.0, velocity=2.0), unit="m")
    assert one.find_fault(heard(), LoopState.RUNNING, 1.0, 1e6) is None
    assert "limit of 2 m/s" in one.find_fault(heard(0.0, 2.4), LoopState.RUNNING, 2.5, 0.0)


@thorough
@given(st.floats(0.1, 20.0), st.floats(-40.0, 40.0))
def test_an_axis_with_an_announced_speed_may_exceed_it_by_a_margin_and_never_its_limit(speed, velocity):
    one = supervisor()
    one.allow(speed)
    bound = min(10.0, 1.5 * speed + 2.0 * 1e-5 / PERIOD_S)
    one.take(heard(velocity=velocity))
    fault = one.find_fault(heard(velocity=velocity), LoopState.RUNNING, velocity, 0.0)
    assert (fault is None) is (abs(velocity) <= bound)
    if fault is not None:
        assert codes_in(fault) == "x FH-107"
        assert ("1.5 times the" in fault) == (bound < 10.0)


def test_the_velocity_that_a_drive_reports_is_held_to_the_announced_speed_too():
    one = supervisor()
    one.allow(2.0)
    found = faults_of(one, [(0.0, 5.0)] * 3)
    assert found[:2] == [None, None]
    assert "5 rad/s, beyond the limit of 3.02 rad/s, 1.5 times the 2" in found[2]


def test_a_slow_motion_is_no_fault_where_the_drive_reports_whole_rpm():
    step, speed = math.pi / 30.0, 0.06
    one = Supervisor("x", LIMITS, PERIOD_S, 1e-6, velocity_resolution=step)
    one.allow(speed)
    for cycle in range(200):
        feedback = heard(speed * PERIOD_S * cycle, step * round(speed / step))
        one.take(feedback)
        assert one.find_fault(feedback, LoopState.RUNNING, speed, math.nan) is None


@pytest.mark.parametrize(("period_s", "held"), [(1e-3, 10), (5e-3, 5), (0.1, 1)])
def test_an_axis_stands_by_its_last_velocity_and_without_feedback_for_a_short_time(period_s, held):
    slowest = max(1e-3 * 10.0, 2.0 * 1e-4 / period_s)
    one = Standstill(10.0, 1e-4, period_s)
    assert not one.take(math.nan, is_usable=False), "nothing is known yet"
    for velocity, stands in ((slowest, True), (-slowest, True), (-1.001 * slowest, False), (1.001 * slowest, False)):
        assert one.take(velocity, is_usable=True) is stands
        lost = [one.take(math.nan, is_usable=False) for _ in range(held + 1)]
        assert lost == [stands] * held + [False]


COUNT_RAD = 1e-4  # rad
LIMIT = 30.0


def lasting_after(positions, velocities, *, usable=None, period_s=PERIOD_S, limit=LIMIT, **options):
    """Cycle in which the contradiction lasts, None for never."""
    check = VelocityCheck(period_s, limit, COUNT_RAD, **options)
    for cycle, (position, velocity) in enumerate(zip(positions, velocities, strict=True)):
        check.take(position, velocity, is_usable=usable is None or bool(usable[cycle]))
        if check.is_lasting:
            return cycle
    return None


def moved(velocity, period_s=PERIOD_S):
    """Position, quantised, of an axis that moves with ``velocity``."""
    return np.round(np.cumsum(velocity) * period_s / COUNT_RAD) * COUNT_RAD


def test_a_frozen_encoder_is_found_before_the_axis_is_fast():
    velocity = 500.0 * np.arange(200) * PERIOD_S  # 500 rad/s^2
    found = lasting_after(np.zeros(200), velocity)
    assert velocity[found] <= LIMIT


@pytest.mark.parametrize(
    ("factor", "most"), [(0.0, 60), (60.0 / (2.0 * math.pi), 199), (0.1, 199), (-1.0, 199), (2.0, 199)]
)
def test_a_frozen_velocity_a_wrong_unit_and_a_wrong_sign_are_found(factor, most):
    velocity = np.full(200, 10.0)
    assert lasting_after(moved(velocity), factor * velocity) <= most


@settings(max_examples=40, deadline=None)
@given(
    st.floats(0.05, 1.0),
    st.floats(0.5, 20.0),
    st.floats(0.0, 5e-3),
    st.integers(0, 2),
    st.floats(0.0, 0.1),
    st.floats(0.0, 0.2),
    st.integers(0, 2**31),
)
def test_filters_delays_quantisation_noise_and_loss_pass(part, frequency, filter_s, delay, step, lost, seed):
    """A sine up to the limit; the reported velocity is filtered, late, quantised (1 rpm is 0.1 rad/s) and noisy."""
    rng = np.random.default_rng(seed)
    time_s = np.arange(1500) * PERIOD_S
    true = part * LIMIT * np.sin(2.0 * np.pi * frequency * time_s)
    reported, value = np.empty_like(true), 0.0
    for cycle, velocity in enumerate(true):
        value += (velocity - value) * PERIOD_S / (filter_s + PERIOD_S)
        reported[cycle] = value
    reported = np.concatenate([np.zeros(delay), reported])[: true.size] + rng.normal(0.0, 0.01 * LIMIT, true.size)
    if step:
        reported = np.trunc(reported / step) * step
    assert lasting_after(moved(true), reported, usable=rng.random(true.size) >= lost) is None


def test_one_glitch_is_no_lasting_contradiction():
    velocity = np.full(400, 3.0)
    reported = velocity.copy()
    reported[200] = 1e4
    assert lasting_after(moved(velocity), reported) is None


def test_a_slow_loop_and_a_coarse_velocity_are_allowed_for():
    period_s, time_s = 0.02, np.arange(500) * 0.02
    true = 1.0 * np.sin(2.0 * np.pi * 0.5 * time_s)
    assert lasting_after(moved(true, period_s), true, period_s=period_s, limit=1.5) is None
    slow = np.full(500, 0.09)  # below 1 rpm
    assert lasting_after(moved(slow), np.zeros(500), limit=0.2, velocity_resolution=0.105) is None
    assert lasting_after(moved(slow), np.zeros(500), limit=0.2) is not None


def test_without_feedback_nothing_is_judged():
    velocity = np.full(400, 10.0)
    assert lasting_after(np.zeros(400), velocity, usable=np.arange(400) % 2 == 0) is None
    check = VelocityCheck(PERIOD_S, LIMIT, COUNT_RAD)
    for _ in range(100):
        assert check.take(math.nan, 1.0) is None
    assert check.last is None
