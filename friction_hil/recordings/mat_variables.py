"""Real vectors and matrices of MATLAB files of version 4 and 5, without any other kind of variable.

scipy reads more, but ends the process on some damaged files, and a compressed variable expands there without limit.
"""

import math
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from friction_hil.recordings.bounds import Memory
from friction_hil.recordings.matrices import column_indices
from friction_hil.recordings.recording import Array
from friction_hil.recordings.source import as_column

HEADER = 128  # bytes of a version 5 file before its first variable
_ORDERS = {b"IM": "<", b"MI": ">"}  # at the end of that header
_TAG = 8  # bytes: kind and length of what follows
_MATRIX, _COMPRESSED = 14, 15
_FLAGS, _SIZES, _NAMES = 6, 5, (1, 2, 16)
_CLASSES = range(6, 16)  # double, single, and integers of 8 to 64 bits
_COMPLEX = 0x800
_KINDS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
_KINDS_4 = ("f8", "f4", "i4", "i2", "u2", "u1")
_HEADER_4 = 20  # bytes before the name of a variable of version 4


@dataclass(frozen=True, slots=True)
class _Element:
    kind: int
    data: memoryview
    end: int  # offset after the element and its padding


def vectors(data: bytes, memory: Memory, problems: list[str]) -> Iterator[tuple[str, Array]]:
    """Yield name and values of each real vector of more than one value, and of each column of a real matrix.

    Damage is appended to ``problems``: a damaged variable costs only itself, a cut what follows it. Raises
    `RecordingError`: the content takes more than ``memory``; `ValueError`: ``data`` is not a MATLAB file.
    """
    order = _ORDERS.get(data[HEADER - 2 : HEADER])
    if order is None:
        yield from _vectors_of_version_4(data, problems)
        return
    at = HEADER
    while at < len(data):
        start = at
        kind, length = struct.unpack_from(f"{order}II", data, at) if at + _TAG <= len(data) else (0, len(data))
        at += _TAG + length
        if at > len(data):
            problems.append(
                f"the file was cut off in the variable at byte {start}: that variable and what followed are lost"
            )
            return
        try:
            body = memoryview(data)[start + _TAG : at]
            if kind == _COMPRESSED:
                kind, body = _uncompressed(body, order, memory)
            found = _columns(body, order) if kind == _MATRIX else {}
        except (ValueError, struct.error, zlib.error) as error:
            problems.append(f"the variable at byte {start} is damaged ({error}): left out")
            continue
        yield from found.items()


def _uncompressed(body: memoryview, order: str, memory: Memory) -> tuple[int, memoryview]:
    """Return kind and content of a compressed element."""
    unpacker, left = zlib.decompressobj(), memory.left
    data = unpacker.decompress(body, left + 1)
    if len(data) > left:
        raise memory.exceeded()
    memory.take(len(data))
    if not unpacker.eof:
        raise ValueError("its compressed content ends early")
    element = _element(memoryview(data), 0, order)
    return element.kind, element.data


def _element(data: memoryview, at: int, order: str) -> _Element:
    """Return the element at an offset; up to 4 bytes of data are stored in the tag itself."""
    first, length = struct.unpack_from(f"{order}II", data, at)
    if first > 0xFFFF:
        kind, length, begin = first & 0xFFFF, first >> 16, at + 4
        end = at + _TAG
    else:
        kind, begin = first, at + _TAG
        end = begin + length + -length % 8
    if begin + length > len(data) or (begin == at + 4 and length > 4):
        raise ValueError("it extends beyond its end")
    return _Element(kind, data[begin : begin + length], end)


def _columns(data: memoryview, order: str) -> dict[str, Array]:
    """Return the columns of a matrix element by name; empty if it holds no real numbers."""
    flags = _element(data, 0, order)
    if flags.kind != _FLAGS or len(flags.data) != 8:
        raise ValueError("its flags are missing")
    (bits,) = struct.unpack_from(f"{order}I", flags.data)
    if bits & 0xFF not in _CLASSES or bits & _COMPLEX:
        return {}
    sizes = _element(data, flags.end, order)
    name = _element(data, sizes.end, order)
    values = _element(data, name.end, order)
    if sizes.kind != _SIZES or name.kind not in _NAMES or values.kind not in _KINDS:
        raise ValueError("a part of it is of another kind than belongs there")
    shape = np.frombuffer(sizes.data, f"{order}i4").tolist()
    numbers = np.frombuffer(values.data, f"{order}{_KINDS[values.kind]}")
    if min(shape, default=-1) < 0 or math.prod(shape) != numbers.size:
        raise ValueError(f"it claims {' x '.join(map(str, shape))} values and has {numbers.size}")
    return _named(bytes(name.data).rstrip(b"\0").decode("utf-8", "replace"), numbers, shape)


def _named(name: str, numbers: np.ndarray, shape: list[int]) -> dict[str, Array]:
    values = numbers.reshape(shape, order="F")
    return {column: as_column(values[index]) for column, index in column_indices(name, shape).items()}


def _vectors_of_version_4(data: bytes, problems: list[str]) -> Iterator[tuple[str, Array]]:
    at = 0
    while at < len(data):
        if at + _HEADER_4 > len(data):
            problems.append(f"the file was cut off at byte {at}: what followed is lost")
            return
        order = "<" if struct.unpack_from("<I", data, at)[0] < 5000 else ">"
        code, rows, columns, is_complex, length = struct.unpack_from(f"{order}5I", data, at)
        is_valid = code // 1000 == (order == ">")
        kind, content = code // 10 % 10, code % 10
        if not is_valid or code // 100 % 10 or kind >= len(_KINDS_4) or content > 2 or not 1 <= length <= 1 << 16:
            raise ValueError("no variable begins where one belongs" if at else "it does not begin as one")
        values = np.dtype(f"{order}{_KINDS_4[kind]}")
        begin = at + _HEADER_4 + length
        end = begin + rows * columns * values.itemsize * (2 if is_complex else 1)
        if end > len(data):
            problems.append(
                f"the file was cut off in the variable at byte {at}: that variable and what followed are lost"
            )
            return
        if not is_complex and content == 0:
            name = data[at + _HEADER_4 : begin].partition(b"\0")[0].decode("latin-1")
            numbers = np.frombuffer(data, values, rows * columns, begin)
            yield from _named(name, numbers, [rows, columns]).items()
        at = end
