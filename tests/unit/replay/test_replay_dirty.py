"""Logs as they are: each fault is detected, reported, and handled so that the true model still explains the torque."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from friction_hil.errors import RecordingError
from friction_hil.models.model_file import ModelFile
from friction_hil.numerics.filtering import decimate, decimated_rows, lowpass
from friction_hil.recordings import Recording
from friction_hil.recordings.quality import find_jumps, find_wrap, resolution, spread, unwrap
from friction_hil.recordings.segments import Segment, even_signals
from friction_hil.replay.comparison import Replay, predict, replay
from friction_hil.replay.preparation import replay_segments

RATE = 1000.0
AMPLITUDE = 3.0
LUGRE = {"sigma0": 200.0, "sigma1": 0.5, "sigma2": 0.05, "coulomb": 0.3, "static": 0.4, "stribeck_velocity": 0.5}


def model(name: str = "coulomb", **parameters: float) -> ModelFile:
    friction = {"model": name, "parameters": parameters or {"coulomb": 0.3, "viscous": 0.05}}
    mechanics = {"inertia": 0.02, "offset": 0.1}
    return ModelFile.model_validate({"axis": "rotary", "friction": friction, "mechanics": mechanics})


def swing(time: np.ndarray | None = None) -> Recording:
    """A sine of 1 Hz at given times, with the torque that `model` needs for it, by hand."""
    time = np.arange(4000) / RATE if time is None else time
    angle = 2.0 * np.pi * time + 0.3
    velocity = 2.0 * np.pi * AMPLITUDE * np.cos(angle)
    position = AMPLITUDE * np.sin(angle)
    torque = -0.02 * (2.0 * np.pi) ** 2 * position + 0.3 * np.sign(velocity) + 0.05 * velocity + 0.1
    return Recording("log", "x", {"time_s": time, "position": position, "velocity": velocity, "torque": torque})


def only(recording: Recording, rows: np.ndarray) -> Recording:
    columns = {name: values[rows] for name, values in recording.columns.items()}
    return Recording(recording.path, recording.axis, columns)


def result(recording: Recording, **options: float) -> tuple[Replay, float]:
    outcome = replay(recording, {"true": model()}, **options)
    return outcome, outcome.predictions[0].relative_error


def test_holes_in_a_column_are_bridged_or_cut() -> None:
    log = swing()
    log.columns["torque"][[7, 9]] = np.nan
    log.columns["velocity"][2000:2100] = np.inf
    outcome, error = result(log)
    assert error < 1e-3
    assert "torque is not finite in 2 of 4000 rows (row 7, 9): interpolated, unless" in outcome.problems[0]
    assert "velocity is not finite in 100 of 4000 rows (row 2000," in outcome.problems[1]
    assert outcome.problems[2] == "1 gap of more than 10 periods, before 2.1 s: 2 parts, each by itself"
    assert len(outcome.time_s) == 3900


def test_a_column_that_is_sampled_more_slowly_is_interpolated() -> None:
    log = swing()
    slow = np.full(4000, np.nan)
    slow[::4] = log["torque"][::4]
    log.columns["torque"] = slow
    outcome, error = result(log)
    assert error < 0.02
    assert len(outcome.segments) == 1


def test_a_clock_that_is_set_back_begins_a_new_part() -> None:
    log = swing()
    log.columns["time_s"] = np.concatenate([log["time_s"][:2500], log["time_s"][2500:] - 2.5])
    outcome, error = result(log)
    assert error < 1e-3
    assert outcome.problems == ("time_s is set back at 1 of 4000 rows (row 2500): a new part begins there",)
    assert outcome.segments == (slice(0, 2500), slice(2500, 4000))


def swapped() -> np.ndarray:
    order = np.arange(4000)
    order[[100, 102]] = order[[102, 100]]
    return order


@pytest.mark.parametrize(
    ("rows", "problem"),
    [
        (swapped(), "time_s goes backward at 2 of 4000 rows (row 101, 102): put in order"),
        (np.r_[0:500, 499, 499, 500:4000], "time_s stands still at 2 of 4002 rows (row 500, 501): the first of each"),
    ],
    ids=["disorder", "repeated"],
)
def test_rows_in_disorder_are_put_in_order_and_repeated_ones_taken_once(rows: np.ndarray, problem: str) -> None:
    outcome, error = result(only(swing(), rows))
    assert error < 1e-4
    assert [each[: len(problem)] for each in outcome.problems] == [problem]
    assert len(outcome.time_s) == 4000


def test_coarse_stamps_are_spread() -> None:
    log = swing()
    log.columns["time_s"] = np.floor(log["time_s"] * 250.0) / 250.0  # four rows share a stamp
    outcome, error = result(log)
    assert error < 1e-3
    assert "its stamps are coarse, and the rows are spread evenly" in outcome.problems[0]
    assert len(outcome.time_s) == 4000


def test_jitter_costs_little() -> None:
    random = np.random.default_rng(3)
    outcome, error = result(swing(np.arange(4000) / RATE + random.uniform(-3e-4, 3e-4, 4000)))
    assert error < 0.02
    assert "the time stamps are uneven: interpolated at" in outcome.problems[0]


@pytest.mark.parametrize(
    ("reach", "step", "name"),
    [(2.0 * math.pi, None, "2 pi"), (4.0, 4.0 / 2**14, "2^14 steps"), (5.0, 5.0 / 2**10, "2^10 steps")],
)
def test_an_encoder_that_wraps_is_unwrapped(reach: float, step: float | None, name: str) -> None:
    log = swing()
    position = log["position"] if step is None else np.round(log["position"] / step) * step
    log.columns["position"] = np.mod(position, reach)
    jumps = int(np.sum(np.abs(np.diff(log.columns["position"])) > reach / 2))
    [motion], _, problems = replay_segments(log)
    assert f"position wraps over {reach:.6g} ({name}) at {jumps} of 4000 rows" in problems[0]
    np.testing.assert_allclose(np.diff(motion.position), np.diff(position), atol=1e-9)


def test_a_jump_that_no_encoder_makes_is_reported_and_left() -> None:
    log = swing()
    log.columns["position"][1700:] += 50.123
    [motion], _, [problem] = replay_segments(log)
    assert problem.startswith("position jumps by up to 50.1")
    assert problem.endswith("at 1 of 4000 rows (row 1700), which no encoder wrap explains: left unchanged")
    np.testing.assert_array_equal(motion.position, log["position"])


def test_a_coarse_velocity_is_derived_from_the_position_instead() -> None:
    log = swing()
    log.columns["velocity"] = np.round(log["velocity"] / 2.0) * 2.0
    outcome, error = result(log)
    assert error < 0.01
    (problem,) = outcome.problems
    assert problem.startswith("velocity comes in steps of 2, ")
    assert problem.endswith("derived from the position below 100 Hz")


def test_a_load_that_is_hardly_known_is_not_used() -> None:
    log = swing()
    log.columns["load_torque"] = np.where(np.arange(4000) < 400, 1.0, np.nan)
    [motion], _, problems = replay_segments(log)
    assert motion.load_torque is None
    assert "load_torque is known in 10 % of the rows: not used" in problems
    log.columns["temperature"] = np.where(np.arange(4000) % 1000 == 0, 20.0 + np.arange(4000) / 1000.0, np.nan)
    [motion], _, _ = replay_segments(log)
    temperature = motion.temperature
    np.testing.assert_allclose(temperature[[0, 500, 3999]], [20.0, 20.5, 23.0])


def test_short_parts_are_reported() -> None:
    outcome, error = result(only(swing(), np.r_[0:1500, 1600:1610, 1700:4000]), lowpass_hz=20.0)
    assert error < 1e-3
    assert "the part from 1.6 s to 1.609 s has 10 rows, too few for a low-pass at 20 Hz: left out" in outcome.problems
    assert len(outcome.segments) == 2
    _, _, problems = replay_segments(only(swing(), np.r_[0:500, 600:602, 700:900]))
    assert "1 part of fewer than 3 rows: left out" in problems


def test_nothing_but_short_parts_is_refused() -> None:
    with pytest.raises(RecordingError, match="no part without a gap has 3 rows"):
        replay(only(swing(), np.r_[0:2, 100:102, 200:202, 300:302]), {"true": model()})
    log = swing()
    log.columns["torque"][1:] = np.nan
    with pytest.raises(RecordingError, match=r"no part without a gap has 3 rows|few values"):
        replay(log, {"true": model()})


@pytest.mark.parametrize("options", [{}, {"lowpass_hz": 40.0}, {"lowpass_hz": 40.0, "decimate": 4}])
def test_two_parts_give_the_same_as_two_files(options: dict[str, float]) -> None:
    """Filters and bristles know nothing of what is beyond a gap."""
    whole = swing()
    first, second = np.arange(1400), np.arange(2300, 4000)
    models = {"lugre": model("lugre", **LUGRE)}
    both = replay(only(whole, np.r_[first, second]), models, **options)
    halves = [replay(only(whole, rows), models, **options) for rows in (first, second)]
    assert len(both.segments) == 2
    for part, half in zip(both.segments, halves, strict=True):
        for name in ("time_s", "velocity", "measured"):
            np.testing.assert_allclose(getattr(both, name)[part], getattr(half, name), rtol=1e-9, atol=1e-9)
        np.testing.assert_allclose(both.predictions[0].torque[part], half.predictions[0].torque, rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("lowpass_hz", [None, 40.0])
def test_segments_are_the_rows_between_gaps_each_by_itself(lowpass_hz: float | None) -> None:
    """A segment made by hand from one part alone is the same, and a model predicts the same torque for it."""
    signals = even_signals(only(swing(), np.r_[0:1400, 2300:4000]), lowpass_hz=lowpass_hz)
    assert signals.grid.segments == (slice(0, 1400), slice(1400, 3100))
    assert signals.longest == 1700
    time, position, velocity, torque = (swing()[name][2300:] for name in ("time_s", "position", "velocity", "torque"))
    if lowpass_hz is not None:
        position = lowpass(position, lowpass_hz, RATE)
        velocity = np.gradient(position, 1.0 / RATE)
    acceleration = np.gradient(velocity, 1.0 / RATE)
    by_hand = Segment(
        *("log", "x", time, position, velocity, acceleration, torque),
        *(None, None, None, RATE, lowpass_hz, swing()["position"][2300:]),
    )
    second = signals.segment(signals.grid.segments[1])
    for name in ("time_s", "position", "velocity", "acceleration", "torque", "encoder"):
        np.testing.assert_allclose(getattr(second, name), getattr(by_hand, name), rtol=1e-9, atol=1e-9)
    for found, expected in zip(predict(model(), second), predict(model(), by_hand), strict=True):
        np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-9)


@given(turns=st.floats(0.6, 20.0), bits=st.integers(8, 16), start=st.floats(-1.0, 1.0))
@settings(max_examples=50, deadline=None)
def test_unwrapping_gives_back_any_smooth_motion(turns: float, bits: int, start: float) -> None:
    """Counts of an encoder of one turn, up to a twentieth of a turn between two rows."""
    rows = max(200, int(turns * 40))
    counts = np.round((start + turns * np.sin(np.linspace(0.0, 3.0, rows))) * 2**bits)
    wrapped = np.mod(counts, 2**bits)
    jumps = find_jumps(wrapped)
    true_jumps = np.flatnonzero(np.abs(np.diff(wrapped)) > 2 ** (bits - 1)) + 1
    if not true_jumps.size:
        assert not jumps.size
        return
    wrap = find_wrap(wrapped, jumps)
    np.testing.assert_array_equal(wrap.rows, true_jumps)
    np.testing.assert_allclose(unwrap(wrapped, wrap) - wrapped[0], counts - counts[0], atol=1e-6)


@given(st.integers(0, 2**31), st.floats(1e-6, 10.0))
def test_the_step_of_a_quantised_column_is_found(seed: int, step: float) -> None:
    values = np.random.default_rng(seed).normal(size=500).cumsum()
    assert resolution(values) is None
    assert resolution(np.round(values * 5.0) * step) == pytest.approx(step, rel=1e-6)


@given(st.lists(st.integers(1, 5), min_size=2, max_size=40))
def test_spread_stamps_go_forward_and_keep_the_first_of_each(counts: list[int]) -> None:
    stamps = np.repeat(np.arange(float(len(counts))), counts)
    result = spread(stamps)
    assert np.all(np.diff(result) > 0.0)
    np.testing.assert_array_equal(np.floor(result), stamps)


@given(st.integers(26, 200), st.integers(1, 9))
def test_decimated_rows_are_those_of_the_samples(rows: int, factor: int) -> None:
    ramp = np.arange(float(rows))
    kept = decimate(ramp, factor)
    assert len(kept) == len(ramp[decimated_rows(rows, factor)]) == math.ceil(rows / factor)
    assert ramp[decimated_rows(rows, factor)][-1] == rows - 1
    both = decimate(np.stack([ramp, ramp**2], axis=1), factor)
    np.testing.assert_array_equal(both[:, 0], kept)


def test_filters_take_columns_side_by_side() -> None:
    values = np.random.default_rng(0).normal(size=(300, 3))
    alone = [lowpass(column.copy(), 50.0, 1000.0) for column in values.T]
    np.testing.assert_allclose(lowpass(values, 50.0, 1000.0).T, alone, rtol=1e-12, atol=1e-13)
