"""Columns of a recording: name, unit and meaning of each.

The meanings are part of the schema in every MCAP file that the daemon writes.
"""

import math
import struct
import zlib
from dataclasses import dataclass
from typing import Literal

AxisKind = Literal["rotary", "linear"]

_LINEAR = {"rad": "m", "rad/s": "m/s", "rad/s^2": "m/s^2", "N m": "N"}


@dataclass(frozen=True, slots=True)
class ColumnMeaning:
    """A column that friction_hil writes; a recording may have others."""

    name: str
    unit: str  # of a rotary axis; `unit` gives that of a linear one
    meaning: str
    is_sparse: bool = False  # NaN in single rows is not reported: the value does not exist at all times


COLUMNS = (
    ColumnMeaning("time_s", "s", "time since the first cycle"),
    ColumnMeaning("cycle", "", "number of the period, from 0; a gap is a missed period or a lost row"),
    ColumnMeaning("position", "rad", "measured position"),
    ColumnMeaning("velocity", "rad/s", "measured velocity, as the drive reports it"),
    ColumnMeaning(
        "load_position",
        "rad",
        "position by the encoder at the load, equal to position where the motion begins",
        is_sparse=True,
    ),
    ColumnMeaning("torque", "N m", "actual torque, as the drive reports it"),
    ColumnMeaning("position_demand", "rad", "position that the motion asks for now", is_sparse=True),
    ColumnMeaning("velocity_demand", "rad/s", "velocity that the motion asks for now", is_sparse=True),
    ColumnMeaning(
        "velocity_demand_ahead", "rad/s", "velocity demand at the time when this cycle's torque acts", is_sparse=True
    ),
    ColumnMeaning(
        "acceleration_demand_ahead",
        "rad/s^2",
        "acceleration demand at the time when this cycle's torque acts",
        is_sparse=True,
    ),
    ColumnMeaning("torque_demand", "N m", "torque that the drive's loops ask for", is_sparse=True),
    ColumnMeaning("load_torque", "N m", "torque that the load puts on the axis"),
    ColumnMeaning("temperature", "°C", "measured temperature of the axis", is_sparse=True),
    ColumnMeaning("velocity_estimate", "rad/s", "velocity that the friction model was given"),
    ColumnMeaning("load_estimate", "N m", "load torque that the friction model was given", is_sparse=True),
    ColumnMeaning("temperature_estimate", "°C", "temperature that the friction model was given", is_sparse=True),
    ColumnMeaning(
        "motor_offset",
        "rad",
        "what is added to position_demand for the motor, across backlash and twist",
        is_sparse=True,
    ),
    ColumnMeaning(
        "velocity_offset",
        "rad/s",
        "velocity offset that gives compensation by the drive's velocity loop, where it takes no torque",
        is_sparse=True,
    ),
    ColumnMeaning("compensation", "N m", "friction feed-forward alone"),
    ColumnMeaning(
        "compensation_uncertainty",
        "N m",
        "standard deviation of compensation by the errors of the model's parameters, of steady motion at "
        "velocity_estimate",
        is_sparse=True,
    ),
    ColumnMeaning(
        "feedforward",
        "N m",
        "gravity, offset and dynamics of an arm that are fed forward beside compensation while the drive has power",
        is_sparse=True,
    ),
    ColumnMeaning("command", "N m", "torque written to the drive: offset in csp and csv, the whole in cst"),
    ColumnMeaning("state", "", "state of the loop (LoopState)"),
    ColumnMeaning("drive_state", "", "state of the drive (DriveState)"),
    ColumnMeaning("is_fresh", "", "1 where the feedback of this cycle arrived in time, else 0"),
    ColumnMeaning("is_enabled", "", "1 where the compensation fades in or is in force, 0 where it fades out"),
    ColumnMeaning(
        "checksum", "", "CRC-32 of the compensator's inputs in this row, by which replay knows an altered one"
    ),
    ColumnMeaning("late_us", "us", "how late the cycle began"),
    ColumnMeaning("exchange_us", "us", "duration of the exchange with the drives"),
    ColumnMeaning(
        "path_lag_s", "s", "time by which missed periods have put the motion behind; it catches up", is_sparse=True
    ),
    ColumnMeaning("change", "", "number of the last change of the settings while the daemon runs; 0 before the first"),
)

NAMES = tuple(column.name for column in COLUMNS)
SPARSE = frozenset(column.name for column in COLUMNS if column.is_sparse)
TIME, CYCLE = NAMES[:2]
CHANGE = NAMES[-1]
UNCERTAINTY = "compensation_uncertainty"
SHADOW_PREFIX = "shadow_"

_NO_LOAD = struct.pack("<d", math.nan)
_BY_NAME = {column.name: column for column in COLUMNS}


def input_checksum(*inputs: float) -> float:
    """Return the checksum of one cycle's inputs of the compensator, in their order; a load that is NaN is no part."""
    return float(zlib.crc32(struct.pack(f"<{len(inputs)}d", *inputs).removesuffix(_NO_LOAD)))


def shadow(model: str) -> str:
    """Return the column of the shadow model called ``model``."""
    return SHADOW_PREFIX + model


def meaning(name: str) -> str:
    """Return the meaning of a column in words; empty for a column of another program."""
    if name in _BY_NAME:
        return _BY_NAME[name].meaning
    if name.startswith(SHADOW_PREFIX):
        return f"friction torque of the shadow model {name.removeprefix(SHADOW_PREFIX)}"
    return ""


def unit(name: str, kind: AxisKind = "rotary") -> str:
    """Return the unit of a column on a rotary or linear axis; empty if it has none or it is unknown."""
    rotary = _BY_NAME[name].unit if name in _BY_NAME else "N m" if name.startswith(SHADOW_PREFIX) else ""
    return _LINEAR.get(rotary, rotary) if kind == "linear" else rotary
