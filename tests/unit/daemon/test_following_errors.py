"""Following error of runs and recordings: which cycles count, against plain computations and known errors."""

import math
import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from friction_hil.analysis.baseline import without_and_with
from friction_hil.cli.work.run import _hint
from friction_hil.daemon.figures import (
    RECOVERY_OF_LATE,
    RECOVERY_OF_MISSED,
    RECOVERY_S,
    SETTLE_S,
    AxisFigures,
    Condition,
    ConditionFigures,
    FollowingErrors,
)
from friction_hil.daemon.safety import LoopState
from friction_hil.errors import RecordingError
from friction_hil.recordings import Recording
from friction_hil.reports.run import friction
from tests.loop_run import SINE, Run, axis
from tests.servo_drives import configuration

T, RAMP_S, PERIOD_S, FADE_S = 2e-3, 0.2, 0.5, 0.1
WITHOUT, WITH, FADING = Condition.WITHOUT, Condition.WITH, Condition.FADING
NO_GAPS = {"stale": 0, "bridged": 0, "bridged_reasons": {}}


def conditions(baseline_s, duration_s):
    """The conditions of a run with a baseline, cycle by cycle."""
    time = np.arange(round(duration_s / T)) * T
    return np.select([time < baseline_s, time <= baseline_s + FADE_S], [WITHOUT, FADING], WITH)


def taken(cycles, error, *, missing=(), late=(), motion_s=PERIOD_S, ramp_s=RAMP_S):
    """Figures of a run in which some cycles are missed, and the feedback of others is late."""
    errors, last = FollowingErrors(T, ramp_s, motion_s), -1
    for k, condition in enumerate(cycles):
        if k not in missing:
            errors.take(Condition(condition), float(error[k]), k - last - 1, k not in late)
            last = k
    return errors.figures(WITHOUT), errors.figures(WITH)


def periods(cycles, condition):
    """First cycle after the settling, and the number of whole periods from there on."""
    inside = np.flatnonzero(cycles == condition)
    begin = max(inside[0] + SETTLE_S / T, (RAMP_S + SETTLE_S) / T)
    return begin, int((inside[-1] + 1 - begin) / (PERIOD_S / T) + 1e-9)


def expected(cycles, error, condition, missing=(), late=()):
    """The same, over arrays: the last whole periods, as many of both conditions, without the cycles that recover."""
    number = np.arange(len(cycles))
    begin, whole = periods(cycles, condition)
    count = min(periods(cycles, each)[1] for each in (WITHOUT, WITH))
    length = PERIOD_S / T
    begin += (whole - count) * length
    kept = (number >= begin) & (number < begin + count * length) & ~np.isin(number, [*missing, *late])
    for k in number:
        if k not in missing and k - 1 in missing:
            gap = 1
            while k - 1 - gap in missing:
                gap += 1
            kept &= ~((number >= k) & (number < k + RECOVERY_S / T + RECOVERY_OF_MISSED * gap))
        if k in late:
            kept &= ~((number >= k) & (number < k + RECOVERY_OF_LATE))
    return math.sqrt(np.mean(error[kept] ** 2)), np.abs(error[kept]).max(), int(kept.sum())


@settings(max_examples=40, deadline=None)
@given(
    baseline_s=st.floats(1.3, 2.5),
    duration_s=st.floats(3.9, 5.0),
    seed=st.integers(0, 1000),
    missing=st.sets(st.integers(5, 1900), max_size=6),
    late=st.sets(st.integers(5, 1900), max_size=6),
)
def test_what_counts_is_steady_motion_in_whole_periods(baseline_s, duration_s, seed, missing, late):
    cycles = conditions(baseline_s, duration_s)
    error = np.random.default_rng(seed).standard_normal(len(cycles))
    late -= missing
    found = taken(cycles, error, missing=missing, late=late)
    for figures, condition in zip(found, (WITHOUT, WITH), strict=True):
        rms, peak, count = expected(cycles, error, condition, missing, late)
        assert (figures.rms, figures.peak) == (pytest.approx(rms), peak)
        assert figures.counted == count


def test_without_a_whole_period_the_steady_motion_counts_that_there_is():
    without, compensated = taken(conditions(1.0, 1.9), np.ones(1000))
    assert (without.counted, compensated.counted) == (round(0.3 / T), pytest.approx(0.3 / T, abs=1))
    assert without.rms == compensated.rms == 1.0
    assert taken(conditions(9.0, RAMP_S + SETTLE_S), np.ones(5000)) == (None, None)  # it ends too early


def test_the_reduction_is_that_of_both_conditions():
    some, less = ConditionFigures(4.0, 8.0, 3, 0), ConditionFigures(1.0, 2.0, 3, 0)
    assert AxisFigures("rad", some, less, is_comparable=True, **NO_GAPS).reduction.rms == pytest.approx(4.0)
    assert AxisFigures("rad", None, less, is_comparable=True, **NO_GAPS).reduction is None


def test_an_interrupted_operation_settles_anew():
    """As sidecar: the drive is disabled and enabled again, and jumps meanwhile."""
    one, gap = round(2.0 / T), round(0.3 / T)
    cycles = np.array([WITHOUT] * one + [FADING] * gap + [WITHOUT] * one)
    error = np.ones(len(cycles))
    error[one : one + gap + round(SETTLE_S / T)] = 100.0
    without, _ = taken(cycles, error, motion_s=math.inf, ramp_s=0.0)
    assert (without.peak, without.counted) == (1.0, 2 * round(1.5 / T))


@given(baseline_s=st.floats(0.5, 2.5), motion_s=st.sampled_from([PERIOD_S, math.inf]), seed=st.integers(0, 1000))
@settings(max_examples=25, deadline=None)
def test_the_end_of_a_time_without_compensation_is_news_once_with_its_figures(baseline_s, motion_s, seed):
    """A thousandth of a second into a fade, not after it: a run that ends then has had them."""
    cycles = conditions(baseline_s, 5.0)
    error = np.random.default_rng(seed).standard_normal(len(cycles))
    errors, told = FollowingErrors(T, RAMP_S, motion_s), {}
    for k, condition in enumerate(cycles):
        errors.take(Condition(condition), float(error[k]), 0, is_usable=True)
        if errors.news is not None:
            told[k], errors.news = errors.news, None
    end = int(np.argmax(cycles != WITHOUT))
    alone, _ = taken(cycles[:end], error, motion_s=motion_s)
    if alone is None:
        assert told == {}
    else:
        rms, seconds = pytest.approx(alone.rms), pytest.approx(alone.counted * T)
        assert {k: (each.rms, each.peak, each.seconds) for k, each in told.items()} == {end: (rms, alone.peak, seconds)}


@pytest.mark.parametrize("mode", ["csp", "cst"])
def test_a_run_has_the_figures_that_its_recording_shows(mode):
    given = {"trajectory": SINE, "compensation": {"baseline_s": 2.0, "fade_s": 0.1}}
    run = Run(axis(mode, **given), duration_s=5.0)
    [one] = run.axes
    names = ("time_s", "cycle", "position", "position_demand", "is_fresh", "is_enabled", "state")
    recording = Recording("run.mcap", "x", {name: run.column(name) for name in names})
    found = without_and_with(recording, cycle_s=run.config.period_s, motion_s=1.0, start_s=SINE["ramp_s"], fade_s=0.1)
    lap = round(1.0 / run.config.period_s)
    for phase, condition in zip(found, (WITHOUT, WITH), strict=True):
        figures = one.following.errors.figures(condition)
        assert figures.counted == lap  # 1.25 s of steady motion without compensation: one period of each
        assert (phase.figures.rms, phase.figures.peak) == (figures.rms, figures.peak)
        error = recording["position_demand"] - recording["position"]
        [(begin, end)] = phase.intervals_s
        inside = (recording["time_s"] >= begin - 1e-9) & (recording["time_s"] < end - 1e-9)
        assert figures.rms == pytest.approx(math.sqrt(np.mean(error[inside] ** 2)))
        assert figures.peak == pytest.approx(np.abs(error[inside]).max())


def hinted(figures, **changes):
    """What `run` says about an axis of which it has these figures."""
    configured = configuration(x=axis(**changes)).axes["x"]
    is_comparable = configured.trajectory.kind != "experiment"
    return _hint(AxisFigures("rad", *figures, is_comparable=is_comparable, **NO_GAPS), configured)


@given(frequency=st.sampled_from([0.2, 0.5, 1.0, 4.0]), ramp_s=st.floats(0.1, 3.0))
@settings(max_examples=25, deadline=None)
def test_the_baseline_that_is_suggested_is_long_enough(frequency, ramp_s):
    some = ConditionFigures(1.0, 2.0, 3, 0)
    text = hinted((None, some), trajectory={**SINE, "frequency": frequency, "ramp_s": ramp_s})
    baseline_s = float(re.search(r"compensation: {baseline_s: (\d+)} makes the first \d+ s a comparison", text)[1])
    errors = FollowingErrors(T, ramp_s, 1.0 / frequency)
    for _ in range(round(baseline_s / T)):
        errors.take(WITHOUT, 1.0, 0, True)
    assert errors.figures(WITHOUT).counted >= 2.0 / frequency / T - 2


@pytest.mark.parametrize(
    ("count", "changes", "words"),
    [
        (2, {}, "^$"),
        (
            0,
            {"mode": "cst", "trajectory": {"kind": "none"}, "limits": {"torque": 0.3, "velocity": 30.0}}
            | {"controller": None},
            "^$",
        ),
        (2, {"trajectory": {"kind": "experiment", "velocity": 3.0, "travel": 1.0}}, "do not compare"),
        (0, {}, "before the motion was steady"),
        (1, {"compensation": {"enabled": False}}, r"compensation\.enabled"),
        (1, {"compensation": {"baseline_s": 3.0}}, "--duration"),
    ],
)
def test_what_a_comparison_lacks_is_said(count, changes, words):
    some = ConditionFigures(1.0, 2.0, 3, 0)
    assert re.search(words, hinted((some if count else None, some if count == 2 else None), **changes))


CYCLE_S, MOTION_S, START_S, FADING_S = 1e-3, 0.5, 0.2, 0.1
IDLE, RUNNING = 100, 6000  # cycles
ON = 3000  # cycle of the run in which the compensation begins


def recorded(*, on=(ON, RUNNING), known_from=0, dropped=()):
    """A sine whose error is 2e-3 without and 5e-4 with compensation, and wild where no row may count."""
    cycle = np.arange(IDLE + RUNNING, dtype=float)
    moving = cycle - IDLE
    is_on = (moving >= on[0]) & (moving < on[1])
    error, settled = np.where(is_on, 5e-4, 2e-3), (FADING_S + SETTLE_S) / CYCLE_S
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
    return without_and_with(recording, cycle_s=CYCLE_S, motion_s=motion_s, start_s=START_S, fade_s=FADING_S)


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
