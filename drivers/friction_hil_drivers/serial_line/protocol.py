"""Interfaces of a serial protocol: exchanges, and the plan of a cycle that is made of them."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Protocol, TypeVar

# Signals that the driver itself uses; a description may have others for its sequences.
FAST = ("position", "velocity")  # read in every cycle
TEMPERATURE = "temperature"  # read as those that follow, where the friction model depends on it
SLOW = ("torque", "status", "error")  # read in every cycle if that costs no request, else by background reads
COMMANDS = ("position_command", "velocity_command", "torque_command")
_SHOWN = 60  # characters
_SHOWN_BYTES = 24


class ReplyError(Exception):
    """Received bytes are no valid reply: a wrong checksum, an exception, a reply of another drive."""

    def __init__(self, message: str, *, is_complete: bool = False, is_unsolicited: bool = False) -> None:
        super().__init__(message)
        # the drive sends nothing more (an exception code, an error text); otherwise more bytes may come, and the line
        # has to become quiet before the next request
        self.is_complete = is_complete
        self.is_unsolicited = is_unsolicited  # the error may belong to an earlier request that has no reply


@dataclass(slots=True)
class Image:
    """Process image of one drive: the values of its signals in the drive's own numbers, by name."""

    values: dict[str, float] = field(default_factory=dict)  # read last, or to be written
    fresh: set[str] = field(default_factory=set)  # signals read since the set was last emptied

    def put(self, names: Sequence[str], numbers: Sequence[float]) -> None:
        """Store numbers that were read together. Raises `ReplyError`: a number is not finite; none was stored."""
        if not all(map(math.isfinite, numbers)):
            listed = ", ".join(f"{n} is {x}" for n, x in zip(names, numbers, strict=True) if not math.isfinite(x))
            raise ReplyError(listed, is_complete=True)
        self.values.update(zip(names, numbers, strict=True))
        self.fresh.update(names)


class Exchange(Protocol):
    """Request and its reply. An exchange is made once for its process images, and used in many cycles."""

    label: str  # for messages: "read 3 registers at 6064h of unit 1"
    addressees: frozenset[str]  # drives that answer, each by its name on the line
    reads: tuple[str, ...]
    writes: tuple[str, ...]
    request_size: int  # largest number of characters on the line
    reply_size: int  # largest number of characters on the line; 0: no reply comes
    reports_refusal: bool  # no reply comes unless the drive refuses the request
    is_acknowledged: bool  # the drive replies that it has carried the request out
    constant: bytes  # the request if it is always the same; empty: `encode` has to be called

    @property
    def unanswered(self) -> frozenset[str]:
        """Addressees that have not answered yet."""
        ...

    def encode(self) -> bytes:
        """Return the request with the values of the images. Raises `ValueError`: a value is not finite."""
        ...

    def take(self, received: bytearray) -> bool:
        """Remove the reply from ``received`` and store it in the images; return True if it is complete.

        Raises `ReplyError`: the bytes are no reply to this request.
        """
        ...

    def may_follow(self, before: "Exchange") -> bool:
        """Return True if the request may be sent while ``before`` is outstanding: their replies cannot be confused."""
        ...

    def without(self, addressees: frozenset[str]) -> "Exchange | None":
        """Return the same exchange with all other addressees; None if there is no such exchange."""
        ...


class Single:
    """Defaults of an `Exchange` that is sent singly and undivided, to drives that send no unsolicited errors."""

    reports_refusal = False
    is_acknowledged = True
    constant = b""

    def may_follow(self, before: Exchange) -> bool:
        """See `Exchange`."""
        return False

    def without(self, addressees: frozenset[str]) -> Exchange | None:
        """See `Exchange`."""
        return None


Part = TypeVar("Part")


def only(parts: Sequence[Part], verb: str, names: Sequence[str]) -> Part:
    """Return the only block that holds some signals.

    Raises `ValueError`: the signals lie in several blocks, or in none: no single request can ``verb`` them.
    """
    if len(parts) != 1:
        listed = "; ".join(map(str, parts))
        raise ValueError(f"one request cannot {verb} {', '.join(names)}: they lie in {listed or 'nothing'}")
    return parts[0]


def shown(data: bytes | bytearray) -> str:
    """Return received bytes as text, for messages."""
    text = repr(bytes(data[:_SHOWN]))[2:-1]
    return f"'{text}'" + (" ..." if len(data) > _SHOWN else "")


def in_hex(data: bytes | bytearray) -> str:
    """Return received bytes in hexadecimal numbers, for messages."""
    return data[:_SHOWN_BYTES].hex(" ") + (" ..." if len(data) > _SHOWN_BYTES else "")


@dataclass(frozen=True, slots=True)
class CycleSignals:
    """Signals of one axis that the cycles read and write, by name."""

    fast: tuple[str, ...]  # read in every cycle
    slow: tuple[str, ...]  # read in every cycle if that costs no request, else by background reads
    commands: tuple[str, ...]  # written in every cycle; empty if the drive is only read


@dataclass(frozen=True, slots=True)
class Plan:
    """Exchanges of a cycle on one line."""

    poll: tuple[Exchange, ...]  # made in each cycle before the computation
    background: tuple[Exchange, ...]  # one of them is made in each cycle, after the push
    push: tuple[Exchange, ...]  # made in each cycle after the computation; empty if the next poll writes the commands


class LineProtocol(Protocol):
    """Protocol on one line, for the axes on it."""

    silence_chars: float  # silence after each frame, in characters
    numbers_replies: bool  # each reply shows to which request it belongs
    names_drives: bool  # each reply shows which drive it is from
    ahead_chars: int  # characters of requests that a drive reads before it answers the first; 0: one request at a time
    reply_form: str  # what a valid reply looks like, for messages: "a reply ends in a CRC-16"

    def show(self, data: bytes | bytearray, /) -> str:
        """Return received bytes as messages show them, with what they say of their sender."""
        ...

    def plan(self, wanted: Mapping[str, CycleSignals]) -> Plan:
        """Plan a cycle with as few exchanges as possible, for the axes by name."""
        ...

    def read(self, axis: str, names: Sequence[str]) -> Exchange:
        """Return the exchange that reads some signals of an axis together (possible at least for each single one)."""
        ...

    def write(self, axis: str, names: Sequence[str]) -> Exchange:
        """Return the exchange that writes some signals of an axis together (possible at least for each single one)."""
        ...

    def reboot(self, axis: str) -> Exchange | None:
        """Return the exchange that restarts the drive of an axis; None if the protocol has none."""
        ...


class ProtocolFactory(Protocol):
    """Class of a line's protocol; all mappings are by axis."""

    def __call__(
        self, descriptions: Mapping[str, Any], options: Mapping[str, Any], images: Mapping[str, Image], /
    ) -> LineProtocol:
        """Return the protocol of a line with these axes."""
        ...
