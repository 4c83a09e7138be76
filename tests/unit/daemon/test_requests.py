"""What is asked of the drives in each state of a run, and which fault of a drive is reset."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from friction_hil.daemon.safety import LoopState
from friction_hil.daemon.sequence import FAULT_RESET_S, REQUESTS, REQUESTS_AFTER_FAULT, FaultReset, Requests
from friction_hil.drive import Command, DriveState, Feedback, Request

FAULT, READY, ENABLED = DriveState.FAULT, DriveState.READY_TO_SWITCH_ON, DriveState.OPERATION_ENABLED
states, drive_states = st.sampled_from(list(LoopState)), st.sampled_from(list(DriveState))


def heard(state):
    return Feedback(state=state, is_fresh=True)


def asked(requests, state, *drives, time_s=0.0, has_fault=False, is_covered=False):
    """Return what is asked of drives in these states."""
    commands, feedback = [Command() for _ in drives], [heard(each) for each in drives]
    requests.fill(commands, feedback, [is_covered] * len(drives), state, time_s, has_fault=has_fault)
    return [each.request for each in commands]


def test_only_states_of_motion_ask_for_power():
    assert set(REQUESTS) == set(LoopState)
    enabling = {state for state, request in REQUESTS.items() if request is Request.ENABLE}
    assert enabling == {LoopState.ENABLING, LoopState.FIRST_MOTION, LoopState.RUNNING, LoopState.STOPPING}
    assert Request.RESET_FAULT not in REQUESTS.values()


@pytest.mark.parametrize(
    ("states", "changes", "is_due"),
    [
        ([FAULT], {}, True),
        ([DriveState.UNKNOWN, FAULT], {}, True),
        ([FAULT], {"is_wanted": False}, False),
        ([READY], {}, False),
        ([FAULT, READY, FAULT], {}, False),
        ([FAULT], {"at_s": FAULT_RESET_S}, False),
        ([FAULT], {"run": LoopState.RUNNING}, False),
    ],
)
def test_only_the_fault_found_at_the_start_is_reset_and_only_on_request(states, changes, is_due):
    given = {"is_wanted": True, "run": LoopState.ENABLING, "at_s": 0.1} | changes
    one = FaultReset(given["is_wanted"])
    for state in states:
        one.take(heard(state))
    assert one.is_due(heard(states[-1]), given["run"], given["at_s"]) is is_due


def test_asking_for_the_reset_changes_nothing_and_its_time_begins_again_once_somebody_starts_the_axes():
    one = FaultReset(True)
    assert not one.is_due(heard(DriveState.SWITCHED_ON), LoopState.IDLE, 0.0)
    assert one.is_due(heard(FAULT), LoopState.IDLE, 0.0)
    assert not one.is_due(heard(FAULT), LoopState.IDLE, FAULT_RESET_S)
    assert not one.is_due(heard(FAULT), LoopState.WAITING, 5.0)
    assert one.is_due(heard(FAULT), LoopState.ENABLING, 60.0)
    assert not one.is_due(heard(FAULT), LoopState.ENABLING, 60.0 + FAULT_RESET_S)


def test_a_fault_that_comes_later_is_not_covered():
    one = Requests(2, is_fault_reset_wanted=True)
    assert one.may_reset(0)
    assert one.covers(0, heard(FAULT), LoopState.IDLE, 0.0, has_fault=True)
    assert one.covers(0, heard(FAULT), LoopState.ENABLING, 0.1, has_fault=True)
    assert not one.covers(0, heard(READY), LoopState.ENABLING, 0.2, has_fault=False)
    assert not one.covers(0, heard(FAULT), LoopState.ENABLING, 0.3, has_fault=True)
    assert not one.may_reset(0)
    assert not one.covers(1, heard(READY), LoopState.IDLE, 0.0, has_fault=False)
    assert one.may_reset(1), "the other drive has its own, and keeps it while it is well and the run is idle"
    assert not one.covers(1, heard(READY), LoopState.IDLE, 0.0, has_fault=True)
    assert not one.may_reset(1)
    assert not Requests(1).covers(0, heard(FAULT), LoopState.ENABLING, 0.1, has_fault=True)


@given(states, st.booleans(), st.lists(drive_states, min_size=1, max_size=3))
def test_each_drive_is_asked_for_what_the_state_says(state, has_fault, drives):
    wanted = (REQUESTS_AFTER_FAULT if has_fault else REQUESTS)[state]
    one = Requests(len(drives))
    one.is_commanded = True
    assert asked(one, state, *drives, has_fault=has_fault) == [wanted] * len(drives)


@given(states, st.booleans(), drive_states, st.booleans())
def test_beside_a_master_nothing_is_asked(state, has_fault, drive, is_stop_asked):
    one = Requests(1, is_follower=True)
    one.is_stop_asked = is_stop_asked
    assert asked(one, state, drive, has_fault=has_fault) == [Request.LISTEN]
    assert not one.is_commanded


@pytest.mark.parametrize("before", [[], [LoopState.IDLE], [LoopState.IDLE, LoopState.ENABLING]])
@pytest.mark.parametrize("is_stop_asked", [False, True])
def test_a_run_that_waits_disables_only_what_it_or_somebody_wanted_stopped(before, is_stop_asked):
    one = Requests(1)
    for state in before:
        asked(one, state, READY)
    assert one.is_commanded is (LoopState.ENABLING in before)
    one.is_stop_asked = is_stop_asked
    is_disabled = is_stop_asked or LoopState.ENABLING in before
    assert asked(one, LoopState.WAITING, ENABLED) == [Request.DISABLE if is_disabled else Request.LISTEN]


def test_a_fault_that_is_covered_is_reset_while_the_drive_is_being_enabled():
    assert asked(Requests(1), LoopState.ENABLING, FAULT, is_covered=True) == [Request.RESET_FAULT]
    assert asked(Requests(1), LoopState.IDLE, FAULT, is_covered=True) == [Request.LISTEN]
    assert asked(Requests(1), LoopState.ENABLING, FAULT) == [Request.ENABLE]


def test_a_run_that_waits_resets_drives_in_fault_for_a_second_and_no_others():
    one, other = Requests(2), Requests(1)
    assert FAULT_RESET_S == 1.0
    assert asked(one, LoopState.WAITING, FAULT, READY, time_s=-math.inf) == [Request.LISTEN] * 2
    one.reset_faults(10.0)
    assert asked(one, LoopState.ENABLING, FAULT, READY, time_s=10.1) == [Request.ENABLE] * 2
    assert asked(one, LoopState.WAITING, FAULT, READY, time_s=10.2) == [Request.RESET_FAULT, Request.DISABLE]
    assert asked(one, LoopState.WAITING, FAULT, READY, time_s=10.0 + FAULT_RESET_S) == [Request.DISABLE] * 2
    other.reset_faults(10.0)
    assert asked(other, LoopState.WAITING, FAULT, time_s=10.5) == [Request.RESET_FAULT]
    assert other.is_commanded, "a reset counts as a command"
