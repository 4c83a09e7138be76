"""Strokes with rests or with a multisine on top, and motions one after another: bounds, derivatives, joins, rest."""

import math

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from friction_hil.config import from_dict
from friction_hil.config.trajectories import peak_speed
from friction_hil.daemon.assembly import make_path
from friction_hil.errors import ConfigurationError, UsageError
from friction_hil.motion import multisine
from friction_hil.motion.sequence import STROKE_ACCELERATION, STROKE_SPEED, Part, sequence_path, strokes_path
from friction_hil.motion.trajectory import circle_path, extent, sine_path, triangle_path
from tests.servo_drives import PERIOD_S, axis_dict, configuration


def sampled(path, duration_s, step=1e-3):
    return np.array([path(s) for s in np.arange(0.0, duration_s, step).tolist()])


def assert_is_integral(rows, step, *, jumps=0.0):
    """Position and velocity follow from their derivatives by the trapezoidal rule; an acceleration may jump."""
    mean_velocity = 0.5 * (rows[1:, 1] + rows[:-1, 1])
    mean_acceleration = 0.5 * (rows[1:, 2] + rows[:-1, 2])
    largest = np.abs(rows).max(axis=0)
    assert np.diff(rows[:, 0]) == pytest.approx(step * mean_velocity, abs=step * step * (largest[2] + jumps))
    change = np.abs(np.diff(rows[:, 1]) - step * mean_acceleration)
    assert change.max() <= step * (0.5 * jumps + 0.1 * largest[2])


@settings(max_examples=30, deadline=None)
@given(stroke=st.floats(0.01, 10.0), frequency=st.floats(0.1, 2.0), rest=st.floats(0.0, 0.9))
def test_strokes_go_to_and_fro_and_rest_at_both_ends(stroke, frequency, rest) -> None:
    path, half = strokes_path(stroke, frequency, rest), 0.5 / frequency
    step = half / 2000
    rows = sampled(path, 2.0 * half, step)
    assert_is_integral(rows, step)
    assert (rows[:, 0].min(), rows[:, 0].max()) == pytest.approx((0.0, stroke), abs=1e-9)
    moving_s = (1.0 - rest) * half
    assert np.abs(rows[:, 1]).max() == pytest.approx(STROKE_SPEED * stroke / moving_s, rel=1e-3)
    assert np.abs(rows[:, 2]).max() == pytest.approx(STROKE_ACCELERATION * stroke / moving_s**2, rel=1e-3)
    assert path(moving_s) == pytest.approx((stroke, 0.0, 0.0), abs=1e-9 * max(1.0, stroke / moving_s**2))
    assert path(half + moving_s + 1e-9) == pytest.approx((0.0, 0.0, 0.0), abs=1e-6 * stroke / moving_s**2)


PARTS = (
    Part(sine_path(0.3, 1.5, 0.7), 2.0 / 1.5, 0.4, 0.2),
    Part(circle_path(0.5, 2.0, -0.4), 1.5, 0.5, 0.0),
    Part(strokes_path(0.2, 1.0, 0.5), 1.0, 0.0, 0.3),
    Part(triangle_path(0.4, 1.0, 0.3), 1.0, 5.0, 0.1),  # a ramp that is longer than the motion
)


def test_motions_of_a_sequence_join_at_rest() -> None:
    path, duration_s = sequence_path(PARTS), sum(part.duration_s for part in PARTS)
    rows = sampled(path, duration_s + 0.5)
    assert_is_integral(rows, 1e-3, jumps=40.0)
    begin_s = 0.0
    for part in PARTS:
        for s in (begin_s, begin_s + part.moving_s + 0.5 * part.rest_s, begin_s + part.duration_s):
            assert path(s) == pytest.approx((0.0, 0.0, 0.0), abs=1e-9)
        begin_s += part.duration_s
    assert path(-1.0) == path(duration_s + 1.0) == (0.0, 0.0, 0.0)


def test_between_its_ramps_a_motion_is_as_it_is() -> None:
    """A whole number of periods: two axes stay on their circle."""
    axes = [sequence_path([Part(circle_path(0.5, 1.0, phase), 3.0, 0.5, 0.0)]) for phase in (0.0, -0.5 * math.pi)]
    x, y = (sampled(each, 3.5) for each in axes)
    assert np.hypot(x[:, 0] + 0.5, y[:, 0]) == pytest.approx(0.5, abs=1e-9)
    steady = slice(510, 2990)
    assert np.hypot(x[steady, 1], y[steady, 1]) == pytest.approx(math.pi, rel=1e-9)
    assert np.hypot(x[:, 1], y[:, 1]).max() <= math.pi * (1.0 + 1e-9)


def test_a_configured_sequence_is_the_path_of_its_motions() -> None:
    sine, strokes = {"amplitude": 0.5, "frequency": 0.5}, {"stroke": 0.3, "frequency": 0.25}
    motions = [
        {"name": "wide", "motion": {"kind": "sine", **sine}, "periods": 2, "ramp_s": 0.5},
        {"name": "rests", "motion": {"kind": "strokes", **strokes}, "ramp_s": 0.0, "rest_s": 1.0},
    ]
    axis = configuration(x=axis_dict(trajectory={"kind": "sequence", "motions": motions})).axes["x"]
    path = make_path(axis, 1e-6, PERIOD_S)
    assert axis.trajectory.duration_s == pytest.approx((4.0 + 0.5 + 0.5) + (4.0 + 1.0))
    low, high, speed = extent(path, axis.trajectory.duration_s, 10_000)
    assert (low, high) == pytest.approx((-0.5, 0.5), rel=1e-3)
    assert speed == pytest.approx(peak_speed(axis.trajectory), rel=1e-3)
    assert peak_speed(axis.trajectory.motions[1].motion) == pytest.approx(STROKE_SPEED * 0.3 / 1.0)


def planned(velocity=2.0, travel=1.0, **given):
    return multisine.plan(velocity, travel, period_s=PERIOD_S, **given)


@settings(max_examples=6, deadline=None)
@example(velocity=1.0, travel=2.0, acceleration=1.0, high_hz=40.0)  # too little time for a whole stroke of its length
@given(
    st.floats(1e-3, 50.0),
    st.floats(1e-3, 10.0),
    st.one_of(st.none(), st.floats(0.01, 1e3)),
    st.sampled_from([40.0, 100.0, None]),
)
def test_the_motion_stays_within_its_bounds_and_ends_where_it_began(velocity, travel, acceleration, high_hz):
    plan = planned(velocity, travel, acceleration=acceleration, high_hz=high_hz, duration_s=16.0)
    path = multisine.multisine_path(plan)
    points = np.array([path(plan.duration_s * k / 4000) for k in range(4001)])
    assert np.max(np.abs(points[:, 0])) <= travel
    assert np.max(np.abs(points[:, 1])) <= velocity
    if acceleration is not None:
        assert np.max(np.abs(points[:, 2])) <= acceleration
    np.testing.assert_allclose(path(plan.duration_s), path(0.0), atol=1e-9 * max(velocity, 1.0) * 1e4)


def test_velocity_and_acceleration_are_derivatives_of_the_position():
    path = multisine.multisine_path(planned())
    step = 1e-5
    for time in np.linspace(0.3, 15.9, 200):
        before, now, after = (path(time + k * step) for k in (-1.0, 0.0, 1.0))
        assert (after[0] - before[0]) / (2.0 * step) == pytest.approx(now[1], abs=1e-4)
        assert (after[1] - before[1]) / (2.0 * step) == pytest.approx(now[2], rel=2e-2, abs=0.3)


def test_the_axis_slides_between_corners_and_is_shaken_alike_in_the_whole_band():
    plan = planned()
    path = multisine.multisine_path(plan)
    velocity = np.array([path(PERIOD_S * k)[1] for k in range(round(plan.duration_s / PERIOD_S))])
    smooth = 4.0 * plan.amplitude * plan.frequency
    assert np.mean(np.abs(velocity) > 0.3 * smooth) > 0.9
    strokes = round(plan.frequency * plan.duration_s)  # no two have the same part of the multisine
    assert math.gcd(strokes, round(plan.duration_s / multisine.REPEAT_S)) == 1
    table = multisine.multisine_table(plan.low_hz, plan.high_hz, plan.sine_velocity, plan.sine_acceleration)
    power = np.abs(np.fft.rfft(table[:, 2]))
    lines = np.arange(len(power)) / multisine.REPEAT_S
    excited = power > 1e-6 * np.max(power)
    assert lines[excited][0] == plan.low_hz
    assert lines[excited][-1] == plan.high_hz
    # a sine has 1.41, random phases about 4
    assert np.max(np.abs(table[:, 2])) / np.std(table[:, 2]) < 1.8


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"high_hz": 500.0}, "500 Hz"),
        ({"high_hz": 3.0}, "from 4 Hz"),
        ({"travel": 0.0}, "travel above zero"),
        ({"velocity": math.inf}, "velocity above zero and finite"),
        ({"duration_s": 10.0}, "16 s or more"),
    ],
)
def test_bounds_without_room_are_refused(given, message):
    with pytest.raises(UsageError, match=message):
        planned(**given)


def configured(**trajectory):
    content = {"kind": "multisine", "velocity": 2.0, "travel": 0.5, **trajectory}
    limits = {"torque": 0.3, "velocity": 5.0, "position": [-1.0, 1.0]}
    axes = {"x": axis_dict(trajectory=content, limits=limits)}
    bus = {"interface": "virtual", "channel": "multisine"}
    return from_dict({"version": 1, "period_s": 2e-3, "bus": bus, "axes": axes}, "x.yaml")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"high_hz": 250.0}, "250 Hz, not 250"),
        ({"velocity": 6.0}, "up to 6"),
        ({"travel": 1.5}, "1 at most"),
        ({"duration_s": 8.0}, "duration_s"),
    ],
)
def test_a_configuration_is_checked_against_limits_and_loop_rate(change, message):
    with pytest.raises(ConfigurationError, match=message):
        configured(**change)


def test_the_path_of_a_configuration_starts_and_ends_at_rest():
    config = configured()
    path = make_path(config.axes["x"], 6e-6, config.period_s)
    assert path(0.0) == path(40.0) == (0.0, 0.0, 0.0)
    assert abs(path(17.0)[1]) > 0.05
