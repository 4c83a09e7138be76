"""Small files that ask for much: the answer is a sentence, after little time and memory."""

import io
import json
import struct
import tracemalloc
import zipfile
from pathlib import Path

import numpy as np
import pytest
import zstandard
from mcap.writer import Writer
from scipy.io import savemat

import friction_hil as fh
from friction_hil.errors import RecordingError
from friction_hil.recordings import bounds

MB = 1 << 20


def npz(path: Path, names: dict[str, tuple[int, ...]], content: int) -> None:
    """An archive of arrays whose headers claim shapes, each with ``content`` zero bytes behind it."""
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, shape in names.items():
            start = io.BytesIO()
            np.lib.format.write_array_header_1_0(start, {"descr": "<f8", "fortran_order": False, "shape": shape})
            with archive.open(f"{name}.npy", "w", force_zip64=True) as member:
                member.write(start.getvalue())
                for begin in range(0, content, MB):
                    member.write(bytes(min(MB, content - begin)))


def mcap(path: Path, *chunks: bytes) -> None:
    """A file of compressed chunks and nothing else."""
    data = b"\x89MCAP0\r\n" + struct.pack("<BQII", 1, 8, 0, 0)
    for chunk in chunks:
        packed = zstandard.compress(chunk)
        body = struct.pack("<QQQII4sQ", 0, 0, len(chunk), 0, 4, b"zstd", len(packed)) + packed
        data += struct.pack("<BQ", 6, len(body)) + body
    path.write_bytes(data + struct.pack("<BQI", 15, 4, 0) + struct.pack("<BQ", 2, 20) + bytes(20) + b"\x89MCAP0\r\n")


def record(opcode: int, body: bytes = b"") -> bytes:
    return struct.pack("<BQ", opcode, len(body)) + body


def message(channel: int, words: int) -> bytes:
    return record(5, struct.pack("<HIQQ", channel, 0, 0, 0) + b"\0\1\0\0" + bytes(8 * words))


def npz_zeros(path: Path) -> None:
    npz(path, {"time_s": (MB,), "torque": (MB,)}, 8 * MB)


def mat_zeros(path: Path) -> None:
    savemat(path, {"time_s": np.zeros(2 * MB)}, do_compression=True)


def hdf5_nothing(path: Path) -> None:
    """Datasets that were never written to take no room in the file."""
    with pytest.importorskip("h5py").File(path, "w") as file:
        for name in ("time_s", "torque"):
            file.create_dataset(name, shape=(1 << 40,), dtype="f8", chunks=(1 << 16,))


def parquet_repeated(path: Path) -> None:
    pyarrow, parquet = pytest.importorskip("pyarrow"), pytest.importorskip("pyarrow.parquet")
    parquet.write_table(pyarrow.table({"time_s": np.zeros(MB), "torque": np.zeros(MB)}), path)


def json_of_other_names(path: Path) -> None:
    path.write_text(json.dumps([{f"n{number}": 1} for number in range(9_900)] * 2))


HUNGRY = {"npz": npz_zeros, "mat": mat_zeros, "h5": hdf5_nothing, "parquet": parquet_repeated}
HUNGRY["json"] = json_of_other_names


@pytest.mark.parametrize("suffix", HUNGRY)
def test_memory_is_bounded_and_the_bound_is_stated(tmp_path, monkeypatch, suffix) -> None:
    """What takes far more than its file; the limit of the test is 10 MB."""
    path = tmp_path / f"x.{suffix}"
    HUNGRY[suffix](path)
    assert path.stat().st_size < MB
    monkeypatch.setattr(bounds, "_ANY_FILE", 10**7)
    tracemalloc.start()
    with pytest.raises(RecordingError, match=r"[MGT]B of memory.*limit.*split the file"):
        fh.recordings.read(path)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 4e7
    monkeypatch.setattr(bounds, "available_memory", lambda: 1e7)
    with pytest.raises(RecordingError, match="half of the available memory"):
        fh.recordings.read(path)


def test_the_limit_grows_with_the_file_and_ends_at_the_machine(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "x"
    path.write_bytes(bytes(1000))
    monkeypatch.setattr(bounds, "available_memory", lambda: 1e12)
    assert bounds.Memory(path).left == 10**9
    monkeypatch.setattr(bounds, "_ANY_FILE", 0)
    memory = bounds.Memory(path)
    memory.take(60_000)
    assert memory.left == 4_000
    with pytest.raises(RecordingError, match=r"takes 65 kB of memory, which is refused for a file of 1 kB"):
        memory.take(5_000)
    memory.take(4_000)
    monkeypatch.setattr(bounds, "available_memory", lambda: 20.0)
    assert bounds.Memory(path).left == 10


@pytest.mark.parametrize(
    ("size", "text"),
    [(0, "0 bytes"), (999, "999 bytes"), (10**9, "1 GB"), (6_400_000_000, "6.4 GB"), (1 << 63, "9.22 EB")],
)
def test_amounts_of_bytes(size: int, text: str) -> None:
    assert bounds.amount(size) == text


def test_an_npz_is_not_believed_about_its_shapes(tmp_path: Path) -> None:
    path = tmp_path / "x.npz"
    npz(path, {"time_s": (3,), "huge": (10**15,), "beyond": (10**30,), "negative": (-3,)}, 24)
    read = fh.recordings.read(path)
    assert list(read.columns) == ["time_s"]
    assert read.problems[:2] == [
        "huge is damaged (its header claims 1000000000000000 values; 3 are there): left out",
        f"beyond is damaged (its header claims {10**30} values; 3 are there): left out",
    ]
    with zipfile.ZipFile(path, "w", zipfile.ZIP_BZIP2) as archive:
        archive.writestr("time_s.npy", bytes(100))
    with pytest.raises(RecordingError, match="compression 12 is none that numpy writes"):
        fh.recordings.read(path)


def test_an_array_comes_back_in_the_order_of_its_values(tmp_path: Path) -> None:
    path = tmp_path / "x.npz"
    np.savez(path, time_s=np.arange(4.0)[:, None], torque=np.asfortranarray(np.arange(4, dtype=">i2")[None, :]))
    read = fh.recordings.read(path)
    assert read["torque"].tolist() == read["time_s"].tolist() == [0.0, 1.0, 2.0, 3.0]


@pytest.mark.parametrize(
    ("chunks", "message"),
    [
        ([bytes(40 * MB)], r"it claims 41943040 bytes, compressed to \d+"),
        ([bytes(MB)], "a record of the kind 0, which belongs into no chunk"),
        ([record(6, bytes(40))], "a record of the kind 6, which belongs into no chunk"),
        ([record(0x80) * 30_000] * 2, "hold more records than are read from a file of this size"),
        ([record(5, bytes(22)) * 30_000] * 2, "hold more records"),
        ([(message(1, 1) + message(2, 2)) * 6_000] * 3, "hold more records"),
    ],
    ids=["expands", "zeros", "chunk in a chunk", "private records", "empty messages", "alternating messages"],
)
def test_a_chunk_is_not_believed_about_its_content(tmp_path, monkeypatch, chunks, message):
    monkeypatch.setattr("friction_hil.recordings.mcap_chunks._PIECES", 20_000)
    mcap(tmp_path / "x.mcap", *chunks)
    with pytest.raises(RecordingError, match=message):
        fh.recordings.read(tmp_path / "x.mcap")


def test_of_very_many_axes_one_is_read(tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema("a/msg/B", "ros2msg", b"float64 time_s\n")
        for number in range(2_000):
            channel = writer.register_channel(f"/axis{number}", "cdr", schema)
            writer.add_message(channel, number, b"\0\1\0\0" + struct.pack("<d", number), number)
        writer.finish()
    with pytest.raises(RecordingError, match=r"2000 axes; at most 256 .*--axis.* and 1900 more"):
        fh.recordings.read_all(path)
    assert fh.recordings.read(path, "axis1234")["time_s"].tolist() == [1234.0]


def test_metadata_of_any_depth_costs_only_itself(tmp_path: Path) -> None:
    path = tmp_path / "x.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        writer.add_metadata("deep", {"json": "[" * 100_000})
        writer.add_metadata("recording", {"json": f'{{"started_unix_ns": {"1" * 5_000}}}'})
        writer.add_metadata("facts", {"json": "5"})
        schema = writer.register_schema("a/msg/B", "ros2msg", b"float64 time_s\nfloat64 position\nfloat64 torque\n")
        channel = writer.register_channel("/x", "cdr", schema)
        for number in range(100):
            writer.add_message(channel, number, b"\0\1\0\0" + struct.pack("<3d", number, number, 1.0), number)
        writer.finish()
    read = fh.recordings.read(path)
    assert read.problems == ["a metadata record is damaged (its lists and objects are nested too deeply): left out"]
    assert sorted(read.metadata) == ["facts", "recording"]


@pytest.mark.parametrize("suffix", [".csv", ".json"])
def test_columns_are_counted_before_they_are_read(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"x{suffix}"
    names = [f"n{number}" for number in range(10_001)]
    path.write_text(",".join(names) + "\n" if suffix == ".csv" else json.dumps([dict.fromkeys(names, 1.0)]))
    with pytest.raises(RecordingError, match="has 10001 columns; at most 10000 are read: split it"):
        fh.recordings.read(path)


def test_numbers_of_any_length_are_read_from_json(tmp_path: Path) -> None:
    path = tmp_path / "x.json"
    path.write_text(f'[{{"time_s": 0, "torque": {"1" * 1_000_000}}}, {{"time_s": 1, "torque": 12345678901234567890}}]')
    read = fh.recordings.read(path)
    assert read["torque"].tolist() == [np.inf, 12345678901234567890.0]
    assert read.problems == ["torque is not finite in 1 of 2 rows (row 0)"]
    path.write_text(f'[{{"time_s": 0, "torque": {"[" * 100_000}')
    with pytest.raises(RecordingError, match="nested too deeply"):
        fh.recordings.read(path)


def test_fields_that_most_rows_lack_are_nan_and_lists_of_different_length_no_columns(tmp_path: Path) -> None:
    path = tmp_path / "x.json"
    path.write_text(json.dumps([{"time_s": number, f"n{number}": number} for number in range(20)]))
    read = fh.recordings.read(path)
    np.testing.assert_array_equal(read["time_s"], np.arange(20.0))
    for number in range(20):
        expected = np.where(np.arange(20) == number, number, np.nan)
        np.testing.assert_array_equal(read.columns[f"n{number}"], expected)
    path.write_text('[{"time_s": 0, "torque": [1]}, {"time_s": 1, "torque": [2, 3]}]')
    read = fh.recordings.read(path)
    assert list(read.columns) == ["time_s"]
    assert read.problems == ["torque is a list of 1 and 2 values, not of 1 to 256 in each row: left out"]


def test_the_limit_of_a_process_is_no_traceback(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A limit that this program does not know of, e.g. `ulimit -v`."""
    path = tmp_path / "x.csv"
    path.write_text("time_s\n0\n1\n")

    def refuse(*_: object) -> None:
        raise MemoryError

    monkeypatch.setattr("friction_hil.recordings.csv_file.layout_of", refuse)
    with pytest.raises(RecordingError, match="does not fit into the memory"):
        fh.recordings.read(path)


def test_flags_that_no_record_holds_are_neither_believed_nor_allocated(tmp_path: Path) -> None:
    """The number of bytes of invalidation bits stands at the end of an MF4 file; one wrong byte made it 16 million."""
    path = tmp_path / "x.mf4"
    columns = {name: np.arange(8.0) for name in ("time_s", "position", "torque")}
    fh.recordings.write(path, fh.recordings.Recording(str(path), "x", columns), overwrite=True)
    data = path.read_bytes()
    assert data[-4:] == bytes(4)
    path.write_bytes(data[:-1] + b"\1")
    tracemalloc.start()
    with pytest.raises(RecordingError, match="bytes of flags in a record"):
        fh.recordings.read(path)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 3e7
