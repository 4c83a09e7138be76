"""How long a drive has torque after its daemon was killed, 50 times, on an independent stack, in simulated time.

A kill is a cut: from a frame drawn at random on, nothing of the master reaches the drive any more, SYNC included. The
drive is then left alone with its timers. test_canopen_watchdogs.py has the same of the simulated drive.
"""

import random
from types import SimpleNamespace

import pytest

from friction_hil.drive import Command, DriveState, Request
from tests.canopen_bench import NODE, BenchBus, Driven, kill
from tests.contract.rig import SteppedTime
from tests.peers.durand_servo import DurandServo, Manners

KILLS = 50
PERIOD_NS, STEP_NS = 1_000_000, 250_000
PUSH = 0.1  # N m
TIMER_MS, MARGIN_MS = 30.0, 10.0
PATIENCE_MS = 1000.0


class CutBus(BenchBus):
    """A bus to one drive; after ``left`` frames nothing of the master gets through."""

    def __init__(self, *, has_timers):
        super().__init__(SimpleNamespace())
        self.left = None
        manners = Manners(timer_at_sync_only=True, has_rpdo_timers=has_timers)
        self.drive = DurandServo(NODE, self.hear, manners)
        self.drive.od.write(0x1029, 1, 1)  # stays Operational after a loss, so that the next kill can follow

    @property
    def torque(self):
        return self.drive.servo.torque

    def send(self, msg, timeout=None):
        if self.left is not None:
            if self.left == 0:
                return
            self.left -= 1
        self.drive.receive(msg.arbitration_id, bytes(msg.data), is_remote=msg.is_remote_frame)


class Master(Driven):
    """The driver, cycle by cycle, until it is killed."""

    def __init__(self, bus):
        limits = {"torque": 0.3, "velocity": 1000.0}
        clock = SteppedTime()
        clock.is_real = True  # a cycle that is cut waits for no answer
        super().__init__("cst", bus=bus, clock=clock, controller=None, limits=limits, trajectory={"kind": "none"})

    def close(self):
        kill(self.drives)  # its locks
        self.bus.shutdown()

    def cycle(self, request, torque=0.0):
        self.clock.ns += PERIOD_NS
        self.bus.drive.advance_to(self.clock.ns)
        self.drives.receive([self.feedback], self.clock.ns + PERIOD_NS)
        self.drives.send([Command(request, torque=torque)])
        return self.feedback.state

    def until(self, request, state):
        for _ in range(200):
            if self.cycle(request) is state:
                return
        raise AssertionError(f"{request.name}: {self.feedback}")

    def kill_times(self, seed):
        """Kill it again and again; return the time from each of its last frames to zero torque, ms."""
        draw, bus, times = random.Random(seed), self.bus, []
        for number in range(KILLS):
            self.until(Request.ENABLE, DriveState.OPERATION_ENABLED)
            push = PUSH * (-1.0) ** number
            for _ in range(draw.randrange(20, 60)):
                self.cycle(Request.ENABLE, push)
            assert abs(bus.torque - push) < 0.01
            bus.left = draw.randrange(1, 12)
            while bus.left:
                self.cycle(Request.ENABLE, push)
            start_ns = now_ns = self.clock.ns
            while bus.torque != 0.0:
                now_ns += STEP_NS
                bus.drive.advance_to(now_ns)
                assert now_ns - start_ns < PATIENCE_MS * 1e6, f"kill {number}: it still has torque"
            times.append((now_ns - start_ns) * 1e-6)
            self.clock.ns = -(-now_ns // PERIOD_NS) * PERIOD_NS
            bus.left = None
            self.until(Request.RESET_FAULT, DriveState.SWITCH_ON_DISABLED)
        return times


@pytest.mark.parametrize("has_timers", [True, False], ids=["RPDO timer", "heartbeat"])
def test_a_watchdog_takes_the_torque_in_its_time(has_timers):
    """The RPDO timer within 30 ms, though the drive looks at those of synchronous RPDOs only when a SYNC comes."""
    bus = CutBus(has_timers=has_timers)
    with Master(bus) as master:
        times = master.kill_times(seed=1 if has_timers else 2)
    loss_ms = int(bus.drive.od.read(0x1016, 1)) & 0xFFFF
    assert max(times) <= (TIMER_MS if has_timers else loss_ms + MARGIN_MS), sorted(times)
    if not has_timers:
        assert 0 < loss_ms <= 300
        assert max(times) > 0.5 * loss_ms, "it is the heartbeat that is measured"
