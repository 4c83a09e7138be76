"""Read the bytes of an MCAP file chunk by chunk, also of a damaged file.

The library's readers create an object for each message and raise an error at the first damage. Here consecutive
messages of equal size are one numpy array, of which only the requested columns are kept, and damage is reported.
"""

import io
import os
import struct
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
import zstandard
from isal.isal_zlib import crc32  # four times as fast as zlib's
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, DataEnd, Metadata, Schema
from mcap.writer import MCAP0_MAGIC
from numpy.typing import NDArray

from friction_hil.errors import RecordingError
from friction_hil.recordings import json_text
from friction_hil.recordings import mcap_format as layout
from friction_hil.recordings.bounds import Memory

_HEADER = struct.Struct("<BQ")  # opcode and length before each record
_MESSAGE_HEADER = 22  # channel, sequence, two times
_CHUNK_LIMIT = 1 << 30  # bytes; a larger size means damage, and must not be allocated
_SMALL_CHUNK = 32 << 20  # bytes that any chunk may have
_EXPANSION = 256  # times its compressed size that a larger chunk may have; LZ4 reaches 255
_PRIVATE = frozenset(range(0x80, 0x100))  # skipped
_OPCODES = frozenset(Opcode) | _PRIVATE
_IN_CHUNK = frozenset({Opcode.SCHEMA, Opcode.CHANNEL}) | _PRIVATE  # beside messages
_BAD_RECORD = (McapError, ValueError, OverflowError, struct.error)
_CHUNK_HEADER = struct.Struct("<QQQII")  # two times, size and CRC of the content, length of the compression's name
_ZSTD = zstandard.ZstdDecompressor()
_PIECES = 500_000  # records other than rows, and runs of rows, that any file may have
_BYTES_PER_PIECE = 4  # of the file, for each piece beyond that
_NAMED_PROBLEMS = 20
_FEWEST_ROWS = 64
_MOST_GROWTH = 256
_FEWEST_AHEAD = 16  # messages
_MESSAGE = int(Opcode.MESSAGE)  # an int: numpy compares with an enumeration slowly

Run = NDArray[Any]


class ChannelRows:
    """Rows of one channel, stored by columns."""

    def __init__(self, width: int, wanted: Sequence[int], memory: Memory) -> None:
        self._width = width
        self._memory = memory
        self._wanted = None if len(wanted) == width else list(wanted)  # None: all of them
        self._values = np.empty((len(wanted), 0))
        self._count = 0
        self.others = 0  # messages of another width than the channel's schema states

    def append(self, run: Run, fraction: float) -> None:
        """Append (n, width) rows, after which ``fraction`` of the file has been read.

        The number of rows to come is estimated from it: touching new memory takes longer than everything else here.
        """
        rows, width = run.shape
        if width != self._width:
            self.others += rows
            return
        self._memory.take(rows * len(self._values) * 8)
        end = self._count + rows
        if end > self._values.shape[1]:
            # rows that are never written to take no memory
            room = max(int(end * min(max(1.2 / max(fraction, 1e-9), 1.25), _MOST_GROWTH)), _FEWEST_ROWS)
            larger = np.empty((len(self._values), room))
            larger[:, : self._count] = self._values[:, : self._count]
            self._values = larger
        self._values[:, self._count : end] = (run if self._wanted is None else run[:, self._wanted]).T
        self._count = end

    @property
    def columns(self) -> list[NDArray[np.float64]]:
        """The wanted columns (n,)."""
        return list(self._values[:, : self._count])


@dataclass(frozen=True, slots=True)
class _Chunk:
    start_ns: int
    end_ns: int
    size: int
    crc: int
    compression: str
    data: memoryview


Choose = Callable[[Channel, "Schema | None"], ChannelRows | None]
"""Function that returns the rows to which the messages of a channel are appended; None: they are kept as runs."""


class McapContent:
    """Content of a file, as far as it could be read."""

    def __init__(self, path: Path, choose: Choose, memory: Memory) -> None:
        self.path = path
        self._choose = choose
        self._memory = memory
        self._pieces_left = _PIECES
        self._refused: set[int] = set()  # channels whose messages are no rows
        self._damaged_records = 0
        self._fraction = 0.0  # of the file that has been read
        self.rows: dict[int, ChannelRows] = {}  # by channel, for those for which `choose` returned some
        self.schemas: dict[int, Schema] = {}  # by number, as the channels
        self.channels: dict[int, Channel] = {}
        self.metadata: dict[str, Any] = {}  # records of friction_hil, decoded from JSON; others unchanged
        # by channel, for the others: (n, words) float64 blocks, the CDR bodies of n messages, in file order
        self.runs: dict[int, list[Run]] = {}
        # by channel: messages whose body does not consist of 8-byte words, in file order
        self.odd: dict[int, list[bytes]] = {}
        self.problems: list[str] = []  # damaged parts and lost rows
        self._chunks = 0
        self._is_data_complete = False
        self._first_log_time: int | None = None
        self._ahead: dict[int, int] = {}  # by length of message: how many to compare at once
        with path.open("rb") as file:
            self._pieces_left += os.fstat(file.fileno()).st_size // _BYTES_PER_PIECE
            self._read(file)
        for channel in tuple(self.runs):
            self._rows_of(channel)

    def _read(self, file: BinaryIO) -> None:
        magic = file.read(len(MCAP0_MAGIC))
        if magic != MCAP0_MAGIC:
            what = "is empty" if not magic else "is not an MCAP file"
            raise RecordingError(f"{self.path} {what}")
        crc = crc32(magic)
        for opcode, header, body in self._records(file):
            if opcode == Opcode.DATA_END:
                self._is_data_complete = True
                self._check_end(body, crc)
            crc = crc32(body, crc32(header, crc))
            try:
                self._take(opcode, body)
            except _BAD_RECORD as error:
                self._damaged_records += 1
                if self._damaged_records <= _NAMED_PROBLEMS:
                    self.problems.append(f"a {Opcode(opcode).name.lower()} record is damaged ({error}): left out")
        if self._damaged_records > _NAMED_PROBLEMS:
            self.problems.append(f"{self._damaged_records - _NAMED_PROBLEMS} more records are damaged: left out")

    def _records(self, file: BinaryIO) -> Iterator[tuple[int, bytes, bytes]]:
        """Yield the records of the file up to its footer, or up to the first damage."""
        size = os.fstat(file.fileno()).st_size
        while True:
            offset = file.tell()
            header = file.read(_HEADER.size)
            if len(header) < _HEADER.size:
                self._note_end(f"was cut off at byte {offset}", "what followed is lost")
                return
            opcode, length = _HEADER.unpack(header)
            if length > size - file.tell():
                lost = f"the {size - offset} bytes from there and what followed are lost"
                if opcode == Opcode.CHUNK and size - file.tell() >= 16:
                    span = self._span(*struct.unpack("<QQ", file.read(16)))
                    lost = f"the rows {span} and what followed are lost"
                self._note_end(f"was cut off in the record at byte {offset}", lost)
                return
            if opcode not in _OPCODES or (opcode == Opcode.FOOTER and not self._is_data_complete):
                self._note_end(f"is damaged at byte {offset}", f"the {size - offset} bytes from there are lost")
                return
            body = file.read(length)
            self._fraction = (offset + length) / size
            if opcode == Opcode.FOOTER:
                if file.read(len(MCAP0_MAGIC)) != MCAP0_MAGIC:
                    self._note_end("was cut off at its end", "")
                return
            yield opcode, header, body

    def _note_end(self, what: str, lost: str) -> None:
        self.problems.append(f"the file {what}: {'all its rows are there' if self._is_data_complete else lost}")

    def _check_end(self, body: bytes, crc: int) -> None:
        expected = DataEnd.read(_stream(body)).data_section_crc if len(body) >= 4 else 0
        if expected not in (0, crc):
            self.problems.append("the file is damaged: the checksum over its data does not agree")

    def _take(self, opcode: int, body: bytes) -> None:
        if opcode == Opcode.CHUNK:
            self._chunks += 1
            self._take_chunk(_parse_chunk(body))
        elif opcode == Opcode.SCHEMA:
            schema = Schema.read(_stream(body))
            self.schemas.setdefault(schema.id, schema)
        elif opcode == Opcode.CHANNEL:
            channel = Channel.read(_stream(body))
            self.channels.setdefault(channel.id, channel)
        elif opcode == Opcode.METADATA:
            record = Metadata.read(_stream(body))
            is_ours = set(record.metadata) == {layout.JSON_KEY}
            content = json_text.parse(record.metadata[layout.JSON_KEY]) if is_ours else record.metadata
            self.metadata[record.name] = content
        elif opcode == Opcode.MESSAGE:
            raise RecordingError(f"{self.path} is not chunked, which is needed; `mcap recover` rewrites it")

    def _take_chunk(self, chunk: _Chunk) -> None:
        try:
            data = _decompress(chunk)
            if chunk.crc not in (0, crc32(data)):
                raise ValueError("its checksum does not agree")
        except _BAD_RECORD as error:
            span = self._span(chunk.start_ns, chunk.end_ns)
            self.problems.append(f"chunk {self._chunks} is damaged ({error}): the rows {span} are lost")
            return
        if self._first_log_time is None:
            self._first_log_time = chunk.start_ns
        self._walk(data)

    def _walk(self, data: bytes) -> None:
        """Read every record of a chunk; consecutive messages of one size become one array."""
        offset = 0
        while offset + _HEADER.size <= len(data):
            opcode, length = _HEADER.unpack_from(data, offset)
            end = offset + _HEADER.size + length
            if end > len(data):
                raise ValueError("a record extends beyond the end of its chunk")
            self._pieces_left -= 1
            if self._pieces_left < 0:
                raise self._too_many_pieces()
            if opcode != _MESSAGE:
                if opcode not in _IN_CHUNK:
                    raise ValueError(f"it holds a record of the kind {opcode}, which belongs into no chunk")
                self._take(opcode, data[offset + _HEADER.size : end])
            elif (length - _MESSAGE_HEADER - 4) % 8 == 0 and length > _MESSAGE_HEADER + 4:
                end = offset + self._take_run(data, offset, length)
            elif length >= _MESSAGE_HEADER:
                (channel,) = struct.unpack_from("<H", data, offset + _HEADER.size)
                self._memory.take(length)
                self.odd.setdefault(channel, []).append(data[offset + _HEADER.size + _MESSAGE_HEADER : end])
            offset = end

    def _take_run(self, data: bytes, offset: int, length: int) -> int:
        """Read consecutive messages of ``length`` bytes from ``offset`` on; return the number of bytes they occupy."""
        kind = layout.message_records((length - _MESSAGE_HEADER - 4) // 8)
        # limited: where messages of several sizes alternate, each would be compared with all that follow
        most = min((len(data) - offset) // kind.itemsize, self._ahead.get(length, _FEWEST_AHEAD))
        records = np.frombuffer(data, kind, most, offset)
        differs = (records["opcode"] != _MESSAGE) | (records["length"] != length)
        count = int(differs.argmax()) or most  # the first does not differ
        self._ahead[length] = max(2 * count, _FEWEST_AHEAD)
        records = records[:count]
        if (records["encoding"] & 0xFFFF != layout.ENCODING_WORD).any():
            raise ValueError("its messages are not little-endian CDR")
        for channel, which in _by_channel(records["channel"]):
            self._pieces_left -= 1
            rows = self._rows_of(channel)
            if rows is None:
                run = records["words"][which].copy()
                self._memory.take(run.nbytes)
                self.runs.setdefault(channel, []).append(run)
            else:
                rows.append(records["words"][which], self._fraction)
        return count * kind.itemsize

    def _rows_of(self, channel: int) -> ChannelRows | None:
        """Return the rows of a channel; None for other messages, and while the channel is not known.

        Channels are repeated at the end of the file: those of a damaged chunk become known there.
        """
        if channel not in self.rows and channel in self.channels and channel not in self._refused:
            about = self.channels[channel]
            schema = self.schemas.get(about.schema_id)
            chosen = self._choose(about, schema)
            if chosen is None and schema is not None:
                self._refused.add(channel)
            if chosen is not None:
                self.rows[channel] = chosen
                for run in self.runs.pop(channel, []):
                    chosen.append(run, self._fraction)
        return self.rows.get(channel)

    def _too_many_pieces(self) -> RecordingError:
        return RecordingError(
            f"{self.path}: its chunks hold more records than are read from a file of this size; the limit is "
            f"{_PIECES} and one for each {_BYTES_PER_PIECE} bytes. `mcap filter` keeps the topics that are needed"
        )

    def _span(self, start_ns: int, end_ns: int) -> str:
        about = self.metadata.get(layout.RECORDING_METADATA)
        origin = about.get("started_unix_ns") if isinstance(about, dict) else None
        origin = origin if isinstance(origin, int) else self._first_log_time or start_ns
        return f"from {(start_ns - origin) * 1e-9:.3f} s to {(end_ns - origin) * 1e-9:.3f} s"


def _by_channel(channels: NDArray[np.uint16]) -> list[tuple[int, slice | NDArray[np.intp]]]:
    """Return the messages of each channel; as slices, which copy nothing, if the channels alternate."""
    same = channels == channels[0]
    if same.all():
        return [(int(channels[0]), slice(None))]
    again = np.flatnonzero(same[1:])
    turn = int(again[0]) + 1 if again.size else len(channels)
    first = channels[:turn].tolist()
    if len(set(first)) == turn and np.array_equal(channels[turn:], channels[:-turn]):
        return [(channel, slice(i, None, turn)) for i, channel in enumerate(first)]
    order = np.argsort(channels, kind="stable")
    numbers, begins = np.unique(channels[order], return_index=True)
    return list(zip(numbers.tolist(), np.split(order, begins[1:]), strict=True))


def _stream(body: bytes) -> ReadDataStream:
    return ReadDataStream(io.BytesIO(body))


def _parse_chunk(body: bytes) -> _Chunk:
    start_ns, end_ns, size, crc, length = _CHUNK_HEADER.unpack_from(body)
    offset = _CHUNK_HEADER.size + length
    if offset + 8 > len(body):
        raise ValueError("the name of its compression is longer than the record")
    compression = body[_CHUNK_HEADER.size : offset].decode()
    (length,) = struct.unpack_from("<Q", body, offset)
    if length > len(body) - offset - 8:
        raise ValueError(f"it claims {length} bytes of data and has {len(body) - offset - 8}")
    return _Chunk(start_ns, end_ns, size, crc, compression, memoryview(body)[offset + 8 : offset + 8 + length])


def _decompress(chunk: _Chunk) -> bytes:
    size = chunk.size
    if size > min(max(_SMALL_CHUNK, _EXPANSION * len(chunk.data)), _CHUNK_LIMIT):
        raise ValueError(f"it claims {size} bytes, compressed to {len(chunk.data)}")
    if chunk.compression == "zstd":
        try:
            claimed = zstandard.get_frame_parameters(chunk.data).content_size
            if claimed not in (size, zstandard.CONTENTSIZE_UNKNOWN):
                raise ValueError(f"it claims {claimed} bytes, its record {size}")
            return _ZSTD.decompress(chunk.data, max_output_size=size)
        except zstandard.ZstdError as error:
            raise ValueError(str(error)) from None
    if chunk.compression == "lz4":
        import lz4.frame  # type: ignore[import-untyped]  # imported here: only some files need it

        frame = lz4.frame.LZ4FrameDecompressor()
        try:
            data: bytes = frame.decompress(chunk.data, max_length=size)
        except RuntimeError as error:
            raise ValueError(str(error)) from None
        if len(data) < size or not (frame.eof or frame.needs_input):
            raise ValueError(f"it does not hold the {size} bytes that its record claims")
        return data
    if chunk.compression:
        raise ValueError(f"its compression {chunk.compression!r} is not known here")
    return bytes(chunk.data)
