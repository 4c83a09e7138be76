"""Joint states in recordings, read by two programs of ROS that are not this one."""

import math
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

import friction_hil as fh
from friction_hil.config.recording import RecordingConfig
from friction_hil.daemon.companion.job import Job
from friction_hil.daemon.companion.new_file import begin_file
from friction_hil.errors import ConfigurationError, RecordingError
from friction_hil.recordings.mcap_writer import McapWriter

COLUMNS = ["cycle", "time_s", "position", "velocity", "torque"]
AXES = ["x", "shoulder_pan"]  # names of a length that needs padding
STARTED = 1_700_000_000_123_456_789
STATE = 2
COUNT = 50


def values() -> np.ndarray:
    """Rows of two axes with state; the torque of the second is not known at first."""
    rows = np.random.default_rng(1).normal(size=(COUNT, len(AXES) * (len(COLUMNS) + STATE)))
    for axis in range(len(AXES)):
        first = axis * (len(COLUMNS) + STATE)
        rows[:, first] = np.arange(COUNT)
        rows[:, first + 1] = np.arange(COUNT) * 1e-3
    rows[0, len(COLUMNS) + STATE + 4] = math.nan
    return rows


def expected(rows: np.ndarray, column: str) -> np.ndarray:
    width = len(COLUMNS) + STATE
    return rows[:, [axis * width + COLUMNS.index(column) for axis in range(len(AXES))]]


@pytest.fixture
def recording(tmp_path) -> Path:
    """A file as the companion begins it."""
    job = Job(AXES, COLUMNS, STATE, 1e-3, STARTED, path="run.mcap", has_joint_states=RecordingConfig(ros=True).ros)
    writer = begin_file(tmp_path / "run.mcap", job, about={})
    writer.write(values())
    writer.write_event(3.0, "fault", "none")
    writer.close()
    return tmp_path / "run.mcap"


def test_rosbags_reads_the_joint_states(recording):
    rosbags = pytest.importorskip("rosbags.rosbag2", reason="rosbags is not installed")
    from rosbags.typesys import Stores, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    rows = values()
    with rosbags.Reader(recording) as reader:
        (connection,) = [each for each in reader.connections if each.topic == "/joint_states"]
        assert connection.msgtype == "sensor_msgs/msg/JointState"
        messages = [
            (stamp, store.deserialize_cdr(raw, connection.msgtype)) for _, stamp, raw in reader.messages([connection])
        ]
    assert len(messages) == COUNT
    for column, field in (("position", "position"), ("velocity", "velocity"), ("torque", "effort")):
        np.testing.assert_array_equal([getattr(each, field) for _, each in messages], expected(rows, column))
    for k, (stamp, message) in enumerate(messages):
        assert message.name == AXES
        assert message.header.stamp.sec * 10**9 + message.header.stamp.nanosec == stamp == STARTED + k * 10**6


def test_the_decoder_of_mcap_reads_them_by_the_schema_in_the_file(recording):
    with recording.open("rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        decoded = [each.decoded_message for each in reader.iter_decoded_messages(topics=["/joint_states"])]
    assert [list(each.name) for each in decoded] == [AXES] * COUNT
    np.testing.assert_array_equal([each.effort for each in decoded], expected(values(), "torque"))


def test_the_rows_of_the_axes_are_read_as_ever(recording):
    rows = values()
    read = fh.recordings.read_all(recording)
    assert list(read) == AXES
    for axis, name in enumerate(AXES):
        np.testing.assert_array_equal(read[name]["position"], expected(rows, "position")[:, axis])
    assert read["x"].problems == []
    assert [event.name for event in read["x"].events] == ["fault"]


def test_without_the_key_there_are_none(tmp_path):
    writer = begin_file(tmp_path / "run.mcap", Job(AXES, COLUMNS, STATE, 1e-3, STARTED), about={})
    writer.write(values())
    writer.close()
    assert b"JointState" not in (tmp_path / "run.mcap").read_bytes()


def test_an_axis_with_the_name_of_the_topic_is_a_mistake_in_the_configuration(tmp_path):
    path = tmp_path / "machine.yaml"
    text = Path("config/single_axis_csp.yaml").read_text().replace("models/", f"{Path('config').resolve()}/models/")
    text = text.replace("\n  x:", "\n  joint_states:")
    path.write_text(text)
    recording = fh.config.load(path).recording
    assert not recording.ros
    path.write_text(text.replace("\nrecording:\n", "\nrecording:\n  ros: true\n"))
    with pytest.raises(ConfigurationError, match=r"axes\.joint_states.*another name"):
        fh.config.load(path)


@pytest.mark.parametrize(
    ("axes", "columns", "message"),
    [(["joint_states"], COLUMNS, "as the topic"), (["x"], ["time_s", "position"], "velocity, torque")],
)
def test_what_cannot_be_joint_states_is_refused_before_there_is_a_file(tmp_path, axes, columns, message):
    with pytest.raises(RecordingError, match=message):
        McapWriter(tmp_path / "run.mcap", axes, columns, has_joint_states=True)
    assert list(tmp_path.iterdir()) == []
