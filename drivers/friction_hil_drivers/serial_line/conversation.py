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
from collections.abc import Callable, Collection, Iterable, Sequence

from friction_hil_drivers.serial_line.batch import Batch
from friction_hil_drivers.serial_line.line import Line, LineGoneError
from friction_hil_drivers.serial_line.protocol import Exchange, Image, ReplyError, shown
from friction_hil_drivers.serial_line.refusals import Refusals
from friction_hil_drivers.serial_line.wire import character_s

_SHORT_SILENCE_NS = 2_000_000  # USB adapters hand over what they have each millisecond
_REOPEN_NS = 200_000_000
_LONGEST_SETTLE_NS = 20_000_000  # a line that is not quiet by then will not be


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
    refusals : Refusals
        Of commands, by the drives on the line.
    queue, awaited : deque of Exchange
        What is still to be sent; what was sent together, and is answered in this order.
    limit_ns : int or None
        When replies have to be there to what was not said at once: what cannot be answered by then is not asked.
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
        character_ns = character_s(line.options) * 1e9 if serial else 0.0
        self._character_ns = round(character_ns)
        self._silence_ns = round(silence_chars * character_ns)
        self._reply_limit_ns = round(reply_limit_s * 1e9)
        self._settle_ns = self._short_settle_ns
        self._doubt_ns = max(self._settle_ns, round(doubt_s * 1e9)) if doubt_s else 0
        self._is_in_doubt = False  # what comes next may be a reply to something before
        self._ahead_chars = ahead_chars
        self._unread_chars = 0  # sent since a drive answered last: it may not have looked at them yet
        self.queue: deque[Exchange] = deque()
        self.awaited: deque[Exchange] = deque()
        self._done: dict[Exchange, Callable[[], None]] = {}  # to be told, of what is queued or awaited
        self._wire_ns: dict[Exchange, int] = {}  # what each takes
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
        self.refusals = Refusals(is_of_one_drive=len(self._images) == 1)

    @property
    def keeps_silence(self) -> bool:
        """Whether silence has to pass between frames."""
        return self._silence_ns > 0

    @property
    def _short_settle_ns(self) -> int:
        return max(self._silence_ns, _SHORT_SILENCE_NS)

    @property
    def is_finished(self) -> bool:
        """Whether all has been asked and answered, or the line is gone."""
        return not self.queue and not self.awaited

    @property
    def due_ns(self) -> int | None:
        """When `step` has something to do although nothing arrives; None: it has not."""
        if self.awaited or self.line.descriptor < 0:
            return None
        if self._is_settling:
            return min(self._heard_ns + self._settle_ns, self._settle_end_ns)
        if not self._owed:
            return self._quiet_until_ns if self.queue else None
        moments = [until for _, until in self._owed]
        if self._received:  # a late reply is coming in
            return min(moments)
        if any(map(self._may_be_asked, self.queue)):
            moments.append(self._quiet_until_ns)
        return min(moments, default=None)

    def say_at_once(self, batch: Batch, limit_ns: int | None) -> bool:
        """Send requests together where nothing at all stands in the way; whether that was so.

        This is how an undisturbed cycle speaks. Whatever is unusual is left to `ask` and `go_on`.

        Parameters
        ----------
        batch : Batch
        limit_ns : int or None
            When all has to be answered.
        """
        if (
            self.queue
            or self._received
            or self._owed
            or self._silent
            or self._is_settling
            or self._is_noisy
            or self._is_in_doubt
            or self.line.descriptor < 0
            or not batch.are_joint
        ):
            return False
        ahead_chars = batch.ahead_chars
        if self.awaited:
            if not batch.may_follow.issuperset(self.awaited):
                return False
            ahead_chars = batch.chars
        now = self._now_ns()
        if now < self._quiet_until_ns:
            return False
        if limit_ns is not None:
            busy_ns = self._busy_until_ns
            if (busy_ns if busy_ns > now else now) + batch.wire_ns > limit_ns:
                return False
        if ahead_chars and self._unread_chars + ahead_chars > self._ahead_chars:
            return False
        try:
            data = b""
            for exchange in batch.exchanges:
                data += exchange.constant or exchange.encode()
            self._send(data, now, batch.answered)
        except LineGoneError as gone:
            self._forget(gone)
            return True
        self.awaited.extend(batch.answered)
        self.refusals.unconfirmed.extend(batch.refusable)
        return True

    def ask(self, exchanges: Iterable[Exchange], done: Callable[[], None] | None = None) -> None:
        """Queue requests; ``done`` is called when the last of them has been answered (sent, if no reply is due)."""
        self.queue.extend(exchanges)
        if done is not None and self.queue:
            self._done[self.queue[-1]] = done

    def step(self, *, is_ready: bool = False) -> None:
        """Do what can be done now.

        Parameters
        ----------
        is_ready : bool
            The operating system says that something has come.
        """
        try:
            if self.line.descriptor >= 0 and (data := self.line.read(is_ready=is_ready)):
                self._received += data
                self._heard_ns = self._now_ns()
        except LineGoneError as gone:
            self._forget(gone)
        if self.awaited and not self.queue:
            if self._received:
                self._await()
        else:
            self.go_on()

    def speak(self) -> None:
        """Send what can be sent now; what has to wait for a late reply is not sent in this cycle."""
        if self._owed:
            self.step()
            self.queue = deque(filter(self._may_be_asked, self.queue))
        else:
            self.go_on()

    def go_on(self) -> None:
        """Deal with what was read, then send what may be sent."""
        if self.line.descriptor < 0:  # not open; asked several times a cycle
            self._reopen()
            return
        if self._is_settling:
            self._settle_on(self._now_ns())
        elif self.awaited:
            if self._received:
                self._await()
        elif self._owed:
            self._drop_late(self._now_ns())
        try:
            while self.queue and self._is_free() and self._say():
                pass
        except LineGoneError as gone:
            self._forget(gone)

    def _is_free(self) -> bool:
        """Whether the next request may be sent now, as far as the line goes."""
        if self.awaited:
            return bool(self._ahead_chars) and self._may_join(0)
        if self._is_settling or self._owed:
            is_busy = self._is_settling or self._received
            if is_busy and not (self._is_noisy and not self.queue[0].reply_size):
                return False
        return not self._quiet_until_ns or self._now_ns() >= self._quiet_until_ns

    def _settle_on(self, now: int) -> None:
        """Drop what belongs to a broken reply, for as long as it comes."""
        self._received.clear()
        if now >= self._heard_ns + self._settle_ns:
            self._is_settling = self._is_noisy = False
        elif now >= self._settle_end_ns:
            self._is_settling, self._is_noisy = False, True
            self._is_in_doubt = self._doubt_ns > 0

    def _await(self) -> None:
        """Take the replies that are complete; in the order of the requests."""
        awaited, received, refusals = self.awaited, self._received, self.refusals
        while awaited and received:
            exchange = awaited[0]
            try:
                if not (self._take_in_vain(exchange) if self._is_in_doubt else exchange.take(received)):
                    return
            except ReplyError as error:
                if self._is_refusal(error):  # the reply proper follows
                    continue
                self._note_error(exchange, error)
            else:
                self._unread_chars = 0
                if self._done or self._is_in_doubt or self._is_noisy or self._silent or refusals.count:
                    self._note_reply(exchange)
                if refusals.unconfirmed or refusals.is_told:
                    refusals.note_reply(exchange)
            awaited.popleft()
            if self._silence_ns:
                self._quiet_until_ns = self._heard_ns + self._silence_ns

    def _note_error(self, exchange: Exchange, error: ReplyError) -> None:
        """Draw conclusions from a reply that is none."""
        self._done.pop(exchange, None)
        if error.is_complete and exchange.writes:
            self.refusals.note(exchange)
        self.trouble = f"{exchange.what}: {error}"
        if not error.is_complete:
            self._is_in_doubt = self._doubt_ns > 0
            if len(self.awaited) == 1:  # where another reply follows, it is told from what is left of this one
                self._settle(self._short_settle_ns)

    def _note_reply(self, exchange: Exchange) -> None:
        """Draw conclusions from a reply, where something is told by it besides what it says."""
        done = self._done.pop(exchange, None)
        if self._is_in_doubt:
            done = None
            self.trouble = f"{exchange.what}: the reply may have been one to an earlier request"
            if len(self.awaited) == 1:
                self._is_in_doubt = False
                self._settle(self._doubt_ns)
        self._is_noisy = False
        self._silent -= exchange.addressees
        self.refusals.note_taken((exchange,))
        if done is not None:
            done()

    def _settle(self, time_ns: int) -> None:
        """Drop all that comes, until the line has been quiet for so long."""
        self._is_settling, self._settle_ns = True, time_ns
        self._settle_end_ns = self._now_ns() + max(_LONGEST_SETTLE_NS, 2 * time_ns)

    def _take_in_vain(self, exchange: Exchange) -> bool:
        """Whether a reply is complete; nothing of it is used."""
        before = [(dict(image.values), set(image.fresh)) for image in self._images]
        try:
            return exchange.take(self._received)
        finally:
            for image, (values, fresh) in zip(self._images, before, strict=True):
                image.values, image.fresh = values, fresh

    def _is_refusal(self, error: ReplyError) -> bool:
        """Whether an error is that of a request without a reply; then it is told."""
        exchange = self.refusals.unasked(error)
        if exchange is not None:
            self.trouble = f"{exchange.what}: {error}"
        return exchange is not None

    def _drop_late(self, now: int) -> None:
        """Take a reply of an earlier cycle for what it is: nothing of it is used."""
        if self._received:
            exchange, _ = self._owed[0]
            try:
                is_complete = self._take_in_vain(exchange)
            except ReplyError as error:
                is_complete = False
                if not self._is_refusal(error):
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
        is_disturbed = bool(self._owed or self._silent)
        place = self._next_place() if is_disturbed else 0
        if place is None:
            return False
        queue, awaited, data = self.queue, self.awaited, b""
        if self._received and not awaited:  # else it is the beginning of a reply that is due
            self._take_unasked()
        sent: list[Exchange] = []
        while True:
            exchange = queue[place]
            del queue[place]
            if self.limit_ns is not None and not self._has_time(exchange):
                # the reply would be late, the next cycle begin with waiting for it, and so would all after that
                if not self._silent:  # else that is the reason
                    self.trouble = f"{exchange.what}: no time was left for it"
                queue.clear()
                break
            data += exchange.encode()
            if exchange.reply_size:
                awaited.append(exchange)
            else:
                sent.append(exchange)
            if is_disturbed or not queue or not self._may_join(len(data)):
                break
        if data:
            self._send(data, self._now_ns(), awaited)
        for exchange in sent:
            if exchange.tells_refusal:
                self.refusals.unconfirmed.append(exchange)
            if self._done and exchange in self._done:
                self._done.pop(exchange)()
        return not awaited

    def _may_join(self, chars: int) -> bool:
        """Whether the next request may be sent together with those before it, which have so many characters."""
        if self._silence_ns or self._is_in_doubt:
            return False
        following = self.queue[0]
        if not self.awaited:
            return not (self._is_noisy and following.reply_size)
        if self._unread_chars + chars + following.request_size > self._ahead_chars:
            return False
        return all(map(following.may_follow, self.awaited))

    def _send(self, data: bytes, now: int, answered: Collection[Exchange]) -> None:
        """Send requests, of which some are answered."""
        self.line.write(data)
        size = len(data)
        self._unread_chars += size
        self._sent_ns = now
        busy_ns = self._busy_until_ns
        self._busy_until_ns = busy_ns = (busy_ns if busy_ns > now else now) + size * self._character_ns
        if self._silence_ns and not answered:
            self._quiet_until_ns = busy_ns + self._silence_ns

    def _has_time(self, exchange: Exchange) -> bool:
        """Whether an exchange can be over in this cycle."""
        assert self.limit_ns is not None
        wire_ns = self._wire_ns.get(exchange)
        if wire_ns is None:
            wire_ns = (exchange.request_size + exchange.reply_size) * self._character_ns
            if exchange.reply_size:
                wire_ns += self._silence_ns + round(self.line.options.turnaround_s * 1e9)
            self._wire_ns[exchange] = wire_ns
        return max(self._now_ns(), self._busy_until_ns) + wire_ns <= self.limit_ns

    def _take_unasked(self) -> None:
        """Look at what came without a question: refusals of what has no reply; the rest is noise."""
        unconfirmed = self.refusals.unconfirmed
        while unconfirmed and self._received:
            try:
                unconfirmed[-1].take(self._received)
            except ReplyError as error:
                if self._is_refusal(error):
                    continue
            break
        if self._received:
            self.trouble = f"not asked for: {shown(self._received)}"
            self._received.clear()

    def _next_place(self) -> int | None:
        """Where in the queue the request is that is to be made now: whoever was silent comes after the others."""
        if self._owed:
            owing = frozenset[str]().union(*(owed.unanswered for owed, _ in self._owed))
            self.queue = deque(self._for_others(exchange, owing) for exchange in self.queue)
        places = [k for k, exchange in enumerate(self.queue) if self._may_be_asked(exchange)]
        return min(places, key=lambda k: self._is_silent(self.queue[k]), default=None)

    def _for_others(self, exchange: Exchange, owing: frozenset[str]) -> Exchange:
        """Let a request to several drives be one to those of them that owe no reply, if there are any."""
        if not exchange.reply_size or exchange.addressees.isdisjoint(owing):
            return exchange
        part = exchange.without(owing) or exchange
        if exchange in self._done:
            self._done[part] = self._done.pop(exchange)
        return part

    def _is_silent(self, exchange: Exchange) -> bool:
        return exchange.reply_size > 0 and not self._silent.isdisjoint(exchange.addressees)

    def give_up(self) -> None:
        """End a cycle: what has not been asked is not asked any more, and what is not answered is lost."""
        self.queue.clear()
        self._done.clear()
        self.limit_ns = None
        if self.awaited:
            self.trouble = f"{self.awaited[0].what}: no reply in time"
            for exchange in self.awaited:
                self._silent |= exchange.unanswered
            self._owe()
            self.line.acknowledge()

    def _owe(self) -> None:
        """Go on without the replies that are awaited; they may still come."""
        if self._reply_limit_ns:
            until = self._sent_ns + self._reply_limit_ns
            self._owed += [(exchange, until) for exchange in self.awaited]
        self.awaited.clear()

    def _forget(self, gone: LineGoneError) -> None:
        self.trouble = str(gone)
        self.queue.clear()
        self._done.clear()
        self._received.clear()
        self._owe()  # a converter in between may keep it until the line is back
        self.refusals.unconfirmed.clear()
        self._is_settling = False
        self._next_reopen_ns = self._now_ns() + _REOPEN_NS

    def _reopen(self) -> None:
        self.queue.clear()  # what was to be said now is not to be said later
        self._done.clear()
        now = self._now_ns()
        if now >= self._next_reopen_ns:
            self._next_reopen_ns = now + _REOPEN_NS
            self.line.reopen()
