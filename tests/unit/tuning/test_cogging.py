"""A torque over the position as large as friction is found over the positions of the own motion."""

import math

import numpy as np
import pytest

from friction_hil.identification import IdentificationSettings, identify
from friction_hil.recordings import Recording
from friction_hil.tuning.cogging import large_position_torque, position_share

RATE_HZ, COULOMB, INERTIA = 250.0, 0.25, 6e-3
HARMONICS = {24: (-0.06, -0.22), 48: (0.0, -0.07), 4: (-0.08, 0.0)}  # cosine and sine, N m
SETTINGS = IdentificationSettings(families=("coulomb",))


def moved(middle: float, amplitude: float, scale: float = 1.0) -> Recording:
    """Two swelling sines about a position, with harmonics ``scale`` times as large as those above."""
    time = np.arange(round(16.0 * RATE_HZ)) / RATE_HZ
    swell = amplitude * np.sin(math.pi * time / 16.0)
    position = middle + swell * np.sin(2.0 * math.pi * 0.5 * time)
    velocity = np.gradient(position, time)
    torque = COULOMB * np.tanh(velocity / 0.01) + INERTIA * np.gradient(velocity, time)
    for order, (cosine, sine) in HARMONICS.items():
        torque += scale * (cosine * np.cos(order * position) + sine * np.sin(order * position))
    torque += 0.005 * np.random.default_rng(1).standard_normal(len(time))
    return Recording("x.mcap", "x", {"time_s": time, "position": position, "velocity": velocity, "torque": torque})


def test_orders_that_the_sweeps_alone_do_not_tell_are_found_with_the_own_motion_and_fitted_to_both() -> None:
    slow, own = [moved(0.0, 0.6)], moved(-0.3, 1.1)
    found = large_position_torque(slow, SETTINGS, own)
    assert found is not None
    assert set(found.orders) == set(HARMONICS)
    settings = IdentificationSettings(families=("coulomb",), orders=found.orders, has_modifiers=False)
    fit = identify([*slow, *found.recordings], settings).best
    _, modifiers = fit.friction
    for each in modifiers["ripple"]:
        assert (each["cosine"], each["sine"]) == pytest.approx(HARMONICS[round(each["order"])], abs=0.01)
    levels = [value for name, value in fit.values.items() if name.endswith("coulomb")]
    assert levels == pytest.approx([COULOMB] * len(levels), rel=0.05)


def test_a_ripple_far_below_friction_is_left_to_the_experiment() -> None:
    assert large_position_torque([moved(0.0, 0.6, scale=0.1)], SETTINGS, moved(-0.3, 1.1, scale=0.1)) is None


def test_what_depends_on_the_position_has_its_own_figure_and_needs_homing() -> None:
    friction = {"model": "coulomb", "parameters": {"coulomb": 0.25}}
    assert position_share({"axis": "rotary", "friction": friction}) is None
    friction["modifiers"] = {"ripple": [{"order": 24.0, "sine": 0.3}, {"order": 4.0, "cosine": -0.4}]}
    share = position_share({"axis": "rotary", "friction": friction})
    assert share is not None
    assert (share.orders, share.level) == ((24.0, 4.0), 0.25)
    assert share.rms == pytest.approx(0.5 / math.sqrt(2.0))
    assert [each for each in ("24, 4", "0.354 N m", "home the axis") if each not in share.text("N m")] == []
