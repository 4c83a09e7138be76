"""Many files through many models: as one at a time, whatever happens to some of them."""

import json
import os
from pathlib import Path
from typing import Any

import jsonschema
import numpy as np
import pytest

import friction_hil as fh
from friction_hil.cli import main
from friction_hil.errors import FrictionHilError
from friction_hil.parallel import pool
from friction_hil.recordings import Recording
from friction_hil.replay import batch as farm


def strict(required: str, **properties: Any) -> dict[str, Any]:
    """Schema of an object that has these properties and no others."""
    names = required.split()
    return {"type": "object", "required": names, "properties": properties, "additionalProperties": False}


NUMBER, TEXT = {"type": ["number", "null"]}, {"type": "string"}
FIGURES = strict(
    "model rmse relative_error unit", model=TEXT, rmse=NUMBER, relative_error=NUMBER, unit={"enum": ["N m", "N"]}
)
ONE = strict(
    "path axis rows duration_s problems verified models",
    **{"path": TEXT, "axis": {"type": ["string", "null"]}, "rows": {"type": ["integer", "null"]}, "error": TEXT},
    **{"duration_s": NUMBER, "problems": {"type": "array", "items": TEXT}, "segments": {"type": "integer"}},
    **{"verified": {"type": ["boolean", "null"]}, "models": {"type": "array", "items": FIGURES}},
)
SCHEMA = strict("recordings", recordings={"type": "array", "items": ONE})
MODELS = ["--model", "coulomb:coulomb=0.3", "--model", "dahl:sigma0=100,coulomb=0.3"]


def log(path: Path, seed: int, *, rows: int = 400) -> Path:
    """A swing whose amplitude depends on the seed."""
    time = np.arange(rows) * 1e-3
    velocity = (1.0 + seed) * np.cos(8.0 * time)
    columns = {"time_s": time, "position": (1.0 + seed) * np.sin(8.0 * time) / 8.0, "velocity": velocity}
    columns["torque"] = 0.3 * np.sign(velocity) + 0.01 * seed
    fh.recordings.write(path, Recording("", "x", columns))
    return path


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Three logs of different formats, and the current directory beside them."""
    (tmp_path / "logs" / "deep").mkdir(parents=True)
    for seed, name in enumerate(("a.csv", "b.parquet", "deep/c.npz")):
        log(tmp_path / "logs" / name, seed)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def replayed(capsys: pytest.CaptureFixture[str], *words: str, status: int = 0) -> tuple[list[dict[str, Any]], str]:
    assert main(["replay", *words, *MODELS, "--json"]) == status
    output = capsys.readouterr()
    content = json.loads(output.out)
    jsonschema.validate(content, SCHEMA)
    return content["recordings"], output.err


def test_patterns_find_files_in_order(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    found, _ = replayed(capsys, "logs/**/*.*", "logs/a.csv")
    assert [each["path"] for each in found] == ["logs/a.csv", "logs/b.parquet", "logs/deep/c.npz"]
    assert [[model["model"] for model in each["models"]] for each in found] == [MODELS[1::2]] * 3
    assert main(["replay", "logs/*.blf", *MODELS]) == 2
    assert "logs/*.blf: no file matches" in capsys.readouterr().err


def test_a_pattern_of_model_files(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    for name in ("one.yaml", "two.yaml"):
        (folder / name).write_text("axis: rotary\nfriction: {model: coulomb, parameters: {coulomb: 0.3}}\nversion: 1\n")
    assert main(["replay", "logs/a.csv", "--model", "*.yaml", "--json"]) == 0
    (found,) = json.loads(capsys.readouterr().out)["recordings"]
    assert [each["model"] for each in found["models"]] == ["one.yaml", "two.yaml"]


def test_a_file_that_cannot_be_read_costs_only_itself(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    data = (folder / "logs" / "b.parquet").read_bytes()
    (folder / "logs" / "b.parquet").write_bytes(data[:-50])
    found, errors = replayed(capsys, "logs/a.csv", "logs/b.parquet", "logs/deep/c.npz", "nothing.csv", status=1)
    assert [len(each["models"]) for each in found] == [2, 0, 2, 0]
    assert "was cut off at byte" in found[1]["error"]
    assert "Error: logs/b.parquet was cut off" in errors
    assert "Error: nothing.csv cannot be read: No such file" in errors
    assert "Traceback" not in errors


def test_pictures_of_files_of_one_name_do_not_meet(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    log(folder / "logs" / "deep" / "a.csv", 5)
    assert main(["replay", "logs/**/a.csv", *MODELS, "--output", "p.png"]) == 0
    assert sorted(path.name for path in folder.glob("p*.png")) == ["p_a_2_a.png", "p_a_a.png"]


def test_names_are_not_cut_short_where_nobody_watches(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = log(folder / f"{'long' * 20}.csv", 1)
    assert main(["replay", str(path), *MODELS]) == 0
    assert f"{path.name} " in capsys.readouterr().out


@pytest.mark.deep
@pytest.mark.parametrize("methods", [["fork", "spawn", "forkserver"], ["spawn"]], ids=["linux", "windows"])
def test_the_pool_gives_what_one_process_gives(methods, folder, monkeypatch):
    """Two workers where there is only one core too; a broken file and order included."""
    monkeypatch.setattr(pool.multiprocessing, "get_all_start_methods", lambda: methods)
    paths = [str(log(folder / f"{i}.csv", i)) for i in range(5)] + ["nothing.csv"]
    tasks = [farm.ReplayTask(path, ("coulomb:coulomb=0.3,viscous=0.01",)) for path in paths]
    alone = [farm.run(task) for task in tasks]
    monkeypatch.setattr(farm, "_MANY", 2)
    monkeypatch.setattr(pool.os, "sched_getaffinity", lambda _: {0, 1})
    done: list[None] = []
    together = farm.replay_many(tasks, on_done=lambda: done.append(None))
    assert together == alone
    assert len(done) == len(tasks)
    assert together[-1][0].exit_status == 1
    errors = [outcome.facts["models"][0]["rmse"] for (outcome,) in together[:-1]]
    assert len(set(errors)) == 5


def test_a_worker_that_dies_is_reported(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class Mortal(farm.ReplayTask):
        def __reduce__(self) -> Any:  # what a worker runs when it unpickles its task
            return os._exit, (1,)

    monkeypatch.setattr(farm, "_MANY", 2)
    monkeypatch.setattr(pool.os, "sched_getaffinity", lambda _: {0, 1})
    with pytest.raises(FrictionHilError, match=r"a worker process died.* of 2 recordings are not done"):
        farm.replay_many([Mortal("a"), Mortal("b")])


def test_columns_are_scaled_by_factors(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    found, _ = replayed(capsys, "logs/a.csv", "--column", "torque=torque*-2*pi/pi")
    plain, _ = replayed(capsys, "logs/a.csv", "--scale", "torque=-2")
    assert found == plain
    assert main(["replay", "logs/a.csv", *MODELS, "--column", "torque=torque*2", "--scale", "torque=2"]) == 2
    assert "'torque' is given twice" in capsys.readouterr().err


def test_only_the_columns_that_are_needed_are_read(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    wide = fh.recordings.read(folder / "logs" / "a.csv")
    wide.columns |= {f"extra_{i}": np.ones(len(wide)) for i in range(5)}
    fh.recordings.write(folder / "wide.mcap", wide)
    seen: list[set[str]] = []
    read = fh.recordings.read_all

    def spy(*arguments: Any, **options: Any) -> Any:
        found = read(*arguments, **options)
        seen.extend(set(each.columns) for each in found.values())
        return found

    monkeypatch.setattr(fh.recordings, "read_all", spy)
    (outcome,) = farm.run(farm.ReplayTask("wide.mcap", ("coulomb:coulomb=0.3",)))
    assert outcome.exit_status == 0
    assert seen == [{"time_s", "position", "velocity", "torque"}]


def test_info_tells_rate_gaps_and_what_a_replay_would_mend(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    time = np.r_[0:300, 800:1500] * 1e-3
    counts = np.mod(np.round(3000.0 * np.sin(12.0 * time)), 4096.0)
    columns = {"time_s": time, "position": counts, "torque": np.ones(1000)}
    fh.recordings.write(tmp_path / "x.parquet", Recording("", "x", columns, units={"position": "counts"}))
    assert main(["convert", str(tmp_path / "x.parquet"), "--info", "--json"]) == 0
    facts = json.loads(capsys.readouterr().out)["axes"]["x"]
    found = (facts["rate_hz"], facts["gaps"], facts["longest_gap_s"], facts["columns"]["position"]["step"])
    assert found == pytest.approx((1000.0, 1, 0.501, 1.0))
    assert facts["columns"]["position"]["unit"] == "counts"
    for words in ("position wraps over 4096 (2^12 steps) at", "position is in counts in the file"):
        assert any(words in problem for problem in facts["problems"])
    assert main(["convert", str(tmp_path / "x.parquet"), "--info"]) == 0
    output = capsys.readouterr()
    assert "1 gaps up to 0.501 s" in output.out
    assert "position wraps over 4096" in output.err
