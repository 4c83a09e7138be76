"""One line in use: its drives, what a cycle on it consists of, and the waiting for replies."""

import select
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

from friction_hil.errors import BusError, DriveError
from friction_hil_drivers.serial_line.axis import SerialAxis
from friction_hil_drivers.serial_line.batch import Batch
from friction_hil_drivers.serial_line.conversation import Conversation
from friction_hil_drivers.serial_line.line import LineGoneError
from friction_hil_drivers.serial_line.protocol import Exchange, LineProtocol, Plan
from friction_hil_drivers.serial_line.selector import LineSelector
from friction_hil_drivers.serial_line.wire import wire_s

_ATTEMPTS = 5
_ATTEMPT_S = 0.3
_TURN_SHARE = 0.25


@dataclass(frozen=True, slots=True)
class _Batches:
    """What goes out in a cycle in which nothing is unusual."""

    poll: Batch
    endings: tuple[Batch, ...]  # in turn: the push and one of the turns


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
    _listening: _Batches = field(init=False)
    _commanding: _Batches = field(init=False)

    def __post_init__(self) -> None:
        self._listening, self._commanding = self._batches(self.listening), self._batches(self.plan)

    def _batches(self, plan: Plan) -> _Batches:
        endings = [(*plan.push, turn) for turn in plan.turns] or ([plan.push] if plan.push else [])
        return _Batches(self._batch(plan.poll, plan.turns), tuple(map(self._batch, endings)))

    def _batch(self, exchanges: tuple[Exchange, ...], before: Iterable[Exchange] = ()) -> Batch:
        keeps_silence = self.conversation.keeps_silence
        return Batch.of(exchanges, self.wire_s(*exchanges), before, keeps_silence=keeps_silence)

    def poll(self, limit_ns: int | None, *, is_commanding: bool, is_heard: bool) -> None:
        """Ask for the feedback of a cycle.

        Parameters
        ----------
        limit_ns : int or None
            When it has to be there: what would come later is not asked.
        is_commanding : bool
            As planned for a cycle in which all is written; else for one in which nothing is.
        is_heard : bool
            What has come before was read a moment ago.
        """
        conversation = self.conversation
        batch = (self._commanding if is_commanding else self._listening).poll
        is_heard = is_heard or bool(conversation.awaited)  # what is awaited is read when all has been asked
        if is_heard and conversation.say_at_once(batch, limit_ns):
            return
        conversation.limit_ns = limit_ns
        conversation.ask(batch.exchanges)
        if is_heard:
            conversation.go_on()
        else:
            conversation.step()

    def send(self, steps: Mapping[str, Mapping[str, float]], end_ns: int | None, *, is_commanding: bool) -> None:
        """Write the push, and a step of one axis in every second cycle (one has to hear what it did).

        Where no step is due, one of the turns follows: so late that no command has to wait for it. Its reply is
        there when the next cycle begins.

        Parameters
        ----------
        steps : mapping
            What is to be written for the state that is wanted, by axis; of those that need anything.
        end_ns : int or None
            When the next cycle begins; a turn that would reach into that is left out.
        is_commanding : bool
            As in `poll`; otherwise there are no steps.
        """
        conversation = self.conversation
        endings = (self._commanding if is_commanding else self._listening).endings
        if endings and not steps:
            place = (self.turn + 1) % len(endings)
            if conversation.say_at_once(endings[place], end_ns):
                self.turn, self.is_step_sent = place, False
                return
        conversation.limit_ns = None  # of a poll that did not come to its end
        plan = self.plan if is_commanding else self.listening
        self.is_step_sent = bool(steps) and not self.is_step_sent and self._take_step(steps)
        conversation.ask(plan.push)
        if not self.is_step_sent:
            self._take_turn(plan, endings, end_ns)
        conversation.speak()

    def _take_step(self, steps: Mapping[str, Mapping[str, float]]) -> bool:
        """Ask for a step of the next axis that has one; whether there is any."""
        for axis in (*self.axes[self.first :], *self.axes[: self.first]):
            if step := steps.get(axis.name):
                axis.image.values.update(step)
                self.conversation.ask((self.write(axis.name, step),), axis.sequencer.acknowledge)
                self.first = (self.axes.index(axis) + 1) % len(self.axes)
                return True
        return False

    def _take_turn(self, plan: Plan, endings: tuple[Batch, ...], end_ns: int | None) -> None:
        """Ask for what changes slowly, for the next of the turns, if that is answered before the next cycle."""
        if not plan.turns:
            return
        place = (self.turn + 1) % len(plan.turns)
        turn = plan.turns[place]
        if end_ns is not None and time.monotonic_ns() + endings[place].wire_ns > end_ns:
            if not self.conversation.trouble:
                self.conversation.trouble = f"{turn.what}: no time was left for it"
            return
        self.turn = place
        self.conversation.ask((turn,))

    def end_turn(self, limit_ns: int) -> None:
        """Wait for what the last cycle has asked, for a share of the time to a moment: others are to be asked too."""
        conversation = self.conversation
        conversation.limit_ns = None  # as in `send`
        now = time.monotonic_ns()
        conversation.step()
        if not attend((conversation,), now + round(_TURN_SHARE * (limit_ns - now)), LineSelector()):
            conversation.give_up()

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
            conversation.step()
            attend([conversation], time.monotonic_ns() + round(limit_s * 1e9), LineSelector())
            if is_done:
                return
            conversation.give_up()
            if not conversation.line.is_open:
                raise BusError(f"{axis}: {conversation.trouble}")
        options, told = conversation.line.options, conversation.trouble or "no reply"
        if not any(exchange.what in told for exchange in exchanges):
            told = f"{' and '.join(exchange.what for exchange in exchanges)}: {told}"
        right = "address and port" if options.is_tcp else f"address, port and baud rate ({options.baud})"
        raise DriveError(f"{axis}: {told} ({attempts} attempts). Right {right}?")


def attend(
    conversations: Sequence[Conversation],
    limit_ns: int,
    selector: LineSelector,
    *,
    until_answered: bool = True,
) -> bool:
    """Let conversations go on until all has been said, or until the monotonic clock is at ``limit_ns``.

    Parameters
    ----------
    conversations : sequence of Conversation
    limit_ns : int
        Monotonic time, ns.
    selector : LineSelector
        If it knows a period, the limit is to be the same in each.
    until_answered : bool
        Wait for the replies, too, not only until all is sent.

    Returns
    -------
    bool
        Whether that is done.
    """
    while True:
        lines: list[int] = []
        for conversation in conversations:
            if conversation.queue or (until_answered and conversation.awaited):
                # open: a line that is gone has nothing to say
                lines.append(conversation.line.descriptor)  # noqa: PERF401  a comprehension is one function more
        if not lines:
            return True
        now = time.monotonic_ns()
        if now >= limit_ns:
            return False
        next_ns = limit_ns
        for conversation in conversations:
            # who awaits a reply has no other date: asked several times a cycle
            if not conversation.awaited and (due := conversation.due_ns) is not None and due < next_ns:
                next_ns = due
        ready = selector.wait(lines, next_ns, now, is_periodic=next_ns == limit_ns)
        for conversation in conversations:
            if conversation.line.descriptor in ready:
                conversation.step(is_ready=True)
            elif (due := conversation.due_ns) is not None and due <= time.monotonic_ns():
                conversation.step()
