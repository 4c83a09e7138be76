"""Friction that grows with the torque of the load, found from the motion of the axis alone."""

import math

import numpy as np
import pytest

import friction_hil as fh
from friction_hil.identification.data import prepare
from friction_hil.identification.load_dependence import LoadDependence, find_load_dependence, load_torque
from friction_hil.identification.sliding import sliding_mechanics
from friction_hil.motion import experiment
from friction_hil.motion.trajectory import sweeps_path
from friction_hil.recordings import Recording
from tests.compensators import compensator, row
from tests.machine_recordings import axis_of, record

PERIOD_S = 1e-3
INERTIA, LOAD_INERTIA = 1.15, 0.7


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
    torque = INERTIA * a + gravity + np.sign(v) * friction + 5.0 * v
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
    torque = (INERTIA - LOAD_INERTIA) * a + load + 60.0 * np.sign(v) + 0.09 * np.abs(load) * np.sign(v)
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
    load = {"inertia": INERTIA, "load_inertia": LOAD_INERTIA, "gravity": (0.5, 2.0, -1.0)}
    model = fh.models.create("coulomb", coulomb=0.03, modifiers={"load": {"motoring": 0.3, "driven": 0.3}})
    for position, acceleration in ((0.3, 2.0), (-1.2, -30.0)):
        unit = compensator(model, lead_s=0.0, **load)
        demand = {"position_demand": position, "velocity_demand": 0.0, "velocity_demand_ahead": 0.0}
        unit.step(*row(0, position=position, **demand)[:9], acceleration)
        [load_now] = load_torque(mechanics, LOAD_INERTIA, np.array([position]), np.array([acceleration]))
        assert load_now == pytest.approx(unit.load_estimate, rel=1e-12)
