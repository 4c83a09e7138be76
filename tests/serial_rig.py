"""The rig for serial lines: a scheduler on a line without wire, and a whole driver with its simulated drive.

On the line without wire time is a number, and the peer a function of bytes. The driver and its simulated drive are
connected by a pseudo-terminal or a TCP connection.
"""

import threading
import time
from collections.abc import Callable

from friction_hil_drivers.ascii.driver import AsciiDrives
from friction_hil_drivers.ascii.simulated import SimulatedAsciiDrives
from friction_hil_drivers.dynamixel.driver import DynamixelDrives
from friction_hil_drivers.dynamixel.simulated import SimulatedDynamixelDrives
from friction_hil_drivers.modbus.driver import ModbusDrives
from friction_hil_drivers.modbus.simulated import SimulatedModbusDrives
from friction_hil_drivers.serial_line.line import LineGoneError
from friction_hil_drivers.serial_line.options import LineOptions
from friction_hil_drivers.serial_line.protocol import Image, ReplyError, Single, shown
from friction_hil_drivers.serial_line.scheduler import BusScheduler

from friction_hil.daemon.realtime import SteppedClock
from friction_hil.drive import Command, DriveState, Feedback, Request
from tests.peers.serial_processes import free_tcp_port
from tests.servo_drives import axis_dict, configuration

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


SILENCE_CHARS = 3.5
CHARACTER_MS = 0.1  # 10 bits at 100 kbaud
SILENCE_MS = SILENCE_CHARS * CHARACTER_MS
REPLY_LIMIT_MS = 50.0


class Bench:
    """A scheduler whose peer answers by a table."""

    def __init__(self, *, reply_limit_ms=REPLY_LIMIT_MS, show=shown, **answers):
        self.answers = answers
        self.time = Time()
        self.image = Image()
        self.line = BenchLine(lambda data: self.answers.get(data.decode(), b""))
        self.scheduler = BusScheduler(
            self.line, [self.image], SILENCE_CHARS, reply_limit_ms * 1e-3, self.time, show=show
        )

    @property
    def is_finished(self):
        return not self.scheduler.queue and not self.scheduler.outstanding

    def say(self, *exchanges, done=None):
        self.scheduler.enqueue(exchanges, done)

    def ask(self, name="position", drive="a drive", done=None):
        self.say(Ask(self.image, name, drive), done=done)

    def miss(self, name, drive):
        """A cycle in which a drive does not reply."""
        self.ask(name, drive)
        self.go(5.0)
        self.scheduler.end_cycle()

    def go(self, ms=10.0, each=0.1):
        """Let time pass, working whenever there is something to do."""
        end = self.time.ns + round(ms * MS)
        while self.time.ns < end:
            self.scheduler.poll()
            self.time.pass_ms(each)

    def cycle(self, name="position"):
        """One cycle: ask, let 5 ms pass, give up; the value if it came."""
        self.image.fresh.clear()
        self.ask(name)
        self.go(5.0)
        self.scheduler.end_cycle()
        return self.image.values[name] if name in self.image.fresh else None


class Ahead(Bench):
    """A peer that takes in so many characters before it answers; replies come when they are given to the line."""

    def __init__(self, chars=64, **answers):
        super().__init__()
        self.line.answer = lambda data: b"".join(answers.get(part, b"") for part in data.decode().split("?")[:-1])
        self.scheduler = BusScheduler(self.line, [self.image], 0.0, REPLY_LIMIT_MS * 1e-3, self.time, ahead_chars=chars)
        self.one, self.three, self.other = (Word(self.image, name) for name in ("a", "abc", "b"))


COUNTS = 2**20 / 6.283185307179586
CONTROLLER = {"position_gain": 1.0, "velocity_gain": 0.1}
PROTOCOLS = {
    "modbus": (ModbusDrives, SimulatedModbusDrives),
    "ascii": (AsciiDrives, SimulatedAsciiDrives),
    "dynamixel": (DynamixelDrives, SimulatedDynamixelDrives),
}
BY_REGISTERS = {"driver": "modbus", "unit": 3, "counts_per_unit": COUNTS, "rated_torque": 0.64}
KINDS = {
    "rtu": {**BY_REGISTERS, "description": "kinco_fd5p", "torque_constant": 0.1},
    "rtu, function 23": {**BY_REGISTERS, "description": "generic_cia402"},
    "tcp": {**BY_REGISTERS, "description": "generic_cia402"},
    "dynamixel": {"driver": "dynamixel", "description": "xl330", "id": 1, "torque_constant": 0.2},
    "odrive": {"driver": "ascii", "description": "odrive", "torque_constant": 0.1},
}
FAST_LINE = {"baud": 4_000_000, "reply_limit_s": 0.05}


def port_of(kind, tmp_path):
    if kind != "tcp":
        return str(tmp_path / "line")
    return f"tcp://127.0.0.1:{free_tcp_port()}"


def serial_configuration(kind, axes):
    """A configuration of axes of a kind in CST; ``axes`` has what is special about them, None for a key that goes."""
    base = {**axis_dict(mode="cst", controller=CONTROLLER), **KINDS[kind], "simulation": {}}
    del base["node"]
    axes = {name: {**base, **given} for name, given in axes.items()}
    return configuration(**{name: {k: v for k, v in axis.items() if v is not None} for name, axis in axes.items()})


class Rig:
    """An axis in CST with its simulated drive."""

    def __init__(self, kind, tmp_path, *, dry_run=False, faults=None, **changes):
        given = {
            "line": {"port": port_of(kind, tmp_path), **FAST_LINE},
            "is_watchdog_required": False,
            "simulation": {"line": faults or {}},
            **changes,
        }
        self._set_up(kind, {"x": given}, dry_run=dry_run)
        self.feedback, self.command = Feedback(), Command()

    def _set_up(self, kind, axes, *, dry_run=False):
        self.config = serial_configuration(kind, axes)
        self.clock = SteppedClock()
        self.driver, simulated = PROTOCOLS[KINDS[kind]["driver"]]
        self.simulated = simulated(self.config, self.config.axes, pace="sync")
        self.simulated.open()
        self._is_stopping = threading.Event()
        self._thread = threading.Thread(target=self.simulated.run, args=(self._is_stopping.is_set,))
        self._thread.start()
        self.drives = self.daemon(dry_run=dry_run)

    @property
    def bus(self):
        """The line of the driver, and ``there`` the simulated drive at the other end."""
        (bus,) = self.drives.buses
        return bus

    @property
    def there(self):
        (line,) = self.simulated.lines
        (drive,) = line.drives
        return drive

    def daemon(self, *, dry_run=False):
        return self.driver(self.config, self.config.axes, self.clock, dry_run=dry_run)

    def begin(self):
        (self.facts,) = self.drives.connect()
        self.drives.start()
        return self

    def cycle(self, request, torque=0.0, count=1):
        for _ in range(count):
            self.clock.sleep_until(self.clock.now_ns() + 1_000_000)
            end_ns = time.monotonic_ns() + 100_000_000 if self.clock.is_real else self.clock.now_ns() + 1_000_000
            self.drives.receive([self.feedback], end_ns)
            self.command.request, self.command.torque = request, torque
            self.drives.send([self.command])

    def enable(self):
        for _ in range(60):
            self.cycle(Request.ENABLE)
            if self.feedback.state is DriveState.OPERATION_ENABLED:
                return self
        raise AssertionError(self.feedback)

    def unplug(self):
        self._is_stopping.set()
        self._thread.join()
        self.simulated.close()

    def close(self):
        self.drives.close()
        self.unplug()

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.close()
