"""Faults of the wire, of the drive on it, and of others who send."""

import struct
from collections.abc import Callable
from typing import Any

from tools.campaigns.attempt import Attempt
from tools.campaigns.can_wire import CONTROLWORD, SYNC, CanWire
from tools.campaigns.disturbance import DIRECTIONS, TO_DAEMON, TO_DRIVE, Disturbance
from tools.campaigns.machine import NODE, OFFSET_ID, SERIAL, SIDECAR, TARGET_ID
from tools.campaigns.serial_wire import CONTROL, SerialWire

# One of each class of CiA 301 and CiA 402: generic, current, voltage, temperature, hardware, software, additional
# modules, monitoring, external, additional functions, manufacturer
EMERGENCY_CODES = (0x1000, 0x2310, 0x3210, 0x4310, 0x5113, 0x6320, 0x7305, 0x8611, 0x9000, 0xF001, 0xFF01)
_CAN_BYTES = 8
_MODES = (0, 1, 3, 6, 8, 9, 10)
_MODE_NUMBERS = {"csp": 8, "csv": 9, "cst": 10}
_FOREIGN_IDS = (0x001, 0x0FF, 0x17F, 0x199, 0x2AA, 0x333, 0x455, 0x57F, 0x5AA, 0x6AA, 0x7E5, 0x7FF, 0x12345)
_BABBLE_IDS = (0x001, SYNC + NODE, 0x100, 0x19A, 0x7FF)
Events = list[dict[str, Any]]


def disturb(kind: str, share: float | None) -> Callable[[Attempt], None]:
    """Return what begins a disturbance of the wire; without a share, of a random one."""

    def begin(attempt: Attempt) -> None:
        rng = attempt.random
        directions = rng.choice(((TO_DRIVE,), (TO_DAEMON,), DIRECTIONS))
        taken = rng.choice((0.02, 0.2, 1.0)) if share is None else share
        delay_s = attempt.machine.period_s * (rng.uniform(0.3, 3.0) if kind == "late" else 1.2)
        most = None if attempt.machine.arena == SERIAL else _CAN_BYTES
        attempt.tell(f"{taken:.0%} {' and '.join(directions)}")
        attempt.wire.disturbances.append(Disturbance(kind, taken, delay_s, directions, rng, most))

    return begin


def cut(attempt: Attempt) -> None:
    """Let nothing pass."""
    attempt.wire.disturbances.append(Disturbance("lost", 1.0, 0.0, DIRECTIONS, attempt.random))


def undisturb(attempt: Attempt) -> None:
    """End all disturbances of the wire."""
    attempt.wire.disturbances.clear()


# Others who send


def foreign(attempt: Attempt) -> None:
    """Send frames of identifiers that nobody uses, or on a line bytes that are no telegram."""
    rng = attempt.random
    if not attempt.is_time(0.004):
        return
    data = rng.randbytes(rng.randrange(_CAN_BYTES + 1))
    if isinstance(attempt.wire, SerialWire):
        attempt.wire.noise(rng.choice(DIRECTIONS), data)
    else:
        attempt.wire.both(rng.choice(_FOREIGN_IDS), data)


def second_master(attempt: Attempt) -> None:
    """Send what another master would: SDO, NMT, controlwords and targets; on a line, requests."""
    rng, wire = attempt.random, attempt.wire
    kind = attempt.chosen(("sdo", "nmt", "rpdo", "heartbeat", "sync and rpdo"))
    if not attempt.is_time(attempt.machine.period_s):
        return
    if isinstance(wire, SerialWire):
        wire.write(CONTROL, rng.choice((0x00, 0x06, 0x0F)))
        return
    if kind == "sdo":
        index, value = rng.choice(((0x6040, 0), (0x6060, 1), (0x1017, 0), (0x6040, 0x0F)))
        wire.both(0x600 + NODE, struct.pack("<BHBI", 0x2B, index, 0, value))
    elif kind == "nmt":
        wire.both(0x000, bytes([rng.choice((0x01, 0x02, 0x80, 0x81, 0x82)), rng.choice((0, NODE))]))
    elif kind == "heartbeat":
        wire.both(0x700 + 127, b"\x05")
    else:
        if kind.startswith("sync"):
            wire.both(SYNC, b"")
        can_id = OFFSET_ID if attempt.machine.arena == SIDECAR else TARGET_ID
        size = 2 if attempt.machine.arena == SIDECAR else rng.choice((4, 8))
        word = struct.pack("<H", rng.choice((0x00, 0x06, 0x0F)))
        wire.both(can_id, word + bytes(size - 2))


def second_sync(attempt: Attempt) -> None:
    """Send a SYNC of another period."""
    wire = attempt.wire
    assert isinstance(wire, CanWire)
    if attempt.is_time(attempt.machine.period_s * attempt.chosen((0.5, 1.0, 1.7))):
        wire.both(SYNC, b"")


def babble(attempt: Attempt) -> None:
    """Send without end, a few frames at each look."""
    wire, rng = attempt.wire, attempt.random
    if not attempt.is_time(0.001):
        return
    can_id = attempt.chosen(_BABBLE_IDS)
    for _ in range(3):
        data = rng.randbytes(_CAN_BYTES)
        if isinstance(wire, SerialWire):
            wire.noise(TO_DAEMON, data)
        else:
            wire.both(can_id, data)


# The drive


def event(do: str, for_s: tuple[float, float] | None = None, **fields: Any) -> Callable[[Attempt], Events]:
    """Return what makes one event of the simulated drive at the moment of the fault."""

    def events(attempt: Attempt) -> Events:
        lasting = {} if for_s is None else {"for_s": round(attempt.random.uniform(*for_s), 3)}
        return [{"at_s": attempt.at_s, "do": do, **lasting, **fields}]

    return events


def emergency(attempt: Attempt) -> Events:
    """Report an error of the class that it is the turn of."""
    code = EMERGENCY_CODES[attempt.number % len(EMERGENCY_CODES)]
    attempt.tell(f"{code:04X}h")
    return [{"at_s": attempt.at_s, "do": "emergency", "code": code, "for_s": 0.2}]


def drive_fault(attempt: Attempt) -> Events:
    """Enter the fault of the class that it is the turn of."""
    code = EMERGENCY_CODES[attempt.number % len(EMERGENCY_CODES)]
    attempt.tell(f"{code:04X}h")
    return [{"at_s": attempt.at_s, "do": "fault", "code": code}]


def silence(attempt: Attempt) -> Events:
    """Be mute, deaf, or both."""
    do = attempt.chosen(("mute", "deaf", "unplug"))
    attempt.tell(do)
    return event(do, for_s=(0.5, 1.5))(attempt)


def jump_event(attempt: Attempt) -> Events:
    """Let the encoder jump by a tenth of a turn to many turns."""
    counts = int(attempt.random.choice((-1, 1)) * 10 ** attempt.random.uniform(5.0, 8.0))
    attempt.tell(f"{counts} counts")
    return [{"at_s": attempt.at_s, "do": "jump_encoder", "counts": counts}]


def freeze(attempt: Attempt) -> None:
    """Freeze the position on a serial line; on CAN the drive does it."""
    if isinstance(attempt.wire, SerialWire):
        attempt.wire.is_freezing = True


def thaw(attempt: Attempt) -> None:
    """End that."""
    if isinstance(attempt.wire, SerialWire):
        attempt.wire.is_freezing, attempt.wire.frozen = False, None


def jump(attempt: Attempt) -> None:
    """Let the position jump on a serial line; on CAN the drive does it."""
    if isinstance(attempt.wire, SerialWire):
        attempt.wire.jump = int(attempt.random.choice((-1, 1)) * 10 ** attempt.random.uniform(5.0, 8.0))


# Somebody else at the drive


def change_mode(attempt: Attempt) -> None:
    """Change the mode of operation, as a vendor's tool does by its own cable."""
    own = _MODE_NUMBERS[attempt.machine.mode]
    mode = attempt.random.choice([each for each in _MODES if each != own])
    attempt.tell(f"mode {mode}")
    assert isinstance(attempt.wire, CanWire)
    attempt.wire.write(NODE, 0x6060, mode, 1)


def change_state(attempt: Attempt) -> None:
    """Take the drive's power, as a vendor's tool does by its own cable."""
    word = attempt.random.choice((0x00, 0x06, 0x02))
    attempt.tell(f"controlword {word:02X}h")
    if isinstance(attempt.wire, SerialWire):
        attempt.wire.write(CONTROL, word)
    else:
        attempt.wire.write(NODE, CONTROLWORD, word, 2)
