"""Rows by which static models are identified: where the axis slides, not where its bristles turn."""

import math

import numpy as np
import pytest

from friction_hil import friction as models
from friction_hil.identification import IdentificationSettings, identify
from friction_hil.identification.data import moved_since_reversal, prepare
from friction_hil.recordings import Recording

TRUE = {"coulomb": 300.0, "static": 420.0, "stribeck_velocity": 0.01}
STIFFNESS, VISCOUS, INERTIA, PERIOD_S = 4e6, 300.0, 800.0, 1e-3
SLIDING = {"least_speed": 4e-4, "sliding_s": 5e-3, "lowpass_hz": 100.0, "decimation": 10}


def slow_axis() -> Recording:
    """A heavy axis that moves so slowly that its bristles take a second to turn where it reverses slowest."""
    time = np.arange(0.0, 40.0, PERIOD_S)
    swell = 0.01 + 0.99 * np.sin(math.pi * time / 40.0) ** 2
    position = 0.06 * swell * np.sin(math.tau * 0.35 * time)
    velocity = np.gradient(position, PERIOD_S)
    lugre = models.create("lugre", sigma0=STIFFNESS, sigma1=2e4, sigma2=VISCOUS, damping_velocity=0.01, **TRUE)
    torque = lugre.simulate(velocity, PERIOD_S) + INERTIA * np.gradient(velocity, PERIOD_S)
    return Recording("slow.mcap", "x", {"time_s": time, "position": position, "torque": torque}, {})


def test_a_slow_axis_shows_its_levels_where_the_bristles_have_turned() -> None:
    turned = 5.0 * TRUE["static"] / STIFFNESS
    settings = IdentificationSettings(families=("stribeck",), **SLIDING, sliding_distance=turned)
    fit = next(each for each in identify([slow_axis()], settings).fits if each.label == "stribeck")
    assert {name: fit.values[name] for name in TRUE} == pytest.approx(TRUE, rel=0.05)
    assert fit.values["viscous"] == pytest.approx(VISCOUS, rel=0.03)
    assert fit.values["inertia"] == pytest.approx(INERTIA, rel=0.02)


def test_rows_near_a_reversal_do_not_count_and_that_is_noted():
    [near] = prepare(slow_axis(), **SLIDING)
    [segment] = prepare(slow_axis(), **SLIDING, sliding_distance=2e-3)
    assert np.count_nonzero(segment.is_moving) < np.count_nonzero(near.is_moving)
    assert "within 0.002 of a reversal" in segment.problems[-1]
    velocity, position = np.array([[1.0, 1.0, -1.0, -1.0, 2.0], [0.0, 1.0, 1.5, 0.5, 0.0]])
    assert moved_since_reversal(velocity, position).tolist() == [0.0, 1.0, 0.0, 1.0, 0.0]
