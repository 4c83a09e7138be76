"""Tables of other programs: matrices, text without names, a sampling rate, and files side by side."""

import json
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.io import savemat

import friction_hil as fh
from friction_hil.cli import main
from friction_hil.errors import ConfigurationError, RecordingError, UsageError
from friction_hil.models.files import load_model_file
from friction_hil.recordings.matrices import array_of, column_indices, without_blanks

TIME = np.arange(300) / 100.0
JOINTS = np.stack([np.sin(TIME + i) for i in range(3)], axis=1)
FRAME = np.arange(16.0).reshape(4, 4)


def _hdf5(path: Path, **arrays: np.ndarray) -> None:
    h5py = pytest.importorskip("h5py", reason="the extra 'formats' is not installed")
    with h5py.File(path, "w") as file:
        for name, values in arrays.items():
            file[name] = values


def _matlab_7_3(path: Path, **arrays: np.ndarray) -> None:
    """A file as MATLAB writes it: HDF5 behind a header of 512 bytes, with transposed matrices."""
    h5py = pytest.importorskip("h5py", reason="the extra 'formats' is not installed")
    with h5py.File(path, "w", userblock_size=512) as file:
        for name, values in arrays.items():
            file[name] = np.atleast_2d(values.T)
    with path.open("r+b") as opened:
        opened.write(b"MATLAB 7.3 MAT-file".ljust(128))


def _json(path: Path, **arrays: np.ndarray) -> None:
    rows = [{name: values[i].tolist() for name, values in arrays.items() if len(values) == 300} for i in range(300)]
    path.write_text(json.dumps(rows))


WRITERS = {
    "x.npz": lambda path, **arrays: np.savez(path, **arrays),
    "x.mat": lambda path, **arrays: savemat(path, arrays),
    "x4.mat": lambda path, **arrays: savemat(path, arrays, format="4"),
    "x73.mat": _matlab_7_3,
    "x.h5": _hdf5,
    "x.json": _json,
}


@pytest.mark.parametrize("name", WRITERS)
def test_a_column_of_a_matrix_is_read_from_every_format_that_has_them(tmp_path: Path, name: str) -> None:
    """Small matrices beside it, more of them than signals, do not make the recording short."""
    WRITERS[name](tmp_path / name, t=TIME, q=JOINTS, tau=2.0 * JOINTS, a=FRAME, b=FRAME, c=FRAME, d=FRAME)
    columns = {"time_s": "t", "position": "q[:, 1]", "torque": "tau[:,2]*0.5"}
    read = fh.recordings.read(tmp_path / name, columns=columns)
    np.testing.assert_array_equal(read["time_s"], TIME)
    np.testing.assert_array_equal(read["position"], JOINTS[:, 1])
    np.testing.assert_array_equal(read["torque"], JOINTS[:, 2])
    np.testing.assert_array_equal(read["q[:,2]"], JOINTS[:, 2])
    only = fh.recordings.read(tmp_path / name, columns=columns, only=["time_s", "position"])
    assert list(only.columns) == ["time_s", "position"]
    np.testing.assert_array_equal(only["position"], JOINTS[:, 1])
    assert "q[:,0]" in only.others or "q" in only.others
    with pytest.raises(UsageError, match=r"--column position=q\[:,7\]: did you mean 'q\[:,.\]'"):
        fh.recordings.read(tmp_path / name, columns={"time_s": "t", "position": "q[:,7]"})


@pytest.mark.parametrize("name", ["x.npz", "x.mat", "x.h5"])
def test_time_may_run_along_the_rows_of_a_matrix(tmp_path: Path, name: str) -> None:
    WRITERS[name](tmp_path / name, time_s=TIME, q=JOINTS.T.copy())
    read = fh.recordings.read(tmp_path / name, columns={"position": "q[2,:]"})
    np.testing.assert_array_equal(read["position"], JOINTS[:, 2])


def test_what_is_no_matrix_of_columns_is_left_out_and_said(tmp_path: Path) -> None:
    np.savez(tmp_path / "x.npz", time_s=TIME, image=np.zeros((300, 300)), box=np.zeros((300, 2, 2)), frame=FRAME)
    read = fh.recordings.read(tmp_path / "x.npz")
    assert list(read.columns) == ["time_s"]
    assert "image is float64 of shape (300, 300), no column: left out" in read.problems
    assert "frame has 4 values, the other columns 300: left out" in read.problems


@given(st.integers(2, 300), st.integers(1, 300), st.text(min_size=1))
def test_each_value_of_a_matrix_is_in_one_column(rows: int, columns: int, name: str) -> None:
    array = np.arange(rows * columns).reshape(rows, columns)
    found = column_indices(name, array.shape)
    assert bool(found) == (min(rows, columns) <= 256)
    if found:
        assert sorted(np.concatenate([array[index] for index in found.values()])) == list(range(rows * columns))
        assert {array_of(column) for column in found} <= {name, array_of(name)}
        assert {without_blanks(column) for column in found} == {without_blanks(column) for column in set(found)}


@pytest.mark.parametrize(
    ("text", "names"),
    [
        ("0 1.5\n0.01 2\n", ["column1", "column2"]),
        ("  0    1.5 \n 0.01   2\n", ["column1", "column2"]),
        ("0\t1.5\n0.01\t2\n", ["column1", "column2"]),
        ("0,1.5\n0.01,2\n", ["column1", "column2"]),
        ("0;1,5\n0,01;2\n", ["column1", "column2"]),
        ("0,0 1,5\n0,01 2,0\n", ["column1", "column2"]),
        ("t q\n0 1.5\n0.01 2\n", ["t", "q"]),
        ('t "motor angle"\n0 1.5\n0.01 2\n', ["t", "motor angle"]),
        ("# made by\n# t q\n0 1.5\n0.01 2\n", ["t", "q"]),
        ("% t, q\n0 1.5\n0.01 2\n", ["t", "q"]),
        ("# t,q\n0,1.5\n0.01,2\n", ["t", "q"]),
        ("# only a remark of five words\n0 1.5\n0.01 2\n", ["column1", "column2"]),
        ("# 300 100\n0 1.5\n0.01 2\n", ["column1", "column2"]),
    ],
)
@pytest.mark.parametrize("suffix", [".txt", ".csv", ".dat", ".tsv"])
def test_text_of_other_programs(tmp_path: Path, text: str, names: list[str], suffix: str) -> None:
    path = tmp_path / f"x{suffix}"
    path.write_text(text)
    read = fh.recordings.read(path, columns={"time_s": names[0], "position": names[1]})
    np.testing.assert_array_equal(read["time_s"], [0.0, 0.01])
    np.testing.assert_array_equal(read["position"], [1.5, 2.0])


def test_what_numpy_writes_is_read_bit_for_bit(tmp_path: Path) -> None:
    np.savetxt(tmp_path / "x.txt", np.column_stack([TIME, JOINTS]), header="time_s a b c")
    read = fh.recordings.read(tmp_path / "x.txt")
    np.testing.assert_array_equal(np.column_stack([read[name] for name in "abc"]), JOINTS)
    (tmp_path / "x.txt").write_text("motor angle\n1\n2\n")  # the name of one column may have blanks
    np.testing.assert_array_equal(fh.recordings.read(tmp_path / "x.txt", rate_hz=2.0)["motor angle"], [1.0, 2.0])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("Hello world\nthis is no table\n", r"x.txt:2: 4 fields, but the header names 2"),
        ("0 1\n1 2 3\n", r"x.txt:2: 3 fields, but the first row has 2"),
        ("0 1\n1 fast\n", r"x.txt:2: column2: 'fast' is not a number"),
        ("  \n\n", r"x.txt is empty"),
        ("# a b\n", r"x.txt is empty"),
    ],
)
def test_text_that_is_no_table_says_where(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "x.txt").write_text(text)
    with pytest.raises(RecordingError, match=message):
        fh.recordings.read(tmp_path / "x.txt", rate_hz=10.0)


def test_a_rate_takes_the_place_of_time_stamps(tmp_path: Path) -> None:
    path = tmp_path / "x.txt"
    np.savetxt(path, JOINTS)
    with pytest.raises(RecordingError, match="a recording without time stamps takes --rate HZ"):
        fh.recordings.read(path)
    read = fh.recordings.read(path, columns={"position": "column2"}, rate_hz=100.0, only=["time_s", "position"])
    np.testing.assert_allclose(read["time_s"], TIME, atol=1e-15)
    np.testing.assert_array_equal(read["position"], JOINTS[:, 1])
    (tmp_path / "x.txt.columns.yaml").write_text("rate_hz: 100\ncolumns: {position: column2}\n")
    np.testing.assert_array_equal(fh.recordings.read(path)["time_s"], read["time_s"])
    np.testing.assert_array_equal(fh.recordings.read(path, rate_hz=50.0)["time_s"], 2.0 * read["time_s"])


def test_a_rate_beside_time_stamps_is_one_too_many(tmp_path: Path) -> None:
    path = tmp_path / "x.csv"
    path.write_text("time_s,position\n0,1\n5,2\n")
    read = fh.recordings.read(path, rate_hz=100.0)
    np.testing.assert_array_equal(read["time_s"], [0.0, 0.01])
    assert "time_s of the file is not used: time stamps are those of 100 Hz" in read.problems
    with pytest.raises(UsageError, match="--rate and --column time_s=t: the time stamps have one source"):
        fh.recordings.read(path, columns={"time_s": "t"}, rate_hz=100.0)
    for rate in (0.0, -1.0, np.nan, np.inf):
        with pytest.raises(UsageError, match="a sampling rate is a number of Hz above 0"):
            fh.recordings.read(path, rate_hz=rate)
    for text in ("rate_hz: fast\n", "rate_hz: -1\n", "columns: {time_s: t}\nrate_hz: 100\n"):
        (tmp_path / "x.csv.columns.yaml").write_text(text)
        with pytest.raises(ConfigurationError, match=r"x.csv.columns.yaml:\d: rate_hz: "):
            fh.recordings.read(path)


def test_files_side_by_side_are_joined_row_by_row_or_at_their_times(tmp_path: Path) -> None:
    position, torque = tmp_path / "position.csv", tmp_path / "torque.txt"
    np.savetxt(position, np.column_stack([TIME, JOINTS[:, 0]]), header="t,q", delimiter=",", comments="")
    np.savetxt(torque, JOINTS[:, 1])
    rows = fh.recordings.read(position, columns={"time_s": "t", "position": "q", "torque": "torque.txt:column1*2"})
    np.testing.assert_array_equal(rows["torque"], 2.0 * JOINTS[:, 1])
    later = TIME[5::2] + 0.003
    np.savetxt(tmp_path / "later.dat", np.column_stack([later, 3.0 * later + 1.0]), header="t tau")
    joined = fh.recordings.read(position, columns={"time_s": "t", "position": "q", "torque": "later.dat:tau"})
    is_known = (later[0] <= TIME) & (later[-1] >= TIME)
    np.testing.assert_allclose(joined["torque"][is_known], 3.0 * TIME[is_known] + 1.0)
    assert np.isnan(joined["torque"][~is_known]).all()
    assert "later.dat:tau is interpolated at the times of t" in joined.problems


def test_a_file_beside_is_not_opened_for_a_column_that_is_not_asked_for(tmp_path: Path) -> None:
    np.savez(tmp_path / "q.npz", time_s=TIME, position=JOINTS[:, 0])
    columns = {"position_demand": "none.npz:q*2", "torque": "none.npz:tau"}
    read = fh.recordings.read(tmp_path / "q.npz", columns=columns, only=["time_s", "position"])
    assert list(read.columns) == ["time_s", "position"]


def test_single_arrays_of_numpy_are_joined(tmp_path: Path) -> None:
    np.save(tmp_path / "q.npy", JOINTS)
    np.save(tmp_path / "tau.npy", JOINTS[:, 0])
    read = fh.recordings.read(
        tmp_path / "q.npy", columns={"position": "q[:,2]", "torque": "tau.npy:tau"}, rate_hz=100.0
    )
    np.testing.assert_array_equal(read["position"], JOINTS[:, 2])
    np.testing.assert_array_equal(read["torque"], JOINTS[:, 0])
    np.save(tmp_path / "objects.npy", np.array([{}, {}]), allow_pickle=True)
    np.save(tmp_path / "cube.npy", np.zeros((3, 3, 3)))
    (tmp_path / "cut.npy").write_bytes((tmp_path / "q.npy").read_bytes()[:500])
    for name, message in (("objects", "Python objects"), ("cube", r"shape \(3, 3, 3\)"), ("cut", "claims 900 values")):
        with pytest.raises(RecordingError, match=message):
            fh.recordings.read(tmp_path / f"{name}.npy", rate_hz=100.0)


def test_time_stamps_may_come_from_a_file_beside(tmp_path: Path) -> None:
    np.save(tmp_path / "q.npy", JOINTS[:, 0])
    np.save(tmp_path / "t.npy", TIME)
    read = fh.recordings.read(tmp_path / "q.npy", columns={"time_s": "t.npy:t", "position": "q"})
    np.testing.assert_array_equal(read["time_s"], TIME)
    np.save(tmp_path / "t.npy", TIME[:-1])
    with pytest.raises(RecordingError, match="without a column of time stamps in both they are joined row by row"):
        fh.recordings.read(tmp_path / "q.npy", columns={"time_s": "t.npy:t", "position": "q"})


def test_a_gap_in_a_file_beside_is_not_bridged(tmp_path: Path) -> None:
    np.savez(tmp_path / "q.npz", time_s=TIME, position=JOINTS[:, 0])
    kept = (TIME < 1.0) | (TIME > 2.0)
    np.savez(tmp_path / "tau.npz", time_s=TIME[kept], tau=JOINTS[kept, 1])
    torque = fh.recordings.read(tmp_path / "q.npz", columns={"torque": "tau.npz:tau"})["torque"]
    np.testing.assert_array_equal(np.isnan(torque), (TIME > 0.995) & (TIME < 2.005) & ~kept)


@pytest.mark.parametrize(
    ("source", "error", "message"),
    [
        ("none.csv:u", UsageError, "no file none.csv"),
        ("short.csv:v", UsageError, "short.csv: there is no column 'v'; there are: u"),
        ("short.csv:u", RecordingError, "short.csv has 2 rows and .*x.csv has 3: .* time stamps t"),
        ("late.csv:u", RecordingError, "late.csv: .* t is 9 to 11 there, 0 to 2"),
        ("short.exe:u", UsageError, "there are: q, t"),
        ("broken.csv:u", RecordingError, "broken.csv:2: u: 'fast' is not a number"),
    ],
)
def test_mistakes_with_a_file_beside_are_one_sentence(tmp_path, source, error, message):
    for name, text in {
        "x.csv": "t,q\n0,1\n1,1\n2,1\n",
        "short.csv": "u\n1\n2\n",
        "late.csv": "t,u\n9,1\n10,2\n11,3\n",
        "broken.csv": "u\nfast\n",
    }.items():
        (tmp_path / name).write_text(text)
    with pytest.raises(error, match=message):
        fh.recordings.read(tmp_path / "x.csv", columns={"time_s": "t", "torque": source})


def test_commands_take_a_rate_and_a_file_beside(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    time = np.arange(3000) * 2e-3
    velocity = np.cos(2.0 * np.pi * 0.9 * time) + 0.4 * np.cos(2.0 * np.pi * 2.3 * time + 1.0)
    position = np.cumsum(velocity) * 2e-3
    torque = 0.3 * np.sign(velocity) + 0.05 * velocity + 0.02 * np.gradient(velocity, 2e-3)
    np.savetxt("position.txt", position)
    np.savetxt("torque.txt", torque)
    columns = ["--rate", "500", "--column", "position=column1", "--column", "torque=torque.txt:column1"]
    assert main(["identify", "position.txt", *columns, "--models", "coulomb", "--output", "axis.yaml"]) == 0
    assert load_model_file("axis.yaml").friction.parameters["coulomb"] == pytest.approx(0.3, rel=0.03)
    capsys.readouterr()
    assert main(["replay", "position.txt", *columns, "--model", "axis.yaml", "--json"]) == 0
    (recording,) = json.loads(capsys.readouterr().out)["recordings"]
    assert recording["models"][0]["relative_error"] < 0.1
    np.savez("joints.npz", q=np.stack([torque, position], axis=1), tau=np.stack([position, torque], axis=1))
    columns = ["--rate", "500", "--column", "position=q[:,1]", "--column", "torque=tau[:,1]"]
    assert main(["convert", "joints.npz", "joint.csv", *columns]) == 0
    np.testing.assert_array_equal(fh.recordings.read("joint.csv")["torque"], torque)
    assert main(["convert", "--info", "position.txt", "--rate", "0"]) == 2
    assert "--rate" in capsys.readouterr().err
