"""Requests and replies on one line, one after the other, in small steps that never wait.

A reply belongs to the request before it, and serial protocols do not number them: a late reply looks like the
present one of the same drive. So a drive that did not answer in time is asked nothing more until its reply has come,
and was dropped, or cannot come any more. Others on the line are asked meanwhile, and what needs no reply is sent: a
drive that is silent must not keep another one from being stopped.
"""

import time
from collections import deque
from collections.abc import Callable, Iterable, Sequence

from friction_hil_drivers.serial_line.line import Line, LineGoneError
from friction_hil_drivers.serial_line.protocol import Exchange, Image, ReplyError
from friction_hil_drivers.serial_line.wire import character_s

_SHORT_SILENCE_NS = 2_000_000  # USB adapters hand over what they have each millisecond
_REOPEN_NS = 200_000_000
_SHOWN = 60  # characters


class Conversation:
    """All that is said on a line.

    Parameters
    ----------
    line : Line
    images : sequence of Image
        Of all axes on the line.
    silence_chars : float
        Silence that has to pass between frames, in characters.
    reply_limit_s : float
        Time after which a reply that did not come will not come any more; 0 where replies are numbered, so that a
        late one is known for what it is.
    now_ns : callable
        Monotonic time, ns.

    Attributes
    ----------
    trouble : str
        What went wrong last, in words.
    lost, late, refused, noise : int
        Requests without a reply in time; replies that came late; replies that were none; bytes that nobody had
        asked for.
    refusals : int
        Commands in a row that the drive refused.
    limit_ns : int or None
        When replies have to be there: what cannot be answered by then is not asked.
    """

    def __init__(
        self,
        line: Line,
        images: Sequence[Image],
        silence_chars: float,
        reply_limit_s: float,
        now_ns: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        self.line = line
        self._images = tuple(images)
        self._now_ns = now_ns
        serial = not line.options.is_tcp
        self._character_ns = character_s(line.options) * 1e9 if serial else 0.0
        self._silence_ns = round(silence_chars * self._character_ns)
        self._turnaround_ns = round(line.options.turnaround_s * 1e9)
        self._reply_limit_ns = round(reply_limit_s * 1e9)
        self._settle_ns = max(self._silence_ns, _SHORT_SILENCE_NS)
        self._queue: deque[tuple[Exchange, Callable[[], None] | None]] = deque()
        self._awaited: tuple[Exchange, Callable[[], None] | None] | None = None
        self._owed: list[tuple[Exchange, int]] = []  # not answered in time, and until when the reply may still come
        self._silent: frozenset[str] = frozenset()  # did not answer last time: asked after the others
        self._is_settling = False  # what comes belongs to a broken reply
        self._received = bytearray()
        self._sent_ns = self._heard_ns = self._quiet_until_ns = 0
        self._next_reopen_ns = 0
        self.trouble = ""
        self.limit_ns: int | None = None
        self.lost = self.late = self.refused = self.noise = self.refusals = 0

    @property
    def is_finished(self) -> bool:
        """Whether all has been asked and answered, or the line is gone."""
        return not self._queue and self._awaited is None

    @property
    def is_all_sent(self) -> bool:
        """Whether every request has been sent, answered or not."""
        return not self._queue

    @property
    def due_ns(self) -> int | None:
        """When `step` has something to do although nothing arrives; None: it has not."""
        if not self.line.is_open:
            return None
        if self._is_settling:
            return self._heard_ns + self._settle_ns
        if self._awaited is not None:
            return None
        if not self._owed:
            return self._quiet_until_ns if self._queue else None
        moments = [until for _, until in self._owed]
        if self._received:  # a late reply is coming in
            return min(moments)
        if any(self._may_be_asked(exchange) for exchange, _ in self._queue):
            moments.append(self._quiet_until_ns)
        return min(moments, default=None)

    def ask(self, exchanges: Iterable[Exchange], done: Callable[[], None] | None = None) -> None:
        """Queue requests; ``done`` is called when the last of them has been answered (sent, if no reply is due)."""
        self._queue.extend((exchange, None) for exchange in exchanges)
        if done is not None and self._queue:
            self._queue[-1] = (self._queue[-1][0], done)

    def step(self) -> None:
        """Do what can be done now."""
        if not self.line.is_open:
            self._reopen()
            return
        try:
            if data := self.line.read():
                self._received += data
                self._heard_ns = self._now_ns()
            while self._hear() and self._say():
                pass
        except LineGoneError as gone:
            self.trouble = str(gone)
            self._forget()

    def _hear(self) -> bool:
        """Deal with what came; whether the line is free for the next request."""
        now = self._now_ns()
        if self._is_settling:
            self._received.clear()
            self._is_settling = now < self._heard_ns + self._settle_ns
        elif self._awaited is not None:
            self._await(*self._awaited, now)
        else:
            self._drop_late(now)
        is_speaking = self._awaited is not None or self._is_settling or bool(self._owed and self._received)
        return not is_speaking and now >= self._quiet_until_ns

    def _await(self, exchange: Exchange, done: Callable[[], None] | None, now: int) -> None:
        try:
            if not (self._received and exchange.take(self._received)):
                return
        except ReplyError as error:
            self.refused += 1
            self.refusals += bool(error.is_complete and exchange.writes)
            self.trouble = f"{exchange.what}: {error}"
            self._is_settling = not error.is_complete
        else:
            self._silent -= exchange.addressees
            if exchange.writes:
                self.refusals = 0
            if done is not None:
                done()
        self._awaited = None
        self._quiet_until_ns = now + self._silence_ns

    def _drop_late(self, now: int) -> None:
        """Take a reply of an earlier cycle for what it is; it is not fresh."""
        if not self._owed:
            return
        if self._received:
            fresh = [set(image.fresh) for image in self._images]
            exchange, _ = self._owed[0]
            try:
                is_complete = exchange.take(self._received)
            except ReplyError as error:
                # of another one who owes a reply, or broken: who did not answer goes on owing
                self.refused += 1
                is_complete, self._is_settling = False, True
                self.trouble = f"late, {exchange.what}: {error}"
            for image, names in zip(self._images, fresh, strict=True):
                image.fresh = names
            if is_complete:
                self.late += 1
                del self._owed[0]
                self._quiet_until_ns = now + self._silence_ns
        self._owed = [(exchange, until) for exchange, until in self._owed if now < until]

    def _may_be_asked(self, exchange: Exchange) -> bool:
        """Whether a late reply could not be taken for one to this request."""
        return not exchange.reply_size or all(exchange.addressees.isdisjoint(owed.unanswered) for owed, _ in self._owed)

    def _say(self) -> bool:
        """Send the next request; whether another one may follow at once."""
        if not self._queue:
            return False
        place = self._next_place() if self._owed or self._silent else 0
        if place is None:
            return False
        if self._received:
            self.noise += len(self._received)
            self.trouble = f"not asked for: {_shown(self._received)}"
            self._received.clear()
        exchange, done = self._queue[place]
        del self._queue[place]
        if self.limit_ns is not None and self._now_ns() + self._wire_ns(exchange) > self.limit_ns:
            # the reply would be late, the next cycle begin with waiting for it, and so would all after that
            self.lost += 1
            self.trouble = f"{exchange.what}: no time was left for it"
            self._queue.clear()
            return False
        data = exchange.encode()
        self.line.write(data)
        self._sent_ns = self._now_ns()
        if exchange.reply_size:
            self._awaited = exchange, done
            return False
        self._quiet_until_ns = self._sent_ns + round(len(data) * self._character_ns) + self._silence_ns
        if done is not None:
            done()
        return True

    def _next_place(self) -> int | None:
        """Where in the queue the request is that is to be made now: whoever was silent comes after the others."""
        places = [k for k, (exchange, _) in enumerate(self._queue) if self._may_be_asked(exchange)]
        return min(places, key=lambda k: self._is_silent(self._queue[k][0]), default=None)

    def _is_silent(self, exchange: Exchange) -> bool:
        return exchange.reply_size > 0 and not self._silent.isdisjoint(exchange.addressees)

    def _wire_ns(self, exchange: Exchange) -> float:
        """Least time until the reply is there."""
        silence = self._silence_ns if exchange.reply_size else 0
        return (exchange.request_size + exchange.reply_size) * self._character_ns + silence + self._turnaround_ns

    def give_up(self) -> None:
        """End a cycle: what has not been asked is not asked any more, and what is not answered is lost."""
        self._queue.clear()
        self.limit_ns = None
        if self._awaited is not None:
            exchange, _ = self._awaited
            self._owe()
            self._silent |= exchange.unanswered
            self.lost += 1
            self.trouble = f"{exchange.what}: no reply in time"

    def _owe(self) -> None:
        """Go on without the reply that is awaited; it may still come."""
        if self._awaited is not None and self._reply_limit_ns:
            self._owed.append((self._awaited[0], self._sent_ns + self._reply_limit_ns))
        self._awaited = None

    def _forget(self) -> None:
        self._queue.clear()
        self._received.clear()
        self._owe()  # a converter in between may keep it until the line is back
        self._is_settling = False
        self._next_reopen_ns = self._now_ns() + _REOPEN_NS

    def _reopen(self) -> None:
        self._queue.clear()  # what was to be said now is not to be said later
        now = self._now_ns()
        if now >= self._next_reopen_ns:
            self._next_reopen_ns = now + _REOPEN_NS
            self.line.reopen()


def _shown(data: bytes | bytearray) -> str:
    return repr(bytes(data[:_SHOWN])) + (" ..." if len(data) > _SHOWN else "")
