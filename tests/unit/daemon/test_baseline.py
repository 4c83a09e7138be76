"""The rows that count without and with compensation, on recordings whose error is known exactly."""

import math

import numpy as np
import pytest

from friction_hil.analysis.baseline import without_and_with
from friction_hil.analysis.following import RECOVERY_S, SETTLE_S
from friction_hil.daemon.safety import LoopState
from friction_hil.errors import RecordingError
from friction_hil.recordings import Recording
from friction_hil.reports.run import friction

CYCLE_S, MOTION_S, START_S, FADE_S = 1e-3, 0.5, 0.2, 0.1
IDLE, RUNNING = 100, 6000  # cycles
ON = 3000  # cycle of the run in which the compensation begins


def recorded(*, on=(ON, RUNNING), known_from=0, dropped=()):
    """A sine whose error is 2e-3 without and 5e-4 with compensation, and wild where no row may count."""
    cycle = np.arange(IDLE + RUNNING, dtype=float)
    moving = cycle - IDLE
    is_on = (moving >= on[0]) & (moving < on[1])
    error, settled = np.where(is_on, 5e-4, 2e-3), (FADE_S + SETTLE_S) / CYCLE_S
    for begin, duration in ((-IDLE, IDLE + (START_S + SETTLE_S) / CYCLE_S), *((each, settled) for each in on)):
        error[(moving >= begin) & (moving < begin + duration)] = 1.0
    demand = np.sin(2.0 * np.pi * cycle * CYCLE_S / MOTION_S)
    columns = {
        "time_s": cycle * CYCLE_S,
        "cycle": cycle,
        "position": demand - error,
        "position_demand": np.where(moving >= known_from, demand, np.nan),
        "is_fresh": np.ones_like(cycle),
        "is_enabled": is_on.astype(float),
        "state": np.where(moving >= 0, float(LoopState.RUNNING), float(LoopState.IDLE)),
    }
    return Recording("made.mcap", "x", {name: np.delete(values, dropped) for name, values in columns.items()})


def phases(recording, motion_s=MOTION_S):
    return without_and_with(recording, cycle_s=CYCLE_S, motion_s=motion_s, start_s=START_S, fade_s=FADE_S)


@pytest.mark.parametrize(
    ("given", "motion_s", "without", "compensated"),
    [
        # of 2.3 s that have settled without and 2.4 s with compensation, 2 s are whole periods
        ({}, MOTION_S, [(0.8, 2.8)], [(3.7, 5.7)]),
        ({"on": (2000, RUNNING)}, MOTION_S, [(0.8, 1.8)], [(4.7, 5.7)]),  # of the longer part the last ones
        ({}, math.inf, [(0.8, 3.1)], [(3.7, 6.1)]),  # a motion without period
        ({"on": (ON, 4500)}, math.inf, [(0.8, 3.1), (5.2, 6.1)], [(3.7, 4.6)]),  # off again: it settles anew
        ({"known_from": 1000}, math.inf, [(1.6, 3.1)], [(3.7, 6.1)]),  # before the master gives a demand
        ({"on": (RUNNING, RUNNING)}, MOTION_S, [(0.8, 5.8)], None),
        ({"on": (0, RUNNING)}, MOTION_S, None, [(0.8, 5.8)]),  # it begins with the motion
    ],
)
def test_settled_motion_counts_in_whole_periods_and_as_many_without_as_with(given, motion_s, without, compensated):
    for phase, intervals_s, error in zip(
        phases(recorded(**given), motion_s), (without, compensated), (2e-3, 5e-4), strict=True
    ):
        assert (phase is None) == (intervals_s is None)
        if phase is not None:
            assert phase.intervals_s == [pytest.approx(each) for each in intervals_s]
            assert (phase.figures.rms, phase.figures.peak) == pytest.approx((error, error))
            assert not np.isnan(phase.error).any()


def test_figures_are_compared_and_courses_are_thinned():
    before, after = phases(recorded())
    assert len(before.time_s) == len(before.error) == 500
    assert before.figures.times(after.figures).rms == pytest.approx(4.0)


def test_the_offset_of_the_motor_across_the_transmission_is_no_error():
    plain, offset = recorded(), recorded()
    offset.columns["motor_offset"] = 0.01 * np.sign(np.sin(np.arange(len(offset)) * CYCLE_S))
    offset.columns["position"] = offset.columns["position"] + offset.columns["motor_offset"]
    for expected, found in zip(phases(plain), phases(offset), strict=True):
        assert found.figures.rms == pytest.approx(expected.figures.rms)
        assert found.figures.peak == pytest.approx(expected.figures.peak)


def test_rows_after_a_missed_period_do_not_count():
    made = recorded(dropped=[IDLE + 2000])
    made.columns["position"][IDLE + 2000 : IDLE + 2000 + round(RECOVERY_S / CYCLE_S)] += 0.3
    before, _ = phases(made)
    assert before.figures.peak == pytest.approx(2e-3)


def test_too_few_rows_are_refused():
    with pytest.raises(RecordingError, match="too busy"):
        phases(recorded(dropped=range(IDLE + 1000, IDLE + 3000, 20)))
    bare = recorded()
    del bare.columns["state"]
    with pytest.raises(RecordingError, match="state"):
        phases(bare)


def test_friction_over_velocity_is_thinned_evenly_and_keeps_its_extremes():
    turn = np.arange(200_000) * 2.0 * np.pi / 200.0  # even steps of 100 rows would meet two points again and again
    velocity, torque = np.sin(turn), np.sign(np.sin(turn))
    torque[123_456], torque[77] = 9.0, -9.0
    shown, friction_torque = friction.thinned(velocity, torque)
    assert 5000 < len(shown) < 7000
    assert friction_torque.max() == 9.0
    assert friction_torque.min() == -9.0
    assert len(np.unique(np.round(shown, 6))) > 90
