"""State machine of a serial line: how far received bytes can be trusted, and whether drives answer in time.

The machine has two states at a time: `Reception` determines the use of received bytes, and `Timeliness` shows whether
every drive has answered. `TABLE` has the nine states; ``README.md`` beside this file shows it.
"""

from enum import IntEnum
from typing import Final, NamedTuple


class Reception(IntEnum):
    """Use of received bytes."""

    IN_SYNC = 0
    OUT_OF_SYNC = 1
    NOISY = 2
    DISCARDING = 3
    DISCARDING_OUT_OF_SYNC = 4
    DISCARDING_NOISY = 5


class Timeliness(IntEnum):
    """Timeliness of the replies. The numbers differ from those of `Reception`, because both are keys of one table."""

    ON_TIME = 10
    SILENT = 11
    LATE = 12


State = Reception | Timeliness


class LineEvent(IntEnum):
    """Event that may change the state."""

    REPLY = 0  # a valid reply came; others are outstanding
    LAST_REPLY = 1  # a valid reply came; no other is outstanding
    BROKEN_REPLY = 2  # a damaged reply or one of another drive came; others are outstanding
    LAST_REPLY_BROKEN = 3  # a damaged reply or one of another drive came; no other is outstanding
    LATE_REPLY_BROKEN = 4  # bytes came that are not the late reply that was expected
    LATE_REPLY_EXPIRED = 5  # a late reply cannot come any more
    LINE_QUIET = 6  # nothing arrived for long enough
    LINE_NEVER_QUIET = 7  # bytes kept arriving for too long
    LINE_LOST = 8  # the adapter was unplugged, or the peer closed the connection
    REPLY_OVERDUE = 9  # a cycle ended without a reply, which may still come
    REPLY_MISSED = 10  # a cycle ended without a reply, and a late one would be recognised by its number
    NO_REPLY_LATE = 11  # the last of the late replies came or expired
    ALL_ANSWERED = 12  # every drive answered the last request to it


class Permission(NamedTuple):
    """Requests that may be sent in a state of the reception, and use of the replies."""

    requests: bool  # requests with a reply
    commands: bool  # commands without a reply
    together: bool  # several requests in one write, and requests while a reply is outstanding
    joined: bool  # requests in one write with commands before them
    replies_used: bool  # the contents of replies are used


class Row(NamedTuple):
    """One state. In a pair, the second entry applies if replies do not show which of several drives they are from.

    A lost or damaged reply may then still come, and would be taken for a reply of another drive.
    """

    meaning: str
    permission: tuple[tuple[bool, bool], ...]  # as `Permission`; () for a timeliness, which is not asked
    following: dict[LineEvent, tuple[State, State]]  # next states; all other events change nothing


_YES, _NO, _NAMED = (True, True), (False, False), (True, False)
_R, _T, _E = Reception, Timeliness, LineEvent
TABLE: Final[dict[State, Row]] = {
    _R.IN_SYNC: Row(
        "each reply belongs to the request that waits for it",
        (_YES, _YES, _YES, _YES, _YES),
        {
            _E.BROKEN_REPLY: (_R.IN_SYNC, _R.OUT_OF_SYNC),
            _E.LAST_REPLY_BROKEN: (_R.DISCARDING, _R.DISCARDING_OUT_OF_SYNC),
            _E.LATE_REPLY_BROKEN: (_R.DISCARDING, _R.DISCARDING),
            _E.LATE_REPLY_EXPIRED: (_R.IN_SYNC, _R.OUT_OF_SYNC),
        },
    ),
    _R.OUT_OF_SYNC: Row(
        "the next reply may belong to an earlier request; it is dropped",
        (_YES, _YES, _NO, _NO, _NO),
        {
            _E.LAST_REPLY: (_R.DISCARDING, _R.DISCARDING),
            _E.LAST_REPLY_BROKEN: (_R.DISCARDING_OUT_OF_SYNC, _R.DISCARDING_OUT_OF_SYNC),
            _E.LATE_REPLY_BROKEN: (_R.DISCARDING_OUT_OF_SYNC, _R.DISCARDING_OUT_OF_SYNC),
        },
    ),
    _R.NOISY: Row(
        "the line did not become quiet after a broken reply",
        (_YES, _YES, _NAMED, _NO, _NAMED),
        {
            _E.REPLY: (_R.IN_SYNC, _R.OUT_OF_SYNC),
            _E.LAST_REPLY: (_R.IN_SYNC, _R.DISCARDING),
            _E.LAST_REPLY_BROKEN: (_R.DISCARDING_NOISY, _R.DISCARDING_NOISY),
            _E.LATE_REPLY_BROKEN: (_R.DISCARDING_NOISY, _R.DISCARDING_NOISY),
        },
    ),
    _R.DISCARDING: Row(
        "bytes are dropped until the line is quiet",
        (_NO, _NO, _NO, _NO, _NO),
        {
            _E.LATE_REPLY_EXPIRED: (_R.DISCARDING, _R.DISCARDING_OUT_OF_SYNC),
            _E.LINE_QUIET: (_R.IN_SYNC, _R.IN_SYNC),
            _E.LINE_NEVER_QUIET: (_R.NOISY, _R.NOISY),
            _E.LINE_LOST: (_R.IN_SYNC, _R.IN_SYNC),
        },
    ),
    _R.DISCARDING_OUT_OF_SYNC: Row(
        "the same; afterwards the next reply is dropped",
        (_NO, _NO, _NO, _NO, _NO),
        {
            _E.LINE_QUIET: (_R.OUT_OF_SYNC, _R.OUT_OF_SYNC),
            _E.LINE_NEVER_QUIET: (_R.NOISY, _R.NOISY),
            _E.LINE_LOST: (_R.OUT_OF_SYNC, _R.OUT_OF_SYNC),
        },
    ),
    _R.DISCARDING_NOISY: Row(
        "the same, on a line that did not become quiet before",
        (_NO, _YES, _NAMED, _NO, _NO),
        {
            _E.LINE_QUIET: (_R.IN_SYNC, _R.OUT_OF_SYNC),
            _E.LINE_NEVER_QUIET: (_R.NOISY, _R.NOISY),
            _E.LINE_LOST: (_R.NOISY, _R.NOISY),
        },
    ),
    _T.ON_TIME: Row(
        "every drive answered the last request to it",
        (),
        {_E.REPLY_OVERDUE: (_T.LATE, _T.LATE), _E.REPLY_MISSED: (_T.SILENT, _T.SILENT)},
    ),
    _T.SILENT: Row(
        "a drive did not answer; its reply is not expected any more, and it is asked after the others",
        (),
        {_E.REPLY_OVERDUE: (_T.LATE, _T.LATE), _E.ALL_ANSWERED: (_T.ON_TIME, _T.ON_TIME)},
    ),
    _T.LATE: Row(
        "a drive did not answer, and its reply may still come; it is not asked until then",
        (),
        {_E.NO_REPLY_LATE: (_T.SILENT, _T.SILENT)},
    ),
}


class LineState:
    """Present state of one line; only `apply` changes it. ``names_drives``: each reply shows which drive it is from."""

    def __init__(self, *, names_drives: bool) -> None:
        self._column = 0 if names_drives else 1
        self._permissions = {
            state: Permission(*(pair[self._column] for pair in row.permission))
            for state, row in TABLE.items()
            if row.permission
        }
        self.reception = Reception.IN_SYNC
        self.timeliness = Timeliness.ON_TIME
        self._update()

    def apply(self, event: LineEvent) -> None:
        """Change the state by the table."""
        for state in (self.reception, self.timeliness):
            following = TABLE[state].following.get(event, (state, state))[self._column]
            if isinstance(following, Reception):
                self.reception = following
            else:
                self.timeliness = following
        self._update()

    def _update(self) -> None:
        self.permission = self._permissions[self.reception]
        self.is_normal = self.reception is Reception.IN_SYNC and self.timeliness is Timeliness.ON_TIME
        # received bytes are dropped until the line is quiet
        self.is_discarding = self.reception >= Reception.DISCARDING
        # the line did not become quiet: commands without a reply do not wait for that
        self.is_noisy = self.reception in (Reception.NOISY, Reception.DISCARDING_NOISY)
