"""A JSON document in memory without a name: its writer hands the descriptor to other processes, which only read it."""

import json
import os
import struct
from typing import Any

_HEAD = struct.Struct("<qqq")  # number of the writing, odd while it is written; cycle that it is about; bytes of text
_TRIES = 100  # of a reader, who meets a writer once in a thousand times


def make_document(name: str, document: dict[str, Any]) -> int:
    """Return the descriptor of a new document; ``name`` is what tools that list memory show."""
    descriptor = os.memfd_create(f"friction_hil-{name}")
    os.fchmod(descriptor, 0o400)  # whoever gets a descriptor for reading cannot open it again for writing
    os.pwrite(descriptor, _HEAD.pack(0, -1, 0), 0)
    write_document(descriptor, document, -1)
    return descriptor


def write_document(descriptor: int, document: dict[str, Any], cycle: int) -> None:
    """Replace the document by one that says what is so up to a cycle."""
    text = json.dumps(document).encode()
    number, before, length = _HEAD.unpack(os.pread(descriptor, _HEAD.size, 0))
    number |= 1  # it is odd already after a process that died while it wrote
    os.pwrite(descriptor, _HEAD.pack(number, before, length), 0)
    os.pwrite(descriptor, text, _HEAD.size)
    os.pwrite(descriptor, _HEAD.pack(number + 1, cycle, len(text)), 0)


def read_document(descriptor: int) -> dict[str, Any]:
    """Return the document; empty if there is only half of it."""
    for _ in range(_TRIES):
        head = os.pread(descriptor, _HEAD.size, 0)
        number, _, length = _HEAD.unpack(head)
        text = os.pread(descriptor, length, _HEAD.size)
        if number % 2 == 0 and os.pread(descriptor, _HEAD.size, 0) == head:
            found: dict[str, Any] = json.loads(text)
            return found
    return {}  # its writer died while it wrote


def cycle_of(descriptor: int) -> int:
    """Return the cycle that the document is about; -1 before the first."""
    return int(_HEAD.unpack(os.pread(descriptor, _HEAD.size, 0))[1])
