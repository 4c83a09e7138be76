"""``friction-hil convert``, as a user types it."""

import json
import os

import numpy as np
import pytest

import friction_hil as fh
from friction_hil.cli import main
from friction_hil.recordings import source
from friction_hil.recordings.mcap_writer import McapWriter

CSV = "time_s,position,torque\n0.0,0.1,1.5\n0.001,0.30000000000000004,-2.0\n"


@pytest.fixture
def two_axes(tmp_path):
    """A recording of the daemon's kind: axes x and y, a gap, an event, states."""
    path = tmp_path / "run.mcap"
    cycles = np.array([0.0, 1.0, 5.0])
    rows = np.stack([cycles * 1e-3, cycles, cycles / 3, cycles], axis=1)
    writer = McapWriter(path, ["x", "y"], ("time_s", "cycle", "position"), state_width=1, metadata={"fingerprint": {}})
    writer.write(np.hstack([rows, rows * [1, 1, -1, 1]]))
    writer.write_event(5.0, "fault", "[red] x: too fast")
    writer.close()
    return path


@pytest.fixture
def table(tmp_path):
    path = tmp_path / "bench.csv"
    path.write_text(CSV)
    return path


def test_csv_to_mcap_and_back_keeps_every_byte(table, tmp_path):
    assert main(["convert", str(table), str(tmp_path / "b.mcap")]) == 0
    assert main(["convert", str(tmp_path / "b.mcap"), str(tmp_path / "c.csv")]) == 0
    assert (tmp_path / "c.csv").read_text() == CSV


def test_each_axis_gets_a_csv_of_its_own(two_axes, tmp_path, capsys):
    assert main(["convert", str(two_axes), str(tmp_path / "out.csv")]) == 0
    output = capsys.readouterr()
    assert output.out == f"{tmp_path}/out_x.csv: 3 rows of 3 columns\n{tmp_path}/out_y.csv: 3 rows of 3 columns\n"
    assert f"{two_axes}: x: 3 cycles are missing in 1 gap, the first after cycle 1\n" in output.err
    y = fh.recordings.read(tmp_path / "out_y.csv")
    np.testing.assert_array_equal(y["position"], -np.array([0, 1, 5]) / 3)


def test_one_axis_is_written_under_the_name_given(two_axes, tmp_path):
    assert main(["convert", str(two_axes), str(tmp_path / "out.csv"), "--axis", "y"]) == 0
    assert fh.recordings.read(tmp_path / "out.csv")["position"][1] == -1 / 3


def test_columns_are_renamed_and_scaled_on_the_way(table, tmp_path):
    out = tmp_path / "out.csv"
    words = ["--column", "current=torque", "--scale", "current=2", "--column", "angle=position"]
    assert main(["convert", str(table), str(out), *words]) == 0
    assert out.read_text().splitlines()[:2] == ["current,angle,time_s", "3.0,0.1,0.0"]


def test_existing_files_are_replaced_only_by_force(two_axes, table, tmp_path, capsys):
    out = tmp_path / "out.mcap"
    out.write_bytes(b"precious")
    assert main(["convert", str(table), str(out)]) == 1
    assert "--force" in capsys.readouterr().err
    assert out.read_bytes() == b"precious"
    assert main(["convert", str(table), str(out), "--force", "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == {"written": [str(out)], "rows": {"bench": 2}}
    (tmp_path / "out_y.csv").write_text("mine")
    assert main(["convert", str(two_axes), str(tmp_path / "out.csv")]) == 1
    assert "out_y.csv exists already" in capsys.readouterr().err
    assert not (tmp_path / "out_x.csv").exists(), "where one of the files exists none is written"
    assert (tmp_path / "out_y.csv").read_text() == "mine"


@pytest.mark.parametrize(
    ("words", "status", "message"),
    [
        (["bench.csv"], 2, "give OUT, or --info"),
        (["bench.csv", "x.csv", "--info"], 2, "leave OUT away"),
        (["bench.csv", "x.txt"], 2, "there are: .csv, .h5,"),
        (["none.csv", "x.mcap"], 1, "No such file or directory"),
        (["bench.csv", "x.mcap", "--column", "torque"], 2, "'torque=effort'"),
        (["bench.csv", "x.mcap", "--column", "torque=efort"], 2, "there are: position, time_s, torque"),
        (["bench.csv", "x.mcap", "--scale", "torque=much"], 2, "'much' is not a number"),
        (["bench.csv", "x.mcap", "--scale", "torque=nan"], 2, "finite and not zero"),
        (["run.mcap", "x.mcap"], 2, "is MCAP already"),
        (["run.mcap", "x.csv", "--axis", "z"], 2, "no axis 'z'; there are: x, y"),
    ],
)
def test_mistakes_are_reported_in_a_sentence(words, status, message, two_axes, table, monkeypatch, capsys):
    monkeypatch.chdir(two_axes.parent)
    assert main(["convert", *words]) == status
    error = capsys.readouterr().err
    assert message in " ".join(error.split())
    assert "Traceback" not in error


def test_info_tells_what_is_in_a_recording(two_axes, capsys):
    assert main(["convert", str(two_axes), "--info"]) == 0
    output = capsys.readouterr()
    for text in ("x: 3 rows, 0.005 s at 400 Hz", "1.667", "2 restart points; metadata: fingerprint, recording"):
        assert text in output.out
    assert "cycle 5: fault: [red] x: too fast" in output.out
    assert "3 cycles are missing" in output.err
    assert main(["convert", str(two_axes), "--info", "--axis", "y", "--json"]) == 0
    content = json.loads(capsys.readouterr().out)
    facts = content["axes"]["y"]
    assert list(content["axes"]) == ["y"]
    assert (facts["rows"], facts["rate_hz"], facts["restart_points"]) == (3, pytest.approx(400.0), 2)
    assert facts["columns"]["position"] == {"unit": "rad or m", "values": 3, "min": -5 / 3, "max": 0.0, "step": None}
    assert (facts["gaps"], facts["longest_gap_s"]) == (0, 0.0)
    assert facts["jitter_s"] == pytest.approx(1.5e-3)
    assert facts["events"] == [{"cycle": 5.0, "name": "fault", "text": "[red] x: too fast"}]
    assert facts["problems"] == ["3 cycles are missing in 1 gap, the first after cycle 1"]


def test_a_recording_that_was_cut_off_is_converted_as_far_as_it_goes(two_axes, tmp_path, capsys):
    data = two_axes.read_bytes()
    two_axes.write_bytes(data[: data.rindex(b"fingerprint") - 200])
    assert main(["convert", str(two_axes), str(tmp_path / "out.csv"), "--axis", "x"]) == 0
    assert "the file was cut off" in capsys.readouterr().err
    assert len(fh.recordings.read(tmp_path / "out.csv")) == 3
    two_axes.write_bytes(data[:300])
    assert main(["convert", str(two_axes), str(tmp_path / "more.csv"), "--axis", "x"]) == 1
    error = capsys.readouterr().err
    assert "Traceback" not in error
    assert "there is no channel in it; the file was cut off" in error


def no_space(*_, **__):
    raise OSError(28, "No space left on device")


@pytest.mark.parametrize("suffix", [".csv", ".json", ".npz", ".mcap", ".mat", ".h5", ".parquet", ".mf4"])
@pytest.mark.parametrize("force", [False, True])
def test_a_conversion_that_fails_leaves_what_was_there(table, tmp_path, monkeypatch, suffix, force):
    """The disk is full, for example: the file appears, or is replaced, only if it is complete."""
    out = tmp_path / "out" / f"x{suffix}"
    out.parent.mkdir()
    if force:
        out.write_bytes(b"precious")
    for name in ("link", "replace"):  # one of them gives the complete file its name
        monkeypatch.setattr(os, name, no_space)
    assert main(["convert", str(table), str(out), *(["--force"] if force else [])]) == 1
    assert [path.name for path in out.parent.iterdir()] == ([out.name] if force else [])
    assert not force or out.read_bytes() == b"precious"


def test_rows_that_cannot_be_written_leave_no_file(tmp_path, capsys):
    (tmp_path / "x.csv").write_text("time_s,torque\n0,1\n1,inf\n")
    assert main(["convert", str(tmp_path / "x.csv"), str(tmp_path / "x.json")]) == 1
    assert "torque is infinite in row 1" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["x.csv"]


def test_one_axis_that_cannot_be_written_leaves_no_other(two_axes, tmp_path, monkeypatch):
    link, calls = os.link, []

    def fail_at_the_second(*words):
        calls.append(words)
        if len(calls) == 2:
            no_space()
        link(*words)

    monkeypatch.setattr(os, "link", fail_at_the_second)
    monkeypatch.setattr(os, "replace", no_space)
    (tmp_path / "out").mkdir()
    assert main(["convert", str(two_axes), str(tmp_path / "out" / "x.csv")]) == 1
    assert list((tmp_path / "out").iterdir()) == []


def test_a_link_stays_and_what_it_names_is_replaced(table, tmp_path):
    (tmp_path / "kept.csv").write_text("old")
    (tmp_path / "kept.csv").chmod(0o640)
    (tmp_path / "link.csv").symlink_to("kept.csv")
    assert main(["convert", str(table), str(tmp_path / "link.csv"), "--force"]) == 0
    assert (tmp_path / "link.csv").is_symlink()
    assert len(fh.recordings.read(tmp_path / "kept.csv")) == 2
    assert (tmp_path / "kept.csv").stat().st_mode & 0o777 == 0o640


def test_a_file_that_appears_meanwhile_is_kept(table, tmp_path, monkeypatch):
    out = tmp_path / "x.csv"

    def write(path, *_, **__):
        with source.new_file(path, overwrite=False) as part:
            part.write_text("mine")
            path.write_text("theirs")

    monkeypatch.setattr("friction_hil.recordings.csv_file.write", write)
    assert main(["convert", str(table), str(out)]) == 1
    assert out.read_text() == "theirs"
    assert sorted(path.name for path in tmp_path.iterdir()) == ["bench.csv", "x.csv"]


def test_values_that_would_overflow_are_reported_and_not_used(tmp_path, capfd):
    rows = "".join(f"{i * 1e-3},{i * 0.1},{(-1) ** i * (1e308 if i == 7 else 1.0)},1e308\n" for i in range(900))
    (tmp_path / "x.csv").write_text(f"time_s,position,torque,velocity\n{rows}")
    assert main(["convert", str(tmp_path / "x.csv"), "--info"]) == 0
    told = capfd.readouterr().err.splitlines()
    assert [line.partition("x: ")[2] for line in told] == [
        "torque is beyond 1e+100 in 1 of 900 rows (row 7): not used in computations",
        "velocity is beyond 1e+100 in 900 of 900 rows (row 0, 1, 2, 3, 4, ...): not used in computations",
    ]
    assert main(["replay", str(tmp_path / "x.csv"), "--model", "coulomb:coulomb=1"]) == 1
    assert "no value of velocity can be used" in capfd.readouterr().err
    assert main(["replay", str(tmp_path / "x.csv"), "--column", "speed=velocity", "--model", "coulomb:coulomb=1"]) == 0
    assert "Warning" not in capfd.readouterr().err


@pytest.mark.parametrize("command", ["replay", "identify"])
def test_a_time_that_stands_still_has_no_rate(tmp_path, capsys, command):
    path = tmp_path / "x.csv"
    path.write_text("time_s,position,velocity,torque\n" + "3,1,2,3\n" * 50)
    assert main(["convert", str(path), "--info"]) == 0
    assert "time_s stands still at 49 of 50 rows" in capsys.readouterr().err
    assert main([command, str(path), *(["--model", "coulomb:coulomb=1"] if command == "replay" else [])]) == 1
    assert "time_s stands still: it needs the time of each row" in capsys.readouterr().err
