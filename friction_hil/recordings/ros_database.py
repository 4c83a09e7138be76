"""Read joint states from the databases (.db3) of ROS 2."""

import contextlib
import sqlite3
from urllib.parse import quote

import zstandard

from friction_hil.errors import RecordingError
from friction_hil.recordings.joint_table import TYPES, JointTable, no_joints
from friction_hil.recordings.recording import Recording
from friction_hil.recordings.source import Source, damaged

_LARGEST_VALUE = 1 << 24  # bytes of a message
_ZSTD = b"\x28\xb5\x2f\xfd"
_COLUMNS = {"topics": {"id", "name", "type"}, "messages": {"topic_id", "timestamp", "data"}}


def read(source: Source) -> list[Recording]:
    """Read the joints of a database, each as an axis.

    Raises `RecordingError`: the file is damaged, or holds no joint states; `OSError`: it cannot be opened.
    """
    source.path.open("rb").close()  # raises the usual error where the file cannot be opened
    address = f"file:{quote(str(source.path.resolve()))}?mode=ro&immutable=1"
    table = JointTable(source.path, source.memory)
    try:
        with contextlib.closing(sqlite3.connect(address, uri=True)) as database:
            database.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, _LARGEST_VALUE)
            database.execute("PRAGMA trusted_schema = OFF")
            _check_tables(source, database)
            kinds = dict(database.execute("SELECT name, type FROM topics LIMIT 1000"))
            rows = database.execute("SELECT id, name, type FROM topics LIMIT 1000")
            topics = {number: name for number, name, kind in rows if kind in TYPES}
            if not topics:
                raise no_joints(source.path, kinds)
            marks = ",".join("?" * len(topics))
            query = f"SELECT topic_id, timestamp, data FROM messages WHERE topic_id IN ({marks}) ORDER BY timestamp"
            for number, received, data in database.execute(query, tuple(topics)):
                if isinstance(data, bytes) and isinstance(received, int):
                    table.add(topics[number], _plain(data), is_ros2=True, received_ns=received)
    except sqlite3.Error as error:
        raise damaged(source.path, "is damaged, or no database of ROS 2", error) from None
    return table.selected(source.select)


def _check_tables(source: Source, database: sqlite3.Connection) -> None:
    """Refuse what only looks like the tables of ROS 2: views and computed columns run whatever the file says."""
    for name, columns in _COLUMNS.items():
        is_table = database.execute(
            "SELECT sql FROM sqlite_master WHERE type = 'table' AND name = ? AND rootpage > 0", (name,)
        ).fetchone()
        plain = {row[1] for row in database.execute(f"PRAGMA table_xinfo({name})") if row[6] == 0}
        if is_table is None or not columns <= plain:
            named = ", ".join(sorted(columns))
            raise RecordingError(f"{source.path} is no database of ROS 2: it has no table {name} with {named}")


def _plain(data: bytes) -> bytes:
    """Return a message, of which each may be compressed by itself; a damaged one is empty."""
    if not data.startswith(_ZSTD):
        return data
    try:
        if zstandard.get_frame_parameters(data).content_size > _LARGEST_VALUE:
            return b""
        return zstandard.ZstdDecompressor().decompress(data, max_output_size=_LARGEST_VALUE)
    except zstandard.ZstdError:
        return b""
