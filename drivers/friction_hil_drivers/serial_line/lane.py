"""One line in use: its drives, what a cycle on it consists of, and the waiting for replies."""

import select
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field

from friction_hil.errors import BusError, DriveError
from friction_hil_drivers.serial_line.axis import SerialAxis
from friction_hil_drivers.serial_line.conversation import Conversation
from friction_hil_drivers.serial_line.line import LineGoneError
from friction_hil_drivers.serial_line.protocol import Exchange, LineProtocol, Plan
from friction_hil_drivers.serial_line.wire import wire_s

_ATTEMPTS = 5
_ATTEMPT_S = 0.3
_TURN_SHARE = 0.25


@dataclass(slots=True)
class Lane:
    """One line with what is said on it.

    Attributes
    ----------
    listening, plan : Plan
        A cycle in which nothing is written, and one in which all is; the same in a dry run.
    rate : str
        What a cycle takes on the wire, for people.
    """

    conversation: Conversation
    protocol: LineProtocol
    axes: list[SerialAxis]
    listening: Plan
    plan: Plan
    rate: str = ""
    turn: int = 0
    is_step_sent: bool = False  # in the cycle before, in the place of a turn
    first: int = 0  # axis that may send a step first
    steps: dict[tuple[str, tuple[str, ...]], Exchange] = field(default_factory=dict)
    wire_times_ns: dict[tuple[Exchange, ...], int] = field(default_factory=dict)

    def send(self, steps: Mapping[str, Mapping[str, float]], end_ns: int | None) -> None:
        """Ask for the push and for a step, of one axis and in every second cycle (one has to hear what it did).

        Where no step is due, one of the turns follows: so late that no command has to wait for it. Its reply is
        there when the next cycle begins.

        Parameters
        ----------
        steps : mapping
            What is to be written for the state that is wanted, by axis.
        end_ns : int or None
            When the next cycle begins; a turn that would reach into that is left out.
        """
        may_step = not self.is_step_sent
        self.is_step_sent = False
        if may_step:
            for axis in (*self.axes[self.first :], *self.axes[: self.first]):
                if step := steps[axis.name]:
                    axis.image.values.update(step)
                    self.conversation.ask((self.write(axis.name, step),), axis.sequencer.acknowledge)
                    self.first = (self.axes.index(axis) + 1) % len(self.axes)
                    self.is_step_sent = True
                    break
        self.conversation.ask(self.plan.push)
        if not self.is_step_sent:
            self.take_turn(self.plan, end_ns)

    def take_turn(self, plan: Plan, end_ns: int | None) -> None:
        """Ask for what changes slowly, for the next of the turns, if that is answered before the next cycle."""
        if not plan.turns:
            return
        turn = (self.turn + 1) % len(plan.turns)
        if end_ns is not None and time.monotonic_ns() + self._wire_ns(*plan.push, plan.turns[turn]) > end_ns:
            return
        self.turn = turn
        self.conversation.ask((plan.turns[turn],))

    def end_turn(self, limit_ns: int) -> None:
        """Wait for what the last cycle has asked, for a share of the time to a moment: others are to be asked too."""
        conversation = self.conversation
        now = time.monotonic_ns()
        serve([conversation], now + round(_TURN_SHARE * (limit_ns - now)), lambda: conversation.is_finished)
        if not conversation.is_finished:
            conversation.give_up()

    def _wire_ns(self, *exchanges: Exchange) -> int:
        if exchanges not in self.wire_times_ns:
            self.wire_times_ns[exchanges] = round(1e9 * self.wire_s(*exchanges))
        return self.wire_times_ns[exchanges]

    def write(self, axis: str, names: Iterable[str]) -> Exchange:
        """Exchange for a step; each is made once."""
        key = axis, tuple(names)
        if key not in self.steps:
            self.steps[key] = self.protocol.write(*key)
        return self.steps[key]

    def wire_s(self, *exchanges: Exchange) -> float:
        """Least time that exchanges in a row take, s."""
        protocol = self.protocol
        return wire_s(exchanges, self.conversation.line.options, protocol.silence_chars, protocol.ahead_chars)

    def drain(self, time_s: float) -> None:
        """Drop what comes in so long a time: replies to a master that was here before.

        Raises
        ------
        BusError
            The line is gone.
        """
        line, end = self.conversation.line, time.monotonic() + time_s
        while (left := end - time.monotonic()) > 0.0:
            if select.select([line.descriptor], (), (), left)[0]:
                try:
                    line.read()
                except LineGoneError as gone:
                    raise BusError(str(gone)) from gone

    def talk(self, axis: str, *exchanges: Exchange, attempts: int = _ATTEMPTS) -> None:
        """Have exchanges before or after the cyclic phase, patiently.

        Raises
        ------
        DriveError
            No usable reply came, several times.
        BusError
            The line is gone.
        """
        conversation, is_done = self.conversation, False

        def done() -> None:
            nonlocal is_done
            is_done = True

        limit_s = max(_ATTEMPT_S, 2.0 * (conversation.line.options.reply_limit_s or 0.0))
        for _ in range(attempts):
            conversation.ask(exchanges, done)
            serve([conversation], time.monotonic_ns() + round(limit_s * 1e9), lambda: conversation.is_finished)
            if is_done:
                return
            conversation.give_up()
            if not conversation.line.is_open:
                raise BusError(f"{axis}: {conversation.trouble}")
        what = " and ".join(exchange.what for exchange in exchanges)
        raise DriveError(
            f"{axis}: {what}: {conversation.trouble or 'no reply'} ({attempts} attempts). Right address, "
            f"port and baud rate ({conversation.line.options.baud})?"
        )


def serve(conversations: Sequence[Conversation], limit_ns: int, is_done: Callable[[], bool]) -> None:
    """Let conversations go on until ``is_done()``, or until the monotonic clock is at ``limit_ns``."""
    for conversation in conversations:
        conversation.step()
    while not is_done():
        now = time.monotonic_ns()
        if now >= limit_ns:
            return
        next_ns, lines = limit_ns, []
        for conversation in conversations:
            if (due := conversation.due_ns) is not None and due < next_ns:
                next_ns = due
            if conversation.line.is_open and not conversation.is_finished:
                lines.append(conversation.line.descriptor)
        ready = select.select(lines, (), (), max(0.0, (next_ns - now) * 1e-9))[0]
        for conversation in conversations:
            if conversation.line.descriptor in ready:
                conversation.step(is_ready=True)
            elif (due := conversation.due_ns) is not None and due <= time.monotonic_ns():
                conversation.step()
