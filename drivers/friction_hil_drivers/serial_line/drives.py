"""Drives on serial lines, as the loop needs them; a protocol adds its codec and its descriptions.

A cycle on a line is the poll (feedback), and after the computation the push (commands) with a step of a sequence, if
one is due, or else one of the turns (what changes slowly), whose reply is there when the next cycle begins. Where one
exchange both writes and reads, the commands ride in the poll of the next cycle.

Several lines are served at once, from one thread.
"""

import contextlib
import os
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

from friction_hil.drive import AxisFacts, Clock, Command, Feedback, Request
from friction_hil.drive.finding import Finding, failure
from friction_hil.errors import BusError, DriveError, FrictionHilError, OptionError, UsageError
from friction_hil_drivers.serial_line import ports
from friction_hil_drivers.serial_line.axis import SerialAxis, unit_mistakes
from friction_hil_drivers.serial_line.connecting import Connecting, by_port, descriptions_of, options_of
from friction_hil_drivers.serial_line.conversation import Conversation
from friction_hil_drivers.serial_line.description import Description
from friction_hil_drivers.serial_line.lane import Lane, attend
from friction_hil_drivers.serial_line.line import Line, taken
from friction_hil_drivers.serial_line.protocol import Exchange, ProtocolFactory
from friction_hil_drivers.serial_line.selector import LineSelector

if TYPE_CHECKING:
    from friction_hil.config import AxisConfig, Configuration

_COMPUTATION_S = 3e-4  # of a period is kept for what comes after the feedback, at most a tenth of it
_STEPPED_TIMEOUT_NS = 10_000_000_000
_STEPPED_TIMEOUTS = 3  # in a row; in simulated time nothing else would ever end a run without drives
_PARTING_NS = 300_000_000
_REOPEN_S, _REOPEN_POLL_S = 0.3, 5e-3
_REFUSALS = 10  # of commands, in a row: the drive does not take them


class SerialDrives:
    """The drives of some axes; see `friction_hil.drive.Drives`. A protocol sets the class's attributes."""

    description_type: ClassVar[type[Description]]
    descriptions: ClassVar[Path]  # directory of the ready ones
    protocol: ClassVar[ProtocolFactory]

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
        connecting = Connecting(configuration, axes, cls.protocol, dry_run=False, is_real=False)
        for names in by_port(axes):
            if all(name in descriptions and name not in refused for name in names):
                try:
                    connecting.lane({name: descriptions[name] for name in names})
                except OptionError as error:
                    yield error.axis, error.key, UsageError(error.text)
                except FrictionHilError as error:
                    yield names[0], "line", error

    check_machine = staticmethod(ports.check_machine)

    @classmethod
    def check_connection(cls, configuration: "Configuration", axes: "Mapping[str, AxisConfig]") -> Iterator[Finding]:
        """Open each line and give it back, and tell what is known of it; see `friction_hil.drive.Driver`."""
        connecting = Connecting(configuration, axes, cls.protocol, dry_run=False, is_real=False)
        for names in by_port(axes):
            of_line = {name: axes[name] for name in names}
            yield _opened(Line(options_of(of_line[names[0]]).line), of_line)
            read: dict[str, Description] = {}
            for name in names:
                with contextlib.suppress(UsageError):  # here and below: check_files tells it
                    read |= descriptions_of(
                        {name: axes[name]}, configuration.source_path, cls.descriptions, cls.description_type
                    )
            if len(read) == len(names):
                with contextlib.suppress(FrictionHilError):
                    yield from connecting.line_findings(connecting.lane(read))
            for name, description in read.items():
                with contextlib.suppress(UsageError):
                    yield from connecting.drive_findings(name, description)

    def __init__(
        self, configuration: "Configuration", axes: "Mapping[str, AxisConfig]", clock: Clock, *, dry_run: bool
    ) -> None:
        self._configuration = configuration
        self._configs = dict(axes)
        self._clock = clock
        self._dry_run = dry_run
        self._margin_ns = round(min(_COMPUTATION_S, 0.1 * configuration.period_s) * 1e9)
        self._selector = LineSelector()  # for the wait that ends at the same time in each period
        self._lanes: list[Lane] = []
        self._conversations: list[Conversation] = []
        self._axes: list[SerialAxis] = []  # in the order of the configuration
        self._heard: list[Conversation] = []  # on which each of these is
        self._is_commanding = False  # something has been written since the start
        self._is_started = False
        self._is_heard = False  # what came until now, in a rehearsal
        self._end_ns = 0  # of the cycle
        self._time_s = 0.0  # of its feedback
        self._timeouts = 0

    def connect(self) -> Sequence[AxisFacts]:
        """Open the lines and prepare every drive; nothing is enabled. See `friction_hil.drive.Drives.connect`."""
        source = self._configuration.source_path
        descriptions = descriptions_of(self._configs, source, self.descriptions, self.description_type)
        connecting = Connecting(
            self._configuration,
            self._configs,
            type(self).protocol,
            dry_run=self._dry_run,
            is_real=self._clock.is_real,
        )
        facts: dict[str, AxisFacts] = {}
        made: dict[str, SerialAxis] = {}
        for names in by_port(self._configs):
            there = {name: descriptions[name] for name in names}
            lane = connecting.lane(there)
            self._lanes.append(lane)
            lane.conversation.line.open()
            made.update((axis.name, axis) for axis in lane.axes)
            facts.update((each.name, each) for each in connecting.prepare(lane, there))
        self._axes = [made[name] for name in self._configs]
        self._conversations = [lane.conversation for lane in self._lanes]
        on = {axis.name: lane.conversation for lane in self._lanes for axis in lane.axes}
        self._heard = [on[name] for name in self._configs]
        return [facts[name] for name in self._configs]

    def start(self) -> None:
        """Begin the cyclic phase."""
        for axis in self._axes:
            axis.image.fresh.clear()  # what was read before
        if self._clock.is_real:
            self._selector = LineSelector(round(self._configuration.period_s * 1e9))
        self._is_started = True

    def receive(self, feedback: Sequence[Feedback], end_ns: int) -> None:
        """Poll every drive until all have answered, or until it is too late for this cycle."""
        is_real = self._clock.is_real
        self._end_ns = end_ns
        limit_ns = end_ns - self._margin_ns if is_real else time.monotonic_ns() + _STEPPED_TIMEOUT_NS
        for lane in self._lanes:
            if not (lane.protocol.ahead_chars or lane.conversation.is_finished):
                lane.end_turn(limit_ns)
            # in simulated time the wire is none: what it would take says nothing of when a reply comes
            lane.poll(limit_ns if is_real else None, is_commanding=self._is_commanding, is_heard=self._is_heard)
        is_over = attend(self._conversations, limit_ns, self._selector)
        if is_over:
            self._timeouts = 0
        elif not is_real:
            self._note_timeout()
        self._is_heard = False
        for conversation in self._conversations:
            if not is_over or conversation.limit_ns is not None:
                conversation.give_up()
        self._time_s = time_s = self._clock.now_ns() * 1e-9
        for told, axis, conversation in zip(feedback, self._axes, self._heard, strict=True):
            axis.fill(told, time_s, conversation.trouble)
            if conversation.refusals.count >= _REFUSALS:
                told.message = f"the drive refuses its commands: {conversation.trouble}"

    def _note_timeout(self) -> None:
        self._timeouts += 1
        if self._timeouts >= _STEPPED_TIMEOUTS:
            waited_s = _STEPPED_TIMEOUTS * _STEPPED_TIMEOUT_NS * 1e-9
            raise DriveError(f"not every drive has answered for {waited_s:g} s: do they still run?")

    def send(self, commands: Sequence[Command]) -> None:
        """Write the commands, or put them where the next poll takes them; a dry run only asks."""
        end_ns = self._end_ns if self._clock.is_real else None
        steps: dict[str, Mapping[str, float]] = {}  # what is to be written beside the commands
        if not self._dry_run:
            for axis, command in zip(self._axes, commands, strict=True):
                if command.request is not Request.LISTEN:
                    self._is_commanding = True
                if step := axis.take(command, self._time_s):
                    steps[axis.name] = step
        is_said = True
        for lane in self._lanes:
            lane.send(steps, end_ns, is_commanding=self._is_commanding)
            if lane.conversation.queue:
                is_said = False
        if not is_said:  # a reply is awaited at the start of the next cycle only
            limit_ns = time.monotonic_ns() + _STEPPED_TIMEOUT_NS if end_ns is None else end_ns
            attend(self._conversations, limit_ns, LineSelector(), until_answered=False)

    def rehearse(self) -> None:
        """Take what came since the cycle before, which the cycle need not do then; see `Drives.rehearse`."""
        for conversation in self._conversations:
            if conversation.line.is_open:  # to get it back may take time
                conversation.step()
        self._selector.forget()
        self._is_heard = True

    def close(self) -> None:
        """See that no drive keeps its power, and leave the lines."""
        try:
            if self._is_started and self._is_commanding:
                for lane in self._lanes:
                    self._part(lane)
        finally:
            for lane in self._lanes:
                lane.conversation.line.close()
            self._selector.close()
            self._is_started = False

    def _part(self, lane: Lane) -> None:
        """Disable every drive of a line and write zero commands, whoever else does not answer."""
        line, end_s = lane.conversation.line, time.monotonic() + _REOPEN_S
        while not line.reopen() and time.monotonic() < end_s:  # it may be back since the last cycle
            time.sleep(_REOPEN_POLL_S)
        lane.end_turn(time.monotonic_ns() + _PARTING_NS)  # else its reply came upon what is to be written
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

    def _try(self, lane: Lane, axis: str, exchange: Exchange) -> None:
        with contextlib.suppress(BusError, DriveError):
            if lane.conversation.line.is_open:
                lane.talk(axis, exchange, attempts=1)


def _opened(line: Line, axes: "Mapping[str, AxisConfig]") -> Finding:
    """Open a line as the daemon does, and give it back; one that somebody else has is left alone."""
    port = line.options.port
    check = f"line of {', '.join(axes)}"
    try:
        # not each program locks a port; to open it would already change its settings
        if not line.options.is_tcp and (others := ports.holders(port)):
            raise taken(port, others)
        line.open()
    except FrictionHilError as error:
        found = failure(check, error)
        is_missing = isinstance(error, BusError) and (line.options.is_tcp or not os.path.exists(port))
        if is_missing and any(axis.simulation is not None for axis in axes.values()):
            found = replace(found, fix=f"{found.fix}; or start friction-hil simulate with this configuration")
        return found
    finally:
        line.close()
    return Finding(check, "pass", f"somebody listens at {port}" if line.options.is_tcp else f"{port} can be opened")
