"""Rehearsal of two axes on one mechanism: the same as single axes where nothing couples them, and what is judged."""

import copy
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from friction_hil.checked_yaml.text import dump
from friction_hil.cli import main
from friction_hil.config import from_dict, load, self_contained
from friction_hil.friction import describe
from friction_hil.motion.trajectory import sine_path
from friction_hil.rehearsal import AxisRun, Motion, Rehearsal, rehearse, simulated_machines
from friction_hil.tuning.rehearsal_motions import simulated_motions
from tests.servo_drives import axis_dict

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


# the machines


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
