"""Joints of an arm in `tune`: weight by experiment and by file, and models that have no weight of their own."""

import dataclasses
import math
from contextlib import nullcontext
from dataclasses import MISSING
from pathlib import Path
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from friction_hil.api.tuning import _identify_arm, _of_arm
from friction_hil.config import Hold
from friction_hil.config.arm import ArmConfig
from friction_hil.daemon.assembly import make_path
from friction_hil.daemon.safety import LoopState
from friction_hil.drive import AxisFacts
from friction_hil.errors import ConfigurationError, OptionError, UsageError
from friction_hil.identification import IdentificationSettings, identify
from friction_hil.models.model_file import ModelFile
from friction_hil.motion.trajectory import extent
from friction_hil.recordings import Recording
from friction_hil.tuning import TuneSettings, Tuning, tune
from friction_hil.tuning.arm import check_joint, without_weight
from friction_hil.tuning.arm_box import _points, refuse_outside, refuse_plan
from friction_hil.tuning.model_files import model_content
from friction_hil.tuning.motions import experiment_run
from tests import random_arms
from tests.arm_machine import ARM, NAMES, gravity, machine

ELBOW = 0.7  # rad, where it is held
COULOMB, OFFSET = 7.0, 2.0  # N m
INERTIA = 0.45 + 0.08 + 4.5 * 0.22**2 + 0.03 + 2.2 * 0.13**2 + 1.0 * 0.35**2  # rotor and links; the rest follows
INERTIA += 3.2 * 0.4**2 + 2.0 * 0.4 * math.cos(ELBOW) * (2.2 * 0.13 + 1.0 * 0.35)


def experiment(travel, weight=1.0, offset=0.0):
    """The shoulder on a sine, the elbow held, as recordings of the daemon."""
    rng = np.random.default_rng(3)
    t = np.arange(8000) * 2e-3
    rate = 2.0 * np.pi * 0.5
    q, dq, ddq = (travel * each for each in (np.sin(rate * t), rate * np.cos(rate * t), -(rate**2) * np.sin(rate * t)))
    torque = weight * gravity(q, ELBOW)[0] + INERTIA * ddq + COULOMB * np.sign(dq) + offset
    torque += rng.normal(0.0, 0.05, len(t))
    both = {"shoulder": (q, dq, torque), "elbow": (np.full_like(t, ELBOW), np.zeros_like(t), np.zeros_like(t))}
    state = np.full(len(t), float(LoopState.RUNNING))
    return {
        name: Recording("x.mcap", name, {"time_s": t, "position": p, "velocity": v, "torque": f, "state": state})
        for name, (p, v, f) in both.items()
    }


def checked(configuration, recorded):
    found = identify([recorded["shoulder"]], IdentificationSettings(("coulomb",), has_modifiers=False, refine=False))
    model = model_content(found, found.best, configuration.axes["shoulder"])
    check = check_joint(configuration, recorded, model, found.best, "shoulder")
    return check, without_weight(model, found.best, check), found


def test_a_right_file_agrees_and_the_model_is_left_without_the_weight(tmp_path):
    check, model, _ = checked(machine(tmp_path), experiment(1.2))
    largest = gravity(check.position, ELBOW)[0]
    assert check.weight_of_file == pytest.approx(largest, rel=1e-9)
    assert check.weight == pytest.approx(largest, rel=0.01)
    assert check.inertia_of_file == pytest.approx(INERTIA, rel=1e-9)
    assert check.inertia == pytest.approx(INERTIA, rel=0.02)
    assert not check.contradictions
    read = ModelFile.model_validate(model)
    assert read.mechanics.gravity == type(read.mechanics.gravity)()
    assert read.mechanics.offset == pytest.approx(0.0, abs=0.1)
    assert read.friction.parameters["coulomb"] == pytest.approx(COULOMB, rel=0.02)


def static_torque(model):
    """What a model feeds forward of no velocity: offset, and half of what its directions differ by."""
    read = ModelFile.model_validate(model)
    levels = read.friction.modifiers.get("direction", {})
    return read.mechanics.offset + 0.5 * sum(
        sign * levels[side]["coulomb"] for side, sign in (("positive", 1.0), ("negative", -1.0)) if side in levels
    )


@pytest.mark.parametrize("weight", [1.0, 0.0])
def test_an_offset_is_kept_only_where_it_cannot_be_the_weight(weight, tmp_path):
    """A long way tells them apart, a short one does not; without a weight nothing has to be told apart."""
    configuration = machine(tmp_path, ARM | {"gravity": [0.0, 0.0, -9.81 * weight]})
    for travel, is_kept in ((1.2, True), (0.1, weight == 0.0)):
        check, model, _ = checked(configuration, experiment(travel, weight, OFFSET))
        assert not check.contradictions
        assert static_torque(model) == pytest.approx(OFFSET if is_kept else 0.0, abs=0.15)
        assert any("not told from the weight" in flag for flag in model["fit"]["flags"]) != is_kept


def test_directions_that_may_differ_by_the_weight_get_the_mean_of_their_levels(tmp_path):
    configuration = machine(tmp_path)
    check, _, found = checked(configuration, experiment(0.1))
    model = model_content(found, found.best, configuration.axes["shoulder"])
    sides = {"positive": {"coulomb": 9.0}, "negative": {"coulomb": 5.0}}
    model["friction"]["modifiers"], model["mechanics"]["offset"] = {"direction": sides}, 0.0
    assert static_torque(without_weight(model, found.best, dataclasses.replace(check, is_apart=True))) == 2.0
    left = without_weight(model, found.best, check)
    assert static_torque(left) == 0.0
    assert left["friction"]["parameters"]["coulomb"] == 7.0
    model["mechanics"]["offset"] = 38.0  # beyond any level: of a fit that has taken weight for it
    assert without_weight(model, found.best, dataclasses.replace(check, is_apart=True))["mechanics"]["offset"] == 0.0


@pytest.mark.parametrize(
    ("arm", "weight", "named"),
    [
        ({"signs": {"shoulder": -1}}, 1.0, "arm.signs"),
        ({}, 0.5, "arm.payload"),
        ({"rotor_inertia": {"shoulder": 0.45 + 1.5 * INERTIA}}, 1.0, "arm.rotor_inertia"),
    ],
)
def test_a_file_that_is_not_the_arms_is_told(arm, weight, named, tmp_path):
    check, _, _ = checked(machine(tmp_path, ARM | arm), experiment(1.2, weight))
    [text] = check.contradictions
    assert named in text
    assert "arm.urdf" in text


def test_a_joint_in_cst_is_refused_before_anything_moves(tmp_path):
    configuration = machine(tmp_path)
    elbow = configuration.axes["elbow"].model_copy(update={"mode": "cst", "trajectory": Hold(kind="hold")})
    configuration = configuration.model_copy(update={"axes": {**configuration.axes, "elbow": elbow}})
    folder = tmp_path / "out"
    with pytest.raises(OptionError) as error:
        tune(configuration, dataclasses.replace(TuneSettings(folder), names=(NAMES[0],)), dialog=None)
    assert (error.value.axis, error.value.key) == ("elbow", "mode")
    assert not folder.exists()


def test_an_arm_that_the_trial_does_not_show_costs_a_warning(tmp_path):
    found = Tuning(recordings=[tmp_path / "trial_without.mcap"])
    told = SimpleNamespace(working=lambda text: nullcontext(lambda *step: None))
    _identify_arm(found, machine(tmp_path).arm, TuneSettings(tmp_path), told)
    assert found.arm is None
    [warning] = found.warnings
    assert warning.startswith("arm: not identified from the trial: ")
    assert "trial_without.mcap" in warning


TOOL = {"mass": 0.0, "center": [0.0, 0.0, -0.35], "link": "fore"}


def standing(**positions):
    """What the drives report before anything moves."""
    zero = dict.fromkeys([field.name for field in dataclasses.fields(AxisFacts) if field.default is MISSING], 0.0)
    facts = [{**zero, "name": name, "position_resolution": 1e-6} for name in positions]
    return {
        name: Recording("start.mcap", name, {"position": np.array([q, math.nan])}, metadata={"facts": facts})
        for name, q in positions.items()
    }


@settings(max_examples=25, deadline=None)
@given(st.floats(-3.0, 3.0), st.floats(-3.0, 3.0))
def test_points_of_an_arm_are_those_in_closed_form(tmp_path_factory, shoulder, elbow):
    arm = machine(tmp_path_factory.mktemp("arm"), ARM | {"payload": TOOL, "signs": {"elbow": -1}}).arm
    found = dict(_points(arm, np.array([[shoulder, elbow]])))
    x, z = 0.4 * math.sin(shoulder), -0.4 * math.cos(shoulder)
    assert found["the origin of joint1"][0] == pytest.approx([0.0, 0.0, 0.0], abs=1e-12)
    assert found["the origin of joint2"][0] == pytest.approx([x, 0.0, z], abs=1e-12)
    x, z = x + 0.35 * math.sin(shoulder - elbow), z - 0.35 * math.cos(shoulder - elbow)
    assert found["the centre of the payload"][0] == pytest.approx([x, 0.0, z], abs=1e-12)


@pytest.mark.parametrize("seed", range(4))
def test_origins_are_where_mujoco_has_the_bodies(tmp_path, seed):
    rng = np.random.default_rng(seed)
    text = random_arms.urdf(rng, 5)
    model, data = random_arms.compiled(text)
    (tmp_path / "arm.urdf").write_text(text)
    joints = random_arms.names(model)
    arm = ArmConfig(file=tmp_path / "arm.urdf", joints={f"x{k}": joint for k, joint in enumerate(joints)})
    arm.read()
    data.qpos[:] = pose = rng.normal(size=model.nq)
    mujoco.mj_kinematics(model, data)
    places = [place[0] for _, place in _points(arm, pose[np.newaxis])]
    assert np.array(places) == pytest.approx(data.xpos[model.jnt_bodyid], abs=1e-9)


def test_an_experiment_that_leaves_the_box_is_refused(tmp_path):
    """The shoulder swings about 0.3 rad, and the elbow, its origin 0.4 m away, with it."""
    bounds = {"velocity": 1.5, "travel": 1.0, "duration_s": 20.0}
    run, duration_s = experiment_run(machine(tmp_path, axes__shoulder__experiment=bounds), "shoulder")
    high = extent(make_path(run.axes["shoulder"], 1e-6, 1e-3), duration_s, 20_000)[1]
    seen = standing(shoulder=0.3, elbow=0.0)
    for free in (1.01, 0.99):
        box = [[-1.0, -0.1, -1.0], [free * 0.4 * math.sin(0.3 + high), 0.1, 0.1]]
        configuration = machine(tmp_path, ARM | {"box": box}, axes__shoulder__experiment=bounds)
        run, _ = experiment_run(configuration, "shoulder")
        if free > 1.0:
            refuse_outside(run, duration_s, seen, "x")
            continue
        with pytest.raises(UsageError, match=r"the experiment of shoulder: the origin of joint2 would be .*arm\.box"):
            refuse_plan(configuration, ("shoulder",), seen, is_shaken=False)


def test_a_trial_in_which_all_joints_move_is_refused_though_no_experiment_is(tmp_path):
    """Each joint alone keeps the tool within 0.59 m of the base, both together do not."""
    short = {"velocity": 0.5, "travel": 0.2, "duration_s": 10.0}
    changes = {f"axes__{name}__experiment": short for name in NAMES}
    for name in NAMES:
        changes[f"axes__{name}__trajectory"] = {"kind": "sine", "amplitude": 0.9, "frequency": 0.1}
    box = [[-0.62, -0.1, -1.0], [0.62, 0.1, 0.1]]
    configuration = machine(tmp_path, ARM | {"box": box, "payload": TOOL}, **changes)
    seen = standing(shoulder=0.0, elbow=0.0)
    for name in NAMES:
        refuse_plan(configuration, (name,), seen, is_shaken=False)
    with pytest.raises(UsageError, match=r"the trial: the centre of the payload would be at \[0\.62"):
        refuse_plan(configuration, NAMES, seen, is_shaken=False)


def test_corners_of_a_box_are_in_order(tmp_path):
    with pytest.raises(ConfigurationError, match=r"arm\.box: the first corner must be below") as error:
        machine(tmp_path, ARM | {"box": [[0.0, 0.0, 1.0], [1.0, 1.0, 1.0]]})
    assert ".yaml:" in str(error.value)


def test_of_joints_that_were_held_nothing_is_said():
    def joint(name, **values):
        return SimpleNamespace(name=name, values=values, errors=dict.fromkeys(values, 0.01), flags=(f"{name} flagged",))

    fit = SimpleNamespace(
        joints=[joint("joint1"), joint("joint2", coulomb=2.5, load=0.19)],
        **{"error_of_file": (0.98, 0.02), "determined": 2, "combinations": 6, "contradiction": 0.1},
    )
    found = SimpleNamespace(fit=fit, names=NAMES, failures={"shoulder": "it hardly slides"})
    text, flags = _of_arm(found, ["elbow"], Path("out"))
    assert "elbow coulomb 2.5 (0.01), per load 0.19 (0.01)" in text
    assert "2 of 6 combinations" in text
    assert "shoulder" not in text
    assert flags == ["arm: elbow: joint2 flagged"]
    _, flags = _of_arm(found, NAMES, Path("out"))
    assert flags == ["arm: shoulder: it hardly slides", "arm: elbow: joint2 flagged"]
