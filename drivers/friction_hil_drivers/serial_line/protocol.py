"""What a protocol has to provide so that its drives can be driven: exchanges, and a plan of a cycle made of them."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol

# Signals that the driver itself understands; a description may have others, for its sequences.
FAST = ("position", "velocity")  # read in every cycle
SLOW = ("torque", "status", "error")  # read in every cycle where they come along, else in turns
COMMANDS = ("position_command", "velocity_command", "torque_command")


class ReplyError(Exception):
    """A reply came that is none: a wrong checksum, an exception, somebody else's.

    Parameters
    ----------
    message : str
        What came, in words.
    is_complete : bool
        The drive has said all it has to say (an exception code, an error text). Otherwise more may come, and the
        line has to fall silent before the next request.
    """

    def __init__(self, message: str, *, is_complete: bool = False) -> None:
        super().__init__(message)
        self.is_complete = is_complete


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

    def put(self, name: str, value: float) -> None:
        """Take a value that was read.

        Raises
        ------
        ReplyError
            It is not finite.
        """
        if not math.isfinite(value):
            raise ReplyError(f"{name} is {value}", is_complete=True)
        self.values[name] = value
        self.fresh.add(name)


class Exchange(Protocol):
    """One request and its reply. It is made once, bound to the images that it serves, and used in many cycles."""

    what: str  # for people: "read 3 registers at 6064h of unit 1"
    addressees: frozenset[str]  # drives that answer, each by a name of its own on the line
    reads: tuple[str, ...]
    writes: tuple[str, ...]
    request_size: int  # characters on the line, the most there can be
    reply_size: int  # likewise; 0: no reply comes

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


@dataclass(frozen=True, slots=True)
class Wanted:
    """What a cycle of one axis needs, by names of signals."""

    fast: tuple[str, ...]  # to be read in every cycle
    slow: tuple[str, ...]  # to be read now and then
    commands: tuple[str, ...]  # to be written in every cycle; none where the drive is only listened to


@dataclass(frozen=True, slots=True)
class Plan:
    """The exchanges of a cycle on one line."""

    poll: tuple[Exchange, ...]  # each cycle, before the computation
    turns: tuple[Exchange, ...]  # one of them each cycle, after the poll
    push: tuple[Exchange, ...]  # each cycle, after the computation; none where the poll of the next cycle writes


class LineProtocol(Protocol):
    """A protocol as it is spoken on one line, to the axes there."""

    silence_chars: float  # that end a frame and have to pass before the next one
    numbers_replies: bool  # a reply tells to which request it belongs

    def plan(self, wanted: Mapping[str, Wanted]) -> Plan:
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
