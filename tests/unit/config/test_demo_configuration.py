"""The configuration of the demo: loops tuned to their margins, and every parameter of the compensator 15 % off."""

from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest

from friction_hil.config import load
from friction_hil.demo import demonstration

DEMO = Path(__file__).parents[3] / "config/demo.yaml"
AXES = load(DEMO).axes


def test_the_product_carries_the_very_same_file():
    assert (files("friction_hil.demo") / "demo.yaml").read_bytes() == DEMO.read_bytes()


def ratios(axis):
    plant, model = axis.simulation, axis.model
    true = plant.friction.parameters
    believed = model.friction.parameters
    return [
        believed["sigma0"] / sum(true["stiffness"]),
        believed["sigma2"] / true["viscous"],
        *(believed[name] / true[name] for name in ("coulomb", "static", "stribeck_velocity")),
        model.mechanics.inertia / plant.mechanics.inertia,
        model.mechanics.torque_lag_s / plant.motor.torque_lag_s,
    ]


def test_the_daemon_has_a_simpler_model_than_the_truth_15_percent_off_the_other_way_round_on_y():
    above = np.array(ratios(AXES["x"])) - 1.0
    assert np.abs(above) == pytest.approx(0.15)
    assert set(np.sign(above)) == {-1.0, 1.0}
    assert np.array(ratios(AXES["y"])) - 1.0 == pytest.approx(-above)
    for axis in AXES.values():
        assert (axis.model.friction_model.name, axis.simulation.friction_model.name) == ("lugre", "gms")
        assert axis.simulation.friction.modifiers["ripple"]
        assert (axis.compensation.enabled, axis.compensation.gain) == (True, 0.9)
        assert axis.simulation.loops.velocity_feedforward == axis.simulation.loops.inertia_feedforward == 1.0


def test_only_bus_and_learning_differ_from_the_file_in_the_demo(tmp_path):
    copy = load(demonstration.private_configuration(tmp_path))
    for name, axis in copy.axes.items():
        given = AXES[name].compensation
        assert (given.learning, axis.compensation.learning) == ("off", "on")
        assert axis.compensation.model_copy(update={"learning": "off"}) == given
        assert axis.model.model_dump() == AXES[name].model.model_dump()
        assert axis.simulation == AXES[name].simulation


def open_loop(plant, frequency_hz, position_gain):
    """Frequency response of the drive's loop, cut at the torque: sampled control, lagging torque, inertia."""
    loops, sample = plant.loops, 1.0 / plant.loops.rate_hz
    s = 2j * np.pi * frequency_hz
    delay = np.exp(-s * sample)
    hold = (1.0 - delay) / (s * sample)
    velocity = hold / (1.0 + s * plant.motor.torque_lag_s) / (plant.mechanics.inertia * s)
    pole = np.exp(-2.0 * np.pi * loops.velocity_filter_hz * sample)
    seen = (1.0 - delay) / (s * sample) * (1.0 - pole) / (1.0 - pole * delay)
    integral = 2.0 * np.pi * loops.integral_hz * sample / (1.0 - delay)
    return loops.velocity_gain * (1.0 + integral) * (seen + position_gain / s) * velocity


def phase_margin(plant, position_gain):
    frequency = np.geomspace(1.0, 3000.0, 100_000)
    response = open_loop(plant, frequency, position_gain)
    crossing = np.flatnonzero(np.abs(response) > 1.0)[-1]
    return frequency[crossing], 180.0 + np.degrees(np.angle(response[crossing]))


@pytest.mark.parametrize("axis", AXES)
def test_loops_are_as_stiff_as_their_margins_allow(axis):
    plant = AXES[axis].simulation
    crossover, margin = phase_margin(plant, 0.0)
    assert 2.0 * np.pi * crossover == pytest.approx(1000.0, rel=0.05)
    assert margin == pytest.approx(55.0, abs=1.0)
    assert plant.loops.position_gain == pytest.approx(1000.0 / 5.0)
    assert 2.0 * np.pi * plant.loops.integral_hz == pytest.approx(1000.0 / 10.0, rel=0.02)
    assert phase_margin(plant, plant.loops.position_gain)[1] == pytest.approx(43.0, abs=1.0)
