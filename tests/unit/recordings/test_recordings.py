"""Recordings in CSV and .mat, the choice of axes and columns, and the checks that every format goes through."""

import re
import sys
import warnings
from pathlib import Path
from types import FrameType

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.io import savemat

import friction_hil as fh
from friction_hil.cli.work.read import read_recordings
from friction_hil.errors import RecordingError, UsageError
from friction_hil.recordings import columns
from friction_hil.recordings.csv_file import _by_arrow
from friction_hil.recordings.quality import LARGEST, too_large, without_overflow
from friction_hil.recordings.recording import Recording

EMPS = Path(__file__).parents[4] / "shared" / "data" / "emps" / "DATA_EMPS.mat"


def csv(folder: Path, text: str) -> Path:
    path = folder / "bench.csv"
    path.write_text(text, encoding="utf-8")
    return path


def recording(**values: list[float]) -> Recording:
    return Recording("bench", "x", {name: np.array(column, dtype=float) for name, column in values.items()})


def test_a_csv_goes_the_way_that_the_code_overview_says(tmp_path: Path) -> None:
    overview = (Path(fh.__file__).parent / "README.md").read_text(encoding="utf-8")
    (told,) = re.findall(r"^A CSV passes.*?nested as (.*?)\. ", overview, re.MULTILINE | re.DOTALL)
    path = csv(tmp_path, "time_s,position,torque\n0,0.5,1e-3\n0.001,0.25,-2\n")
    ways: list[list[str]] = []

    def watch(frame: FrameType, event: str, _: object) -> None:
        if event == "call" and frame.f_code is _by_arrow.__code__:
            way = []
            caller: FrameType | None = frame
            while caller is not None:
                way.insert(0, caller.f_code.co_name)
                caller = caller.f_back
            ways.append([each for each in way[way.index("read_recordings") :] if not each.startswith("<")])

    before = sys.getprofile()
    sys.setprofile(watch)
    try:
        read_recordings([path], None)
    finally:
        sys.setprofile(before)
    assert ways == [re.findall(r"`(\w+)`", told)]


def test_csv_is_read_by_its_header(tmp_path: Path) -> None:
    read = fh.recordings.read(csv(tmp_path, "time_s,position,torque\n0,0.5,1e-3\n0.001,0.25,-2\n"))
    assert read.axis == "bench"
    np.testing.assert_array_equal(read["position"], [0.5, 0.25])
    np.testing.assert_array_equal(read["torque"], [1e-3, -2.0])
    assert (len(read), read.duration_s, read.period_s, read.problems) == (2, 0.001, 0.001, [])


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
        ("", "is empty"),
        ("time_s,position\n", "no rows"),
        ("0,1\n1,2\n", "no column time_s. There are: column1, column2. .*--column time_s=NAME"),
        ("0,1\n1,2,3\n", "bench.csv:2: 3 fields, but the first row has 2"),
        ("time_s,position\n0,1\n1,fast\n", "bench.csv:3: position: 'fast' is not a number"),
        ('time_s,position\n0,1\n1,"0,5"\n', "bench.csv:3: position: '0,5' is not a number; decimal commas need semi"),
        ("time_s;position\n0;1,5\n1;0.5\n", "bench.csv:3: has a decimal point; lines before, a comma"),
        ("time_s;position\n0;1.234,5\n", "bench.csv:2: position: '1.234,5' is not a number"),
        ("time_s,position\n0,1\n1\n", "bench.csv:3: 1 fields, but the header names 2"),
        ("time_s,position\n0,1,2\n1,1,2\n", "bench.csv:2: 3 fields, but the header names 2"),
        ("t,position\n0,1\n", "no column time_s. There are: t, position. .*--column time_s=NAME"),
        ("time_s,position\nnan,1\n0,1\n", r"time_s is not finite in 1 of 2 rows \(row 0\)"),
        ("time_s,position\n1_0,1\n", "'1_0' is not a number"),
    ],
)
def test_csv_that_cannot_be_read_says_where(tmp_path: Path, text: str, message: str) -> None:
    with pytest.raises(RecordingError, match=message):
        fh.recordings.read(csv(tmp_path, text))


def test_binary_file_called_csv(tmp_path: Path) -> None:
    (tmp_path / "x.csv").write_bytes(b"time_s\n\xff\xfe\n")
    with pytest.raises(RecordingError, match=r"not a UTF-8 text file \(byte 7\)"):
        fh.recordings.read(tmp_path / "x.csv")


def test_files_that_are_not_there_or_not_known(tmp_path: Path) -> None:
    with pytest.raises(RecordingError, match=r"nothing\.csv cannot be read: No such file or directory"):
        fh.recordings.read(tmp_path / "nothing.csv")
    with pytest.raises(UsageError, match=r"There are: \.asc, \.bag, \.blf, \.csv, .*\.parquet"):
        fh.recordings.read(tmp_path / "x.parket")
    with pytest.raises(RecordingError, match="cannot be read"):
        fh.recordings.read(tmp_path / "nothing.mat")


def test_columns_are_mapped_then_scaled(tmp_path: Path) -> None:
    path = csv(tmp_path, "t,qm,effort,torque\n0,1,2,99\n1,3,4,99\n")
    read = fh.recordings.read(
        path, columns={"time_s": "t", "position": "qm", "torque": "effort"}, scale={"torque": 0.5}
    )
    assert list(read.columns) == ["time_s", "position", "torque"]
    np.testing.assert_array_equal(read["torque"], [1.0, 2.0])


def test_one_source_may_serve_two_columns(tmp_path: Path) -> None:
    read = fh.recordings.read(csv(tmp_path, "time_s,x\n0,1\n1,3\n"), columns={"position": "x", "position_demand": "x"})
    np.testing.assert_array_equal(read["position"], read["position_demand"])


def test_wrong_mapping_or_scale_is_wrong_use(tmp_path: Path) -> None:
    path = csv(tmp_path, "time_s,effort\n0,1\n1,2\n")
    with pytest.raises(UsageError, match="did you mean 'effort'"):
        fh.recordings.read(path, columns={"torque": "efort"})
    with pytest.raises(UsageError, match="--scale torque: there are: effort, time_s"):
        fh.recordings.read(path, scale={"torque": 2.0})
    for factor in (0.0, np.inf, np.nan):
        with pytest.raises(UsageError, match="finite and not zero"):
            fh.recordings.read(path, scale={"effort": factor})
    with pytest.raises(UsageError, match="too large"):
        fh.recordings.read(csv(tmp_path, "time_s,effort\n0,1\n1,200\n"), scale={"effort": 1e307})


def test_name_of_the_axis(tmp_path: Path) -> None:
    path = csv(tmp_path, "time_s,position\n0,1\n1,2\n")
    assert fh.recordings.read(path, "x").axis == "x"
    assert list(fh.recordings.read_all(path)) == ["bench"]


def test_odd_time_stamps_and_gaps_are_reported(tmp_path: Path) -> None:
    read = fh.recordings.read(csv(tmp_path, "time_s,cycle,torque\n0,0,1\n1,1,inf\n1,2,1\n0.5,5,1\n2,6,1\n3,9,1\n"))
    assert read.problems == [
        "time_s goes backward at 1 of 6 rows (row 3)",
        "time_s stands still at 1 of 6 rows (row 2)",
        "torque is not finite in 1 of 6 rows (row 1)",
        "4 cycles are missing in 2 gaps, the first after cycle 2",
    ]


def test_demand_may_be_unknown_for_a_while_but_not_infinite(tmp_path: Path) -> None:
    read = fh.recordings.read(csv(tmp_path, "time_s,velocity_demand\n0,nan\n1,-inf\n2,1\n"))
    assert read.problems == ["velocity_demand is not finite in 1 of 3 rows (row 1)"]


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


def test_what_cannot_be_written_is_refused(tmp_path: Path) -> None:
    first = recording(time_s=[0, 1], position=[1, 2])
    with pytest.raises(RecordingError, match="cannot be written: No such file or directory"):
        fh.recordings.write(tmp_path / "no" / "x.csv", first)
    with pytest.raises(UsageError, match=r"there are: \.csv, \.h5, .*\.parquet"):
        fh.recordings.write(tmp_path / "x.log", first)


def test_mat_vectors_are_columns(tmp_path: Path) -> None:
    path = tmp_path / "x.mat"
    content = {"time_s": np.arange(3.0), "torque": np.array([[1], [2], [3]], np.int16), "gain": 7.0}
    savemat(path, content | {"note": "hello", "short": np.arange(2.0), "z": np.ones(3) * 1j})
    read = fh.recordings.read(path)
    assert list(read.columns) == ["time_s", "torque"]
    np.testing.assert_array_equal(read["torque"], [1.0, 2.0, 3.0])
    assert read.problems == ["short has 2 values, the other columns 3: left out"]


@given(
    names=st.lists(st.from_regex(r"[a-z]\w{0,30}", fullmatch=True).filter(str.isascii), max_size=4, unique=True),
    data=st.data(),
)
def test_mat_is_read_as_it_was_written(
    tmp_path_factory: pytest.TempPathFactory, names: list[str], data: st.DataObject
) -> None:
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
    savemat(path, {"gain": 7.0})
    with pytest.raises(RecordingError, match="no real vector"):
        fh.recordings.read(path)
    savemat(path, {"time_s": np.arange(100.0)})
    path.write_bytes(path.read_bytes()[:300])
    with pytest.raises(RecordingError, match=r"x\.mat"):
        fh.recordings.read(path)
    path.write_bytes(b"\x89HDF\r\n\x1a\n".rjust(136) + bytes(400))
    with pytest.raises(RecordingError, match=r"x\.mat"):
        fh.recordings.read(path)
    path.write_bytes(b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM" + bytes(400))
    with pytest.raises(RecordingError, match=r"MATLAB 7.3 .*-v7"):
        fh.recordings.read(path)


@pytest.mark.skipif(not EMPS.exists(), reason="the shared data are not here")
def test_emps_is_read_as_it_is() -> None:
    read = fh.recordings.read(
        EMPS, columns={"time_s": "t", "position": "qm", "torque": "vir"}, scale={"torque": 35.150651}
    )
    assert len(read) == 24841
    assert read.period_s == pytest.approx(1e-3, rel=1e-4)
    assert read.problems == []


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
