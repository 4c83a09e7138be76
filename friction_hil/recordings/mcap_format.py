"""What our MCAP files look like: topics, schemas and the bytes of a message, for writer and reader alike.

One channel ``/AXIS`` an axis holds its rows: a flat ROS 2 message of float64 fields named as the columns.
``/AXIS/state`` holds the state of its compensator at restart points, ``/events`` what happened.
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
JSON_KEY = "json"  # its only key, as in all our metadata records

_FIELD_NAME = re.compile(r"[a-z](_?[a-z0-9]+)*")  # what ROS 2 allows
_FIELD = re.compile(r"float64\s+([A-Za-z]\w*)")


def is_field_name(name: str) -> bool:
    """Whether ROS 2 allows the name of a field: lower-case letters, digits, single underscores."""
    return _FIELD_NAME.fullmatch(name) is not None


def row_schema(columns: Sequence[str]) -> str:
    """Message definition of a row."""
    lines = []
    for name in columns:
        units = " or ".join(dict.fromkeys(u for u in (unit(name), unit(name, "linear")) if u))
        remark = f"{meaning(name)}{f' [{units}]' if units else ''}"
        lines.append(f"float64 {name}" + (f"    # {remark}" if remark else ""))
    return "\n".join(lines) + "\n"


def row_fields(schema: str) -> list[str] | None:
    """Names of the fields of a flat float64 message; None for any other message."""
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
    """Bytes of a state message; ``state`` is float64, little-endian."""
    # CDR aligns the first float64 of the sequence to 8 bytes: 4 bytes of padding follow its length.
    return CDR_LITTLE_ENDIAN + struct.pack("<dI4x", cycle, len(state) // 8) + state


def event_message(cycle: float, name: str, text: str) -> bytes:
    """Bytes of an event message."""
    body = bytearray(struct.pack("<d", cycle))
    for value in (name, text):
        data = value.encode() + b"\0"
        body += b"\0" * (-len(body) % 4) + struct.pack("<I", len(data)) + data
    return CDR_LITTLE_ENDIAN + bytes(body)


def read_event(message: bytes) -> tuple[float, str, str]:
    """Cycle, name and text of an event message.

    Raises
    ------
    ValueError
        The bytes are not an event.
    """
    body = message[len(CDR_LITTLE_ENDIAN) :]
    if len(body) < 8 or not message.startswith(CDR_LITTLE_ENDIAN):
        raise ValueError("not a little-endian CDR message")
    texts, at = [], 8
    for _ in range(2):
        at += -at % 4
        if at + 4 > len(body):
            raise ValueError("the message ends early")
        (size,) = struct.unpack_from("<I", body, at)
        if not 1 <= size <= len(body) - at - 4:
            raise ValueError("the message ends early")
        texts.append(body[at + 4 : at + 3 + size].decode())
        at += 4 + size
    return struct.unpack_from("<d", body)[0], texts[0], texts[1]


@functools.cache
def message_records(words: int) -> np.dtype[np.void]:
    """Message records, one after the other, whose CDR body is ``words`` times 8 bytes."""
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
