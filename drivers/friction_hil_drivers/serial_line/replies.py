"""Records of late replies, and of commands that drives refuse.

They use neither the line nor a clock; the scheduler reports the events.
"""

from collections import deque
from collections.abc import Collection, Iterable, Sequence

from friction_hil_drivers.serial_line.protocol import Exchange, ReplyError

_MAX_UNCONFIRMED = 8
_MOST_LATE = 20.0  # times the limit: bytes that come still later belong to something else


class LateReplies:
    """Record of replies that did not come in time, and of the drives that were asked."""

    def __init__(self) -> None:
        # whose reply may still come, in the order of their requests, each with its last moment (monotonic, ns)
        self.expected: list[tuple[Exchange, int]] = []
        self.silent: frozenset[str] = frozenset()  # drives that did not answer the last request to them
        self.limit_ns = 0  # from a request until its reply is not expected any more
        self._expired: tuple[Exchange, int] | None = None  # the last one, and when that was

    def expect(self, exchanges: Iterable[Exchange], until_ns: int) -> None:
        """Expect the replies to exchanges until ``until_ns``."""
        self.expected += [(exchange, until_ns) for exchange in exchanges]

    def note_silent(self, exchanges: Iterable[Exchange]) -> None:
        """Note the drives that did not answer."""
        self.silent = self.silent.union(*(exchange.unanswered for exchange in exchanges))

    def note_answer(self, exchange: Exchange) -> None:
        """Note that the drives of an exchange answered in time."""
        self.silent -= exchange.addressees

    def drop_expired(self, now_ns: int) -> bool:
        """Stop expecting replies whose time is over; return True if there were any."""
        left = [(exchange, until) for exchange, until in self.expected if now_ns < until]
        is_any_expired = len(left) < len(self.expected)
        if is_any_expired:
            self._expired = next(each for each in self.expected if now_ns >= each[1])
        self.expected = left
        return is_any_expired

    def origin(self, received_ns: int) -> str:
        """Return to which request bytes may be a reply that is not expected any more, and the remedy; "" for none."""
        if self._expired is None:
            return ""
        exchange, expired_ns = self._expired
        took_ms, limit_ms = ((t - expired_ns + self.limit_ns) * 1e-6 for t in (received_ns, expired_ns))
        if took_ms > _MOST_LATE * limit_ms:
            return ""
        return (
            f", {took_ms:.0f} ms after the request ({exchange.label}); replies are awaited for {limit_ms:.0f} ms: set "
            "line.reply_limit_s above that, and find what delays the drive or the adapter"
        )

    def permit(self, exchange: Exchange) -> bool:
        """Return True if no late reply could be taken for the reply to this request."""
        return not exchange.reply_size or all(
            exchange.addressees.isdisjoint(late.unanswered) for late, _ in self.expected
        )

    def for_others(self, exchanges: Sequence[Exchange]) -> list[Exchange]:
        """Replace requests to several drives by requests to those from which no late reply is expected."""
        owing = frozenset[str]().union(*(late.unanswered for late, _ in self.expected))
        return [
            exchange
            if not exchange.reply_size or exchange.addressees.isdisjoint(owing)
            else exchange.without(owing) or exchange
            for exchange in exchanges
        ]

    def first_to_send(self, exchanges: Sequence[Exchange]) -> int | None:
        """Return the index of the first permitted request; requests to silent drives come after the others."""
        permitted = [index for index, exchange in enumerate(exchanges) if self.permit(exchange)]
        return min(permitted, key=lambda index: self._is_to_silent_drive(exchanges[index]), default=None)

    def _is_to_silent_drive(self, exchange: Exchange) -> bool:
        return exchange.reply_size > 0 and not self.silent.isdisjoint(exchange.addressees)


class Refusals:
    """Counter of commands that drives refuse, by an error instead of the reply or by an unsolicited error."""

    def __init__(self, *, is_of_one_drive: bool) -> None:
        self._is_of_one_drive = is_of_one_drive  # on the line
        self.count = 0  # of successive refused commands
        # commands without a reply, the most recent last: an unsolicited error belongs to the last of them
        self.unconfirmed: deque[Exchange] = deque(maxlen=_MAX_UNCONFIRMED)
        self.is_refused = False  # the drive has refused one of these since its last reply
        self._signals: set[str] = set()  # written by the refused commands; another command's success does not count

    def note(self, exchange: Exchange) -> None:
        """Count a command that the drive refused."""
        self.count += 1
        self._signals.update(exchange.writes)

    def note_unsolicited(self, error: ReplyError) -> Exchange | None:
        """Count the command to which an unsolicited error belongs, and return it; None if it belongs to none."""
        if not (error.is_unsolicited and self.unconfirmed):
            return None
        exchange = self.unconfirmed.pop()
        self.note(exchange)
        self.is_refused = True
        return exchange

    def note_accepted(self, exchanges: Iterable[Exchange]) -> None:
        """Reset the count if one of these accepted commands writes a signal of a refused one."""
        if self.count and any(not self._signals.isdisjoint(exchange.writes) for exchange in exchanges):
            self.count = 0
            self._signals.clear()

    def note_reply(self, exchange: Exchange) -> None:
        """Note that a drive answered, and has therefore accepted the earlier commands without a reply."""
        if self._is_of_one_drive and not (self.count or self.is_refused):
            self.unconfirmed.clear()
            return
        accepted: Collection[Exchange] = [each for each in self.unconfirmed if each.addressees <= exchange.addressees]
        if not self.is_refused:
            self.note_accepted(accepted)
        self.is_refused = False
        rest = [each for each in self.unconfirmed if each not in accepted]
        self.unconfirmed.clear()
        self.unconfirmed.extend(rest)
