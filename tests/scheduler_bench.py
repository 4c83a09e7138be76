"""A scheduler of a serial line on the bench: its peer answers by a table, and time is simulated."""

from friction_hil_drivers.serial_line.protocol import Image, shown
from friction_hil_drivers.serial_line.scheduler import BusScheduler

from tests.serial_peers import MS, Ask, BenchLine, Time, Word

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

    def ask(self, name="position", done=None):
        exchange = Ask(self.image, name)
        self.scheduler.enqueue((exchange,), done)
        return exchange

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
