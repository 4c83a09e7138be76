"""Clocks, pacing by them, and what is asked of the operating system: nothing here waits for time to pass."""

import copy
import ctypes
import errno
import json
import math
import os
import resource
import subprocess
import sys

import numpy as np
import pytest

from friction_hil.daemon import realtime
from friction_hil.daemon.axis import AxisLoop
from friction_hil.daemon.pacing import CacheWarmer, ExchangeTimes, Pacer
from friction_hil.daemon.realtime import RealClock, SteppedClock, punctuality
from friction_hil.daemon.row import AxisRow
from friction_hil.daemon.safety import LoopState
from friction_hil.drive import Command, Feedback
from friction_hil.motion.trajectory import PathTime
from tests.servo_drives import PERIOD_S, ServoDrives, configuration


def test_simulated_time_passes_only_in_sleep_and_never_backward():
    clock = SteppedClock()
    assert not clock.is_real
    assert clock.now_ns() == clock.now_ns() == 0
    assert clock.doze_until(10**9) is False
    assert clock.now_ns() == 0
    clock.sleep_until(1_000_000)
    assert clock.now_ns() == 1_000_000
    clock.sleep_until(500_000)
    assert clock.now_ns() == 1_000_000


@pytest.mark.parametrize("spin_us", [0, 100])
def test_real_time_is_never_early_and_after_the_deadline_there_is_no_time_to_get_ready(spin_us):
    clock = RealClock(spin_us)
    assert clock.is_real
    for ahead_ns in (-1_000_000_000, 0, 1_000, 300_000):
        deadline = clock.now_ns() + ahead_ns
        clock.sleep_until(deadline)
        assert clock.now_ns() >= deadline
    assert clock.doze_until(clock.now_ns() + (-1 if spin_us else 200_000)) is False


# Locks the memory of a process of its own: this one has gigabytes, and what is locked once stays in memory.
PUNCTUAL = """
import gc, json, os, sys
from friction_hil.daemon.realtime import punctuality

def status():
    with open("/proc/self/status") as file:
        locked = next(line.split()[1] for line in file if line.startswith("VmLck"))
    with os.scandir("/proc/self/fd") as descriptors:
        opened = [os.readlink(each) for each in descriptors if os.path.lexists(each)]
    return {
        "scheduler": os.sched_getscheduler(0),
        "priority": os.sched_getparam(0).sched_priority,
        "is_locked": locked != "0",
        "is_latency_held": "/dev/cpu_dma_latency" in opened,
        "is_collecting": gc.isenabled(),
        "is_frozen": gc.get_freeze_count() > 0,
    }

priority, way = int(sys.argv[1]), sys.argv[2]
if way == "collector off":
    gc.disable()
found = {"before": status()}
try:
    with punctuality(priority) as findings:
        found["inside"] = status()
        if way == "error":
            raise RuntimeError
except RuntimeError:
    pass
found |= {"after": status(), "findings": [[each.check, each.result, each.detail, each.fix] for each in findings]}
print(json.dumps(found))
"""


def punctual(priority, way=""):
    """What punctuality changes in a process, as the kernel and Python tell it, and what it reports."""
    command = [sys.executable, "-c", PUNCTUAL, str(priority), way]
    return json.loads(subprocess.run(command, capture_output=True, check=True, timeout=60).stdout)


def test_nothing_is_asked_for_at_ordinary_priority():
    found = punctual(0)
    assert found["findings"] == []
    assert found["inside"] == found["before"] == found["after"]


@pytest.mark.parametrize("way", ["", "error", "collector off"])
def test_everything_is_granted_or_reported_and_given_back(way):
    found = punctual(1, way)
    inside, findings = found["inside"], found["findings"]
    assert found["after"] == found["before"]
    assert found["before"]["is_collecting"] == (way != "collector off")
    assert [check for check, *_ in findings] == ["memory", "priority", "processor sleep"]
    assert all((result == "pass") == (fix == "") for _, result, _, fix in findings)
    text = "\n".join(detail for _, result, detail, _ in findings if result != "pass")
    scheduler = inside["scheduler"] & ~os.SCHED_RESET_ON_FORK
    assert (scheduler == os.SCHED_FIFO and inside["priority"] == 1) != ("no SCHED_FIFO priority 1" in text)
    assert inside["is_locked"] != ("memory is not locked" in text)
    assert inside["is_latency_held"] != ("/dev/cpu_dma_latency cannot be held" in text)
    assert inside["is_frozen"]
    assert not inside["is_collecting"]


class _Memory:
    """The C library's, as far as it locks memory."""

    def __init__(self, refusal):
        self._refusal, self.munlockall = refusal, lambda: 0

    def mlockall(self, flags):
        ctypes.set_errno(self._refusal)
        return -1 if self._refusal else 0


@pytest.mark.deep
@pytest.mark.parametrize(
    ("refusal", "limit", "is_capable", "result", "detail"),
    [
        (errno.ENOMEM, 8e6, False, "warn", "memory is not locked (Cannot allocate memory)"),
        (0, 8e6, False, "warn", "memory is locked, but the limit of 8 MB leaves little room"),
        (0, 8e6, True, "pass", "memory is locked"),
        (0, resource.RLIM_INFINITY, False, "pass", "memory is locked"),
    ],
)
def test_memory_that_may_run_out_is_told(monkeypatch, refusal, limit, is_capable, result, detail):
    """Locked memory within a limit is worse than it looks: what the loop asks for beyond it, it does not get."""
    monkeypatch.setattr(realtime.ctypes, "CDLL", lambda *_, **__: _Memory(refusal))
    monkeypatch.setattr(resource, "getrlimit", lambda which: (limit, limit))
    status = f"Name:\tpython\nCapInh:\t{0:016x}\nCapEff:\t{is_capable << 14:016x}\n"
    monkeypatch.setattr(realtime, "system_text", lambda path: status)
    with punctuality(1) as findings:
        found = next(each for each in findings if each.check == "memory")
    assert found.result == result
    assert found.detail.startswith(detail)
    assert ("memlock" in found.fix) == (result == "warn")


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
    first = [("doze", MS), ("warm", 0), ("sleep", MS)]
    assert clock.asked == [*first, ("doze", 2 * MS), ("warm", 1), ("sleep", 2 * MS)]
    assert one.end_ns(1) == 3 * MS
    warmed = []
    pacer(Sleeper(has_time=False), warmed.append).wait(0)
    assert warmed == [], "there is no time before the deadline"


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
    assert text is None or ("1400 µs" in text and "1000 µs" in text)


@pytest.fixture
def parts():
    """Drives, an axis of theirs and its row."""
    config = configuration()
    drives = ServoDrives(config)
    axis = AxisLoop("x", config.axes["x"], drives.connect()[0], PERIOD_S, PathTime(0.25))
    return drives, axis, AxisRow(np.full(axis.row_width, math.nan), [])


def test_a_position_after_missed_periods_is_no_jump(parts):
    """At two thirds of the velocity limit an axis goes further in four periods than it may in one."""
    _, axis, row = parts
    for cycle in (0, 1, 2, 6, 7, 11):
        feedback = Feedback(20.0 * PERIOD_S * cycle, 20.0, is_fresh=True)
        assert axis.update(cycle, LoopState.IDLE, math.nan, feedback, Command(), row).fault is None
    assert axis.gaps.stale == 0


def test_warming_changes_nothing_of_the_real_axis_and_its_first_error_is_kept(parts):
    drives, axis, row = parts
    before = copy.deepcopy((axis.compensator.state, axis.supervisor.position, axis.gaps.stale))
    warmer = CacheWarmer(*parts)
    assert [warmer.warm(cycle) for cycle in range(5)] == [None] * 5
    np.testing.assert_equal((axis.compensator.state, axis.supervisor.position, axis.gaps.stale), before)
    assert np.isnan(row.values).all()
    assert drives.sent == [[]]
    drives.warm_caches = lambda: 1 / 0
    warmer = CacheWarmer(*parts)
    assert warmer.warm(0) == warmer.error == "ZeroDivisionError: division by zero"
