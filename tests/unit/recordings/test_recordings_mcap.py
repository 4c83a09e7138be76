"""MCAP: what is written, judged by the library's and ROS 2's own readers, and read back."""

import struct
import zlib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer
from mcap_ros2.decoder import DecoderFactory

import friction_hil as fh
from friction_hil.errors import RecordingError, UsageError
from friction_hil.recordings import mcap_chunks
from friction_hil.recordings import mcap_format as layout
from friction_hil.recordings.columns import NAMES
from friction_hil.recordings.mcap_writer import McapWriter
from friction_hil.recordings.recording import Recording

COLUMNS = ("time_s", "cycle", "position", "torque")
STATE = 3
STARTED = 1_700_000_000_000_000_000


def rows(cycles: np.ndarray, axes: int, *, columns: int = len(COLUMNS), state: int = STATE) -> np.ndarray:
    """Random rows for the writer, with consistent time and cycle."""
    random = np.random.default_rng(7)
    values = random.normal(size=(len(cycles), axes, columns + state))
    values[:, :, 0] = cycles[:, None] * 1e-3
    values[:, :, 1] = cycles[:, None]
    return values.reshape(len(cycles), -1)


def write(path: Path, values: np.ndarray, axes: list[str], **options: Any) -> None:
    writer = McapWriter(path, axes, COLUMNS, state_width=STATE, started_unix_ns=STARTED, **options)
    writer.write(values)
    writer.close()


def test_two_axes_come_back_bit_for_bit(tmp_path: Path) -> None:
    values = rows(np.arange(2500.0), 2)
    write(tmp_path / "run.mcap", values, ["x", "y"], metadata={"configuration": {"period_s": 1e-3}})
    read = fh.recordings.read_all(tmp_path / "run.mcap")
    assert list(read) == ["x", "y"]
    for axis, name in enumerate(read):
        assert list(read[name].columns) == list(COLUMNS)
        for i, column in enumerate(COLUMNS):
            expected = np.ascontiguousarray(values[:, axis * 7 + i])
            assert read[name].columns[column].tobytes() == expected.tobytes()
        assert read[name].problems == []
        assert read[name].metadata["configuration"] == {"period_s": 1e-3}
        assert read[name].metadata["recording"]["axes"] == ["x", "y"]


def test_a_restart_point_at_each_chunk_and_after_each_gap(tmp_path: Path) -> None:
    cycles = np.concatenate([np.arange(0, 1300), np.arange(1310, 2500)]).astype(float)
    values = rows(cycles, 2)
    write(tmp_path / "run.mcap", values, ["x", "y"])
    read = fh.recordings.read(tmp_path / "run.mcap", "y")
    restarts = read.restarts
    assert [cycles[row] for row, _ in restarts] == [0, 1000, 1310, 2000]
    for row, state in restarts:
        np.testing.assert_array_equal(state, values[row, 7 + len(COLUMNS) : 14])


def test_ros_decodes_the_same_numbers_at_the_same_times(tmp_path: Path) -> None:
    values = rows(np.arange(30.0), 2)
    writer = McapWriter(tmp_path / "run.mcap", ["x", "y"], COLUMNS, state_width=STATE, started_unix_ns=STARTED)
    writer.write(values)
    writer.write_event(29.0, "fault", "position of x beyond its limit, 10 Ω")
    writer.close()
    seen: dict[str, list[Any]] = {}
    with (tmp_path / "run.mcap").open("rb") as file:
        reader = make_reader(file, validate_crcs=True, decoder_factories=[DecoderFactory()])
        for _, channel, message, decoded in reader.iter_decoded_messages():
            seen.setdefault(channel.topic, []).append((message.log_time, decoded))
        names = [record.name for record in reader.iter_metadata()]
    assert names == ["recording"]
    assert set(seen) == {"/x", "/y", "/x/state", "/y/state", "/events"}
    for offset, topic in ((0, "/x"), (7, "/y")):
        assert len(seen[topic]) == 30
        for i, (log_time, row) in enumerate(seen[topic]):
            assert [getattr(row, name) for name in COLUMNS] == values[i, offset : offset + 4].tolist()
            assert log_time == STARTED + i * 1_000_000
        ((_, state),) = seen[f"{topic}/state"]
        assert state.cycle == 0.0
        assert list(state.state) == values[0, offset + 4 : offset + 7].tolist()
    ((_, event),) = seen["/events"]
    assert (event.cycle, event.name) == (29.0, "fault")
    assert event.text == "position of x beyond its limit, 10 Ω"


def test_the_full_set_of_columns_is_a_ros_message(tmp_path: Path) -> None:
    names = [*NAMES, "shadow_dahl"]
    fh.recordings.write(tmp_path / "x.mcap", Recording("", "x", {name: np.arange(3.0) for name in names}))
    with (tmp_path / "x.mcap").open("rb") as file:
        reader = make_reader(file, decoder_factories=[DecoderFactory()])
        decoded = [[getattr(message, name) for name in names] for *_, message in reader.iter_decoded_messages()]
    assert decoded == [[float(i)] * len(names) for i in range(3)]


@given(st.floats(), st.text(), st.text())
def test_events_survive(cycle: float, name: str, text: str) -> None:
    back = layout.read_event(layout.event_message(cycle, name, text))
    assert struct.pack("<d", back[0]) == struct.pack("<d", cycle)
    assert back[1:] == (name, text)


def test_events_of_every_length_between_rows_are_read(tmp_path: Path) -> None:
    writer = McapWriter(tmp_path / "run.mcap", ["x"], COLUMNS, state_width=STATE)
    writer.write(rows(np.arange(3.0), 1))
    texts = ["e" * length for length in range(20)]
    for cycle, text in enumerate(texts):
        writer.write_event(cycle, "set", text)
    writer.write(rows(np.arange(3.0, 6.0), 1))
    writer.close()
    read = fh.recordings.read(tmp_path / "run.mcap")
    assert ([event.text for event in read.events], len(read)) == (texts, 6)


@given(st.binary(max_size=80), st.binary())
def test_damaged_events_are_refused_and_the_quick_checksum_is_that_of_zlib(data: bytes, rest: bytes) -> None:
    assert mcap_chunks.crc32(rest, mcap_chunks.crc32(data)) == zlib.crc32(data + rest)
    try:
        layout.read_event(layout.CDR_LITTLE_ENDIAN + data)
    except ValueError:
        return
    assert len(data) >= 18  # a cycle and two terminated strings


def test_rows_are_on_disk_before_the_file_is_closed(tmp_path: Path) -> None:
    path = tmp_path / "run.mcap"
    writer = McapWriter(path, ["x"], COLUMNS, state_width=STATE, metadata={"fingerprint": {"cpu": "?"}})
    with pytest.raises(RecordingError, match="there is no channel in it"):
        fh.recordings.read(path)
    writer.write(rows(np.arange(2300.0), 1))
    assert writer.rows_kept == 2000
    read = fh.recordings.read(path)
    assert len(read) == 2000
    assert read.metadata["fingerprint"] == {"cpu": "?"}
    assert len(read.problems) == 1
    assert "cut off" in read.problems[0]
    writer.close()
    assert writer.rows_kept == len(fh.recordings.read(path)) == 2300


@pytest.mark.parametrize(("period", "expected"), [(0.4, [3, 3, 1]), (5.0, [1] * 7)])
def test_chunks_hold_at_most_a_second_and_long_periods_still_end_them(tmp_path: Path, period, expected) -> None:
    values = rows(np.arange(7.0), 1)
    values[:, 0] = np.arange(7) * period
    write(tmp_path / "x.mcap", values, ["x"])
    with (tmp_path / "x.mcap").open("rb") as file:
        summary, counts = make_reader(file).get_summary(), []
        channel = next(c.id for c in summary.channels.values() if c.topic == "/x")
        for chunk in summary.chunk_indexes:
            file.seek(chunk.message_index_offsets[channel] + 9 + 2)
            counts.append(struct.unpack("<I", file.read(4))[0] // 16)
    assert counts == expected


@pytest.mark.parametrize(("axis", "message"), [(None, "--axis; there are: x, y"), ("z", "'z'; there are: x, y")])
def test_axis_must_be_chosen_where_there_are_several(tmp_path: Path, axis: str | None, message: str) -> None:
    write(tmp_path / "run.mcap", rows(np.arange(5.0), 2), ["x", "y"])
    with pytest.raises(UsageError, match=message):
        fh.recordings.read(tmp_path / "run.mcap", axis)


def foreign(path: Path, messages: list[tuple[str, str, str, bytes]], **options: Any) -> None:
    """A file with one message on each channel: topic, schema, encoding, data."""
    with path.open("wb") as file:
        writer = Writer(file, **options)
        writer.start()
        for topic, schema, encoding, data in messages:
            number = writer.register_schema(f"pkg/msg/{topic[1:].title()}", "ros2msg", schema.encode())
            writer.add_message(writer.register_channel(topic, encoding, number), 5, data, 5)
        writer.finish()


FLAT = "float64 time_s\nfloat64 position  # m\n"
BODY = struct.pack("<2d", 0.5, 2.0)


@pytest.mark.parametrize("compression", list(CompressionType))
def test_foreign_flat_messages_are_read(tmp_path: Path, compression: CompressionType) -> None:
    imu = ("/imu", "float64[3] gyro\n", "cdr", b"\0\1\0\0" + bytes(24))
    foreign(tmp_path / "x.mcap", [("/joint", FLAT, "cdr", b"\0\1\0\0" + BODY), imu], compression=compression)
    read = fh.recordings.read(tmp_path / "x.mcap")
    assert (read.axis, read["position"].tolist()) == ("joint", [2.0])


@pytest.mark.parametrize("compression", [CompressionType.LZ4, CompressionType.ZSTD])
def test_a_chunk_that_holds_more_than_it_claims_is_damaged(tmp_path: Path, compression: CompressionType) -> None:
    path = tmp_path / "x.mcap"
    foreign(path, [("/joint", FLAT, "cdr", b"\0\1\0\0" + BODY)] * 50, compression=compression)
    data = bytearray(path.read_bytes())
    at = data.index(compression.name.lower().encode()) - 4  # of the length of the name; before it size and CRC
    claimed = int.from_bytes(data[at - 12 : at - 4], "little") - 30
    data[at - 12 : at - 4] = claimed.to_bytes(8, "little")
    path.write_bytes(data)
    with pytest.raises(fh.errors.RecordingError, match=f"{claimed}"):
        fh.recordings.read(path)


TOPICS = {"a": ["time_s", "u"], "b": ["time_s", "v"], "c": ["time_s", "u", "v", "w"]}


@given(
    turns=st.lists(
        st.tuples(st.lists(st.sampled_from("abc?"), min_size=1, max_size=4), st.integers(1, 60)), max_size=5
    ),
    chunk_size=st.sampled_from([200, 3000, 1 << 20]),
    only=st.sampled_from([None, ("time_s", "v"), ("w", "time_s", "u", "v")]),
)
def test_messages_in_any_order_come_back(tmp_path_factory, turns, chunk_size, only):
    """Channels take turns, some of equal width, with what is no row between them."""
    path = tmp_path_factory.mktemp("order") / "x.mcap"
    sent: dict[str, list[list[float]]] = {topic: [] for topic in TOPICS}
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=chunk_size)
        writer.start()
        schemas = {name: "".join(f"float64 {field}\n" for field in fields) for name, fields in TOPICS.items()}
        channels = {
            name: writer.register_channel(f"/{name}", "cdr", writer.register_schema(name, "ros2msg", text.encode()))
            for name, text in (schemas | {"?": "string text\n"}).items()
        }
        order = ["a", "b", "c", *(topic for topics, count in turns for topic in topics * count)]
        for number, topic in enumerate(order):
            row = [float(number), *(number + 0.1 * i for i in range(len(TOPICS.get(topic, [])) - 1))]
            body = bytes(number % 5) if topic == "?" else struct.pack(f"<{len(row)}d", *row)
            writer.add_message(channels[topic], number, b"\0\1\0\0" + body, number)
            if topic != "?":
                sent[topic].append(row)
        writer.finish()
    read = fh.recordings.read_all(path, only=only)
    assert set(read) == set(TOPICS)
    for topic, fields in TOPICS.items():
        expected = dict(zip(fields, np.array(sent[topic]).T.tolist(), strict=True))
        wanted = {name: expected[name] for name in fields if only is None or name in only}
        assert {name: values.tolist() for name, values in read[topic].columns.items()} == wanted
        assert read[topic].problems == []


def test_a_record_as_long_as_the_messages_before_it(tmp_path: Path) -> None:
    with (tmp_path / "x.mcap").open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema("pkg/msg/Joint", "ros2msg", FLAT.encode())
        channel = writer.register_channel("/joint", "cdr", schema)
        for turn in range(3):
            for _ in range(4):
                writer.add_message(channel, 5, b"\0\1\0\0" + BODY, 5)
            # numbers 2 * 2, topic 4 + 23, encoding 4 + 3, metadata 4 bytes: as message headers 22, encoding 4, body 16
            writer.register_channel(f"/{turn}{'x' * 21}", "cdr", schema)
        writer.finish()
    read = fh.recordings.read(tmp_path / "x.mcap", "joint")
    assert read["position"].tolist() == [2.0] * 12
    assert not [problem for problem in read.problems if "damaged" in problem]


CDR = b"\0\1\0\0"


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (("/imu", "float64[3] gyro\n", "cdr", CDR + bytes(24)), r"flat .*/imu \(pkg/msg/Imu, cdr\)"),
        (("/joint", FLAT, "json", b'{"position": 1}'), r"/joint \(pkg/msg/Joint, json\)"),
        (("/joint", FLAT, "cdr", bytes(4) + BODY), "not little-endian"),
        (("/joint", FLAT, "cdr", CDR + BODY + b"12345678"), "1 rows of /joint"),
        (("/joint", FLAT, "cdr", CDR + BODY), "not chunked"),
        (b"time_s,position\n0,1\n", "is not an MCAP file"),
    ],
)
def test_foreign_files_that_are_not_ours_to_read(tmp_path: Path, content, message: str) -> None:
    path = tmp_path / "x.mcap"
    if isinstance(content, bytes):
        path.write_bytes(content)
    else:
        foreign(path, [content], use_chunking="chunked" not in message)
    with pytest.raises(RecordingError, match=message):
        fh.recordings.read(path)
