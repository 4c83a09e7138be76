"""Identification of two masses, backlash and encoder errors, against an independent simulation of such an axis."""

import json
import math
from dataclasses import replace
from functools import cache, partial
from pathlib import Path

import numpy as np
import pytest
from scipy import signal

from friction_hil.cli import main
from friction_hil.config import load
from friction_hil.errors import ConfigurationError
from friction_hil.identification import Identification, IdentificationSettings, identify
from friction_hil.identification.data import prepare
from friction_hil.identification.export import add_mechanics, as_model_file, mechanics_as_json
from friction_hil.identification.frequency_response import FrequencyResponse, frequency_response
from friction_hil.identification.load_side import find_load_side
from friction_hil.identification.mechanics import Mechanics, find_mechanics
from friction_hil.identification.resonance import fit_resonance
from friction_hil.models.model_file import ModelFile
from friction_hil.motion import experiment, multisine
from friction_hil.recordings import Recording
from tests.coverage_of_errors import AXES, INTERVAL, QUANTITIES, true_values
from tests.coverage_of_errors import found as coverage
from tests.coverage_of_errors import shaken as product_shaken
from tests.machine_recordings import FOLDER, axis_of, record_mechanism, true_frequencies
from tests.machine_recordings import record as record_machine
from tests.two_mass_axis import Axis, Side, record, sweeps, there_and_back

COULOMB_LOAD = Axis(motor=Side(0.0, viscous=1e-3), load=Side(0.07), resonance_hz=60.0)
GAP = Axis(motor=Side(0.01), load=Side(0.06), backlash=1e-3, resonance_hz=60.0)
RIGID_LUGRE = Axis(resonance_hz=math.inf, motor=Side(0.07, 0.09, sigma0=50.0, sigma1=0.05))
RIGID = Axis(resonance_hz=math.inf)


def without_load(recording: Recording) -> Recording:
    columns = {name: values for name, values in recording.columns.items() if name != "load_position"}
    return Recording(recording.path, recording.axis, columns)


@cache
def excited(axis: Axis) -> Recording:
    """The product's experiment on an axis, with the position of its load."""
    return record(axis, sweeps(experiment.plan(2.0, 0.5, 6e-6, 12.0), 12.5))


shaken = cache(partial(product_shaken, seed=1))  # the product's multisine on an axis


@cache
def found(axis: Axis) -> tuple[Identification, Mechanics]:
    recording = without_load(excited(axis))
    result = identify([recording], IdentificationSettings(families=("lugre",), has_modifiers=False, refine=False))
    return result, find_mechanics([recording], result)


def known(mechanics: Mechanics) -> dict[str, float]:
    return {each.key: each.value for each in mechanics.quantities if each.value is not None}


def truth(axis: Axis) -> dict[str, float]:
    same = ("motor_inertia", "load_inertia", "stiffness", "antiresonance_hz", "resonance_hz", "damping", "backlash")
    friction = {"motor_friction": axis.motor.level, "load_friction": axis.load.level}
    return {name: getattr(axis, name) for name in same} | friction | {"inertia": axis.motor_inertia + axis.load_inertia}


def response_of(recording: Recording) -> FrequencyResponse | None:
    return frequency_response(prepare(recording))


def test_the_response_is_that_of_the_discretised_axis() -> None:
    """Two masses under a torque that is held over the period, as scipy discretises them; little damping."""
    motor, load, stiffness, damping, period_s = 1.2e-4, 4e-4, 7.4, 1e-3, 1e-3
    rates = np.array(
        [
            [0.0, 1.0, 0.0, 0.0],
            [-stiffness / motor, -damping / motor, stiffness / motor, damping / motor],
            [0.0, 0.0, 0.0, 1.0],
            [stiffness / load, damping / load, -stiffness / load, -damping / load],
        ]
    )
    inputs = np.array([[0.0], [1.0 / motor], [0.0], [0.0]])
    system = signal.cont2discrete((rates, inputs, np.eye(1, 4), np.zeros((1, 1))), period_s)
    torque = 0.02 * np.random.default_rng(0).standard_normal(24_000)
    _, position, _ = signal.dlsim((*system[:4], period_s), torque, x0=[0.0, 30.0, 0.0, 30.0])
    columns = {"time_s": period_s * np.arange(len(torque)), "position": position[:, 0], "torque": torque}
    response = response_of(Recording("x.csv", "x", columns))
    assert not response.has_instrument
    band = (response.frequency_hz > 5.0) & (response.frequency_hz < 200.0)
    turns = np.exp(2j * math.pi * response.frequency_hz * period_s)
    found = [system[2] @ np.linalg.solve(turn * np.eye(4) - system[0], system[1]) for turn in turns]
    expected = np.array(found)[:, 0, 0] * math.tau * 1j * response.frequency_hz
    error = np.abs(np.log(response.response / expected))[band]
    assert np.median(error) < 1e-3
    antiresonance = math.sqrt(stiffness / load) / math.tau  # 21.6 Hz, 0.3 Hz wide: less than the distance of two lines
    near = band & (np.abs(response.frequency_hz - antiresonance) < 2.0)
    np.testing.assert_allclose(response.response[near], expected[near], rtol=0.15)
    assert np.all(response.coherence[band] > 0.99)


def test_resonance_and_anti_resonance_are_those_of_the_axis() -> None:
    axis = Axis()
    response = response_of(shaken(axis))
    assert response.has_instrument
    resonance, why = fit_resonance(response)
    assert resonance is not None, why
    expected = truth(axis)
    limits = {"antiresonance_hz": 2e-3, "resonance_hz": 5e-3, "inertia": 0.01, "stiffness": 0.02, "damping": 0.1}
    for name, limit in limits.items():
        assert resonance.values[name] == pytest.approx(expected[name], rel=limit), name
    assert resonance.values["delay_s"] == pytest.approx(0.5e-3, rel=0.1)  # a mean over the period of 1 ms


@pytest.mark.deep
def test_intervals_hold_the_true_values_as_often_as_they_say() -> None:
    """One repetition of each axis; `tests.coverage_of_errors` has as many as you like."""
    scores = []
    for axis in AXES.values():
        true = true_values(axis)
        found_there = list(coverage(axis, 1))
        scores += [[(each.values[key] - true[key]) / each.errors[key] for key in QUANTITIES] for each in found_there]
    assert len(scores) == len(AXES)
    held = np.abs(scores) < INTERVAL
    assert np.count_nonzero(held) >= 8  # 90 % of 12, less two standard deviations and a half
    assert np.std(scores) > 0.4  # and not by errors that are far too large


def test_the_telescope_is_found_as_its_file_has_it() -> None:
    axis = axis_of("telescope")
    bounds = axis.experiment
    plan = multisine.plan(bounds.velocity, bounds.travel, period_s=1e-3, duration_s=24.0)
    response = response_of(record_machine(axis, multisine.multisine_path(plan), plan.duration_s))
    resonance, why = fit_resonance(response)
    assert resonance is not None, why
    for name, expected in true_frequencies(axis).items():
        limit = 0.15 if name == "damping" else 0.02
        assert resonance.values[name] == pytest.approx(expected, rel=limit), name


def test_a_rigid_axis_has_no_resonance() -> None:
    response = response_of(shaken(RIGID))
    assert response.band_hz[1] > 100.0
    resonance, why = fit_resonance(response)
    assert resonance is None
    assert "no resonance from 2 to 150 Hz" in why


@pytest.mark.deep
@pytest.mark.parametrize("moved", ["shoulder", "elbow"])
def test_the_loops_of_an_axis_that_is_held_are_no_coupling(moved: str) -> None:
    """The links are rigid; the other joint gives way under the inertial forces, as far as its loops let it."""
    bounds = load(FOLDER / "two_link_arm.yaml").axes[moved].experiment
    plan = multisine.plan(bounds.velocity, bounds.travel, period_s=1e-3, duration_s=16.0)
    recorded = record_mechanism("two_link_arm", moved, multisine.multisine_path(plan), plan.duration_s)
    own = recorded.pop(moved)
    [other] = recorded.values()
    segments = prepare(own)
    beside = [np.interp(each.time_s, other["time_s"], other["position"])[:, None] for each in segments]
    alone, both = (frequency_response(segments, beside=each) for each in (None, beside))
    assert fit_resonance(alone)[0] is not None
    assert fit_resonance(both)[0] is None


def test_slow_strokes_excite_no_response() -> None:
    response = response_of(without_load(record(Axis(), there_and_back(1.0, 1.5, 12.0))))
    assert response is None or fit_resonance(response)[0] is None


@pytest.mark.deep
def test_the_spring_of_a_coupling_is_not_put_into_the_bristle_unsaid() -> None:
    result, mechanics = found(COULOMB_LOAD)
    assert result.best.values["sigma0"] == pytest.approx(COULOMB_LOAD.stiffness, rel=0.5)  # what LuGre makes of it
    [flag] = mechanics.flags
    assert "may be the coupling's" in flag
    values, expected = known(mechanics), truth(COULOMB_LOAD)
    assert mechanics.load is not None
    for name, limit in {"motor_inertia": 0.1, "load_inertia": 0.1, "stiffness": 0.05, "load_friction": 0.03}.items():
        assert values[name] == pytest.approx(expected[name], rel=limit), name
    assert values["antiresonance_hz"] == pytest.approx(expected["antiresonance_hz"], rel=0.05)
    assert values["motor_friction"] < 0.05 * values["load_friction"]


@pytest.mark.deep
def test_the_bristle_of_a_rigid_axis_is_not_taken_for_a_coupling() -> None:
    result, mechanics = found(RIGID_LUGRE)
    assert result.best.values["sigma0"] == pytest.approx(50.0, rel=0.1)
    assert mechanics.flags == ()
    assert mechanics.load is None
    missing = {each.key: each.missing for each in mechanics.quantities if each.value is None}
    assert {"stiffness", "resonance_hz", "backlash", "load_friction", "load_dependence"} <= set(missing)
    assert all("record" in missing[name] for name in ("stiffness", "backlash", "load_dependence"))
    [line] = (each for each in mechanics.lines if each.startswith("backlash"))
    assert "not determined" in line


def rigid_axis(counts: int, rate_hz: float, inertia: float) -> Recording:
    """An axis of one mass with Coulomb and viscous friction, whose encoder is coarse for three sines."""
    time = np.arange(round(40.0 * rate_hz)) / rate_hz
    omega, size = math.tau * np.array([[0.11], [0.37], [0.83]]), np.array([[0.55], [0.35], [0.12]])
    position, velocity = (
        np.sum(size * np.sin(omega * time), axis=0),
        np.sum(size * omega * np.cos(omega * time), axis=0),
    )
    acceleration = -np.sum(size * omega**2 * np.sin(omega * time), axis=0)
    noise = 0.008 * np.random.default_rng(counts).standard_normal(time.size)
    torque = inertia * acceleration + 0.3 * np.sign(velocity) + 0.12 * velocity + noise
    step = math.tau / counts
    return Recording("x", "x", {"time_s": time, "position": step * np.round(position / step), "torque": torque})


@pytest.mark.parametrize(("counts", "rate_hz"), [(4096, 200.0), (4096, 1000.0), (2000, 500.0)])
def test_noise_of_a_coarse_encoder_is_no_coupling_and_costs_little_inertia(counts: int, rate_hz: float) -> None:
    recording = rigid_axis(counts, rate_hz, inertia=0.02)
    result = identify([recording], IdentificationSettings(families=("coulomb",), has_modifiers=False))
    assert not any("coupling" in each for each in result.notes)
    assert result.best.mechanics["inertia"] == pytest.approx(
        0.02, rel=0.15
    )  # of 20 Hz to 100 Hz, noise took up to 65 %
    assert find_mechanics([recording], result).load is None


def test_backlash_is_found_from_the_motor_alone():
    _, mechanics = found(GAP)
    expected, quantities = truth(GAP), {each.key: each for each in mechanics.quantities}
    assert mechanics.backlash == pytest.approx(GAP.backlash, rel=0.1)
    for name in ("backlash", "motor_friction", "load_friction", "stiffness"):
        assert abs(quantities[name].value - expected[name]) < 4.0 * quantities[name].error, name
        assert quantities[name].error < 0.1 * expected[name], name


@pytest.mark.deep
def test_a_weight_that_holds_a_gap_closed_is_named() -> None:
    plain = without_load(excited(RIGID_LUGRE))
    settings = IdentificationSettings(families=("coulomb",), has_modifiers=False, refine=False)
    recording = Recording(plain.path, plain.axis, {**plain.columns, "torque": plain["torque"] + 0.5})
    mechanics = find_mechanics([recording], identify([recording], settings))
    [why] = (each.missing for each in mechanics.quantities if each.key == "backlash")
    assert "such as a weight, holds the load against one side" in why
    assert "record strokes" in why


def test_with_the_position_of_the_load_each_side_is_known():
    with_gap, without = (find_load_side([one], prepare(one)) for one in map(excited, (GAP, COULOMB_LOAD)))
    expected = truth(GAP)
    for name in ("backlash", "motor_inertia", "motor_friction", "load_friction", "stiffness"):
        assert with_gap.values[name] == pytest.approx(expected[name], rel=0.05), name
    assert "backlash" not in without.values


@pytest.mark.deep
@pytest.mark.parametrize("is_encoder", [True, False])
def test_an_error_of_the_encoder_is_told_from_cogging_by_the_speed(is_encoder: bool) -> None:
    slow, fast = (there_and_back(speed, 5.0, 8.0) for speed in (1.5, 5.0))
    axis = replace(RIGID, **({"encoder_error": (2e-4, 40.0)} if is_encoder else {"cogging": (3e-3, 40.0)}))
    recording = without_load(record(axis, np.concatenate([slow, fast])))
    settings = IdentificationSettings(families=("coulomb",), has_modifiers=False, gravity="none", refine=False)
    mechanics = find_mechanics([recording], identify([recording], settings))
    [error] = (each for each in mechanics.quantities if each.key == "encoder_error")
    if not is_encoder:
        assert error.value is None
        assert "speed" in error.missing
        return
    assert "order 40" in error.label
    assert error.value == pytest.approx(2e-4, rel=0.15)


def test_model_file_has_the_load_and_is_read_again() -> None:
    result, mechanics = found(COULOMB_LOAD)
    content = as_model_file(result)
    add_mechanics(content, mechanics)
    read = ModelFile.model_validate(content).mechanics
    values = known(mechanics)
    assert read.load.stiffness == pytest.approx(values["stiffness"])
    assert read.inertia == pytest.approx(values["inertia"])
    assert read.load.inertia < read.inertia
    assert any("coupling" in flag for flag in content["fit"]["flags"])
    printed = json.loads(json.dumps(mechanics_as_json(mechanics)))
    assert printed["quantities"]["stiffness"]["standard_error"] > 0.0
    assert printed["quantities"]["backlash"]["missing"]


def test_a_load_heavier_than_the_axis_is_refused() -> None:
    content = {"inertia": 1e-4, "load": {"inertia": 2e-4, "stiffness": 5.0}}
    friction = {"model": "coulomb", "parameters": {"coulomb": 0.1}}
    with pytest.raises((ConfigurationError, ValueError), match=r"part of mechanics\.inertia"):
        ModelFile.model_validate({"axis": "rotary", "friction": friction, "mechanics": content})


@pytest.mark.deep
def test_command_prints_what_was_found_and_what_was_not(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    np.savez("shaken.npz", **shaken(Axis()).columns)
    words = ["identify", "shaken.npz", "--models", "coulomb", "--gravity", "none", "-v", "--output", "m.yaml"]
    assert main([*words, "--report", "report.html"]) == 0
    shown = " ".join(capsys.readouterr().out.split())
    assert "anti-resonance" in shown
    assert "backlash: not determined:" in shown
    text = Path("report.html").read_text()
    assert "<h2>Mechanics</h2>" in text
    assert "Frequency response of the motor" in text
    assert "load:" in Path("m.yaml").read_text()
