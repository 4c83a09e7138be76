"""Which commands the drives of a line refuse, as far as what they say shows it. No line, no clock."""

from collections import deque
from collections.abc import Iterable

from friction_hil_drivers.serial_line.protocol import Exchange, ReplyError

_MOST_UNCONFIRMED = 8


class Refusals:
    """Counts commands that are refused, by an error in place of the reply, or by one where no reply is due.

    Parameters
    ----------
    is_of_one_drive : bool
        Nobody else is on the line.

    Attributes
    ----------
    count : int
        Commands in a row that were refused.
    unconfirmed : deque of Exchange
        Sent without a reply: an error that comes next may mean the last of them.
    is_told : bool
        The drive has refused one of these since it answered last.
    """

    def __init__(self, *, is_of_one_drive: bool) -> None:
        self._is_of_one_drive = is_of_one_drive
        self.count = 0
        self.unconfirmed: deque[Exchange] = deque(maxlen=_MOST_UNCONFIRMED)
        self.is_told = False
        self._signals: set[str] = set()  # that these commands write: one that is taken says nothing of another

    def note(self, exchange: Exchange) -> None:
        """Count a command that was refused in place of its reply."""
        self.count += 1
        self._signals.update(exchange.writes)

    def unasked(self, error: ReplyError) -> Exchange | None:
        """Count the command to which an unasked error belongs, and return it; None where it belongs to none."""
        if not (error.is_unasked and self.unconfirmed):
            return None
        exchange = self.unconfirmed.pop()
        self.note(exchange)
        self.is_told = True
        return exchange

    def note_taken(self, exchanges: Iterable[Exchange]) -> None:
        """Begin to count anew if one of these commands, which the drive took, is among those that it refused."""
        if self.count and any(not self._signals.isdisjoint(exchange.writes) for exchange in exchanges):
            self.count = 0
            self._signals.clear()

    def note_reply(self, exchange: Exchange) -> None:
        """Note that a drive answered: what was sent to it before, without a reply, it has not refused."""
        if self._is_of_one_drive and not (self.count or self.is_told):
            self.unconfirmed.clear()
            return
        taken = [each for each in self.unconfirmed if each.addressees <= exchange.addressees]
        if not self.is_told:
            self.note_taken(taken)
        self.is_told = False
        rest = [each for each in self.unconfirmed if each not in taken]
        self.unconfirmed.clear()
        self.unconfirmed.extend(rest)
