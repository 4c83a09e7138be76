"""Generalised Maxwell-slip friction against the closed forms of hysteresis.

With Fs = Fc each element is a spring that slips at alpha_i Fc (a Jenkin element), and the sum obeys Masing's
rules: the virgin curve is piecewise linear, every later branch is the virgin curve doubled and moved to its turning
point, and a loop that closes is forgotten (Masing 1926; Madelung 1905). Torque is then a function of the path alone.
"""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import friction_hil as fh

checked = settings(max_examples=60, deadline=None)
LEVEL = 0.08
WEIGHTS = np.array([0.1, 0.25, 0.25, 0.4])
BREAK_POINTS = np.array([1e-4, 4e-4, 1.2e-3, 3e-3])  # rad


def gms(weights=WEIGHTS, break_points=BREAK_POINTS, **changes):
    stiffness = np.asarray(weights) * LEVEL / np.asarray(break_points)
    parameters = {"stiffness": list(stiffness), "weight": list(weights), "attraction": 20.0}
    levels = {"coulomb": LEVEL, "static": LEVEL, "stribeck_velocity": 0.1}
    return fh.models.create("gms", **parameters | levels | changes)


def virgin(x, weights=WEIGHTS, break_points=BREAK_POINTS):
    """Torque over the travel ``x`` >= 0 from rest, by its break points alone."""
    corners = np.sort(break_points)
    torque = [sum(w * LEVEL * min(one / b, 1.0) for w, b in zip(weights, break_points, strict=True)) for one in corners]
    return np.interp(x, [0.0, *corners], [0.0, *torque])


def masing(path, curve):
    """Torque over a path from rest, by Masing's rules and a memory of turning points that closing loops wipe out."""
    turns = []  # (position, torque) of each turning point that is still remembered
    torque, last, sign = [], 0.0, 0.0
    force = 0.0
    for x in path:
        if sign and (x - last) * sign < 0.0:
            turns.append((last, force))
        sign = math.copysign(1.0, x - last) if x != last else sign
        # a branch that comes back to where the branch before it began closes a loop
        while len(turns) >= 2 and (x - turns[-2][0]) * sign >= 0.0:
            del turns[-2:]
        if len(turns) == 1 and abs(x) >= abs(turns[0][0]):
            turns.clear()  # past its first turning point the path is on the virgin curve again
        if turns:
            begin, level = turns[-1]
            force = level + sign * 2.0 * curve(0.5 * abs(x - begin))
        else:
            force = sign * curve(abs(x))
        last = x
        torque.append(force)
    return np.array(torque)


def drive(model, path, dt=1e-3):
    """Torque at each point of a ``path`` that begins at zero."""
    return model.simulate(np.diff([0.0, *path]) / dt, dt)


def densely(turns, step):
    """Path from zero through the turning points, in samples of about ``step``."""
    ends = zip([0.0, *turns[:-1]], turns, strict=True)
    return np.concatenate([np.linspace(a, b, max(2, round(abs(b - a) / step) + 1))[1:] for a, b in ends])


def test_the_virgin_curve_is_piecewise_linear_with_its_break_points():
    x = np.linspace(0.0, 5e-3, 2001)[1:]
    np.testing.assert_allclose(drive(gms(), x), virgin(x), rtol=1e-12)
    coarse = np.array([*BREAK_POINTS, 1.0])  # one sample from corner to corner, and far away
    np.testing.assert_allclose(drive(gms(), coarse), virgin(coarse), rtol=1e-12)
    slopes = np.diff(drive(gms(), x)) / x[0]
    stiffness = WEIGHTS * LEVEL / BREAK_POINTS
    for left, right in zip([0.0, *BREAK_POINTS[:-1]], BREAK_POINTS, strict=True):
        inside = slopes[(x[:-1] > left) & (x[1:] < right)]
        np.testing.assert_allclose(inside, stiffness[right <= BREAK_POINTS].sum(), rtol=1e-9)
    np.testing.assert_allclose(slopes[x[:-1] > BREAK_POINTS[-1]], 0.0, atol=1e-9)


@st.composite
def elements(draw):
    count = draw(st.integers(2, 8))
    shares = np.array([draw(st.floats(0.05, 1.0)) for _ in range(count)])
    corners = np.array([draw(st.floats(1e-5, 1e-2)) for _ in range(count)])
    return shares / shares.sum(), corners


@checked
@given(elements(), st.lists(st.floats(-0.03, 0.03, allow_subnormal=False), min_size=1, max_size=30))
def test_any_path_obeys_masings_rules_whatever_its_elements(parts, path):
    """The implementation consists of elements, the oracle of the virgin curve and turning points."""
    weights, corners = parts
    torque = drive(gms(weights, corners), path)
    expected = masing(path, lambda x: virgin(x, weights, corners))
    np.testing.assert_allclose(torque, expected, atol=1e-9 * LEVEL)


@checked
@given(elements(), st.floats(1e-5, 3e-2), st.floats(1e-3, 1.0))
def test_a_closed_cycle_costs_the_area_of_its_loop(parts, reach, speed):
    """4 alpha_i Fc (X - x_i) for each element that slips at the amplitude X."""
    weights, corners = parts
    model = gms(weights, corners)
    slipping = corners < reach
    area = 4.0 * LEVEL * np.sum(weights[slipping] * (reach - corners[slipping]))
    # every corner is a sample, so that trapezoids over the path are exact
    grid = np.unique([0.0, 2.0 * reach, *(2.0 * corners[slipping])])
    up, down = -reach + grid[1:], reach - grid[1:]
    start = np.unique([reach, *corners[slipping]])
    path = np.concatenate([start, down, up])
    torque = model.simulate(np.diff([0.0, *path]) / (reach / speed), reach / speed)
    cycle = slice(start.size - 1, None)
    measured = np.sum(0.5 * (torque[cycle][1:] + torque[cycle][:-1]) * np.diff(path[cycle]))
    assert measured == pytest.approx(area, rel=1e-9, abs=1e-12 * LEVEL * reach)


def test_dissipated_energy_of_a_cycle_is_the_loop_area():
    """By the model's own account, which takes the torque at the end of each sample."""
    reach, step, dt = 5e-3, 1e-6, 1e-4
    path = densely([reach, -reach, reach, -reach, reach], step)
    energy = gms().dissipated_energy(np.diff([0.0, *path]) / dt, dt)
    cycle = round(4.0 * reach / step)
    area = 4.0 * LEVEL * np.sum(WEIGHTS * (reach - BREAK_POINTS))
    excess = 2.0 * LEVEL * step  # half a step of torque for every branch on which an element is a spring
    assert energy[-1] - energy[-1 - cycle] == pytest.approx(area + excess, rel=1e-9)
    assert energy[-1 - cycle] > energy[cycle] > 0.0


def test_a_slipping_element_relaxes_to_its_curve_with_the_attraction():
    """dF/dt = C (alpha sgn v - F / s(v)) at constant v: exact whatever the step, from either side."""
    model = gms([0.5, 0.5], [1e-4, 1e-4], static=2.0 * LEVEL, attraction=5.0)

    def curve(v):
        return LEVEL + LEVEL * math.exp(-((v / 0.1) ** 2))

    slow, fast = 0.03, 0.15
    runner = model.start("simulation")
    force = runner.step(slow, 1.0)  # breaks away in the middle of this step and stays on its curve
    assert force == pytest.approx(curve(slow), rel=1e-12)
    for v, times in ((fast, (1e-3, 0.02, 0.005)), (slow, (1e-2, 1e-4)), (2.0 * fast, (3.0,))):
        for dt in times:
            expected = curve(v) + (force - curve(v)) * math.exp(-5.0 * dt / curve(v))
            force = runner.step(v, dt)
            assert force == pytest.approx(expected, rel=1e-12)
    # reversal: a spring again, from where it was
    assert runner.step(-slow, 1e-5) == pytest.approx(force - LEVEL / 1e-4 * slow * 1e-5, rel=1e-12)


def test_elements_slip_one_after_the_other_on_a_falling_curve():
    """At constant velocity the virgin curve is that of s(v): capacities alpha_i s, break points alpha_i s / k_i."""
    v, step = 0.05, 1e-6
    s = LEVEL + LEVEL * math.exp(-0.25)
    torque = gms(static=2.0 * LEVEL).simulate(np.full(12_000, v), step / v)
    x = step * np.arange(1, 12_001)
    np.testing.assert_allclose(torque, virgin(x * LEVEL / s) * s / LEVEL, rtol=1e-9)


def test_rest_keeps_every_element_where_it_is():
    model = gms(static=2.0 * LEVEL)
    runner = model.start("simulation")
    for v in (0.2, -0.01, 0.003):
        before = runner.step(v, 1e-2)
    kept = runner.state.copy()
    for _ in range(100):
        assert runner.step(0.0, 10.0) == pytest.approx(before, rel=1e-12)
    assert runner.step(1e-9, 1e-3) == pytest.approx(before, rel=1e-6)
    assert kept.shape == runner.state.shape
