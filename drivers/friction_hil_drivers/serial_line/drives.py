"""Drives on serial lines, as the loop needs them; a protocol adds its codec and its descriptions.

A cycle on a line is the poll (feedback), one of the turns (what changes slowly), and after the computation the push
(commands) with a step of a sequence, if one is due. Where one exchange both writes and reads, the commands ride in
the poll of the next cycle. Several lines are served at once, from one thread.
"""

import contextlib
import itertools
import select
import statistics
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

from friction_hil.drive import AxisFacts, Clock, Command, DriveState, Feedback, Request
from friction_hil.errors import BusError, DriveError, UsageError
from friction_hil_drivers.serial_line.axis import Scales, SerialAxis, make_scales
from friction_hil_drivers.serial_line.conversation import Conversation
from friction_hil_drivers.serial_line.description import Description, Step, load_description
from friction_hil_drivers.serial_line.line import Line
from friction_hil_drivers.serial_line.options import SerialOptions
from friction_hil_drivers.serial_line.protocol import (
    FAST,
    SLOW,
    Exchange,
    Image,
    LineProtocol,
    Plan,
    ProtocolFactory,
    Wanted,
)
from friction_hil_drivers.serial_line.sequences import state_signals, watchdog_steps
from friction_hil_drivers.serial_line.wire import character_s, check_rate, exchange_s

if TYPE_CHECKING:
    from friction_hil.config import AxisConfig, Configuration

_COMPUTATION_S = 3e-4  # of a period is kept for what comes after the feedback, at most a tenth of it
_STEPPED_TIMEOUT_S = 10.0
_STEPPED_TIMEOUTS = 3  # in a row; in simulated time nothing else would ever end a run without drives
_ATTEMPTS = 3
_ATTEMPT_S = 0.3
_REPLY_LIMIT_S, _REPLY_LIMIT_SHARE = 0.05, 0.4
_MEASURED_CYCLES = 25
_WATCHDOG_PERIODS, _LEAST_WATCHDOG_PERIODS, _LEAST_WATCHDOG_S = 20, 3, 0.1
_LATENESS_S = 2e-3  # of a reply, beside the adapter's latency
_INTERPOLATION_CYCLES = {"csp": 1.0, "csv": 0.5, "cst": 0.0}  # between set-points, beside half a period as for torques
_REFUSALS = 10  # of commands, in a row: the drive does not take them


@dataclass(slots=True)
class _Lane:
    """One line with what is said on it."""

    conversation: Conversation
    protocol: LineProtocol
    axes: list[SerialAxis]
    listening: Plan
    plan: Plan  # the same as listening in a dry run
    rate: str  # what a cycle takes on the wire, for people
    turn: int = 0
    is_step_sent: bool = False  # in the cycle before, in the place of a turn
    first: int = 0  # axis that may send a step first
    steps: dict[tuple[str, tuple[str, ...]], Exchange] = field(default_factory=dict)

    def questions(self, plan: Plan) -> tuple[Exchange, ...]:
        """Exchanges of the next cycle before its computation."""
        if not plan.turns or self.is_step_sent:
            return plan.poll
        self.turn = (self.turn + 1) % len(plan.turns)
        return *plan.poll, plan.turns[self.turn]

    def send(self, steps: Mapping[str, Mapping[str, float]]) -> None:
        """Ask for a step, of one axis and in every second cycle (one has to hear what it did), and for the push."""
        may_step = not self.is_step_sent
        self.is_step_sent = False
        for axis in (*self.axes[self.first :], *self.axes[: self.first]):
            if may_step and (step := steps[axis.name]):
                axis.image.values.update(step)
                self.conversation.ask((self.write(axis.name, step),), axis.sequencer.acknowledge)
                self.first = (self.axes.index(axis) + 1) % len(self.axes)
                self.is_step_sent = True
                break
        self.conversation.ask(self.plan.push)

    def write(self, axis: str, names: Iterable[str]) -> Exchange:
        """Exchange for a step; each is made once."""
        key = axis, tuple(names)
        if key not in self.steps:
            self.steps[key] = self.protocol.write(*key)
        return self.steps[key]


class SerialDrives:
    """The drives of some axes; see `friction_hil.drive.Drives`. A protocol sets the class's attributes."""

    description_type: ClassVar[type[Description]]
    descriptions: ClassVar[Path]  # directory of the ready ones
    protocol: ClassVar[ProtocolFactory]

    def __init__(
        self, configuration: "Configuration", axes: "Mapping[str, AxisConfig]", clock: Clock, *, dry_run: bool
    ) -> None:
        self._configuration = configuration
        self._configs = dict(axes)
        self._clock = clock
        self._dry_run = dry_run
        self._period_s = configuration.period_s
        self._lanes: list[_Lane] = []
        self._conversations: list[Conversation] = []
        self._axes: list[SerialAxis] = []  # in the order of the configuration
        self._places = {name: place for place, name in enumerate(self._configs)}
        self._is_commanding = False  # something has been written since the start
        self._is_started = False
        self._end_ns = 0  # of the cycle
        self._timeouts = 0

    def connect(self) -> Sequence[AxisFacts]:
        """Open the lines and prepare every drive; nothing is enabled. See `friction_hil.drive.Drives.connect`."""
        source = self._configuration.source_path
        descriptions = {
            name: load_description(_options(axis).description, source, self.descriptions, self.description_type)
            for name, axis in self._configs.items()
        }
        ports: dict[str, list[str]] = {}
        for name, axis in self._configs.items():
            ports.setdefault(_options(axis).line.port, []).append(name)
        facts: dict[str, AxisFacts] = {}
        made: dict[str, SerialAxis] = {}
        for names in ports.values():
            lane = self._make_lane({name: descriptions[name] for name in names})
            self._lanes.append(lane)
            lane.conversation.line.open()
            made.update((axis.name, axis) for axis in lane.axes)
            notes = {name: self._prepare(lane, made[name], descriptions[name]) for name in names}
            delay_s = _actuation_delay_s(lane, self._measure(lane) if self._clock.is_real else 0.0, self._period_s)
            for name in names:
                facts[name] = self._facts(lane, made[name], descriptions[name], delay_s, notes[name])
        self._axes = [made[name] for name in self._configs]
        self._conversations = [lane.conversation for lane in self._lanes]
        return [facts[name] for name in self._configs]

    def _make_lane(self, descriptions: Mapping[str, Description]) -> _Lane:
        configs = {name: self._configs[name] for name in descriptions}
        options = {name: _options(config) for name, config in configs.items()}
        images = {name: Image() for name in configs}
        protocol = type(self).protocol(descriptions, options, images)
        axes, wanted, heard = [], {}, {}
        for name, config in configs.items():
            description = descriptions[name]
            signals = description.units()
            mode = description.modes.get(config.mode)
            if mode is None:
                raise DriveError(
                    f"{name}: {description.name} cannot be commanded in mode {config.mode}; its description has "
                    f"{', '.join(description.modes)}"
                )
            scales = make_scales(
                name,
                description,
                options[name].units,
                kind=config.model.axis,
                is_inverted=options[name].is_inverted,
            )
            fast = tuple(signal for signal in FAST if signal in signals)
            slow = tuple(signal for signal in signals if signal in (*SLOW, *state_signals(description)))
            wanted[name] = Wanted(fast, slow, mode.commands)
            heard[name] = Wanted(fast, slow, ())
            before = (*mode.prepare, *watchdog_steps(description, self._watchdog_s(name)))
            axes.append(SerialAxis(name, description, scales, images[name], mode.commands, before))
            self._check_counter(name, scales)
        first = next(iter(options.values())).line
        listening = protocol.plan(heard)
        plan = listening if self._dry_run else protocol.plan(wanted)
        line = Line(first)
        limit_s = 0.0 if protocol.numbers_replies else self._reply_limit_s(line, plan, protocol.silence_chars)
        conversation = Conversation(line, list(images.values()), protocol.silence_chars, limit_s)
        lane = _Lane(conversation, protocol, axes, listening, plan, rate="")
        if not first.is_tcp:
            step = self._longest_step(lane, descriptions)
            lane.rate = check_rate(plan, step, first, protocol.silence_chars, self._period_s)
        return lane

    def _reply_limit_s(self, line: Line, plan: Plan, silence_chars: float) -> float:
        """Time for which a drive that did not answer is not asked again.

        A lost reply alone must be no fault; but a reply must not be late by more than this.

        Raises
        ------
        UsageError
            The configuration's is shorter than replies may take.
        """
        options = line.options
        longest_s = max(exchange_s(each, options, silence_chars) for each in (*plan.poll, *plan.turns, *plan.push))
        least_s = (0.0 if options.is_tcp else longest_s) + _LATENESS_S + line.latency_s
        if options.reply_limit_s is None:
            bridged_s = self._configuration.realtime.max_missed * self._period_s
            return max(least_s, min(_REPLY_LIMIT_S, _REPLY_LIMIT_SHARE * bridged_s))
        if options.reply_limit_s < least_s:
            raise UsageError(
                f"line.reply_limit_s: {options.reply_limit_s:g} s is too short for {options.port}: a reply may take "
                f"{least_s * 1e3:.3g} ms, and one that comes after the limit would be taken for a later one"
            )
        return options.reply_limit_s

    def _check_counter(self, axis: str, scales: Scales) -> None:
        """See that a counter cannot go half round while feedback is bridged."""
        if scales.position_bits is None:
            return
        bridged_s = self._period_s * (self._configuration.realtime.max_missed + 1)
        reach = self._configs[axis].limits.velocity * bridged_s
        half = abs(scales.of["position"]) * 2.0 ** (scales.position_bits - 1)
        if reach >= half:
            raise UsageError(
                f"{axis}: the position counter of {scales.position_bits} bits wraps within {2.0 * half:.4g}; at "
                f"limits.velocity the axis moves by {reach:.4g} in the {bridged_s:g} s for which lost feedback is "
                "bridged: lower the limit, the period or realtime.max_missed"
            )

    def _longest_step(self, lane: _Lane, descriptions: Mapping[str, Description]) -> Exchange | None:
        """The exchange of a sequence that takes longest beside the cycle."""
        if self._dry_run:
            return None
        steps = []
        for name, description in descriptions.items():
            if description.state_machine == "cia402":
                steps.append(lane.write(name, ("control",)))
            sequences = (description.enable, description.disable, description.quick_stop, description.reset_fault)
            every = itertools.chain(*sequences, watchdog_steps(description, _LEAST_WATCHDOG_S))
            steps += [lane.write(name, step.write) for step in every]
        return max(steps, key=lambda step: step.request_size + step.reply_size, default=None)

    def _prepare(self, lane: _Lane, axis: SerialAxis, description: Description) -> list[str]:
        """Read all that an axis tells, write what has to be there before it is enabled; what the user should know."""
        config, options = self._configs[axis.name], _options(self._configs[axis.name])
        line = lane.conversation.line
        notes = [*line.notes(), *_inferred(description)]
        for name in [n for n in description.units() if n in (*FAST, *SLOW, *axis.state_signals)]:
            self._talk(lane, axis.name, lane.protocol.read(axis.name, (name,)))
        state = axis.read_state()
        if state is DriveState.UNKNOWN and not self._dry_run:
            told = ", ".join(f"{name} = {axis.image.values[name]:g}" for name in axis.state_signals)
            raise DriveError(f"{axis.name}: the drive tells no state that its description knows: {told}")
        if state.is_powered and not self._dry_run:
            raise DriveError(
                f"{axis.name}: the drive is in state {state.name.lower().replace('_', ' ')} already: another master "
                "is driving it, or a former one left it enabled; disable it first"
            )
        if not self._dry_run:
            for step in (*description.prepare, *description.modes[config.mode].prepare):
                self._write(lane, axis, step)
            notes += self._arm_watchdog(lane, axis, description, options)
        axis.hold()
        return notes

    def _facts(
        self, lane: _Lane, axis: SerialAxis, description: Description, delay_s: float, notes: list[str]
    ) -> AxisFacts:
        config, options = self._configs[axis.name], _options(self._configs[axis.name])
        line, scales = lane.conversation.line, axis.scales
        signals = description.units()
        resolution = abs(scales.of["position"]) * signals["position"].step
        if options.counts_per_unit is not None:  # a position in turns is printed finer than the encoder is
            resolution = max(resolution, 1.0 / options.counts_per_unit)
        return AxisFacts(
            name=axis.name,
            identity=f"{description.name}, {options.address} on {line.options.port}",
            position_resolution=resolution,
            torque_resolution=abs(scales.of["torque_command"]) * signals["torque_command"].step,
            setpoint_delay_s=_setpoint_delay_s(delay_s, config.mode, options.setpoint_delay_cycles, self._period_s),
            actuation_delay_s=delay_s,
            notes=(*notes, lane.rate) if lane.rate else tuple(notes),
        )

    def _arm_watchdog(
        self, lane: _Lane, axis: SerialAxis, description: Description, options: SerialOptions
    ) -> list[str]:
        if description.watchdog is None:
            if options.is_watchdog_required:
                raise DriveError(
                    f"{axis.name}: {description.name} has no communication watchdog in its description: if the daemon "
                    "dies, its torque stays. Set is_watchdog_required: false to accept that"
                )
            return ["the drive does NOT watch the daemon: if the daemon dies, its last torque stays"]
        time_s = self._watchdog_s(axis.name)
        for step in watchdog_steps(description, time_s):
            self._write(lane, axis, step)
        return [f"the drive watches the daemon: {time_s * 1e3:g} ms without a command end its torque"]

    def _watchdog_s(self, axis: str) -> float:
        given = _options(self._configs[axis]).watchdog_s
        least_s = _LEAST_WATCHDOG_PERIODS * self._period_s
        if given is not None and given < least_s:
            raise UsageError(f"{axis}: watchdog_s: {given:g} s is less than three periods, {least_s:g} s")
        return given or max(_WATCHDOG_PERIODS * self._period_s, _LEAST_WATCHDOG_S)

    def _write(self, lane: _Lane, axis: SerialAxis, step: Step) -> None:
        """Write a step of the preparations, wait for what it should lead to."""
        axis.image.values.update(step.write)
        self._talk(lane, axis.name, lane.write(axis.name, step.write))
        end = time.monotonic() + step.timeout_s
        while step.until is not None:
            for name in axis.state_signals:
                self._talk(lane, axis.name, lane.protocol.read(axis.name, (name,)))
            state = axis.read_state()
            if state.name.lower() == step.until:
                return
            if time.monotonic() > end:
                raise DriveError(
                    f"{axis.name}: {dict(step.write)} should lead to {step.until} within {step.timeout_s:g} s; "
                    f"the drive is in {state.name.lower()}"
                )

    def _talk(self, lane: _Lane, axis: str, exchange: Exchange, attempts: int = _ATTEMPTS) -> None:
        """Have one exchange before or after the cyclic phase, patiently.

        Raises
        ------
        DriveError
            No usable reply came, several times.
        """
        conversation, is_done = lane.conversation, False

        def done() -> None:
            nonlocal is_done
            is_done = True

        limit_s = max(_ATTEMPT_S, 2.0 * (conversation.line.options.reply_limit_s or 0.0))
        for _ in range(attempts):
            conversation.ask((exchange,), done)
            self._serve([conversation], time.monotonic_ns() + round(limit_s * 1e9), lambda: conversation.is_finished)
            if is_done:
                return
            conversation.give_up()
            if not conversation.line.is_open:
                raise BusError(f"{axis}: {conversation.trouble}")
        raise DriveError(
            f"{axis}: {exchange.what}: {conversation.trouble or 'no reply'} ({attempts} attempts). Right address, "
            f"port and baud rate ({conversation.line.options.baud})?"
        )

    def _measure(self, lane: _Lane) -> float:
        """Median time that the poll of a cycle takes on this line, with one of its turns, s."""
        took = []
        for _ in range(_MEASURED_CYCLES):
            began = time.perf_counter()
            for exchange in lane.questions(lane.listening):
                self._talk(lane, lane.axes[0].name, exchange)
            took.append(time.perf_counter() - began)
        return statistics.median(took)

    def start(self) -> None:
        """Begin the cyclic phase."""
        self._is_started = True

    def receive(self, feedback: Sequence[Feedback], end_ns: int) -> None:
        """Poll every drive until all have answered, or until it is too late for this cycle."""
        for axis in self._axes:
            axis.begin()
        for lane in self._lanes:
            lane.conversation.ask(lane.questions(lane.plan if self._is_commanding else lane.listening))
        conversations = self._conversations
        is_real = self._clock.is_real
        self._end_ns = end_ns
        margin_s = min(_COMPUTATION_S, 0.1 * self._period_s)
        limit_ns = end_ns - round(margin_s * 1e9) if is_real else time.monotonic_ns() + round(_STEPPED_TIMEOUT_S * 1e9)
        for conversation in conversations:
            conversation.limit_ns = limit_ns
        self._serve(conversations, limit_ns, self._are_finished)
        is_lost = not self._are_finished()
        for conversation in conversations:
            conversation.give_up()
        self._timeouts = self._timeouts + 1 if is_lost and not is_real else 0
        if self._timeouts >= _STEPPED_TIMEOUTS:
            waited_s = _STEPPED_TIMEOUTS * _STEPPED_TIMEOUT_S
            raise DriveError(f"not every drive has answered for {waited_s:g} s: do they still run?")
        time_s = self._clock.now_ns() * 1e-9
        for lane in self._lanes:
            for axis in lane.axes:
                told = feedback[self._places[axis.name]]
                axis.fill(told, time_s, lane.conversation.trouble)
                if lane.conversation.refusals >= _REFUSALS:
                    told.message = f"the drive refuses its commands: {lane.conversation.trouble}"

    def send(self, commands: Sequence[Command]) -> None:
        """Write the commands, or put them where the next poll takes them; a dry run writes nothing."""
        if self._dry_run:
            return
        time_s = self._clock.now_ns() * 1e-9
        steps: dict[str, Mapping[str, float]] = {}
        for axis, command in zip(self._axes, commands, strict=True):
            if command.request is not Request.LISTEN:
                self._is_commanding = True
            steps[axis.name] = axis.take(command, time_s)
        if not self._is_commanding:
            return
        for lane in self._lanes:
            lane.send(steps)
        # the last reply is awaited at the start of the next cycle
        limit_ns = self._end_ns if self._clock.is_real else time.monotonic_ns() + round(_STEPPED_TIMEOUT_S * 1e9)
        self._serve(self._conversations, limit_ns, self._is_all_sent)

    def _serve(self, conversations: Sequence[Conversation], limit_ns: int, is_done: Callable[[], bool]) -> None:
        """Let the conversations go on until ``is_done()``, or until the monotonic clock is at ``limit_ns``."""
        while True:
            for conversation in conversations:
                conversation.step()
            if is_done():
                return
            now = time.monotonic_ns()
            if now >= limit_ns:
                return
            next_ns, lines = limit_ns, []
            for conversation in conversations:
                if (due := conversation.due_ns) is not None and due < next_ns:
                    next_ns = due
                if conversation.line.is_open and not conversation.is_finished:
                    lines.append(conversation.line.descriptor)
            select.select(lines, (), (), max(0.0, (next_ns - now) * 1e-9))

    def _are_finished(self) -> bool:
        return all(lane.conversation.is_finished for lane in self._lanes)

    def _is_all_sent(self) -> bool:
        return all(lane.conversation.is_all_sent for lane in self._lanes)

    def rehearse(self) -> None:
        """Do nothing: a cycle on a serial line waits for the wire anyway."""

    def close(self) -> None:
        """See that no drive keeps its power, and leave the lines."""
        try:
            if self._is_started and self._is_commanding:
                for lane in self._lanes:
                    self._part(lane)
        finally:
            for lane in self._lanes:
                lane.conversation.line.close()
            self._is_started = False

    def _part(self, lane: _Lane) -> None:
        """Disable every drive of a line and write zero commands, whoever else does not answer."""
        farewell = []
        for axis in lane.axes:
            axis.hold()
            farewell += [(axis, write) for write in axis.parting()]
        for axis, write in farewell:
            axis.image.values.update(write)
            self._try(lane, axis.name, lane.write(axis.name, write))
        for exchange in (*lane.plan.poll, *lane.plan.push):
            if exchange.writes:
                self._try(lane, lane.axes[0].name, exchange)

    def _try(self, lane: _Lane, axis: str, exchange: Exchange) -> None:
        with contextlib.suppress(BusError, DriveError):
            if lane.conversation.line.is_open:
                self._talk(lane, axis, exchange, attempts=1)


def _actuation_delay_s(lane: _Lane, poll_s: float, period_s: float) -> float:
    """From sampling a position to the middle of the time in which the torque computed from it acts, s.

    A torque that is pushed acts as soon as its request is complete; one that rides in the poll, a period after the
    sample. Either holds for a period. ``poll_s`` is what the poll took when it was measured.
    """
    if not lane.plan.push:
        return 1.5 * period_s
    line, silence = lane.conversation.line.options, lane.protocol.silence_chars
    if not line.is_tcp and poll_s:
        # the sample is taken when the request is complete
        poll_s -= lane.plan.poll[0].request_size * character_s(line)
        poll_s += sum(exchange_s(exchange, line, silence) for exchange in lane.plan.push)
    return min(max(poll_s, 0.0), period_s) + 0.5 * period_s


def _setpoint_delay_s(actuation_s: float, mode: str, cycles: float | None, period_s: float) -> float:
    """From sending a set-point to the drive's demand being equal to it, s; ``cycles`` is what the user knows of it."""
    if cycles is not None:
        return cycles * period_s
    return actuation_s + _INTERPOLATION_CYCLES[mode] * period_s


def _inferred(description: Description) -> list[str]:
    if not description.inferred:
        return []
    listed = ", ".join(description.inferred)
    return [f"no manual was read for these of {description.name}; check them first, with --dry-run: {listed}"]


def _options(axis: "AxisConfig") -> SerialOptions:
    assert isinstance(axis.options, SerialOptions)
    return axis.options
