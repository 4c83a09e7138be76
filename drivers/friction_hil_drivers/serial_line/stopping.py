"""Stopping drives that were left enabled, and resetting their faults, without a run.

The sequences are those of the descriptions, taken by the same `Sequencer` as in a run. Each state is read back. Nothing
here can enable a drive, and it needs neither a mode nor a watchdog: a configuration that no run would accept is enough.
"""

import contextlib
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from friction_hil.drive import DriveState, FaultCode, Request
from friction_hil.drive.inventory import Stop, StopReport, result_of
from friction_hil.drive.stop import DriveStop, StopState
from friction_hil.errors import DriveError, FrictionHilError
from friction_hil_drivers.cia402 import profile
from friction_hil_drivers.serial_line.axis import ACTING, error_text, not_zero
from friction_hil_drivers.serial_line.bus import SerialBus
from friction_hil_drivers.serial_line.commissioning import (
    REPLY_LIMIT_S,
    by_port,
    descriptions_of,
    longest_reply_s,
    options_of,
)
from friction_hil_drivers.serial_line.description import Description
from friction_hil_drivers.serial_line.line import Line
from friction_hil_drivers.serial_line.protocol import Exchange, Image, Plan, ProtocolFactory
from friction_hil_drivers.serial_line.scheduler import BusScheduler
from friction_hil_drivers.serial_line.sequences import Sequencer, disable_writes, state_of, state_signals

if TYPE_CHECKING:
    from friction_hil.config import AxisConfig, Configuration

_REACTION_S = 2.0  # longest wait for the end of a drive's own reaction to a fault
_RESTART_S = 3.0  # longest wait for a drive that restarts
_RELAPSE_S = 0.3  # in which another master would have enabled the drive again, or the fault have come back
_POLL_S = 0.02
_PATIENCE_S = 5.0  # for a sequence as a whole; each step has its own time-out
_REFUSALS = 3  # in succession: the drive does not take the step
_ATTEMPTS = 2  # for a drive that may be gone
_STANDSTILL_STEPS = 2.0  # noise of an encoder
_COMMANDS = {StopState.QUICK_STOP: Request.QUICK_STOP, StopState.DISABLE: Request.DISABLE}
_NOTHING = Plan((), (), ())


def stop_axes(
    configuration: "Configuration",
    axes: "Mapping[str, AxisConfig]",
    protocol: ProtocolFactory,
    descriptions: Path,
    kind: type[Description],
) -> StopReport:
    """Take the power of the drives of some axes; see `friction_hil.drive.Driver`."""
    return _on_each_line(configuration, axes, protocol, descriptions, kind, is_stop=True)


def reset_axes(
    configuration: "Configuration",
    axes: "Mapping[str, AxisConfig]",
    protocol: ProtocolFactory,
    descriptions: Path,
    kind: type[Description],
) -> StopReport:
    """Reset the faults of the drives of some axes; see `friction_hil.drive.Driver`."""
    return _on_each_line(configuration, axes, protocol, descriptions, kind, is_stop=False)


def unknown(axis: str, address: str, reason: str) -> Stop:
    """Return the result for a drive of which nothing could be read."""
    return Stop(None, DriveState.UNKNOWN, DriveState.UNKNOWN, "unknown", reason, axis, address)


def _on_each_line(
    configuration: "Configuration",
    axes: "Mapping[str, AxisConfig]",
    protocol: ProtocolFactory,
    descriptions: Path,
    kind: type[Description],
    *,
    is_stop: bool,
) -> StopReport:
    found: dict[str, Stop] = {}
    drives: dict[str, ServicedDrive] = {}

    def attempt(names: Sequence[str], work: Callable[[], None]) -> None:
        try:
            work()
        except FrictionHilError as error:
            for name in names:
                drives.pop(name, None)
                found.setdefault(name, unknown(name, _address(axes[name]), str(error)))

    with contextlib.ExitStack() as stack:

        def open_line(names: list[str]) -> None:
            known = descriptions_of({n: axes[n] for n in names}, configuration.source_path, descriptions, kind)
            images = {name: Image() for name in names}
            bus = _make_bus({name: axes[name] for name in names}, known, images, protocol)
            stack.callback(bus.scheduler.line.close)
            bus.scheduler.line.open()
            if not bus.protocol.numbers_replies:
                bus.discard_input(REPLY_LIMIT_S)  # replies to a former master
            for name in names:
                drives[name] = ServicedDrive(bus, name, _address(axes[name]), known[name], images[name])

        for names in by_port(axes):
            attempt(names, partial(open_line, names))
        for name, drive in list(drives.items()):
            attempt([name], partial(drive.look, is_halted=is_stop))
        for name, drive in list(drives.items()):
            attempt([name], partial(_serve, found, name, drive.stop if is_stop else drive.reset))
    return StopReport(tuple(found[name] for name in axes))


def _serve(found: dict[str, Stop], name: str, act: Callable[[], Stop]) -> None:
    found[name] = act()


def _address(axis: "AxisConfig") -> str:
    options = options_of(axis)
    return f"{options.address} on {options.line.port}"


def _make_bus(
    axes: "Mapping[str, AxisConfig]",
    descriptions: Mapping[str, Description],
    images: Mapping[str, Image],
    factory: ProtocolFactory,
) -> SerialBus:
    """Make the bus of a line for single exchanges; it is not open yet."""
    options = {name: options_of(axis) for name, axis in axes.items()}
    protocol = factory(descriptions, options, images)
    line = Line(next(iter(options.values())).line)
    reads = [protocol.read(name, (signal,)) for name, known in descriptions.items() for signal in state_signals(known)]
    reply_s = longest_reply_s(line, Plan(tuple(reads), (), ()), protocol.silence_chars)
    limit_s = max(reply_s, line.options.reply_limit_s or REPLY_LIMIT_S)
    scheduler = BusScheduler(
        line,
        list(images.values()),
        protocol.silence_chars,
        0.0 if protocol.numbers_replies else limit_s,
        anonymous_reply_s=0.0 if protocol.numbers_replies or protocol.names_drives else reply_s,
    )
    return SerialBus(scheduler, protocol, [], _NOTHING, _NOTHING)


class ServicedDrive:
    """One drive on an open line."""

    def __init__(self, bus: SerialBus, name: str, address: str, description: Description, image: Image) -> None:
        self._bus = bus
        self._name = name
        self._address = address  # where the drive is, for messages
        self._description = description
        self._values = image.values
        self._before = DriveState.UNKNOWN
        self._is_silent = False  # it did not answer when its state was read last
        self._trouble = ""  # reason why something did not succeed

    def look(self, *, is_halted: bool) -> None:
        """Read the state; with ``is_halted``, also write what begins to stop the drive.

        All drives are halted before the first of them is awaited.
        """
        self._before = self._state()
        if not is_halted or self._before.is_unpowered:
            return
        description = self._description
        if self._is_silent:
            for write in disable_writes(description):  # deaf one way is not deaf the other way
                self._write(write, attempts=1)
        elif description.state_machine == "cia402":
            self._write({"control": profile.QUICK_STOP})
        else:
            self._write((description.quick_stop or description.disable)[0].write)

    def stop(self) -> Stop:
        """Stop the drive: quick stop, standstill or two seconds, disable; return what was read back."""
        before = self._before
        if before is DriveState.FAULT:
            for write in disable_writes(self._description):  # some drives keep their switch on in a fault
                self._write(write)
            after = self._settled()
            return self._result(before, after, result_of(after, "unpowered"), self._trouble)
        if before.is_unpowered:
            return self._result(before, before, "unpowered")
        if self._is_silent:
            self._state(attempts=1)
            if self._is_silent:
                return self._result(before, DriveState.UNKNOWN, "unknown", self._trouble)
        self._trouble = self._bus.scheduler.last_error = ""
        self._carry_out()
        after = self._settled()
        return self._result(before, after, result_of(after, "stopped"), self._trouble)

    def _carry_out(self) -> None:
        """Take the drive through the states of `friction_hil.drive.stop`."""
        is_cia402 = self._description.state_machine == "cia402"
        noise = _STANDSTILL_STEPS * self._description.units()["position"].step
        stop = DriveStop(noise, has_quick_stop_state=is_cia402)
        if is_cia402 or self._description.quick_stop:
            self._take_to(Request.QUICK_STOP)
            stop.begin(time.monotonic_ns(), StopState.STOPPING)
        else:
            stop.begin(time.monotonic_ns(), StopState.DISABLE)
        while not stop.is_over(time.monotonic_ns()):
            step = stop.step(time.monotonic_ns())
            if step is None or step is StopState.STANDSTILL:
                time.sleep(_POLL_S)
            if step in _COMMANDS:
                self._take_to(_COMMANDS[step])
                if self._is_silent:
                    stop.take_silence()
                else:
                    stop.take_command(time.monotonic_ns())
            elif step is StopState.STANDSTILL:
                is_read = self._read("position")
                stop.take_position(self._values["position"] if is_read else None, time.monotonic_ns())
            elif step is not None:
                state = self._state()
                if self._is_silent:
                    stop.take_silence()
                else:
                    stop.take_state(state, time.monotonic_ns())

    def reset(self) -> Stop:
        """Reset the drive's fault, and leave it without power; return what was read back."""
        before, end = self._before, time.monotonic() + _REACTION_S
        while before is DriveState.FAULT_REACTION_ACTIVE and time.monotonic() < end:
            time.sleep(_POLL_S)
            before = self._state()
        if before is DriveState.UNKNOWN:
            return self._result(before, before, "unknown", self._trouble or "its description does not list its state")
        if before is not DriveState.FAULT:
            detail = "it has no fault" if before.is_powered else ""
            return self._result(before, before, result_of(before, "unpowered"), detail)
        fault = self._fault()
        has_steps = bool(self._description.reset_fault) or self._description.state_machine == "cia402"
        reboot = self._bus.protocol.reboot(self._name)
        if not has_steps and reboot is None:
            detail = "its description has no reset_fault: switch the drive off and on"
            return self._result(before, before, "fault", detail, fault)
        self._trouble = self._bus.scheduler.last_error = ""
        if has_steps:
            self._take_to(Request.RESET_FAULT)
            self._leave_unwatched()
        after = self._settled()
        if after is DriveState.FAULT and reboot is not None:
            self._trouble = ""
            self._restart(reboot)
            after = self._settled()
        if after is DriveState.FAULT:
            return self._result(before, after, "fault", self._trouble or f"it now reports {self._fault()}", fault)
        return self._result(before, after, result_of(after, "reset"), self._trouble, fault)

    def _restart(self, reboot: Exchange) -> None:
        """Restart the drive, and wait until it answers again."""
        try:
            self._bus.transact(self._name, reboot, attempts=1)  # a second one would begin again
        except DriveError as error:
            self._trouble = error.detail.removeprefix(f"{self._name}: ")
        end = time.monotonic() + _RESTART_S
        while self._state() is DriveState.UNKNOWN and self._is_silent and time.monotonic() < end:
            time.sleep(_POLL_S)

    def _result(self, before: DriveState, after: DriveState, result: str, detail: str = "", fault: str = "") -> Stop:
        detail = "" if result in ("stopped", "reset", "unpowered") else detail
        left = "; ".join(self._not_zero()) if after.is_unpowered else ""
        left = FaultCode.TORQUE_LEFT.append_to(left) if left else ""
        return Stop(None, before, after, result, detail, self._name, self._address, fault, left)

    def _not_zero(self) -> list[str]:
        """Set the torque and velocity that a run has left to zero, where they can be read; return those that stay."""
        names = [name for name in ACTING if name in self._description.units()]

        def read(name: str) -> float | None:
            return self._values[name] if self._read(name) else None

        def write_zero(name: str) -> None:
            self._write({name: 0.0})

        return not_zero(self._description, names, read, write_zero)

    def _leave_unwatched(self) -> None:
        """Switch a watchdog off that the reset has armed: with nobody to feed it, it would be the next fault."""
        watchdog = self._description.watchdog
        if watchdog is None or not self._state().is_unpowered:
            return
        if any(step.write.get(watchdog.signal) for step in self._description.reset_fault):
            self._write({watchdog.signal: 0.0})

    def _take_to(self, request: Request) -> None:
        """Write the steps of a request until none is left, or one is not followed; errors are kept as trouble."""
        sequencer = Sequencer(self._description)
        end, refusals = time.monotonic() + _PATIENCE_S, 0
        while not sequencer.problem and refusals < _REFUSALS and time.monotonic() < end:
            state = self._state()
            step = sequencer.next_write(request, state, time.monotonic())
            if not step:
                return
            if self._write(step):
                refusals = 0
                sequencer.acknowledge()
            else:
                refusals += 1
        if sequencer.problem and not self._trouble:
            said = self._bus.scheduler.last_error  # of a drive that refuses a request without a reply
            self._trouble = sequencer.problem + (f" ({said})" if said else "")

    def _settled(self) -> DriveState:
        """Read the state until the drive has had time for a relapse; return the last one.

        It is read all the time: some drives trip a watchdog when nobody asks them anything.
        """
        end = time.monotonic() + _RELAPSE_S
        while True:
            state = self._state()
            if time.monotonic() > end or state is DriveState.UNKNOWN:
                return state
            time.sleep(_POLL_S)

    def _state(self, attempts: int = _ATTEMPTS) -> DriveState:
        """Read the state; UNKNOWN where the drive does not answer, or its description does not list the state."""
        self._is_silent = not all(self._read(name, attempts) for name in state_signals(self._description))
        return DriveState.UNKNOWN if self._is_silent else state_of(self._description, self._values)

    def _fault(self) -> str:
        """Return what the drive reports as its fault, in words."""
        if "error" in self._description.units() and self._read("error") and self._values["error"]:
            return error_text(self._description, self._values["error"])
        return "a fault without an error number"

    def _read(self, name: str, attempts: int = _ATTEMPTS) -> bool:
        """Read a signal; return True if the drive answered."""
        try:
            self._bus.transact(self._name, self._bus.read_exchange(self._name, name), attempts=attempts)
        except DriveError as error:
            self._trouble = error.detail.removeprefix(f"{self._name}: ")
            return False
        return True

    def _write(self, step: Mapping[str, float], attempts: int = _ATTEMPTS) -> bool:
        """Write values; return True if the drive took them."""
        self._values.update(step)
        try:
            self._bus.transact(self._name, self._bus.write_exchange(self._name, step), attempts=attempts)
        except DriveError as error:
            self._trouble = error.detail.removeprefix(f"{self._name}: ")
            return False
        return True
