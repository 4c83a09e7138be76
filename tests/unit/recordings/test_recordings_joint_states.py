"""Joint states of ROS 1 and 2, written by rosbags and read back by joint name."""

import json
import sqlite3
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import friction_hil as fh
from friction_hil.cli import main
from friction_hil.errors import RecordingError, UsageError
from friction_hil.recordings.bounds import Memory
from friction_hil.recordings.joint_table import JointTable
from friction_hil.recordings.recording import Recording
from tests.contract.recording_formats import read_or_reason

rosbags = pytest.importorskip("rosbags.typesys", reason="rosbags is not installed")
COUNT = 40
TIME = np.arange(COUNT) * 0.01
START = 1_700_000_000


def messages(store, header, stamp):
    """Joint states whose order changes; the effort of each second message is not filled."""
    joint = store.types["sensor_msgs/msg/JointState"]
    for row, time in enumerate(TIME):
        values = {"shoulder": (np.sin(time), np.cos(time), 2.0), "elbow": (0.5 * time, 0.5, -1.0)}
        names = list(values)[:: 1 if row % 3 else -1]
        own = {} if "seq" not in header.__dataclass_fields__ else {"seq": row}
        position, velocity, effort = (np.array([values[name][k] for name in names]) for k in range(3))
        yield joint(
            header=header(stamp=stamp(sec=START, nanosec=round(1e9 * time)), frame_id="base" * (row % 2), **own),
            name=names,
            position=position,
            velocity=velocity,
            effort=effort if row % 2 else np.empty(0),
        )


def ros2(path: Path, suffix: str) -> Path:
    from rosbags.rosbag2 import StoragePlugin, Writer

    store = rosbags.get_typestore(rosbags.Stores.ROS2_HUMBLE)
    types, plugin = store.types, {"mcap": StoragePlugin.MCAP, "db3": StoragePlugin.SQLITE3}[suffix]
    with Writer(path / suffix, version=8, storage_plugin=plugin) as writer:
        topic = writer.add_connection("/joint_states", "sensor_msgs/msg/JointState", typestore=store)
        for each in messages(store, types["std_msgs/msg/Header"], types["builtin_interfaces/msg/Time"]):
            writer.write(topic, 5, store.serialize_cdr(each, "sensor_msgs/msg/JointState"))
    return next((path / suffix).glob(f"*.{suffix}"))


def bag(path: Path, compression: str = "") -> Path:
    from rosbags.rosbag1 import Writer

    store = rosbags.get_typestore(rosbags.Stores.ROS1_NOETIC)
    types = store.types
    writer = Writer(path / "x.bag")
    if compression:
        writer.set_compression(Writer.CompressionFormat[compression])
    with writer:
        topic = writer.add_connection("/joint_states", "sensor_msgs/msg/JointState", typestore=store)
        for each in messages(store, types["std_msgs/msg/Header"], types["builtin_interfaces/msg/Time"]):
            writer.write(topic, 5, store.serialize_ros1(each, "sensor_msgs/msg/JointState"))
    return path / "x.bag"


WRITERS = {
    "mcap": lambda path: ros2(path, "mcap"),
    "db3": lambda path: ros2(path, "db3"),
    "bag": bag,
    "bz2": lambda path: bag(path, "BZ2"),
    "lz4": lambda path: bag(path, "LZ4"),
}


@pytest.mark.parametrize("name", WRITERS)
def test_each_joint_is_an_axis_by_its_name(tmp_path: Path, name: str, capsys: pytest.CaptureFixture[str]) -> None:
    path = WRITERS[name](tmp_path)
    found = fh.recordings.read_all(path)
    assert set(found) == {"shoulder", "elbow"}
    np.testing.assert_allclose(found["shoulder"]["time_s"], TIME, atol=1e-9)
    np.testing.assert_allclose(found["shoulder"]["position"], np.sin(TIME))
    np.testing.assert_allclose(found["elbow"]["position"], 0.5 * TIME)
    np.testing.assert_array_equal(found["elbow"].columns["torque"], np.where(np.arange(COUNT) % 2, -1.0, np.nan))
    with pytest.raises(UsageError, match="several axes; choose one with --axis"):
        fh.recordings.read(path)
    assert main(["convert", str(path), "--info", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["axes"]["elbow"]["suggestion"]["command"].endswith("--axis elbow")


@pytest.mark.parametrize("name", ["db3", "bag", "bz2", "lz4"])
def test_a_file_that_is_cut_off_is_read_as_far_as_it_goes_or_refused(tmp_path: Path, name: str) -> None:
    path = WRITERS[name](tmp_path)
    data = path.read_bytes()
    for size in (0, 10, len(data) // 3, len(data) // 2, len(data) - 20):
        path.write_bytes(data[:size])
        read = read_or_reason(path)
        assert isinstance(read, Recording) or str(path) in read or "several axes" in read


@given(st.binary(max_size=200), st.booleans())
def test_bytes_that_are_no_message_are_counted(data: bytes, is_ros2: bool) -> None:
    table = JointTable(Path(__file__), Memory(Path(__file__)))
    table.add("x", (b"\0\1\0\0" if is_ros2 else b"") + data, is_ros2=is_ros2)
    for read in table.selected(lambda names: names) if table.rows else []:
        assert len(read) == 1


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ("VIEW messages AS SELECT 1 AS topic_id, 1 AS timestamp, x'00' AS data", "no table messages"),
        ("TABLE messages (topic_id, timestamp, data AS (zeroblob(100)))", "no table messages"),
        ("TABLE messages (topic_id, timestamp, data)", r"/scan \(sensor_msgs/msg/LaserScan\)"),
    ],
    ids=["view", "generated", "other topics"],
)
def test_a_database_that_computes_its_tables_or_has_no_joint_states_is_refused(tmp_path, table, message) -> None:
    """A view, or a generated column, may take any time and memory."""
    made = sqlite3.connect(tmp_path / "x.db3")
    made.execute("CREATE TABLE topics (id, name, type)")
    kind = "LaserScan" if "LaserScan" in message else "JointState"
    made.execute(f"INSERT INTO topics VALUES (1, '/scan', 'sensor_msgs/msg/{kind}')")
    made.execute(f"CREATE {table}")
    made.commit()
    made.close()
    with pytest.raises(RecordingError, match=message):
        fh.recordings.read_all(tmp_path / "x.db3")


def test_a_bag_that_claims_more_than_the_memory_is_refused(tmp_path: Path) -> None:
    path = bag(tmp_path, "BZ2")
    data = path.read_bytes()
    at = data.index(b"size=") + 5
    path.write_bytes(data[:at] + b"\xff\xff\xff\xff" + data[at + 4 :])
    with pytest.raises(RecordingError, match="of memory"):
        fh.recordings.read_all(path)
