"""Processor time of the cyclic exchange with one CANopen axis, without bus and drive.

The loop, driver and compensator of the daemon run the first axis of the demo at its period, against a simulated drive
in this process. The drive computes while the loop sleeps; its frames are ready when the loop sends SYNC. The exchange
consists of SYNC, TPDOs and decoding (receive), model and compensator (step), encoding and RPDO (send). The whole cycle
also includes set-point, supervision and the row of the recording.
"""

import os
import time
from collections import deque
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from friction_hil_drivers.canopen import CanopenDrives
from friction_hil_drivers.canopen.simulated import SimulatedCanopenDrives
from friction_hil_drivers.canopen.wire import cia301
from friction_hil_drivers.canopen.wire.cia301 import Frame
from friction_hil_drivers.canopen.wire.frames import FrameBus

from friction_hil import config
from friction_hil.compensator import Compensator
from friction_hil.daemon.axis import AxisLoop
from friction_hil.daemon.control.journal import JournalReader, make_journal
from friction_hil.daemon.loop import Loop
from friction_hil.daemon.realtime import RealClock, punctuality
from friction_hil.daemon.run import LoopSettings
from friction_hil.daemon.safety import LoopState
from friction_hil.daemon.stop import StopRequest
from friction_hil.drive import Command, DriveState, Feedback
from friction_hil.drive.finding import complaints
from friction_hil.errors import FrictionHilError
from friction_hil.motion.trajectory import PathTime
from friction_hil.numerics.jit import Array
from friction_hil.recordings import columns
from tools.benchmarks.loop.daemon import configured
from tools.benchmarks.report import Row, against, note, percentile

if TYPE_CHECKING:
    import can

PERIOD_S, DURATION_S = 1e-3, 10.0
TARGET_US = 60.0
NEWS_TARGET_US = 1.0
LOOKS = 300
STATE, EXCHANGE = columns.NAMES.index("state"), columns.NAMES.index("exchange_us")

_MAX_MISSED = 2000  # periods: a busy machine is no fault here


class MemoryBus:
    """One end of a bus in memory, with the interface of python-can; frames arrive at the other end."""

    channel_info = "bus of the benchmark"

    def __init__(self) -> None:
        self.received: deque[can.Message] = deque()
        self.other = self

    def send(self, message: "can.Message") -> None:
        """Pass a frame to the other end."""
        self.other.received.append(message)

    def recv(self, timeout: float | None = None) -> "can.Message | None":
        """Return the next frame, or None."""
        if not self.received and timeout:
            end = time.monotonic() + timeout
            while not self.received and time.monotonic() < end:
                time.sleep(1e-4)
        return self.received.popleft() if self.received else None

    def fileno(self) -> int:
        """Return -1: there is no descriptor."""
        return -1

    def shutdown(self) -> None:
        """Do nothing: there is nothing to close."""


class LoopBus(MemoryBus):
    """The loop's end during commissioning: the drives reply to each frame before `send` returns."""

    def __init__(self, configuration: config.Configuration) -> None:
        super().__init__()
        self.other = MemoryBus()
        self.other.other = self
        drives_bus: Any = self.other
        self._drives = SimulatedCanopenDrives(configuration, configuration.axes, pace="sync", bus=drives_bus)
        self._drives.open()

    def send(self, message: "can.Message") -> None:
        """Pass a frame to the drives and let them reply."""
        super().send(message)
        self._drives.run(lambda: not self.other.received)


class ReadyFrames(FrameBus):
    """The loop's end in the cyclic phase: the replies to SYNC were computed before, and arrive at once."""

    def __init__(self, bus: LoopBus) -> None:
        python_can: Any = bus
        super().__init__(python_can, bus.channel_info)
        self._loop_bus = bus
        self._sent: list[Frame] = []
        self._replies: list[Frame] = []
        self._received: deque[Frame] = deque()

    def send(self, can_id: int, data: bytes | bytearray) -> None:
        """Keep a frame for the drives."""
        self._sent.append((can_id, data))  # type: ignore[arg-type]    # it is not changed before it is used
        if can_id == cia301.SYNC_ID:
            self._received.extend(self._replies)
            self._replies.clear()

    def receive(self, timeout: float) -> Frame | None:
        """Return the next frame, or None without waiting."""
        return self._received.popleft() if self._received else None

    def work(self) -> None:
        """Pass the sent frames to the drives, and keep their replies."""
        for frame in self._sent:
            super().send(*frame)
        self._sent.clear()
        while (reply := super().receive(0.0)) is not None:
            self._replies.append(reply)


class SharedClock(RealClock):
    """The loop's clock; the drives work while the loop sleeps."""

    def __init__(self, spin_us: int, frames: ReadyFrames) -> None:
        super().__init__(spin_us)
        self._frames = frames

    def doze_until(self, deadline_ns: int) -> bool:
        """Let the drives work, then sleep until shortly before the deadline."""
        self._frames.work()
        return super().doze_until(deadline_ns)


class TimedDrives(CanopenDrives):
    """The driver, with the time of its part of a cycle.

    Attributes
    ----------
    commissioning_bus : FrameBus or None
        Bus whose drives reply at once, over which they are left.
    """

    receive_ns = send_ns = 0
    commissioning_bus: FrameBus | None = None

    def close(self) -> list[DriveState]:
        """Leave the drives as outside of the cyclic phase; see `CanopenDrives.close`."""
        if self.commissioning_bus is not None:
            self._bus, self.commissioning_bus = self.commissioning_bus, None
        return super().close()

    def receive(self, feedback: Sequence[Feedback], end_ns: int) -> None:
        """Send SYNC; receive and decode the TPDOs."""
        began = time.perf_counter_ns()
        super().receive(feedback, end_ns)
        self.receive_ns = time.perf_counter_ns() - began

    def send(self, commands: Sequence[Command]) -> None:
        """Encode and send the RPDO."""
        began = time.perf_counter_ns()
        super().send(commands)
        self.send_ns = time.perf_counter_ns() - began


class TimedCompensator(Compensator):
    """The compensator, with the time of a step."""

    __slots__ = ("step_ns",)

    def step(self, *inputs: float) -> float:
        """Compute one cycle."""
        began = time.perf_counter_ns()
        torque = super().step(*inputs)  # type: ignore[arg-type]
        self.step_ns = time.perf_counter_ns() - began
        return torque


class CycleTimes:
    """Sink of the loop that keeps the times of the cycles in motion, us."""

    def __init__(self, drives: TimedDrives, compensator: TimedCompensator) -> None:
        self._drives = drives
        self._compensator = compensator
        self.times: dict[str, list[float]] = {"exchange": [], "receive": [], "step": [], "send": [], "whole cycle": []}

    def push(self, row: Array) -> None:
        """Keep the times of a row."""
        if row[STATE] != LoopState.RUNNING:
            return
        parts = (self._drives.receive_ns / 1e3, self._compensator.step_ns / 1e3, self._drives.send_ns / 1e3)
        for series, taken in zip(self.times.values(), (sum(parts), *parts, float(row[EXCHANGE])), strict=True):
            series.append(taken)

    def event(self, cycle: int, name: str, text: str) -> None:
        """Ignore an event."""


def run() -> list[Row]:
    """Run the loop for 10 s.

    Raises
    ------
    FrictionHilError
        The loop ended with a fault.
    """
    given = configured(1, PERIOD_S, config.Realtime().spin_us)
    given["bus"] = {"interface": "virtual", "channel": f"benchmark {os.getpid()}"}
    configuration = config.from_dict(given, "benchmark")
    bus = LoopBus(configuration)
    frames = ReadyFrames(bus)
    clock = SharedClock(configuration.realtime.spin_us, frames)
    drives = TimedDrives(configuration, configuration.axes, clock, dry_run=False, bus=frames.bus)
    (facts,) = drives.connect()
    drives.commissioning_bus, drives._bus = drives._bus, frames  # from here on only the cycle is measured
    drives._exchange = drives._make_exchange(frames)
    path_time = PathTime(1.0)
    axis = AxisLoop(facts.name, configuration.axes[facts.name], facts, configuration.period_s, path_time)
    axis.compensator = compensator = TimedCompensator(axis.compensator.model, axis.compensator.settings)
    samples = CycleTimes(drives, compensator)
    settings = LoopSettings(configuration.period_s, duration_s=DURATION_S, max_missed=_MAX_MISSED)
    note(f"one axis for {DURATION_S:g} s")
    with punctuality(configuration.realtime.priority) as findings:
        result = Loop(drives, [axis], path_time, clock, samples, settings, StopRequest()).run()
    for line in complaints(findings):
        note(line)
    if result.faults:
        raise FrictionHilError("the loop ended with a fault: " + "; ".join(result.faults))
    (_, exchange), *others = ((name, sorted(series)) for name, series in samples.times.items())
    return [
        against(TARGET_US, "exchange p50 (target)", "us", percentile(exchange, 0.5)),
        Row("exchange p99", percentile(exchange, 0.99), "us"),
        *(Row(f"{name} p50", percentile(series, 0.5), "us") for name, series in others),
        against(NEWS_TARGET_US, "journal without news p50 (target)", "us", percentile(_looks_us(), 0.5)),
    ]


def _looks_us() -> list[float]:
    """Return the times of a look into the journal when nothing has changed, us, ascending; each a mean of many."""
    journal, looks = JournalReader(make_journal()), range(LOOKS)
    found = []
    for _ in range(LOOKS):
        began = time.perf_counter_ns()
        for _ in looks:
            if journal.has_news:
                raise AssertionError("nobody has written")
        found.append((time.perf_counter_ns() - began) / (1e3 * LOOKS))
    os.close(journal.descriptor)
    return sorted(found)
