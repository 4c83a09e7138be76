"""What is peculiar to single formats, and files of other programs; tests/contract has what all formats promise."""

import json
import struct
import sys
import zlib
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scipy.io
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

import friction_hil as fh
from friction_hil.errors import ConfigurationError, RecordingError, UsageError
from friction_hil.recordings.mapping import parse_source
from friction_hil.recordings.recording import Recording
from tests.contract.recording_formats import read_or_reason, sample

BAM = Path(__file__).parents[4] / "shared" / "data" / "bam_xl330"


def test_a_unit_that_is_not_ours_is_converted_and_said_unless_a_factor_is_given(tmp_path: Path) -> None:
    wrong = sample()
    wrong.units = {"position": "deg", "torque": "N·m", "gear_2": "deg"}
    fh.recordings.write(tmp_path / "x.parquet", wrong)
    read = fh.recordings.read(tmp_path / "x.parquet")
    assert [each for each in read.problems if "deg" in each] == ["position is in deg in the file: multiplied by pi/180"]
    np.testing.assert_allclose(read["position"], np.radians(wrong["position"]))
    assert read.units["position"] == "rad"
    for factor in (1.0, np.pi / 180.0):
        given = fh.recordings.read(tmp_path / "x.parquet", scale={"position": factor})
        np.testing.assert_allclose(given["position"], factor * wrong["position"])
        assert not any("deg" in problem for problem in given.problems)


@settings(max_examples=25, suppress_health_check=[HealthCheck.function_scoped_fixture], deadline=None)
@given(noise=st.binary(max_size=300))
def test_other_bytes_in_a_format_that_is_only_read_end_in_a_sentence(tmp_path: Path, noise: bytes) -> None:
    path = tmp_path / "x.mdf"
    path.write_bytes(noise)
    read = read_or_reason(path)
    assert isinstance(read, Recording) or str(path) in read


def test_csv_that_a_crash_left_behind(tmp_path: Path) -> None:
    path = tmp_path / "x.csv"
    path.write_bytes(b"time_s,torque\n0,1\n1,2\n2,37\0\0\0\0")
    read = fh.recordings.read(path)
    assert read["torque"].tolist() == [1.0, 2.0]
    assert read.problems == [
        "the file ends in 4 zero bytes, as a crash leaves them: left out",
        "line 4 has no line end, so the file may have been cut off in it: that row is left out",
    ]


@pytest.fixture(params=[True, False], ids=["pyarrow", "without"])
def has_arrow(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> bool:
    if not request.param:
        monkeypatch.setitem(sys.modules, "pyarrow", None)
    return request.param


def test_csv_has_the_same_bits_with_and_without_pyarrow(tmp_path: Path, has_arrow: bool) -> None:
    fh.recordings.write(tmp_path / "x.csv", sample())
    read = fh.recordings.read(tmp_path / "x.csv")
    for name, column in sample().columns.items():
        assert read.columns[name].tobytes() == column.tobytes()


def test_the_last_row_needs_no_line_end(tmp_path: Path, has_arrow: bool) -> None:
    path = tmp_path / "x.csv"
    path.write_bytes(b"time_s,torque\n0,1\n1,2")
    read = fh.recordings.read(path)
    assert read["torque"].tolist() == [1.0, 2.0]
    (problem,) = read.problems
    assert problem.startswith("line 3 has no line end: its row is read")
    for cut in (b"1", b"1,2e", b"1,2,"):
        path.write_bytes(b"time_s,torque\n0,1\n" + cut)
        read = fh.recordings.read(path)
        assert read["torque"].tolist() == [1.0]
        assert "line 3 has no line end, so the file may have been cut off in it" in read.problems[0]


@pytest.mark.parametrize(
    "text",
    [
        "time_s;torque\n0;1,5\n0,001;-2,25e-1\n",
        "sep=;\n# 1.5 V; 2,5 V\ntime_s;torque\n0,0;1,50\n0,001;-,225",
        "time_s\ttorque\r\n0\t1,5\r\n,001\t-0,225\r\n",
        'time_s;torque\n"0,0";"1,5"\n"0,001";"-0,225"\n',
    ],
)
def test_decimal_commas(tmp_path: Path, text: str, has_arrow: bool) -> None:
    (tmp_path / "x.csv").write_text(text, newline="")
    read = fh.recordings.read(tmp_path / "x.csv")
    assert read["time_s"].tolist() == [0.0, 0.001]
    assert read["torque"].tolist() == [1.5, -0.225]


@pytest.mark.parametrize("suffix", [".h5", ".parquet", ".npz"])
def test_a_changed_value_is_found_by_its_checksum(tmp_path: Path, suffix: str) -> None:
    """One bit of a value in the middle of a column; test_recordings_damage.py does the same to MCAP."""
    path = tmp_path / f"x{suffix}"
    torque = np.random.default_rng(3).normal(size=3000)
    fh.recordings.write(path, Recording("", "x", {"time_s": np.arange(3000) * 1e-3, "torque": torque}))
    data = bytearray(path.read_bytes())
    at = data.find(torque[1500:1501].tobytes())
    assert at > 0
    data[at] ^= 1
    path.write_bytes(data)
    read = fh.recordings.read(path)
    assert list(read.columns) == ["time_s"]
    assert any(problem.startswith("torque is damaged (") for problem in read.problems), read.problems


@pytest.mark.parametrize("order", ["<", ">"])
def test_mat_of_either_byte_order(tmp_path: Path, order: str) -> None:
    """Version 5, written by hand: a vector of doubles stored as small integers, as MATLAB does."""

    def element(kind: int, data: bytes) -> bytes:
        if len(data) <= 4:
            return struct.pack(f"{order}I", len(data) << 16 | kind) + data.ljust(4, b"\0")
        return struct.pack(f"{order}II", kind, len(data)) + data + bytes(-len(data) % 8)

    def vector(name: bytes, values: list[int]) -> bytes:
        body = element(6, struct.pack(f"{order}II", 6, 0)) + element(5, struct.pack(f"{order}ii", len(values), 1))
        body += element(1, name) + element(3, struct.pack(f"{order}{len(values)}h", *values))
        return struct.pack(f"{order}II", 14, len(body)) + body

    header = b"MATLAB 5.0".ljust(124) + struct.pack(f"{order}H", 0x100) + (b"IM" if order == "<" else b"MI")
    path = tmp_path / "x.mat"
    variables = vector(b"time_s", [0, 1, 2]) + vector(b"vir", [-3, 300, 7])
    path.write_bytes(header + variables)
    read = fh.recordings.read(path)
    assert read["vir"].tolist() == [-3.0, 300.0, 7.0]
    packed = zlib.compress(variables[: len(variables) // 2 + 3])
    path.write_bytes(header + struct.pack(f"{order}II", 15, len(packed)) + packed + variables)
    read = fh.recordings.read(path)
    assert read["vir"].tolist() == [-3.0, 300.0, 7.0]


def test_mat_of_version_4(tmp_path: Path) -> None:
    path, torque = tmp_path / "x.mat", [0.0, 1.0, 4.0, 9.0, 16.0]
    content = {"time_s": np.arange(5.0), "torque": np.array(torque), "gain": 7.0, "note": "hello", "z": np.ones(5) * 1j}
    scipy.io.savemat(path, content, format="4", oned_as="row")
    read = fh.recordings.read(path)
    assert list(read.columns) == ["time_s", "torque"]
    assert read["torque"].tolist() == torque
    path.write_bytes(path.read_bytes()[:120])
    assert "cut off in the variable at byte" in fh.recordings.read(path).problems[0]
    fh.recordings.write(path, sample(40), overwrite=True)
    path.write_bytes(path.read_bytes()[:-20])
    read = fh.recordings.read(path)  # version 5: what stands before the cut
    assert list(read.columns) == ["time_s", "position", "torque"]
    assert "cut off in the variable at byte" in read.problems[0]


def test_what_a_format_cannot_hold_is_refused(tmp_path: Path) -> None:
    late = Recording("", "x", {"time_s": np.array([0.0, 1.7e18])})
    with pytest.raises(RecordingError, match="is it in seconds"):
        fh.recordings.write(tmp_path / "x.mcap", late)


ODD_NAMES = {"Speed (rpm)": (".mat", ".mcap"), "a/b": (".h5",), "a\\b": (".npz",), "_x": (".mat",)}


@pytest.mark.parametrize(("name", "suffix"), [(name, each) for name, given in ODD_NAMES.items() for each in given])
def test_names_that_a_format_cannot_have(tmp_path: Path, name: str, suffix: str) -> None:
    odd = Recording("", "x", {"time_s": np.arange(3.0), name: np.ones(3)})
    with pytest.raises(RecordingError, match=rf"'{name[0]}.*rename with --column"):
        fh.recordings.write(tmp_path / f"x{suffix}", odd)
    assert not (tmp_path / f"x{suffix}").exists()


@pytest.mark.parametrize(("package", "suffix"), [("pyarrow", ".parquet"), ("h5py", ".h5"), ("asammdf", ".mf4")])
def test_a_package_that_is_not_installed(package, suffix, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    fh.recordings.write(tmp_path / f"x{suffix}", sample())
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(UsageError, match=rf'{package} .*pip install "friction-hil\[formats\]"'):
        fh.recordings.read(tmp_path / f"x{suffix}")
    with pytest.raises(UsageError, match=package):
        fh.recordings.write(tmp_path / f"y{suffix}", sample())


def test_parquet_of_other_programs(tmp_path: Path) -> None:
    pa = pytest.importorskip("pyarrow")
    from pyarrow import parquet

    start = datetime(2026, 1, 2)
    content: dict[str, Any] = {
        "when": [start + timedelta(milliseconds=i) for i in range(4)],
        "counts": pa.array([1, None, 3, 4], pa.int32()),
        "on": [True, False, True, True],
        "single": pa.array([0.5, 1.5, 2.5, 3.5], pa.float32()),
        "note": ["a", "b", "c", "d"],
    }
    parquet.write_table(pa.table(content), tmp_path / "x.parquet")
    read = fh.recordings.read(tmp_path / "x.parquet", columns={"time_s": "when"})
    np.testing.assert_allclose(read["time_s"], [0.0, 1e-3, 2e-3, 3e-3])
    np.testing.assert_array_equal(read["counts"], [1.0, np.nan, 3.0, 4.0])
    np.testing.assert_array_equal(read["on"], [1.0, 0.0, 1.0, 1.0])
    np.testing.assert_array_equal(read["single"], [0.5, 1.5, 2.5, 3.5])
    assert "note holds string, no numbers: left out" in read.problems


def test_hdf5_of_other_programs(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "x.h5", "w") as file:
        file["x/time"] = np.arange(4.0)
        file["x/effort"] = np.arange(4, dtype=np.int16)[None, :]
        file["x/effort"].attrs["units"] = "Nm"
        file["y/effort"] = np.ones(4)
        file["calibration"] = np.arange(9.0)
        file["gain"] = 3.0
        file["log"] = np.array([(0.0, 1), (1.0, 2), (2.0, 3), (3.0, 4)], dtype=[("s", "f8"), ("speed", "i4")])
    read = fh.recordings.read(tmp_path / "x.h5", columns={"time_s": "time", "torque": "x/effort"})
    assert set(read.columns) == {"time_s", "torque", "y/effort", "s", "speed"}
    assert read["torque"].tolist() == [0.0, 1.0, 2.0, 3.0]
    assert read["speed"].tolist() == [1.0, 2.0, 3.0, 4.0]
    assert read.units["torque"] == "Nm"
    assert read.problems == ["calibration has 9 values, the other columns 4: left out"]


def test_hdf5_with_what_is_no_column_and_open_elsewhere(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "x.h5", "w") as file:
        file["time_s"], file["big"] = np.arange(3.0), np.arange(3, dtype=">f8")[:, None]
        file.create_dataset("torque", data=np.arange(3.0), chunks=(2,), compression="gzip")
        file["torque"].attrs["gain"] = 2.0
        file["nothing"], file["text"], file["type"] = h5py.Empty("f8"), ["a", "b", "c"], np.dtype("f8")
        file["soft"] = h5py.SoftLink("/torque")
        file.create_group("empty")
        file.flush()
        read = fh.recordings.read(tmp_path / "x.h5")
    assert {name: values.tolist() for name, values in read.columns.items()} == {
        name: [0.0, 1.0, 2.0] for name in ("time_s", "big", "torque")
    }
    assert (read.problems, read.units) == ([], {})


def test_matlab_7_3_is_hdf5(tmp_path: Path) -> None:
    h5py = pytest.importorskip("h5py")
    path = tmp_path / "x.mat"
    with h5py.File(path, "w", userblock_size=512) as file:
        file["time_s"], file["torque"] = np.arange(5.0)[None, :], np.ones((1, 5))
        file["#refs#/a"] = np.arange(5.0)
    with path.open("r+b") as opened:
        opened.write(b"MATLAB 7.3 MAT-file, Platform: GLNXA64".ljust(124) + b"\x00\x02IM")
    read = fh.recordings.read(path)
    assert set(read.columns) == {"time_s", "torque"}
    path.write_bytes(path.read_bytes()[:1500])
    with pytest.raises(RecordingError, match=r"which is HDF5: .*cut off at byte 1500"):
        fh.recordings.read(path)


def test_mdf_with_groups_of_their_own_times(tmp_path: Path) -> None:
    asammdf = pytest.importorskip("asammdf")
    fast, slow = np.arange(10) * 0.1, np.arange(3) * 0.3 + 0.05
    with asammdf.MDF(version="4.10") as mdf:
        mdf.append([asammdf.Signal(fast * 2.0, fast, name="pos", unit="rad")])
        mdf.append([asammdf.Signal(slow * 3.0, slow, name="effort", unit="Nm")])
        mdf.save(str(tmp_path / "x.mf4"))
    read = fh.recordings.read(tmp_path / "x.mf4", columns={"position": "pos", "torque": "effort"})
    np.testing.assert_allclose(read["time_s"], np.sort(np.concatenate([fast, slow])))
    known = np.isfinite(read["torque"])
    np.testing.assert_allclose(read["torque"][known], slow * 3.0)
    np.testing.assert_allclose(read["position"][~known], fast * 2.0)
    assert read.problems[0].startswith("2 groups of channels have time stamps of their own: merged")


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ({"a": 1}, "a list of rows belongs here"),
        ([], "a list of rows belongs here"),
        ([{"time_s": 0}, 7], "row 1 is not an object of fields but 7"),
        ({"rows": [{"t": 0.0}, {"t": 1.0}]}, r"no column time_s\. There are: t"),
    ],
)
def test_json_that_is_no_recording(tmp_path: Path, content: Any, message: str) -> None:
    (tmp_path / "x.json").write_text(json.dumps(content))
    with pytest.raises(RecordingError, match=message):
        fh.recordings.read(tmp_path / "x.json")


def test_json_of_other_programs(tmp_path: Path) -> None:
    rows = [{"time_s": 0.0, "on": True, "note": "a"}, {"time_s": 1, "torque": None, "on": False}]
    (tmp_path / "x.json").write_text(json.dumps({"mass": 0.5, "short": rows[:1], "entries": rows}))
    read = fh.recordings.read(tmp_path / "x.json")
    assert read.metadata == {"mass": 0.5}
    assert read["on"].tolist() == [1.0, 0.0]
    assert np.isnan(read.columns["torque"]).all()
    assert read.problems == [
        "the list 'short' is shorter than 'entries': left out",
        'note is no number in row 0 but "a": left out',
    ]
    (tmp_path / "x.json").write_text('[\n{"time_s": 0.0},\n{"time_s": oops},\n{"time_s": 2.0}\n]')
    with pytest.raises(RecordingError, match=r"x\.json:3: is no JSON: .*column 12"):
        fh.recordings.read(tmp_path / "x.json")


@pytest.mark.skipif(not BAM.exists(), reason="the shared data are not here")
def test_bam_is_read_as_it_is() -> None:
    for path in sorted(BAM.glob("*.json")):
        read = fh.recordings.read(path, columns={"time_s": "timestamp", "velocity": "speed"})
        rows = json.loads(path.read_text())["entries"]
        assert len(read) == len(rows)
        assert read["position"][-1] == rows[-1]["position"]
        assert read.metadata["mass"] == 0.49


@pytest.mark.parametrize(
    ("text", "source", "factor"),
    [
        ("vir*35.1507", "vir", 35.1507),
        ("encoder*2*pi/4096", "encoder", 2.0 * np.pi / 4096.0),
        ("a * -1e-3", "a", -1e-3),
        ("plain", "plain", 1.0),
        ("x/effort", "x/effort", 1.0),
        ("Speed (rpm)*pi/30", "Speed (rpm)", np.pi / 30.0),
        ("x/effort/2", "x/effort", 0.5),
    ],
)
def test_a_source_with_a_factor(text: str, source: str, factor: float) -> None:
    assert parse_source(text) == (source, pytest.approx(factor, rel=1e-15))


@pytest.mark.parametrize("text", ["a*0", "a/0", "a*1e999", "a*1e-200*1e-200"])
def test_a_factor_that_is_none(text: str) -> None:
    with pytest.raises(UsageError, match="finite and not zero"):
        parse_source(text)


def test_a_mapping_lies_beside_the_file(tmp_path: Path) -> None:
    (tmp_path / "x.csv").write_text("t,qm,effort\n0,1,2\n1,3,4\n")
    beside = tmp_path / "x.csv.columns.yaml"
    beside.write_text("columns:\n  time_s: t\n  torque: effort*0.5\n")
    read = fh.recordings.read(tmp_path / "x.csv")
    assert read["torque"].tolist() == [1.0, 2.0]
    again = fh.recordings.read(tmp_path / "x.csv", columns={"torque": "qm"})  # goes before it, without its factor
    assert again["torque"].tolist() == [1.0, 3.0]
    beside.rename(tmp_path / "columns.yaml")
    assert fh.recordings.read(tmp_path / "x.csv")["torque"].tolist() == [1.0, 2.0]
    (tmp_path / "y.csv").write_text("time_s,torque\n0,7\n")  # of another origin: nothing to map
    assert fh.recordings.read(tmp_path / "y.csv", only=["time_s", "torque"])["torque"].tolist() == [7.0]


@pytest.mark.parametrize(
    ("text", "line", "message"),
    [
        ("column: {}\n", 1, "columns: is missing"),
        ("columns:\n  torque: 7\n", 2, "columns.torque: is a column's name"),
        ("columns:\n  time_s: t\n  torque: a*0\n", 3, "finite and not zero"),
        ("columns: {torque: a}\nscale: 3\n", 2, "scale: is not known here"),
    ],
)
def test_mistakes_in_a_mapping_have_their_line(tmp_path: Path, text: str, line: int, message: str) -> None:
    (tmp_path / "x.csv").write_text("t\n0\n")
    (tmp_path / "x.csv.columns.yaml").write_text(text)
    with pytest.raises(ConfigurationError) as caught:
        fh.recordings.read(tmp_path / "x.csv")
    assert f"x.csv.columns.yaml:{line}: " in str(caught.value)
    assert message in str(caught.value)
