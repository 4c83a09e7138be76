"""What a protocol has to provide so that its drives can be driven: exchanges, and a plan of a cycle made of them."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol, TypeVar

# Signals that the driver itself understands; a description may have others, for its sequences.
FAST = ("position", "velocity")  # read in every cycle
SLOW = ("torque", "status", "error")  # read in every cycle where they come along, else in turns
COMMANDS = ("position_command", "velocity_command", "torque_command")
_SHOWN = 60  # characters


class ReplyError(Exception):
    """A reply came that is none: a wrong checksum, an exception, somebody else's.

    Parameters
    ----------
    message : str
        What came, in words.
    is_complete : bool
        The drive has said all it has to say (an exception code, an error text). Otherwise more may come, and the
        line has to fall silent before the next request.
    is_unsolicited : bool
        It is an error that may belong to a request before this one, to which nothing is replied otherwise.
    """

    def __init__(self, message: str, *, is_complete: bool = False, is_unsolicited: bool = False) -> None:
        super().__init__(message)
        self.is_complete = is_complete
        self.is_unsolicited = is_unsolicited


@dataclass(slots=True)
class Image:
    """Process image of one drive: the values of its signals in the drive's own numbers, by name.

    Attributes
    ----------
    values : dict of str to float
        As last read, or to be written.
    fresh : set of str
        What was read since the set was last emptied.
    """

    values: dict[str, float] = field(default_factory=dict)
    fresh: set[str] = field(default_factory=set)

    def put(self, names: Sequence[str], numbers: Sequence[float]) -> None:
        """Take numbers that were read together.

        Raises
        ------
        ReplyError
            One of them is not finite; none was taken.
        """
        if not all(map(math.isfinite, numbers)):
            listed = ", ".join(f"{n} is {x}" for n, x in zip(names, numbers, strict=True) if not math.isfinite(x))
            raise ReplyError(listed, is_complete=True)
        self.values.update(zip(names, numbers, strict=True))
        self.fresh.update(names)


class Exchange(Protocol):
    """One request and its reply. It is made once, bound to the images that it serves, and used in many cycles."""

    what: str  # for people: "read 3 registers at 6064h of unit 1"
    addressees: frozenset[str]  # drives that answer, each by a name of its own on the line
    reads: tuple[str, ...]
    writes: tuple[str, ...]
    request_size: int  # characters on the line, the most there can be
    reply_size: int  # likewise; 0: no reply comes
    tells_refusal: bool  # no reply comes, but an error does where the drive refuses
    constant: bytes  # all that `encode` would do is to return this; empty: it has to be called

    @property
    def unanswered(self) -> frozenset[str]:
        """Addressees that have not answered yet."""
        ...

    def encode(self) -> bytes:
        """Make the request, from the images' values where it writes.

        Raises
        ------
        ValueError
            A value is not finite.
        """
        ...

    def take(self, received: bytearray) -> bool:
        """Remove from ``received`` what is understood and put it into the images; whether the reply is complete.

        Raises
        ------
        ReplyError
            It is no reply to this request.
        """
        ...

    def may_follow(self, before: "Exchange") -> bool:
        """Whether it may be sent while ``before`` is not answered: neither's reply can be taken for the other's."""
        ...

    def without(self, addressees: frozenset[str]) -> "Exchange | None":
        """Return the same for all other addressees; None where it cannot be divided so."""
        ...


class Single:
    """What an `Exchange` has that is made by itself, whole or not at all, and whose drives do not err unasked."""

    tells_refusal = False
    constant = b""

    def may_follow(self, before: Exchange) -> bool:
        """See `Exchange`."""
        return False

    def without(self, addressees: frozenset[str]) -> Exchange | None:
        """See `Exchange`."""
        return None


Part = TypeVar("Part")


def only(parts: Sequence[Part], verb: str, names: Sequence[str]) -> Part:
    """Return the one part of a drive in which some signals lie.

    Raises
    ------
    ValueError
        They lie in several, or in none: no single request can ``verb`` them.
    """
    if len(parts) != 1:
        listed = "; ".join(map(str, parts))
        raise ValueError(f"one request cannot {verb} {', '.join(names)}: they lie in {listed or 'nothing'}")
    return parts[0]


def shown(data: bytes | bytearray) -> str:
    """Text of what came, for messages."""
    text = repr(bytes(data[:_SHOWN]))[2:-1]
    return f"'{text}'" + (" ..." if len(data) > _SHOWN else "")


@dataclass(frozen=True, slots=True)
class CycleSignals:
    """What a cycle of one axis needs, by names of signals."""

    fast: tuple[str, ...]  # to be read in every cycle
    slow: tuple[str, ...]  # to be read now and then
    commands: tuple[str, ...]  # to be written in every cycle; none where the drive is only listened to


@dataclass(frozen=True, slots=True)
class Plan:
    """The exchanges of a cycle on one line."""

    poll: tuple[Exchange, ...]  # each cycle, before the computation
    background: tuple[Exchange, ...]  # one of them each cycle, after the push
    push: tuple[Exchange, ...]  # each cycle, after the computation; none where the poll of the next cycle writes


class LineProtocol(Protocol):
    """A protocol as it is spoken on one line, to the axes there."""

    silence_chars: float  # that end a frame and have to pass before the next one
    numbers_replies: bool  # a reply tells to which request it belongs
    names_drives: bool  # a reply tells which of the drives it is from
    ahead_chars: int  # of requests that the drives take in before they answer the first; 0: one at a time

    def plan(self, wanted: Mapping[str, CycleSignals]) -> Plan:
        """Put a cycle together from as few exchanges as there can be, for the axes by name."""
        ...

    def read(self, axis: str, names: Sequence[str]) -> Exchange:
        """Exchange that reads some signals of an axis that can be read together (a single one always can)."""
        ...

    def write(self, axis: str, names: Sequence[str]) -> Exchange:
        """Exchange that writes some signals of an axis that can be written together (a single one always can)."""
        ...


class ProtocolFactory(Protocol):
    """Makes a line's protocol; all mappings are by axis."""

    def __call__(
        self, descriptions: Mapping[str, Any], options: Mapping[str, Any], images: Mapping[str, Image], /
    ) -> LineProtocol:
        """Make it."""
        ...
