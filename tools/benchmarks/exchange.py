"""What a cycle costs for one CANopen axis, with the bus and the drive's own time left out.

The real loop, driver and compensator run the first axis of the shipped demo at its period, against a simulated
drive in this process. That drive works while the loop sleeps; what it sends lies ready when the loop sends SYNC.
Measured is what the loop records as ``exchange_us``: SYNC, TPDOs, decoding, compensator, encoding, RPDO.
"""

import time
from collections import deque
from pathlib import Path
from typing import TYPE_CHECKING, Any

from friction_hil_drivers.canopen import CanopenDrives, objects
from friction_hil_drivers.canopen.simulated import SimulatedCanopenDrives

from friction_hil import config
from friction_hil.axis import AxisLoop
from friction_hil.errors import FrictionHilError
from friction_hil.jit import Array
from friction_hil.loop import Loop, LoopSettings, StopRequest
from friction_hil.realtime import RealClock, punctuality
from friction_hil.recordings import columns
from friction_hil.safety import LoopState
from friction_hil.servo.trajectory import PathTime
from tools.benchmarks.report import Row, against, note, percentile

if TYPE_CHECKING:
    import can

DEMO = Path(__file__).parents[2] / "config/demo.yaml"
DURATION_S = 10.0
TARGET_US = 60.0
STATE, EXCHANGE = columns.NAMES.index("state"), columns.NAMES.index("exchange_us")


class Bus:
    """One end of a bus without a wire; what is sent here is received at the other end."""

    channel_info = "bus of the benchmark"

    def __init__(self) -> None:
        self.received: deque[can.Message] = deque()
        self.other = self

    def send(self, message: "can.Message") -> None:
        """Hand a frame over."""
        self.other.received.append(message)

    def recv(self, timeout: float | None = None) -> "can.Message | None":
        """Take the next frame."""
        if not self.received and timeout:
            end = time.monotonic() + timeout
            while not self.received and time.monotonic() < end:
                time.sleep(1e-4)
        return self.received.popleft() if self.received else None

    def shutdown(self) -> None:
        """Nothing to close."""


class LoopBus(Bus):
    """The loop's end: the drives answer each SYNC at once, with what they have worked out before."""

    def __init__(self, configuration: config.Configuration) -> None:
        super().__init__()
        self._drives_bus = self.other = Bus()
        self._drives_bus.other = self._answers = Bus()
        any_bus: Any = self._drives_bus
        self._drives = SimulatedCanopenDrives(configuration, configuration.axes, pace="sync", bus=any_bus)
        self._drives.open()

    def send(self, message: "can.Message") -> None:
        """Hand a frame over; SDO and NMT are answered here and now."""
        super().send(message)
        identifier = message.arbitration_id
        if identifier == objects.NMT_ID or objects.SDO_REQUEST_BASE <= identifier < objects.HEARTBEAT_BASE:
            self.work()
            self._deliver()
        elif identifier == objects.SYNC_ID:
            self._deliver()

    def work(self) -> None:
        """Let the drives take all frames that were sent to them."""
        self._drives.run(lambda: not self._drives_bus.received)

    def _deliver(self) -> None:
        self.received.extend(self._answers.received)
        self._answers.received.clear()


class Clock(RealClock):
    """The loop's clock; while the loop sleeps, the drives work."""

    def __init__(self, spin_us: int, bus: LoopBus) -> None:
        super().__init__(spin_us)
        self._bus = bus

    def sleep_until(self, deadline_ns: int) -> None:
        """Return at the deadline."""
        self._bus.work()
        super().sleep_until(deadline_ns)


class Samples:
    """The loop's sink: keeps the exchange times of the cycles in motion."""

    def __init__(self) -> None:
        self.exchange_us: list[float] = []

    def push(self, row: Array) -> None:
        """Take a row."""
        if row[STATE] == LoopState.RUNNING:
            self.exchange_us.append(float(row[EXCHANGE]))

    def event(self, cycle: int, name: str, text: str) -> None:
        """Take an event, and forget it."""


def run() -> list[Row]:
    """Run the loop for 10 s.

    Raises
    ------
    FrictionHilError
        The loop met a fault.
    """
    configuration = one_axis(config.load(DEMO))
    bus = LoopBus(configuration)
    clock = Clock(configuration.realtime.spin_us, bus)
    any_bus: Any = bus
    drives = CanopenDrives(configuration, configuration.axes, clock, dry_run=False, bus=any_bus)
    (facts,) = drives.connect()
    path_time = PathTime(1.0)
    axis = AxisLoop(facts.name, configuration.axes[facts.name], facts, configuration.period_s, path_time)
    samples = Samples()
    settings = LoopSettings(configuration.period_s, duration_s=DURATION_S)
    note(f"one axis for {DURATION_S:g} s")
    with punctuality(configuration.realtime.priority) as refused:
        result = Loop(drives, [axis], path_time, clock, samples, settings, StopRequest()).run()
    for line in refused:
        note(line)
    if result.faults:
        raise FrictionHilError("the loop met a fault: " + "; ".join(result.faults))
    samples.exchange_us.sort()
    return [
        against(TARGET_US, "exchange p50 (target)", "us", percentile(samples.exchange_us, 0.5)),
        Row("exchange p99", percentile(samples.exchange_us, 0.99), "us"),
        Row("wake-up late p99 in this run", result.late_p99_us, "us"),
    ]


def one_axis(configuration: config.Configuration) -> config.Configuration:
    """Keep the first axis, compensated from the start, on a bus of its own name."""
    name, axis = next(iter(configuration.axes.items()))
    compensation = axis.compensation.model_copy(update={"baseline_s": 0.0})
    assert configuration.bus is not None
    return configuration.model_copy(
        update={
            "axes": {name: axis.model_copy(update={"compensation": compensation})},
            "bus": configuration.bus.model_copy(update={"channel": "benchmark"}),
        }
    )
