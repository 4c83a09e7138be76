"""Logs of raw CAN frames (candump .log, Vector .asc and .blf), decoded with the PDOs that the driver maps."""

import io
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from friction_hil.drive import DriveState, Mode
from friction_hil.errors import DriveError, RecordingError
from friction_hil.recordings import Recording
from friction_hil_drivers.canopen import objects
from friction_hil_drivers.canopen.configure import read_units
from friction_hil_drivers.canopen.eds import load_eds
from friction_hil_drivers.canopen.mapping import COMMANDS, FEEDBACK, pdo_layout
from friction_hil_drivers.canopen.objects import Object
from friction_hil_drivers.canopen.options import CanopenOptions
from friction_hil_drivers.canopen.sdo import ObjectAccess
from friction_hil_drivers.canopen.units import PER_MILLE, CanopenUnits
from friction_hil_drivers.cia402 import profile

if TYPE_CHECKING:
    import can

    from friction_hil.config import AxisConfig

Array = NDArray[np.float64]

_SYNC = 0x080
_EXPEDITED_UPLOAD = 0x43  # of 4 bytes; 4 is added for each byte that is not used
_COUNTER = 1 << 32
_NAMED = 5


class _Frames:
    """Data frames with 11-bit identifiers, in the order of the log."""

    def __init__(self, path: Path) -> None:
        times: list[float] = []
        identifiers: list[int] = []
        lengths: list[int] = []
        data: list[bytes] = []
        self.problems: list[str] = []
        for message in _messages(path, self.problems):
            if message.is_extended_id or message.is_remote_frame or message.is_error_frame or len(message.data) > 8:
                continue
            times.append(message.timestamp)
            identifiers.append(message.arbitration_id)
            lengths.append(len(message.data))
            data.append(bytes(message.data).ljust(8, b"\0"))
        self.times = np.array(times)
        self.identifiers = np.array(identifiers, dtype=np.int64)
        self.lengths = np.array(lengths, dtype=np.int64)
        self.data = np.frombuffer(b"".join(data), dtype=np.uint8).reshape(-1, 8)
        self.places: dict[int, NDArray[np.intp]] = {}
        order = np.argsort(self.identifiers, kind="stable")
        bounds = np.flatnonzero(np.diff(self.identifiers[order])) + 1
        for places in np.split(order, bounds) if order.size else ():
            self.places[int(self.identifiers[places[0]])] = places

    def of(self, identifier: int) -> NDArray[np.intp]:
        """Places of the frames with an identifier."""
        return self.places.get(identifier, np.empty(0, np.intp))


class _LoggedObjects(ObjectAccess):
    """What a drive said about its objects in the log, when the daemon connected; else what its EDS says."""

    def __init__(self, frames: _Frames, axis: str, options: CanopenOptions, path: Path) -> None:
        self.axis = axis
        self.where = f"node {options.node} in {path}"
        self._dictionary = None if options.eds is None else load_eds(options.eds, options.node)
        self._answers: dict[tuple[int, int], bytes] = {}
        for place in frames.of(objects.SDO_RESPONSE_BASE + options.node):
            answer = frames.data[place].tobytes()
            unused = (answer[0] - _EXPEDITED_UPLOAD) // 4
            if answer[0] & 0xF3 == _EXPEDITED_UPLOAD and 0 <= unused < 4:
                self._answers[int.from_bytes(answer[1:3], "little"), answer[3]] = answer[4 : 8 - unused]

    def bytes_of(self, entry: Object) -> bytes | None:
        return self._answers.get(entry.address)

    def width(self, entry: Object) -> int:
        answer = self._answers.get(entry.address)
        if answer is not None:
            return 8 * len(answer)
        if self._dictionary is not None:
            try:
                variable = self._dictionary.get_variable(entry.index, entry.subindex)
            except KeyError:
                variable = None
            if variable is not None:
                return len(variable)
        return entry.type.bits


def read_bus_log(path: Path, axes: "Mapping[str, AxisConfig]") -> list[Recording]:
    """Decode the PDOs of some axes.

    A row is a cycle: a SYNC and the frames up to the next one; where the log has no SYNC, a cycle begins with
    each first TPDO. What did not come in a cycle is NaN in its row. Scales are those of the configuration, else
    what the drive told while the daemon connected, if the log has that; widths likewise, or of the EDS, or of
    the standard.

    Parameters
    ----------
    path : path
        The log; its suffix says what python-can reads it as.
    axes : dict
        Configured axes of this driver.

    Returns
    -------
    list of Recording
        One an axis of which there are frames; what was not understood is in ``problems``.

    Raises
    ------
    RecordingError
        There is no frame of any axis, or a drive's scales are not known.
    OSError
        The log cannot be opened.
    """
    frames = _Frames(path)
    recordings = []
    wanted = []
    for name, axis in axes.items():
        options = axis.options
        assert isinstance(options, CanopenOptions)
        first = objects.TPDO_BASES[0] + options.node
        wanted.append(f"{first:03X}h ({name})")
        if not frames.of(first).size:
            continue
        access = _LoggedObjects(frames, name, options, path)
        try:
            units = read_units(access, options, axis.model.axis)
        except DriveError as error:
            raise RecordingError(str(error)) from None
        recordings.append(_decode(frames, access, units, Mode[axis.mode.upper()], options.node, path))
    if not recordings:
        found = ", ".join(f"{identifier:03X}h" for identifier in sorted(frames.places)) or "none"
        reasons = "".join(f"; {problem}" for problem in frames.problems)
        raise RecordingError(
            f"{path}: no frame of an axis is in it. Wanted: {', '.join(wanted)}; there are: {found}{reasons}"
        )
    missing = [name for name in axes if name not in {recording.axis for recording in recordings}]
    for recording in recordings:
        recording.problems += [f"there are no frames of axis {name}" for name in missing]
    return recordings


def _decode(
    frames: _Frames, access: _LoggedObjects, units: CanopenUnits, mode: Mode, node: int, path: Path
) -> Recording:
    recording = Recording(str(path), access.axis, {}, problems=list(frames.problems))
    syncs = frames.of(_SYNC)
    first = objects.TPDO_BASES[0] + node
    starts = np.sort(syncs) if syncs.size else np.sort(frames.of(first))
    taken: dict[Object, Array] = {}
    has_frame = np.zeros(len(starts), dtype=bool)
    pdos = [
        *((objects.TPDO_BASES[i] + node, f"TPDO {i + 1}", entries) for i, entries in enumerate(FEEDBACK)),
        (objects.RPDO_BASES[0] + node, "RPDO 1", COMMANDS[mode]),
    ]
    for identifier, name, entries in pdos:
        layout = pdo_layout(entries, [access.width(entry) for entry in entries])
        places = frames.of(identifier)
        fits = frames.lengths[places] >= layout.size
        if not fits.all():
            recording.problems.append(
                f"{np.sum(~fits)} of {len(places)} frames of {name} have fewer bytes than its objects, {layout.size}: "
                f"left out (the first at {_since(frames, places[~fits][0]):.6f} s)"
            )
            places = places[fits]
        cycles = np.searchsorted(starts, places, "right") - 1
        _, firsts = np.unique(cycles, return_index=True)  # a second one in a cycle is late for the one before
        places, cycles = places[firsts], cycles[firsts]
        places, cycles = places[cycles >= 0], cycles[cycles >= 0]
        has_frame[cycles] |= identifier == first
        at = 0
        for entry, code in zip(entries, layout.format[1:], strict=True):
            kind = np.dtype(f"<{code}")
            raw = frames.data[places, at : at + kind.itemsize].copy().view(kind).ravel()
            values = np.full(len(starts), np.nan)
            values[cycles] = raw
            taken[entry] = values
            at += kind.itemsize
    rows = np.flatnonzero(has_frame)
    time = frames.times[starts[rows]]
    recording.columns = {"time_s": time - time[0]}
    if syncs.size:
        recording.columns["cycle"] = rows.astype(np.float64)
    for column, (entry, scale) in _columns(units, mode).items():
        values = taken[entry][rows]
        recording.columns[column] = (_continuous(values) if "position" in column else values) * scale
    words = taken[objects.STATUSWORD][rows]
    kinds, which = np.unique(words, return_inverse=True)
    states = [profile.drive_state(int(word)) if word == word else DriveState.UNKNOWN for word in kinds]
    recording.columns["drive_state"] = np.array(states, dtype=np.float64)[which]
    return recording


def _columns(units: CanopenUnits, mode: Mode) -> dict[str, tuple[Object, float]]:
    """Our columns, the object that each comes from, and its scale."""
    torque = units.rated_torque / PER_MILLE
    columns = {
        "position": (objects.POSITION_ACTUAL, 1.0 / units.counts_per_unit),
        "velocity": (objects.VELOCITY_ACTUAL, 1.0 / units.velocity_per_unit),
        "torque": (objects.TORQUE_ACTUAL, torque),
        "command": (objects.TARGET_TORQUE if mode is Mode.CST else objects.TORQUE_OFFSET, torque),
    }
    if mode is Mode.CSP:
        columns["position_demand"] = objects.TARGET_POSITION, 1.0 / units.counts_per_unit
    if mode is Mode.CSV:
        columns["velocity_demand"] = objects.TARGET_VELOCITY, 1.0 / units.velocity_per_unit
    return columns


def _continuous(counts: Array) -> Array:
    """Counts without the wraps of a 32-bit counter; NaN stays NaN."""
    known = np.isfinite(counts)
    straight = counts.copy()
    straight[known] = np.unwrap(counts[known], period=_COUNTER)
    return straight


def _since(frames: _Frames, place: int) -> float:
    return float(frames.times[place] - frames.times[0])


def _messages(path: Path, problems: list[str]) -> Iterator["can.Message"]:
    """Every frame that can be read; where that ends too early, ``problems`` says so."""
    suffix = path.suffix.lower()
    if suffix == ".log":
        yield from _candump(path, problems)
        return
    import can

    count, last = 0, 0.0
    try:
        with path.open("rb") as file:
            reader = can.BLFReader(file) if suffix == ".blf" else can.ASCReader(_whole_asc(path, problems))
            for message in reader:
                count, last = count + 1, message.timestamp
                yield message
            claimed = getattr(reader, "file_size", 0)
            if claimed > path.stat().st_size:
                problems.append(
                    f"the file was cut off: it has {path.stat().st_size} of {claimed} bytes; "
                    f"what followed frame {count} (at {last:.6f} s) is lost"
                )
    except OSError:
        raise
    except Exception as error:  # noqa: BLE001 - the parsers raise whatever damaged bytes lead them to
        reason = " ".join(str(error).split()) or type(error).__name__
        problems.append(
            f"the file was cut off or is damaged behind frame {count} (at {last:.6f} s): "
            f"what followed is lost ({reason})"
        )


def _whole_asc(path: Path, problems: list[str]) -> io.StringIO:
    """Text of an .asc file up to its last whole line."""
    text = path.read_bytes().decode("utf-8", "replace")
    whole, newline, rest = text.rpartition("\n")
    lines = whole.count("\n") + 1
    if rest.strip("\0 \r"):
        problems.append(f"the file was cut off in line {lines + 1}: that line and what followed are lost")
    elif "begin triggerblock" in whole[:10_000].lower() and not whole.rstrip().lower().endswith("end triggerblock"):
        problems.append(f"the file was cut off behind line {lines}, before its end mark: what followed is lost")
    return io.StringIO(whole + newline)


def _candump(path: Path, problems: list[str]) -> Iterator["can.Message"]:
    """Frames of a log in the form of ``candump -l``; lines that are none are counted."""
    import can

    data = path.read_bytes()
    whole, newline, rest = data.rpartition(b"\n")
    text = (whole + newline).decode("utf-8", "replace")
    if rest.strip(b"\0 \r"):
        problems.append(f"the file was cut off in line {text.count(chr(10)) + 1}: that line is lost")
    lines = io.StringIO(text)
    wrong = []
    while True:
        before = lines.tell()
        try:
            yield from can.CanutilsLogReader(lines)
            break
        except Exception:  # noqa: BLE001 - whatever a damaged line leads the parser to; a new one goes on behind it
            if lines.tell() == before:
                break
            wrong.append(text.count("\n", 0, lines.tell()))
    if wrong:
        named = ", ".join(map(str, wrong[:_NAMED])) + (", ..." if len(wrong) > _NAMED else "")
        problems.append(f"{len(wrong)} lines are no frames (line {named}): left out")
