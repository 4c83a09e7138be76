"""Recordings from logs of raw CAN frames, decoded with the PDOs of each axis (`log_mapping`)."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from friction_hil.drive import Mode
from friction_hil.errors import DriveError, RecordingError
from friction_hil.recordings import Recording
from friction_hil.recordings.contradictions import contradictions
from friction_hil_drivers.canopen.commands.log_mapping import OWN, LoggedPdo, LogMapping, mappings
from friction_hil_drivers.canopen.connect.eds import EdsObjects, load_eds
from friction_hil_drivers.canopen.options import CanopenOptions, canopen_options
from friction_hil_drivers.canopen.sdo.dialogue import UPLOAD, answered, expedited
from friction_hil_drivers.canopen.wire import cia301
from friction_hil_drivers.canopen.wire.frame_log import FrameLog
from friction_hil_drivers.cia402 import objects, profile
from friction_hil_drivers.cia402.access import ObjectReader
from friction_hil_drivers.cia402.objects import Address, Object
from friction_hil_drivers.cia402.scales import read_units
from friction_hil_drivers.cia402.units import COUNTER_BITS, PER_MILLE, DriveUnits

if TYPE_CHECKING:
    from friction_hil.config import AxisConfig

Array = NDArray[np.float64]

_HALF = 1 << 16  # counts: whose low bytes stand where the high ones are expected moves by so many


class LoggedObjects(ObjectReader):
    """Objects of a drive as it reported them while the daemon connected; widths of others as in its EDS."""

    def __init__(self, log: FrameLog, axis: str, options: CanopenOptions, path: Path) -> None:
        self.axis = axis
        self.where = f"node {options.node} in {path}"
        self._number = options.axis_number
        self.eds: EdsObjects | None = None  # None if the configuration names none
        if options.eds is not None:
            self.eds = EdsObjects(load_eds(options.eds, options.node), options.axis_number)
        self._answers: dict[Address, bytes] = {}
        for row in log.rows_of(cia301.SDO_RESPONSE_BASE + options.node):
            answer = log.data[row].tobytes()
            address, content = answered(answer), expedited(answer, UPLOAD)
            if address is not None and content is not None:
                self._answers[address] = content

    def bytes_of(self, entry: Object) -> bytes | None:
        """Return the content of an object that is in the log, None for others."""
        return self._answers.get(entry.of_axis(self._number).address)

    def width(self, entry: Object) -> int:
        """Return the width of an object in bits: from the log, else from the EDS, else from the standard."""
        of_eds = None if self.eds is None else self.eds.width(entry)
        return super().width(entry) or of_eds or entry.type.bits


def read_bus_log(path: Path, axes: "Mapping[str, AxisConfig]") -> list[Recording]:
    """Decode the PDOs of some axes.

    A row is a cycle: a SYNC and the frames up to the next one; where the log has no SYNC, a cycle begins with
    each first TPDO. What did not come in a cycle is NaN in its row. Scales are those of the configuration, else
    those that the drive reported while the daemon connected, if the log has that; widths likewise, or of the EDS,
    or of the standard. There is a recording for each axis of which there are frames; its ``problems`` list what could
    not be read.

    Raises `RecordingError`: there is no frame of any axis, or a drive's scales are not known. `OSError`: the log cannot
    be opened.
    """
    log = FrameLog(path)
    found = {name: _mapping_of(log, name, axis, path) for name, axis in axes.items()}
    recordings = [
        _read_axis(log, name, axes[name], path, access, mapping)
        for name, (access, mapping) in found.items()
        if mapping is not None
    ]
    if not recordings:
        wanted = ", ".join(f"{_wanted(axis)} ({name})" for name, axis in axes.items())
        reasons = "".join(f"; {problem}" for problem in log.problems)
        raise RecordingError(
            f"{path}: no frame of an axis is in it. Wanted: {wanted}; there are: {_identifiers(log)}{reasons}"
        )
    missing = [name for name in axes if name not in {recording.axis for recording in recordings}]
    for recording in recordings:
        recording.problems += [f"there are no frames of axis {name}: {_wanted(axes[name])}" for name in missing]
    return recordings


def _wanted(axis: "AxisConfig") -> str:
    """Return the identifiers of which one shows that an axis is in the log, in words."""
    options = canopen_options(axis)
    if options.sidecar is not None:
        return ", ".join(f"{pdo.cob_id:03X}h" for pdo in options.sidecar.tpdos)
    if options.axis_number:
        return "identifiers and mapping that the daemon writes for a further axis of a node, which are not in the log"
    return f"{cia301.TPDO_BASES[0] + options.node:03X}h"


def _identifiers(log: FrameLog) -> str:
    return ", ".join(f"{identifier:03X}h" for identifier in sorted(log.rows)) or "none"


def _mapping_of(log: FrameLog, name: str, axis: "AxisConfig", path: Path) -> "tuple[LoggedObjects, LogMapping | None]":
    """Return the objects of an axis, and the mapping that its frames do not contradict; None if it has no frames."""
    options = canopen_options(axis)
    access = LoggedObjects(log, name, options, path)
    reasons = []
    for mapping in mappings(log, options, Mode[axis.mode.upper()], access, access.eds):
        if not any(pdo.frames(log).size for pdo in mapping.feedback):
            continue
        reason = mapping.contradiction(log)
        if not reason:
            return access, mapping
        reasons.append(f"{reason} (the mapping {mapping.origin})")
    if not reasons:
        return access, None
    node = options.node
    there = ", ".join(
        f"{base + node:03X}h ({'/'.join(map(str, np.unique(log.lengths[rows])))} bytes)"
        for base in cia301.TPDO_BASES
        if (rows := log.rows_of(base + node)).size
    )
    raise RecordingError(
        f"{path}: {name}: {'; '.join(reasons)}. Of node {node} there are {there or 'no default PDOs'}: state what they "
        f"carry under axes.{name}.sidecar.tpdos with bus.role: sidecar, or name the drive's EDS under axes.{name}.eds"
    )


def _read_axis(
    log: FrameLog, name: str, axis: "AxisConfig", path: Path, access: LoggedObjects, mapping: LogMapping
) -> Recording:
    options = canopen_options(axis)
    try:
        units = read_units(access, options, axis.model.axis)
    except DriveError as error:
        raise RecordingError(str(error)) from None
    mode = Mode[axis.mode.upper()]
    recording = Recording(str(path), name, {}, problems=list(log.problems))
    if mapping.origin != OWN:
        recording.problems.append(f"the PDOs are decoded by the mapping {mapping.origin}")
    mapping = mapping.without_other_commands(log, recording.problems)
    base = _base(log, mapping)
    syncs = log.rows_of(cia301.SYNC_ID)
    starts = np.sort(syncs) if syncs.size else np.sort(base.frames(log))
    values: dict[Object, Array] = {}
    arrived: dict[str, NDArray[np.bool_]] = {}
    for pdo in (base, *(each for each in mapping.pdos if each is not base)):
        decoded, arrived[pdo.name] = _decode_pdo(log, pdo, starts, recording.problems)
        values = decoded | values  # the base's own, where several carry an object
    cycles = np.flatnonzero(arrived[base.name])
    if not cycles.size:
        raise RecordingError(f"{path}: {name}: no frame of {base.name} ({base.cob_id:03X}h) belongs to a cycle")
    time = log.times[starts[cycles]]
    recording.columns = {"time_s": time - time[0]}
    if syncs.size:
        recording.columns["cycle"] = cycles.astype(np.float64)
    for column, (entry, scale) in _columns(units, mode).items():
        if entry in values and column not in recording.columns:
            raw = values[entry][cycles]
            recording.columns[column] = (_unwrapped(raw) if "position" in column else raw) * scale
    if objects.STATUSWORD in values:
        recording.columns["drive_state"] = _drive_states(_held(values[objects.STATUSWORD])[cycles])
    if mapping.is_assumed and (against := [*contradictions(recording), *_too_fast(recording, units.counts_per_unit)]):
        raise RecordingError(
            f"{path}: {name}: decoded by the mapping {mapping.origin}, which the log does not state, {against[0]}: "
            f"state what the PDOs carry under axes.{name}.sidecar.tpdos with bus.role: sidecar, or name the drive's EDS"
        )
    return recording


def _too_fast(recording: Recording, counts_per_unit: float) -> list[str]:
    """Return that the position moves by more than half of its bytes hold in a cycle, where no velocity confirms it."""
    if "velocity" in recording or "position" not in recording or len(recording) < 2:
        return []
    steps = np.abs(np.diff(recording.columns["position"])) * counts_per_unit
    step = float(np.median(steps[np.isfinite(steps)])) if np.isfinite(steps).any() else 0.0
    return [f"the position moves by {step:.4g} counts in a cycle"] if step >= _HALF else []


def _base(log: FrameLog, mapping: LogMapping) -> LoggedPdo:
    """Return the PDO whose frames make a row: that of the position, if there is one."""
    there = [pdo for pdo in mapping.feedback if pdo.frames(log).size]
    for wanted in (objects.POSITION_ACTUAL, objects.VELOCITY_ACTUAL, objects.STATUSWORD):
        for pdo in there:
            if any(entry == wanted for entry, _ in pdo.entries):
                return pdo
    return there[0]


def _decode_pdo(
    log: FrameLog, pdo: LoggedPdo, starts: NDArray[np.intp], problems: list[str]
) -> tuple[dict[Object, Array], NDArray[np.bool_]]:
    """Return the raw values of each object of a PDO, one for each cycle that begins at ``starts``; NaN for none.

    Also in which cycles it came.
    """
    rows = pdo.frames(log)
    fits = log.lengths[rows] == pdo.size
    if not fits.all():
        few = bool((log.lengths[rows[~fits]] < pdo.size).all())
        what = "have fewer bytes than its objects" if few else "have another number of bytes than its objects"
        problems.append(
            f"{np.sum(~fits)} of {len(rows)} frames of {pdo.name} {what}, {pdo.size}: "
            f"left out (the first at {log.since_start_s(rows[~fits][0]):.6f} s)"
        )
        rows = rows[fits]
    cycles = np.searchsorted(starts, rows, "right") - 1
    _, firsts = np.unique(cycles, return_index=True)  # a second frame in a cycle came too late for the cycle before
    rows, cycles = rows[firsts], cycles[firsts]
    rows, cycles = rows[cycles >= 0], cycles[cycles >= 0]
    values: dict[Object, Array] = {}
    for entry, raw in pdo.values(log, rows).items():
        values[entry] = np.full(len(starts), np.nan)
        values[entry][cycles] = raw
    arrived = np.zeros(len(starts), np.bool_)
    arrived[cycles] = True
    return values, arrived


def _held(values: Array) -> Array:
    """Return the last known value for each cycle: of a drive that sends its statusword only when it changes."""
    known = np.flatnonzero(np.isfinite(values))
    if not known.size:
        return values
    return values[known[np.maximum(np.searchsorted(known, np.arange(len(values)), "right") - 1, 0)]]


def _columns(units: DriveUnits, mode: Mode) -> dict[str, tuple[Object, float]]:
    """Return the columns of a recording, each with its object and its scale."""
    torque = units.rated_torque / PER_MILLE
    columns = {
        "position": (objects.POSITION_ACTUAL, 1.0 / units.counts_per_unit),
        "velocity": (objects.VELOCITY_ACTUAL, 1.0 / units.velocity_per_unit),
        "torque": (objects.TORQUE_ACTUAL, torque),
        "command": (objects.TARGET_TORQUE if mode is Mode.CST else objects.TORQUE_OFFSET, units.command_sign * torque),
    }
    if mode is Mode.CSP:
        columns["position_demand"] = objects.TARGET_POSITION, 1.0 / units.counts_per_unit
    if mode is Mode.CSV:
        columns["velocity_demand"] = objects.TARGET_VELOCITY, 1.0 / units.velocity_per_unit
    columns["torque_demand"] = objects.TORQUE_DEMAND, torque
    return columns


def _unwrapped(counts: Array) -> Array:
    """Return counts without the wraps of the 32-bit counter; NaN stays NaN."""
    known = np.isfinite(counts)
    unwrapped = counts.copy()
    unwrapped[known] = np.unwrap(counts[known], period=1 << COUNTER_BITS)
    return unwrapped


def _drive_states(statuswords: Array) -> Array:
    """Return the drive's state in each row."""
    words, which = np.unique(statuswords, return_inverse=True)
    states = [profile.drive_state(int(word)) for word in words]
    return np.array(states, dtype=np.float64)[which]
