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

    def is_silent(self):
        return self.master.receive(1, 0.02) == b""


@pytest.fixture
def make_bench(tmp_path):
    open_benches: list[Bench] = []

    def make(is_real=True, silence_chars=0.0, **faults):
        options = LineOptions(port=str(tmp_path / "line"), baud=10000, turnaround_s=TURNAROUND_NS * 1e-9)
        drive = make_drive(is_synchronous=not is_real)
        responder = TinyResponder({"x": drive})
        port = PtyPort(Path(options.port))
        line = SimulatedLine(
            port, responder, [drive], options, LineFaults(**faults), silence_chars=silence_chars, is_real=is_real
        )
        open_benches.append(Bench(line, Master(Path(options.port)), drive, responder))
        return open_benches[-1]

    yield make
    for bench in open_benches:
        bench.master.close()
        bench.line.port.close()


# Wire time


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
    assert bench.is_silent()
    bench.line.work(replied)
    assert bench.master.line() == b"0\n"
    assert bench.line.due_ns is None


def test_what_is_left_before_a_silence_is_no_request(make_bench):
    bench = make_bench(silence_chars=3.5)
    bench.send(b"?pos", 0)
    end = 4 * CHARACTER_NS
    bench.line.work(end + SILENCE_NS)
    assert bench.responder.silences == 0
    bench.line.work(end + SILENCE_NS + 1)
    assert bench.responder.silences == 1
    bench.send(b"?error\n", 20_000_000)
    bench.line.work(40_000_000)
    assert bench.master.line() == b"0\n"


# Faults


@settings(max_examples=60, deadline=None)
@given(reply=st.binary(min_size=2, max_size=40), seed=st.integers(0, 1000))
def test_each_fault_does_what_it_is_called(reply, seed):
    assert Faults(LineFaults(seed=seed)).spoil(reply).pieces == (reply,)
    assert Faults(LineFaults(seed=seed, drop=1)).spoil(reply).pieces == ()
    late = Faults(LineFaults(seed=seed, delay=1)).spoil(reply)
    assert (late.pieces, late.is_late) == ((reply,), True)
    corrupt = Faults(LineFaults(seed=seed, corrupt=1)).spoil(reply).pieces[0]
    assert len(corrupt) == len(reply)
    flipped = int.from_bytes(corrupt, "big") ^ int.from_bytes(reply, "big")
    assert flipped.bit_count() == 1
    split = Faults(LineFaults(seed=seed, split=1)).spoil(reply).pieces
    assert len(split) == 2
    assert all(split)
    assert b"".join(split) == reply
    noisy = Faults(LineFaults(seed=seed, noise=1)).spoil(reply).pieces[0]
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
    state = []
    for k in range(600):
        bench.send(b"control=6\n?position\n", k * 30_000_000)
        bench.line.work(k * 30_000_000 + 29_000_000)
        state.append(bench.drive.state)
        if bench.drive.time_s > 0.6:
            break
    assert bench.drive.state is DriveState.READY_TO_SWITCH_ON
    assert state[1] is DriveState.READY_TO_SWITCH_ON
    assert DriveState.NOT_READY in state
    period_s = 0.03 if is_real else 0.001
    off = state.count(DriveState.NOT_READY)
    assert off * period_s == pytest.approx(0.3, abs=2 * period_s)
