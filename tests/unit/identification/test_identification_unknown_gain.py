"""A drive of unknown gain: what is held sets the scale; groups of recordings; rows at rest; a real servo in volts."""

import json
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import friction_hil as fh
from friction_hil import recordings
from friction_hil.cli import main
from friction_hil.errors import RecordingError, UsageError
from friction_hil.identification import Identification, IdentificationSettings, identify
from friction_hil.models.files import load_model_file
from friction_hil.recordings import Recording
from tests.unit.identification.test_identification import plain

BAM = Path(__file__).parents[4] / "shared" / "data" / "bam_xl330"
needs_bam = pytest.mark.skipif(not BAM.exists(), reason="the shared data are not here")
PERIOD_S = 4e-3
GAIN, BACK_EMF, INERTIA, GRAVITY = 0.08, 0.03, 0.006, 0.48  # N m/V, N m s/rad, kg m^2, N m: a small servo
FRICTION: dict[str, dict[str, Any]] = {
    "coulomb": {"coulomb": 0.05},
    "stribeck": {"coulomb": 0.05, "static": 0.08, "stribeck_velocity": 0.3},
    "power_law": {"coulomb": 0.05, "factor": 0.02, "exponent": 0.5},
    "dahl": {"sigma0": 20.0, "coulomb": 0.05},
}
IN_VOLTS = IdentificationSettings(
    families=("coulomb",), gravity="pendulum", held={"gravity.cosine": 0.0}, has_modifiers=False
)


def recorded(
    family: str = "coulomb",
    *,
    noise: float = 0.0,
    seed: int = 0,
    viscous: float = 0.0,
    load: float = 0.0,
    amplitude: float = 1.0,
    seconds: float = 8.0,
    name: str = "made.csv",
    **metadata: Any,
) -> Recording:
    """A pendulum that a motor swings, its volts in the column torque, with so many volts of white noise."""
    time = np.arange(round(seconds / PERIOD_S)) * PERIOD_S
    swings = ((0.5, 0.37, 0.3), (0.15, 1.3, 1.1), (0.05, 3.1, 0.5))
    velocity = amplitude * sum(a * 2 * np.pi * f * np.cos(2 * np.pi * f * time + p) for a, f, p in swings)
    position = np.cumsum(velocity) * PERIOD_S
    gravity = GRAVITY * np.sin(position)
    modifiers = {"load": {"motoring": load, "driven": load}} if load else None
    model = fh.models.create(family, modifiers=modifiers, **FRICTION[family])
    torque = INERTIA * np.gradient(velocity, PERIOD_S) + gravity + (BACK_EMF + viscous) * velocity + 0.01
    torque += model.simulate(velocity, PERIOD_S, position=position, load_torque=gravity)
    volts = torque / GAIN + noise * np.random.default_rng(seed).normal(size=len(time))
    columns = {"time_s": time, "position": position, "velocity": velocity, "torque": volts}
    return Recording(name, "x", columns, dict(metadata))


def found(*given: Recording, held: dict[str, float] | None = None, **settings: Any) -> Identification:
    """Identify a pendulum with an unknown gain, its gravity held."""
    held = {"gravity.sine": GRAVITY, "gravity.cosine": 0.0} if held is None else held
    content: dict[str, Any] = {"families": ("coulomb",), "gravity": "pendulum", "has_modifiers": False, **settings}
    return identify(given, IdentificationSettings(held=held, has_unknown_gain=True, **content))


def fit_of(*given: Recording, **settings: Any) -> Any:
    """The fit of Coulomb friction."""
    return plain(found(*given, **settings), "coulomb")


@pytest.mark.parametrize("held", [{"gravity.sine": GRAVITY}, {"inertia": INERTIA}], ids=["gravity", "inertia"])
@pytest.mark.parametrize("family", FRICTION)
def test_truth_is_found_in_torque(family: str, held: dict[str, float]) -> None:
    fit = plain(found(recorded(family), families=(family,), held=held), family)
    assert fit.drive == pytest.approx({"drive.gain": GAIN, "drive.back_emf": BACK_EMF}, rel=1e-4)
    assert fit.mechanics["inertia"] == pytest.approx(INERTIA, rel=1e-4)
    assert fit.mechanics["gravity.sine"] == pytest.approx(GRAVITY, rel=1e-4)
    assert fit.mechanics["offset"] == pytest.approx(0.01, abs=1e-4)
    parameters, modifiers = fit.friction
    assert {name: parameters[name] for name in FRICTION[family]} == pytest.approx(FRICTION[family], rel=1e-3)
    assert not modifiers


def test_gain_is_that_of_gravity_found_in_volts() -> None:
    """An ordinary fit in volts, divided by hand, is the same one."""
    recording = recorded(noise=0.3)
    fit = fit_of(recording)
    volts = plain(identify([recording], IN_VOLTS), "coulomb")
    gain = GRAVITY / volts.values["gravity.sine"]
    drive = {"drive.gain": gain, "drive.back_emf": gain * volts.values["viscous"]}
    assert fit.drive == pytest.approx(drive, rel=1e-6)
    for name in ("inertia", "coulomb"):
        assert fit.values[name] == pytest.approx(gain * volts.values[name], rel=1e-6), name
    assert fit.train.rmse == pytest.approx(gain * volts.train.rmse, rel=1e-6)
    assert fit.held_out.relative_error == pytest.approx(volts.held_out.relative_error, rel=1e-6)
    assert fit.curves.measured == pytest.approx(gain * volts.curves.measured)
    sliding = volts.curves.friction - volts.values["viscous"] * fit.curves.velocity
    assert fit.curves.friction == pytest.approx(gain * sliding)


def test_unit_of_the_signal_changes_the_gain_alone() -> None:
    fine, coarse = recorded(noise=0.3, load=0.2), recorded(noise=0.3, load=0.2)
    coarse.columns["torque"] = 1e3 * coarse["torque"]
    one, other = (plain(found(each, has_modifiers=True), "coulomb + load") for each in (fine, coarse))
    assert one.drive["drive.gain"] == pytest.approx(1e3 * other.drive["drive.gain"], rel=1e-4)
    assert {**one.values, "drive.gain": 0.0} == pytest.approx({**other.values, "drive.gain": 0.0}, rel=1e-4, abs=1e-7)
    assert one.held_out.rmse == pytest.approx(other.held_out.rmse, rel=1e-4)


@pytest.mark.deep
def test_stated_errors_are_those_of_repeated_experiments() -> None:
    names = ("drive.gain", "drive.back_emf", "inertia", "coulomb")
    truth = {"drive.gain": GAIN, "drive.back_emf": BACK_EMF, "inertia": INERTIA, "coulomb": 0.05}
    errors, stated = [], []
    for seed in range(40):
        fit = fit_of(recorded(noise=0.5, seed=seed), decimation=1)
        errors.append([fit.values[name] - truth[name] for name in names])
        stated.append([fit.inference.standard_errors[name] for name in names])
    ratio = np.std(errors, axis=0) / np.mean(stated, axis=0)
    assert np.all((ratio > 0.7) & (ratio < 1.4)), dict(zip(names, ratio, strict=True))
    assert np.all(np.abs(np.mean(errors, axis=0)) < 4.0 * np.mean(stated, axis=0) / np.sqrt(40.0))


def test_back_emf_and_viscous_friction_are_one_until_one_is_held() -> None:
    recording = recorded(viscous=0.01)
    both = fit_of(recording)
    assert both.drive["drive.back_emf"] == pytest.approx(BACK_EMF + 0.01, rel=1e-4)
    assert both.friction[0]["viscous"] == 0.0
    assert any("drive.back_emf with viscous friction" in flag for flag in both.flags)
    held = {"gravity.sine": GRAVITY, "drive.back_emf": BACK_EMF}
    apart = fit_of(recording, held=held)
    assert apart.friction[0]["viscous"] == pytest.approx(0.01, rel=1e-3)
    assert apart.drive["drive.gain"] == pytest.approx(GAIN, rel=1e-4)
    assert not any("drive.back_emf" in flag for flag in apart.flags)


def test_load_dependent_friction_is_found_beside_the_gain() -> None:
    best = found(recorded(load=0.25, noise=0.05), families=("coulomb", "stribeck"), has_modifiers=True).best
    assert best.label == "coulomb + load"
    assert best.friction[1]["load"] == pytest.approx({"motoring": 0.25, "driven": 0.25}, rel=0.03)
    assert best.drive["drive.gain"] == pytest.approx(GAIN, rel=0.01)
    assert any("load.motoring and load.driven with gravity" in flag for flag in best.flags)


def test_rows_at_rest_do_not_count() -> None:
    """An axis that is held by friction while the motor pulls says nothing of sliding."""
    recording = recorded(seconds=12.0)
    velocity, volts = recording["velocity"].copy(), recording["torque"].copy()
    rest = (recording["time_s"] > 4.0) & (recording["time_s"] < 8.0)
    velocity[rest] = 0.0
    position = np.cumsum(velocity) * PERIOD_S
    volts += (INERTIA * (np.gradient(velocity, PERIOD_S) - np.gradient(recording["velocity"], PERIOD_S))) / GAIN
    volts += GRAVITY * (np.sin(position) - np.sin(recording["position"])) / GAIN
    volts[rest] = 3.0 * np.sin(5.0 * recording["time_s"][rest])
    recording.columns.update(position=position, velocity=velocity, torque=volts)
    sliding = fit_of(recording, least_speed=0.05, decimation=1)
    assert sliding.drive["drive.gain"] == pytest.approx(GAIN, rel=0.01)
    assert sliding.train.relative_error < 0.02
    assert np.min(np.abs(sliding.curves.velocity)) >= 0.05
    assert np.all(np.diff(sliding.curves.time_s) > 0.0)
    assert fit_of(recording, decimation=1).train.relative_error > 0.2


def test_groups_are_held_out_as_a_whole() -> None:
    """The error on a group is that of a fit to the other groups alone."""
    given = [
        recorded(noise=0.2, seed=i, amplitude=0.5 + 0.25 * (i // 2), name=f"{i}.csv", trajectory="abc"[i // 2])
        for i in range(6)
    ]
    fit = fit_of(*given, group_by="trajectory")
    assert fit.across_speeds is None
    errors = []
    for group in "abc":
        kept = [each for each in given if each.metadata["trajectory"] == group]
        rest = [each for each in given if each.metadata["trajectory"] != group]
        volts = plain(identify(rest, IN_VOLTS, validation=kept), "coulomb")
        errors.append((fit.drive["drive.gain"] * volts.validation.rmse) ** 2)
    assert fit.held_out.blocks == pytest.approx(errors, rel=0.02)


@pytest.mark.parametrize(
    ("held", "settings", "error", "message"),
    [
        ({}, {}, UsageError, "--fix gravity.sine=MASS"),
        ({"gravity.cosine": 0.0, "offset": 0.1}, {}, UsageError, "--fix gravity.sine=MASS"),
        ({"gravity.sine": -GRAVITY}, {}, RecordingError, "the sign of the signal"),
        ({"gravity.sine": GRAVITY, "coulomb": 0.05}, {}, UsageError, "friction cannot be held"),
        ({"gravity.sine": GRAVITY, "drive.gain": 0.1}, {}, UsageError, "--scale torque=GAIN"),
        ({"gravity.sine": GRAVITY}, {"group_by": "trajectry"}, UsageError, "did you mean 'trajectory'"),
        ({"gravity.sine": GRAVITY}, {"least_speed": 1e3}, RecordingError, "0 rows"),
        ({"gravity.sine": GRAVITY}, {"least_speed": -1.0}, UsageError, "not -1"),
    ],
)
def test_mistakes_are_reported(held, settings, error, message):
    with pytest.raises(error, match=message):
        found(recorded(trajectory="a"), held=held, **settings)


def test_command_writes_the_friction_in_torque(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    recordings.write(tmp_path / "swing.csv", recorded(noise=0.1))
    words = ["identify", "swing.csv", "--models", "coulomb", "--unknown-gain", "--fix", f"gravity.sine={GRAVITY}"]
    assert main([*words, "--output", "axis.yaml", "--json"]) == 0
    document = json.loads(capsys.readouterr().out)
    assert document["fits"][0]["drive"] == pytest.approx({"gain": GAIN, "back_emf": BACK_EMF}, rel=0.05)
    model = load_model_file("axis.yaml")
    assert model.friction.parameters["coulomb"] == pytest.approx(0.05, rel=0.1)
    assert model.mechanics.gravity.sine == pytest.approx(GRAVITY)
    assert model.fit is not None
    assert model.torque_signal.model_dump(exclude={"column"}) == pytest.approx(document["fits"][0]["drive"], rel=1e-6)
    assert main([*words, "--controller", "position_gain=1", "--controller", "velocity_gain=1"]) == 2
    assert "not with --unknown-gain" in capsys.readouterr().err


@pytest.mark.deep
@needs_bam
def test_servo_has_friction_that_grows_with_its_load(tmp_path, monkeypatch, capsys):
    """Its volts are the duty, a signed register of 885 counts, times the supply; released, it has none."""
    monkeypatch.chdir(tmp_path)
    facts = [json.loads(path.read_text()) for path in sorted(BAM.glob("*.json"))]
    mass, length = facts[0]["mass"], facts[0]["length"]
    mapping = ("time_s=timestamp", "position_demand=goal_position", "torque=load:int16*input_volts/885")
    words = ["identify", str(BAM / "*.json"), "--unknown-gain", "--gravity", "pendulum", "--where", "torque_enable"]
    words += [word for each in mapping for word in ("--column", each)]
    words += ["--fix", f"gravity.sine={mass * 9.81 * length}", "--fix", "gravity.cosine=0", "--lowpass", "10"]
    words += ["--decimate", "4", "--min-speed", "0.1", "--group-by", "trajectory", "--output", "servo.yaml", "-v"]
    assert main(words) == 0
    text = capsys.readouterr().out
    assert "Chosen: coulomb + load." in text
    assert "held out in turn" in text
    rows = re.findall(r"^(\w.*?) {2,}\d+ +[\d.]+ % +([\d.]+) %", text, re.MULTILINE)
    error = {label: float(held_out) for label, held_out in rows}
    assert error["coulomb + load"] < 0.9 * error["stribeck"]
    assert error["stribeck"] < 0.9 * error["coulomb"]  # the simplest one is shown, however far it is behind
    model = load_model_file("servo.yaml")
    assert model.fit is not None
    # data sheet: 0.52 N m and 1.47 A at 5 V, 103 rpm without load, so that k_e is at most 0.46 V s/rad
    drive = model.torque_signal
    assert drive.column == "load:int16*input_volts*0.001129943503"
    assert 0.06 < drive.gain < 0.11
    assert 0.25 < drive.back_emf / drive.gain < 0.46
    assert mass * length**2 < model.mechanics.inertia < 2.0 * mass * length**2  # the bob's, and the rotor's
    assert model.friction.modifiers["load"] == pytest.approx({"motoring": 0.24, "driven": 0.24}, abs=0.06)
