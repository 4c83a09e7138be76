"""Rehearsal in simulation: the same as the loop itself gives, of single axes and of two on one mechanism."""

import copy
import json
import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from friction_hil.checked_yaml.text import dump
from friction_hil.cli import main
from friction_hil.config import from_dict, load, self_contained
from friction_hil.daemon.safety import LoopState
from friction_hil.drive import AxisFacts
from friction_hil.errors import RecordingError
from friction_hil.friction import describe
from friction_hil.identification.drive_loop import identify_loops
from friction_hil.models.model_file import ModelFile
from friction_hil.motion.trajectory import sine_path
from friction_hil.recordings import Recording
from friction_hil.rehearsal import AxisRun, Motion, Rehearsal, rehearse, simulated_machines
from friction_hil.servo.config import Encoder, Loops, ServoConfig
from friction_hil.tuning.rehearsal_motions import simulated_motions
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


def test_a_drive_without_feedforward_is_recognised_and_a_torque_that_follows_no_loop_is_refused():
    loops = Loops(position_gain=90.0, velocity_gain=0.12, integral_hz=6.0, velocity_feedforward=0.0)
    recording, resolution = excited("csp", ServoConfig(loops=loops)), 2.0 * math.pi / 2**20
    found = identify_loops(recording, "csp", resolution)
    assert found.velocity_feedforward == pytest.approx(0.0, abs=0.1)
    assert found.velocity_gain == pytest.approx(0.12, rel=0.12)
    recording.columns["torque"] = np.random.default_rng(1).normal(size=len(recording))
    with pytest.raises(RecordingError, match="gains explains"):
        identify_loops(recording, "csp", resolution)


def test_the_velocity_loop_is_found_in_csv() -> None:
    true = Loops(velocity_gain=0.1, integral_hz=8.0)
    found = identify_loops(excited("csv", ServoConfig(loops=true)), "csv", 2.0 * math.pi / 2**20, 30.0)
    assert (found.position_gain, found.explained > 0.98) == (0.0, True)
    assert found.velocity_gain == pytest.approx(true.velocity_gain, rel=0.12)
    assert found.integral_hz == pytest.approx(true.integral_hz, rel=0.2)


MACHINES = Path(__file__).parents[3] / "config/machines"
FRICTION = {"model": "lugre", "parameters": dict(describe("lugre").example)}
SHARE = 2.0**-12  # kg; of the beam, at each motor
INERTIAS = {"a": 2e-4, "b": 3e-4}
# the mass in the ends of the beam, dyadic: nothing is left to couple
SEPARATE = {"kind": "gantry", "axes": ["a", "b"], "span": 2.0, "beam": {"mass": 2 * SHARE, "inertia": 2 * SHARE}}

COUNTS = 1e8  # per m
# a step of the integration late is 2e-5 m; a count that is rounded differently moves the axis by some counts
MOST = {"error": 1e-6, "load_error": 1e-6, "compensation": 1e-4, "demand": 0.0, "gain_factor": 0.0}


def axis_of(node, mode, mechanics):
    controller = {"position_gain": 40.0, "velocity_gain": 0.04, "integral_hz": 3.0}
    model = {"axis": "linear", "friction": FRICTION, "mechanics": {"inertia": mechanics["inertia"]}}
    parts = {"friction": FRICTION, "loops": {"position_gain": 60.0, "velocity_gain": 0.05}}
    parts |= {"mechanics": {"axis": "linear", **mechanics}, "encoder": {"counts": COUNTS}}
    given = {"counts_per_unit": COUNTS, "rated_torque": 1.0, "mode": mode, "model": model, "simulation": parts}
    given |= {"limits": {"torque": 0.3, "torque_slew": 300.0, "velocity": 30.0}}
    trajectory = {"kind": "sine", "amplitude": 0.3, "frequency": 1.0}
    given |= {"trajectory": trajectory, **({"controller": controller} if mode == "cst" else {})}
    return axis_dict(node=node, **given)


def machines(modes, mechanism, **parts):
    share = 0.0 if mechanism else SHARE
    axes = {
        name: axis_of(node, modes[name], {"inertia": inertia + share, **parts})
        for node, (name, inertia) in enumerate(INERTIAS.items(), start=1)
    }
    bus = {"interface": "virtual", "channel": "coupled-rehearsal"}
    shared = {"simulation": {"mechanism": mechanism}} if mechanism else {}
    return simulated_machines(from_dict({"version": 1, "period_s": 1e-3, "bus": bus, **shared, "axes": axes}, "test"))


@pytest.mark.parametrize("modes", [{"a": "csp", "b": "csp"}, {"a": "csv", "b": "cst"}])
def test_axes_that_nothing_couples_are_rehearsed_as_single_ones(modes):
    """Also where their commands take effect at different moments, in the same cycle or in another one."""
    motions = {
        "a": Motion(sine_path(0.3, 1.0, 0.0), 1.0, ramp_s=0.5, start_s=1.0),
        "b": Motion(sine_path(-0.2, 1.5, 0.4), 2.0 / 1.5, ramp_s=0.5, start_s=2.0 - 2.0 / 1.5),
    }
    delays = {"a": 1.9e-3, "b": 3.2e-3}  # to the middle of the torque

    def run_of(axis, model):
        facts = replace(axis.facts, actuation_delay_s=delays[axis.name])
        return AxisRun(Rehearsal(axis.config, facts, 1e-3), axis.servo, model, motions[axis.name])

    alone = machines(modes, None, spring={"stiffness": 1e-12})  # which no one feels, but simulated with further parts
    [coupled] = machines(modes, SEPARATE)
    assert [axis.name for axis in coupled.axes] == ["a", "b"]
    models = [machine.axes[0].config.model for machine in alone]
    for is_compensated in (False, True):
        runs = [run_of(axis, model) for axis, model in zip(coupled.axes, models, strict=True)]
        together = rehearse(coupled.mechanism, runs, is_compensated=is_compensated)
        for found, machine, model in zip(together, alone, models, strict=True):
            [single] = rehearse(None, [run_of(machine.axes[0], model)], is_compensated=is_compensated)
            assert np.abs(single["error"]).max() > 1e-4
            for name, most in MOST.items():
                np.testing.assert_allclose(found[name], single[name], rtol=0.0, atol=most, err_msg=name)


def test_the_shorter_motion_begins_with_the_longer_one_and_ends_with_it():
    [machine] = machines({"a": "csp", "b": "csp"}, SEPARATE)
    short = Motion(sine_path(0.1, 1.0, 0.0), 0.5, ramp_s=0.1, start_s=0.1)
    long = Motion(sine_path(0.1, 1.0, 0.0), 1.0, ramp_s=0.4, start_s=0.2)
    runs = [
        AxisRun(Rehearsal(axis.config, axis.facts, 1e-3), axis.servo, axis.config.model, motion)
        for axis, motion in zip(machine.axes, (short, long), strict=True)
    ]
    one, other = rehearse(machine.mechanism, runs)
    assert one["demand"].size == 1200
    np.testing.assert_array_equal(one["demand"], other["demand"])


def gantry(**changes):
    """The gantry of the examples, with some keys of its second axis changed."""
    data = yaml.safe_load(dump(self_contained(load(MACHINES / "gantry.yaml"))))
    data["axes"]["y2"] |= changes
    return data


def test_axes_of_a_mechanism_are_one_machine_among_the_others():
    data = gantry()
    data["axes"] = {"x": copy.deepcopy(data["axes"]["y1"]) | {"node": 3}, **data["axes"]}
    found = simulated_machines(from_dict(data, "test"))
    assert [[axis.name for axis in machine.axes] for machine in found] == [["x"], ["y1", "y2"]]
    assert [machine.mechanism is not None for machine in found] == [False, True]


def test_both_sides_of_a_gantry_make_the_same_motions_but_the_elbow_its_own():
    data = gantry(counts_per_unit=1e5, experiment={"velocity": 0.05, "travel": 0.01})
    data["axes"]["y2"]["simulation"]["encoder"] = {"counts": 100000}
    [machine] = simulated_machines(from_dict(data, "test"))
    motions = simulated_motions(machine)
    assert {"own", "slow", "small"} <= set(motions)
    for one, other in motions.values():
        assert [one.path(t) for t in (0.0, 0.3, 0.7)] == [other.path(t) for t in (0.0, 0.3, 0.7)]
    [arm] = simulated_machines(load(MACHINES / "two_link_arm.yaml"))
    shoulder, elbow = simulated_motions(arm)["own"]
    assert shoulder.path(0.3) != elbow.path(0.3)


def test_a_study_of_a_gantry_has_both_axes(tmp_path, monkeypatch):
    said = []
    monkeypatch.setattr("friction_hil.cli.work.study_machine.MOTIONS", ("small",))
    monkeypatch.setattr("friction_hil.cli.work.study_machine.print_json", said.append)
    assert main(["study", str(MACHINES / "gantry.yaml"), "--output", str(tmp_path / "out"), "--json"]) == 0
    facts = json.loads(json.dumps(said[0]))
    assert list(facts) == ["y1", "y2"]
    for axis in facts.values():
        motor, load = (axis["small"][side] for side in ("motor", "load"))
        assert min(motor["reduction"]["rms"], load["reduction"]["rms"]) > 4.0
        assert load["without"]["rms"] == pytest.approx(
            motor["without"]["rms"], rel=1e-2
        )  # but for the encoder's counts
    assert (tmp_path / "out/report.html").read_text().count("<img ") == 2
