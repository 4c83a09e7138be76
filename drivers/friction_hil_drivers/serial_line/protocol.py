"""Interfaces of a serial protocol: exchanges, and the plan of a cycle that is made of them."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol, TypeVar

# Signals that the driver itself understands; a description may have others, for its sequences.
FAST = ("position", "velocity")  # read in every cycle
SLOW = ("torque", "status", "error")  # read in every cycle if that costs no request, else by background reads
COMMANDS = ("position_command", "velocity_command", "torque_command")
_SHOWN = 60  # characters


class ReplyError(Exception):
    """The received bytes are no valid reply: a wrong checksum, an exception, a reply of another drive.

    Parameters
    ----------
    message : str
        Description of the received bytes, for people.
    is_complete : bool
        The drive has sent all it will send (an exception code, an error text). Otherwise more may come, and the
        line has to fall silent before the next request.
    is_unsolicited : bool
        The error may belong to an earlier request to which nothing is replied otherwise.
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
        Signals read since the set was last emptied.
    """

    values: dict[str, float] = field(default_factory=dict)
    fresh: set[str] = field(default_factory=set)

    def put(self, names: Sequence[str], numbers: Sequence[float]) -> None:
        """Store numbers that were read together.

        Raises
        ------
        ReplyError
            One of them is not finite; none was stored.
        """
        if not all(map(math.isfinite, numbers)):
            listed = ", ".join(f"{n} is {x}" for n, x in zip(names, numbers, strict=True) if not math.isfinite(x))
            raise ReplyError(listed, is_complete=True)
        self.values.update(zip(names, numbers, strict=True))
        self.fresh.update(names)


class Exchange(Protocol):
    """One request and its reply. It is made once for certain process images, and used in many cycles."""

    label: str  # for messages: "read 3 registers at 6064h of unit 1"
    addressees: frozenset[str]  # drives that answer, each by its name on the line
    reads: tuple[str, ...]
    writes: tuple[str, ...]
    request_size: int  # characters on the line, at most
    reply_size: int  # likewise; 0: no reply comes
    reports_refusal: bool  # no reply comes, but an error does if the drive refuses
    constant: bytes  # the request, if it is always the same; empty: `encode` has to be called

    @property
    def unanswered(self) -> frozenset[str]:
        """Addressees that have not answered yet."""
        ...

    def encode(self) -> bytes:
        """Return the request; the values that it writes are those of the images.

        Raises
        ------
        ValueError
            A value is not finite.
        """
        ...

    def take(self, received: bytearray) -> bool:
        """Remove the reply from ``received`` and store it in the images; return True if it is complete.

        Raises
        ------
        ReplyError
            It is no reply to this request.
        """
        ...

    def may_follow(self, before: "Exchange") -> bool:
        """Return True if it may be sent while ``before`` is outstanding: their replies cannot be confused."""
        ...

    def without(self, addressees: frozenset[str]) -> "Exchange | None":
        """Return the same exchange with all other addressees; None if it cannot be divided so."""
        ...


class Single:
    """Defaults of an `Exchange` that is sent alone, as a whole, to drives that send no unsolicited errors."""

    reports_refusal = False
    constant = b""

    def may_follow(self, before: Exchange) -> bool:
        """See `Exchange`."""
        return False

    def without(self, addressees: frozenset[str]) -> Exchange | None:
        """See `Exchange`."""
        return None


Part = TypeVar("Part")


def only(parts: Sequence[Part], verb: str, names: Sequence[str]) -> Part:
    """Return the only part of a drive in which some signals lie.

    Raises
    ------
    ValueError
        They lie in several parts, or in none: no single request can ``verb`` them.
    """
    if len(parts) != 1:
        listed = "; ".join(map(str, parts))
        raise ValueError(f"one request cannot {verb} {', '.join(names)}: they lie in {listed or 'nothing'}")
    return parts[0]


def shown(data: bytes | bytearray) -> str:
    """Return received bytes as text, for messages."""
    text = repr(bytes(data[:_SHOWN]))[2:-1]
    return f"'{text}'" + (" ..." if len(data) > _SHOWN else "")


@dataclass(frozen=True, slots=True)
class CycleSignals:
    """Signals that a cycle of one axis reads and writes, by name."""

    fast: tuple[str, ...]  # to be read in every cycle
    slow: tuple[str, ...]  # to be read now and then, in the background
    commands: tuple[str, ...]  # to be written in every cycle; none if the drive is only read


@dataclass(frozen=True, slots=True)
class Plan:
    """The exchanges of a cycle on one line."""

    poll: tuple[Exchange, ...]  # each cycle, before the computation
    background: tuple[Exchange, ...]  # one of them each cycle, after the push
    push: tuple[Exchange, ...]  # each cycle, after the computation; empty if the next poll writes the commands


class LineProtocol(Protocol):
    """A protocol on one line, for the axes there."""

    silence_chars: float  # silence that ends a frame and has to pass before the next one
    numbers_replies: bool  # each reply tells to which request it belongs
    names_drives: bool  # each reply tells which drive it is from
    ahead_chars: int  # characters of requests that a drive reads before it answers the first; 0: one request at a time

    def plan(self, wanted: Mapping[str, CycleSignals]) -> Plan:
        """Plan a cycle with as few exchanges as possible, for the axes by name."""
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
