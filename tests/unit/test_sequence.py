"""The course of a run: which way it can take, and that it always ends without power."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from friction_hil.daemon.safety import REQUESTS, LoopState
from friction_hil.daemon.sequence import (
    DISABLE_TIMEOUT_S,
    ENABLE_TIMEOUT_S,
    QUICK_STOP_TIMEOUT_S,
    SETTLE_S,
    STANDSTILL_S,
    STANDSTILL_TIMEOUT_S,
    Course,
    Facts,
)
from friction_hil.drive import Request

DT = 0.01
STANDING = {"is_standing": True, "is_setpoint_standing": True, "is_faded_out": True}
facts = st.builds(Facts, *[st.booleans()] * 7)


class Run:
    """A course fed with facts every 10 ms."""

    def __init__(self, is_listening=False):
        self.course = Course(is_listening=is_listening)
        self.time_s = 0.0

    def pass_time(self, seconds=DT, **what):
        for _ in range(round(seconds / DT)):
            self.time_s += DT
            self.course.advance(self.time_s, Facts(**what))
        return self.course.state

    def reach(self, state):
        """By the ordinary way."""
        self.pass_time(SETTLE_S)
        if state >= LoopState.RUNNING:
            self.pass_time(is_enabled=True)
        if state >= LoopState.STOPPING:
            self.pass_time(is_enabled=True, is_stop_requested=True)
        assert self.course.state is state
        return self


def test_the_ordinary_way():
    run = Run()
    assert run.pass_time(SETTLE_S - DT) is LoopState.IDLE
    assert run.pass_time() is LoopState.ENABLING
    assert run.pass_time(1.0, is_powered=True) is LoopState.ENABLING
    assert run.pass_time(is_powered=True, is_enabled=True) is LoopState.RUNNING
    assert run.pass_time(10.0, is_powered=True, is_enabled=True) is LoopState.RUNNING
    assert run.pass_time(is_powered=True, is_stop_requested=True) is LoopState.STOPPING
    for missing in ("is_setpoint_standing", "is_faded_out"):
        assert run.pass_time(1.0, is_powered=True, **STANDING | {missing: False}) is LoopState.STOPPING
    assert run.pass_time(is_powered=True, **STANDING) is LoopState.DISABLING
    assert run.pass_time(1.0, is_powered=True) is LoopState.DISABLING
    assert run.pass_time() is LoopState.DONE
    assert run.pass_time(10.0, is_stop_requested=True, has_fault=True) is LoopState.DONE
    assert run.course.fault == ""


def test_a_reversal_is_no_standstill():
    """The axis seems to stand for a moment, again and again."""
    run = Run().reach(LoopState.RUNNING)
    run.pass_time(has_fault=True, is_powered=True)
    for _ in range(20):
        assert run.pass_time(STANDSTILL_S - DT, has_fault=True, is_powered=True, is_standing=True) is (
            LoopState.FAULT_STOPPING
        )
        run.pass_time(has_fault=True, is_powered=True)
    assert run.pass_time(STANDSTILL_S + DT, has_fault=True, is_powered=True, is_standing=True) is LoopState.DISABLING


@pytest.mark.parametrize("state", [LoopState.RUNNING, LoopState.STOPPING])
def test_a_fault_in_motion_stops_the_axis_before_it_is_disabled(state):
    run = Run().reach(state)
    assert run.pass_time(has_fault=True, is_powered=True) is LoopState.FAULT_STOPPING
    assert run.pass_time(1.0, has_fault=True, is_powered=True) is LoopState.FAULT_STOPPING
    assert run.pass_time(0.1, has_fault=True, is_powered=True, is_standing=True) is LoopState.DISABLING
    assert run.course.fault == ""


def test_a_fault_that_took_the_power_away_needs_no_stop():
    run = Run().reach(LoopState.RUNNING)
    run.pass_time(has_fault=True, is_powered=True)
    assert run.pass_time(has_fault=True) is LoopState.DISABLING
    assert run.pass_time(has_fault=True) is LoopState.DONE


@pytest.mark.parametrize("what", ["has_fault", "is_stop_requested"])
def test_before_power_a_fault_or_a_stop_ends_the_run(what):
    assert Run().pass_time(**{what: True}) is LoopState.DONE
    run = Run().reach(LoopState.ENABLING)
    assert run.pass_time(is_powered=True, is_enabled=True, **{what: True}) is LoopState.DISABLING


@pytest.mark.parametrize(
    ("state", "held", "timeout_s", "after", "words"),
    [
        (LoopState.ENABLING, {}, ENABLE_TIMEOUT_S, LoopState.DISABLING, "not enabled within 5 s"),
        (LoopState.STOPPING, STANDING | {"is_standing": False}, STANDSTILL_TIMEOUT_S, LoopState.DISABLING, ""),
        (LoopState.FAULT_STOPPING, {"has_fault": True}, QUICK_STOP_TIMEOUT_S, LoopState.DISABLING, "no standstill"),
        (LoopState.DISABLING, {}, DISABLE_TIMEOUT_S, LoopState.DONE, "still powered 2 s after"),
    ],
)
def test_what_does_not_come_is_not_waited_for_forever(state, held, timeout_s, after, words):
    run = Run()
    if state <= LoopState.STOPPING:
        run.reach(state)
    else:
        run.reach(LoopState.RUNNING).pass_time(has_fault=True, is_powered=True)
        while run.course.state is not state:
            run.pass_time(has_fault=True, is_powered=True, is_standing=True)
        assert run.course.state is state
    assert run.pass_time(timeout_s - 2 * DT, is_powered=True, **held) is state
    assert run.pass_time(3 * DT, is_powered=True, **held) is after
    assert words in run.course.fault
    assert bool(words) is bool(run.course.fault)


def test_a_listener_stays_idle_until_it_is_told_to_go():
    run = Run(is_listening=True)
    assert run.pass_time(10.0, is_enabled=True, is_powered=True, is_standing=True) is LoopState.IDLE
    assert run.pass_time(is_stop_requested=True) is LoopState.DONE


@settings(max_examples=40, deadline=None)
@given(st.lists(st.tuples(facts, st.integers(1, 300)), max_size=20), st.booleans())
def test_no_course_of_things_goes_back_or_gives_power_after_a_fault(events, is_listening):
    course, time_s, faulty = Course(is_listening=is_listening), 0.0, False
    before = course.state
    for what, repeats in events:
        for _ in range(repeats):
            time_s += DT
            changed = course.advance(time_s, what)
            after = course.state
            assert changed is (after is not before)
            assert after >= before
            if after is not before:
                assert course.since_s == time_s
            if is_listening:
                assert after in (LoopState.IDLE, LoopState.DONE)
            if (before, after) == (LoopState.ENABLING, LoopState.RUNNING):
                assert what.is_enabled
                assert not what.has_fault
                assert not what.is_stop_requested
            faulty = faulty or what.has_fault
            if faulty:
                assert REQUESTS[after] is not Request.ENABLE
            before = after


@settings(max_examples=40, deadline=None)
@given(st.lists(st.tuples(facts, st.integers(1, 100)), max_size=8), facts, st.sampled_from(["stop", "fault"]))
def test_every_course_ends_in_bounded_time(events, last, why):
    """Whatever the drives do: set-point and fading end by themselves, all else has a time-out."""
    course, time_s = Course(is_listening=False), 0.0
    for what, repeats in events:
        for _ in range(repeats):
            time_s += DT
            course.advance(time_s, what)
    last.is_stop_requested = last.is_stop_requested or why == "stop"
    last.has_fault = last.has_fault or why == "fault"
    last.is_setpoint_standing = last.is_faded_out = True
    bound = time_s + STANDSTILL_TIMEOUT_S + QUICK_STOP_TIMEOUT_S + DISABLE_TIMEOUT_S + 0.1
    while course.state is not LoopState.DONE:
        time_s += DT
        course.advance(time_s, last)
        assert time_s < bound
