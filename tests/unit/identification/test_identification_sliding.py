"""Gravity and inertia from the rows in which an axis slides, where presliding and a swinging load hide them."""

import math
from functools import cache
from typing import Any

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
