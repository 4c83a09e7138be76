"""Replay of recordings through models: against motion that is known exactly, and a real axis with known figures."""

import json
from pathlib import Path

import numpy as np
import pytest
import yaml
from scipy import signal

import friction_hil as fh
from friction_hil.cli import main
from friction_hil.config import load, self_contained
from friction_hil.errors import RecordingError, UsageError
from friction_hil.models.model_file import ModelFile
from friction_hil.recordings import Recording
from friction_hil.recordings.mcap_writer import McapWriter
from friction_hil.replay.comparison import predict, replay
from friction_hil.replay.preparation import replay_segments

ROOT = Path(__file__).parents[3]
EMPS = ROOT.parent / "shared" / "data" / "emps" / "DATA_EMPS.mat"
EMPS_MODEL = """\
version: 1
axis: linear
friction: {model: coulomb, parameters: {coulomb: 20.3935, viscous: 203.5034}}
mechanics: {inertia: 95.1089, offset: -3.1648}
"""
MAPPING = ["--column", "time_s=t", "--column", "position=qm", "--column", "torque=vir", "--scale", "torque=35.150651"]

MECHANICS = {"inertia": 0.02, "offset": 0.1, "gravity": {"constant": 0.2, "sine": 0.4, "cosine": -0.3}}


def model(coulomb: float) -> ModelFile:
    friction = {"model": "coulomb", "parameters": {"coulomb": coulomb, "viscous": 0.05}}
    return ModelFile.model_validate({"axis": "rotary", "friction": friction, "mechanics": MECHANICS})


MODEL = model(0.3)


def swinging(rate_hz: float = 1000.0, seconds: float = 4.0) -> Recording:
    """A sine of 1 Hz and the torque that MODEL needs for it, by hand."""
    time = np.arange(round(rate_hz * seconds)) / rate_hz
    angle = 2.0 * np.pi * time + 0.3
    position = np.sin(angle)
    velocity = 2.0 * np.pi * np.cos(angle)
    acceleration = -((2.0 * np.pi) ** 2) * position
    torque = 0.02 * acceleration + 0.3 * np.sign(velocity) + 0.05 * velocity
    torque += 0.1 + 0.2 + 0.4 * np.sin(position) - 0.3 * np.cos(position)
    columns = {"time_s": time, "position": position, "velocity": velocity, "torque": torque}
    return Recording("swing.csv", "x", columns)


def without(recording: Recording, name: str) -> Recording:
    del recording.columns[name]
    return recording


def test_true_model_explains_the_torque_with_measured_velocity_and_by_position_alone() -> None:
    result = replay(swinging(), {"true": MODEL})
    (prediction,) = result.predictions
    assert (prediction.model, prediction.unit) == ("true", "N m")
    assert prediction.relative_error < 1e-4  # what the ends of the central differences leave
    assert prediction.rmse == pytest.approx(prediction.relative_error * np.sqrt(np.mean(result.measured**2)))
    assert (result.problems, result.rows, result.duration_s) == ((), 4000, pytest.approx(3.999))
    result = replay(without(swinging(), "velocity"), {"true": MODEL})
    assert result.predictions[0].relative_error < 1e-4  # the low-pass rounds the reversals on both sides alike
    assert result.problems == ("no velocity: derived from the position below 100 Hz",)
    assert len(result.time_s) == 4000 - 2 * 49  # the low-pass needs room at both ends


def test_a_wrong_model_is_reported_by_its_error() -> None:
    result = replay(swinging(), {"true": MODEL, "wrong": model(0.2)})
    prediction = result.predictions[1]
    assert prediction.rmse == pytest.approx(0.1, rel=1e-3)
    np.testing.assert_allclose(prediction.torque, prediction.friction + prediction.mechanics)
    relative = np.linalg.norm(result.measured - prediction.torque) / np.linalg.norm(result.measured)
    assert prediction.relative_error == pytest.approx(relative)


def test_derived_motion_has_no_delay() -> None:
    recording = swinging()
    [motion], _, _ = replay_segments(recording, lowpass_hz=50.0)
    inner = slice(200, -200)
    np.testing.assert_allclose(motion.velocity[inner], recording["velocity"][inner], atol=1e-3)
    expected = -((2.0 * np.pi) ** 2) * recording["position"]
    np.testing.assert_allclose(motion.acceleration[inner], expected[inner], atol=1e-2)


@pytest.mark.parametrize("factor", [2, 7, 10])
def test_decimation_ends_on_the_last_sample_and_filters_as_matlab_does(factor: int) -> None:
    recording = swinging()
    whole = replay(recording, {"true": MODEL}, lowpass_hz=100.0)
    part = replay(recording, {"true": MODEL}, lowpass_hz=100.0, decimate=factor)
    assert part.time_s[-1] == whole.time_s[-1]
    np.testing.assert_allclose(np.diff(part.time_s), factor * 1e-3)
    b, a = signal.cheby1(8, 0.05, 0.8 / factor)
    expected = signal.filtfilt(b, a, whole.measured, padlen=24)[::-1][::factor][::-1]
    np.testing.assert_allclose(part.measured, expected, atol=1e-6)
    assert len(part.velocity) == len(part.time_s) == len(part.measured) == len(part.predictions[0].torque)


def test_every_part_between_gaps_is_used_and_a_few_missed_cycles_are_bridged() -> None:
    recording = swinging()
    keep = np.r_[0:500, 800:3500, 3600:4000]
    recording.columns = {name: values[keep] for name, values in recording.columns.items()}
    result = replay(recording, {"true": MODEL})
    assert result.problems == ("2 gaps of more than 10 periods, before 0.8 s, 3.6 s: 3 parts, each by itself",)
    assert result.segments == (slice(0, 500), slice(500, 3200), slice(3200, 3600))
    np.testing.assert_array_equal(result.time_s, recording["time_s"])
    assert result.predictions[0].relative_error < 1e-3
    recording = swinging()
    keep = np.r_[0:500, 500, 500, 503:4000]
    recording.columns = {name: values[keep] for name, values in recording.columns.items()}
    result = replay(recording, {"true": MODEL})
    assert result.predictions[0].relative_error < 1e-3
    assert len(result.time_s) == 4000


@pytest.mark.parametrize(
    ("seconds", "options", "error", "message"),
    [
        *((4.0, {"lowpass_hz": hz}, UsageError, "a low-pass lies above 0") for hz in (0.0, -1.0, np.nan)),
        (4.0, {"lowpass_hz": 500.0}, UsageError, "500 Hz, not at 500 Hz"),
        (4.0, {"decimate": 0}, UsageError, "whole number from 1"),
        (0.04, {"lowpass_hz": 100.0}, RecordingError, "40 rows without a gap are too few"),
        (0.002, {}, RecordingError, "too few"),
    ],
)
def test_what_cannot_be_replayed_is_refused(seconds, options, error, message) -> None:
    with pytest.raises(error, match=message):
        replay(swinging(seconds=seconds), {"true": MODEL}, **options)
    with pytest.raises(RecordingError, match=r"torque\. There are: time_s, position, velocity"):
        replay(without(swinging(seconds=seconds), "torque"), {"true": MODEL})


needs_emps = pytest.mark.skipif(not EMPS.exists(), reason="the shared data are not here")


@needs_emps
def test_emps_is_explained_to_four_percent(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    model = tmp_path / "axis.yaml"
    model.write_text(EMPS_MODEL)
    words = ["replay", str(EMPS), "--model", str(model), *MAPPING, "--lowpass", "100", "--decimate", "10"]
    assert main([*words, "--json"]) == 0
    (result,) = json.loads(capsys.readouterr().out)["recordings"]
    assert (result["rows"], result["verified"], result["problems"]) == (24841, None, [])
    (figures,) = result["models"]
    assert figures["relative_error"] == pytest.approx(0.04039, abs=1e-5)
    assert figures["unit"] == "N"
    assert main(words) == 0
    assert "4.039 %" in capsys.readouterr().out


@needs_emps
def test_emps_published_figure_which_counts_the_end_of_the_record() -> None:
    """The benchmark leaves out 49 samples at the beginning and none at the end, where the filter has no data."""
    columns = {"time_s": "t", "position": "qm", "torque": "vir"}
    recording = fh.recordings.read(EMPS, columns=columns, scale={"torque": 35.150651})
    [motion], _, _ = replay_segments(recording, 100.0)
    torque = np.sum(predict(ModelFile.model_validate(yaml.safe_load(EMPS_MODEL)), motion), axis=0)
    b, a = signal.cheby1(8, 0.05, 0.08)
    measured, predicted = (
        signal.filtfilt(b, a, values[49:], padlen=24)[::-1][::10] for values in (motion.torque, torque)
    )
    error = np.linalg.norm(measured - predicted) / np.linalg.norm(measured)
    assert error == pytest.approx(0.04083, abs=5e-6)


@pytest.fixture
def swing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The swing as CSV, the current directory being its folder, which has model.yaml too."""
    fh.recordings.write(tmp_path / "swing.csv", swinging(seconds=1.0))
    (tmp_path / "model.yaml").write_text(EMPS_MODEL)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_pictures_are_drawn(swing: Path, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["--model", "coulomb:coulomb=0.3,viscous=0.05", "--model", "dahl:sigma0=100,coulomb=0.3", "--output"]
    assert main(["replay", "swing.csv", *words, "one.png"]) == 0
    assert (swing / "one.png").read_bytes().startswith(b"\x89PNG")
    assert "picture: one.png" in capsys.readouterr().out
    (swing / "other.csv").write_bytes((swing / "swing.csv").read_bytes())
    assert main(["replay", "swing.csv", "other.csv", *words, "two.svg"]) == 0
    for name in ("two_swing_swing.svg", "two_other_other.svg"):
        assert b"<svg" in (swing / name).read_bytes()


@pytest.mark.parametrize(
    ("words", "status", "message"),
    [
        ([], 2, "axis 'swing'; give --model"),
        (["--model", "coulom"], 2, "did you mean 'coulomb'?"),
        (["--model", "coulomb:coulomb=1", "--lowpass", "700"], 2, "half the sampling rate, 500 Hz"),
        (["--model", "coulomb:coulomb=1", "--decimate", "0"], 2, "0 is not in the range"),
        (["--model", "coulomb:coulomb=1", "--output", "x.jpgg"], 2, "'.jpgg'"),
        (["--model", "coulomb:coulomb=1", "--output", "no/x.png"], 1, "no/x.png cannot be written"),
        (["--verify"], 1, "the daemon's own MCAP recording"),
        (["--model", "coulomb:coulomb=1", "--lowpass", "1e-9"], 1, "too few for a low-pass at 1e-09 Hz"),
        (["--model", "coulomb:coulomb=1", "--lowpass", "1e-320"], 1, "too few for a low-pass"),
        (["--model", "coulomb:coulomb=1", "--decimate", "1000000"], 1, "too few for these filters"),
        (["--model", "coulomb:coulomb=1", "--scale", "torque=2", "--scale", "torque=3"], 2, "'torque' is given twice"),
        (["--model", "coulomb:coulomb=1", "--column", "a=torque", "--column", "a=position"], 2, "'a' is given twice"),
        (["--model", "coulomb:coulomb=1", "--column", "torque=curent"], 2, "there are: position, time_s, torque"),
    ],
)
def test_mistakes_are_reported_in_a_sentence(words, status, message, swing, capsys):
    assert main(["replay", "swing.csv", *words]) == status
    error = " ".join(capsys.readouterr().err.split())
    assert message in error
    assert "Traceback" not in error


def test_no_torque_at_all_has_no_relative_error(swing: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["replay", "swing.csv", "--model", "coulomb:coulomb=1", "--scale", "torque=1e-300"]) == 0
    out = capsys.readouterr().out
    assert "undefined" in out
    assert "nan" not in out


def test_the_daemons_own_model_is_taken_where_none_is_given(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    configuration = load(sorted((ROOT / "config").glob("*.yaml"))[0])
    name, axis = next(iter(configuration.axes.items()))
    recording = swinging(seconds=1.0)
    metadata = {"configuration": self_contained(configuration)}
    writer = McapWriter(tmp_path / "run.mcap", [name], list(recording.columns), metadata=metadata)
    writer.write(np.stack(list(recording.columns.values()), axis=1))
    writer.close()
    assert main(["replay", str(tmp_path / "run.mcap"), "--json"]) == 0
    (result,) = json.loads(capsys.readouterr().out)["recordings"]
    assert result["axis"] == name
    assert [figures["model"] for figures in result["models"]] == [f"{axis.model.friction.model} (as recorded)"]
