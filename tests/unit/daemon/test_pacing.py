"""Pacing of the loop in simulated time: deadlines, missed periods, lateness, warm caches, exchange times."""

import copy
import math

import numpy as np
import pytest

from friction_hil.daemon.axis import AxisLoop
from friction_hil.daemon.pacing import CacheWarmer, ExchangeTimes, Pacer
from friction_hil.daemon.realtime import SteppedClock
from friction_hil.daemon.row import AxisRow
from friction_hil.daemon.safety import LoopState
from friction_hil.drive import Command, Feedback
from friction_hil.motion.trajectory import PathTime
from tests.servo_drives import PERIOD_S, ServoDrives, configuration

MS = 1_000_000


class Sleeper(SteppedClock):
    """Oversleeps by the given times, one after the other, and notes all that it is asked for."""

    def __init__(self, *late_ns, has_time=True):
        super().__init__()
        self.late_ns, self.has_time, self.asked = list(late_ns), has_time, []

    def doze_until(self, deadline_ns):
        self.asked.append(("doze", deadline_ns))
        return self.has_time

    def sleep_until(self, deadline_ns):
        self.asked.append(("sleep", deadline_ns))
        super().sleep_until(deadline_ns + (self.late_ns.pop(0) if self.late_ns else 0))


def pacer(clock, warm=lambda cycle: None):
    one = Pacer(clock, PERIOD_S, warm)
    one.start()
    return one


def test_each_cycle_begins_a_period_after_the_last_and_caches_are_warmed_between_doze_and_sleep():
    clock = Sleeper()
    one = pacer(clock, lambda cycle: clock.asked.append(("warm", cycle)))
    assert [one.wait(cycle) for cycle in range(2)] == [0, 1]
    assert clock.asked == [
        *[("doze", MS), ("warm", 0), ("sleep", MS)],
        *[("doze", 2 * MS), ("warm", 1), ("sleep", 2 * MS)],
    ]
    assert one.end_ns(1) == 3 * MS


def test_without_time_before_the_deadline_nothing_is_warmed():
    warmed = []
    pacer(Sleeper(has_time=False), warmed.append).wait(0)
    assert warmed == []


@pytest.mark.parametrize(
    ("late_ns", "cycle", "late_us"), [(0, 4, 0.0), (999_999, 4, 999.999), (MS, 5, 0.0), (3 * MS + 200_000, 7, 200.0)]
)
def test_missed_periods_are_skipped_and_do_not_count_as_lateness(late_ns, cycle, late_us):
    one = pacer(Sleeper(late_ns))
    assert one.wait(4) == cycle
    assert (one.skipped, one.overslept_ns) == (cycle - 4, late_ns)
    assert one.late_us == pytest.approx(late_us)
    assert one.end_ns(cycle) - (one.overslept_ns + 5 * MS) == pytest.approx(MS - 1000 * late_us)


def test_percentiles_are_of_all_wake_ups():
    one = pacer(Sleeper(*[1000 * us for us in range(100)]))
    for cycle in range(100):
        one.wait(cycle)
    assert [one.late_percentile_us(fraction) for fraction in (0.5, 0.99)] == [49.0, 98.0]


@pytest.mark.parametrize(("times_us", "is_too_long"), [([900, 950, 5000], False), ([1400, 1500, 10], True)])
def test_an_exchange_longer_than_the_period_is_warned_of_by_its_median(times_us, is_too_long):
    one = ExchangeTimes(PERIOD_S)
    for time_us in times_us:
        one.add(time_us)
    text = one.warning()
    assert (text is not None) == is_too_long
    if text is not None:
        assert text.startswith("feedback and command take 1400 µs, more than the period of 1000 µs")


def made():
    config = configuration()
    drives = ServoDrives(config)
    axis = AxisLoop("x", config.axes["x"], drives.connect()[0], PERIOD_S, PathTime(0.25))
    return drives, axis, AxisRow(np.full(axis.row_width, math.nan), [])


def test_a_position_after_missed_periods_is_no_jump():
    """At two thirds of the velocity limit an axis goes further in four periods than it may in one."""
    _, axis, row = made()
    feedback, velocity = Feedback(is_fresh=True), 20.0
    for cycle in (0, 1, 2, 6, 7, 11):
        feedback.position, feedback.velocity = velocity * PERIOD_S * cycle, velocity
        assert axis.update(cycle, LoopState.IDLE, math.nan, feedback, Command(), row).fault is None
    assert axis.gaps.stale == 0


def test_warming_changes_nothing_of_the_real_axis():
    drives, axis, row = made()
    before = copy.deepcopy((axis.compensator.state, axis.supervisor.position, axis.gaps.stale))
    warmer = CacheWarmer(drives, axis, row)
    assert [warmer.warm(cycle) for cycle in range(5)] == [None] * 5
    np.testing.assert_equal((axis.compensator.state, axis.supervisor.position, axis.gaps.stale), before)
    assert np.isnan(row.values).all()
    assert drives.sent == [[]]


def test_the_first_error_in_warming_is_kept():
    drives, axis, row = made()
    drives.warm_caches = lambda: 1 / 0
    warmer = CacheWarmer(drives, axis, row)
    assert warmer.warm(0) == warmer.error == "ZeroDivisionError: division by zero"
