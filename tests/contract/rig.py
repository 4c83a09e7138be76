"""What a contract test of drives needs: a driver, simulated drives behind it, and a count of what it commands."""

import math
import os
import struct
import threading
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import can

from friction_hil.config import Configuration, from_dict
from friction_hil.config.drivers import DRIVERS, SIMULATED_DRIVES, load_driver
from friction_hil.drive import AxisFacts, Command, Drives, DriveState, Feedback, Request
from friction_hil.drive.inventory import Stop, StopReport

PERIOD_S = 1e-3
INERTIA, FRICTION = 2e-4, 0.01  # of the simulated axes, kg m^2 and N m
COUNTS = 2**20 / (2.0 * math.pi)  # per rad
RATED_TORQUE = 0.64
PLANT = {
    "mechanics": {"inertia": INERTIA},
    "friction": {"model": "coulomb", "parameters": {"coulomb": FRICTION}},
}
AXES = ("x", "y")
_LONGEST_WATCHDOG_S = 0.5
_PATIENCE_S = 20.0  # only ends a test that hangs


class SteppedTime:
    """Simulated time: it advances only by the cycles of a test."""

    is_real = False

    def __init__(self) -> None:
        self.ns = 0
        self.tick_ns = 0  # for every look at it, where a driver waits for what does not come

    def now_ns(self) -> int:
        self.ns += self.tick_ns
        return self.ns

    def doze_until(self, deadline_ns: int) -> bool:
        return False

    def sleep_until(self, deadline_ns: int) -> None:
        self.ns = max(self.ns, deadline_ns)


class NotApplicableError(Exception):
    """Raised by a method of a rig for what its drives or its line cannot do; the tests that need it are skipped.

    Its text says why, and is the reason of the skip.
    """


class Rig(ABC):
    """Two axes in CST with simulated drives, and the driver under test.

    A subclass names its drives and counts commands; the rest has defaults for drivers that have entry points.

    Attributes
    ----------
    configuration : Configuration
        Of both axes.
    inertia, friction : float
        Of each simulated axis, kg m^2 and N m: torque t accelerates it by (t - friction) / inertia.
    torque_tolerance : float
        Torque to which the drive's own units may round a command, N m.
    """

    inertia, friction = INERTIA, FRICTION
    torque_tolerance = 2e-3
    is_detached = False  # set by `detach`

    def __init__(self, configuration: Configuration) -> None:
        self.configuration = configuration
        self.clock = SteppedTime()

    @abstractmethod
    def make_drives(self, *, dry_run: bool = False) -> Drives:
        """Make the drives of both axes, not connected yet."""

    @abstractmethod
    def count_commands(self) -> int:
        """Return how often something was written to the drives so far that changes them."""

    @abstractmethod
    def silence(self) -> None:
        """Make every drive fall silent, as if the cable were cut."""

    @abstractmethod
    def trip(self) -> None:
        """Bring the drive of the first axis into its fault state."""

    @abstractmethod
    def has_power(self, axis: int) -> bool:
        """Return whether a drive (0 or 1) has power, as the drive itself knows it; not through the driver."""

    @abstractmethod
    def leave_enabled(self) -> None:
        """Give both drives power before the driver connects, as a master does that ends without disabling them."""

    @abstractmethod
    def detach(self) -> None:
        """Keep the commands of the cycle from the drive of the first axis, though it is there and has power.

        Raises
        ------
        NotApplicableError
            Here a drive that is there takes every command.
        """

    @abstractmethod
    def kill(self) -> None:
        """Let the drives alone, as if the driver's process had been killed, until their watchdogs must have acted.

        Raises
        ------
        NotApplicableError
            The drives have no watchdog, or time does not pass without the driver.
        """

    @abstractmethod
    def close(self) -> None:
        """End the simulated drives."""


class Connection:
    """Drives of a rig, driven as the loop does it; closed at the end of the context."""

    def __init__(self, rig: Rig, *, dry_run: bool = False, is_enabled: bool = False) -> None:
        self.rig = rig
        self._is_enabled = is_enabled
        self.drives = rig.make_drives(dry_run=dry_run)
        self.feedback = [Feedback() for _ in AXES]
        self._commands = [Command() for _ in AXES]
        self.facts: tuple[AxisFacts, ...] = ()
        self.written = self._count = 0

    def __enter__(self) -> "Connection":
        try:
            self.facts = tuple(self.drives.connect())
            self.drives.start()
            if self._is_enabled:
                self.enable()
        except BaseException:
            self.drives.close()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self.drives.close()

    @property
    def states(self) -> list[DriveState]:
        return [each.state for each in self.feedback]

    def cycle(self, request: Request, *torques: float) -> None:
        """One cycle: one torque for all axes, or one an axis."""
        clock = self.rig.clock
        clock.ns += round(PERIOD_S * 1e9)
        # where nobody replies, the deadline has passed already: nothing waits
        is_silent = clock.is_real and not self.rig.is_detached
        self.drives.receive(self.feedback, 0 if is_silent else clock.ns + round(PERIOD_S * 1e9))
        before, self._count = self._count, self.rig.count_commands()
        self.written = self._count - before  # of the commands of the cycle before, which a poll may carry
        for k, command in enumerate(self._commands):
            command.request = request
            command.position, command.velocity = self.feedback[k].position, 0.0
            command.torque = torques[k % len(torques)] if torques else 0.0
        self.drives.send(self._commands)

    def cycles(self, count: int, request: Request, *torques: float) -> Iterator[list[Feedback]]:
        for _ in range(count):
            self.cycle(request, *torques)
            yield self.feedback

    def run(self, count: int, request: Request, *torques: float) -> None:
        for _ in self.cycles(count, request, *torques):
            pass

    def enable(self) -> None:
        for _ in self.cycles(100, Request.ENABLE):
            if self.states == [DriveState.OPERATION_ENABLED] * len(AXES):
                return
        raise AssertionError(self.feedback)


class InstalledRig(Rig):
    """A rig of an installed driver and its counterpart, both by their entry points; the counterpart has a thread.

    Parameters
    ----------
    driver : str
        Name of both entry points.
    axes : dict
        For each axis, the driver's own keys.
    """

    def __init__(self, driver: str, axes: dict[str, dict[str, Any]], bus: dict[str, Any] | None = None) -> None:
        base = {
            "driver": driver,
            "mode": "cst",
            "limits": {"torque": 0.3, "velocity": 1000.0},
            "model": {"axis": "rotary", "friction": PLANT["friction"], "mechanics": PLANT["mechanics"]},
            "trajectory": {"kind": "none"},
            "simulation": PLANT,
        }
        data = {
            "version": 1,
            "period_s": PERIOD_S,
            **({"bus": bus} if bus else {}),
            "axes": {name: {**base, **keys} for name, keys in axes.items()},
        }
        super().__init__(from_dict(data, "contract"))
        self._driver = load_driver(driver, DRIVERS)
        self.counterpart = load_driver(driver, SIMULATED_DRIVES)(
            self.configuration, self.configuration.axes, pace="sync"
        )
        self.ready: str = self.counterpart.open()
        self._is_stopping = threading.Event()
        self._thread = threading.Thread(target=self.counterpart.run, args=(self._is_stopping.is_set,))
        self._thread.start()

    def make_drives(self, *, dry_run: bool = False) -> Drives:
        config = self.configuration
        return self._driver.drives_for(config, config.axes, self.clock, dry_run=dry_run)

    def stop_axes(self) -> tuple[Stop, ...]:
        """Stop all drives without a run."""
        report: StopReport = self._driver.stop_axes(self.configuration, self.configuration.axes)
        return report.stops

    def reset_axes(self) -> tuple[Stop, ...]:
        """Reset the faults of all drives without a run."""
        report: StopReport = self._driver.reset_axes(self.configuration, self.configuration.axes)
        return report.stops

    def silence(self) -> None:
        self.stop()
        self.clock.is_real = True  # in simulated time a driver would wait for replies

    def stop(self) -> bool:
        """End `run` of the counterpart; True when it has ended."""
        self._is_stopping.set()
        self._thread.join(60.0)
        return not self._thread.is_alive()

    def close(self) -> None:
        self.stop()
        self.counterpart.close()


class CanRig(InstalledRig):
    """CANopen drives on python-can's virtual bus."""

    def __init__(self, folder: Path) -> None:
        bus = {"interface": "virtual", "channel": str(folder)}
        self._listener = can.Bus(interface="virtual", channel=str(folder))
        self._count = 0
        super().__init__("canopen", {"x": {"node": 1}, "y": {"node": 2}}, bus)

    def count_commands(self) -> int:
        while (message := self._listener.recv(0.0)) is not None:
            self._count += _commands_can(message.arbitration_id, bytes(message.data))
        return self._count

    def trip(self) -> None:
        """See `Rig.trip`."""
        self.counterpart.nodes[0].drive.fault(0x2310, 0)

    def has_power(self, axis: int) -> bool:
        """See `Rig.has_power`."""
        return bool(self.counterpart.nodes[axis].drive.state.is_powered)

    def leave_enabled(self) -> None:
        """See `Rig.leave_enabled`: by SDO, as another master does it."""
        for node in (1, 2):
            for word in ("2f6060000a000000", "2b40600006000000", "2b40600007000000", "2b4060000f000000"):
                self._send(0x600 + node, bytes.fromhex(word))
        self._await(lambda: self.has_power(0) and self.has_power(1))

    def detach(self) -> None:
        """See `Rig.detach`: in Pre-operational a drive ignores PDOs, and its loops go on."""
        self.is_detached = self.clock.is_real = True  # in simulated time a driver would wait for its TPDOs
        self.clock.tick_ns = round(0.05 * PERIOD_S * 1e9)
        self._send(0x000, bytes([0x80, 1]))

    def kill(self) -> None:
        """See `Rig.kill`: time passes with SYNC, which another master goes on to send here."""
        cycles = round(_LONGEST_WATCHDOG_S / PERIOD_S)
        node = self.counterpart.nodes[0]
        end_ns = node.now_ns + round((cycles - 1) * PERIOD_S * 1e9)
        for _ in range(cycles):
            self._send(0x080, b"")
        self._await(lambda: node.now_ns >= end_ns)

    def _send(self, can_id: int, data: bytes) -> None:
        self._listener.send(can.Message(arbitration_id=can_id, data=data, is_extended_id=False))

    @staticmethod
    def _await(is_done: Callable[[], bool]) -> None:
        end = time.monotonic() + _PATIENCE_S
        while not is_done():
            assert time.monotonic() < end, "the simulated drives do not answer"
            time.sleep(1e-3)

    def close(self) -> None:
        super().close()
        self._listener.shutdown()


def _commands_can(can_id: int, data: bytes) -> bool:
    """True for what changes a drive: PDOs to it, SDO downloads and NMT, but for what makes it send feedback."""
    if can_id == 0x000:
        return data[0] not in (0x01, 0x80)  # start, and back to Pre-operational
    if 0x600 < can_id < 0x680:
        index = struct.unpack_from("<H", data, 1)[0]
        return data[0] & 0xE0 == 0x20 and not 0x1800 <= index < 0x1C00  # PDOs that the drive sends
    return 0x200 <= can_id < 0x580 and (can_id & 0x80) == 0


class SerialRig(InstalledRig):
    """Drives on one line; what the driver's thread writes to it is taken apart by the protocol's grammar."""

    def __init__(self, driver: str, port: str, axes: dict[str, dict[str, Any]], grammar: Any, patch: Any) -> None:
        line = {"port": port, "baud": 4_000_000, "reply_limit_s": 0.05}
        common = {"line": line, "is_watchdog_required": False}
        super().__init__(driver, {name: {**common, **keys} for name, keys in axes.items()})
        self._grammar = grammar
        self._written = bytearray()  # since the last count: whole requests
        self._counted = 0
        owner, write = threading.get_ident(), os.write

        def tapped(descriptor: int, data: bytes) -> int:
            count = write(descriptor, data)
            if threading.get_ident() == owner:
                self._written += bytes(data)[:count]
            return count

        patch.setattr(os, "write", tapped)

    def count_commands(self) -> int:
        self._counted += sum(self._grammar(bytes(self._written)))
        self._written.clear()
        return self._counted

    def trip(self) -> None:
        """See `Rig.trip`."""
        self._drives[0].fail()

    def has_power(self, axis: int) -> bool:
        """See `Rig.has_power`."""
        return bool(self._drives[axis].state.is_powered)

    def leave_enabled(self) -> None:
        """See `Rig.leave_enabled`."""
        for drive in self._drives:
            drive.enter(DriveState.OPERATION_ENABLED)

    def detach(self) -> None:
        """See `Rig.detach`."""
        raise NotApplicableError("a serial drive that replies takes commands: there is no state between")

    def kill(self) -> None:
        """See `Rig.kill`."""
        raise NotApplicableError("the time of simulated serial drives passes with requests only")

    @property
    def _drives(self) -> Any:
        (line,) = self.counterpart.lines
        return line.drives


# Requests of each protocol, one after the other: True for those that change a drive.


def modbus_rtu(data: bytes) -> Iterator[bool]:
    """Requests of Modbus RTU."""
    at = 0
    while at < len(data):
        function = data[at + 1]
        yield function in (5, 6, 15, 16, 23)
        if function == 23:
            at += 13 + data[at + 10]
        else:
            at += 9 + data[at + 6] if function in (15, 16) else 8


def modbus_tcp(data: bytes) -> Iterator[bool]:
    """Requests of Modbus TCP."""
    at = 0
    while at < len(data):
        yield data[at + 7] in (5, 6, 15, 16, 23)
        at += 6 + int.from_bytes(data[at + 4 : at + 6], "big")


def dynamixel(data: bytes) -> Iterator[bool]:
    """Packets of Dynamixel protocol 2."""
    at = 0
    while at < len(data):
        assert data[at : at + 4] == b"\xff\xff\xfd\x00"
        yield data[at + 7] not in (0x01, 0x02, 0x82, 0x8A, 0x92, 0x9A)  # ping and the reads
        at += 7 + int.from_bytes(data[at + 5 : at + 7], "little")


def odrive(data: bytes) -> Iterator[bool]:
    """Lines of ODrive's ASCII protocol."""
    for line in data.split(b"\n"):
        if line.strip():
            yield not line.startswith((b"r ", b"f "))
