"""Axes from messages sensor_msgs/JointState of ROS 1 and 2, each by the name of its joint. Pure.

The order of the joints may change from message to message, and arrays that a publisher does not fill are empty.
"""

import struct
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from friction_hil.errors import RecordingError
from friction_hil.recordings.bounds import MOST_AXES, Memory
from friction_hil.recordings.joint_state import COLUMNS
from friction_hil.recordings.recording import Recording

TYPES = ("sensor_msgs/msg/JointState", "sensor_msgs/JointState")
_BYTES_PER_ROW = 300  # of a row of one joint, while the messages are read
_MOST_NAMED = 10


class _Body:
    """The bytes of a message, read in order; arrays of ROS 2 are aligned, texts end in a zero byte."""

    def __init__(self, data: bytes, is_ros2: bool) -> None:
        self._order = "<"
        self._at = 0
        self._is_ros2 = is_ros2
        if is_ros2:
            if len(data) < 4 or data[0] != 0 or data[1] > 1:
                raise ValueError("no CDR message")
            self._order = "<" if data[1] else ">"
        self._data = data[4:] if is_ros2 else data

    def numbers(self, code: str, count: int = 1) -> tuple[float, ...]:
        size = struct.calcsize(code)
        if self._is_ros2 and count:
            self._at += -self._at % size
        end = self._at + size * count
        if end > len(self._data):
            raise ValueError("the message ends early")
        values = struct.unpack_from(f"{self._order}{count}{code}", self._data, self._at)
        self._at = end
        return values

    def length(self) -> int:
        count = int(self.numbers("I")[0])
        if count > len(self._data):
            raise ValueError("the message ends early")
        return count

    def text(self) -> str:
        size = self.length()
        data = bytes(self.numbers("B", size))  # type: ignore[arg-type]
        return data.rstrip(b"\0").decode("utf-8", "replace")


class JointTable:
    """Rows of the joints that come in messages."""

    def __init__(self, path: Path, memory: Memory) -> None:
        self._path = path
        self._memory = memory  # that the content may take
        self.rows: dict[tuple[str, str], list[tuple[int, float, float, float]]] = {}
        self._damaged = 0
        self._repeated = 0

    def add(self, topic: str, message: bytes, *, is_ros2: bool, received_ns: int = 0) -> None:
        """Take the rows of a message; one that is damaged is counted."""
        try:
            self._take(topic, _Body(message, is_ros2), is_ros2, received_ns)
        except (ValueError, struct.error):
            self._damaged += 1

    def _take(self, topic: str, body: _Body, is_ros2: bool, received_ns: int) -> None:
        if not is_ros2:
            body.numbers("I")  # number of the message
        seconds, rest = body.numbers("i" if is_ros2 else "I")[0], body.numbers("I")[0]
        body.text()
        names = [body.text() for _ in range(body.length())]
        arrays = [body.numbers("d", body.length()) for _ in COLUMNS]
        if any(len(values) not in (0, len(names)) for values in arrays):
            raise ValueError("its arrays are not as long as its names")
        self._repeated += len(names) - len(set(names))
        self._memory.take(_BYTES_PER_ROW * len(names))
        stamp = int(seconds) * 1_000_000_000 + int(rest) or received_ns
        for place, name in enumerate(names):
            position, velocity, effort = (values[place] if values else np.nan for values in arrays)
            self.rows.setdefault((topic, name), []).append((stamp, position, velocity, effort))
            if len(self.rows) > MOST_AXES:
                raise RecordingError(f"{self._path} has the joints of more than {MOST_AXES} axes")

    def selected(self, select: Callable[[list[str]], list[str]]) -> list[Recording]:
        """Return the axes that ``select`` chooses of all.

        Raises `RecordingError`: there is no message that can be read.
        """
        recordings = list(self._recordings())
        if not recordings:
            raise RecordingError(f"{self._path}: there are no joint states that can be read")
        names = select([recording.axis for recording in recordings])
        return [recording for recording in recordings if recording.axis in names]

    def _recordings(self) -> Iterator[Recording]:
        """Yield an axis for each joint; of a joint in several topics, with the name of the topic before."""
        joints = [name for _, name in self.rows]
        for (topic, name), rows in self.rows.items():
            axis = name if joints.count(name) == 1 else f"{topic.strip('/')}/{name}"
            stamps = np.array([row[0] for row in rows], dtype=np.int64)
            order = np.argsort(stamps, kind="stable")
            recording = Recording(str(self._path), axis, {"time_s": (stamps[order] - stamps.min()) * 1e-9})
            values = np.array([row[1:] for row in rows])[order]
            for place, column in enumerate(COLUMNS):
                if np.isfinite(values[:, place]).any():
                    recording.columns[column] = np.ascontiguousarray(values[:, place])
            if self._damaged:
                recording.problems.append(f"{self._damaged} messages are damaged: left out")
            if self._repeated:
                recording.problems.append(f"{self._repeated} times a message names a joint twice")
            yield recording


def no_joints(path: Path, kinds: dict[str, str]) -> RecordingError:
    """Return the error for a file without joint states; ``kinds`` are the types of its topics."""
    named = ", ".join(f"{topic} ({kind})" for topic, kind in list(kinds.items())[:_MOST_NAMED])
    more = f" and {len(kinds) - _MOST_NAMED} more" if len(kinds) > _MOST_NAMED else ""
    return RecordingError(f"{path}: no topic holds {TYPES[1]}; there are: {named or 'none'}{more}")
