"""Journal of the changes of a run, in shared memory: what the compensators were changed to, by number.

The process of the control socket appends; the companion copies the entries to the recording, and a successor of either
finds there what the former one knew. The memory has no name.
"""

import json
import os
import struct
from typing import Any

_LENGTH = struct.Struct("<q")  # of what is complete, at the beginning


def make_journal() -> int:
    """Return the descriptor of an empty journal."""
    descriptor = os.memfd_create("friction_hil-journal")
    os.pwrite(descriptor, _LENGTH.pack(0), 0)
    return descriptor


def append(descriptor: int, entry: dict[str, Any]) -> None:
    """Append an entry; a reader sees all of it, or nothing."""
    (length,) = _LENGTH.unpack(os.pread(descriptor, _LENGTH.size, 0))
    line = json.dumps(entry).encode() + b"\n"
    at = _LENGTH.size + length
    while line:
        written = os.pwrite(descriptor, line, at)
        line, at = line[written:], at + written
    os.pwrite(descriptor, _LENGTH.pack(at - _LENGTH.size), 0)


def entries(descriptor: int) -> list[dict[str, Any]]:
    """Return all entries, each with its ``number``, in their order."""
    (length,) = _LENGTH.unpack(os.pread(descriptor, _LENGTH.size, 0))
    data = b""
    while len(data) < length and (part := os.pread(descriptor, length - len(data), _LENGTH.size + len(data))):
        data += part
    return [json.loads(line) for line in data.splitlines()]
