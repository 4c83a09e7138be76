"""The drive port for drives on serial lines; a protocol adds its codec and its descriptions.

A cycle on a line begins with the poll, which reads the feedback. After the computation follow the push, which writes
the commands, and a step of a sequence if one is due, or else one of the background reads (signals that change slowly),
whose reply has arrived when the next cycle begins. If one exchange both writes and reads, the commands are part of the
poll of the next cycle.

One thread serves all lines.
"""

import contextlib
import os
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any, ClassVar

from friction_hil.drive import AxisFacts, Clock, Command, Driver, DriveState, FaultCode, Feedback, Request
from friction_hil.drive.codes import Explanation, coded
from friction_hil.drive.finding import Finding, failure
from friction_hil.drive.inventory import StopReport
from friction_hil.errors import BusError, DriveError, FrictionHilError, OptionError, UsageError
from friction_hil_drivers.serial_line import codes, ports, stopping
from friction_hil_drivers.serial_line.axis import SerialAxis, unit_mistakes
from friction_hil_drivers.serial_line.bus import SerialBus
from friction_hil_drivers.serial_line.commissioning import Commissioning, by_port, descriptions_of, options_of
from friction_hil_drivers.serial_line.description import Description
from friction_hil_drivers.serial_line.line import Line, taken
from friction_hil_drivers.serial_line.new_keys import new_keys
from friction_hil_drivers.serial_line.options import SerialOptions
from friction_hil_drivers.serial_line.protocol import Exchange, ProtocolFactory
from friction_hil_drivers.serial_line.scheduler import BusScheduler
from friction_hil_drivers.serial_line.waiting import LineSelector, run_schedulers

if TYPE_CHECKING:
    from friction_hil.config import AxisConfig, Configuration
    from friction_hil.config.new_file import DriverKeys, Wanted

_COMPUTATION_S = 3e-4  # kept free in each period after the feedback, at most a tenth of the period
_SIMULATED_TIMEOUT_NS = 10_000_000_000
_SIMULATED_TIMEOUTS = 3  # in succession; in simulated time nothing else would end a run without drives
_RELEASE_NS = 300_000_000
_REOPEN_S, _REOPEN_POLL_S = 0.3, 5e-3
_POWER_OFF_S = 0.5  # for a drive to brake and take its power away
_STOPS = Request.QUICK_STOP, Request.DISABLE
_ATTEMPTS = 3  # to set commands to zero at the end
_MAX_REFUSALS = 10  # successive refused commands that are a fault


class SerialDrives(Driver):
    """Drives of some axes on serial lines; see `friction_hil.drive.Drives`. A protocol sets the class attributes."""

    Options: ClassVar[type[SerialOptions]]
    description_type: ClassVar[type[Description]]
    descriptions: ClassVar[Path]  # directory of the descriptions that come with the driver
    protocol: ClassVar[ProtocolFactory]
    address_key: ClassVar[str]  # key of the drive's address on its line
    explanations: ClassVar[Mapping[str, Explanation]] = codes.EXPLANATIONS
    remedies: ClassVar[Mapping[str, str]] = codes.REMEDIES
    simulated: ClassVar[Mapping[str, Any]]  # what a new configuration of a simulated drive has, see `new_keys`

    @classmethod
    def new_keys(cls, wanted: "Wanted") -> "DriverKeys":
        """Return the keys of a new configuration; see `friction_hil.drive.Driver`."""
        return new_keys(
            wanted,
            address_key=cls.address_key,
            is_address_needed=cls.Options.model_fields[cls.address_key].is_required(),
            directory=cls.descriptions,
            kind=cls.description_type,
            simulated=cls.simulated,
        )

    @classmethod
    def check_files(
        cls, configuration: "Configuration", axes: "Mapping[str, AxisConfig]"
    ) -> Iterator[tuple[str, str, FrictionHilError]]:
        """Read the descriptions, and plan the cycle of each line; see `friction_hil.drive.Driver`."""
        descriptions: dict[str, Description] = {}
        for name, axis in axes.items():
            try:
                descriptions |= descriptions_of(
                    {name: axis}, configuration.source_path, cls.descriptions, cls.description_type
                )
            except UsageError as error:
                yield name, "description", error
        refused = set[str]()
        for name, description in descriptions.items():
            options, kind = options_of(axes[name]), axes[name].model.axis
            for mistake in unit_mistakes(name, description, options.units, kind):
                yield name, mistake.key, UsageError(mistake.text)
                refused.add(name)
        commissioning = Commissioning(configuration, axes, cls.protocol, dry_run=False, is_real=False)
        for names in by_port(axes):
            if all(name in descriptions and name not in refused for name in names):
                try:
                    commissioning.make_bus({name: descriptions[name] for name in names})
                except OptionError as error:
                    yield error.axis, error.key, UsageError(error.text)
                except FrictionHilError as error:
                    yield names[0], "line", error

    check_machine = staticmethod(ports.check_machine)

    @classmethod
    def check_connection(cls, configuration: "Configuration", axes: "Mapping[str, AxisConfig]") -> Iterator[Finding]:
        """Open and close each line, and report on it and its drives; see `friction_hil.drive.Driver`."""
        commissioning = Commissioning(configuration, axes, cls.protocol, dry_run=False, is_real=False)
        for names in by_port(axes):
            of_line = {name: axes[name] for name in names}
            yield _opened(Line(options_of(of_line[names[0]]).line), of_line)
            read: dict[str, Description] = {}
            for name in names:
                with contextlib.suppress(UsageError):  # here and below: check_files reports it
                    read |= descriptions_of(
                        {name: axes[name]}, configuration.source_path, cls.descriptions, cls.description_type
                    )
            if len(read) == len(names):
                with contextlib.suppress(FrictionHilError):
                    yield from commissioning.line_findings(commissioning.make_bus(read))
            for name, description in read.items():
                with contextlib.suppress(UsageError):
                    yield from commissioning.drive_findings(name, description)

    @classmethod
    def stop_axes(cls, configuration: "Configuration", axes: "Mapping[str, AxisConfig]") -> StopReport:
        """Take the power of the drives of some axes; see `friction_hil.drive.Driver`."""
        return stopping.stop_axes(configuration, axes, cls.protocol, cls.descriptions, cls.description_type)

    @classmethod
    def reset_axes(cls, configuration: "Configuration", axes: "Mapping[str, AxisConfig]") -> StopReport:
        """Reset the faults of the drives of some axes; see `friction_hil.drive.Driver`."""
        return stopping.reset_axes(configuration, axes, cls.protocol, cls.descriptions, cls.description_type)

    def __init__(
        self, configuration: "Configuration", axes: "Mapping[str, AxisConfig]", clock: Clock, *, dry_run: bool
    ) -> None:
        self._configuration = configuration
        self._configs = dict(axes)
        self._clock = clock
        self._dry_run = dry_run
        self._margin_ns = round(min(_COMPUTATION_S, 0.1 * configuration.period_s) * 1e9)
        self._selector = LineSelector()  # for the wait that ends at the same time in each period
        self._plain_selector = LineSelector()
        self.buses: list[SerialBus] = []
        self._schedulers: list[BusScheduler] = []
        self._axes: list[SerialAxis] = []  # in the order of the configuration
        self._bus_of: list[SerialBus] = []  # of each of these axes
        self._is_commanding = False  # something has been written since the start
        self._is_started = False
        self._is_read = False  # `warm_caches` has read the bytes that came before this cycle
        self._end_ns = 0  # end of the cycle
        self._time_s = 0.0  # time of its feedback
        self._timeouts = 0
        self._states: dict[str, DriveState] = {}  # read back after the stop
        self.leftovers: list[str] = []  # after `close`: torque and velocity that a drive may still hold

    def connect(self) -> Sequence[AxisFacts]:
        """Open the lines and prepare every drive; nothing is enabled. See `friction_hil.drive.Drives.connect`."""
        source = self._configuration.source_path
        descriptions = descriptions_of(self._configs, source, self.descriptions, self.description_type)
        commissioning = Commissioning(
            self._configuration,
            self._configs,
            type(self).protocol,
            dry_run=self._dry_run,
            is_real=self._clock.is_real,
        )
        facts: dict[str, AxisFacts] = {}
        axes: dict[str, SerialAxis] = {}
        for names in by_port(self._configs):
            on_bus = {name: descriptions[name] for name in names}
            bus = commissioning.make_bus(on_bus)
            self.buses.append(bus)
            bus.scheduler.line.open()
            axes.update((axis.name, axis) for axis in bus.axes)
            facts.update((each.name, each) for each in commissioning.prepare(bus, on_bus))
        self._axes = [axes[name] for name in self._configs]
        self._schedulers = [bus.scheduler for bus in self.buses]
        buses = {axis.name: bus for bus in self.buses for axis in bus.axes}
        self._bus_of = [buses[name] for name in self._configs]
        return [facts[name] for name in self._configs]

    def start(self) -> None:
        """Begin the cyclic phase."""
        for axis in self._axes:
            axis.image.fresh.clear()  # what was read before
        for scheduler in self._schedulers:
            scheduler.notices.clear()
        if self._clock.is_real:
            self._selector = LineSelector(round(self._configuration.period_s * 1e9))
        self._is_started = True

    def receive(self, feedback: Sequence[Feedback], end_ns: int) -> None:
        """Poll every drive until all have answered, or until it is too late for this cycle."""
        is_real = self._clock.is_real
        self._end_ns = end_ns
        deadline_ns = end_ns - self._margin_ns if is_real else time.monotonic_ns() + _SIMULATED_TIMEOUT_NS
        for bus in self.buses:
            scheduler = bus.scheduler
            if (scheduler.outstanding or scheduler.queue) and not bus.protocol.ahead_chars:
                bus.finish_background_read(deadline_ns)
            # in simulated time the wire takes no time: it is unknown when a reply will come
            bus.request_feedback(
                deadline_ns if is_real else None, is_commanding=self._is_commanding, is_read=self._is_read
            )
        # not once all have answered: one that is silent would make the positions of the others seem to be later ones
        self._time_s = time_s = self._clock.now_ns() * 1e-9
        is_over = run_schedulers(self._schedulers, deadline_ns, self._selector)
        if is_over:
            self._timeouts = 0
        elif not is_real:
            self._note_timeout()
        self._is_read = False
        if not is_over:
            for scheduler in self._schedulers:
                scheduler.end_cycle()
        for each, axis, bus in zip(feedback, self._axes, self._bus_of, strict=True):
            scheduler = bus.scheduler
            axis.fill(each, time_s, scheduler.last_error)
            each.is_setpoint_lost = bus.is_commanded and not bus.commands[axis.name] <= scheduler.sent
            if scheduler.refusals.count >= _MAX_REFUSALS:
                text = f"the drive refuses its commands: {scheduler.last_error}"
                each.message = coded(text, codes.COMMANDS_REFUSED)
            if scheduler.notices:  # of all drives on the line; the texts say which
                each.notices += (f"a command is refused: {text}" for text in scheduler.notices)
                scheduler.notices.clear()

    def _note_timeout(self) -> None:
        self._timeouts += 1
        if self._timeouts >= _SIMULATED_TIMEOUTS:
            waited_s = _SIMULATED_TIMEOUTS * _SIMULATED_TIMEOUT_NS * 1e-9
            text = f"not every drive has answered for {waited_s:g} s: do they still run?"
            raise DriveError(text, code=codes.PACE_NOT_ANSWERED)

    def send(self, commands: Sequence[Command]) -> None:
        """Write the commands, or put them where the next poll takes them; a dry run only reads."""
        end_ns = self._end_ns if self._clock.is_real else None
        steps: dict[str, Mapping[str, float]] = {}  # values to write in addition to the commands, by axis
        stopping = set[str]()
        if not self._dry_run:
            for axis, command in zip(self._axes, commands, strict=True):
                if command.request is not Request.LISTEN:
                    self._is_commanding = True
                if step := axis.take(command, self._time_s):
                    steps[axis.name] = step
                    if command.request in _STOPS:
                        stopping.add(axis.name)
        is_sent = True
        for bus in self.buses:
            bus.send_commands(steps, end_ns, is_commanding=self._is_commanding, stopping=stopping)
            if bus.scheduler.queue:
                is_sent = False
        if not is_sent:  # replies are awaited at the start of the next cycle only
            until_ns = time.monotonic_ns() + _SIMULATED_TIMEOUT_NS if end_ns is None else end_ns
            run_schedulers(self._schedulers, until_ns, self._plain_selector, until_answered=False)

    def warm_caches(self) -> None:
        """Read what has come since the last cycle, so that the next cycle need not; see `Drives.warm_caches`."""
        for scheduler in self._schedulers:
            if scheduler.line.is_open:  # reopening may take time
                scheduler.poll()
        self._selector.forget()
        self._is_read = True

    def close(self) -> list[DriveState]:
        """Disable every drive, and close the lines; return the states read back after that."""
        try:
            if self._is_started and self._is_commanding:
                for bus in self.buses:
                    self._release(bus)
        finally:
            for bus in self.buses:
                bus.scheduler.line.close()
            self._selector.close()
            self._is_started = False
        return [self._states.get(name, DriveState.UNKNOWN) for name in self._configs]

    def _release(self, bus: SerialBus) -> None:
        """Disable every drive of a bus, write zero commands, read the states back, even if some do not answer."""
        line, end_s = bus.scheduler.line, time.monotonic() + _REOPEN_S
        while not line.reopen() and time.monotonic() < end_s:  # the line may be back since the last cycle
            time.sleep(_REOPEN_POLL_S)
        bus.finish_background_read(time.monotonic_ns() + _RELEASE_NS)  # or its reply would come after the first write
        for axis in bus.axes:
            axis.hold()
        for axis in bus.axes:
            for write in axis.disable_writes():
                axis.image.values.update(write)
                self._try(bus, axis.name, bus.write_exchange(axis.name, write))
        zeroing = [exchange for exchange in (*bus.plan.poll, *bus.plan.push) if exchange.writes]
        is_taken = all([self._try(bus, bus.axes[0].name, exchange) for exchange in zeroing])  # noqa: C419 - all of them
        for axis in bus.axes:
            state = self._states[axis.name] = self._read_back(bus, axis)
            if not is_taken and state is not DriveState.UNKNOWN:  # it answers, so a telegram may have been lost
                is_taken = all([self._try(bus, axis.name, exchange, _ATTEMPTS) for exchange in zeroing])  # noqa: C419
            left = axis.not_zero(partial(self._read, bus, axis), partial(self._write_zero, bus, axis))
            if axis.acting_commands and not left and not (is_taken and state is not DriveState.UNKNOWN):
                left = [f"the drive may still hold its last {' and '.join(axis.acting_commands)}"]
            self.leftovers += (FaultCode.TORQUE_LEFT.append_to(f"{axis.name}: {text}") for text in left)

    def _read(self, bus: SerialBus, axis: SerialAxis, name: str) -> float | None:
        """Return the number that a drive holds, None if it does not answer."""
        return axis.image.values[name] if self._try(bus, axis.name, bus.read_exchange(axis.name, name)) else None

    def _write_zero(self, bus: SerialBus, axis: SerialAxis, name: str) -> None:
        axis.image.values[name] = 0.0
        self._try(bus, axis.name, bus.write_exchange(axis.name, (name,)))

    def _read_back(self, bus: SerialBus, axis: SerialAxis) -> DriveState:
        """Return the state of a drive, once it has no power or its time is over; UNKNOWN if it does not answer."""
        exchanges = [bus.protocol.read(axis.name, (name,)) for name in axis.state_signals]
        end_s = time.monotonic() + _POWER_OFF_S
        while exchanges and bus.scheduler.line.is_open:
            is_read = all(self._try(bus, axis.name, exchange) for exchange in exchanges)
            if is_read and not (state := axis.read_state()).is_powered:
                return state
            if time.monotonic() > end_s:  # a single reply that is lost says nothing
                return state if is_read else DriveState.UNKNOWN
        return DriveState.UNKNOWN

    def _try(self, bus: SerialBus, axis: str, exchange: Exchange, attempts: int = 1) -> bool:
        """Perform an exchange if the line still works; return True if it was answered."""
        with contextlib.suppress(BusError, DriveError):
            if bus.scheduler.line.is_open:
                bus.transact(axis, exchange, attempts=attempts)
                return True
        return False


def _opened(line: Line, axes: "Mapping[str, AxisConfig]") -> Finding:
    """Open a line as the daemon does, and close it again; a line in use by another process is left alone."""
    port = line.options.port
    check = f"line of {', '.join(axes)}"
    try:
        # not every program locks its port, and opening a port would change its settings
        if not line.options.is_tcp and (others := ports.holders(port)):
            raise taken(port, others)
        line.open()
    except FrictionHilError as error:
        found = failure(check, error, "FH-416")
        is_missing = isinstance(error, BusError) and (line.options.is_tcp or not os.path.exists(port))
        if is_missing and any(axis.simulation is not None for axis in axes.values()):
            found = replace(found, fix=f"{found.fix}; or start friction-hil simulate with this configuration")
        return found
    finally:
        line.close()
    return Finding(check, "pass", f"{port} accepts connections" if line.options.is_tcp else f"{port} can be opened")
