"""PDOs, emergencies and heartbeats as bytes and as values. Pure functions: no bus, no clock, no state."""

import struct
from collections.abc import Sequence
from typing import NamedTuple

from friction_hil.drive import Command, DriveState, Mode, Request
from friction_hil.drive.encoder import unwrap
from friction_hil_drivers.canopen.mapping import MappedPdo
from friction_hil_drivers.canopen.units import COUNTER_BITS, CanopenUnits
from friction_hil_drivers.cia402 import profile

Frame = tuple[int, bytes]  # identifier and data

_EMERGENCY = struct.Struct("<HB")  # error code and error register; some drives send nothing after them
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
        Mode of operation that the drive reports (6061h).
    """

    state: DriveState = DriveState.UNKNOWN
    counts: int | None = None
    position: float = 0.0
    velocity: float = 0.0
    torque: float = 0.0
    mode: int = 0


def decode_feedback(
    tpdos: Sequence[MappedPdo], frames: Sequence[bytes], units: CanopenUnits, counts_before: int | None
) -> Measurement:
    """Decode the TPDOs of one cycle.

    Parameters
    ----------
    tpdos : sequence of MappedPdo
        As `mapping.FEEDBACK` maps them.
    frames : sequence of bytes
        Data of each TPDO; what is longer than its mapping is ignored.
    units : CanopenUnits
    counts_before : int or None
        `Measurement.counts` of the cycle before; the position follows the counter from there, given that it moved by
        less than 2^31.
    """
    statusword, raw, torque = tpdos[0].layout.unpack_from(frames[0])
    velocity, mode = tpdos[1].layout.unpack_from(frames[1])
    counts = raw if counts_before is None else unwrap(counts_before, raw, COUNTER_BITS)
    return Measurement(
        profile.drive_state(statusword),
        counts,
        counts / units.counts_per_unit,
        velocity / units.velocity_per_unit,
        units.torque(torque),
        mode,
    )


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


def encode_command(rpdo: MappedPdo, mode: Mode, units: CanopenUnits, controlword: int, command: Command) -> Frame:
    """Encode a command as `mapping.COMMANDS` maps it.

    Raises
    ------
    ValueError
        A value is not finite.
    """
    torque = units.torque_per_mille(command.torque)
    if mode is Mode.CSP:
        return rpdo.cob_id, rpdo.layout.pack(controlword, units.position_counts(command.position), torque)
    if mode is Mode.CSV:
        return rpdo.cob_id, rpdo.layout.pack(controlword, units.velocity_increments(command.velocity), torque)
    return rpdo.cob_id, rpdo.layout.pack(controlword, torque)


def decode_emergency(data: bytes) -> str | None:
    """Return the error of an emergency message in words, "" for "no error", None for a message too short."""
    if len(data) < _EMERGENCY.size:
        return None
    code = _EMERGENCY.unpack_from(data)[0]
    return profile.error_text(code) if code else ""


def decode_heartbeat(data: bytes) -> int | None:
    """Return the NMT state in a heartbeat, None for an empty message."""
    return data[0] & _NMT_STATE if data else None
