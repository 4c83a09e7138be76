"""Read joint states from the bags (.bag, version 2.0) of ROS 1.

Source: the page "Bags/Format/2.0" of the ROS wiki. A record is a header of fields ``name=value`` and data, each behind
its length; a chunk's data are records, compressed as a whole.
"""

import bz2
import struct
from collections.abc import Iterator
from typing import BinaryIO

from friction_hil.errors import RecordingError
from friction_hil.recordings.joint_table import TYPES, JointTable, no_joints
from friction_hil.recordings.recording import Recording
from friction_hil.recordings.source import Source

_MAGIC = b"#ROSBAG V2.0\n"
_MESSAGE, _CHUNK, _CONNECTION = 2, 5, 7
_LARGEST_HEADER = 1 << 16
_LARGEST_CHUNK = 1 << 30


def read(source: Source) -> list[Recording]:
    """Read the joints of a bag, each as an axis; one that was cut off up to its last whole record.

    Raises `RecordingError`: the file is no bag of version 2.0, or holds no joint states; `OSError`: it cannot be
    opened.
    """
    table = JointTable(source.path, source.memory)
    kinds: dict[str, str] = {}
    topics: dict[bytes, str] = {}
    problems: list[str] = []
    with source.path.open("rb") as file:
        if file.read(len(_MAGIC)) != _MAGIC:
            raise RecordingError(f"{source.path} is no bag of ROS 1, version 2.0")
        size = source.path.stat().st_size
        for fields, data in _records(file, size, problems):
            records = iter([(fields, data)])
            if _kind(fields) == _CHUNK:
                records = _in_memory(_expanded(source, fields, data, problems), problems)
            for own, content in records:
                if _kind(own) == _CONNECTION:
                    kind = _fields(content).get(b"type", b"").decode("utf-8", "replace")
                    topic = own.get(b"topic", b"").decode("utf-8", "replace")
                    kinds[topic] = kind
                    if kind in TYPES:
                        topics[own.get(b"conn", b"")] = topic
                elif _kind(own) == _MESSAGE and (number := own.get(b"conn", b"")) in topics:
                    stamp = own.get(b"time", b"").ljust(8, b"\0")
                    seconds, rest = struct.unpack("<II", stamp[:8])
                    received = seconds * 1_000_000_000 + rest
                    table.add(topics[number], content, is_ros2=False, received_ns=received)
    if not topics:
        raise no_joints(source.path, kinds)
    recordings = table.selected(source.select)
    for recording in recordings:
        recording.problems += dict.fromkeys(problems)
    return recordings


Fields = dict[bytes, bytes]


def _kind(fields: Fields) -> int:
    return fields.get(b"op", b"\0")[0] if fields.get(b"op") else 0


def _fields(header: bytes) -> Fields:
    """Return the fields of a header; what follows a damaged one is left out."""
    found, at = {}, 0
    while at + 4 <= len(header):
        (length,) = struct.unpack_from("<I", header, at)
        name, sign, value = header[at + 4 : at + 4 + length].partition(b"=")
        if not sign:
            break
        found[name] = value
        at += 4 + length
    return found


def _records(file: BinaryIO, size: int, problems: list[str]) -> Iterator[tuple[Fields, bytes]]:
    while True:
        at = file.tell()
        header = _sized(file, size, _LARGEST_HEADER)
        data = None if header is None else _sized(file, size, _LARGEST_CHUNK)
        if header is None or data is None:
            if at < size:
                problems.append(f"the file was cut off or is damaged at byte {at}: what followed is lost")
            return
        yield _fields(header), data


def _sized(file: BinaryIO, size: int, most: int) -> bytes | None:
    length = file.read(4)
    if len(length) < 4:
        return None
    (count,) = struct.unpack("<I", length)
    return None if count > min(most, size - file.tell()) else file.read(count)


def _in_memory(data: bytes, problems: list[str]) -> Iterator[tuple[Fields, bytes]]:
    at = 0
    while at + 8 <= len(data):
        (length,) = struct.unpack_from("<I", data, at)
        begin = at + 4 + length
        if begin + 4 > len(data):
            break
        (count,) = struct.unpack_from("<I", data, begin)
        if begin + 4 + count > len(data):
            break
        yield _fields(data[at + 4 : begin]), data[begin + 4 : begin + 4 + count]
        at = begin + 4 + count
    if at != len(data):
        problems.append("a chunk is damaged: the rest of it is lost")


def _expanded(source: Source, fields: Fields, data: bytes, problems: list[str]) -> bytes:
    """Return the records of a chunk; of a damaged one, none."""
    compression = fields.get(b"compression", b"none")
    (size,) = struct.unpack("<I", fields.get(b"size", b"").ljust(4, b"\0")[:4])
    if size > min(_LARGEST_CHUNK, source.memory.left):
        raise source.memory.exceeded(size)
    try:
        if compression == b"bz2":
            return bz2.BZ2Decompressor().decompress(data, max_length=size)
        if compression == b"lz4":
            import lz4.frame  # type: ignore[import-untyped]  # imported here: only some files need it

            content: bytes = lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=size)
            return content
    except (OSError, EOFError, RuntimeError, ValueError) as error:
        problems.append(f"a chunk is damaged ({error}): it is left out")
        return b""
    if compression != b"none":
        name = compression.decode("ascii", "replace")
        problems.append(f"a chunk is compressed by {name}, which is not known here: left out")
        return b""
    return data
