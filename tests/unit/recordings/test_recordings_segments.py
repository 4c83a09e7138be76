"""The pipeline from a recording to segments: the same for replay, identification, training and tuning."""

import numpy as np
import pytest

from friction_hil.errors import RecordingError, UsageError
from friction_hil.identification.data import prepare
from friction_hil.recordings import Recording
from friction_hil.recordings.segments import even_signals, known_fraction
from friction_hil.replay.preparation import replay_segments

RATE = 1000.0


def swing(**columns: np.ndarray) -> Recording:
    time = np.arange(4000) / RATE
    position = np.sin(2.0 * np.pi * time)
    own = {"time_s": time, "position": position, "velocity": np.gradient(position, 1.0 / RATE), "torque": position}
    return Recording("log", "x", own | columns)


@pytest.mark.parametrize("lowpass_hz", [None, 30.0])
@pytest.mark.parametrize("has_velocity", [True, False])
def test_replay_and_identification_see_the_same_motion(lowpass_hz: float | None, has_velocity: bool) -> None:
    recording = swing()
    if not has_velocity:
        del recording.columns["velocity"]
    [seen_by_replay], _, problems = replay_segments(recording, lowpass_hz)
    [seen_by_identification] = prepare(recording, lowpass_hz=lowpass_hz)
    for name in ("time_s", "position", "velocity", "acceleration", "encoder"):
        np.testing.assert_array_equal(getattr(seen_by_replay, name), getattr(seen_by_identification, name))
    assert seen_by_replay.lowpass_hz == seen_by_identification.lowpass_hz
    np.testing.assert_array_equal(seen_by_replay.torque, seen_by_identification.lowpass(seen_by_identification.torque))
    assert tuple(problems) == seen_by_identification.problems


def test_a_recorded_velocity_is_used_as_it_is_unless_a_low_pass_is_asked_for() -> None:
    signals = even_signals(swing())
    assert signals.lowpass_hz is None
    assert signals.settling_rows == 0
    np.testing.assert_array_equal(signals.segment(signals.grid.segments[0]).velocity, swing()["velocity"])
    signals = even_signals(swing(), lowpass_hz=50.0)
    assert signals.problems == ()
    assert signals.settling_rows == 99
    segment = signals.segment(signals.grid.segments[0])
    np.testing.assert_array_equal(segment.velocity, np.gradient(segment.position, 1.0 / RATE))


def test_the_torque_is_moved_back_by_the_delay_that_the_driver_stated() -> None:
    recording = swing()
    recording.metadata["facts"] = [{"name": "y", "torque_delay_s": 0.5}, {"name": "x", "torque_delay_s": 3e-3}]
    as_recorded = even_signals(recording)
    moved = even_signals(recording, is_torque_delay_removed=True)
    np.testing.assert_array_equal(as_recorded.grid.columns["torque"], recording["torque"])
    np.testing.assert_allclose(moved.grid.columns["torque"][:-3], recording["torque"][3:], atol=1e-12)
    assert as_recorded.problems == ()
    assert moved.problems == ("the drive's torque was read 3 ms late: moved back by as much",)
    recording.metadata["facts"] = [{"name": "x", "torque_delay_s": None}]
    recording.columns["torque"] = np.zeros(4000)
    with pytest.raises(RecordingError, match="axis x does not report its torque"):
        even_signals(recording, is_torque_delay_removed=True)


@pytest.mark.parametrize("lowpass_hz", [0.0, -1.0, 500.0, float("nan")])
def test_a_low_pass_lies_between_zero_and_half_the_sampling_rate(lowpass_hz: float) -> None:
    with pytest.raises(UsageError, match="half the sampling rate, 500 Hz"):
        even_signals(swing(), lowpass_hz=lowpass_hz)


def test_a_recording_is_shown_in_a_few_lines_and_knows_a_fraction_of_its_values():
    columns = {f"column_{k}": np.zeros(5000) for k in range(200)}
    shown = repr(Recording("x.mcap", "x", columns, problems=["something"]))
    assert len(shown.splitlines()) <= 10
    assert len(shown) < 600
    assert "5000 rows; 1 problems" in shown
    recording = swing(load_torque=np.where(np.arange(4000) % 4 == 0, 1.0, np.nan))
    assert [known_fraction(recording, name) for name in ("load_torque", "temperature")] == [0.25, 0.0]
