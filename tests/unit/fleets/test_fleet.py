"""A fleet: one table whoever is interrupted, one damaged file costs itself alone, object stores as disks."""

import os
import shutil
from pathlib import Path

import numpy as np
import pyarrow.parquet as parquet
import pytest

import friction_hil as fh
from friction_hil.cli import main
from friction_hil.errors import FrictionHilError, UsageError
from friction_hil.fleets import run as runs
from friction_hil.fleets import storage
from friction_hil.parallel import pool

TIME, LONG = np.arange(0.0, 4.0, 2e-3), np.arange(0.0, 24.0, 5e-3)


def log(path: Path, level: float, seed: int = 0, time: np.ndarray = TIME) -> Path:
    noise = np.random.default_rng(seed).normal(scale=1e-3, size=time.size)
    position, torque = np.sin(3.0 * time), level * np.sign(np.cos(3.0 * time)) + noise
    columns = {"time_s": time, "position": position, "torque": torque}
    path.parent.mkdir(parents=True, exist_ok=True)
    fh.recordings.write(path, fh.recordings.from_table(columns, path.stem))
    return path


@pytest.fixture(autouse=True)
def here(monkeypatch):
    """One process: starting others takes longer than all of this."""
    monkeypatch.setattr(pool, "processors", lambda: 1)


@pytest.fixture
def logs(tmp_path):
    for k in range(4):
        log(tmp_path / "logs" / f"m{k}.parquet", 0.1 * (k + 1), k)
    (tmp_path / "logs" / "damaged.parquet").write_bytes(b"PAR1 and no more")
    return tmp_path / "logs"


def identified(logs, output, **options):
    return fh.fleet("identify", str(logs / "*.parquet"), output=output, models="coulomb", **options)


@pytest.mark.parametrize("processes", [1, 2])
def test_every_axis_has_a_row_and_a_model_and_a_damaged_file_its_reason(logs, tmp_path, monkeypatch, processes):
    monkeypatch.setattr(pool, "processors", lambda: processes)
    done = identified(logs, tmp_path / "out")
    assert [row["axis"] for row in done.rows] == [None, "m0", "m1", "m2", "m3"]
    assert [round(row["friction.coulomb"], 2) for row in done.rows[1:]] == [0.1, 0.2, 0.3, 0.4]
    assert "damaged.parquet" in done.failures[0]["error"]
    assert done.worst[0] is done.failures[0]
    assert parquet.read_table(done.table).to_pylist() == [
        {name: row.get(name) for name in parquet.read_schema(done.table).names} for row in done.rows
    ]
    models = [fh.models.load(path) for path in (tmp_path / "out" / "files").glob("*/*.yaml")]
    assert sorted(round(model.parameters["coulomb"], 2) for model in models) == [0.1, 0.2, 0.3, 0.4]
    assert "damaged.parquet" in done.report.read_text()


def test_what_is_done_is_kept_and_what_changed_or_failed_is_done_again(logs, tmp_path, monkeypatch):
    def converted(output, **options):
        return fh.fleet("convert", str(logs / "*.parquet"), output=output, **options)

    whole = converted(tmp_path / "whole")
    started = []

    def dies(function, tasks, **_):
        for index, task in list(enumerate(tasks))[:3]:
            started.append(task.name)
            yield index, function(task)
        raise FrictionHilError("the connection to the scheduler was lost")

    monkeypatch.setattr(runs, "run_many", dies)
    with pytest.raises(FrictionHilError, match="was lost"):
        converted(tmp_path / "out")
    monkeypatch.undo()
    with (tmp_path / "out" / "done.jsonl").open("a") as file:
        file.write('{"key": "cut o')
    seen = []
    again = converted(tmp_path / "out", progress=lambda name, share: seen.append((Path(name).name, share)))
    assert again.known == 2  # of three, one is damaged
    assert again.rows == whole.rows
    assert again.table.read_bytes() == whole.table.read_bytes()
    assert sorted(name for name, _ in seen) == ["damaged.parquet", "m2.parquet", "m3.parquet"]
    assert seen[-1][1] == 1.0
    (logs / "m1.parquet").unlink()
    log(logs / "m1.parquet", 0.7, time=LONG)
    shutil.copy(logs / "m0.parquet", logs / "damaged.parquet")
    mended = converted(tmp_path / "out")
    assert mended.known == 3
    assert not mended.failures
    assert mended.rows[2]["rows"] == LONG.size
    assert converted(tmp_path / "out", to=".csv").known == 0, "with other options nothing is known"


def test_recordings_are_converted_with_the_same_values(logs, tmp_path):
    done = fh.fleet("convert", [logs / "m0.parquet", logs / "m1.parquet"], output=tmp_path / "out", to=".mcap")
    assert not done.failures
    (path,) = (tmp_path / "out" / "files").glob("m0*/*.mcap")
    assert np.array_equal(fh.recordings.read(path)["torque"], fh.recordings.read(logs / "m0.parquet")["torque"])


def test_the_machine_whose_friction_has_changed_is_named(tmp_path, capsys):
    for machine, late in (("a", 0.2), ("b", 0.3)):
        for day in range(48):
            path = log(tmp_path / machine / f"{day:02}.parquet", late if day >= 38 else 0.2, day, LONG)
            os.utime(path, (86400.0 * day, 86400.0 * day))
    patterns = [str(tmp_path / machine / "*.parquet") for machine in "ab"]
    done = fh.fleet("health", patterns, output=tmp_path / "out")
    assert {row["source"] for row in done.rows} == {str(tmp_path / "a"), str(tmp_path / "b")}
    assert {row["source"] for row in done.worst} == {str(tmp_path / "b")}
    assert done.worst[0]["state"] == "changed"


@pytest.mark.parametrize(
    ("arguments", "options", "words"),
    [
        (("guess", "x.csv"), {}, "guess"),
        (("convert", "logs/m0.parquet"), {"to": ".exe"}, r"\.exe"),
        (("identify", "logs/m0.parquet"), {"modells": "lugre"}, "models"),
        (("verify", "logs/m0.parquet"), {"models": "lugre"}, "models"),
        (("identify", "logs/none*.csv"), {}, "no file matches"),
        (("identify", "nosuchstore://bucket/x.csv"), {}, "nosuchstore"),
    ],
)
def test_nonsense_is_refused_before_anything_is_done(logs, tmp_path, monkeypatch, arguments, options, words):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(UsageError, match=words):
        fh.fleet(*arguments, output=tmp_path / "out", **options)
    assert not (tmp_path / "out").exists()


def test_the_command_ends_with_the_worst_and_what_to_do_next(logs, tmp_path, capsys):
    words = ["fleet", "identify", str(logs / "*.parquet"), "--output", str(tmp_path / "out"), "--models", "coulomb"]
    assert main(words) == 1
    first, worst, *_, last = capsys.readouterr().out.splitlines()
    assert first == "4 of 5 done; 5 rows"
    assert worst.startswith("- not done: ")
    assert last.startswith("next: ")
    (logs / "damaged.parquet").unlink()
    assert main(words) == 0
    assert "4 of 4 done, 4 of them before" in capsys.readouterr().out
    assert main(["fleet", "convert", str(logs / "m0.parquet"), "--to", ".csv", "--output", str(tmp_path / "csv")]) == 0
    assert list((tmp_path / "csv" / "files").glob("m0*/m0.csv"))


def test_recordings_in_an_object_store_give_the_table_of_those_on_a_disk(logs, tmp_path, monkeypatch):
    pytest.importorskip("s3fs", reason="s3fs is not installed")
    server = pytest.importorskip("moto.server", reason="moto is not installed").ThreadedMotoServer("127.0.0.1", 0)
    server.start()
    try:
        host, port = server.get_host_and_port()
        monkeypatch.setenv("AWS_ENDPOINT_URL", f"http://{host}:{port}")
        for name in ("AWS_ACCESS_KEY_ID", "AWS_SECRET_ACCESS_KEY"):
            monkeypatch.setenv(name, "testing")
        monkeypatch.setenv("AWS_DEFAULT_REGION", "us-east-1")
        store = __import__("s3fs").S3FileSystem(anon=False, skip_instance_cache=True)
        store.mkdir("fleet")
        for path in logs.iterdir():
            store.put(str(path), f"fleet/logs/{path.name}")
        store.pipe("fleet/logs/m0.parquet.columns.yaml", b"columns: {torque: 'torque*2'}\n")
        here = identified(logs, tmp_path / "here")
        there = fh.fleet("identify", "s3://fleet/logs/m*.parquet", output=tmp_path / "there", models="coulomb")
        rest = [{**row, "source": Path(row["source"]).name} for row in there.rows[1:]]
        assert rest == [{**row, "source": Path(row["source"]).name} for row in here.rows[2:]]
        assert there.rows[0]["friction.coulomb"] == pytest.approx(0.2, rel=0.02), "its own file maps the columns"
        assert (
            fh.fleet("identify", "s3://fleet/logs/m*.parquet", output=tmp_path / "there", models="coulomb").known == 4
        )
        gone = fh.fleet("identify", "s3://fleet/logs/none.parquet", output=tmp_path / "gone")
        assert "no such recording" in gone.failures[0]["error"]
    finally:
        server.stop()


def test_later_parts_of_a_recording_in_a_store_are_read_with_the_first():
    names = ["b/run-2.mcap", "b/run-10.mcap", "b/run.mcap", "b/other-2.mcap", "b/x.csv"]
    assert storage.without_later_parts(names) == ["b/run.mcap", "b/other-2.mcap", "b/x.csv"]
