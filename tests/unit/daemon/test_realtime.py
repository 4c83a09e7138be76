"""Clocks, and what is asked of the operating system: nothing here waits for time to pass."""

import ctypes
import errno
import json
import os
import resource
import subprocess
import sys

import pytest

from friction_hil.daemon import realtime
from friction_hil.daemon.realtime import RealClock, SteppedClock, punctuality


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
def test_real_time_is_never_early(spin_us):
    clock = RealClock(spin_us)
    assert clock.is_real
    for ahead_ns in (-1_000_000_000, 0, 1_000, 300_000):
        deadline = clock.now_ns() + ahead_ns
        clock.sleep_until(deadline)
        assert clock.now_ns() >= deadline


def test_after_the_deadline_there_is_no_time_to_get_ready():
    clock = RealClock(100)
    assert clock.doze_until(clock.now_ns() - 1) is False
    assert RealClock(0).doze_until(clock.now_ns() + 200_000) is False


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


def test_tests_do_not_lock_the_memory_of_pytest():
    with pytest.raises(AssertionError, match="process of its own"):
        ctypes.CDLL(None).mlockall(0)


class _Memory:
    """The C library's, as far as it locks memory."""

    def __init__(self, refusal):
        self._refusal = refusal
        self.munlockall = lambda: 0

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
