"""The message sensor_msgs/msg/JointState of ROS 2: its definition, and its bytes.

Source: sensor_msgs/msg/JointState.msg, std_msgs/msg/Header.msg and builtin_interfaces/msg/Time.msg of ROS 2. The
encoding is CDR as of the DDS interoperability wire protocol (XCDR1), little-endian: a value is aligned to its size,
counted from after the four bytes of the encoding.
"""

import struct
from collections.abc import Sequence

from friction_hil.ros import JOINT_STATES

TOPIC = f"/{JOINT_STATES}"
SCHEMA = "sensor_msgs/msg/JointState"
_LINE = "=" * 80
TEXT = f"""std_msgs/Header header
string[] name
float64[] position    # rad or m
float64[] velocity    # rad/s or m/s
float64[] effort      # N m or N
{_LINE}
MSG: std_msgs/Header
builtin_interfaces/Time stamp
string frame_id
{_LINE}
MSG: builtin_interfaces/Time
int32 sec
uint32 nanosec
"""
COLUMNS = ("position", "velocity", "torque")  # friction_hil's, in the order of the message

_LITTLE_ENDIAN = b"\x00\x01\x00\x00"
_NS = 1_000_000_000
_MOST_S = (1 << 31) - 1  # what int32 holds: until 2038


class JointStates:
    """Messages of the states of all axes, whose names are those of the joints."""

    def __init__(self, axes: Sequence[str]) -> None:
        body = bytearray(struct.pack("<iI", 0, 0))
        _put_text(body, "")
        _put_length(body, len(axes))
        for name in axes:
            _put_text(body, name)
        offsets = []
        for _ in COLUMNS:
            _put_length(body, len(axes))
            body += b"\0" * (-len(body) % 8)
            offsets.append(len(body))
            body += b"\0" * (8 * len(axes))
        self._offsets = offsets
        self._body = body
        self._values = struct.Struct(f"<{len(axes)}d")

    def message(self, time_ns: int, values: Sequence[Sequence[float]]) -> bytes:
        """Return the bytes of a message. ``time_ns``: since 1970.

        ``values``: (3, axes) positions, velocities and efforts; NaN where one is not known.
        """
        seconds, rest = divmod(time_ns, _NS)
        struct.pack_into("<iI", self._body, 0, min(seconds, _MOST_S), rest)
        for offset, row in zip(self._offsets, values, strict=True):
            self._values.pack_into(self._body, offset, *row)
        return _LITTLE_ENDIAN + bytes(self._body)


def _put_length(body: bytearray, length: int) -> None:
    body += b"\0" * (-len(body) % 4) + struct.pack("<I", length)


def _put_text(body: bytearray, text: str) -> None:
    data = text.encode() + b"\0"
    _put_length(body, len(data))
    body += data
