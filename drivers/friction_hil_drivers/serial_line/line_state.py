"""State machine of a serial line: how far received bytes can be trusted, and whether drives answer in time.

The machine has two states at a time: `Reception` determines the use of received bytes, and `Timeliness` shows whether
every drive has answered. `TRANSITIONS` has all transitions; an event without a row for the present state changes
nothing. `PERMISSIONS` lists what may be sent in each state of the reception. ``README.md`` beside this
file has both tables.
"""

from enum import IntEnum
from typing import Final, NamedTuple


class Reception(IntEnum):
    """Use of received bytes."""

    IN_SYNC = 0  # replies belong to the requests that wait for them
    OUT_OF_SYNC = 1  # the next reply may belong to an earlier request: it is dropped
    NOISY = 2  # the line did not become quiet after a broken reply
    DISCARDING = 3  # bytes are dropped until the line is quiet
    DISCARDING_OUT_OF_SYNC = 4  # the same; then the next reply is dropped
    DISCARDING_NOISY = 5  # the same, once more, on a line that did not become quiet before


class Timeliness(IntEnum):
    """Timeliness of the replies. The numbers differ from those of `Reception`, because both are keys of one table."""

    ON_TIME = 10  # every drive answered the last request to it
    SILENT = 11  # a drive did not answer; its reply is not expected any more, and it is asked after the others
    LATE = 12  # a drive did not answer, and its reply may still come: it is not asked until then


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


TRANSITIONS: Final[dict[tuple[State, LineEvent], State]] = {
    (Reception.IN_SYNC, LineEvent.LAST_REPLY_BROKEN): Reception.DISCARDING,
    (Reception.IN_SYNC, LineEvent.LATE_REPLY_BROKEN): Reception.DISCARDING,
    (Reception.OUT_OF_SYNC, LineEvent.LAST_REPLY): Reception.DISCARDING,
    (Reception.OUT_OF_SYNC, LineEvent.LAST_REPLY_BROKEN): Reception.DISCARDING_OUT_OF_SYNC,
    (Reception.OUT_OF_SYNC, LineEvent.LATE_REPLY_BROKEN): Reception.DISCARDING_OUT_OF_SYNC,
    (Reception.NOISY, LineEvent.REPLY): Reception.IN_SYNC,
    (Reception.NOISY, LineEvent.LAST_REPLY): Reception.IN_SYNC,
    (Reception.NOISY, LineEvent.LAST_REPLY_BROKEN): Reception.DISCARDING_NOISY,
    (Reception.NOISY, LineEvent.LATE_REPLY_BROKEN): Reception.DISCARDING_NOISY,
    (Reception.DISCARDING, LineEvent.LINE_QUIET): Reception.IN_SYNC,
    (Reception.DISCARDING, LineEvent.LINE_NEVER_QUIET): Reception.NOISY,
    (Reception.DISCARDING, LineEvent.LINE_LOST): Reception.IN_SYNC,
    (Reception.DISCARDING_OUT_OF_SYNC, LineEvent.LINE_QUIET): Reception.OUT_OF_SYNC,
    (Reception.DISCARDING_OUT_OF_SYNC, LineEvent.LINE_NEVER_QUIET): Reception.NOISY,
    (Reception.DISCARDING_OUT_OF_SYNC, LineEvent.LINE_LOST): Reception.OUT_OF_SYNC,
    (Reception.DISCARDING_NOISY, LineEvent.LINE_QUIET): Reception.IN_SYNC,
    (Reception.DISCARDING_NOISY, LineEvent.LINE_NEVER_QUIET): Reception.NOISY,
    (Reception.DISCARDING_NOISY, LineEvent.LINE_LOST): Reception.NOISY,
    (Timeliness.ON_TIME, LineEvent.REPLY_OVERDUE): Timeliness.LATE,
    (Timeliness.ON_TIME, LineEvent.REPLY_MISSED): Timeliness.SILENT,
    (Timeliness.SILENT, LineEvent.REPLY_OVERDUE): Timeliness.LATE,
    (Timeliness.SILENT, LineEvent.ALL_ANSWERED): Timeliness.ON_TIME,
    (Timeliness.LATE, LineEvent.NO_REPLY_LATE): Timeliness.SILENT,
}

# If replies do not show which of several drives they are from, these rows replace those above: a lost or damaged reply
# may still come, and would then be taken for a reply of another drive.
ANONYMOUS_TRANSITIONS: Final[dict[tuple[State, LineEvent], State]] = {
    (Reception.IN_SYNC, LineEvent.BROKEN_REPLY): Reception.OUT_OF_SYNC,
    (Reception.IN_SYNC, LineEvent.LAST_REPLY_BROKEN): Reception.DISCARDING_OUT_OF_SYNC,
    (Reception.IN_SYNC, LineEvent.LATE_REPLY_EXPIRED): Reception.OUT_OF_SYNC,
    (Reception.NOISY, LineEvent.REPLY): Reception.OUT_OF_SYNC,
    (Reception.NOISY, LineEvent.LAST_REPLY): Reception.DISCARDING,
    (Reception.DISCARDING, LineEvent.LATE_REPLY_EXPIRED): Reception.DISCARDING_OUT_OF_SYNC,
    (Reception.DISCARDING_NOISY, LineEvent.LINE_QUIET): Reception.OUT_OF_SYNC,
}


class Permission(NamedTuple):
    """Requests that may be sent in a state of the reception, and use of the replies."""

    requests: bool  # requests with a reply
    commands: bool  # commands without a reply
    together: bool  # several requests in one write, and requests while a reply is outstanding
    joined: bool  # requests in one write with commands before them
    replies_used: bool  # the contents of replies are used


_YES, _NO = True, False
PERMISSIONS: Final[dict[Reception, Permission]] = {
    # in order: requests, commands, together, joined, replies_used
    Reception.IN_SYNC: Permission(_YES, _YES, _YES, _YES, _YES),
    Reception.OUT_OF_SYNC: Permission(_YES, _YES, _NO, _NO, _NO),
    Reception.NOISY: Permission(_YES, _YES, _YES, _NO, _YES),
    Reception.DISCARDING: Permission(_NO, _NO, _NO, _NO, _NO),
    Reception.DISCARDING_OUT_OF_SYNC: Permission(_NO, _NO, _NO, _NO, _NO),
    Reception.DISCARDING_NOISY: Permission(_NO, _YES, _YES, _NO, _NO),
}
ANONYMOUS_PERMISSIONS: Final[dict[Reception, Permission]] = {
    Reception.NOISY: Permission(_YES, _YES, _NO, _NO, _NO),
    Reception.DISCARDING_NOISY: Permission(_NO, _YES, _NO, _NO, _NO),
}


class LineState:
    """Present state of one line; only `apply` changes it. ``names_drives``: each reply shows which drive it is from."""

    def __init__(self, *, names_drives: bool) -> None:
        self.transitions = TRANSITIONS if names_drives else TRANSITIONS | ANONYMOUS_TRANSITIONS
        self.permissions = PERMISSIONS if names_drives else PERMISSIONS | ANONYMOUS_PERMISSIONS
        self.reception = Reception.IN_SYNC
        self.timeliness = Timeliness.ON_TIME
        self._update()

    def apply(self, event: LineEvent) -> None:
        """Change the state by the table; an event without a row for the present state changes nothing."""
        for state in (self.reception, self.timeliness):
            following = self.transitions.get((state, event))
            if isinstance(following, Reception):
                self.reception = following
            elif following is not None:
                self.timeliness = following
        self._update()

    def _update(self) -> None:
        self.permission = self.permissions[self.reception]
        self.is_normal = self.reception is Reception.IN_SYNC and self.timeliness is Timeliness.ON_TIME
        # received bytes are dropped until the line is quiet
        self.is_discarding = self.reception >= Reception.DISCARDING
        # the line did not become quiet: commands without a reply do not wait for that
        self.is_noisy = self.reception in (Reception.NOISY, Reception.DISCARDING_NOISY)
