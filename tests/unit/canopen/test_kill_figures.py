"""How long a drive has torque after its daemon was killed, 50 times, on two independent stacks, in simulated time.

A kill is a cut: from a frame drawn at random on, nothing of the master reaches the drive any more, SYNC included. The
drive is then left alone with its timers.
"""

import contextlib
import itertools
import queue
import random
import re
from abc import ABC, abstractmethod
from collections.abc import Callable
from pathlib import Path
from typing import Any

import can
import pytest
from friction_hil_drivers.canopen import CanopenDrives
from friction_hil_drivers.canopen.connect.eds import SIMULATED_SERVO

from friction_hil.config import from_dict
from friction_hil.drive import Command, DriveState, Feedback, Request
from tests.canopen_bench import NODE, Bench
from tests.contract.rig import SteppedTime
from tests.peers.durand_servo import DurandServo, Manners

KILLS = 50
PERIOD_NS, STEP_NS = 1_000_000, 250_000
PUSH = 0.1  # N m
TIMER_MS, MARGIN_MS = 30.0, 10.0
PATIENCE_MS = 1000.0

_channels = itertools.count()


class Stack(ABC):
    """One drive and its stack, without a bus and a clock."""

    @abstractmethod
    def give(self, message: can.Message) -> None:
        """Give the drive a frame."""

    @abstractmethod
    def advance_to(self, now_ns: int) -> None:
        """Let time pass."""

    @property
    @abstractmethod
    def torque(self) -> float:
        """Torque of the motor, N m."""

    @abstractmethod
    def read(self, index: int, subindex: int) -> int:
        """Return the content of an object."""


class Durand(Stack):
    """The servo on durand."""

    def __init__(self, answer: Callable[[int, bytes], None], *, has_timers: bool) -> None:
        self._servo = DurandServo(NODE, answer, Manners(timer_at_sync_only=True, has_rpdo_timers=has_timers))
        self._servo.od.write(0x1029, 1, 1)  # stays Operational after a loss, so that the next kill can follow

    def give(self, message: can.Message) -> None:
        self._servo.receive(message.arbitration_id, bytes(message.data), is_remote=message.is_remote_frame)

    def advance_to(self, now_ns: int) -> None:
        self._servo.advance_to(now_ns)

    @property
    def torque(self) -> float:
        return self._servo.servo.torque

    def read(self, index: int, subindex: int) -> int:
        return int(self._servo.od.read(index, subindex))


class Simulated(Stack):
    """The product's own simulated drive."""

    def __init__(self, answer: Callable[[int, bytes], None], folder: Path, *, has_timers: bool) -> None:
        eds = SIMULATED_SERVO if has_timers else _without_timers(folder)
        manners = {"timer_at_sync_only": True}
        self._bench = Bench(is_paced_by_sync=False, eds=eds, manners=manners)
        self._bench.write(0x1029, 1, "B", 1)
        self._answer = answer
        self._told = len(self._bench.sent)

    def give(self, message: can.Message) -> None:
        if message.is_remote_frame:
            self._bench.guard()
        else:
            self._bench.send(message.arbitration_id, bytes(message.data))
        self._tell()

    def advance_to(self, now_ns: int) -> None:
        self._bench.at(now_ns * 1e-6)
        self._tell()

    def _tell(self) -> None:
        for frame in self._bench.sent[self._told :]:
            self._answer(*frame)
        self._told = len(self._bench.sent)

    @property
    def torque(self) -> float:
        return self._bench.servo.torque_demand

    def read(self, index: int, subindex: int) -> int:
        return self._bench.read(index, subindex)


def _without_timers(folder: Path) -> Path:
    """Return an EDS whose RPDOs have no event timer."""
    text = re.sub(r"\[140\dsub5\]\n(?:.+\n)+", "", SIMULATED_SERVO.read_text())
    path = folder / "without_timers.eds"
    path.write_text(text)
    return path


class CutBus(can.BusABC):
    """A bus to one drive; after ``left`` frames nothing of the master gets through."""

    def __init__(self) -> None:
        super().__init__(channel="cut")
        self.left: int | None = None
        self.stack: Stack | None = None
        self._answers: queue.Queue[can.Message] = queue.Queue()

    def answer(self, can_id: int, data: bytes) -> None:
        self._answers.put(can.Message(arbitration_id=can_id, data=data, is_extended_id=False))

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        if self.left is not None:
            if self.left == 0:
                return
            self.left -= 1
        assert self.stack is not None
        self.stack.give(msg)

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        with contextlib.suppress(queue.Empty):
            return self._answers.get(timeout=timeout), True
        return None, True


class Master:
    """The driver, cycle by cycle, until it is killed."""

    def __init__(self, bus: CutBus) -> None:
        self.clock = SteppedTime()
        self.clock.is_real = True  # a cycle that is cut waits for no answer
        axis = {
            "driver": "canopen",
            "node": NODE,
            "mode": "cst",
            "limits": {"torque": 0.3, "velocity": 1000.0},
            "model": {"axis": "rotary", "friction": {"model": "coulomb", "parameters": {"coulomb": 0.02}}},
            "trajectory": {"kind": "none"},
        }
        where = {"interface": "virtual", "channel": f"kill-{next(_channels)}"}
        config = from_dict({"version": 1, "period_s": 1e-3, "bus": where, "axes": {"x": axis}}, "kill")
        self.bus = bus
        self.drives: Any = CanopenDrives(config, config.axes, self.clock, dry_run=False, bus=bus)
        self.feedback, self.command = [Feedback()], Command()

    def cycle(self, request: Request, torque: float = 0.0) -> DriveState:
        assert self.bus.stack is not None
        self.clock.ns += PERIOD_NS
        self.bus.stack.advance_to(self.clock.ns)
        self.drives.receive(self.feedback, self.clock.ns + PERIOD_NS)
        self.command.request, self.command.torque = request, torque
        self.drives.send([self.command])
        return self.feedback[0].state

    def until(self, request: Request, *states: DriveState) -> None:
        for _ in range(200):
            if self.cycle(request) in states:
                return
        raise AssertionError(f"{request.name}: {self.feedback[0]}")


def kill_times(bus: CutBus, master: Master, seed: int) -> list[float]:
    """Kill the master again and again; return the time from each of its last frames to zero torque, ms."""
    stack = bus.stack
    assert stack is not None
    draw = random.Random(seed)
    times = []
    for number in range(KILLS):
        master.until(Request.ENABLE, DriveState.OPERATION_ENABLED)
        push = PUSH * (-1.0) ** number
        for _ in range(draw.randrange(20, 60)):
            master.cycle(Request.ENABLE, push)
        assert abs(stack.torque - push) < 0.01
        bus.left = draw.randrange(1, 12)
        while bus.left:
            master.cycle(Request.ENABLE, push)
        start_ns = now_ns = master.clock.ns
        while stack.torque != 0.0:
            now_ns += STEP_NS
            stack.advance_to(now_ns)
            assert now_ns - start_ns < PATIENCE_MS * 1e6, f"kill {number}: it still has torque"
        times.append((now_ns - start_ns) * 1e-6)
        master.clock.ns = -(-now_ns // PERIOD_NS) * PERIOD_NS
        bus.left = None
        master.until(Request.RESET_FAULT, DriveState.SWITCH_ON_DISABLED)
    return times


@pytest.fixture(params=["durand", "simulated"])
def make(request: pytest.FixtureRequest, tmp_path: Path) -> Callable[..., tuple[CutBus, Master]]:
    def made(*, has_timers: bool) -> tuple[CutBus, Master]:
        bus = CutBus()
        if request.param == "durand":
            bus.stack = Durand(bus.answer, has_timers=has_timers)
        else:
            bus.stack = Simulated(bus.answer, tmp_path, has_timers=has_timers)
        master = Master(bus)
        master.drives.connect()
        master.drives.start()
        return bus, master

    return made


def test_the_rpdo_timer_takes_the_torque_within_30_ms(make: Callable[..., tuple[CutBus, Master]]) -> None:
    """Though the drive looks at the timers of synchronous RPDOs only when a SYNC comes."""
    times = kill_times(*make(has_timers=True), seed=1)
    assert len(times) == KILLS
    assert max(times) <= TIMER_MS, sorted(times)


def test_the_heartbeat_takes_the_torque_within_its_time_and_10_ms(make: Callable[..., tuple[CutBus, Master]]) -> None:
    """Where the drive's RPDOs have no timers."""
    bus, master = make(has_timers=False)
    times = kill_times(bus, master, seed=2)
    assert bus.stack is not None
    loss_ms = bus.stack.read(0x1016, 1) & 0xFFFF
    assert 0 < loss_ms <= 300
    assert len(times) == KILLS
    assert max(times) <= loss_ms + MARGIN_MS, sorted(times)
    assert max(times) > 0.5 * loss_ms, "it is the heartbeat that is measured"
