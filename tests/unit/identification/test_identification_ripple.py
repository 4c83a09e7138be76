"""Orders of ripple in a residual, and viscous friction that bends down, from signals made up here."""

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

import friction_hil as fh
from friction_hil.identification import IdentificationSettings, identify, structures
from friction_hil.identification.ripple import RippleSearch
from friction_hil.identification.structures import InitialScales, build, directed
from friction_hil.recordings import Recording

Array = NDArray[np.float64]

ROWS_HZ = 200.0
TURN = 2.0 * math.pi
COULOMB = IdentificationSettings(families=("coulomb",), gravity="none")


def swelling(amplitude: float, frequency: float = 0.31, seconds: float = 40.0) -> Array:
    """Position of a sine whose amplitude grows from a tenth of ``amplitude``."""
    time = np.arange(round(seconds * ROWS_HZ)) / ROWS_HZ
    return amplitude * (0.1 + 0.9 * time / seconds) * np.sin(TURN * frequency * time)


def noise(rows: int, seed: int) -> Array:
    """Noise of standard deviation 1, correlated over some ten rows."""
    white = np.random.default_rng(seed).standard_normal(rows + 60)
    smooth = np.convolve(white, np.exp(-np.arange(61) / 10.0), mode="valid")
    return np.asarray(smooth / np.std(smooth))


def search(position: Array, residual: Array, *, is_linear: bool = False) -> list[float]:
    velocity = np.gradient(position) * ROWS_HZ
    columns = np.column_stack([np.sign(velocity), velocity, np.ones_like(velocity)])
    left = residual - columns @ np.linalg.lstsq(columns, residual, rcond=None)[0]
    whole = [slice(0, len(position))]
    return RippleSearch(position, left, columns, np.ones(len(position)), whole, is_linear=is_linear).orders()


@pytest.mark.deep
@settings(max_examples=8, deadline=None)
@given(st.sampled_from([7, 9, 13]), st.sampled_from([36, 42, 50]), st.floats(0.0, TURN), st.floats(0.0, TURN))
def test_whole_orders_are_found_together_in_a_fraction_of_a_turn(low: int, high: int, a: float, b: float) -> None:
    position = 0.4 + swelling(0.85)
    residual = np.cos(low * position + a) + 1.5 * np.cos(high * position + b)
    assert set(search(position, residual + 0.5 * noise(len(position), 1))) == {low, high}


@pytest.mark.parametrize(
    ("order", "axis", "position", "most"),
    [
        (7.57, "rotary", (12.0, 0.05), 0.02),  # of a motor behind a gear, over several turns
        (42.4, "rotary", (12.0, 0.05), 0.02),
        (212.7, "linear", (0.2,), 0.1),
    ],
)
def test_an_order_that_is_clearly_not_whole_stays_so(order, axis, position, most):
    position, is_linear = swelling(*position), axis == "linear"
    turn = TURN if is_linear else 1.0
    residual = np.cos(turn * order * position) + 0.3 * noise(len(position), 3 if is_linear else 2)
    assert search(position, residual, is_linear=is_linear) == [pytest.approx(order, abs=most)]


@pytest.mark.parametrize("seed", range(8))
def test_noise_has_no_ripple(seed: int) -> None:
    position = swelling(0.85)
    assert search(position, noise(len(position), seed)) == []


def recorded(friction: dict[str, Any], top: float, position: float = 0.0) -> Recording:
    """An axis of 0.02 kg m^2 on sines of 0.3 and 0.8 Hz."""
    time = np.arange(20_000) * 1e-3
    amplitude = top / (TURN * 0.8)
    q = position + amplitude * np.sin(TURN * 0.8 * time) * np.linspace(0.1, 1.0, time.size)
    velocity = np.gradient(q, 1e-3)
    model = fh.models.create("coulomb", **friction)
    torque = model.simulate(velocity, 1e-3, position=q) + 0.02 * np.gradient(velocity, 1e-3)
    torque += 0.02 * np.random.default_rng(5).standard_normal(time.size)
    return Recording("made.csv", "x", {"time_s": time, "position": q, "velocity": velocity, "torque": torque})


def test_a_high_order_is_found_far_from_zero() -> None:
    """The decimator's gain is 0.99: in an angle of 150 times 3 rad, five are missing."""
    ripple = [{"order": 150, "cosine": 0.1, "sine": 0.1}]
    friction = {"coulomb": 1.0, "viscous": 0.5, "modifiers": {"ripple": ripple}}
    result = identify([recorded(friction, 0.6, position=3.0)], COULOMB)
    [found] = result.best.friction[1]["ripple"]
    assert found["order"] == 150.0
    assert (found["cosine"], found["sine"]) == pytest.approx((0.1, 0.1), abs=0.01)


@pytest.mark.parametrize(("quadratic", "is_kept"), [(-0.1, True), (-0.4, False)])
def test_viscous_friction_may_bend_down_as_long_as_it_cannot_change_its_sign(quadratic: float, is_kept: bool) -> None:
    """Up to three times the top speed of the data, 1 rad/s."""
    friction = {"coulomb": 1.0, "viscous": 0.8, "modifiers": {"viscous": {"quadratic": quadratic}}}
    result = identify([recorded(friction, 1.0)], COULOMB)
    [bent] = (each for each in result.fits if each.label == "coulomb + viscous")
    assert bent.values["viscous.quadratic"] == (pytest.approx(quadratic, abs=0.02) if is_kept else 0.0)


SCALES = InitialScales(0.1, 0.15, 2.0, 1.0, (1e-4,), (0.1,), (0.1, 0.5, 2.0), 0.01, 0.3)


@pytest.mark.parametrize("family", [name for name in structures.families() if name != "table"])
def test_a_structure_split_by_direction_is_the_one_that_is_built_so(family: str) -> None:
    plain, split = (build(family, SCALES, "rotary", 1e-3, is_directed=is_directed) for is_directed in (False, True))
    assert directed(plain) == split
