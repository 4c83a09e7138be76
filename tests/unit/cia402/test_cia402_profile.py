"""CiA 402 facts, against the standard's tables as the canopen library has them."""

import pytest
from canopen.profiles.p402 import OperationMode, State402
from friction_hil_drivers.cia402 import objects, profile
from friction_hil_drivers.cia402.simulated.power import requested_state
from hypothesis import given
from hypothesis import strategies as st

from friction_hil.drive import DriveState, Mode, Request

NAMES = {
    DriveState.NOT_READY: "NOT READY TO SWITCH ON",
    DriveState.SWITCH_ON_DISABLED: "SWITCH ON DISABLED",
    DriveState.READY_TO_SWITCH_ON: "READY TO SWITCH ON",
    DriveState.SWITCHED_ON: "SWITCHED ON",
    DriveState.OPERATION_ENABLED: "OPERATION ENABLED",
    DriveState.QUICK_STOP_ACTIVE: "QUICK STOP ACTIVE",
    DriveState.FAULT_REACTION_ACTIVE: "FAULT REACTION ACTIVE",
    DriveState.FAULT: "FAULT",
}


@given(st.integers(0, 0xFFFF))
def test_statusword_means_what_the_library_says_it_means(statusword: int) -> None:
    meant = [name for name, (mask, bits) in State402.SW_MASK.items() if statusword & mask == bits]
    assert len(meant) <= 1
    state = profile.drive_state(statusword)
    assert NAMES.get(state) == (meant[0] if meant else None)
    if meant:
        assert profile.drive_state(profile.STATE_BITS[state] | statusword & 0xFF90) is state


@pytest.mark.parametrize(
    ("start", "request_", "words", "end"),
    [
        (DriveState.SWITCH_ON_DISABLED, Request.ENABLE, [0x06, 0x07, 0x0F], DriveState.OPERATION_ENABLED),
        (DriveState.OPERATION_ENABLED, Request.DISABLE, [0x07, 0x06, 0x00], DriveState.SWITCH_ON_DISABLED),
        (DriveState.OPERATION_ENABLED, Request.QUICK_STOP, [0x02], DriveState.QUICK_STOP_ACTIVE),
        (DriveState.QUICK_STOP_ACTIVE, Request.DISABLE, [0x00], DriveState.SWITCH_ON_DISABLED),
        (DriveState.QUICK_STOP_ACTIVE, Request.ENABLE, [0x00, 0x06, 0x07, 0x0F], DriveState.OPERATION_ENABLED),
        (DriveState.SWITCHED_ON, Request.QUICK_STOP, [0x00], DriveState.SWITCH_ON_DISABLED),
    ],
)
def test_request_is_reached_by_the_standard_commands(
    start: DriveState, request_: Request, words: list[int], end: DriveState
) -> None:
    state = start
    for word in words:
        assert profile.next_controlword(state, request_) == word
        before, state = state, requested_state(state, word)
        expected = State402.TRANSITIONTABLE.get((NAMES[before], NAMES[state]))
        assert expected is None or expected & 0x0F == word, "the library knows another command for this transition"
    assert state is end
    assert requested_state(state, profile.next_controlword(state, request_)) is state


@given(st.sampled_from(DriveState), st.sampled_from([Request.DISABLE, Request.ENABLE, Request.QUICK_STOP]))
def test_no_request_resets_a_fault_or_enables_unasked(state: DriveState, request_: Request) -> None:
    word = profile.next_controlword(state, request_)
    assert not word & profile.FAULT_RESET
    if request_ is not Request.ENABLE:
        assert word & 0x0F != profile.ENABLE_OPERATION


@pytest.mark.parametrize("request_", [Request.LISTEN, Request.RESET_FAULT])
def test_some_requests_have_no_controlword_of_their_own(request_: Request) -> None:
    with pytest.raises(ValueError, match=request_.name):
        profile.next_controlword(DriveState.FAULT, request_)


def test_drive_follows_every_transition_of_the_standard() -> None:
    automatic = {"NOT READY TO SWITCH ON", "START", "FAULT REACTION ACTIVE", "FAULT"}
    states = {name: state for state, name in NAMES.items()}
    for (start, end), word in State402.TRANSITIONTABLE.items():
        if start not in automatic:
            assert requested_state(states[start], word) is states[end], (start, end)


@given(st.sampled_from(list(NAMES)), st.integers(0, 0xFFFF))
def test_drive_makes_no_transition_beside_the_standard(state: DriveState, word: int) -> None:
    wanted = requested_state(state, word)
    known = {*State402.TRANSITIONTABLE, ("READY TO SWITCH ON", "SWITCH ON DISABLED")}
    known.add(("SWITCHED ON", "SWITCH ON DISABLED"))
    assert wanted is state or (NAMES[state], NAMES[wanted]) in known
    if word & profile.FAULT_RESET:
        assert wanted is state or wanted is not DriveState.OPERATION_ENABLED


def test_modes_of_6502h() -> None:
    assert profile.supported_modes(0) == ()
    assert profile.supported_modes(0xFFFF_FFFF) == (Mode.CSP, Mode.CSV, Mode.CST)
    for kind in ("POSITION", "VELOCITY", "TORQUE"):
        name = f"CYCLIC SYNCHRONOUS {kind}"
        assert profile.supported_modes(OperationMode.SUPPORTED[name]) == (OperationMode.NAME2CODE[name],)


def test_error_codes_and_objects_have_words() -> None:
    assert profile.error_text(0x8130) == "8130h heartbeat or life guard lost"
    assert profile.error_text(0x8999) == "8999h monitoring"
    assert profile.error_text(0xB123) == "B123h the manufacturer's own"
    assert str(objects.TORQUE_OFFSET) == "60B2h torque offset"
    assert str(objects.INTERPOLATION_EXPONENT) == "60C2h:02 interpolation time index"
    assert str(objects.FEED) == "6092h:01 feed"
    assert (objects.TORQUE_OFFSET.mapping, objects.POSITION_ACTUAL.mapping) == (0x60B20010, 0x60640020)
