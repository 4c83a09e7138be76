"""Kinds of motion: told apart by the demand at once, whatever the phase, and recognised."""

import math

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from friction_hil.learning.coordinates import coordinates_of
from friction_hil.learning.motions import Kind, Limit, Motions, Used
from friction_hil.learning.thresholds import WINDOW_TICKS
from tests.compensators import LUGRE

PERIOD_S = 2e-3
TICK = 125  # rows
COORDINATES = coordinates_of(LUGRE, {})
FILE, BETTER = Used(np.zeros(4), 0.9, COORDINATES), Used(np.ones(4), 1.0, COORDINATES)


class Moved:
    """Kinds of motion of an axis that moves; the time goes on."""

    def __init__(self):
        self.motions, self.left = Motions(FILE, 1, PERIOD_S), np.empty((2, 0))

    def move(self, seconds, amplitude, frequency, rest=0):
        """Move by whole periods after a rest of any number of rows; return when the kind was another one, s."""
        period = round(1.0 / (frequency * PERIOD_S))
        angle = math.tau / period * np.arange(period * math.ceil(seconds / (period * PERIOD_S)))
        position = np.concatenate([np.zeros(rest), amplitude * (1.0 - np.cos(angle))])
        velocity = np.concatenate([np.zeros(rest), amplitude * math.tau / (period * PERIOD_S) * np.sin(angle)])
        rows = np.concatenate([self.left, np.stack([position, velocity])], axis=1)
        ends = rows.shape[1] // TICK * TICK
        self.left = rows[:, ends:]
        return [(k + TICK) * PERIOD_S for k in range(0, ends, TICK) if self.motions.take(*rows[:, k : k + TICK])]


@example(frequency=13.5, amplitude=1.0, factor=0.90234375, rest=520)  # parts of spans that are mostly rest
@given(
    frequency=st.floats(0.5, 20.0),
    amplitude=st.floats(1e-4, 10.0),
    factor=st.floats(0.9, 1.1),
    rest=st.integers(0, 999),
)
@settings(max_examples=10, deadline=None)
def test_the_same_motion_is_the_same_kind_at_any_phase_and_after_any_rest(frequency, amplitude, factor, rest):
    moved = Moved()
    assert moved.move(7.0, amplitude, frequency) == []
    kind = moved.motions.now
    assert moved.move(7.0, factor * amplitude, frequency, rest) == []
    assert moved.motions.now is kind


@pytest.mark.parametrize("factor", [0.1, 0.5, 2.0, 10.0])
def test_another_motion_is_told_within_a_period_and_nothing_is_proven_for_it(factor):
    moved = Moved()
    moved.move(8.0, 0.1, 1.0)
    moved.motions.keep(BETTER)
    changes = moved.move(7.0, factor * 0.1, 1.0)
    assert len(changes) == 1
    assert changes[0] <= (0.5 if factor in (0.1, 10.0) else 1.0)
    assert moved.motions.now.used is FILE


def test_a_motion_that_comes_back_is_recognised_with_what_was_proven_for_it():
    moved = Moved()
    moved.move(8.0, 0.1, 1.0)
    moved.motions.keep(BETTER)
    moved.motions.now.pause = 16
    for amplitude in (1.0, 0.01):
        moved.move(8.0, amplitude, 1.0)
    left, found = moved.move(8.0, 0.1, 1.0)
    assert found - left <= 1.25
    assert (moved.motions.now.used, moved.motions.now.pause) == (BETTER, 16)


def test_a_motion_counts_as_a_kind_after_a_window():
    moved = Moved()
    moved.move(0.25 * WINDOW_TICKS - 1.0, 0.1, 1.0)
    assert moved.motions.now.ranges is None
    moved.move(1.0, 0.1, 1.0)
    assert moved.motions.now.ranges is not None


def test_the_kinds_that_were_not_seen_for_longest_are_forgotten():
    moved = Moved()
    moved.move(8.0, 1e-3, 1.0)
    moved.motions.keep(BETTER)
    for k in range(1, 10):
        moved.move(8.0, 1e-3 * 2.0**k, 1.0)
    moved.move(8.0, 1e-3, 1.0)
    assert moved.motions.now.used is FILE


@pytest.mark.parametrize(("torque", "tried"), [(0.085, 20), (0.09, 0), (0.07, 0)])
def test_a_gain_that_was_no_help_is_tried_again_after_a_while_or_once_friction_is_another(torque, tried):
    kind = Kind(FILE, 1, limit=Limit(0.93, 0.08))
    assert [kind.highest_gain(torque) for _ in range(tried + 1)] == [*(tried * [0.93]), 1.0]
    assert kind.limit is None
