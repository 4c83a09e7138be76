"""Several axes behind one drive whose replies tell neither axis nor request, on a line that holds replies up."""

from collections import deque

import pytest
from friction_hil_drivers.ascii.description import AsciiDescription
from friction_hil_drivers.ascii.driver import AsciiDrives, AsciiLine
from friction_hil_drivers.ascii.messages import Language
from friction_hil_drivers.ascii.options import AsciiOptions
from friction_hil_drivers.serial_line.description import load_description
from friction_hil_drivers.serial_line.protocol import CycleSignals, Image
from friction_hil_drivers.serial_line.scheduler import BusScheduler
from hypothesis import given
from hypothesis import strategies as st

from tests.serial_rig import MS, BenchLine, Time

ODRIVE = load_description("odrive", None, AsciiDrives.descriptions, AsciiDescription)
WANTED = CycleSignals(("position", "velocity"), ("torque", "status", "error"), ("torque_command",))
STEP_MS, CYCLE_MS, TURN_MS, ANSWER_MS, PIECE_MS = 0.1, 2.0, 0.3, 0.1, 0.4
REPLY_LIMIT_S, REPLY_S = 8e-3, 3e-3
MAX_MISSED = 10  # four tenths of that is the limit above


class Bench:
    """An ODrive that answers in order. Position tells axis and number of the request, ``fates`` what becomes of it.

    Parameters
    ----------
    axes : int
    fates : iterable
        Of each reply: None, it is lost; else the time for which this one and all behind it are held up, ms.
    cut : int, optional
        Replies come in two pieces, so many characters and then the rest.
    """

    def __init__(self, axes, fates=(), cut=None):
        names = [str(number) for number in range(axes)]
        # without a checksum a part of a reply looks like one
        description = ODRIVE.model_copy(update={"checksum": None})
        line = {"port": "/dev/bench", "baud": 921600}
        options = {n: AsciiOptions.model_validate({"line": line, "description": "odrive", "axis": n}) for n in names}
        self.images = {name: Image({"torque_command": 0.25}) for name in names}
        protocol = AsciiLine(dict.fromkeys(names, description), options, self.images)
        self.plan = protocol.plan(dict.fromkeys(names, WANTED))
        self.time = Time()
        self.line = BenchLine(self._hear)
        self.scheduler = BusScheduler(
            self.line,
            list(self.images.values()),
            0.0,
            REPLY_LIMIT_S,
            self.time,
            ahead_chars=protocol.ahead_chars,
            anonymous_reply_s=0.0 if protocol.names_drives else REPLY_S,
        )
        self.asked = dict.fromkeys(names, 0)
        self._language = Language(description, "0")
        self._fates, self._cut = iter(fates), cut
        self._free_ns = self._turn = 0
        self._coming = deque()

    def _hear(self, data):
        for request in data.decode().splitlines():
            if request[0] == "f":
                axis = request[2]
                self.asked[axis] += 1
                self._reply(f"{int(axis) * 1000 + self.asked[axis]}.0 {axis}.0")
            elif request[0] == "r":
                self._reply({"I": "-1.25", "c": "8", "e": "4096"}[request.rpartition(".")[2][0]])
        return b""

    def _reply(self, text):
        fate = next(self._fates, 0.0)
        at_ns = max(self.time.ns, self._free_ns) + round((ANSWER_MS + (fate or 0.0)) * MS)
        self._free_ns = at_ns
        if fate is None:
            return
        line = self._language.seal_reply(text.encode())
        cut = len(line) if self._cut is None else self._cut
        self._coming.append((at_ns, line[:cut]))
        self._free_ns = at_ns + round((0.0 if self._cut is None else PIECE_MS) * MS)
        self._coming.append((self._free_ns, line[cut:]))

    def _pass(self, ms):
        end = self.time.ns + round(ms * MS)
        while self.time.ns < end:
            while self._coming and self._coming[0][0] <= self.time.ns:
                self.line.arrived += self._coming.popleft()[1]
            self.scheduler.poll()
            self.time.pass_ms(STEP_MS)

    def cycle(self):
        """Poll, then command, and ask for the next of what changes slowly; axes whose feedback came."""
        for image in self.images.values():
            image.fresh.clear()
        self.scheduler.enqueue(self.plan.poll)
        self.scheduler.poll()
        self._pass(CYCLE_MS - TURN_MS)
        self.scheduler.end_cycle()
        fresh = {name for name, image in self.images.items() if image.fresh >= {"position", "velocity"}}
        for name in fresh:
            told = int(self.images[name].values["position"])
            assert told == int(name) * 1000 + self.asked[name], f"axis {name} was told {told}"
        for image in self.images.values():
            assert image.values.get("torque", -1.25) == -1.25
            assert image.values.get("status", 8.0) == 8.0
            assert image.values.get("error", 4096.0) == 4096.0
        self._turn = (self._turn + 1) % len(self.plan.background)
        self.scheduler.enqueue((*self.plan.push, self.plan.background[self._turn]))
        self.scheduler.flush()
        self._pass(TURN_MS)
        return fresh


@pytest.mark.parametrize("axes", [1, 2])
@pytest.mark.parametrize("cut", range(1, 6))
def test_the_beginning_of_a_reply_stays_when_the_next_request_joins(axes, cut):
    """The poll goes out while the reply to the last cycle's turn is half there."""
    bench = Bench(axes, cut=cut)
    for _ in range(12):
        assert len(bench.cycle()) == axes
    assert bench.images["0"].values["error"] == 4096.0
    assert bench.scheduler.last_error == ""


# one stall at a time: whatever was held up comes in a row, longer than any limit or not, and then the line is well
@given(
    before=st.integers(0, 12),
    stall_ms=st.floats(0.0, 60.0),
    lost=st.lists(st.booleans(), max_size=6),
    cut=st.none() | st.integers(1, 5),
)
def test_after_a_stall_no_axis_is_told_what_is_another_ones_or_old(before, stall_ms, lost, cut):
    fates = [0.0] * before + [stall_ms] + [None if is_lost else 0.0 for is_lost in lost]
    bench = Bench(2, fates, cut)
    fresh = [bench.cycle() for _ in range(60)]
    assert all(len(names) == 2 for names in fresh[-10:]), "the line is well again"


@pytest.mark.parametrize("lost", range(8))
def test_a_single_lost_reply_is_bridged(lost):
    bench = Bench(2, [0.0] * lost + [None])
    missed = [2 - len(bench.cycle()) for _ in range(30)]
    assert 0 < sum(each > 0 for each in missed) < MAX_MISSED
    assert missed[-10:] == [0] * 10


@given(before=st.integers(0, 12), stall_ms=st.floats(0.0, REPLY_LIMIT_S * 1e3 - CYCLE_MS))
def test_of_one_axis_nothing_old_is_told_within_the_limit(before, stall_ms):
    bench = Bench(1, [0.0] * before + [stall_ms])
    fresh = [bench.cycle() for _ in range(30)]  # which compares each feedback with its request
    assert fresh[-10:] == [{"0"}] * 10, "the line is well again"


@pytest.mark.parametrize("turn_ms", [0.0, TURN_MS])
def test_an_undisturbed_line_is_spoken_on_at_once(turn_ms):
    """Also while the reply to the last cycle's turn is still on its way."""
    bench = Bench(1, [0.0, turn_ms] * 10)
    for _ in range(10):
        assert bench.cycle() == {"0"}
    assert len(bench.line.sent) == 20
