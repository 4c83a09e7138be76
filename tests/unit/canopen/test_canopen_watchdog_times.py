"""Times of watchdogs: longer than what the loop bridges, and not much longer."""

import pytest
from friction_hil_drivers.canopen.connect.watchdog_times import contradictions, watchdog_times
from hypothesis import given
from hypothesis import strategies as st

PERIODS = st.sampled_from([2.5e-4, 5e-4, 1e-3, 2e-3, 4e-3, 1e-2, 0.1])


def silence_ms(period_s, max_missed, between_ms):
    """The longest silence of a daemon that is well: between two frames, and all that it bridges in between."""
    return between_ms + 1e3 * period_s * max_missed


@given(PERIODS, st.integers(1, 40))
def test_by_default_nothing_trips_while_the_loop_bridges(period_s, max_missed):
    times = watchdog_times(period_s, max_missed)
    period_ms = 1e3 * period_s
    assert list(contradictions(period_s, max_missed, times)) == []
    assert times.timer_ms > silence_ms(period_s, max_missed, times.feed_cycles * period_ms)
    assert times.loss_ms > silence_ms(period_s, max_missed, 1e3 * times.beat_s)
    assert times.timer_ms <= times.loss_ms <= times.timer_ms + 3, "each acts as soon as the bridged periods allow"
    assert times.beat_s / period_s == pytest.approx(round(times.beat_s / period_s))
    assert times.timer_ms <= max(20.0, 1.4 * period_ms * (max_missed + 2))
    assert times.feed_cycles == 1 or times.feed_cycles * period_ms <= times.timer_ms / 4


@given(PERIODS, st.integers(1, 40), st.floats(0.002, 2.0), st.floats(0.005, 2.0))
def test_times_that_are_given_are_kept_or_refused(period_s, max_missed, watchdog_s, heartbeat_s):
    times = watchdog_times(period_s, max_missed, heartbeat_s, watchdog_s)
    assert (times.timer_ms, times.heartbeat_ms) == (round(1e3 * watchdog_s), round(1e3 * heartbeat_s))
    refused = {key for key, _ in contradictions(period_s, max_missed, times)}
    period_ms = 1e3 * period_s
    if times.timer_ms <= silence_ms(period_s, max_missed, times.feed_cycles * period_ms):
        assert "watchdog_s" in refused
    if times.loss_ms <= silence_ms(period_s, max_missed, times.heartbeat_ms):
        assert "heartbeat_s" in refused
    for key, text in contradictions(period_s, max_missed, times):
        least = float(text.split("at least ")[1].split(" s")[0])
        given_s = {"watchdog_s": watchdog_s, "heartbeat_s": heartbeat_s}
        again = watchdog_times(period_s, max_missed, **{**given_s, key: least})
        assert key not in {other for other, _ in contradictions(period_s, max_missed, again)}, text


def test_the_demo_stops_within_30_ms():
    times = watchdog_times(1e-3, 20)
    assert (times.timer_ms, times.feed_cycles, times.heartbeat_ms, times.loss_ms) == (25, 3, 20, 28)


@pytest.mark.parametrize(("key", "value"), [("watchdog_s", 0.02), ("heartbeat_s", 0.01)])
def test_a_contradiction_is_told_with_its_arithmetic(key, value):
    times = watchdog_times(1e-3, 20, **{key: value})
    [(found, text)] = contradictions(1e-3, 20, times)
    assert found == key
    assert "realtime.max_missed 20 + 2 cycles of 1 ms = 22 ms" in text
    assert {"watchdog_s": "20 ms after the last command", "heartbeat_s": "30 ms after the last heartbeat"}[key] in text


@given(PERIODS, st.integers(20, 2000))
def test_the_bridged_periods_that_a_drive_can_meet_have_a_time_that_it_takes(period_s, least_ms):
    times = watchdog_times(period_s, 1)
    if times.timer_ms >= least_ms:
        return
    again = watchdog_times(period_s, times.met_by(least_ms))
    assert again.timer_ms >= least_ms
    fewer = times.met_by(least_ms) - 1
    assert fewer < 1 or watchdog_times(period_s, fewer).timer_ms < least_ms
