"""Joints of an arm in `tune`: weight by experiment and by file, and models that have no weight of their own."""

import dataclasses
import math
from contextlib import nullcontext
from types import SimpleNamespace

import numpy as np
import pytest

from friction_hil.api.tuning import _identify_arm
from friction_hil.config import Hold
from friction_hil.daemon.safety import LoopState
from friction_hil.errors import OptionError
from friction_hil.identification import IdentificationSettings, identify
from friction_hil.models.model_file import ModelFile
from friction_hil.recordings import Recording
from friction_hil.tuning import TuneSettings, Tuning, tune
from friction_hil.tuning.arm import check_joint, without_weight
from friction_hil.tuning.model_files import model_content
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
