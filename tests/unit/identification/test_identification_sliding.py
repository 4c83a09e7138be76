"""Gravity and inertia from the rows in which an axis slides, where presliding and a swinging load hide them."""

import math
from functools import cache

import numpy as np
import pytest

from friction_hil.identification import IdentificationSettings
from friction_hil.identification.candidates import CandidateFitter
from friction_hil.identification.data import prepare
from friction_hil.identification.sliding import LOW_HZ, WIDE_HZ, sliding_mechanics
from friction_hil.motion import experiment
from friction_hil.motion.trajectory import sweeps_path
from friction_hil.recordings import Recording
from tests.machine_recordings import axis_of, record


@cache
def experiment_on(name: str, seconds: float) -> Recording:
    """The experiment of `tune` on an example machine."""
    axis = axis_of(name)
    bounds, counts = axis.experiment, axis.simulation.encoder.counts
    assert bounds.acceleration is not None
    plan = experiment.plan(
        bounds.velocity, bounds.travel, math.tau / counts, seconds, acceleration=bounds.acceleration, period_s=1e-3
    )
    return record(axis, sweeps_path(plan), seconds)


def fitter_of(recording: Recording) -> CandidateFitter:
    settings = IdentificationSettings(families=("lugre",), has_modifiers=False)
    return CandidateFitter([recording], [], settings, lambda _: None)


@pytest.mark.deep
def test_weight_and_inertia_of_a_joint_are_found_behind_its_soft_gear() -> None:
    mechanics = axis_of("harmonic_drive").simulation.mechanics
    fitter = fitter_of(experiment_on("harmonic_drive", 40.0))
    fit = fitter.fit(fitter.build("lugre", is_directed=False))
    # losses of the gear count as a little of either
    assert fit.mechanics["inertia"] == pytest.approx(mechanics.inertia + mechanics.load.inertia, rel=0.15)
    assert fit.mechanics["gravity.sine"] == pytest.approx(mechanics.gravity.sine, rel=0.15)
    assert any("below 12 Hz" in note for note in fitter.notes)


def test_a_stiff_axis_without_gravity_has_none_and_nothing_held() -> None:
    fitter = fitter_of(experiment_on("direct_drive", 24.0))
    fit = fitter.fit(fitter.build("coulomb", is_directed=False))
    assert fit.mechanics["gravity.sine"] == fit.mechanics["gravity.cosine"] == 0.0
    assert "inertia" in fit.inference.standard_errors
    assert fitter.notes == []


def test_an_inertia_that_the_user_holds_stays() -> None:
    recording = experiment_on("harmonic_drive", 40.0)
    settings = IdentificationSettings(families=("coulomb",), has_modifiers=False, held={"inertia": 1.0})
    fitter = CandidateFitter([recording], [], settings, lambda _: None)
    fit = fitter.fit(fitter.build("coulomb", is_directed=False))
    assert fit.mechanics["inertia"] == 1.0


def test_a_load_that_swings_makes_the_axis_look_light_in_fast_motion_only() -> None:
    records = prepare(experiment_on("harmonic_drive", 40.0))
    slow, fast = (sliding_mechanics(records, can_swing=True, low_hz=low_hz) for low_hz in (LOW_HZ, WIDE_HZ))
    assert slow.differs(fast)
    assert fast.inertia < 0.7 * slow.inertia
    assert slow.has_swing


def test_an_axis_that_does_not_slide_tells_nothing() -> None:
    time = 1e-3 * np.arange(5000)
    position = 1e-3 * np.sin(math.tau * 60.0 * time)
    columns = {"time_s": time, "position": position, "torque": 10.0 * position}
    assert sliding_mechanics(prepare(Recording("x.csv", "x", columns)), can_swing=True) is None
