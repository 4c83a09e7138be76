"""Expedited SDO transfers as single frames (CiA 301), for the cyclic phase. Pure functions: no bus, no clock.

A request is one frame (600h + node) and so is its answer (580h + node). An answer belongs to a request if its index and
subindex are the same.
"""

import struct
from dataclasses import dataclass

from friction_hil_drivers.canopen import objects
from friction_hil_drivers.canopen.codec import Frame
from friction_hil_drivers.canopen.objects import Object

_HEAD = struct.Struct("<BHB")
_FRAME_BYTES, _DATA_BYTES = 8, 4
_UPLOAD_REQUEST, _DOWNLOAD_REQUEST = 0x40, 0x23
_UPLOAD_ANSWER, _DOWNLOAD_ANSWER, _ABORT = 0x40, 0x60, 0x80
_COMMAND, _EXPEDITED, _SIZE_INDICATED = 0xE0, 0x02, 0x01


@dataclass(frozen=True, slots=True)
class SdoAnswer:
    """Answer of a server.

    Attributes
    ----------
    index, subindex : int
        Object that it is about.
    data : bytes
        Of an upload; empty for a download and an abort.
    is_abort : bool
    is_upload : bool
    """

    index: int
    subindex: int
    data: bytes
    is_abort: bool
    is_upload: bool

    def value(self, entry: Object) -> int | None:
        """Return the integer that was read, None if the answer has none."""
        if not self.data:
            return None
        return int.from_bytes(self.data, "little", signed=entry.type.is_signed)


def upload(node: int, entry: Object) -> Frame:
    """Return the request to read an object."""
    data = _HEAD.pack(_UPLOAD_REQUEST, entry.index, entry.subindex).ljust(_FRAME_BYTES, b"\0")
    return objects.SDO_REQUEST_BASE + node, data


def download(node: int, entry: Object, value: int) -> Frame:
    """Return the request to write an integer object of at most 32 bits."""
    size = entry.type.bits // 8
    command = _DOWNLOAD_REQUEST | (_DATA_BYTES - size) << 2
    data = value.to_bytes(size, "little", signed=entry.type.is_signed).ljust(_DATA_BYTES, b"\0")
    return objects.SDO_REQUEST_BASE + node, _HEAD.pack(command, entry.index, entry.subindex) + data


def decode(data: bytes) -> SdoAnswer | None:
    """Return the answer in a frame of 580h + node; None for anything but the answer to an expedited request."""
    if len(data) != _FRAME_BYTES:
        return None
    command, index, subindex = _HEAD.unpack_from(data)
    kind, payload = command & _COMMAND, data[_HEAD.size :]
    if kind in (_ABORT, _DOWNLOAD_ANSWER):
        return SdoAnswer(index, subindex, b"", kind == _ABORT, is_upload=False)
    if kind != _UPLOAD_ANSWER or not command & _EXPEDITED:
        return None
    size = _DATA_BYTES - (command >> 2 & 3) if command & _SIZE_INDICATED else _DATA_BYTES
    return SdoAnswer(index, subindex, payload[:size], is_abort=False, is_upload=True)
