"""Serial bus: a line, its drives, and the requests of a cycle."""

import select
import time
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, field
from functools import partial

from friction_hil.errors import BusError, DriveError
from friction_hil_drivers.serial_line import codes
from friction_hil_drivers.serial_line.axis import SerialAxis
from friction_hil_drivers.serial_line.line import LineGoneError
from friction_hil_drivers.serial_line.options import LineOptions
from friction_hil_drivers.serial_line.protocol import Exchange, LineProtocol, Plan
from friction_hil_drivers.serial_line.scheduler import BusScheduler
from friction_hil_drivers.serial_line.waiting import LineSelector, run_schedulers
from friction_hil_drivers.serial_line.wire import wire_s

_ATTEMPTS = 5
_ATTEMPT_S = 0.3
_BACKGROUND_FRACTION = 0.25  # of the time until the feedback is due: longest wait for a background read


@dataclass(slots=True)
class SerialBus:
    """Line with the drives on it."""

    scheduler: BusScheduler
    protocol: LineProtocol
    axes: list[SerialAxis]
    listening: Plan  # requests of a cycle that only reads
    plan: Plan  # requests of a cycle that also writes the commands; the same as `listening` in a dry run
    rate: str = ""  # time of a cycle on the wire, as text
    _selector: LineSelector = field(default_factory=LineSelector)
    is_commanded: bool = False  # the last cycle had commands
    commands: dict[str, frozenset[Exchange]] = field(default_factory=dict)  # that carry those of an axis
    _background_index: int = 0
    _is_step_turn: bool = True  # False after a step: its effect has to be read first
    _last_step: Exchange | None = None
    _stops: Mapping[str, Mapping[str, float]] = field(default_factory=dict)  # steps to a stop that are due, by axis
    _first_axis: int = 0  # index of the axis that may send a step first
    _steps: dict[tuple[str, tuple[str, ...]], Exchange] = field(default_factory=dict)
    _reads: dict[tuple[str, str], Exchange] = field(default_factory=dict)
    _ending_ns: dict[Exchange, int] = field(default_factory=dict)  # of push and a background read on the wire

    def __post_init__(self) -> None:
        for plan in (self.listening, self.plan):
            self._ending_ns |= {each: round(1e9 * self.wire_s(*plan.push, each)) for each in plan.background}
        writing = [each for each in (*self.plan.poll, *self.plan.push) if each.writes]
        for axis in self.axes:
            drive = self.read_exchange(axis.name, "position").addressees
            self.commands[axis.name] = frozenset(each for each in writing if drive <= each.addressees)

    def request_feedback(self, deadline_ns: int | None, *, is_commanding: bool, is_read: bool) -> None:
        """Send the poll of a cycle.

        If a drive owes replies, the line may have time for a single request to it: a step to a stop that could not be
        sent goes first.

        ``deadline_ns``: a reply that would be complete later is not requested. ``is_commanding``: the cycle writes the
        commands. ``is_read``: the bytes that have arrived were read shortly before.
        """
        scheduler = self.scheduler
        scheduler.deadline_ns = deadline_ns
        is_read = is_read or bool(scheduler.outstanding)  # outstanding replies are read when everything has been sent
        if self._stops and self._last_step not in scheduler.sent:
            self._enqueue_step(self._stops)
        scheduler.queue.extend((self.plan if is_commanding else self.listening).poll)
        if is_read:
            scheduler.advance()
        else:
            scheduler.poll()

    def send_commands(
        self,
        # values to write for the requested state, by axis; axes that need none are left out
        steps: Mapping[str, Mapping[str, float]],
        end_ns: int | None,  # when the next cycle begins; a background read that would not end by then is left out
        *,
        is_commanding: bool,  # if false, there are no steps
        stopping: Collection[str],  # axes whose step leads to a stop
    ) -> None:
        """Send the push, and in every second cycle a step of one axis (its effect has to be read in between).

        If no step is due, one background read follows the commands, so that none of them waits for it. Its reply has
        arrived when the next cycle begins.
        """
        scheduler = self.scheduler
        if scheduler.sent:
            self._is_step_turn = self._last_step not in scheduler.sent
        self._stops = {}
        scheduler.sent.clear()
        self.is_commanded = is_commanding
        scheduler.deadline_ns = None
        plan = self.plan if is_commanding else self.listening
        is_step_queued = bool(steps) and self._is_step_turn and self._enqueue_step(steps)
        scheduler.queue.extend(plan.push)
        if plan.background and not is_step_queued:
            index = (self._background_index + 1) % len(plan.background)
            exchange = plan.background[index]
            if end_ns is None or time.monotonic_ns() + self._ending_ns[exchange] <= end_ns:
                self._background_index = index
                scheduler.queue.append(exchange)
            elif not scheduler.last_error:
                scheduler.last_error = f"{exchange.label}: no time was left for it"
        if not scheduler.state.is_normal:
            scheduler.flush()
        elif scheduler.queue or scheduler.line.descriptor < 0:
            scheduler.advance()
        if is_step_queued and stopping and not scheduler.state.is_normal:
            self._stops = {axis: step for axis, step in steps.items() if axis in stopping}

    def _enqueue_step(self, steps: Mapping[str, Mapping[str, float]]) -> bool:
        """Queue a step of the next axis that has one; return True if any axis has.

        What has to be read back is read in the next turn: a period has room for one exchange beside the poll.
        """
        for axis in (*self.axes[self._first_axis :], *self.axes[: self._first_axis]):
            if step := steps.get(axis.name):
                reads = [self.read_exchange(axis.name, name) for name in axis.to_read_back(step)]
                if reads and axis.written == step:
                    self._last_step = reads[-1]
                    self.scheduler.enqueue(reads, partial(axis.acknowledge, step))
                else:
                    axis.image.values.update(step)
                    done = partial(axis.note_written if reads else axis.acknowledge, step)
                    self._last_step = self.write_exchange(axis.name, step)
                    self.scheduler.enqueue((self._last_step,), done)
                self._first_axis = (self.axes.index(axis) + 1) % len(self.axes)
                return True
        return False

    def finish_background_read(self, deadline_ns: int) -> None:
        """Wait for the reply to the last background read, at most for a fraction of the time until ``deadline_ns``."""
        scheduler = self.scheduler
        scheduler.deadline_ns = None
        now = time.monotonic_ns()
        scheduler.poll()
        until_ns = now + round(_BACKGROUND_FRACTION * (deadline_ns - now))
        if not run_schedulers((scheduler,), until_ns, self._selector):
            scheduler.end_cycle()

    def write_exchange(self, axis: str, names: Iterable[str]) -> Exchange:
        """Return the exchange that writes some signals of an axis; each is made once."""
        key = axis, tuple(names)
        if key not in self._steps:
            self._steps[key] = self.protocol.write(*key)
        return self._steps[key]

    def read_exchange(self, axis: str, name: str) -> Exchange:
        """Return the exchange that reads one signal of an axis; each is made once."""
        key = axis, name
        if key not in self._reads:
            self._reads[key] = self.protocol.read(axis, (name,))
        return self._reads[key]

    def wire_s(self, *exchanges: Exchange) -> float:
        """Compute the least time that successive exchanges take, s."""
        protocol = self.protocol
        return wire_s(exchanges, self.scheduler.line.options, protocol.silence_chars, protocol.ahead_chars)

    def discard_input(self, time_s: float) -> None:
        """Drop the bytes that arrive within ``time_s``: replies to requests of an earlier master.

        Raises `BusError`: the line is gone.
        """
        line, end = self.scheduler.line, time.monotonic() + time_s
        while (left := end - time.monotonic()) > 0.0:
            if select.select([line.descriptor], (), (), left)[0]:
                try:
                    line.read()
                except LineGoneError as gone:
                    raise BusError(str(gone), code=codes.LINE_LOST) from gone

    def transact(self, axis: str, *exchanges: Exchange, attempts: int = _ATTEMPTS) -> None:
        """Perform exchanges before or after the cyclic phase, with several attempts.

        Raises `DriveError`: no usable reply came in any attempt; `BusError`: the line is gone.
        """
        scheduler, is_done, began_ns = self.scheduler, False, time.monotonic_ns()

        def done() -> None:
            nonlocal is_done
            is_done = True

        limit_s = max(_ATTEMPT_S, 2.0 * (scheduler.line.options.reply_limit_s or 0.0))
        for _ in range(attempts):
            scheduler.enqueue(exchanges, done)
            scheduler.poll()
            run_schedulers([scheduler], time.monotonic_ns() + round(limit_s * 1e9), self._selector)
            if is_done:
                return
            scheduler.end_cycle()
            if not scheduler.line.is_open:
                raise BusError(f"{axis}: {scheduler.last_error}", code=codes.LINE_LOST)
        options, text = scheduler.line.options, scheduler.last_error or "no reply"
        if not any(exchange.label in text for exchange in exchanges):
            text = f"{' and '.join(exchange.label for exchange in exchanges)}: {text}"
        text = f"{axis}: {text} ({attempts} attempts)"
        if scheduler.last_answer != scheduler.last_error or not scheduler.last_answer:  # an answer needs no question
            text += f". {self._question(options, is_any_received=scheduler.received_ns >= began_ns)}"
        raise DriveError(text, code=codes.NO_REPLY)

    def _question(self, options: LineOptions, *, is_any_received: bool) -> str:
        """Return what may be wrong where no valid reply came."""
        if not is_any_received:
            right = "address and port" if options.is_tcp else f"address, port and baud rate ({options.baud})"
            return f"Right {right}?"
        settings = f"baud rate {options.baud}, parity {options.parity}, {options.stop_bits:g} stop bits, "
        right = "protocol and description" if options.is_tcp else f"{settings}protocol and description"
        return f"Bytes arrive, but no valid reply ({self.protocol.reply_form}). Right {right}?"
