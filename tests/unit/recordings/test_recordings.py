"""Recordings in CSV and .mat, the choice of axes and columns, and the checks that every format goes through."""

import warnings
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.io import savemat

import friction_hil as fh
from friction_hil.errors import RecordingError, UsageError
from friction_hil.recordings import columns
from friction_hil.recordings.quality import LARGEST, too_large, without_overflow
from friction_hil.recordings.recording import Recording

EMPS = Path(__file__).parents[4] / "shared" / "data" / "emps" / "DATA_EMPS.mat"


def csv(folder: Path, text: str | bytes) -> Path:
    path = folder / "bench.csv"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def recording(**values: list[float]) -> Recording:
    return Recording("bench", "x", {name: np.array(column, dtype=float) for name, column in values.items()})


def test_csv_is_read_by_its_header(tmp_path: Path) -> None:
    path = csv(tmp_path, "time_s,position,torque\n0,0.5,1e-3\n0.001,0.25,-2\n")
    read = fh.recordings.read(path)
    np.testing.assert_array_equal(read["position"], [0.5, 0.25])
    np.testing.assert_array_equal(read["torque"], [1e-3, -2.0])
    assert (len(read), read.duration_s, read.period_s, read.problems) == (2, 0.001, 0.001, [])
    assert (read.axis, *fh.recordings.read_all(path), fh.recordings.read(path, "x").axis) == ("bench", "bench", "x")


@pytest.mark.parametrize(
    "text",
    [
        "# from the bench\ntime_s;position\n0;1\n1;\n",
        "\ufefftime_s\tposition\r\n0\t1\r\n1\tnan\r\n",
        'time_s,"position"\n0,1\n\n1,\n',
    ],
)
def test_csv_of_other_programs(tmp_path: Path, text: str) -> None:
    read = fh.recordings.read(csv(tmp_path, text))
    np.testing.assert_array_equal(read["position"], [1.0, np.nan])
    assert read.problems == ["position is not finite in 1 of 2 rows (row 1)"]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("time_s,position\n", "no rows"),
        ("0,1\n1,2\n", "time_s. .* column1, column2. .*--column time_s=NAME"),
        ("0,1\n1,2,3\n", "bench.csv:2: 3 fields, .* 2"),
        ("time_s,position\n0,1\n1,fast\n", "bench.csv:3: position: 'fast'"),
        ('time_s,position\n0,1\n1,"0,5"\n', "bench.csv:3: position: '0,5' .* decimal commas"),
        ("time_s;position\n0;1,5\n1;0.5\n", "bench.csv:3: .* decimal point"),
        ("time_s;position\n0;1.234,5\n", "bench.csv:2: position: '1.234,5'"),
        ("time_s,position\n0,1\n1\n", "bench.csv:3: 1 fields, .* 2"),
        ("time_s,position\n0,1,2\n1,1,2\n", "bench.csv:2: 3 fields, .* 2"),
        ("t,position\n0,1\n", "time_s. .* t, position. .*--column time_s=NAME"),
        ("time_s,position\nnan,1\n0,1\n", r"time_s .* 1 of 2 rows \(row 0\)"),
        ("time_s,position\n1_0,1\n", "'1_0'"),
        (b"time_s\n\xff\xfe\n", r"UTF-8 .*\(byte 7\)"),
    ],
)
def test_csv_that_cannot_be_read_says_where(tmp_path: Path, text: str | bytes, message: str) -> None:
    with pytest.raises(RecordingError, match=message):
        fh.recordings.read(csv(tmp_path, text))


def test_files_of_no_known_format_are_refused(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"\.asc, \.bag, \.blf, \.csv, .*\.parquet"):
        fh.recordings.read(tmp_path / "x.parket")
    first = recording(time_s=[0, 1], position=[1, 2])
    with pytest.raises(UsageError, match=r"\.csv, \.h5, .*\.parquet"):
        fh.recordings.write(tmp_path / "x.log", first)
    with pytest.raises(RecordingError, match="No such file or directory"):
        fh.recordings.write(tmp_path / "no" / "x.csv", first)


def test_columns_are_mapped_then_scaled(tmp_path: Path) -> None:
    path = csv(tmp_path, "t,qm,effort,torque\n0,1,2,99\n1,3,4,99\n")
    mapped = {"time_s": "t", "position": "qm", "torque": "effort"}
    read = fh.recordings.read(path, columns=mapped, scale={"torque": 0.5})
    assert list(read.columns) == ["time_s", "position", "torque"]
    np.testing.assert_array_equal(read["torque"], [1.0, 2.0])
    twice = fh.recordings.read(path, columns=mapped | {"position_demand": "qm"})
    np.testing.assert_array_equal(twice["position"], twice["position_demand"])


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"columns": {"torque": "efort"}}, "'effort'"),
        ({"scale": {"torque": 2.0}}, "--scale torque: there are: effort, time_s"),
        ({"scale": {"effort": 1e307}}, "too large"),
        *(({"scale": {"effort": factor}}, "finite and not zero") for factor in (0.0, np.inf, np.nan)),
    ],
)
def test_wrong_mapping_or_scale_is_wrong_use(tmp_path: Path, given, message) -> None:
    with pytest.raises(UsageError, match=message):
        fh.recordings.read(csv(tmp_path, "time_s,effort\n0,1\n1,200\n"), **given)


@pytest.mark.parametrize(
    ("text", "problems"),
    [
        (
            "time_s,cycle,torque\n0,0,1\n1,1,inf\n1,2,1\n0.5,5,1\n2,6,1\n3,9,1\n",
            [
                "time_s goes backward at 1 of 6 rows (row 3)",
                "time_s stands still at 1 of 6 rows (row 2)",
                "torque is not finite in 1 of 6 rows (row 1)",
                "4 cycles are missing in 2 gaps, the first after cycle 2",
            ],
        ),
        # a demand may be unknown for a while
        ("time_s,velocity_demand\n0,nan\n1,-inf\n2,1\n", ["velocity_demand is not finite in 1 of 3 rows (row 1)"]),
    ],
)
def test_odd_time_stamps_and_gaps_are_reported(tmp_path: Path, text: str, problems: list[str]) -> None:
    assert fh.recordings.read(csv(tmp_path, text)).problems == problems


def test_absent_column_is_no_problem_but_is_not_there() -> None:
    absent = recording(time_s=[0, 1], temperature=[np.nan, np.nan])
    assert "temperature" not in absent
    with pytest.raises(RecordingError, match=r"no column temperature, torque\. There are: time_s\."):
        absent.require("temperature", "torque")


@given(arrays(np.float64, st.integers(0, 40), elements=st.floats()))
def test_values_that_would_overflow_are_found(values: np.ndarray) -> None:
    expected = [i for i, value in enumerate(values) if np.isfinite(value) and abs(value) > LARGEST]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert too_large(values).tolist() == expected
        kept = without_overflow(values)
    assert np.flatnonzero(np.isnan(kept) & ~np.isnan(values)).tolist() == expected
    others = np.delete(np.arange(len(values)), expected)
    assert kept[others].tobytes() == values[others].tobytes()


def test_mat_vectors_are_columns(tmp_path: Path) -> None:
    path = tmp_path / "x.mat"
    content = {"time_s": np.arange(3.0), "torque": np.array([[1], [2], [3]], np.int16), "gain": 7.0}
    savemat(path, content | {"note": "hello", "short": np.arange(2.0), "z": np.ones(3) * 1j})
    read = fh.recordings.read(path)
    assert list(read.columns) == ["time_s", "torque"]
    np.testing.assert_array_equal(read["torque"], [1.0, 2.0, 3.0])
    assert read.problems == ["short has 2 values, the other columns 3: left out"]


@given(st.lists(st.from_regex(r"[a-z][a-z0-9_]{0,30}", fullmatch=True), max_size=4, unique=True), st.data())
def test_mat_is_read_as_it_was_written(tmp_path_factory, names, data):
    """Whether scipy has compressed it or not."""
    shapes = st.sampled_from([(4, 1), (1, 4), (3, 1), (2, 2), (1, 1), (0, 0)])
    content = {name: data.draw(arrays(np.float64, shapes, elements=st.floats())) for name in names}
    content |= {name: np.arange(4.0)[:, None] for name in ("time_s", "A", "B", "C", "D")}  # the most frequent length
    paths = [tmp_path_factory.mktemp(name) / "x.mat" for name in ("plain", "compressed")]
    for path, is_compressed in zip(paths, (False, True), strict=True):
        savemat(path, content, do_compression=is_compressed)
    plain, compressed = map(fh.recordings.read, paths)
    assert plain.problems == compressed.problems
    assert list(plain.columns) == list(compressed.columns)
    for name, values in plain.columns.items():
        assert values.flags.c_contiguous
        assert values.tobytes() == compressed.columns[name].tobytes() == content[name].tobytes()


def test_mat_that_cannot_be_read(tmp_path: Path) -> None:
    path = tmp_path / "x.mat"
    savemat(path, {"time_s": np.arange(100.0)})
    cut = path.read_bytes()[:300]
    savemat(path, {"gain": 7.0})
    no_hdf = b"\x89HDF\r\n\x1a\n".rjust(136) + bytes(400)
    version_7_3 = b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM" + bytes(400)
    for content, message in (
        (path.read_bytes(), "no real vector"),
        (cut, r"x\.mat"),
        (no_hdf, r"x\.mat"),
        (version_7_3, r"MATLAB 7.3 .*-v7"),
    ):
        path.write_bytes(content)
        with pytest.raises(RecordingError, match=message):
            fh.recordings.read(path)


@pytest.mark.skipif(not EMPS.exists(), reason="the shared data are not here")
def test_emps_is_read_as_it_is() -> None:
    columns = {"time_s": "t", "position": "qm", "torque": "vir"}
    read = fh.recordings.read(EMPS, columns=columns, scale={"torque": 35.150651})
    assert (len(read), read.problems) == (24841, [])
    assert read.period_s == pytest.approx(1e-3, rel=1e-4)


def test_every_column_is_described_once() -> None:
    assert len(set(columns.NAMES)) == len(columns.NAMES)
    assert all(columns.meaning(name) for name in columns.NAMES)
    assert columns.unit("position") == "rad"
    assert columns.unit("torque", "linear") == "N"
    assert columns.unit("shadow_dahl", "linear") == "N"
    assert columns.unit("qm") == columns.meaning("qm") == ""


def test_the_readme_lists_every_column_and_every_format() -> None:
    readme = (Path(fh.recordings.__file__).parent / "README.md").read_text(encoding="utf-8")
    for word in (*columns.NAMES, *fh.recordings.formats()):
        assert f"`{word}`" in readme, word
