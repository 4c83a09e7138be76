"""PDOs, emergencies and heartbeats as bytes and as values. Pure: no bus, no clock, no state from cycle to cycle."""

import struct
from collections.abc import Callable, Sequence
from operator import itemgetter
from typing import Any, NamedTuple

from friction_hil.drive import Command, DriveState, Mode, Request
from friction_hil.drive.encoder import derived_velocity
from friction_hil_drivers.canopen.cia301 import Frame
from friction_hil_drivers.canopen.mapping import TARGETS, MappedPdo
from friction_hil_drivers.canopen.units import COUNTER_BITS, PER_MILLE, CanopenUnits
from friction_hil_drivers.cia402 import objects, profile
from friction_hil_drivers.cia402.objects import Object
from friction_hil_drivers.cia402.profile import drive_state

_HALF, _MASK = 1 << (COUNTER_BITS - 1), (1 << COUNTER_BITS) - 1
_make = tuple.__new__  # what the constructor of a named tuple calls
_COMMANDED = 3  # values of a command: controlword, target, torque

_EMERGENCY_CODE = struct.Struct("<H")  # then the error register and 5 bytes of the manufacturer; some drives send less
_NMT_STATE = 0x7F  # bits of a heartbeat's byte; the upper one is the toggle bit of node guarding


class Measurement(NamedTuple):
    """Feedback of one complete cycle, SI.

    Attributes
    ----------
    state : DriveState
    counts : int or None
        Position counter without its wraps; None before the first complete cycle.
    position, velocity, torque : float
        rad, rad/s, N m (m, m/s, N on a linear axis).
    mode : int
        Mode of operation that the drive reports (6061h); the one that was set where it reports none.
    statusword : int
        6041h.
    """

    state: DriveState = DriveState.UNKNOWN
    counts: int | None = None
    position: float = 0.0
    velocity: float = 0.0
    torque: float = 0.0
    mode: int = 0
    statusword: int = 0


class FeedbackDecoder:
    """Decoder of the TPDOs of one drive, whatever they carry and in whatever order.

    Parameters
    ----------
    tpdos : sequence of MappedPdo
        Statusword and position are among their entries. A velocity that is not is derived from the position; a torque
        that is not is reported as 0; a mode that is not is taken to be the one that was set.
    units : CanopenUnits
    mode : Mode
        Mode of operation that was set.
    period_s : float
        Period of the cycle, s.
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

    def __init__(self, tpdos: Sequence[MappedPdo], units: CanopenUnits, mode: Mode, period_s: float) -> None:
        self._unpack = [pdo.layout.unpack_from for pdo in tpdos]
        together = struct.Struct("<" + "".join(pdo.layout.format.removeprefix("<") for pdo in tpdos))
        self._unpack_all, self._size = together.unpack, together.size
        self._counts_per_unit, self._velocity_per_unit = units.counts_per_unit, units.velocity_per_unit
        self._rated_torque = units.rated_torque
        self._period_s = period_s
        slots: dict[Object, int] = {}
        # objects that no TPDO carries are read from before the values of the frames
        self._without = (0, int(mode))
        for slot, entry in enumerate((entry for pdo in tpdos for entry in pdo.entries), len(self._without)):
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
        """Decode the TPDOs of one cycle.

        Parameters
        ----------
        frames : sequence of bytes
            Data of each TPDO; what is longer than its mapping is ignored.
        before : Measurement
            The one before; the position follows its counter, given that it moved by less than 2^31 since.
        elapsed_s : float
            Time since then, s.
        """
        data = b"".join(frames)
        values = self._unpack_all(data) if len(data) == self._size else self._unpack_longer(frames)
        statusword, raw, increments, torque, mode = self._pick(self._without + values)
        counts = before.counts
        # as `friction_hil.drive.encoder.unwrap`, without the call
        counts = raw if counts is None else counts + ((raw - counts + _HALF) & _MASK) - _HALF
        position = counts / self._counts_per_unit
        velocity = 0.0
        if self._has_velocity:
            velocity = increments / self._velocity_per_unit
        elif before.counts is not None:
            velocity = derived_velocity(position - before.position, elapsed_s, before.velocity, self._period_s)
        state, si_torque = drive_state(statusword), torque * self._rated_torque / PER_MILLE
        return _make(Measurement, (state, counts, position, velocity, si_torque, mode, statusword))

    def _unpack_longer(self, frames: Sequence[bytes]) -> tuple[int, ...]:
        """Return the values of TPDOs some of which are longer than their mapping."""
        return tuple(value for unpack, data in zip(self._unpack, frames, strict=True) for value in unpack(data))


def next_controlword(state: DriveState, request: Request, before: int) -> int:
    """Return the controlword that takes a drive one transition towards ``request``.

    Parameters
    ----------
    state : DriveState
        State that the drive reported last.
    request : Request
    before : int
        Controlword of the cycle before: a fault is reset by a rising edge.
    """
    if request is Request.RESET_FAULT:
        return profile.reset_controlword(state, before)
    return profile.next_controlword(state, request)


class CommandEncoder:
    """Encoder of the RPDOs of one drive, whatever they carry and in whatever order.

    Parameters
    ----------
    rpdos : sequence of MappedPdo
        Controlword and the target of the mode are among their entries. A torque offset that is not is not sent.
    mode : Mode
    units : CanopenUnits
    """

    __slots__ = ("_carried", "_cob_id", "_is_csp", "_is_csv", "_pack", "_pdos", "_units")

    def __init__(self, rpdos: Sequence[MappedPdo], mode: Mode, units: CanopenUnits) -> None:
        self._is_csp, self._is_csv = mode is Mode.CSP, mode is Mode.CSV
        self._units = units
        slots = {objects.CONTROLWORD: 0, TARGETS[mode]: 1}
        if mode is not Mode.CST:
            slots[objects.TORQUE_OFFSET] = 2
        # the values of each PDO are picked out of the commanded ones and, behind them, the constant ones of all PDOs
        constants: list[bytes] = []
        self._pdos = []
        # the usual mapping: one RPDO with the commanded values in their order
        self._cob_id, self._pack = 0, None
        for pdo in rpdos:
            picked = []
            for entry in pdo.entries:
                if entry in slots:
                    picked.append(slots[entry])
                else:
                    picked.append(_COMMANDED + len(constants))
                    constants.append(pdo.carried[entry])
            self._pdos.append((pdo.cob_id, pdo.layout.pack, _picker(picked)))
            if len(rpdos) == 1 and picked == list(range(_COMMANDED)):
                self._cob_id, self._pack = pdo.cob_id, pdo.layout.pack
        self._carried = tuple(constants)

    def encode(self, controlword: int, command: Command) -> list[Frame]:
        """Return the frames of a command, in the order of the RPDOs.

        Raises
        ------
        ValueError
            A value is not finite.
        """
        units = self._units
        torque = units.torque_per_mille(command.torque)
        if self._is_csp:
            target = units.position_counts(command.position)
        elif self._is_csv:
            target = units.velocity_increments(command.velocity)
        else:
            target = torque
        if self._pack is not None:
            return [(self._cob_id, self._pack(controlword, target, torque))]
        values = (controlword, target, torque, *self._carried)
        return [(cob_id, pack(*pick(values))) for cob_id, pack, pick in self._pdos]


def _picker(slots: Sequence[int]) -> Callable[[Sequence[Any]], Sequence[Any]]:
    """Return a function that picks the values at ``slots``."""
    return itemgetter(*slots) if len(slots) > 1 else itemgetter(slice(slots[0], slots[0] + 1))


def emergency_code(data: bytes) -> int | None:
    """Return the error code of an emergency message, None for a message too short to have one."""
    return _EMERGENCY_CODE.unpack_from(data)[0] if len(data) >= _EMERGENCY_CODE.size else None


def emergency_text(data: bytes) -> str:
    """Return an emergency message in words: error code, error register, the manufacturer's bytes if there are any."""
    code = emergency_code(data)
    if code is None:
        return f"emergency without an error code: {len(data)} bytes {data.hex(' ')}".rstrip()
    text = f"emergency {profile.error_text(code)}" if code else "emergency 0000h: the drive reports no error any more"
    if len(data) > _EMERGENCY_CODE.size:
        text += f", error register {data[2]:02X}h"
    return f"{text}, {data[3:].hex(' ')}" if any(data[3:]) else text


def decode_heartbeat(data: bytes) -> int | None:
    """Return the NMT state in a heartbeat, None for an empty message."""
    return data[0] & _NMT_STATE if data else None
