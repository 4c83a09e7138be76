"""Controlword, statusword, modes, error codes and emergencies of CiA 402. Pure functions, no bus."""

import struct

from friction_hil.drive import DriveState, Mode, Request

# Commands of the controlword (6040h)
DISABLE_VOLTAGE = 0x0000
QUICK_STOP = 0x0002
SHUTDOWN = 0x0006
SWITCH_ON = 0x0007  # from Operation Enabled the same bits mean "disable operation"
ENABLE_OPERATION = 0x000F
FAULT_RESET = 0x0080  # acts on the rising edge of this bit alone

# Bits of the statusword (6041h)
VOLTAGE_ENABLED = 0x0010
WARNING = 0x0080
REMOTE = 0x0200
TARGET_REACHED = 0x0400
INTERNAL_LIMIT = 0x0800
FOLLOWS_COMMAND = 0x1000  # csp, csv, cst: the drive follows the command value
FOLLOWING_ERROR = 0x2000  # csp

STATE_BITS: dict[DriveState, int] = {
    DriveState.NOT_READY: 0x00,
    DriveState.SWITCH_ON_DISABLED: 0x40,
    DriveState.READY_TO_SWITCH_ON: 0x21,
    DriveState.SWITCHED_ON: 0x23,
    DriveState.OPERATION_ENABLED: 0x27,
    DriveState.QUICK_STOP_ACTIVE: 0x07,
    DriveState.FAULT_REACTION_ACTIVE: 0x0F,
    DriveState.FAULT: 0x08,
}
_QUICK_STOP_BIT_COUNTS = (0x21, 0x23, 0x27, 0x07)  # in these; in the others bit 5 has no meaning


def _decode(bits: int) -> DriveState:
    for state, pattern in STATE_BITS.items():
        mask = 0x6F if pattern in _QUICK_STOP_BIT_COUNTS else 0x4F
        if bits & mask == pattern:
            return state
    return DriveState.UNKNOWN


STATE_MASK = 0x6F  # bits of the statusword from which the state follows
STATES = tuple(_decode(bits) for bits in range(STATE_MASK + 1))


def drive_state(statusword: int) -> DriveState:
    """Return the state that a statusword reports, `DriveState.UNKNOWN` for bits that the profile does not define."""
    return STATES[statusword & STATE_MASK]


_SAID_WHILE_DISABLED = (  # (bit, value that is told, text)
    (VOLTAGE_ENABLED, False, "no voltage"),
    (WARNING, True, "a warning"),
    (REMOTE, False, "not in remote control, so that it takes no controlword"),
    (INTERNAL_LIMIT, True, "an internal limit is active"),
)


def status_words(statusword: int) -> str:
    """Return a statusword with what it says beside the state of a drive that is not enabled.

    >>> status_words(0x0240)
    '6041h = 0240h: no voltage'
    """
    said = [text for bit, value, text in _SAID_WHILE_DISABLED if bool(statusword & bit) is value]
    return f"6041h = {statusword & 0xFFFF:04X}h{': ' if said else ''}{', '.join(said)}"


_TO_DISABLE = {DriveState.OPERATION_ENABLED: SWITCH_ON, DriveState.SWITCHED_ON: SHUTDOWN}
_TO_ENABLE = {
    DriveState.SWITCH_ON_DISABLED: SHUTDOWN,
    DriveState.READY_TO_SWITCH_ON: SWITCH_ON,
    DriveState.SWITCHED_ON: ENABLE_OPERATION,
    DriveState.OPERATION_ENABLED: ENABLE_OPERATION,
}
_TO_QUICK_STOP = {DriveState.OPERATION_ENABLED: QUICK_STOP, DriveState.QUICK_STOP_ACTIVE: QUICK_STOP}
_STEPS = {Request.DISABLE: _TO_DISABLE, Request.ENABLE: _TO_ENABLE, Request.QUICK_STOP: _TO_QUICK_STOP}


def next_controlword(state: DriveState, request: Request, before: int | None = None) -> int:
    """Return the controlword that takes a drive in ``state`` one transition towards ``request``.

    A fault is reset by the user's explicit request alone, and once: the drive needs a rising edge after ``before``, the
    controlword of the cycle before. A drive in Quick Stop Active is enabled through Switch On Disabled, because few
    drives support the direct transition 16.

    Raises `ValueError`: ``request`` is `Request.LISTEN`, for which no controlword is written, or `Request.RESET_FAULT`
    without the controlword before.
    """
    if request is Request.RESET_FAULT and before is not None:
        return FAULT_RESET if state is DriveState.FAULT and not before & FAULT_RESET else DISABLE_VOLTAGE
    if request not in _STEPS:
        raise ValueError(f"no controlword follows from {request.name} and the drive's state alone")
    return _STEPS[request].get(state, DISABLE_VOLTAGE)


def supported_modes(bits: int) -> tuple[Mode, ...]:
    """Return the cyclic synchronous modes in object 6502h: mode n has bit n - 1."""
    return tuple(mode for mode in Mode if bits >> (mode - 1) & 1)


_MODE_NAMES = {
    1: "profile position",
    2: "velocity",
    3: "profile velocity",
    4: "profile torque",
    6: "homing",
    7: "interpolated position",
    8: "csp",
    9: "csv",
    10: "cst",
    11: "cst with commutation angle",
}


def mode_names(bits: int) -> list[str]:
    """Return the names of all modes of the profile in object 6502h."""
    return [name for mode, name in _MODE_NAMES.items() if bits >> (mode - 1) & 1]


# Error codes of 603Fh and of EMCY messages that a servo axis meets (CiA 301, CiA 402)
ERROR_TEXTS: dict[int, str] = {
    0x2310: "continuous over-current",
    0x2320: "short circuit or earth leakage",
    0x3110: "mains over-voltage",
    0x3120: "mains under-voltage",
    0x3210: "DC link over-voltage",
    0x3220: "DC link under-voltage",
    0x4210: "device too hot",
    0x4310: "drive too hot",
    0x5441: "contactor or safety input open",
    0x6320: "parameter error",
    0x7121: "motor blocked",
    0x7300: "sensor error",
    0x7305: "incremental encoder 1 error",
    0x7500: "communication error inside the drive",
    0x8100: "communication error",
    0x8110: "CAN overrun: frames were lost",
    0x8120: "CAN in error passive mode",
    0x8130: "heartbeat or life guard lost",
    0x8140: "recovered from bus-off",
    0x8141: "recovered from bus-off",
    0x8150: "CAN identifier collision",
    0x8210: "RPDO not processed: too short",
    0x8220: "RPDO longer than mapped",
    0x8250: "RPDO time-out",
    0x8400: "velocity speed controller",
    0x8500: "position controller",
    0x8611: "following error",
    0x8700: "SYNC lost",
}
_ERROR_CLASSES = {
    0x1000: "generic error",
    0x2000: "current",
    0x3000: "voltage",
    0x4000: "temperature",
    0x5000: "device hardware",
    0x6000: "device software",
    0x7000: "additional modules",
    0x8000: "monitoring",
    0x9000: "external error",
    0xF000: "additional functions",
}


def error_text(code: int) -> str:
    """Return an error code in words: ``8611h following error``; an unknown one by its class."""
    text = ERROR_TEXTS.get(code) or _ERROR_CLASSES.get(code & 0xF000, "the manufacturer's own")
    return f"{code:04X}h {text}"


_EMERGENCY_CODE = struct.Struct("<H")  # then the error register and 5 bytes of the manufacturer; some drives send less


def emergency_code(data: bytes) -> int | None:
    """Return the error code of an emergency message, None for a message too short to have one."""
    return _EMERGENCY_CODE.unpack_from(data)[0] if len(data) >= _EMERGENCY_CODE.size else None


def emergency_text(data: bytes) -> str:
    """Return an emergency message in words: error code, error register, the manufacturer's bytes if there are any."""
    code = emergency_code(data)
    if code is None:
        return f"emergency without an error code: {len(data)} bytes {data.hex(' ')}".rstrip()
    text = f"emergency {error_text(code)}" if code else "emergency 0000h: the drive reports no error any more"
    if len(data) > _EMERGENCY_CODE.size:
        text += f", error register {data[2]:02X}h"
    return f"{text}, {data[3:].hex(' ')}" if any(data[3:]) else text
