"""Commissioning: opens lines and prepares their drives to be enabled. It runs before the loop, and may wait."""

import itertools
import statistics
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from friction_hil.drive import AxisFacts, DriveState
from friction_hil.drive.finding import Finding
from friction_hil.errors import DriveError, OptionError
from friction_hil_drivers.serial_line import codes, ports
from friction_hil_drivers.serial_line.axis import SerialAxis, SignalScales, make_scales
from friction_hil_drivers.serial_line.bus import SerialBus
from friction_hil_drivers.serial_line.description import Description, Step, load_description
from friction_hil_drivers.serial_line.line import Line
from friction_hil_drivers.serial_line.options import SerialOptions
from friction_hil_drivers.serial_line.protocol import (
    FAST,
    SLOW,
    TEMPERATURE,
    CycleSignals,
    Exchange,
    Image,
    Plan,
    ProtocolFactory,
)
from friction_hil_drivers.serial_line.scheduler import BusScheduler
from friction_hil_drivers.serial_line.sequences import state_signals, watchdog_steps
from friction_hil_drivers.serial_line.set_up import arm_watchdog, write_step
from friction_hil_drivers.serial_line.wire import character_s, check_rate, wire_s

if TYPE_CHECKING:
    from friction_hil.config import AxisConfig, Configuration

REPLY_LIMIT_S, _REPLY_LIMIT_FRACTION = 0.05, 0.4
_MEASURED_CYCLES = 25
_WATCHDOG_PERIODS, _LEAST_WATCHDOG_PERIODS, _LEAST_WATCHDOG_S = 20, 3, 0.1
_LATENESS_S = 2e-3  # margin for a reply, beside the adapter's latency
_INTERPOLATION_CYCLES = {"csp": 1.0, "csv": 0.5, "cst": 0.0}  # delay of set-points in addition to that of torques


class Commissioning:
    """Opens the lines of some axes and prepares their drives."""

    def __init__(
        self,
        configuration: "Configuration",
        axes: "Mapping[str, AxisConfig]",
        protocol: ProtocolFactory,
        *,
        dry_run: bool,  # nothing may be written
        is_real: bool,  # in real time, in which the time of a poll can be measured
    ) -> None:
        self._configs = dict(axes)
        self._options = {name: options_of(axis) for name, axis in axes.items()}
        self._protocol = protocol
        self._dry_run = dry_run
        self._is_real = is_real
        self._period_s = configuration.period_s
        self._max_missed = configuration.realtime.max_missed

    def make_bus(self, descriptions: Mapping[str, Description]) -> SerialBus:
        """Make the bus of a line from the descriptions of its drives; it is not open yet.

        Raises `UsageError`: a drive or the line cannot do what the configuration asks for.
        """
        options = {name: self._options[name] for name in descriptions}
        images = {name: Image() for name in descriptions}
        protocol = self._protocol(descriptions, options, images)
        axes, commanded, listening_to = [], {}, {}
        for name, description in descriptions.items():
            config = self._configs[name]
            signals = description.units()
            mode = description.modes.get(config.mode)
            if mode is None:
                has = ", ".join(description.modes)
                text = f"{description.name} cannot be commanded in mode {config.mode}; its description has {has}"
                raise OptionError(name, "mode", text)
            given = config.compensation
            if "torque_command" not in mode.commands and given.enabled and not given.is_by_position:
                text = (
                    f"{description.name} takes no torque in mode {config.mode}: give compensation.velocity_offset with "
                    "position_gain, which shifts the set-point of the position, or compensation: {enabled: false}"
                )
                raise OptionError(name, "mode", text)
            self._check_watchdog(name, description)
            scales = make_scales(
                name,
                description,
                options[name].units,
                kind=config.model.axis,
                is_inverted=options[name].is_inverted,
                inverted_torque=options[name].inverted_torque,
            )
            fast = tuple(signal for signal in FAST if signal in signals)
            needed = (*SLOW, *_temperature_signals(config, description), *state_signals(description))
            slow = tuple(signal for signal in signals if signal in needed)
            commanded[name] = CycleSignals(fast, slow, mode.commands)
            listening_to[name] = CycleSignals(fast, slow, ())
            before = (*mode.prepare, *self._watchdog_steps(name, description))
            axes.append(SerialAxis(name, description, scales, images[name], mode.commands, before, self._period_s))
            self._check_counter(name, scales)
        first = next(iter(options.values())).line
        listening = protocol.plan(listening_to)
        plan = listening if self._dry_run else protocol.plan(commanded)
        line = Line(first)
        reply_s = longest_reply_s(line, plan, protocol.silence_chars)
        scheduler = BusScheduler(
            line,
            list(images.values()),
            protocol.silence_chars,
            0.0 if protocol.numbers_replies else self._reply_limit_s(next(iter(options)), reply_s),
            ahead_chars=protocol.ahead_chars,
            anonymous_reply_s=0.0 if protocol.numbers_replies or protocol.names_drives else reply_s,
            show=protocol.show,
        )
        bus = SerialBus(scheduler, protocol, axes, listening, plan)
        if not first.is_tcp:
            step = self._longest_step(bus, descriptions)
            silence, ahead = protocol.silence_chars, protocol.ahead_chars
            bus.rate = check_rate(plan, step, first, silence, ahead, self._period_s)
        return bus

    def _reply_limit_s(self, axis: str, least_s: float) -> float:
        """Return the time for which a drive that did not answer is not asked again, s; a reply may take ``least_s``.

        The time has to be so short that a single lost reply is no fault, and longer than any delay of a reply. Raises
        `OptionError`: the configuration gives a time that is shorter than a reply may take.
        """
        options = self._options[axis].line
        if options.reply_limit_s is None:
            return max(least_s, min(REPLY_LIMIT_S, _REPLY_LIMIT_FRACTION * self._max_missed * self._period_s))
        if options.reply_limit_s < least_s:
            raise OptionError(
                axis,
                "line.reply_limit_s",
                f"{options.reply_limit_s:g} s is too short for {options.port}: a reply may take "
                f"{least_s * 1e3:.3g} ms, and one that comes after the limit would be taken for a later one",
            )
        return options.reply_limit_s

    def _check_counter(self, axis: str, scales: SignalScales) -> None:
        """Refuse a position counter that could move by half its range while feedback is bridged."""
        if scales.position_bits is None:
            return
        bridged_s = self._period_s * (self._max_missed + 1)
        reach = self._configs[axis].limits.velocity * bridged_s
        half = abs(scales.of["position"]) * 2.0 ** (scales.position_bits - 1)
        if reach >= half:
            raise OptionError(
                axis,
                "limits.velocity",
                f"the position counter of {scales.position_bits} bits wraps within {2.0 * half:.4g}; at "
                f"limits.velocity the axis moves by {reach:.4g} in the {bridged_s:g} s for which lost feedback is "
                "bridged: lower the limit, the period or realtime.max_missed",
            )

    def _check_watchdog(self, axis: str, description: Description) -> None:
        if description.watchdog is None and self._options[axis].is_watchdog_required and not self._dry_run:
            raise OptionError(
                axis,
                "is_watchdog_required",
                f"{description.name} has no communication watchdog in its description: if the daemon dies, its torque "
                "stays. Set is_watchdog_required: false to accept that",
            )

    def _longest_step(self, bus: SerialBus, descriptions: Mapping[str, Description]) -> Exchange | None:
        """Return the exchange, of all steps of sequences, that takes longest on the wire."""
        if self._dry_run:
            return None
        steps = []
        for name, description in descriptions.items():
            if description.state_machine == "cia402":
                steps.append(bus.write_exchange(name, ("control",)))
            sequences = (description.enable, description.disable, description.quick_stop, description.reset_fault)
            every = itertools.chain(*sequences, self._watchdog_steps(name, description))
            steps += [bus.write_exchange(name, step.write) for step in every]
        return max(steps, key=lambda step: step.request_size + step.reply_size, default=None)

    def prepare(self, bus: SerialBus, descriptions: Mapping[str, Description]) -> list[AxisFacts]:
        """Read the state of all drives on an open line, and write their configuration; none is enabled.

        Raises `DriveError`: a drive does not answer, refuses, is powered already, or does not match its description.
        """
        if not bus.protocol.numbers_replies:
            bus.discard_input(REPLY_LIMIT_S)
        notes = {axis.name: self._prepare(bus, axis, descriptions[axis.name]) for axis in bus.axes}
        delay_s = _actuation_delay_s(bus, _poll_s(bus) if self._is_real else 0.0, self._period_s)
        return [self._facts(bus, axis, descriptions[axis.name], delay_s, notes[axis.name]) for axis in bus.axes]

    def _prepare(self, bus: SerialBus, axis: SerialAxis, description: Description) -> list[str]:
        """Prepare one drive; return notes for the user."""
        notes = [*bus.scheduler.line.notes()]
        if description.inferred:
            notes.append(str(_sources(axis.name, description)))
        temperature = _temperature_signals(self._configs[axis.name], description)
        for name in [n for n in description.units() if n in (*FAST, *SLOW, *temperature, *axis.state_signals)]:
            bus.transact(axis.name, bus.protocol.read(axis.name, (name,)))
        state = axis.read_state()
        if state is DriveState.UNKNOWN and not self._dry_run:
            shown = ", ".join(f"{name} = {axis.image.values[name]:g}" for name in axis.state_signals)
            text = f"{axis.name}: the drive reports a state that its description does not list: {shown}"
            raise DriveError(text, code=codes.STATE_UNKNOWN)
        if state.is_powered and not self._dry_run:
            text = (
                f"{axis.name}: the drive is in state {state.words} already: another master "
                "is driving it, or a former one left it enabled"
            )
            fix = "stop that master, or take the drive's power by friction-hil stop CONFIG"
            raise DriveError(text, fix, codes.ALREADY_POWERED)
        if not self._dry_run:
            for step in (*description.prepare, *description.modes[self._configs[axis.name].mode].prepare):
                write_step(bus, axis, description, step)
            notes.append(self._arm_watchdog(bus, axis, description))
        axis.hold()
        return notes

    def line_findings(self, bus: SerialBus) -> Iterator[Finding]:
        """Report the expected cycle time of a line; nothing is sent."""
        line = bus.scheduler.line
        if (found := ports.latency(ports.name_of(line.options.port))) is not None:
            needed_s = bus.wire_s(*bus.plan.push, *bus.plan.poll) + line.latency_s
            if needed_s > self._period_s:
                detail = f"{found.detail}: with the wire's time a cycle takes {1e3 * needed_s:.3g} ms, the period is "
                found = replace(found, result="fail", detail=f"{detail}{1e3 * self._period_s:g} ms", code="FH-415")
            yield found
        if bus.rate:
            yield Finding(f"rate of {', '.join(axis.name for axis in bus.axes)}", "pass", bus.rate)

    def drive_findings(self, axis: str, description: Description) -> Iterator[Finding]:
        """Report the sources of a drive's description and its watchdog; nothing is sent.

        Raises `UsageError`: the time of its watchdog does not fit the period.
        """
        yield _sources(axis, description)
        if description.watchdog is not None or not self._options[axis].is_watchdog_required:
            yield self._watchdog(axis, description)

    def _facts(
        self, bus: SerialBus, axis: SerialAxis, description: Description, delay_s: float, notes: list[str]
    ) -> AxisFacts:
        config, options = self._configs[axis.name], self._options[axis.name]
        scales, signals = axis.scales, description.units()
        torque = next((name for name in ("torque_command", "torque") if name in signals), None)
        resolution = abs(scales.of["position"]) * signals["position"].step
        if options.counts_per_unit is not None:  # a position in revolutions has more digits than the encoder resolves
            resolution = max(resolution, 1.0 / options.counts_per_unit)
        return AxisFacts(
            name=axis.name,
            identity=f"{description.name}, {options.address} on {options.line.port}",
            position_resolution=resolution,
            torque_resolution=0.0 if torque is None else abs(scales.of[torque]) * signals[torque].step,
            setpoint_delay_s=_setpoint_delay_s(delay_s, config.mode, options.setpoint_delay_cycles, self._period_s),
            actuation_delay_s=delay_s,
            notes=(*notes, bus.rate) if bus.rate else tuple(notes),
            torque_delay_s=_torque_delay_s(bus.plan, self._period_s),
            takes_torque="torque_command" in description.modes[config.mode].commands
            or config.compensation.is_by_position,
        )

    def _arm_watchdog(self, bus: SerialBus, axis: SerialAxis, description: Description) -> str:
        if description.watchdog is None:
            return self._watchdog(axis.name, description).detail
        return arm_watchdog(bus, axis, description, self._watchdog_steps(axis.name, description))

    def _watchdog(self, axis: str, description: Description) -> Finding:
        """Report whether the drive is to drop its torque when the daemon dies; no drive is asked."""
        check = f"{axis}: watchdog"
        if description.watchdog is None:
            return Finding(
                check,
                "warn",
                "the drive does NOT watch the daemon: if the daemon dies, its last torque stays",
                "keep the emergency stop in reach",
                "FH-418",
            )
        signal = description.watchdog.signal
        time_s = self._watchdog_steps(axis, description)[0].write[signal] * description.units()[signal].scale
        detail = f"{time_s * 1e3:g} ms without a command are to end the drive's torque"
        unread = sorted(name for name in description.watchdog_signals if not description.can_be_read(name))
        if unread:
            detail += f"; nothing reads {' and '.join(unread)} of the drive: it cannot be read back"
            return Finding(check, "warn", detail, "describe a request that reads it", "FH-420")
        return Finding(check, "pass", f"{detail}; run writes it and reads it back")

    def _watchdog_steps(self, axis: str, description: Description) -> tuple[Step, ...]:
        try:
            return watchdog_steps(description, self._watchdog_s(axis))
        except ValueError as error:
            raise OptionError(axis, "watchdog_s", str(error)) from None

    def _watchdog_s(self, axis: str) -> float:
        given = self._options[axis].watchdog_s
        least_s = _LEAST_WATCHDOG_PERIODS * self._period_s
        if given is not None and given < least_s:
            text = f"{given:g} s is less than three periods, {least_s:g} s"
            raise OptionError(axis, "watchdog_s", text)
        return given or max(_WATCHDOG_PERIODS * self._period_s, _LEAST_WATCHDOG_S)


def longest_reply_s(line: Line, plan: Plan, silence_chars: float) -> float:
    """Return the longest time from a request to the end of its reply, s."""
    longest_s = max(wire_s((each,), line.options, silence_chars) for each in (*plan.poll, *plan.background, *plan.push))
    return longest_s + _LATENESS_S + line.latency_s


def by_port(axes: "Mapping[str, AxisConfig]") -> Sequence[list[str]]:
    """Return the names of the axes on each line."""
    ports: dict[str, list[str]] = {}
    for name, axis in axes.items():
        ports.setdefault(options_of(axis).line.port, []).append(name)
    return list(ports.values())


def options_of(axis: "AxisConfig") -> SerialOptions:
    """Return the options of an axis on a serial line."""
    assert isinstance(axis.options, SerialOptions)
    return axis.options


def descriptions_of(
    axes: "Mapping[str, AxisConfig]", beside: Path | None, directory: Path, kind: type[Description]
) -> dict[str, Description]:
    """Read the descriptions of the drives of some axes; see `load_description`."""
    return {
        name: load_description(options_of(axis).description, beside, directory, kind) for name, axis in axes.items()
    }


def _temperature_signals(config: "AxisConfig", description: Description) -> tuple[str, ...]:
    """Return the signal of the temperature, if the drive has one and a friction model of the axis depends on it."""
    models = (config.model, *(shadow.model for shadow in config.shadows))
    is_needed = any(model.friction_model.depends_on_temperature for model in models)
    return (TEMPERATURE,) if is_needed and TEMPERATURE in description.units() else ()


def _torque_delay_s(plan: Plan, period_s: float) -> float | None:
    """Return the mean age of the torque at the time of the position, s; a background read is one to N periods old."""
    if any("torque" in exchange.reads for exchange in plan.poll):
        return 0.0
    is_background = any("torque" in exchange.reads for exchange in plan.background)
    return 0.5 * (1 + len(plan.background)) * period_s if is_background else None


def _poll_s(bus: SerialBus) -> float:
    """Measure the median time that the poll of a cycle takes on this line, s."""
    took = []
    for _ in range(_MEASURED_CYCLES):
        began = time.perf_counter()
        bus.transact(bus.axes[0].name, *bus.listening.poll)
        took.append(time.perf_counter() - began)
    return statistics.median(took)


def _actuation_delay_s(bus: SerialBus, poll_s: float, period_s: float) -> float:
    """Return the time from sampling a position to the middle of the period in which the resulting torque acts, s.

    A torque in the push acts as soon as its request is complete, a torque in the poll one period after the sample.
    Both are held for a period. ``poll_s`` is the measured time of the poll.
    """
    if not bus.plan.push:
        return 1.5 * period_s
    line = bus.scheduler.line.options
    if not line.is_tcp and poll_s:
        # the sample is taken when the request is complete
        poll_s -= bus.plan.poll[0].request_size * character_s(line)
        poll_s += bus.wire_s(*bus.plan.push)
    return min(max(poll_s, 0.0), period_s) + 0.5 * period_s


def _setpoint_delay_s(actuation_s: float, mode: str, cycles: float | None, period_s: float) -> float:
    """Return the time from sending a set-point until the drive follows it, s; ``cycles`` is the configured value."""
    if cycles is not None:
        return cycles * period_s
    return actuation_s + _INTERPOLATION_CYCLES[mode] * period_s


def _sources(axis: str, description: Description) -> Finding:
    """Report the signals of the description that were not taken from a manual."""
    check = f"{axis}: description"
    if not description.inferred:
        return Finding(check, "pass", f"{description.name}: none of its signals is marked as inferred")
    listed = ", ".join(description.inferred)
    detail = f"no manual was read for these of {description.name}: {listed}"
    return Finding(check, "warn", detail, "check them first, with run --dry-run", "FH-419")
