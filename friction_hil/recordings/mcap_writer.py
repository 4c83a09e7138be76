"""Write recordings as MCAP, chunk by chunk."""

import contextlib
import io
import json
import math
import os
import stat
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from mcap.well_known import MessageEncoding, Profile, SchemaEncoding
from mcap.writer import CompressionType, Writer
from numpy.typing import NDArray

from friction_hil.errors import RecordingError
from friction_hil.recordings import joint_state
from friction_hil.recordings import mcap_format as layout
from friction_hil.recordings.columns import CYCLE, TIME
from friction_hil.recordings.joint_state import JointStates
from friction_hil.recordings.recording import Array, Recording
from friction_hil.recordings.source import new_file
from friction_hil.ros import JOINT_STATES

CHUNK_S = 1.0
_CHUNK_BYTES = 8 << 20
_ROWS_AT_ONCE = 10_000


class McapWriter:
    """Writer of the cycles of one or several axes; flushed rows survive a crash of this process.

    Metadata is written before the first row. At the start of each chunk and after each gap in ``cycle``, the state of
    every axis is written, so that a replay can start there. Raises `RecordingError`: ROS 2 does not allow the name of a
    column as a field; or joint states are asked for, and a column for them is missing, or an axis has the name of their
    topic; `OSError`: the file exists, or cannot be opened or written.
    """

    def __init__(
        self,
        path: Path,  # an existing file is an error unless `overwrite`
        axes: Sequence[str],
        columns: Sequence[str],  # of every axis, among them `time_s`
        *,
        state_width: int = 0,  # state values that follow the columns of an axis in a row
        started_unix_ns: int = 0,  # wall-clock time at `time_s` = 0, since 1970
        metadata: Mapping[str, Any] | None = None,  # what JSON can hold, by name; each entry becomes a metadata record
        about: Mapping[str, Any] | None = None,  # further entries of the metadata record about the file itself
        overwrite: bool = False,
        is_durable: bool = False,  # each chunk is forced to the disk: flushed rows survive a power cut, too
        # each row is also a message sensor_msgs/msg/JointState of all axes, for tools of ROS 2
        has_joint_states: bool = False,
        on_flush: Callable[[], None] = lambda: None,  # called after `rows_kept` and `events_kept` have changed
    ) -> None:
        _check_names(path, columns)
        self._joint_states: JointStates | None = None
        if has_joint_states:
            _check_joint_states(path, axes, columns)
            width = len(columns) + state_width
            found = [[i * width + columns.index(name) for i in range(len(axes))] for name in joint_state.COLUMNS]
            self._joint_columns = np.array(found)
            self._joint_states = JointStates(axes)
        # handed to the operating system, or on the disk if `is_durable`; the others are in the open chunk
        self.rows_kept = self.events_kept = 0
        self._width = len(columns)
        self._axis_width = len(columns) + state_width
        self._time = columns.index(TIME)
        self._cycle = columns.index(CYCLE) if CYCLE in columns else None
        self._started_unix_ns = started_unix_ns
        self._on_flush = on_flush
        self._rows = self._events = 0
        self._previous_cycle = math.nan
        self._chunk_start = math.nan  # time of the open chunk's first row; NaN while none is open
        self._chunk_rows = 0
        self._chunk_rows_limit = max(
            1, _CHUNK_BYTES // (len(axes) * (self._width * 8 + (80 if has_joint_states else 35)))
        )
        self._last_log_time = started_unix_ns
        self.path = path
        self.size = 0  # bytes up to the end of the last chunk
        self._file: io.BufferedWriter = path.open("wb" if overwrite else "xb")
        # only files have a disk to be forced to; a link to /dev/null has none
        self._is_durable = is_durable and stat.S_ISREG(os.fstat(self._file.fileno()).st_mode)
        try:
            # This class ends the chunks: the library's own limit is set out of reach.
            self._mcap = Writer(self._file, chunk_size=1 << 62, compression=CompressionType.LZ4, enable_data_crcs=True)
            self._mcap.start(profile=Profile.ROS2, library="friction_hil")
            own = {
                "version": layout.VERSION,
                "axes": list(axes),
                "columns": list(columns),
                "state_width": state_width,
                "started_unix_ns": started_unix_ns,
                **(about or {}),
            }
            for name, content in {layout.RECORDING_METADATA: own, **(metadata or {})}.items():
                self._mcap.add_metadata(name, {layout.JSON_KEY: json.dumps(content)})
            self._register(axes, columns, state_width)
            self._mcap.flush()  # type: ignore[no-untyped-call]
            self._force()
            if self._is_durable:
                force_folder(path)
        except BaseException:
            with contextlib.suppress(OSError):  # what is buffered cannot be written: the same error once more
                self._file.close()
            if not overwrite:
                path.unlink(missing_ok=True)
            raise

    def _register(self, axes: Sequence[str], columns: Sequence[str], state_width: int) -> None:
        def schema(name: str, text: str) -> int:
            number: int = self._mcap.register_schema(name, SchemaEncoding.ROS2, text.encode())
            return number

        def channels(suffix: str, schema_id: int) -> list[int]:
            return [self._mcap.register_channel(f"/{axis}{suffix}", MessageEncoding.CDR, schema_id) for axis in axes]

        self._row_channels = channels("", schema(layout.ROW_SCHEMA, layout.row_schema(columns)))
        self._event_channel = self._mcap.register_channel(
            layout.EVENT_TOPIC, MessageEncoding.CDR, schema(layout.EVENT_SCHEMA, layout.EVENT_TEXT)
        )
        if self._joint_states is not None:
            self._joint_channel = self._mcap.register_channel(
                joint_state.TOPIC, MessageEncoding.CDR, schema(joint_state.SCHEMA, joint_state.TEXT)
            )
        self._state_channels = []
        if state_width:
            self._state_channels = channels(layout.STATE_SUFFIX, schema(layout.STATE_SCHEMA, layout.STATE_TEXT))

    def write(self, rows: Array, has_state: NDArray[np.bool_] | None = None) -> None:
        """Append rows (n, axes * (columns + state)): for each axis its columns, then its state.

        ``has_state``, (n,): rows whose state is known and written; without it all are known, and written where a replay
        needs them. Raises `OSError`: the file cannot be written.
        """
        data = np.ascontiguousarray(rows, dtype="<f8").tobytes()
        row_bytes = rows.shape[1] * 8
        times = rows[:, self._time].tolist()
        cycles = times if self._cycle is None else rows[:, self._cycle].tolist()
        joints = None if self._joint_states is None else rows[:, self._joint_columns].tolist()
        for i, (time, cycle) in enumerate(zip(times, cycles, strict=True)):
            if self._chunk_rows and (
                not 0.0 <= time - self._chunk_start < CHUNK_S or self._chunk_rows >= self._chunk_rows_limit
            ):
                self.flush()
            row = data[i * row_bytes : (i + 1) * row_bytes]
            is_gap = self._cycle is not None and cycle != self._previous_cycle + 1.0
            if self._chunk_rows == 0:
                self._chunk_start = time
            with_state = self._chunk_rows == 0 or is_gap if has_state is None else bool(has_state[i])
            self._write_row(row, time, cycle, with_state=with_state)
            if self._joint_states is not None and joints is not None:
                body = self._joint_states.message(self._last_log_time, joints[i])
                number = (self._rows - 1) & 0xFFFFFFFF
                self._mcap.add_message(self._joint_channel, self._last_log_time, body, self._last_log_time, number)
            self._previous_cycle = cycle

    def _write_row(self, row: bytes, time: float, cycle: float, *, with_state: bool) -> None:
        log_time = self._started_unix_ns + round(time * 1e9)
        axis_bytes, row_bytes = self._axis_width * 8, self._width * 8
        if with_state:
            for axis, channel in enumerate(self._state_channels):
                state = row[axis * axis_bytes + row_bytes : (axis + 1) * axis_bytes]
                self._mcap.add_message(channel, log_time, layout.state_message(cycle, state), log_time)
        for axis, channel in enumerate(self._row_channels):
            body = layout.CDR_LITTLE_ENDIAN + row[axis * axis_bytes : axis * axis_bytes + row_bytes]
            self._mcap.add_message(channel, log_time, body, log_time, self._rows & 0xFFFFFFFF)
        self._rows += 1
        self._chunk_rows += 1
        self._last_log_time = log_time

    def write_event(self, cycle: float, name: str, text: str) -> None:
        """Append an event to the chunk of the rows written before it. Raises `OSError`: the file cannot be written."""
        message = layout.event_message(cycle, name, text)
        self._mcap.add_message(self._event_channel, self._last_log_time, message, self._last_log_time)
        self._events += 1

    @property
    def has_open_chunk(self) -> bool:
        """True if rows or events have been written since the last flush."""
        return (self._rows, self._events) != (self.rows_kept, self.events_kept)

    def flush(self) -> None:
        """End the open chunk and hand it to the operating system, or to the disk if ``is_durable``."""
        self._mcap.flush()  # type: ignore[no-untyped-call]
        self._force()
        self._chunk_rows = 0
        self._note_kept()

    def abandon(self) -> None:
        """Close the file after an error, without a summary; what was flushed remains."""
        with contextlib.suppress(OSError):  # what is buffered cannot be written: the same error once more
            self._file.close()
        with contextlib.suppress(OSError):
            if self.path.is_file():
                os.truncate(self.path, self.size)  # part of a chunk, of no use, may have been written

    def close(self) -> None:
        """Write the summary, and close the file; safe to call twice."""
        if self._file.closed:
            return
        try:
            self._mcap.finish()  # type: ignore[no-untyped-call]
            self._force()
            self._file.close()
            self._note_kept()
        finally:
            self._file.close()

    def _force(self) -> None:
        self._file.flush()
        if self._is_durable:
            os.fsync(self._file.fileno())
        self.size = self._file.tell() if self._file.seekable() else 0

    def _note_kept(self) -> None:
        self.rows_kept, self.events_kept = self._rows, self._events
        self._on_flush()


def force_folder(path: Path) -> None:
    """Force the entry of a new file to the disk: without it, a power cut can lose the file's name."""
    descriptor = os.open(path.parent, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def write(path: Path, recording: Recording, *, overwrite: bool) -> None:
    """Write the columns of one axis; ``time_s`` = 0 is 1970, or later if time stamps are negative.

    Raises `RecordingError`: ROS 2 does not allow the name of a column as a field; `OSError`: the file exists, unless
    ``overwrite``, or cannot be written.
    """
    columns = list(recording.columns)
    time = recording[TIME]
    started = max(0, -math.floor(float(time.min()) * 1e9))
    if started + float(time.max()) * 1e9 >= 1 << 63:
        raise RecordingError(f"{path}: {TIME} spans {time.min():g} to {time.max():g}: is it in seconds?")
    _check_names(path, columns)
    with new_file(path, overwrite=overwrite) as part:
        writer = McapWriter(part, [recording.axis], columns, started_unix_ns=started, overwrite=True)
        try:
            for start in range(0, len(recording), _ROWS_AT_ONCE):
                rows = slice(start, start + _ROWS_AT_ONCE)
                writer.write(np.stack([values[rows] for values in recording.columns.values()], axis=1))
        finally:
            writer.close()


def _check_joint_states(path: Path, axes: Sequence[str], columns: Sequence[str]) -> None:
    missing = [name for name in joint_state.COLUMNS if name not in columns]
    if missing:
        raise RecordingError(f"{path}: joint states need the columns {', '.join(missing)}")
    if JOINT_STATES in axes:
        raise RecordingError(f"{path}: an axis is called {JOINT_STATES}, as the topic of the joint states")


def _check_names(path: Path, columns: Sequence[str]) -> None:
    wrong = [name for name in columns if not layout.is_field_name(name)]
    if wrong:
        raise RecordingError(
            f"{path}: MCAP holds columns named with lower-case letters, digits and underscores, not "
            f"{', '.join(map(repr, wrong))}; rename with --column new_name='{wrong[0]}'"
        )
