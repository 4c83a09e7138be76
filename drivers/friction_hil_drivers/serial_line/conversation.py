"""Requests and replies on one line, in order, in small steps that never wait.

A reply belongs to the request before it, and serial protocols do not number them: a late reply looks like the
present one of the same drive. So a drive that did not answer in time is asked nothing more until its reply has come,
and was dropped, or cannot come any more. Others on the line are asked meanwhile, and what needs no reply is sent: a
drive that is silent must not keep another one from being stopped.

Where replies do not even tell which drive they are from, one that comes later than expected would be another axis's
feedback. There, after a reply that did not come or was broken, the next one is dropped, and all that follows until the
line has been quiet for as long as a reply takes: drives answer in order, so what is from before has come by then.

Requests go out together where the drives read ahead and no reply to one of them could be taken for one to another:
a cycle then wakes up once.
"""

import time
from collections import deque
from collections.abc import Callable, Iterable, Sequence

from friction_hil_drivers.serial_line.line import Line, LineGoneError
from friction_hil_drivers.serial_line.protocol import Exchange, Image, ReplyError, shown
from friction_hil_drivers.serial_line.wire import character_s

_SHORT_SILENCE_NS = 2_000_000  # USB adapters hand over what they have each millisecond
_REOPEN_NS = 200_000_000
_LONGEST_SETTLE_NS = 20_000_000  # a line that is not quiet by then will not be
_MOST_UNCONFIRMED = 8

Asked = tuple[Exchange, Callable[[], None] | None]


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
    ahead_chars : int
        Characters of requests that may be sent before the first of them is answered; 0: one request at a time.
    doubt_s : float
        Time that a reply takes at most where nothing holds it up, on a line on which replies do not tell which of
        several drives they are from; 0 where they do.
    now_ns : callable
        Monotonic time, ns.

    Attributes
    ----------
    trouble : str
        What went wrong last, in words.
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
        *,
        ahead_chars: int = 0,
        doubt_s: float = 0.0,
    ) -> None:
        self.line = line
        self._images = tuple(images)
        self._now_ns = now_ns
        serial = not line.options.is_tcp
        self._character_ns = character_s(line.options) * 1e9 if serial else 0.0
        self._silence_ns = round(silence_chars * self._character_ns)
        self._turnaround_ns = round(line.options.turnaround_s * 1e9)
        self._reply_limit_ns = round(reply_limit_s * 1e9)
        self._settle_ns = self._short_settle_ns = max(self._silence_ns, _SHORT_SILENCE_NS)
        self._doubt_ns = max(self._short_settle_ns, round(doubt_s * 1e9)) if doubt_s else 0
        self._is_in_doubt = False  # what comes next may be a reply to something before
        self._ahead_chars = ahead_chars
        self._unread_chars = 0  # sent since a drive answered last: it may not have looked at them yet
        self._queue: deque[Asked] = deque()
        self._awaited: deque[Asked] = deque()  # sent together, answered in this order
        self._unconfirmed: deque[Exchange] = deque(maxlen=_MOST_UNCONFIRMED)  # sent without a reply: may be refused
        self._is_refused = False  # one of these was
        self._owed: list[tuple[Exchange, int]] = []  # not answered in time, and until when the reply may still come
        self._silent: frozenset[str] = frozenset()  # did not answer last time: asked after the others
        self._is_settling = False  # what comes belongs to a broken reply
        self._settle_end_ns = 0
        self._is_noisy = False  # the line did not fall silent: what needs no reply does not wait for that
        self._received = bytearray()
        self._sent_ns = self._heard_ns = self._quiet_until_ns = self._busy_until_ns = 0
        self._next_reopen_ns = 0
        self.trouble = ""
        self.limit_ns: int | None = None
        self.refusals = 0

    @property
    def is_finished(self) -> bool:
        """Whether all has been asked and answered, or the line is gone."""
        return not self._queue and not self._awaited

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
            return min(self._heard_ns + self._settle_ns, self._settle_end_ns)
        if self._awaited:
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
        self._queue.extend([(exchange, None) for exchange in exchanges])
        if done is not None and self._queue:
            self._queue[-1] = (self._queue[-1][0], done)

    def step(self, *, is_ready: bool = False) -> None:
        """Do what can be done now.

        Parameters
        ----------
        is_ready : bool
            The operating system says that something has come.
        """
        if not self.line.is_open:
            self._reopen()
            return
        try:
            if data := self.line.read(is_ready=is_ready):
                self._received += data
                self._heard_ns = self._now_ns()
            self._go_on()
        except LineGoneError as gone:
            self._forget(gone)

    def speak(self) -> None:
        """Send what can be sent now; what has to wait for a late reply is not sent in this cycle."""
        if self._owed:
            self.step()
            self._queue = deque(asked for asked in self._queue if self._may_be_asked(asked[0]))
        elif self.line.is_open:
            try:
                self._go_on()
            except LineGoneError as gone:
                self._forget(gone)

    def _go_on(self) -> None:
        while self._hear() and self._say():
            pass

    def _hear(self) -> bool:
        """Deal with what came; whether the line is free for the next request."""
        now = self._now_ns()
        if self._is_settling:
            self._received.clear()
            if now >= self._heard_ns + self._settle_ns:
                self._is_settling = self._is_noisy = False
            elif now >= self._settle_end_ns:
                self._is_settling, self._is_noisy = False, True
                self._is_in_doubt = self._doubt_ns > 0
        elif self._awaited:
            self._await(now)
        elif self._owed:
            self._drop_late(now)
        if self._awaited:
            return bool(self._ahead_chars) and self._may_join(0)
        if self._is_noisy and self._queue and not self._queue[0][0].reply_size:
            return now >= self._quiet_until_ns
        return not self._is_settling and not (self._owed and self._received) and now >= self._quiet_until_ns

    def _await(self, now: int) -> None:
        """Take the replies that are complete; in the order of the requests."""
        while self._awaited:
            exchange, done = self._awaited[0]
            is_last = len(self._awaited) == 1
            try:
                if not (self._received and self._is_taken(exchange)):
                    return
            except ReplyError as error:
                if self._is_of_unconfirmed(error):  # the reply proper follows
                    continue
                self.refusals += bool(error.is_complete and exchange.writes)
                self.trouble = f"{exchange.what}: {error}"
                if not error.is_complete:
                    self._is_in_doubt = self._doubt_ns > 0
                    if is_last:  # where another reply follows, it is told from what is left of this one
                        self._settle(self._short_settle_ns)
            else:
                if self._is_in_doubt:
                    done = None
                    self.trouble = f"{exchange.what}: the reply may have been one to an earlier request"
                    if is_last:
                        self._is_in_doubt = False
                        self._settle(self._doubt_ns)
                self._is_noisy = False
                if self._silent:
                    self._silent -= exchange.addressees
                if exchange.writes:
                    self.refusals = 0
                if self._unconfirmed or self._is_refused:
                    self._confirm(exchange)
                self._unread_chars = 0
                if done is not None:
                    done()
            self._awaited.popleft()
            self._quiet_until_ns = now + self._silence_ns

    def _settle(self, time_ns: int) -> None:
        """Drop all that comes, until the line has been quiet for so long."""
        self._is_settling, self._settle_ns = True, time_ns
        self._settle_end_ns = self._now_ns() + max(_LONGEST_SETTLE_NS, 2 * time_ns)

    def _is_taken(self, exchange: Exchange) -> bool:
        """Whether a reply is complete; in doubt nothing of it is used."""
        return self._take_in_vain(exchange) if self._is_in_doubt else exchange.take(self._received)

    def _take_in_vain(self, exchange: Exchange) -> bool:
        before = [(dict(image.values), set(image.fresh)) for image in self._images]
        try:
            return exchange.take(self._received)
        finally:
            for image, (values, fresh) in zip(self._images, before, strict=True):
                image.values, image.fresh = values, fresh

    def _is_of_unconfirmed(self, error: ReplyError) -> bool:
        """Whether an error is that of a request without a reply; then that one is refused."""
        if not (error.is_unasked and self._unconfirmed):
            return False
        self.refusals += 1
        self._is_refused = True
        self.trouble = f"{self._unconfirmed.pop().what}: {error}"
        return True

    def _confirm(self, exchange: Exchange) -> None:
        """Note that a drive answered: what was sent to it before, without a reply, it has not refused."""
        rest = [each for each in self._unconfirmed if not each.addressees <= exchange.addressees]
        if len(rest) < len(self._unconfirmed) and not self._is_refused:
            self.refusals = 0
        self._is_refused = False
        self._unconfirmed.clear()
        self._unconfirmed.extend(rest)

    def _drop_late(self, now: int) -> None:
        """Take a reply of an earlier cycle for what it is: nothing of it is used."""
        if self._received:
            exchange, _ = self._owed[0]
            try:
                is_complete = self._take_in_vain(exchange)
            except ReplyError as error:
                is_complete = False
                if not self._is_of_unconfirmed(error):
                    # of another one who owes a reply, or broken: who did not answer goes on owing
                    self._settle(self._short_settle_ns)
                    self.trouble = f"late, {exchange.what}: {error}"
            if is_complete:
                del self._owed[0]
                self._quiet_until_ns = now + self._silence_ns
        if any(now >= until for _, until in self._owed):
            self._owed = [(exchange, until) for exchange, until in self._owed if now < until]
            self._is_in_doubt = self._doubt_ns > 0

    def _may_be_asked(self, exchange: Exchange) -> bool:
        """Whether a late reply could not be taken for one to this request."""
        return not exchange.reply_size or all(exchange.addressees.isdisjoint(owed.unanswered) for owed, _ in self._owed)

    def _say(self) -> bool:
        """Send the next request, or several together; whether another one may follow at once."""
        if not self._queue:
            return False
        is_disturbed = bool(self._owed or self._silent)
        place = self._next_place() if is_disturbed else 0
        if place is None:
            return False
        if self._received and not self._awaited:  # else it is the beginning of a reply that is due
            self._take_unasked()
        data = b""
        sent: list[Callable[[], None]] = []
        while True:
            exchange, done = self._queue[place]
            del self._queue[place]
            if self.limit_ns is not None and not self._has_time(exchange):
                # the reply would be late, the next cycle begin with waiting for it, and so would all after that
                self.trouble = f"{exchange.what}: no time was left for it"
                self._queue.clear()
                break
            data += exchange.encode()
            if exchange.reply_size:
                self._awaited.append((exchange, done))
            else:
                if exchange.tells_refusal:
                    self._unconfirmed.append(exchange)
                if done is not None:
                    sent.append(done)
            if is_disturbed or not self._queue or not self._may_join(len(data)):
                break
        if data:
            self._send(data)
        for done in sent:
            done()
        return not self._awaited

    def _may_join(self, chars: int) -> bool:
        """Whether the next request may be sent together with those before it, which have so many characters."""
        if not self._queue or self._silence_ns or self._is_in_doubt:
            return False
        if not self._awaited:
            return not (self._is_noisy and self._queue[0][0].reply_size)
        exchange, _ = self._queue[0]
        if self._unread_chars + chars + exchange.request_size > self._ahead_chars:
            return False
        return all(exchange.may_follow(before) for before, _ in self._awaited)

    def _send(self, data: bytes) -> None:
        self.line.write(data)
        self._unread_chars += len(data)
        self._sent_ns = self._now_ns()
        self._busy_until_ns = max(self._busy_until_ns, self._sent_ns) + round(len(data) * self._character_ns)
        if not self._awaited:
            self._quiet_until_ns = self._busy_until_ns + self._silence_ns if self._silence_ns else 0

    def _has_time(self, exchange: Exchange) -> bool:
        """Whether an exchange can be over in this cycle."""
        assert self.limit_ns is not None
        silence = self._silence_ns if exchange.reply_size else 0
        wire_ns = (exchange.request_size + exchange.reply_size) * self._character_ns + silence + self._turnaround_ns
        return max(self._now_ns(), self._busy_until_ns) + wire_ns <= self.limit_ns

    def _take_unasked(self) -> None:
        """Look at what came without a question: refusals of what has no reply; the rest is noise."""
        while self._unconfirmed and self._received:
            try:
                self._unconfirmed[-1].take(self._received)
            except ReplyError as error:
                if self._is_of_unconfirmed(error):
                    continue
            break
        if self._received:
            self.trouble = f"not asked for: {shown(self._received)}"
            self._received.clear()

    def _next_place(self) -> int | None:
        """Where in the queue the request is that is to be made now: whoever was silent comes after the others."""
        if self._owed:
            owing = frozenset[str]().union(*(owed.unanswered for owed, _ in self._owed))
            self._queue = deque((self._for_others(exchange, owing), done) for exchange, done in self._queue)
        places = [k for k, (exchange, _) in enumerate(self._queue) if self._may_be_asked(exchange)]
        return min(places, key=lambda k: self._is_silent(self._queue[k][0]), default=None)

    def _for_others(self, exchange: Exchange, owing: frozenset[str]) -> Exchange:
        """Let a request to several drives be one to those of them that owe no reply, if there are any."""
        if exchange.reply_size and not exchange.addressees.isdisjoint(owing):
            return exchange.without(owing) or exchange
        return exchange

    def _is_silent(self, exchange: Exchange) -> bool:
        return exchange.reply_size > 0 and not self._silent.isdisjoint(exchange.addressees)

    def give_up(self) -> None:
        """End a cycle: what has not been asked is not asked any more, and what is not answered is lost."""
        self._queue.clear()
        self.limit_ns = None
        if self._awaited:
            self.trouble = f"{self._awaited[0][0].what}: no reply in time"
            for exchange, _ in self._awaited:
                self._silent |= exchange.unanswered
            self._owe()

    def _owe(self) -> None:
        """Go on without the replies that are awaited; they may still come."""
        if self._reply_limit_ns:
            until = self._sent_ns + self._reply_limit_ns
            self._owed += [(exchange, until) for exchange, _ in self._awaited]
        self._awaited.clear()

    def _forget(self, gone: LineGoneError) -> None:
        self.trouble = str(gone)
        self._queue.clear()
        self._received.clear()
        self._owe()  # a converter in between may keep it until the line is back
        self._unconfirmed.clear()
        self._is_settling = False
        self._next_reopen_ns = self._now_ns() + _REOPEN_NS

    def _reopen(self) -> None:
        self._queue.clear()  # what was to be said now is not to be said later
        now = self._now_ns()
        if now >= self._next_reopen_ns:
            self._next_reopen_ns = now + _REOPEN_NS
            self.line.reopen()
