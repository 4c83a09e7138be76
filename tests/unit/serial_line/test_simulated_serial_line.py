"""A simulated line on a real pseudo-terminal, under a clock of its own: wire time, silence, faults, supply."""

import select
from dataclasses import dataclass
from pathlib import Path

import pytest
from friction_hil_drivers.serial_line.options import LineOptions
from friction_hil_drivers.serial_line.simulated import LineFaults, SimulatedDrive
from friction_hil_drivers.serial_line.simulated.faults import Faults
from friction_hil_drivers.serial_line.simulated.port import PtyPort
from friction_hil_drivers.serial_line.simulated.server import SimulatedLine
from hypothesis import given, settings
from hypothesis import strategies as st

from friction_hil.drive import DriveState
from tests.serial_bench import LONG_S, Master, TinyResponder, make_drive

CHARACTER_NS = 1_000_000  # 10 bits at 10000 baud
TURNAROUND_NS, SILENCE_NS = 2_000_000, 3_500_000
LATE_THEN_IN_TIME = next(  # seed
    seed
    for seed in range(100)
    for faults in [Faults(LineFaults(delay=0.5, seed=seed))]
    if faults.spoil(b"0\n").is_late and not faults.spoil(b"592\n").is_late
)


@dataclass
class Bench:
    line: SimulatedLine
    master: Master
    drive: SimulatedDrive
    responder: TinyResponder

    def send(self, data, now_ns=0):
        """Put a request on the wire; it is heard at that time."""
        self.master.send(data)
        assert select.select(self.line.port.descriptors, [], [], LONG_S)[0]
        self.line.hear(now_ns)


@pytest.fixture
def make_bench(tmp_path):
    open_benches = []

    def make(is_real=True, silence_chars=0.0, **faults):
        options = LineOptions(port=str(tmp_path / "line"), baud=10000, turnaround_s=TURNAROUND_NS * 1e-9)
        drive = make_drive(is_synchronous=not is_real)
        responder = TinyResponder(drive)
        port = PtyPort(Path(options.port))
        keys = {"silence_chars": silence_chars, "is_real": is_real}
        line = SimulatedLine(port, responder, [drive], options, LineFaults(**faults), **keys)
        open_benches.append(Bench(line, Master(Path(options.port)), drive, responder))
        return open_benches[-1]

    yield make
    for bench in open_benches:
        bench.master.close()
        bench.line.port.close()


def test_characters_turn_around_and_silence_take_their_time(make_bench):
    bench = make_bench(silence_chars=3.5)
    bench.send(b"?position\n", 5_000_000)
    complete = 5_000_000 + 10 * CHARACTER_NS
    assert bench.line.due_ns == complete
    bench.line.work(complete - 1)
    assert bench.drive.samples == 0
    bench.line.work(complete + 30_000)  # the server is late: that moves nothing
    assert bench.drive.samples == 1
    assert bench.drive.time_s == pytest.approx(complete * 1e-9)
    replied = complete + SILENCE_NS + TURNAROUND_NS + 2 * CHARACTER_NS  # "0" and the line's end
    assert bench.line.due_ns == replied
    bench.line.work(replied - 1)
    assert bench.master.receive(1, 0.02) == b""
    bench.line.work(replied)
    assert bench.master.line() == b"0\n"
    assert bench.line.due_ns is None


def test_what_is_left_before_a_silence_is_no_request(make_bench):
    bench = make_bench(silence_chars=3.5)
    bench.send(b"?pos", 0)
    end = 4 * CHARACTER_NS
    for silence_ns, silences in ((SILENCE_NS, 0), (SILENCE_NS + 1, 1)):
        bench.line.work(end + silence_ns)
        assert bench.responder.silences == silences
    bench.send(b"?error\n", 20_000_000)
    bench.line.work(40_000_000)
    assert bench.master.line() == b"0\n"


@settings(max_examples=60, deadline=None)
@given(reply=st.binary(min_size=2, max_size=40), seed=st.integers(0, 1000))
def test_each_fault_does_what_it_is_called(reply, seed):
    def spoiled(**faults):
        return Faults(LineFaults(seed=seed, **faults)).spoil(reply)

    assert (spoiled().pieces, spoiled(drop=1).pieces) == ((reply,), ())
    assert (spoiled(delay=1).pieces, spoiled(delay=1).is_late) == ((reply,), True)
    corrupt = spoiled(corrupt=1).pieces[0]
    assert len(corrupt) == len(reply)
    assert (int.from_bytes(corrupt, "big") ^ int.from_bytes(reply, "big")).bit_count() == 1
    first, second = spoiled(split=1).pieces
    assert min(len(first), len(second)) > 0
    assert first + second == reply
    noisy = spoiled(noise=1).pieces[0]
    assert noisy.endswith(reply)
    assert 1 <= len(noisy) - len(reply) <= 4


def test_a_late_reply_comes_after_its_delay_and_holds_up_no_other(make_bench):
    bench = make_bench(delay=0.5, delay_s=0.5, seed=LATE_THEN_IN_TIME)
    bench.send(b"?error\n", 0)
    bench.line.work(7 * CHARACTER_NS)
    assert bench.line.due_ns == 7 * CHARACTER_NS + TURNAROUND_NS + 500_000_000 + 2 * CHARACTER_NS
    bench.send(b"?status\n", 20 * CHARACTER_NS)
    bench.line.work(28 * CHARACTER_NS)
    assert bench.line.due_ns == 28 * CHARACTER_NS + TURNAROUND_NS + 4 * CHARACTER_NS
    bench.line.work(2_000_000_000)
    assert bench.master.line() + bench.master.line() == b"592\n0\n"


@pytest.mark.parametrize("is_real", [True, False])
def test_a_reboot_is_silent_and_leaves_nothing(make_bench, is_real):
    bench = make_bench(is_real=is_real, reboot_at_s=(0.1,))
    states = []
    while bench.drive.time_s <= 0.6:
        now_ns = 30_000_000 * len(states)
        bench.send(b"control=6\n?position\n", now_ns)
        bench.line.work(now_ns + 29_000_000)
        states.append(bench.drive.state)
    assert states[1] is states[-1] is DriveState.READY_TO_SWITCH_ON
    period_s = 0.03 if is_real else 0.001
    assert states.count(DriveState.NOT_READY) * period_s == pytest.approx(0.3, abs=2 * period_s)
