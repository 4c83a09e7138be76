"""What the rows show in which an axis slides: gravity, inertia, levels, and friction that grows with the load."""

import math
from functools import cache
from typing import Any

import numpy as np
import pytest

import friction_hil as fh
from friction_hil import friction as models
from friction_hil.identification import IdentificationSettings, identify
from friction_hil.identification.candidates import CandidateFitter
from friction_hil.identification.data import moved_since_reversal, prepare
from friction_hil.identification.load_dependence import LoadDependence, find_load_dependence, load_torque
from friction_hil.identification.sliding import LOW_HZ, WIDE_HZ, sliding_mechanics
from friction_hil.motion import experiment
from friction_hil.motion.trajectory import sweeps_path
from friction_hil.recordings import Recording
from tests.compensators import compensator, row
from tests.machine_recordings import axis_of, record


@cache
def experiment_on(name: str, seconds: float) -> Recording:
    """The experiment of `tune` on an example machine."""
    axis = axis_of(name)
    bounds, counts = axis.experiment, axis.simulation.encoder.counts
    assert bounds.acceleration is not None
    given = {"acceleration": bounds.acceleration, "period_s": 1e-3}
    plan = experiment.plan(bounds.velocity, bounds.travel, math.tau / counts, seconds, **given)
    return record(axis, sweeps_path(plan), seconds)


def fit_of(name: str, seconds: float, family: str, **held: float) -> Any:
    """The fit of a family to the experiment of a machine, and what was noted."""
    settings = IdentificationSettings(families=(family,), has_modifiers=False, held=held)
    fitter = CandidateFitter([experiment_on(name, seconds)], [], settings, lambda _: None)
    return fitter.fit(fitter.build(family, is_directed=False)), fitter.notes


@pytest.mark.deep
def test_weight_and_inertia_of_a_joint_are_found_behind_its_soft_gear():
    mechanics = axis_of("harmonic_drive").simulation.mechanics
    fit, notes = fit_of("harmonic_drive", 40.0, "lugre")
    # losses of the gear count as a little of either
    assert fit.mechanics["inertia"] == pytest.approx(mechanics.inertia + mechanics.load.inertia, rel=0.15)
    assert fit.mechanics["gravity.sine"] == pytest.approx(mechanics.gravity.sine, rel=0.15)
    assert any("below 12 Hz" in note for note in notes)


def test_a_stiff_axis_without_gravity_has_none_and_nothing_held_but_by_the_user():
    fit, notes = fit_of("direct_drive", 24.0, "coulomb")
    assert fit.mechanics["gravity.sine"] == fit.mechanics["gravity.cosine"] == 0.0
    assert "inertia" in fit.inference.standard_errors
    assert notes == []
    fit, _ = fit_of("harmonic_drive", 40.0, "coulomb", inertia=1.0)
    assert fit.mechanics["inertia"] == 1.0


def test_a_load_that_swings_makes_the_axis_look_light_in_fast_motion_only() -> None:
    records = prepare(experiment_on("harmonic_drive", 40.0))
    slow, fast = (sliding_mechanics(records, can_swing=True, low_hz=low_hz) for low_hz in (LOW_HZ, WIDE_HZ))
    assert (slow.differs(fast), slow.has_swing) == (True, True)
    assert fast.inertia < 0.7 * slow.inertia


def test_an_axis_that_does_not_slide_tells_nothing() -> None:
    time = 1e-3 * np.arange(5000)
    position = 1e-3 * np.sin(math.tau * 60.0 * time)
    columns = {"time_s": time, "position": position, "torque": 10.0 * position}
    assert sliding_mechanics(prepare(Recording("x.csv", "x", columns)), can_swing=True) is None


TRUE = {"coulomb": 300.0, "static": 420.0, "stribeck_velocity": 0.01}
STIFFNESS, VISCOUS, INERTIA, PERIOD_S = 4e6, 300.0, 800.0, 1e-3
SLIDING = {"least_speed": 4e-4, "sliding_s": 5e-3, "lowpass_hz": 100.0, "decimation": 10}


def slow_axis() -> Recording:
    """A heavy axis that moves so slowly that its bristles take a second to turn where it reverses slowest."""
    time = np.arange(0.0, 40.0, PERIOD_S)
    swell = 0.01 + 0.99 * np.sin(math.pi * time / 40.0) ** 2
    position = 0.06 * swell * np.sin(math.tau * 0.35 * time)
    velocity = np.gradient(position, PERIOD_S)
    lugre = models.create("lugre", sigma0=STIFFNESS, sigma1=2e4, sigma2=VISCOUS, damping_velocity=0.01, **TRUE)
    torque = lugre.simulate(velocity, PERIOD_S) + INERTIA * np.gradient(velocity, PERIOD_S)
    return Recording("slow.mcap", "x", {"time_s": time, "position": position, "torque": torque}, {})


def test_a_slow_axis_shows_its_levels_where_the_bristles_have_turned() -> None:
    turned = 5.0 * TRUE["static"] / STIFFNESS
    settings = IdentificationSettings(families=("stribeck",), **SLIDING, sliding_distance=turned)
    fit = next(each for each in identify([slow_axis()], settings).fits if each.label == "stribeck")
    assert {name: fit.values[name] for name in TRUE} == pytest.approx(TRUE, rel=0.05)
    assert fit.values["viscous"] == pytest.approx(VISCOUS, rel=0.03)
    assert fit.values["inertia"] == pytest.approx(INERTIA, rel=0.02)


def test_rows_near_a_reversal_do_not_count_and_that_is_noted():
    [near] = prepare(slow_axis(), **SLIDING)
    [segment] = prepare(slow_axis(), **SLIDING, sliding_distance=2e-3)
    assert np.count_nonzero(segment.is_moving) < np.count_nonzero(near.is_moving)
    assert "within 0.002 of a reversal" in segment.problems[-1]
    velocity, position = np.array([[1.0, 1.0, -1.0, -1.0, 2.0], [0.0, 1.0, 1.5, 0.5, 0.0]])
    assert moved_since_reversal(velocity, position).tolist() == [0.0, 1.0, 0.0, 1.0, 0.0]


TOTAL_INERTIA, LOAD_INERTIA = 1.15, 0.7


def moved(factor: float, weight: dict[str, float], amplitude: float = 1.0, seed: int = 0) -> Recording:
    """Sines of two frequencies that swell and fade; Stribeck friction, and more of it with the load."""
    time = PERIOD_S * np.arange(30_000)
    swell = amplitude * np.sin(math.pi * time / 30.0) ** 2
    q = swell * (0.7 * np.sin(math.tau * 0.6 * time) + 0.2 * np.sin(math.tau * 1.7 * time))
    v = np.gradient(q, PERIOD_S)
    a = np.gradient(v, PERIOD_S)
    gravity = weight.get("offset", 0.0) + weight.get("gravity.sine", 0.0) * np.sin(q)
    load = gravity + LOAD_INERTIA * a
    friction = 6.0 + 2.0 * np.exp(-((v / 0.1) ** 2)) + factor * np.abs(load)
    torque = TOTAL_INERTIA * a + gravity + np.sign(v) * friction + 5.0 * v
    torque += 0.1 * np.random.default_rng(seed).standard_normal(len(time))
    return Recording("x.csv", "x", {"time_s": time, "position": q, "torque": torque})


def found(factor, weight, load_inertia=LOAD_INERTIA, **given) -> LoadDependence:
    result = find_load_dependence(prepare(moved(factor, weight, **given)), weight, load_inertia, ())
    assert result is not None
    return result


@pytest.mark.parametrize("weight", [{"gravity.sine": 15.7}, {"offset": 20.0}], ids=["pendulum", "weight"])
@pytest.mark.parametrize("factor", [0.25, 1.2])
def test_the_factor_is_found_with_its_error(factor: float, weight: dict[str, float]) -> None:
    result = found(factor, weight)
    assert result.is_clear
    assert result.error < 0.15 * factor
    assert result.factor == pytest.approx(factor, abs=4.0 * result.error + 0.01)


def test_friction_without_load_dependence_has_none() -> None:
    result = found(0.0, {"gravity.sine": 15.7})
    assert (result.is_clear, result.is_excluded) == (False, True)


@pytest.mark.parametrize("inertia", [None, LOAD_INERTIA])
def test_friction_of_the_load_that_holds_it_against_one_side_hides_the_factor(inertia: float | None) -> None:
    """The screw: what the nut loses looks like inertia, and is not denied."""
    time = PERIOD_S * np.arange(20_000)
    q = np.sin(math.pi * time / 20.0) ** 2 * np.sin(math.tau * 0.6 * time)
    v = np.gradient(q, PERIOD_S)
    a = np.gradient(v, PERIOD_S)
    load = LOAD_INERTIA * a + 30.0 * np.sign(v)
    torque = (TOTAL_INERTIA - LOAD_INERTIA) * a + load + 60.0 * np.sign(v) + 0.09 * np.abs(load) * np.sign(v)
    torque += 0.1 * np.random.default_rng(0).standard_normal(len(time))
    recording = Recording("x.csv", "x", {"time_s": time, "position": q, "torque": torque})
    result = find_load_dependence(prepare(recording), {}, inertia, ())
    assert (result.is_clear, result.is_excluded) == (False, False)


def test_the_factor_of_a_hobby_servo_is_right_though_its_load_is_not_known() -> None:
    axis = axis_of("hobby_servo")
    plan = experiment.plan(2.0, 1.2, math.tau / 4096, 60.0, acceleration=25.0, period_s=PERIOD_S)
    records = prepare(record(axis, sweeps_path(plan), 60.0))
    slow = sliding_mechanics(records, can_swing=True)
    result = find_load_dependence(records, {"gravity.sine": slow.sine}, None, ())
    gear = axis.simulation.gear
    true = 0.5 * (1.0 / gear.forward_efficiency - gear.backward_efficiency)
    assert result.is_clear
    assert abs(result.factor - true) < 3.0 * result.error
    assert result.error < 0.25 * true


def test_an_axis_whose_load_hardly_changes_or_that_does_not_slide_tells_nothing():
    result = found(0.25, {"offset": 20.0}, amplitude=0.01)
    assert (result.is_clear, result.is_excluded) == (False, False)
    recording = moved(0.25, {})
    recording.columns["position"] = np.sin(math.tau * 60.0 * recording["time_s"])
    assert find_load_dependence(prepare(recording), {}, LOAD_INERTIA, ()) is None


def test_the_load_is_that_of_the_compensator():
    mechanics = {"gravity.constant": 0.5, "gravity.sine": 2.0, "gravity.cosine": -1.0}
    load = {"inertia": TOTAL_INERTIA, "load_inertia": LOAD_INERTIA, "gravity": (0.5, 2.0, -1.0)}
    model = fh.models.create("coulomb", coulomb=0.03, modifiers={"load": {"motoring": 0.3, "driven": 0.3}})
    for position, acceleration in ((0.3, 2.0), (-1.2, -30.0)):
        unit = compensator(model, lead_s=0.0, **load)
        demand = {"position_demand": position, "velocity_demand": 0.0, "velocity_demand_ahead": 0.0}
        unit.step(*row(0, position=position, **demand)[:9], acceleration)
        [load_now] = load_torque(mechanics, LOAD_INERTIA, np.array([position]), np.array([acceleration]))
        assert load_now == pytest.approx(unit.load_estimate, rel=1e-12)
