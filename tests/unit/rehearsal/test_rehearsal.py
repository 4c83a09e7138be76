"""Rehearsal in simulation: the same as the loop itself gives, for each mode, and gains as in the simulated drive."""

import math
from dataclasses import replace

import numpy as np
import pytest

from friction_hil.daemon.safety import LoopState
from friction_hil.drive import AxisFacts
from friction_hil.errors import RecordingError
from friction_hil.identification.drive_loop import identify_loops
from friction_hil.models.model_file import ModelFile
from friction_hil.motion.trajectory import sine_path
from friction_hil.recordings import Recording
from friction_hil.rehearsal import Motion, Rehearsal
from friction_hil.servo.config import Encoder, Loops, ServoConfig
from tests.servo_drives import PERIOD_S, TRUE_FRICTION, axis_dict, configuration, run

OWN_LOOPS = {
    "csp": {},
    "csv": {"controller": {"position_gain": 30.0}},
    "cst": {"controller": {"position_gain": 40.0, "velocity_gain": 0.04, "integral_hz": 3.0}},
}
SETPOINT_DELAY = {"csp": 2.5, "csv": 2.0, "cst": 1.5}
AMPLITUDE, HZ = 0.3, 1.0


def facts(mode, servo):
    resolution = 2.0 * math.pi / servo.encoder.counts
    return AxisFacts("x", "", resolution, 6.4e-4, SETPOINT_DELAY[mode] * PERIOD_S, 1.5 * PERIOD_S)


def machine(mode, **changes):
    return configuration(x=axis_dict(mode=mode, **OWN_LOOPS[mode], **changes))


def recorded(config, servo, duration_s):
    """Columns of a run of the daemon's loop on a simulated servo, while it moves."""
    _, rows, _ = run(config, servo=servo, duration_s=duration_s)
    names = ("state", "position", "position_demand", "velocity_demand", "torque", "time_s")
    columns = {name: np.array(rows.column("x", name)) for name in names}
    moves = np.isfinite(columns["position_demand"]) & (columns["state"] == LoopState.RUNNING)
    return {name: values[moves] for name, values in columns.items()}


def rehearsed_and_run(mode, servo, **compensation):
    """The rehearsal of an axis, and the errors that the loop itself leaves in the same motion."""
    config = machine(mode, compensation={"fade_s": 0.1, **compensation})
    axis, columns = config.axes["x"], recorded(config, servo, 5.0)
    error = (columns["position_demand"] - columns["position"])[round(2.0 / PERIOD_S) :][: round(2.0 / PERIOD_S)]
    motion = Motion(sine_path(AMPLITUDE, HZ, 0.0), 2.0, ramp_s=0.25, start_s=2.0)
    is_compensated = compensation.get("enabled", True)
    rehearsal = Rehearsal(axis, facts(mode, servo), PERIOD_S)
    return rehearsal.run(servo, axis.model, motion, is_compensated=is_compensated), error


@pytest.mark.deep
@pytest.mark.parametrize(("mode", "bits"), [("csp", 20), ("csp", 13), ("csv", 20), ("cst", 20)])
@pytest.mark.parametrize("is_compensated", [False, True])
def test_a_rehearsal_has_the_error_of_the_loop_itself(mode, bits, is_compensated):
    servo = ServoConfig(loops=Loops(position_gain=100.0, velocity_gain=0.1), encoder=Encoder(counts=2**bits))
    outcome, error = rehearsed_and_run(mode, servo, enabled=is_compensated)
    assert outcome.rms == pytest.approx(float(np.sqrt(np.mean(error**2))), rel=0.05)
    assert outcome.peak == pytest.approx(float(np.max(np.abs(error))), rel=0.1)
    assert outcome.gain_factor == 1.0


def test_a_machine_of_two_masses_is_rehearsed_as_the_loop_itself_moves_it():
    load = {"inertia": 1e-4, "stiffness": 50.0, "damping": 5e-3, "backlash": 2e-3}
    loops = {"position_gain": 60.0, "velocity_gain": 0.05}
    parts = {"mechanics": {"inertia": 1e-4, "load": load}, "loops": loops, "encoder": {"at": "both"}}
    outcome, error = rehearsed_and_run("csp", ServoConfig.model_validate(parts))
    assert outcome.rms == pytest.approx(float(np.sqrt(np.mean(error**2))), rel=0.1)


def test_a_model_with_too_much_friction_swings_in_a_rehearsal() -> None:
    servo = ServoConfig()
    axis = machine("csp").axes["x"]
    level = {name: 3.0 * TRUE_FRICTION[name] for name in ("coulomb", "static")}
    friction = {"model": "lugre", "parameters": {**TRUE_FRICTION, **level}}
    wrong = ModelFile.model_validate({"axis": "rotary", "friction": friction, "mechanics": {"inertia": 2e-4}})
    rehearsal = Rehearsal(axis, facts("csp", servo), PERIOD_S)
    motion = Motion(sine_path(0.02, 0.5, 0.0), 4.0)
    without = rehearsal.run(servo, wrong, motion, is_compensated=False)
    outcome = rehearsal.run(servo, wrong, motion)
    assert outcome.gain_factor < 1.0 or outcome.rms > without.rms
    assert rehearsal.run(servo, axis.model, motion).rms < without.rms


def excited(mode, servo):
    """Recording of a motion of several frequencies, uncompensated."""
    bounds = {"velocity": 4.0, "travel": 0.8, "duration_s": 12.0, "ramp_s": 0.25}
    config = machine(mode, compensation={"enabled": False}, trajectory={"kind": "experiment", **bounds})
    columns = recorded(config, servo, 12.0)
    return Recording("memory", "x", columns)


@pytest.mark.deep
@pytest.mark.parametrize("bits", [20, 18])
def test_the_loops_of_a_drive_are_found_from_its_torque(bits) -> None:
    true = Loops(position_gain=90.0, velocity_gain=0.12, integral_hz=6.0)
    servo = ServoConfig(loops=true, encoder=Encoder(counts=2**bits))
    recording = excited("csp", servo)
    found = identify_loops(recording, "csp", 2.0 * math.pi / 2**bits)
    assert found.explained > 0.98
    assert found.velocity_gain == pytest.approx(true.velocity_gain, rel=0.12)
    # the torque depends on the sum and the product of the two corners
    corner = math.tau * found.integral_hz
    true_corner = math.tau * true.integral_hz
    assert found.position_gain + corner == pytest.approx(true.position_gain + true_corner, rel=0.15)
    assert found.position_gain * corner == pytest.approx(true.position_gain * true_corner, rel=0.2)
    assert found.velocity_feedforward == 1.0


def test_a_drive_without_feedforward_is_recognised() -> None:
    servo = ServoConfig(loops=Loops(position_gain=90.0, velocity_gain=0.12, integral_hz=6.0, velocity_feedforward=0.0))
    found = identify_loops(excited("csp", servo), "csp", 2.0 * math.pi / 2**20)
    assert found.velocity_feedforward == pytest.approx(0.0, abs=0.1)
    assert found.velocity_gain == pytest.approx(0.12, rel=0.12)


def test_the_velocity_loop_is_found_in_csv() -> None:
    true = Loops(velocity_gain=0.1, integral_hz=8.0)
    found = identify_loops(excited("csv", ServoConfig(loops=true)), "csv", 2.0 * math.pi / 2**20, 30.0)
    assert (found.position_gain, found.explained > 0.98) == (0.0, True)
    assert found.velocity_gain == pytest.approx(true.velocity_gain, rel=0.12)
    assert found.integral_hz == pytest.approx(true.integral_hz, rel=0.2)


def test_a_torque_that_follows_no_loop_is_refused() -> None:
    recording = excited("csp", ServoConfig())
    noise = np.random.default_rng(1).normal(size=len(recording))
    strange = replace(recording, columns={**recording.columns, "torque": noise})
    with pytest.raises(RecordingError, match="cascade of gains explains"):
        identify_loops(strange, "csp", 6e-6)
