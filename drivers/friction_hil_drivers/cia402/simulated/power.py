"""Power drive system state machine of CiA 402: the state that a controlword asks for. Pure functions."""

from enum import IntEnum

from friction_hil.drive import DriveState


class PowerCommand(IntEnum):
    """Device control commands, decoded from the controlword's bits 0 to 3."""

    DISABLE_VOLTAGE = 0
    QUICK_STOP = 1
    SHUTDOWN = 2
    SWITCH_ON = 3  # in Operation Enabled: disable operation
    ENABLE_OPERATION = 4


def command(controlword: int) -> PowerCommand:
    """Return the device control command in a controlword."""
    if not controlword & 0x02:
        return PowerCommand.DISABLE_VOLTAGE
    if not controlword & 0x04:
        return PowerCommand.QUICK_STOP
    if not controlword & 0x01:
        return PowerCommand.SHUTDOWN
    return PowerCommand.ENABLE_OPERATION if controlword & 0x08 else PowerCommand.SWITCH_ON


_DISABLED, _READY = DriveState.SWITCH_ON_DISABLED, DriveState.READY_TO_SWITCH_ON
_ON, _ENABLED = DriveState.SWITCHED_ON, DriveState.OPERATION_ENABLED
_STOPPING = DriveState.QUICK_STOP_ACTIVE

TRANSITIONS: dict[tuple[DriveState, PowerCommand], DriveState] = {
    (_DISABLED, PowerCommand.SHUTDOWN): _READY,  # 2
    (_READY, PowerCommand.SWITCH_ON): _ON,  # 3
    (_READY, PowerCommand.ENABLE_OPERATION): _ON,  # 3, then 4
    (_ON, PowerCommand.ENABLE_OPERATION): _ENABLED,  # 4
    (_ENABLED, PowerCommand.SWITCH_ON): _ON,  # 5
    (_ON, PowerCommand.SHUTDOWN): _READY,  # 6
    (_READY, PowerCommand.DISABLE_VOLTAGE): _DISABLED,  # 7
    (_READY, PowerCommand.QUICK_STOP): _DISABLED,  # 7
    (_ENABLED, PowerCommand.SHUTDOWN): _READY,  # 8
    (_ENABLED, PowerCommand.DISABLE_VOLTAGE): _DISABLED,  # 9
    (_ON, PowerCommand.DISABLE_VOLTAGE): _DISABLED,  # 10
    (_ON, PowerCommand.QUICK_STOP): _DISABLED,  # 10
    (_ENABLED, PowerCommand.QUICK_STOP): _STOPPING,  # 11
    (_STOPPING, PowerCommand.DISABLE_VOLTAGE): _DISABLED,  # 12
    (_STOPPING, PowerCommand.ENABLE_OPERATION): _ENABLED,  # 16, where the quick stop option allows it
}
_UPWARD = ((_DISABLED, _READY), (_READY, _ON), (_ON, _ENABLED), (_STOPPING, _ENABLED))


def _requested(state: DriveState, controlword: int) -> DriveState:
    wanted = TRANSITIONS.get((state, command(controlword)), state)
    return state if controlword & 0x80 and (state, wanted) in _UPWARD else wanted


# by state and low byte of the controlword: read in every cycle
_REQUESTED = {state: tuple(_requested(state, word) for word in range(0x100)) for state in DriveState}


def requested_state(state: DriveState, controlword: int) -> DriveState:
    """Return the state that a controlword asks for, one transition from ``state``; ``state`` itself for none.

    While the fault reset bit is set no transition leads towards Operation Enabled: resetting a fault must not
    switch a drive on. The reset itself (transition 15) depends on the controlword before and is not part of this.
    """
    return _REQUESTED[state][controlword & 0xFF]
