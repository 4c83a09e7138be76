"""``friction-hil health``: recordings of many days, from files to exit status, report, metrics and history."""

import json
import os
from pathlib import Path

import numpy as np
import pytest
import yaml

import friction_hil as fh
from friction_hil.cli import main
from friction_hil.recordings import Recording
from friction_hil.recordings.mcap_writer import McapWriter
from tests.processes import run
from tests.servo_drives import axis_dict

NOON = 1_700_000_000.0  # s since 1970
DAY_S = 86400.0
WORDS = ["--baseline", "10"]


def record(folder: Path, day: int, coulomb: float) -> Path:
    """Write the recording of a day: sines and Coulomb friction; the time of the file is its start."""
    rng = np.random.default_rng(day)
    time = np.arange(0.0, 12.0, 0.005)
    position = 2.0 * np.sin(1.6 * time) + 0.9 * np.sin(3.1 * time)
    velocity = np.gradient(position, 0.005)
    torque = coulomb * (1.0 + 0.01 * rng.normal()) * np.sign(velocity) + 0.03 * velocity
    torque += 0.003 * rng.normal(size=len(time))
    path = folder / f"day{day:03d}.npz"
    columns = {"time_s": time, "position": position, "velocity": velocity, "torque": torque}
    fh.recordings.write(path, Recording(str(path), "x", columns))
    os.utime(path, (NOON + day * DAY_S, NOON + day * DAY_S))
    return path


@pytest.fixture
def days(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Twelve days of recordings in the folder ``days`` of the current directory."""
    folder = tmp_path / "days"
    folder.mkdir()
    for day in range(12):
        record(folder, day, 0.2)
    monkeypatch.chdir(tmp_path)
    return folder


@pytest.mark.deep
def test_months_of_recordings_show_what_has_changed_and_nothing_else(
    days: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["health", "days", *WORDS, "--history", "x.jsonl", "--metrics", "x.prom"]
    assert main(words) == 0
    shown = capsys.readouterr()
    assert "nothing has changed (at most 1 false alarms a year)" in shown.out
    assert "the temperature is not recorded" in shown.out
    assert "the start is not recorded" in shown.err
    assert (
        'friction_hil_health_alarm{axis="axis",quantity="coulomb.positive",unit="N m"} 0' in Path("x.prom").read_text()
    )
    for path in days.iterdir():
        path.unlink()  # the history has what they showed
    for day in range(12, 20):
        record(days, day, 0.26)
    assert main([*words, "--json"]) == 3
    result = json.loads(capsys.readouterr().out)
    axis = result["axes"]["axis"]
    assert (result["state"], axis["observations"]) == ("changed", 20)
    changed = {each["name"]: each for each in axis["quantities"] if each["state"] == "changed"}
    assert {"coulomb.positive", "coulomb.negative"} <= set(changed)
    assert not {name for name in changed if name.startswith(("viscous", "asymmetry", "ripple", "zone"))}
    assert changed["coulomb.positive"]["change"] == pytest.approx(0.06, abs=0.006)
    assert changed["coulomb.positive"]["share"] == pytest.approx(0.3, abs=0.03)
    assert changed["coulomb.positive"]["since_s"] == pytest.approx(NOON + 12 * DAY_S, abs=1.5 * DAY_S)
    assert any(text.startswith("Coulomb friction, positive direction: rose by") for text in axis["changed"])
    assert 'quantity="coulomb.positive",unit="N m"} 1' in Path("x.prom").read_text()
    pytest.importorskip("matplotlib", reason="the extra 'report' is not installed")
    assert main([*words, "--report", "x.html"]) == 3
    page = Path("x.html").read_text()
    assert "! Coulomb friction" in capsys.readouterr().out
    assert page.count("<img") == 3
    assert "Coulomb friction, positive direction" in page


def test_after_a_repair_a_baseline_begins_again(days: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["health", "days", *WORDS, "--since", "2023-11-18", "--order", "7", "--axis", "z"]) == 1
    shown = capsys.readouterr().out
    assert "z: 8 observations, too few to judge" in shown
    assert "learning: 8 of 11 observations" in shown
    assert "ripple at order 7 per revolution" in shown


@pytest.mark.parametrize(("started_s", "part"), [(NOON, 1), (NOON, 2), (0.0, 1)])
def test_a_recording_of_the_daemon_has_its_axes_and_its_start(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], started_s: float, part: int
) -> None:
    one = fh.recordings.read(record(tmp_path, 0, 0.2))
    path = tmp_path / ("run.mcap" if part == 1 else "run-2.mcap")
    start_ns = round(started_s * 1e9)
    writer = McapWriter(path, ["x", "y"], list(one.columns), started_unix_ns=start_ns, about={"part": part})
    writer.write(np.column_stack(2 * list(one.columns.values())))
    writer.close()
    os.utime(path, (NOON - DAY_S, NOON - DAY_S))
    assert main(["health", str(path), "--json"]) == 1
    result = json.loads(capsys.readouterr().out)
    assert result["state"] == "not judged"
    assert list(result["axes"]) == ["x", "y"]
    (quantity,) = [each for each in result["axes"]["y"]["quantities"] if each["name"] == "coulomb.positive"]
    assert quantity["values"] == [pytest.approx(0.2, rel=0.05)]
    is_stated = started_s > 0.0
    begin_s = started_s if is_stated else NOON - DAY_S
    assert quantity["times_s"] == [pytest.approx(begin_s + 6.0, abs=0.1)]
    assert is_stated == (not any("the start is not recorded" in note for note in result["notes"]))


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["nowhere"], "no service of this name has recordings in"),
        (["no/where.mcap"], "no/where.mcap"),
        (["days", "--report", "x.txt"], "a report ends in .html"),
        (["days", "--history", "days/day000.npz"], "cannot be read"),
        (["days", "--baseline", "3"], "3 is not in the range x>=10"),
    ],
)
def test_mistakes_are_answered_in_words(
    days: Path, capsys: pytest.CaptureFixture[str], words: list[str], message: str
) -> None:
    assert main(["health", *words]) in (1, 2)
    shown = capsys.readouterr()
    assert message in shown.err
    assert "Traceback" not in shown.err


def machine(folder: Path, **changes: object) -> Path:
    """Write the configuration of a simulated axis with Coulomb friction of 0.07 N m."""
    axis = axis_dict(trajectory={"kind": "hold"}, **changes)
    friction = {"model": "coulomb", "parameters": {"coulomb": 0.07, "viscous": 2e-3}}
    axis["simulation"] = {"mechanics": {"inertia": 2e-4}, "friction": friction}
    bus = {"interface": "socketcan", "channel": "can0"}
    path = folder / "mill.yaml"
    values = {"version": 1, "period_s": 4e-3, "bus": bus, "realtime": {"priority": 0}, "axes": {"x": axis}}
    path.write_text(yaml.safe_dump(values))
    return path


@pytest.mark.deep
def test_a_fingerprint_is_a_motion_of_the_axis_that_is_kept_for_comparison(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    config = machine(tmp_path, experiment={"velocity": 3.0, "travel": 1.0, "duration_s": 20})
    words = ["--fingerprint", "--simulate", "--pace", "sync", "--yes", "--axis", "x", "--json"]
    done = run("health", config, *words, check=False)
    assert done.returncode == 1, done.stderr  # one observation: nothing is judged yet
    folder = tmp_path / "friction-hil" / "health"
    [recorded] = (folder / "mill-fingerprint").iterdir()
    assert recorded.name.startswith("x-")
    quantities = {each["name"]: each for each in json.loads(done.stdout)["axes"]["x"]["quantities"]}
    assert quantities["coulomb.positive"]["values"] == pytest.approx([0.07], rel=0.03)
    assert quantities["coulomb.negative"]["values"] == pytest.approx([0.07], rel=0.03)
    recorded.unlink()
    assert main(["health", "mill-fingerprint", "--json"]) == 1  # what is kept is shown without another motion
    assert json.loads(capsys.readouterr().out)["axes"]["x"]["observations"] == 1


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["mill.yaml"], "mill.yaml is no recording; with --fingerprint, the axes of a configuration are moved"),
        (["mill.mcap", "--yes"], "--yes, --simulate, --reset-fault and --pace belong to --fingerprint"),
        (["mill.mcap", "--fingerprint", "--yes"], "--fingerprint takes one configuration file, CONFIG.yaml"),
        (["mill.yaml", "--fingerprint"], "--yes moves them without asking"),
        (["mill.yaml", "--fingerprint", "--yes"], "axes.x.experiment: is missing: it says how far and how fast"),
        (["mill.yaml", "--fingerprint", "--yes", "--axis", "z"], "there is no axis 'z'; there are: x"),
    ],
)
def test_a_fingerprint_that_cannot_be_made_says_why(
    words: list[str], said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    machine(tmp_path)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    assert main(["health", *words]) == 2
    assert said in capsys.readouterr().err
