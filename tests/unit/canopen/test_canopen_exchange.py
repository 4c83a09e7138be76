"""A cycle on the bus when something is wrong with it: frames that are not sent, late, lost, or strange.

Time is what the tests say; the exchange takes it for real.
"""

import errno
import sys
from collections import Counter
from pathlib import Path

import pytest

from friction_hil.drive import Command, DriveState, Request
from tests.canopen_bench import NODE, BenchBus, Driven
from tests.contract.rig import SteppedTime

MS = 1_000_000
RPDO1 = 0x205


class Time(SteppedTime):
    """Real for the driver; each look at it takes 10 us, so that nothing waits for ever."""

    is_real = True

    def __init__(self):
        super().__init__()
        self.tick_ns = 10_000


class Between(BenchBus):
    """A man in the middle: TPDOs come so many cycles late, or not at all; sending may fail."""

    def __init__(self):
        super().__init__()
        self.delay_cycles = self.cycle = 0
        self.is_full = lambda can_id: False
        self.held = []  # (cycle in which it is due, frame)
        self.clock = None

    def send(self, msg, timeout=None):
        if self.is_full(msg.arbitration_id):
            raise OSError(errno.ENOBUFS, "No buffer space available")
        super().send(msg, timeout)

    def answers_of(self, can_id, data):
        answers = super().answers_of(can_id, data)
        if not self.delay_cycles:
            return answers
        late = [frame for frame in answers if frame[0] & 0x780 in (0x180, 0x280)]
        self.held += [(self.cycle + self.delay_cycles, frame) for frame in late]
        return [frame for frame in answers if frame not in late]

    def release(self):
        """What is due comes a little after SYNC."""
        due = [frame for cycle, frame in self.held if cycle <= self.cycle]
        self.held = [one for one in self.held if one[0] > self.cycle]
        for frame in due:
            self.hear(*frame)

    def recv(self, timeout=None):
        if self.clock is None or self.answers.qsize():  # connecting, or something is there
            return super().recv(timeout)
        if timeout:  # the driver waits: time for what is late
            self.release()
        if self.answers.empty():
            self.clock.ns += round(timeout * 1e9)
            return None
        return super().recv(timeout)


class Enabled(Driven):
    """A drive in CST, enabled."""

    def __init__(self):
        super().__init__("cst", bus=Between(), clock=Time())
        self.start()
        self.bus.clock = self.clock
        self.cycles(20, Request.ENABLE)
        assert self.feedback.state is DriveState.OPERATION_ENABLED

    def receive(self):
        self.bus.cycle += 1
        self.clock.ns = (self.clock.ns // MS + 1) * MS
        self.drives.receive([self.feedback], self.clock.ns + MS)
        self.feedback.notices.clear()
        return self.feedback

    def send(self, request):
        self.drives.send([Command(request)])

    def cycles(self, count, request):
        """Return for how many cycles the feedback was fresh, and the reasons why it was not."""
        heard = []
        for _ in range(count):
            feedback = self.receive()
            heard.append((feedback.is_fresh, feedback.missing))
            self.send(request)
        return sum(is_fresh for is_fresh, _ in heard), [missing for _, missing in heard if missing]

    def sent(self, can_id):
        return [data for each, data in self.bus.sent if each == can_id]

    def close(self):
        self.bus.delay_cycles, self.bus.is_full, self.bus.clock = 0, lambda can_id: False, None
        super().close()


@pytest.fixture
def driven():
    one = Enabled()
    yield one
    one.close()


def test_a_full_queue_is_a_missed_exchange_and_then_a_fault(driven):
    driven.bus.is_full = lambda can_id: True
    for _ in range(3):
        fresh, missing = driven.cycles(5, Request.ENABLE)
        assert fresh == 0
        assert missing[0].startswith("SYNC was not sent: the bus virtual")
        driven.bus.is_full = lambda can_id: False
        fresh, _ = driven.cycles(5, Request.ENABLE)
        assert fresh >= 4
        assert driven.feedback.message == ""
        driven.bus.is_full = lambda can_id: True
    driven.cycles(10, Request.ENABLE)
    driven.bus.is_full = lambda can_id: False
    driven.cycles(2, Request.ENABLE)
    driven.bus.is_full = lambda can_id: can_id == RPDO1  # SYNC and feedback come, commands do not
    driven.cycles(12, Request.ENABLE)
    assert "cannot send" in driven.feedback.message
    assert driven.feedback.message.endswith("[FH-202]")
    driven.bus.is_full = lambda can_id: False
    driven.cycles(3, Request.QUICK_STOP)  # the usual stop
    assert driven.sent(RPDO1)[-1][0] == 0x02


@pytest.mark.parametrize("delay", [1, 2, 5, 9])
def test_feedback_that_comes_whole_cycles_late_is_never_taken_for_fresh_for_long(driven, delay):
    driven.cycles(60, Request.ENABLE)
    driven.bus.delay_cycles = delay
    fresh, missing = driven.cycles(60, Request.ENABLE)
    assert fresh <= 3
    # one less while a cycle without SYNC is on its way
    assert missing[-1] in [f"the TPDOs of node 5 answer SYNC {lag} cycles late [FH-235]" for lag in (delay, delay - 1)]
    driven.bus.delay_cycles = 0
    driven.bus.held = [(0, frame) for _, frame in driven.bus.held]  # at once: the last one counts
    fresh, missing = driven.cycles(60, Request.ENABLE)
    assert fresh >= 57
    assert driven.feedback.missing == ""


def test_a_node_that_another_master_took_out_of_operational_is_brought_back_and_stopped(driven):
    driven.bench.write(0x6007, 0, "h", 0)  # the drive itself does nothing about it
    driven.cycles(5, Request.ENABLE)
    for frame in [*driven.bench.nmt(0x80), (0x700 + NODE, b"\x7f")]:
        driven.bus.hear(*frame)
    driven.receive()
    assert not driven.feedback.is_reachable
    assert "left Operational: it is pre-operational" in driven.feedback.message
    rpdos = len(driven.sent(RPDO1))
    driven.send(Request.QUICK_STOP)
    assert len(driven.sent(RPDO1)) == rpdos
    assert driven.bus.sent[-2:] == [(0, bytes([1, NODE])), (0x605, bytes.fromhex("2b40600002000000"))]
    assert driven.bench.statusword & 0x6F == 0x07, "quick stop active, by SDO"
    driven.cycles(3, Request.QUICK_STOP)
    assert driven.feedback.is_reachable
    assert driven.feedback.state is DriveState.QUICK_STOP_ACTIVE
    driven.cycles(5, Request.DISABLE)
    assert driven.feedback.state is DriveState.SWITCH_ON_DISABLED


def test_an_ordinary_cycle_makes_few_calls(driven):
    """Each is some 50 ns of a period; what only a disturbance needs must not be computed in every cycle."""
    folders = {"cycle", "sdo", "stop", "connect", "cia402"}  # without those of the simulated drive
    calls, cycles = Counter(), 100

    def count(frame, event, argument):
        path = Path(frame.f_code.co_filename)
        if event == "call" and path.parent.name in folders:
            calls[f"{path.stem}.{frame.f_code.co_name}"] += 1

    driven.cycles(60, Request.ENABLE)  # long enough for a probe to be due
    sys.setprofile(count)
    try:
        fresh, _ = driven.cycles(cycles, Request.ENABLE)
    finally:
        sys.setprofile(None)
    assert fresh == cycles
    assert calls.total() <= 22 * cycles, calls.most_common()
