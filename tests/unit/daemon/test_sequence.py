"""State machine of a run: its transitions, and that it always ends without power."""

from dataclasses import fields

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from friction_hil.daemon import sequence
from friction_hil.daemon.safety import STANDSTILL_S, LoopState
from friction_hil.daemon.sequence import REQUESTS, RunInputs, RunStateMachine, Timeout, timeout_faults
from friction_hil.drive import DriveState, Feedback, Request
from friction_hil.drive.codes import FaultCode

DT = 0.01
STANDING = {"is_standing": True, "is_setpoint_standing": True, "is_faded_out": True}
PLACES = {LoopState.FIRST_MOTION: 1.5, LoopState.WAITING: 5.5}
inputs = st.builds(RunInputs, **{one.name: st.booleans() for one in fields(RunInputs)})


def place(state):
    """Place of a state in the order of a run."""
    return PLACES.get(state, float(state))


class Run:
    """A state machine with inputs every 10 ms."""

    def __init__(self, is_listening=False):
        self.machine = RunStateMachine(is_listening=is_listening)
        self.time_s = 0.0

    def pass_time(self, seconds=DT, **what):
        for _ in range(round(seconds / DT)):
            self.time_s += DT
            self.machine.advance(self.time_s, RunInputs(**what))
        return self.machine.state

    def reach(self, state):
        """Go there without any fault."""
        self.pass_time(sequence.SETTLE_S)
        if state >= LoopState.RUNNING:
            self.pass_time(is_enabled=True)
        if state >= LoopState.STOPPING:
            self.pass_time(is_enabled=True, is_stop_requested=True)
        assert self.machine.state is state
        return self


def test_an_ordinary_run():
    run = Run()
    assert run.pass_time(sequence.SETTLE_S - DT) is LoopState.IDLE
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
    assert run.machine.take_timeout() is None


@pytest.mark.parametrize(
    ("what", "after"),
    [
        ({}, LoopState.RUNNING),
        ({"is_first_motion_due": True, "has_fault": True}, LoopState.FAULT_STOPPING),
        ({"is_first_motion_due": True, "is_stop_requested": True}, LoopState.FAULT_STOPPING),
    ],
)
def test_a_first_motion_comes_before_the_path_and_is_ended_by_the_drives_quick_stop(what, after):
    run, powered = Run().reach(LoopState.ENABLING), {"is_enabled": True, "is_powered": True}
    assert run.pass_time(is_enabled=True, is_first_motion_due=True) is LoopState.FIRST_MOTION
    assert run.pass_time(3.0, is_first_motion_due=True, **powered) is LoopState.FIRST_MOTION
    assert run.pass_time(**powered, **what) is after


@pytest.mark.parametrize("state", [LoopState.RUNNING, LoopState.STOPPING])
def test_a_fault_in_motion_stops_the_axis_before_it_is_disabled(state):
    """And a reversal, in which the axis seems to stand for a moment, again and again, is no standstill."""
    run, fault = Run().reach(state), {"has_fault": True, "is_powered": True}
    assert run.pass_time(1.0, **fault) is LoopState.FAULT_STOPPING
    for _ in range(20):
        assert run.pass_time(STANDSTILL_S - DT, is_standing=True, **fault) is LoopState.FAULT_STOPPING
        run.pass_time(**fault)
    assert run.pass_time(STANDSTILL_S + DT, is_standing=True, **fault) is LoopState.DISABLING
    assert run.machine.take_timeout() is None


def test_a_fault_that_took_the_power_away_needs_no_stop():
    run = Run().reach(LoopState.RUNNING)
    run.pass_time(has_fault=True, is_powered=True)
    assert [run.pass_time(has_fault=True) for _ in range(2)] == [LoopState.DISABLING, LoopState.DONE]


def test_a_drive_may_be_given_longer_to_switch_on():
    run = Run()
    run.machine = RunStateMachine(is_listening=False, enable_timeout_s=20.0)
    run.reach(LoopState.ENABLING)
    assert run.pass_time(19.9, is_standing=True) is LoopState.ENABLING
    assert run.pass_time(0.2, is_standing=True) is not LoopState.ENABLING
    assert "20 s" in run.machine.take_timeout().text


@pytest.mark.parametrize("what", ["has_fault", "is_stop_requested"])
def test_before_power_a_fault_or_a_stop_ends_the_run(what):
    assert Run().pass_time(**{what: True}) is LoopState.DONE
    run = Run().reach(LoopState.ENABLING)
    assert run.pass_time(is_powered=True, is_enabled=True, **{what: True}) is LoopState.DISABLING


def test_a_listener_stays_idle_until_it_is_told_to_go():
    run = Run(is_listening=True)
    assert run.pass_time(10.0, is_enabled=True, is_powered=True, is_standing=True) is LoopState.IDLE
    assert run.pass_time(is_stop_requested=True) is LoopState.DONE


@settings(max_examples=40, deadline=None)
@given(st.lists(st.tuples(inputs, st.integers(1, 300)), max_size=20), st.booleans())
def test_no_inputs_lead_back_or_to_power_after_a_fault(events, is_listening):
    machine, time_s, faulty = RunStateMachine(is_listening=is_listening), 0.0, False
    before = machine.state
    for what in (what for what, repeats in events for _ in range(repeats)):
        time_s += DT
        changed = machine.advance(time_s, what)
        after = machine.state
        assert changed is (after is not before)
        assert machine.since_s == time_s or not changed
        # back to power only from WAITING, where nobody has to be kept from it
        is_started = before is LoopState.WAITING and after is LoopState.ENABLING
        is_ending = what.has_fault or what.is_stop_requested or what.is_pause_requested
        assert place(after) >= place(before) or is_started
        assert not (is_started and is_ending)
        assert not is_listening or after in (LoopState.IDLE, LoopState.WAITING, LoopState.DONE)
        if before is LoopState.ENABLING and after in (LoopState.FIRST_MOTION, LoopState.RUNNING):
            assert what.is_enabled
            assert not is_ending
        faulty = what.has_fault or (faulty and not is_started)
        assert not (faulty and REQUESTS[after] is Request.ENABLE)
        before = after


@settings(max_examples=40, deadline=None)
@given(
    st.lists(st.tuples(inputs, st.integers(1, 100)), max_size=8), inputs, st.sampled_from(["stop", "fault", "pause"])
)
@example([(RunInputs(has_fault=True, is_kept_after_fault=True), 1)], RunInputs(), "fault")
def test_every_run_ends_in_bounded_time(events, last, why):
    """Whatever the drives do: the set-point ends by itself, all else has a time-out."""
    machine, time_s = RunStateMachine(is_listening=False), 0.0
    for what in (what for what, repeats in events for _ in range(repeats)):
        time_s += DT
        machine.advance(time_s, what)
    last.is_stop_requested |= why == "stop"
    last.has_fault |= why == "fault"
    last.is_kept_after_fault &= why == "pause"
    last.is_pause_requested |= why == "pause"
    last.is_setpoint_standing = True  # the compensation may fade for a day, by fade_s
    disabling_s = max(sequence.DISABLE_TIMEOUT_S, sequence.LOST_POWERED_TIMEOUT_S)
    stopping_s = sequence.FADE_TIMEOUT_S + sequence.STANDSTILL_TIMEOUT_S + sequence.QUICK_STOP_TIMEOUT_S
    bound = time_s + stopping_s + disabling_s + 0.1
    # who waits without power, waits with a fault too
    may_wait = why == "pause" or (why == "fault" and machine.state is LoopState.WAITING)
    while machine.state not in ((LoopState.DONE, LoopState.WAITING) if may_wait else (LoopState.DONE,)):
        time_s += DT
        machine.advance(time_s, last)
        assert time_s < bound


@settings(max_examples=60, deadline=None)
@given(ramp=st.integers(0, 500), fade=st.integers(0, 500), moves=st.integers(0, 800))
@example(ramp=0, fade=0, moves=800)
def test_a_stop_waits_for_standstill_from_the_rest_of_set_point_and_compensation_on(ramp, fade, moves):
    """Cycles after the request: the axis follows its ramp, and may go on moving after that, as one that hunts does."""
    run = Run().reach(LoopState.STOPPING)
    rest, waits, stands = max(ramp, fade), round(sequence.STANDSTILL_TIMEOUT_S / DT), round(STANDSTILL_S / DT)
    cycle = 0
    while run.machine.state is LoopState.STOPPING:
        cycle += 1
        run.pass_time(
            is_powered=True, is_setpoint_standing=cycle > ramp, is_faded_out=cycle > fade, is_standing=cycle > moves
        )
    assert run.machine.state is LoopState.DISABLING
    assert cycle > rest
    assert cycle >= min(moves + stands, rest + waits), "it still moves, and has not had its time"
    assert cycle <= max(rest, min(moves + stands, rest + waits)) + 3


def test_a_pause_disables_and_waits_and_a_start_enables_again():
    run = Run().reach(LoopState.RUNNING)
    assert run.pass_time(is_pause_requested=True, is_powered=True, is_enabled=True) is LoopState.STOPPING
    assert run.pass_time(0.1, is_pause_requested=True, is_powered=True, **STANDING) is LoopState.DISABLING
    assert run.pass_time(is_pause_requested=True) is LoopState.WAITING
    assert run.pass_time(30.0, is_pause_requested=True) is LoopState.WAITING
    assert run.pass_time(has_fault=True) is LoopState.WAITING
    assert run.pass_time() is LoopState.ENABLING


@pytest.mark.parametrize(("is_kept", "after"), [(True, LoopState.WAITING), (False, LoopState.DONE)])
def test_after_a_fault_a_run_that_is_kept_waits_and_another_ends(is_kept, after):
    run = Run().reach(LoopState.RUNNING)
    fault = {"has_fault": True, "is_kept_after_fault": is_kept, "is_pause_requested": True}
    assert run.pass_time(is_powered=True, **fault) is LoopState.FAULT_STOPPING
    assert run.pass_time(0.1, is_powered=True, is_standing=True, **fault) is LoopState.DISABLING
    assert run.pass_time(**fault) is after


@pytest.mark.parametrize(
    ("state", "held", "seconds", "code"),
    [
        (LoopState.IDLE, {}, 0.05, None),
        (LoopState.ENABLING, {}, 5.0, FaultCode.NOT_ENABLED),
        (LoopState.STOPPING, {"is_setpoint_standing": True}, 10.0, None),  # compensation that does not fade out
        (LoopState.STOPPING, {"is_setpoint_standing": True, "is_faded_out": True}, 2.0, None),
        (LoopState.FAULT_STOPPING, {"is_powered": True, "has_fault": True}, 5.0, FaultCode.NO_STANDSTILL),
        (LoopState.FAULT_STOPPING, {"is_powered": True, "is_standing": True}, 0.05, None),
        (LoopState.DISABLING, {"is_powered": True}, 2.0, FaultCode.STILL_POWERED),
        (LoopState.DISABLING, {"is_lost_powered": True}, 5.0, None),
        (LoopState.DISABLING, {"is_lost_unknown": True}, 1.0, None),
        (LoopState.DISABLING, {"is_lost_powered": True, "is_lost_unknown": True}, 5.0, None),
    ],
)
def test_every_wait_has_a_timeout_of_its_own(state, held, seconds, code):
    """The numbers are written out here: a stop that takes twice as long by a change of one is another stop."""
    machine, period_s = RunStateMachine(is_listening=False), 1e-3
    machine.state = state
    machine.advance(0.0, RunInputs(**held | {"is_standing": False}))
    k = 1
    while machine.state is state and k < 20_000:
        machine.advance(k * period_s, RunInputs(**held))
        k += 1
    more_s = 2.0 if state is LoopState.STOPPING and seconds == 10.0 else 0.0  # then standstill is waited for
    assert (k - 1) * period_s == pytest.approx(seconds + more_s, abs=2.5 * period_s)
    ends = {LoopState.IDLE: LoopState.ENABLING, LoopState.DISABLING: LoopState.DONE}
    assert machine.state is ends.get(state, LoopState.DISABLING)
    timeout = machine.take_timeout()
    assert (timeout is None) if code is None else timeout.code is code
    assert machine.take_timeout() is None


POWERED, OFF, MOVES, STANDS = DriveState.OPERATION_ENABLED, DriveState.SWITCH_ON_DISABLED, False, True


@pytest.mark.parametrize(
    ("state", "drive", "stands", "is_named"),
    [
        (LoopState.ENABLING, OFF, STANDS, True),
        (LoopState.ENABLING, POWERED, MOVES, False),
        (LoopState.DISABLING, POWERED, STANDS, True),
        (LoopState.DISABLING, OFF, MOVES, False),
        (LoopState.FAULT_STOPPING, POWERED, MOVES, True),
        (LoopState.FAULT_STOPPING, OFF, STANDS, False),
    ],
)
@pytest.mark.parametrize("reachable", [True, False])
@pytest.mark.parametrize("silent", [True, False])
def test_a_timeout_names_the_axes_that_kept_the_run_and_not_those_of_which_nothing_is_known(
    state, drive, stands, is_named, reachable, silent
):
    timeout = Timeout(FaultCode.STILL_POWERED, "not in time")
    heard = Feedback(state=drive, is_fresh=True, is_reachable=reachable)
    said = list(timeout_faults(timeout, state, ["x"], [heard], [stands], [silent]))
    if not (is_named and reachable):  # nobody: the wait is told all the same
        assert said == [FaultCode.STILL_POWERED.append_to("not in time")]
    elif silent:
        assert said == []
    else:
        assert [each.startswith(f"x: not in time: the drive is in {drive.words}") for each in said] == [True]


def test_an_axis_that_has_stood_since_the_start_is_disabled_at_once():
    machine = RunStateMachine(is_listening=False)
    machine.state = LoopState.FAULT_STOPPING
    assert not machine.advance(0.04, RunInputs(is_powered=True, is_standing=True))
    assert machine.advance(0.06, RunInputs(is_powered=True, is_standing=True))
    assert machine.state is LoopState.DISABLING
