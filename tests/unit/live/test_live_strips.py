"""Strips of the page, and the circle: what is drawn is what the rows say."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from friction_hil.config import Circle
from friction_hil.daemon.safety import LoopState
from friction_hil.live import Rows
from friction_hil.live.web.circle import CircleTracer
from friction_hil.live.web.strips import BUCKET_S, WINDOW_S, Strips


@given(
    st.lists(st.floats(-1e3, 1e3) | st.just(np.nan), min_size=1, max_size=300),
    st.lists(st.integers(1, 120), min_size=1, max_size=6),
)
def test_however_rows_arrive_no_peak_is_lost_and_nothing_is_invented(values, parts):
    strips, column = Strips(1, 1e-3), np.array(values)
    time, found = 1e-3 * np.arange(len(column)), []
    for at in np.split(np.arange(len(column)), np.cumsum(parts)):
        times, [points] = strips.take(time[at], column[at, None])
        found += zip(times, points, strict=True)
    ends = np.floor(time / BUCKET_S)
    complete = ends < ends[-1]
    for bucket in np.unique(ends[complete]):
        inside = column[ends == bucket]
        known = inside[np.isfinite(inside)]
        shown = [value for at, value in found if int(at / BUCKET_S + 1e-6) == bucket]
        assert len(shown) == 2
        if known.size:
            assert sorted(shown) == pytest.approx([known.min(), known.max()], rel=1e-6)
        else:
            assert shown == [None, None]
    assert len(found) == 2 * len(np.unique(ends[complete]))


def test_a_gap_breaks_the_line_and_the_window_has_an_end():
    strips = Strips(1, 1e-3)
    time = np.concatenate([np.arange(0.0, 1.0, 1e-3), np.arange(2.0, 40.0, 1e-3)])
    times, [values] = strips.take(time, np.ones((len(time), 1)))
    [gap] = [at for at, value in zip(times, values, strict=True) if value is None]
    assert 1.0 < gap < 2.0
    kept, _ = strips.window()
    assert kept[-1] - kept[0] == pytest.approx(WINDOW_S, abs=BUCKET_S)


def test_slow_rows_are_all_shown():
    times, [values] = Strips(1, 0.05).take(0.05 * np.arange(9), np.arange(9.0)[:, None])
    assert (len(times), values) == (9, list(range(9)))


class Facts:
    """What the tracer of the circle needs of a daemon."""

    period_s, ramp_s = 1e-3, 0.2
    axes = ("x", "y")
    columns = ("cycle", "position", "position_demand", "state", "is_fresh", "is_enabled")


def turning(cycles, error, *, state=LoopState.RUNNING):
    """Rows of two axes on a circle of radius 2 about (1, -3), with a radius error that depends on the angle."""
    angle = 2.0 * np.pi * 0.5 * 1e-3 * cycles
    ones, rows = np.ones(len(cycles)), []
    for centre, way in ((1.0, np.cos(angle)), (-3.0, np.sin(angle))):
        rows.append([cycles, centre + (2.0 + error(angle)) * way, centre + 2.0 * way, state * ones, ones, ones])
    return Rows(Facts, np.moveaxis(np.array(rows), 2, 0))


def test_the_circle_shows_the_radius_error_over_the_angle_and_only_of_whole_laps_in_steady_motion():
    def error(angle):
        return 1e-3 * np.cos(3.0 * angle)

    tracer = CircleTracer(Facts, ("x", "y"), Circle(kind="circle", radius=2.0, frequency=0.5))
    for part in np.split(np.arange(2500.0), 10):  # a lap takes 2000 cycles, the start 700
        tracer.take(turning(part, error), 0)
    assert tracer.figures().error.size == 0
    for part in np.split(np.arange(2500.0, 5000.0), 10):
        tracer.take(turning(part, error), 0)
    lap = tracer.figures()
    assert lap.error.size == 2000
    assert lap.error == pytest.approx(error(lap.angle), abs=1e-6)
    assert (lap.compensated, lap.scale.ring, lap.scale.magnification) == (1.0, 5e-4, pytest.approx(800.0))
    tracer.take(turning(np.arange(5000.0, 5010.0), error, state=LoopState.STOPPING), 0)
    assert tracer.figures().error.size == 0
