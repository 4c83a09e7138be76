"""Scheduler of the requests on one line: sends them in order, in steps that never wait.

Serial protocols do not number their replies, so a late reply looks like the present one of the same drive. A drive
that did not answer in time is therefore not asked again until its reply has come and was dropped, or cannot come any
more. Meanwhile the other drives on the line are asked, and commands without a reply are sent: a silent drive must not
prevent another one from being stopped.

Requests are sent together if the drives read ahead and no reply to one of them could be taken for the reply to
another: the process then wakes up only once in a cycle.

`line_state` has the states and their transitions, `BusScheduler._verdict` the rule for sending.
"""

import time
from collections import deque
from collections.abc import Callable, Iterable, Sequence
from enum import IntEnum

from friction_hil_drivers.serial_line.line import Line, LineGoneError
from friction_hil_drivers.serial_line.line_state import LineEvent, Timeliness
from friction_hil_drivers.serial_line.protocol import Exchange, Image, shown
from friction_hil_drivers.serial_line.receiver import ReplyReceiver
from friction_hil_drivers.serial_line.wire import character_s

_REOPEN_NS = 200_000_000


class Verdict(IntEnum):
    """Decision on sending a request."""

    SEND = 0
    WAIT = 1
    TOO_LATE = 2  # its reply would not come before the deadline


_SEND, _WAIT, _TOO_LATE = Verdict


class BusScheduler(ReplyReceiver):
    """Sends requests on one line, and takes the replies to them; see also `ReplyReceiver`."""

    def __init__(
        self,
        line: Line,
        images: Sequence[Image],  # of all axes on the line
        silence_chars: float,  # between frames
        # after which an outstanding reply cannot come any more; 0 if replies are numbered: a late one is recognised
        reply_limit_s: float,
        now_ns: Callable[[], int] = time.monotonic_ns,  # monotonic
        *,
        ahead_chars: int = 0,  # of requests that may be sent before the first is answered; 0: one request at a time
        # longest time of an undelayed reply if replies do not show which drive they are from; 0 on other lines
        anonymous_reply_s: float = 0.0,
        show: Callable[[bytearray], str] = shown,  # received bytes as text, for messages
    ) -> None:
        character_ns = character_s(line.options) * 1e9
        super().__init__(
            images,
            silence_ns=round(silence_chars * character_ns),
            reply_limit_ns=round(reply_limit_s * 1e9),
            anonymous_reply_ns=round(anonymous_reply_s * 1e9),
            now_ns=now_ns,
            show=show,
        )
        self.line = line
        self._character_ns = round(character_ns)
        self._turn_ns = self._silence_ns + round(line.options.turnaround_s * 1e9)  # from a request to its reply
        self._ahead_chars = ahead_chars
        self.queue: deque[Exchange] = deque()  # still to be sent
        self.sent: set[Exchange] = set()  # written to the line since the set was last emptied
        self.busy_until_ns = 0
        self._next_reopen_ns = 0
        self.deadline_ns: int | None = None  # a queued request whose reply would be complete later is not sent

    @property
    def due_ns(self) -> int | None:
        """Time at which `poll` has to be called even if nothing arrives, ns; None if it need not be."""
        if self.outstanding or self.line.descriptor < 0:
            return None
        if self.state.is_discarding:
            return min(self._received_ns + self._discard_ns, self._discard_end_ns)
        if self.state.timeliness is not Timeliness.LATE:
            return self._quiet_until_ns if self.queue else None
        moments = [until for _, until in self._late.expected]
        if self._received:  # a late reply is coming in
            return min(moments)
        if any(map(self._late.permit, self.queue)):
            moments.append(self._quiet_until_ns)
        return min(moments)

    def enqueue(self, exchanges: Iterable[Exchange], callback: Callable[[], None] | None = None) -> None:
        """Queue one request or more; ``callback`` is called when the last was answered, or sent if it has no reply."""
        self.queue.extend(exchanges)
        if callback is not None:
            self._callbacks[self.queue[-1]] = callback

    def poll(self, *, is_ready: bool = False) -> None:
        """Read the bytes that have arrived, handle replies, and send requests that may be sent.

        ``is_ready``: the operating system reports that bytes have arrived.
        """
        try:
            if self.line.descriptor >= 0 and (data := self.line.read(is_ready=is_ready)):
                self._received += data
                self._received_ns = self._now_ns()
        except LineGoneError as gone:
            self._lose_line(gone)
        if self.outstanding and not self.queue:
            if self._received:
                self._take_replies()
        else:
            self.advance()

    def flush(self) -> None:
        """Send the requests that may be sent now, and drop those that would have to wait for a late reply."""
        if self.state.timeliness is not Timeliness.LATE:
            self.advance()
            return
        self.poll()
        for exchange in [each for each in self.queue if not self._late.permit(each)]:
            self.queue.remove(exchange)
            self._callbacks.pop(exchange, None)

    def advance(self) -> None:
        """Handle the bytes that were read, then send the requests that may be sent."""
        if self.line.descriptor < 0:  # not `is_open`: evaluated several times a cycle
            self._reopen()
            return
        if self._received or not self.state.is_normal:
            self._take_received()
        while self.queue:
            found = (self.queue, 0) if self.state.timeliness is Timeliness.ON_TIME else self._choose()
            if found is None:
                return
            queue, index = found
            now_ns = self._now_ns()
            verdict = self._verdict(queue[index], now_ns)
            if verdict is _WAIT:
                return
            if queue is not self.queue:
                self._replace_queue(queue)
            if self._received and not self.outstanding:  # otherwise it is the beginning of an expected reply
                self._take_unsolicited()
            data, sending = b"", []
            while verdict is _SEND:
                exchange = queue[index]
                del queue[index]
                data += exchange.constant or exchange.encode()
                sending.append(exchange)
                if exchange.reply_size:
                    self.outstanding.append(exchange)
                if not queue:
                    break
                index = 0
                verdict = self._verdict(queue[0], now_ns, len(data))
            if verdict is _TOO_LATE:
                self._drop_queue(queue[index])
            if data:
                try:
                    self.line.write(data)
                except LineGoneError as gone:
                    self._lose_line(gone)
                    return
                self.sent.update(sending)
                self._sent_ns = now_ns
                self._unread_chars += len(data)
                self.busy_until_ns = max(self.busy_until_ns, now_ns) + len(data) * self._character_ns
                if self._silence_ns and not self.outstanding:
                    self._quiet_until_ns = self.busy_until_ns + self._silence_ns
                for exchange in sending:
                    if exchange.reports_refusal:
                        self.refusals.unconfirmed.append(exchange)
                    if not exchange.reply_size and (callback := self._callbacks.pop(exchange, None)) is not None:
                        callback()
            if self.outstanding:
                return

    def _take_received(self) -> None:
        """Handle the bytes that were read."""
        if self.state.is_discarding:
            self._discard(self._now_ns())
        elif self.outstanding:
            if self._received:
                self._take_replies()
        elif self.state.timeliness is Timeliness.LATE:
            self._take_late_reply(self._now_ns())

    def _choose(self) -> tuple[deque[Exchange], int] | None:
        """Return what may be asked while a drive is late or silent, and the index of the first; None for nothing."""
        queue = deque(self._late.for_others(self.queue))
        index = self._late.first_to_send(queue)
        return None if index is None else (queue, index)

    def end_cycle(self) -> None:
        """End a cycle: drop requests that were not sent, and treat outstanding replies as late or lost."""
        self.queue.clear()
        self._callbacks.clear()
        self.deadline_ns = None
        if self.outstanding:
            self.last_error = f"{self.outstanding[0].label}: no reply in time"
            if self._received:
                self.last_error = (
                    f"{self.outstanding[0].label}: no whole reply in time, only {self._show(self._received)}"
                )
            self._late.note_silent(self.outstanding)
            if not self.reply_limit_ns:
                self.state.apply(LineEvent.REPLY_MISSED)
            self._expect_late()
            self.line.acknowledge()

    def _verdict(self, exchange: Exchange, now_ns: int, chars: int = 0) -> Verdict:
        """Decide if a request may be sent; ``chars``: of other requests that precede it in the same write."""
        if not (self.state.is_normal or self._is_permitted(exchange, is_joined=bool(chars))):
            return _WAIT
        size, reply_size = exchange.request_size, exchange.reply_size
        if self.outstanding:
            if self._silence_ns or self._unread_chars + chars + size > self._ahead_chars:
                return _WAIT
            if not all(map(exchange.may_follow, self.outstanding)):
                return _WAIT
        elif self._silence_ns if chars else now_ns < self._quiet_until_ns:
            return _WAIT
        if self.deadline_ns is not None:
            end_ns = max(self.busy_until_ns, now_ns) + (size + reply_size) * self._character_ns
            if reply_size:
                end_ns += self._turn_ns
            if end_ns > self.deadline_ns:
                return _TOO_LATE
        return _SEND

    def _is_permitted(self, exchange: Exchange, *, is_joined: bool) -> bool:
        """Return True if a request may be sent in the present state of the disturbed line."""
        state, permission, is_answered = self.state, self.state.permission, bool(exchange.reply_size)
        if not (permission.requests if is_answered else permission.commands):
            return False
        if (is_joined or self.outstanding) and not permission.together:
            return False
        if is_joined and not self.outstanding and is_answered and not permission.joined:
            return False
        if state.timeliness is Timeliness.ON_TIME:
            return True
        if is_joined:
            return False
        if state.timeliness is Timeliness.LATE and self._received and not self.outstanding:
            return state.is_noisy and not is_answered  # a late reply is coming in
        return True

    def _replace_queue(self, queue: deque[Exchange]) -> None:
        """Replace each request in the queue by the one at the same index of ``queue``."""
        for before, exchange in zip(self.queue, queue, strict=True):
            if exchange is not before and before in self._callbacks:
                self._callbacks[exchange] = self._callbacks.pop(before)
        self.queue = queue

    def _drop_queue(self, exchange: Exchange) -> None:
        """Send nothing more in this cycle: this reply and all later ones would be late."""
        if not self._late.silent:  # otherwise the silent drive is the reason
            self.last_error = f"{exchange.label}: no time was left for it"
        for each in self.queue:
            self._callbacks.pop(each, None)
        self.queue.clear()

    def _lose_line(self, gone: LineGoneError) -> None:
        self.last_error = str(gone)
        self.queue.clear()
        self._callbacks.clear()
        self._received.clear()
        self._expect_late()  # a converter in between may send them when the line is back
        self.refusals.unconfirmed.clear()
        self.state.apply(LineEvent.LINE_LOST)
        self._next_reopen_ns = self._now_ns() + _REOPEN_NS

    def _reopen(self) -> None:
        """Try to reopen the line; queued requests are dropped."""
        self.queue.clear()
        self._callbacks.clear()
        now_ns = self._now_ns()
        if now_ns >= self._next_reopen_ns:
            self._next_reopen_ns = now_ns + _REOPEN_NS
            self.line.reopen()
