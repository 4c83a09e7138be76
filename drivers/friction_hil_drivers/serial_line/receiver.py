"""Receiving half of a line's scheduler: takes the replies to outstanding requests, and late replies.

If replies do not show which drive they are from, a late one would be taken for the feedback of another axis. On such a
line, after a lost or damaged reply, the next reply is dropped, and then all bytes until the line has been quiet for as
long as a reply takes: drives answer in order, so that all older replies have come by then.
"""

from collections import deque
from collections.abc import Callable, Sequence

from friction_hil_drivers.serial_line.line_state import LineEvent, LineState
from friction_hil_drivers.serial_line.protocol import Exchange, Image, ReplyError
from friction_hil_drivers.serial_line.replies import LateReplies, Refusals

_MIN_QUIET_NS = 2_000_000  # USB adapters pass bytes on once a millisecond
_MOST_NOTICES = 10  # between two looks at them
_MAX_DISCARD_NS = 20_000_000  # a line that is not quiet by then counts as noisy


class ReplyReceiver:
    """Takes replies from the bytes that were received, and keeps the state of the line."""

    def __init__(
        self,
        images: Sequence[Image],  # of all axes on the line
        *,
        silence_ns: int,  # between frames
        reply_limit_ns: int,  # after which an outstanding reply cannot come any more; 0 if replies are numbered
        # longest time of a reply if replies do not show which drive they are from; 0 on other lines
        anonymous_reply_ns: int,
        now_ns: Callable[[], int],  # monotonic
        show: Callable[[bytearray], str],  # received bytes as text, for messages
    ) -> None:
        self._show = show
        self._images = tuple(images)
        self._now_ns = now_ns
        self._silence_ns = silence_ns
        self.reply_limit_ns = reply_limit_ns
        self._discard_ns = self._min_discard_ns = max(silence_ns, _MIN_QUIET_NS)
        self._stale_ns = max(self._min_discard_ns, anonymous_reply_ns)
        self._discard_end_ns = 0
        self.state = LineState(names_drives=not anonymous_reply_ns)
        # sent and not answered yet, in the order in which they will be answered
        self.outstanding: deque[Exchange] = deque()
        self._callbacks: dict[Exchange, Callable[[], None]] = {}  # of queued and outstanding exchanges
        self._late = LateReplies()
        self._received = bytearray()
        self._unread_chars = 0  # sent since the last reply: the drive may not have read them yet
        self._sent_ns = self._received_ns = self._quiet_until_ns = 0
        # as text; the second: the last one that was a drive's answer, e.g. an exception of Modbus
        self.last_error = self.last_answer = ""
        self.notices: list[str] = []  # commands that drives refused
        self.refusals = Refusals(is_of_one_drive=len(self._images) == 1)

    @property
    def received_ns(self) -> int:
        """Monotonic time of the last received bytes, ns; 0 before the first ones."""
        return self._received_ns

    def _take_replies(self) -> None:
        """Take the replies that are complete, in the order of the requests."""
        outstanding, received, refusals, state = self.outstanding, self._received, self.refusals, self.state
        while outstanding and received:
            exchange = outstanding[0]
            is_normal = state.is_normal
            try:
                if is_normal or state.permission.replies_used:
                    if not exchange.take(received):
                        return
                elif not self._take_unused(exchange):
                    return
            except ReplyError as error:
                if self._note_refusal(error):  # the reply to this request follows
                    continue
                self._note_error(exchange, error)
            else:
                self._unread_chars = 0
                if self._callbacks or not is_normal or refusals.count:
                    self._note_reply(exchange)
                if refusals.unconfirmed or refusals.is_refused:
                    refusals.note_reply(exchange)
            outstanding.popleft()
            if self._silence_ns:
                self._quiet_until_ns = self._received_ns + self._silence_ns

    def _note_error(self, exchange: Exchange, error: ReplyError) -> None:
        """Handle an error that came instead of the reply to the first outstanding request."""
        self._callbacks.pop(exchange, None)
        self.last_error = f"{exchange.label}: {error}"
        if error.is_complete:
            self.last_answer = self.last_error
            if exchange.writes:
                self.refusals.note(exchange)
                if len(self.notices) < _MOST_NOTICES:
                    self.notices.append(self.last_error)
        else:
            # the next reply, if there is one, is found after the rest of this one
            is_last = len(self.outstanding) == 1
            self._apply(LineEvent.LAST_REPLY_BROKEN if is_last else LineEvent.BROKEN_REPLY, self._min_discard_ns)

    def _note_reply(self, exchange: Exchange) -> None:
        """Handle a valid reply on a disturbed line, after a refusal, or to a request with a callback."""
        callback = self._callbacks.pop(exchange, None)
        if not self.state.permission.replies_used:
            callback = None
            self.last_error = f"{exchange.label}: the reply may have been one to an earlier request"
        self._apply(LineEvent.LAST_REPLY if len(self.outstanding) == 1 else LineEvent.REPLY, self._stale_ns)
        self._late.note_answer(exchange)
        self._note_all_answered()
        self.refusals.note_accepted((exchange,))
        if callback is not None:
            callback()

    def _note_all_answered(self) -> None:
        if not self._late.silent:
            self.state.apply(LineEvent.ALL_ANSWERED)

    def _apply(self, event: LineEvent, discard_ns: int) -> None:
        """Change the state; if bytes are dropped from now on, do so until the line was quiet for ``discard_ns``."""
        self.state.apply(event)
        if self.state.is_discarding:
            self._discard_ns = discard_ns
            self._discard_end_ns = self._now_ns() + max(_MAX_DISCARD_NS, 2 * discard_ns)

    def _discard(self, now: int) -> None:
        """Drop received bytes until the line is quiet, or was not quiet for too long."""
        self._received.clear()
        if now >= self._received_ns + self._discard_ns:
            self.state.apply(LineEvent.LINE_QUIET)
        elif now >= self._discard_end_ns:
            self.state.apply(LineEvent.LINE_NEVER_QUIET)

    def _take_unused(self, exchange: Exchange) -> bool:
        """Take a reply without using its contents; return True if it was complete."""
        before = [(dict(image.values), set(image.fresh)) for image in self._images]
        try:
            return exchange.take(self._received)
        finally:
            for image, (values, fresh) in zip(self._images, before, strict=True):
                image.values, image.fresh = values, fresh

    def _note_refusal(self, error: ReplyError) -> bool:
        """Count an unsolicited error as the refusal of a command without a reply; return True if it is one."""
        exchange = self.refusals.note_unsolicited(error)
        if exchange is not None:
            self.last_error = f"{exchange.label}: {error}"
        return exchange is not None

    def _take_late_reply(self, now: int) -> None:
        """Take a late reply without using its contents, and stop expecting replies that cannot come any more."""
        late = self._late
        if self._received:
            exchange, _ = late.expected[0]
            try:
                is_complete = self._take_unused(exchange)
            except ReplyError as error:
                is_complete = False
                if not self._note_refusal(error):
                    # a damaged reply, or one of another drive: the late reply is still expected
                    self._apply(LineEvent.LATE_REPLY_BROKEN, self._min_discard_ns)
                    self.last_error = f"late, {exchange.label}: {error}"
            if is_complete:
                del late.expected[0]
                self._quiet_until_ns = now + self._silence_ns
        if late.drop_expired(now):
            self.state.apply(LineEvent.LATE_REPLY_EXPIRED)
        if not late.expected:
            self.state.apply(LineEvent.NO_REPLY_LATE)
            self._note_all_answered()

    def _take_unsolicited(self) -> None:
        """Handle bytes without a request: refusals of commands without a reply; all others are noise."""
        unconfirmed = self.refusals.unconfirmed
        while unconfirmed and self._received:
            try:
                unconfirmed[-1].take(self._received)
            except ReplyError as error:
                if self._note_refusal(error):
                    continue
                self.last_error = f"{unconfirmed[-1].label}: {error}"
            break
        if self._received:
            self.last_error = f"not asked for: {self._show(self._received)}{self._late.origin(self._received_ns)}"
            self._received.clear()

    def _expect_late(self) -> None:
        """Stop waiting for the outstanding replies, and expect them as late ones."""
        if self.reply_limit_ns and self.outstanding:
            self._late.expect(self.outstanding, self._sent_ns + self.reply_limit_ns)
            self._late.limit_ns = self.reply_limit_ns
            self.state.apply(LineEvent.REPLY_OVERDUE)
        self.outstanding.clear()
