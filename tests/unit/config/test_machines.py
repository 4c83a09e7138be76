"""The example machines: they load, fit the schema, follow their motion, and have what they are examples of."""

import json
import math
from pathlib import Path

import jsonschema
import numpy as np
import pytest

from friction_hil.checked_yaml.text import read
from friction_hil.config import load, self_contained
from friction_hil.config.external_torque import simulated_servo
from friction_hil.config.simulation import simulated_servos
from friction_hil.daemon.assembly import periodic_path
from friction_hil.motion.trajectory import PathTime, Trajectory

FOLDER = Path(__file__).parents[3] / "config/machines"
MACHINES = sorted(FOLDER.glob("*.yaml"))
VALIDATOR = jsonschema.Draft202012Validator(json.loads((FOLDER.parent / "schema.json").read_text()))
CSP, CST = 8, 10


def axis_of(name):
    (axis,) = load(FOLDER / f"{name}.yaml").axes.values()
    return axis


def followed(axis, seconds):
    """Follow the trajectory without compensation: following error and twist of each millisecond."""
    one = simulated_servo(axis.simulation)
    return one, followed_together([one], [axis], seconds)[:, 0]


def followed_together(servos, axes, seconds):
    """Follow the trajectories of some axes at once: following error and twist, (milliseconds, axes, 2)."""
    time = PathTime(1.0)
    time.start(0.0)
    trajectories = [Trajectory(periodic_path(axis.trajectory), time) for axis in axes]
    rows = []
    for k in range(round(1e3 * seconds)):
        for one, trajectory in zip(servos, trajectories, strict=True):
            one.command(CSP, trajectory.at(1e-3 * k).position)
        for one in servos:
            one.advance(one.steps_per_second // 1000)
        rows.append([(one.following_error, one.load_position - one.true_position) for one in servos])
    return np.array(rows)


def test_there_are_machines_each_with_a_bus_of_its_own():
    names = "ball_screw belt direct_drive gantry harmonic_drive hobby_servo six_joint_arm telescope two_link_arm"
    assert {path.stem for path in MACHINES} >= {*names.split(), "worm_gear"}
    ports = [load(path).bus.port for path in MACHINES]
    assert len(set(ports)) == len(ports)


@pytest.mark.parametrize("path", MACHINES, ids=lambda path: path.stem)
def test_a_machine_fits_the_schema_and_follows_its_motion(path):
    """Within a fifth of the limit of the following error, and with friction that matters: errors not from rounding."""
    configuration = load(path)
    assert list(VALIDATOR.iter_errors(read(path).value)) == []
    assert list(VALIDATOR.iter_errors(self_contained(configuration))) == []
    assert f"config/machines/{path.name} --simulate" in path.read_text()
    servos = simulated_servos(configuration, configuration.axes)
    rows = followed_together(servos.values(), configuration.axes.values(), 3.0)
    for index, (servo, axis) in enumerate(zip(servos.values(), configuration.axes.values(), strict=True)):
        assert configuration.simulation is not None or not axis.simulation.is_rigid
        error = np.abs(rows[1000:, index, 0])
        assert error.max() < 0.2 * axis.limits.following_error
        assert error.max() > 3.0 / servo.counts_per_unit
        assert abs(servo.torque_demand) < servo.torque_limit
        assert axis.model.mechanics.inertia == pytest.approx(servo.total_inertia, rel=0.1)


@pytest.mark.parametrize(("name", "is_locked"), [("worm_gear", True), ("hobby_servo", False)])
def test_only_the_worm_gear_holds_its_load_without_power(name, is_locked):
    simulation = axis_of(name).simulation
    one = simulated_servo(simulation, 0.0 if is_locked else 0.5 * math.pi)
    start = one.load_position
    one.advance(one.steps_per_second)
    assert (abs(one.load_position - start) < 3e-3) == is_locked


def test_the_strain_wave_gear_warms_up_and_its_friction_falls():
    axis = axis_of("harmonic_drive")
    one, _ = followed(axis, 8.0)
    friction = axis.simulation.friction_model
    cold, warm = (
        float(friction.steady_state([0.5], load_torque=0.0, temperature=temperature)[0])
        for temperature in (axis.simulation.thermal.ambient, one.temperatures.gear)
    )
    assert one.temperatures.gear > axis.simulation.thermal.ambient + 2.0
    assert warm < 0.98 * cold


def test_the_coupling_of_the_ball_screw_crosses_its_play():
    axis = axis_of("ball_screw")
    _, rows = followed(axis, 4.0)
    assert np.ptp(rows[2000:, 1]) > axis.simulation.mechanics.load.backlash


def test_the_shoulder_feels_the_elbow():
    """Held still, it takes the reaction of an elbow that moves; alone it would hang without any error."""
    configuration = load(FOLDER / "two_link_arm.yaml")
    both = simulated_servos(configuration, configuration.axes)
    trajectory = configuration.axes["elbow"].trajectory
    largest = 0.0
    for k in range(1500):
        phase = 2e-3 * math.pi * trajectory.frequency * k
        both["shoulder"].command(CSP, 0.0)
        both["elbow"].command(CSP, 0.3 * trajectory.radius * (1.0 - math.cos(phase)))
        for one in both.values():
            one.advance(one.steps_per_second // 1000)
        largest = max(largest, abs(both["shoulder"].following_error))
    assert 2e-5 < largest < 0.2 * configuration.axes["shoulder"].limits.following_error
