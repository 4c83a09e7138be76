"""Layout of friction_hil's MCAP files, for writer and reader: topics, schemas and the bytes of a message.

The channel ``/AXIS`` holds the rows of an axis: a flat ROS 2 message of float64 fields named as the columns.
``/AXIS/state`` holds the state of its compensator at restart points, ``/events`` faults and changes of settings.
"""

import functools
import re
import struct
from collections.abc import Sequence

import numpy as np

from friction_hil.recordings.columns import meaning, unit

VERSION = 1
CDR_LITTLE_ENDIAN = b"\x00\x01\x00\x00"
ENCODING_WORD = int.from_bytes(CDR_LITTLE_ENDIAN, "little")

ROW_SCHEMA = "friction_hil/msg/Cycle"
STATE_SCHEMA = "friction_hil/msg/State"
EVENT_SCHEMA = "friction_hil/msg/Event"
STATE_TEXT = "float64 cycle    # the state is that before this cycle's step\nfloat64[] state\n"
EVENT_TEXT = "float64 cycle\nstring name\nstring text\n"

STATE_SUFFIX = "/state"
EVENT_TOPIC = "/events"
RECORDING_METADATA = "recording"  # name of the metadata record about the file itself
PART = "part"  # its key: number of this file among those of one recording
SERIES = "series"  # its key: the daemon and the path that all its recordings were started with
IS_OF_FAULT = "is_of_fault"  # its key: the file is a copy of the rows around a fault
JSON_KEY = "json"  # its only key, as in all metadata records of friction_hil

_FIELD_NAME = re.compile(r"[a-z](_?[a-z0-9]+)*")  # what ROS 2 allows
_FIELD = re.compile(r"float64\s+([A-Za-z]\w*)")


def is_field_name(name: str) -> bool:
    """True if ROS 2 allows the name of a field: lower-case letters, digits, single underscores."""
    return _FIELD_NAME.fullmatch(name) is not None


def row_schema(columns: Sequence[str]) -> str:
    """Return the message definition of a row."""
    lines = []
    for name in columns:
        units = " or ".join(dict.fromkeys(u for u in (unit(name), unit(name, "linear")) if u))
        remark = f"{meaning(name)}{f' [{units}]' if units else ''}"
        lines.append(f"float64 {name}" + (f"    # {remark}" if remark else ""))
    return "\n".join(lines) + "\n"


def row_fields(schema: str) -> list[str] | None:
    """Return the names of the fields of a flat float64 message; None for any other message."""
    names = []
    for line in schema.splitlines():
        text = line.partition("#")[0].strip()
        if not text:
            continue
        field = _FIELD.fullmatch(text)
        if field is None:
            return None
        names.append(field[1])
    return names or None


def state_message(cycle: float, state: bytes) -> bytes:
    """Return the bytes of a state message; ``state`` is float64, little-endian."""
    # CDR aligns the first float64 of the sequence to 8 bytes: 4 bytes of padding follow its length.
    return CDR_LITTLE_ENDIAN + struct.pack("<dI4x", cycle, len(state) // 8) + state


def event_message(cycle: float, name: str, text: str) -> bytes:
    """Return the bytes of an event message."""
    body = bytearray(struct.pack("<d", cycle))
    for value in (name, text):
        data = value.encode() + b"\0"
        body += b"\0" * (-len(body) % 4) + struct.pack("<I", len(data)) + data
    return CDR_LITTLE_ENDIAN + bytes(body)


def read_event(message: bytes) -> tuple[float, str, str]:
    """Return cycle, name and text of an event message. Raises `ValueError`: the bytes are not an event."""
    body = message[len(CDR_LITTLE_ENDIAN) :]
    if len(body) < 8 or not message.startswith(CDR_LITTLE_ENDIAN):
        raise ValueError("not a little-endian CDR message")
    texts, offset = [], 8
    for _ in range(2):
        offset += -offset % 4
        if offset + 4 > len(body):
            raise ValueError("the message ends early")
        (size,) = struct.unpack_from("<I", body, offset)
        if not 1 <= size <= len(body) - offset - 4:
            raise ValueError("the message ends early")
        texts.append(body[offset + 4 : offset + 3 + size].decode())
        offset += 4 + size
    return struct.unpack_from("<d", body)[0], texts[0], texts[1]


@functools.cache
def message_records(words: int) -> np.dtype[np.void]:
    """Return the numpy type of a message record whose CDR body is ``words`` times 8 bytes."""
    return np.dtype(
        [
            ("opcode", "u1"),
            ("length", "<u8"),
            ("channel", "<u2"),
            ("sequence", "<u4"),
            ("log_time", "<u8"),
            ("publish_time", "<u8"),
            ("encoding", "<u4"),
            ("words", "<f8", (words,)),
        ]
    )
