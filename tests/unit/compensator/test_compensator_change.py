"""A change of settings or model between two cycles: the torque goes from that of the former ones to that of the new."""

import math

import numpy as np
import pytest

import friction_hil as fh
from friction_hil.compensator import INPUTS
from tests.compensators import LUGRE, PERIOD_S, compensator

FADE_S = 0.2
OTHER = fh.models.create("lugre", **{**LUGRE.parameters, "sigma0": 2.0 * LUGRE.parameters["sigma0"]})


def inputs_at(cycle):
    """An axis that follows a sine without an error and reverses at cycle 500, within a cycle."""
    t = cycle * PERIOD_S

    def velocity(at):
        return 30.0 * math.sin(math.tau * at)

    position = 30.0 / math.tau * (1.0 - math.cos(math.tau * t))
    now = (float(cycle), position, velocity(t), 0.0)
    return (*now, position, velocity(t), velocity(t + PERIOD_S), 1.0, 1.0, 0.0, 20.0, math.nan)


def torques(one, cycles, change=None, other=None):
    found = []
    for cycle in cycles:
        if cycle == change:
            one.adopt(other.record, other.friction_state)
        found.append(one.step(*inputs_at(cycle)))
    return np.array(found)


@pytest.mark.parametrize("change", range(496, 505))
def test_a_change_in_the_cycle_of_a_reversal_stays_between_both(change):
    """The step of friction at the reversal belongs to the motion: it must not be held for the time of the fade.

    A difference that was found at the peak of friction after it is too large beyond, for 10 ms.
    """
    cycles = range(900)
    low, high = (torques(compensator(LUGRE, gain=gain, fade_s=FADE_S), cycles) for gain in (0.8, 0.9))
    other = compensator(LUGRE, gain=0.8, fade_s=FADE_S)
    torques(other, range(change))  # so that its state is that of this motion
    found = torques(compensator(LUGRE, gain=0.9, fade_s=FADE_S), cycles, change, other)
    assert found[change] == pytest.approx(high[change], abs=1e-12)
    room = np.full(900, 1e-3 * LUGRE.level)
    room[change : change + 6] = 0.5 * 0.1 * LUGRE.level  # the whole step of friction is 2
    assert np.all(found >= np.minimum(low, high) - room)
    assert np.all(found <= np.maximum(low, high) + room)
    np.testing.assert_allclose(found[change + round(1.5 * FADE_S / PERIOD_S) :], low[change + 300 :], atol=1e-12)


def test_two_changes_in_one_cycle_begin_with_the_torque_of_the_first_settings():
    one, alike = (compensator(LUGRE, gain=0.9, fade_s=FADE_S) for _ in range(2))
    torques(one, range(300))
    torques(alike, range(300))
    for gain in (0.4, 0.6):
        one.adopt(compensator(LUGRE, gain=gain, fade_s=FADE_S).record, None)
    assert one.step(*inputs_at(300)) == pytest.approx(alike.step(*inputs_at(300)), abs=1e-12)


def test_replay_repeats_a_change_bit_for_bit():
    """Also from the state that a recording has of the cycle of the change."""
    other = compensator(OTHER, fade_s=FADE_S)
    stepped = torques(compensator(LUGRE, fade_s=FADE_S), range(700), 500, other)
    one = compensator(LUGRE, fade_s=FADE_S)
    rows = np.array([inputs_at(cycle) for cycle in range(700)]).T
    first, _ = one.replay([np.ascontiguousarray(each[:500]) for each in rows])
    one.adopt(other.record, other.friction_state)
    assert one.is_changing
    one.finish_change(*rows[:, 500])
    saved = one.state.copy()
    second, _ = one.replay([np.ascontiguousarray(each[500:]) for each in rows])
    again = compensator(OTHER, fade_s=FADE_S)
    again.state[:] = saved
    third, _ = again.replay([np.ascontiguousarray(each[500:]) for each in rows])
    assert len(rows) == len(INPUTS)
    np.testing.assert_array_equal(np.concatenate([first, second]), stepped)
    np.testing.assert_array_equal(second, third)


@pytest.mark.parametrize("change", range(498, 503))
def test_a_map_that_has_reversed_before_the_bristles_of_the_next_model_leaves_no_torque_behind(change):
    """Their torques are of opposite directions then: the difference says nothing of what they differ by later."""

    def inputs(cycle):  # slower by far than the bristles need to reverse
        given = list(inputs_at(cycle))
        return [given[0], *(value / 300.0 for value in given[1:7]), *given[7:]]

    static = fh.models.create("stribeck", coulomb=0.08, static=0.12, stribeck_velocity=0.2)
    other, one, alike = (compensator(each, fade_s=FADE_S) for each in (LUGRE, static, static))
    for cycle in range(change):
        for each in (other, one, alike):
            each.step(*inputs(cycle))
    one.adopt(other.record, other.friction_state)
    found = [[each.step(*inputs(cycle)) for each in (one, other)] for cycle in range(change, change + 60)]
    assert found[0][0] == pytest.approx(alike.step(*inputs(change)), abs=1e-12)
    np.testing.assert_allclose(*np.array(found)[40:].T, atol=0.02 * LUGRE.level)
