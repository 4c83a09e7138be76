"""The lock to another clock's SYNC: jitter, drift, missing SYNCs, jumps, two producers."""

import random
import re

import pytest

from friction_hil.drive.phase_lock import PhaseLock

PERIOD_S = 1e-3
T = 1_000_000


def stamps(count, *, ppm=0.0, jitter_ns=0, seed=1, missing=()):
    numbers = random.Random(seed)
    times = [round(k * T * (1.0 + ppm * 1e-6)) + numbers.randint(-jitter_ns, jitter_ns) for k in range(count)]
    return [time for k, time in enumerate(times) if k not in missing]


def locked(**options):
    """A lock on 100 SYNCs whose cycle 0 is the SYNC after them."""
    lock = PhaseLock(PERIOD_S)
    given = stamps(100, **options)
    assert lock.acquire(given) == ""
    lock.start(given[-1] + T // 2)
    return lock


@pytest.mark.parametrize("ppm", [-200.0, 0.0, 200.0])
@pytest.mark.parametrize("seed", range(5))
def test_it_stands_jitter_and_drift(ppm, seed):
    lock = locked(ppm=ppm, jitter_ns=100_000, seed=seed)
    numbers = random.Random(seed + 100)
    errors, deviations = [], []
    for cycle in range(5000):
        true = (100 + cycle) * T * (1.0 + ppm * 1e-6)
        errors.append(lock.sync_ns(cycle) - true)
        lock.take(cycle, round(true) + numbers.randint(-100_000, 100_000))
        deviations.append(lock.deviation_ppm)
    assert max(map(abs, errors)) < 80_000  # below the jitter itself
    assert abs(sum(errors[1000:]) / 4000) < 3_000
    assert lock.is_locked
    assert sum(deviations[1000:]) / 4000 == pytest.approx(ppm, abs=20.0)
    assert 40_000 < lock.jitter_ns < 80_000  # of a uniform distribution: 58 us


def test_a_drift_that_changes_leaves_no_lasting_error():
    lock = locked()
    true = 100.0 * T
    for cycle in range(3000):
        assert abs(lock.sync_ns(cycle) - true) < 100_000
        lock.take(cycle, round(true))
        true += T * (1.0 + 200e-6)
    assert abs(lock.sync_ns(3000) - true) < 100


def test_missing_syncs_are_bridged_and_they_and_late_wakeups_do_not_disturb_acquisition():
    lock = locked(ppm=150.0)
    for cycle in range(10):
        lock.take(cycle, round((100 + cycle) * T * (1.0 + 150e-6)))
    assert lock.sync_ns(60) == pytest.approx(160 * T * (1.0 + 150e-6), abs=1000)
    given = stamps(100, ppm=-120.0, missing=(17, 18, 60))
    given[30] += 700_000
    lock = PhaseLock(PERIOD_S)
    assert lock.acquire(given) == ""
    assert lock.deviation_ppm == pytest.approx(-120.0, abs=10.0)


def test_single_outliers_change_nothing_and_a_jump_of_the_other_clock_is_followed():
    lock = locked()
    lock.take(0, 100 * T)
    before = lock.sync_ns(10)
    assert not lock.take(1, 101 * T + 400_000)
    assert lock.sync_ns(10) == before
    for cycle in range(2, 20):
        lock.take(cycle, (100 + cycle) * T + 400_000)
    assert lock.sync_ns(20) == pytest.approx(120 * T + 400_000, abs=1)


@pytest.mark.parametrize(
    ("given", "reason"),
    [
        (stamps(9), "too few"),
        ([2 * one for one in stamps(50)], "every 2 ms and not every 1 ms"),
        (sorted([*stamps(50), *(one + 500_000 for one in stamps(50))]), "every 0.5 ms"),
        (sorted([*stamps(50), *(one + 200_000 for one in stamps(50))]), "."),
        (stamps(50, ppm=20_000), "every 1.02 ms and not every 1 ms"),
    ],
)
def test_what_gives_no_lock_is_said(given, reason):
    assert re.search(reason, PhaseLock(PERIOD_S).acquire(given))
