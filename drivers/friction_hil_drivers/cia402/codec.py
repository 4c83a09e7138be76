"""The cyclic image of a drive as bytes and as values. Pure: no bus, no clock, no state from cycle to cycle."""

import struct
from collections.abc import Callable, Mapping, Sequence
from operator import itemgetter
from typing import Any, NamedTuple, Protocol

from friction_hil.drive import Command, DriveState, Mode
from friction_hil.drive.encoder import derived_velocity
from friction_hil_drivers.cia402 import objects
from friction_hil_drivers.cia402.objects import Object
from friction_hil_drivers.cia402.profile import STATE_MASK, STATES
from friction_hil_drivers.cia402.units import COUNTER_BITS, PER_MILLE, DriveUnits

_HALF, _MASK = 1 << (COUNTER_BITS - 1), (1 << COUNTER_BITS) - 1
_make = tuple.__new__  # what the constructor of a named tuple calls
_COMMANDED = 3  # values of a command: controlword, target, torque or velocity offset

FEEDBACK = (
    (objects.STATUSWORD, objects.POSITION_ACTUAL, objects.TORQUE_ACTUAL),
    (objects.VELOCITY_ACTUAL, objects.MODE_DISPLAY),
)
_MEASURED = {entry for block in FEEDBACK for entry in block}
COMMANDS = {  # the target of the mode comes second
    Mode.CSP: (objects.CONTROLWORD, objects.TARGET_POSITION, objects.TORQUE_OFFSET),
    Mode.CSV: (objects.CONTROLWORD, objects.TARGET_VELOCITY, objects.TORQUE_OFFSET),
    Mode.CST: (objects.CONTROLWORD, objects.TARGET_TORQUE),
}


def command_entries(mode: Mode, *, is_by_velocity: bool) -> list[Object]:
    """Return the objects of a command; ``is_by_velocity``: with the velocity offset in place of the torque offset."""
    offset = objects.VELOCITY_OFFSET if is_by_velocity else objects.TORQUE_OFFSET
    return [offset if entry is objects.TORQUE_OFFSET else entry for entry in COMMANDS[mode]]


_FORMATS = {8: "b", 16: "h", 32: "i", 64: "q"}  # of `struct`, for signed integers by their width


class Block(Protocol):
    """Objects in bytes that are exchanged in each cycle: a PDO on CAN, a part of the process image on EtherCAT."""

    @property
    def entries(self) -> tuple[Object, ...]:
        """Objects in the order of their bytes; of feedback those that are used, and the layout skips the others."""

    @property
    def layout(self) -> struct.Struct:
        """Layout of the bytes, with the widths that the drive itself gives its objects."""

    @property
    def carried(self) -> Mapping[Object, bytes]:
        """Constant content of those entries of a command that are not commanded."""


def place(blocks: Sequence[Block], entry: Object) -> tuple[int, int]:
    """Return the number of the block that carries an object, and the object's place in it."""
    ((number, position),) = [
        (n, k) for n, block in enumerate(blocks) for k, each in enumerate(block.entries) if each == entry
    ]
    return number, position


def field_format(entry: Object, bits: int) -> str:
    """Return the format character of `struct` for an object of ``bits`` bits."""
    return _FORMATS[bits] if entry.type.is_signed else _FORMATS[bits].upper()


def block_layout(entries: Sequence[Object], widths: Sequence[int]) -> struct.Struct:
    """Return the layout of a block that carries ``entries``, with their widths in bits on this drive."""
    return struct.Struct("<" + "".join(field_format(entry, bits) for entry, bits in zip(entries, widths, strict=True)))


class Measurement(NamedTuple):
    """Feedback of one complete cycle, SI."""

    state: DriveState = DriveState.UNKNOWN
    counts: int | None = None  # position counter without its wraps; None before the first complete cycle
    position: float = 0.0  # rad (m), and so on
    velocity: float = 0.0
    torque: float = 0.0
    mode: int = 0  # that the drive reports (6061h); the one that was set where it reports none
    statusword: int = 0  # 6041h


class FeedbackDecoder:
    """Decoder of the feedback of one drive, whatever its blocks carry and in whatever order.

    ``blocks``: statusword and position are among their entries. A velocity that is not is derived from the position; a
    torque that is not is reported as 0; a mode that is not is taken to be the one that was set. ``mode``: mode of
    operation that was set. ``period_s``: period of the cycle, s.
    """

    __slots__ = (
        "_counts_per_unit",
        "_has_velocity",
        "_period_s",
        "_pick",
        "_rated_torque",
        "_size",
        "_unpack",
        "_unpack_all",
        "_velocity_per_unit",
        "_without",
    )

    def __init__(self, blocks: Sequence[Block], units: DriveUnits, mode: Mode, period_s: float) -> None:
        self._unpack = [block.layout.unpack_from for block in blocks]
        together = struct.Struct("<" + "".join(block.layout.format.removeprefix("<") for block in blocks))
        self._unpack_all, self._size = together.unpack, together.size
        self._counts_per_unit, self._velocity_per_unit = units.counts_per_unit, units.velocity_per_unit
        self._rated_torque = units.rated_torque
        self._period_s = period_s
        slots: dict[Object, int] = {}
        # objects that no block carries are read from before the values of the blocks
        carried = {entry for block in blocks for entry in block.entries}
        self._without = () if carried.issuperset(_MEASURED) else (0, int(mode))
        for slot, entry in enumerate((entry for block in blocks for entry in block.entries), len(self._without)):
            slots.setdefault(entry, slot)
        self._has_velocity = objects.VELOCITY_ACTUAL in slots
        self._pick = itemgetter(
            slots[objects.STATUSWORD],
            slots[objects.POSITION_ACTUAL],
            slots.get(objects.VELOCITY_ACTUAL, 0),
            slots.get(objects.TORQUE_ACTUAL, 0),
            slots.get(objects.MODE_DISPLAY, 1),
        )

    def decode(self, frames: Sequence[bytes], before: Measurement, elapsed_s: float = 0.0) -> Measurement:
        """Decode the feedback of one cycle.

        ``frames``: data of each block; what is longer than its mapping is ignored. ``before``: the one before; the
        position follows its counter, given that it moved by less than 2^31 since. ``elapsed_s``: time since then, s.
        """
        data = b"".join(frames)
        values = self._unpack_all(data) if len(data) == self._size else self._unpack_longer(frames)
        if self._without:
            values = self._without + values
        statusword, raw, increments, torque, mode = self._pick(values)
        counts = before.counts
        if counts is None or -_HALF <= raw - counts < _HALF:
            counts = raw
        else:  # as `friction_hil.drive.encoder.unwrap`, without the call
            counts += ((raw - counts + _HALF) & _MASK) - _HALF
        position = counts / self._counts_per_unit
        velocity = 0.0
        if self._has_velocity:
            velocity = increments / self._velocity_per_unit
        elif before.counts is not None:
            velocity = derived_velocity(position - before.position, elapsed_s, before.velocity, self._period_s)
        state = STATES[statusword & STATE_MASK]  # as `profile.drive_state`, without the call
        si_torque = torque * self._rated_torque / PER_MILLE
        return _make(Measurement, (state, counts, position, velocity, si_torque, mode, statusword))

    def _unpack_longer(self, frames: Sequence[bytes]) -> tuple[int, ...]:
        """Return the values of blocks some of which are longer than their mapping."""
        return tuple(value for unpack, data in zip(self._unpack, frames, strict=True) for value in unpack(data))


class CommandEncoder:
    """Encoder of the commands to one drive, whatever its blocks carry and in whatever order.

    ``blocks``: by where they go: the identifier of a frame, or an offset in the process image. Controlword and the
    target of the mode are among their entries. A torque offset that is not is not sent. A velocity offset that they do
    not merely carry is sent in its place.
    """

    __slots__ = ("_address", "_blocks", "_carried", "_is_by_velocity", "_is_csp", "_is_csv", "_pack", "_units")

    def __init__(self, blocks: Mapping[int, Block], mode: Mode, units: DriveUnits) -> None:
        self._is_csp, self._is_csv = mode is Mode.CSP, mode is Mode.CSV
        self._units = units
        offset = objects.VELOCITY_OFFSET
        self._is_by_velocity = any(offset in block.entries and offset not in block.carried for block in blocks.values())
        slots = {entry: slot for slot, entry in enumerate(command_entries(mode, is_by_velocity=self._is_by_velocity))}
        # the values of each block are picked out of the commanded ones and, behind them, the constant ones of all
        constants: list[bytes] = []
        self._blocks = []
        # the usual mapping: one block with the commanded values in their order
        self._address, self._pack = 0, None
        for address, block in blocks.items():
            picked = []
            for entry in block.entries:
                if entry in slots:
                    picked.append(slots[entry])
                else:
                    picked.append(_COMMANDED + len(constants))
                    constants.append(block.carried[entry])
            self._blocks.append((address, block.layout.pack, _picker(picked)))
            if len(blocks) == 1 and picked == list(range(_COMMANDED)):
                self._address, self._pack = address, block.layout.pack
        self._carried = tuple(constants)

    def encode(self, controlword: int, command: Command) -> list[tuple[int, bytes]]:
        """Return the bytes of each block of a command with where they go; a `ValueError`: one is not finite."""
        units = self._units
        torque = units.torque_per_mille(command.torque)
        if self._is_csp:
            target = units.position_counts(command.position)
        elif self._is_csv:
            target = units.velocity_increments(command.velocity)
        else:
            target = torque
        if self._pack is not None:
            return [(self._address, self._pack(controlword, target, torque))]
        offset = units.velocity_increments(command.velocity_offset) if self._is_by_velocity else torque
        values = (controlword, target, offset, *self._carried)
        return [(address, pack(*pick(values))) for address, pack, pick in self._blocks]


def _picker(slots: Sequence[int]) -> Callable[[Sequence[Any]], Sequence[Any]]:
    """Return a function that picks the values at ``slots``."""
    return itemgetter(*slots) if len(slots) > 1 else itemgetter(slice(slots[0], slots[0] + 1))
