"""Data frames of a log of raw CAN frames: candump .log and what it prints, Vector .asc and .blf, PEAK .trc."""

import contextlib
import io
import re
import struct
import zlib
from collections.abc import Iterator
from datetime import UTC, datetime
from pathlib import Path
from typing import BinaryIO

import can
import numpy as np
from numpy.typing import NDArray

from friction_hil.errors import RecordingError
from friction_hil.recordings.bounds import amount

_EXPANSION = 64  # times its size that a compressed log may hold
_ANY_FILE = 10**8  # bytes that even the smallest one may hold
_CONTAINER = struct.Struct("<4sHHIIH14x")  # signature, header size and version, size, kind; compression and its header
_LOG_CONTAINER, _DEFLATED = 10, 2
_SMALLEST_OBJECT = 16  # bytes
_COLOUR = re.compile(r"\x1b\[[0-9;]*m")
_PRINTED = re.compile(  # a line that candump prints, without colours
    r"\s*(?:\((?P<time>[^()]*)\)\s+)?[A-Za-z]\S*\s+(?:[RT]X\s+\S\s+\S\s+)?(?P<id>[0-9A-Fa-f]{3,8})\s+"
    r"\[(?P<size>\d+)\](?P<data>(?:\s+[0-9A-Fa-f]{2}(?![0-9A-Fa-f]))*)\s*(?:'.*'|remote request)?\s*$"
)
_HEAD = 4000  # characters that show what kind of log it is
_STANDARD_DIGITS = 3
_BACKWARD = 0.05  # of the frames: more are earlier than the one before where times count from that
_LONGEST_STEP_S = 1000.0
_LONGEST_LIST = 5  # of line numbers in a message


class FrameLog:
    """Data frames with 11-bit identifiers, in the order of the log: arrays with a row for each."""

    def __init__(self, path: Path) -> None:
        times: list[float] = []
        identifiers: list[int] = []
        lengths: list[int] = []
        data: list[bytes] = []
        self.problems: list[str] = []  # messages about the parts of the log that could not be read
        read = _candump if path.suffix.lower() in (".log", ".txt") else _vector
        for message in read(path, self.problems):
            if message.is_extended_id or message.is_remote_frame or message.is_error_frame or len(message.data) > 8:
                continue
            times.append(message.timestamp)
            identifiers.append(message.arbitration_id)
            lengths.append(len(message.data))
            data.append(bytes(message.data).ljust(8, b"\0"))
        self.times = np.array(times)  # s
        self.identifiers = np.array(identifiers, dtype=np.int64)
        self.lengths = np.array(lengths, dtype=np.int64)
        self.data = np.frombuffer(b"".join(data), dtype=np.uint8).reshape(-1, 8)  # zeros behind ``lengths``
        self.rows = _rows_by_identifier(self.identifiers)

    def rows_of(self, identifier: int) -> NDArray[np.intp]:
        """Return the indices of the frames with an identifier."""
        return self.rows.get(identifier, np.empty(0, np.intp))

    def since_start_s(self, row: int) -> float:
        """Return the time of a frame since the first one, s."""
        return float(self.times[row] - self.times[0])


def _rows_by_identifier(identifiers: NDArray[np.int64]) -> dict[int, NDArray[np.intp]]:
    if not identifiers.size:
        return {}
    order = np.argsort(identifiers, kind="stable")
    bounds = np.flatnonzero(np.diff(identifiers[order])) + 1
    return {int(identifiers[rows[0]]): rows for rows in np.split(order, bounds)}


def _vector(path: Path, problems: list[str]) -> Iterator[can.Message]:
    """Yield every frame that can be read; where the log ends too early, add that to ``problems``."""
    count, last = 0, 0.0
    try:
        with path.open("rb") as file:
            is_binary = path.suffix.lower() == ".blf"
            if is_binary:
                _check_expansion(path, file)
            text = io.StringIO() if is_binary else _whole_lines(path, problems)
            is_trace = path.suffix.lower() == ".trc"
            reader = can.BLFReader(file) if is_binary else can.TRCReader(text) if is_trace else can.ASCReader(text)
            for message in reader:
                count, last = count + 1, message.timestamp
                yield message
            claimed = getattr(reader, "file_size", 0)
            if claimed > path.stat().st_size:
                problems.append(
                    f"the file was cut off: it has {path.stat().st_size} of {claimed} bytes; "
                    f"what followed frame {count} (at {last:.6f} s) is lost"
                )
    except (OSError, RecordingError):
        raise
    except Exception as error:  # noqa: BLE001 - damaged bytes make the parsers raise errors of any kind
        reason = " ".join(str(error).split()) or type(error).__name__
        problems.append(
            f"the file was cut off or is damaged behind frame {count} (at {last:.6f} s): "
            f"what followed is lost ({reason})"
        )


def _check_expansion(path: Path, file: BinaryIO) -> None:
    """Refuse a .blf file whose compressed parts hold far more than its size; the parser expands them without limit."""
    limit = left = max(_ANY_FILE, _EXPANSION * path.stat().st_size)
    at = struct.unpack("<4sI", file.read(8).ljust(8, b"\0"))[1]  # size of the header
    while True:
        file.seek(at)
        start = file.read(_CONTAINER.size)
        if len(start) < _CONTAINER.size:
            break
        signature, _, _, size, kind, method = _CONTAINER.unpack(start)
        if signature != b"LOBJ":
            break  # damaged: the parser reports it
        if size < _SMALLEST_OBJECT:  # the parser would take all that follows for its content
            raise ValueError(f"the object at byte {at} claims {size} bytes")
        if (kind, method) == (_LOG_CONTAINER, _DEFLATED) and size >= _CONTAINER.size:
            with contextlib.suppress(zlib.error):
                left -= len(zlib.decompressobj().decompress(file.read(size - _CONTAINER.size), left + 1))
            if left < 0:
                raise RecordingError(
                    f"{path}: its compressed parts hold more than {amount(limit)}, which is refused for a file of "
                    f"{amount(path.stat().st_size)}: split it into shorter logs"
                )
        at += size + size % 4
    file.seek(0)


def _whole_lines(path: Path, problems: list[str]) -> io.StringIO:
    """Return the text of an .asc or .trc file up to its last complete line."""
    text = path.read_bytes().decode("utf-8", "replace")
    whole, newline, rest = text.rpartition("\n")
    lines = whole.count("\n") + 1
    if rest.strip("\0 \r"):
        problems.append(f"the file was cut off in line {lines + 1}: that line and what followed are lost")
    elif "begin triggerblock" in whole[:10_000].lower() and not whole.rstrip().lower().endswith("end triggerblock"):
        problems.append(f"the file was cut off behind line {lines}, before its end mark: what followed is lost")
    return io.StringIO(whole + newline)


def _candump(path: Path, problems: list[str]) -> Iterator[can.Message]:
    """Yield the frames of a log in the form of ``candump -l``; lines that cannot be read are counted."""
    data = path.read_bytes()
    whole, newline, rest = data.rpartition(b"\n")
    text = (whole + newline).decode("utf-8", "replace")
    if rest.strip(b"\0 \r"):
        problems.append(f"the file was cut off in line {text.count(chr(10)) + 1}: that line is lost")
    if any(map(_PRINTED.match, _COLOUR.sub("", text[:_HEAD]).splitlines())):
        yield from _printed(path, _COLOUR.sub("", text), problems)
        return
    lines = io.StringIO(text)
    wrong = []
    line, counted = 0, 0  # number of the line that begins at the offset up to which line ends were counted
    while True:
        before = lines.tell()
        try:
            yield from can.CanutilsLogReader(lines)
            break
        except Exception:  # noqa: BLE001 - a damaged line makes the parser raise any error; a new parser goes on after it
            if lines.tell() == before:
                break
            line, counted = line + text.count("\n", counted, lines.tell()), lines.tell()
            wrong.append(line)
    _note_wrong(wrong, problems)


def _note_wrong(wrong: list[int], problems: list[str]) -> None:
    if wrong:
        listed = ", ".join(map(str, wrong[:_LONGEST_LIST])) + (", ..." if len(wrong) > _LONGEST_LIST else "")
        problems.append(f"{len(wrong)} lines are no frames (line {listed}): left out")


def _printed(path: Path, text: str, problems: list[str]) -> Iterator[can.Message]:
    """Yield the frames of what candump prints on a terminal; its option -t gives the time, as any of a, A, z and d.

    Raises `RecordingError`: it was printed without times.
    """
    found: list[tuple[float, int, bytes]] = []
    wrong, without_time = [], 0
    for number, line in enumerate(text.splitlines(), 1):
        parts = _PRINTED.match(line)
        if parts is None or len(data := bytes.fromhex(parts["data"])) != int(parts["size"]):
            if line.strip() and not (parts and "remote request" in line):
                wrong.append(number)
            continue
        time = _time_of(parts["time"])
        if time is None:
            without_time += 1
        elif len(parts["id"]) == _STANDARD_DIGITS:
            found.append((time, int(parts["id"], 16), data))
    if without_time and not found:
        raise RecordingError(
            f"{path}: candump printed these {without_time} frames without their times, and without those there is no "
            "motion: record with candump -l, or candump -t a"
        )
    if without_time:
        problems.append(f"{without_time} frames have no time: left out")
    _note_wrong(wrong, problems)
    times = np.array([time for time, _, _ in found])
    is_backward = len(times) > 1 and np.count_nonzero(np.diff(times) < 0.0) > _BACKWARD * len(times)
    if is_backward and times.max() < _LONGEST_STEP_S:
        problems.append("the times are those since the frame before (candump -t d): added up")
        times = np.cumsum(times)
    for time, (_, identifier, data) in zip(times.tolist(), found, strict=True):
        yield can.Message(timestamp=time, arbitration_id=identifier, data=data, is_extended_id=False)


def _time_of(text: str | None) -> float | None:
    if not text:
        return None
    with contextlib.suppress(ValueError):
        return float(text)
    with contextlib.suppress(ValueError):
        return datetime.fromisoformat(text).replace(tzinfo=UTC).timestamp()
    return None
