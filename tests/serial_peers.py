"""A line without wire for tests of what serial drives share: time is a number, the peer a function of bytes."""

from collections.abc import Callable

from friction_hil_drivers.serial_line.line import LineGoneError
from friction_hil_drivers.serial_line.options import LineOptions
from friction_hil_drivers.serial_line.protocol import Image, ReplyError, Single

MS = 1_000_000


class Time:
    """A clock that stands still between `pass_ms`."""

    def __init__(self) -> None:
        self.ns = 1_000_000_000

    def __call__(self) -> int:
        return self.ns

    def pass_ms(self, ms: float) -> None:
        self.ns += round(ms * MS)


class BenchLine:
    """In place of a `Line`: ``answer`` gets what is written and returns what is there to be read at once."""

    def __init__(self, answer: Callable[[bytes], bytes], **options: object) -> None:
        self.options = LineOptions.model_validate({"port": "/dev/bench", "baud": 100000, **options})
        self.answer = answer
        self.sent: list[bytes] = []
        self.arrived = b""
        self.is_back = False
        self.descriptor = 3

    @property
    def is_open(self) -> bool:
        return self.descriptor >= 0

    def read(self, *, is_ready: bool = True) -> bytes:
        if not self.is_open:
            raise LineGoneError("/dev/bench is gone")
        data, self.arrived = self.arrived, b""
        return data

    def write(self, data: bytes) -> None:
        if not self.is_open:
            raise LineGoneError("/dev/bench is gone")
        self.sent.append(data)
        self.arrived += self.answer(data)

    def acknowledge(self) -> None:
        """Nothing holds replies back here."""

    def pull_out(self) -> None:
        """From now on every use fails, until `is_back`."""

        def gone(*_: object, **__: object) -> bytes:
            self.descriptor = -1
            raise LineGoneError("/dev/bench is gone: unplugged")

        self.read = gone  # type: ignore[method-assign]

    def reopen(self) -> bool:
        if self.is_back:
            self.descriptor = 3
            del self.read  # type: ignore[method-assign]
        return self.is_open

    def close(self) -> None:
        self.descriptor = -1


def cut(received: bytearray) -> bytes | None:
    """Remove a reply with its semicolon; None while it is not complete."""
    head, mark, rest = bytes(received).partition(b";")
    if not mark:
        return None
    received[:] = rest
    return head


class Ask(Single):
    """A made-up exchange: ``NAME?`` is answered by a number and a semicolon; ``!`` is a refusal."""

    def __init__(self, image: Image, name: str, drive: str = "a drive") -> None:
        self.image = image
        self.name = name
        self.label = f"reading {name}"
        self.addressees = self.unanswered = frozenset((drive,))
        self.reads: tuple[str, ...] = (name,)
        self.writes: tuple[str, ...] = ()
        self.request_size, self.reply_size = len(name) + 1, 8

    def encode(self) -> bytes:
        return f"{self.name}?".encode()

    def take(self, received: bytearray) -> bool:
        if (head := cut(received)) is None:
            return False
        if head == b"!":
            raise ReplyError("the drive refuses", is_complete=True)
        try:
            number = float(head)
        except ValueError:
            raise ReplyError(f"{head!r} is no number") from None
        self.image.put((self.name,), (number,))
        return True


class Word(Ask):
    """An `Ask` that may follow one with another number of letters, whose reply has as many letters before it."""

    def may_follow(self, before: object) -> bool:
        return isinstance(before, Word) and len(before.name) != len(self.name)

    def take(self, received: bytearray) -> bool:
        if (head := cut(received)) is None:
            return False
        name, _, number = head.decode().partition(" ")
        if name == "!":
            raise ReplyError("the drive refuses", is_unsolicited=True)
        if len(name) != len(self.name):
            raise ReplyError(f"{name} in place of {self.name}")
        self.image.put((self.name,), (float(number),))
        return True


class Push(Single):
    """A made-up command to which nothing is replied but a refusal: ``!;``."""

    reports_refusal = True

    def __init__(self, image: Image, name: str) -> None:
        self.image, self.name, self.label = image, name, f"pushing {name}"
        self.addressees = self.unanswered = frozenset(("a drive",))
        self.reads: tuple[str, ...] = ()
        self.writes: tuple[str, ...] = (name,)
        self.request_size, self.reply_size = 12, 0

    def encode(self) -> bytes:
        return f"{self.name}={self.image.values[self.name]:g};".encode()

    def take(self, received: bytearray) -> bool:
        if (head := cut(received)) is None:
            return False
        raise ReplyError("the drive refuses", is_unsolicited=head == b"!")


class Tell(Push):
    """A made-up command: ``NAME=NUMBER;``, answered by ``;`` where ``is_answered``."""

    reports_refusal = False

    def __init__(self, image: Image, name: str, *, is_answered: bool = False) -> None:
        super().__init__(image, name)
        self.label = f"writing {name}"
        self.reply_size = int(is_answered)

    def take(self, received: bytearray) -> bool:
        if (head := cut(received)) is None:
            return False
        if head:
            raise ReplyError("the drive refuses", is_complete=head == b"!")
        return True
