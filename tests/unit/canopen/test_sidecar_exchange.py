"""A sidecar's cycles in real time, in time that a test makes: a clock and a bus whose frames come when they are due."""

import itertools
import random

import pytest
from friction_hil_drivers.canopen.connect.heard_pdos import HeardPdos
from friction_hil_drivers.canopen.sidecar.axis import SidecarAxis
from friction_hil_drivers.canopen.sidecar.exchange import SidecarExchange
from friction_hil_drivers.canopen.sidecar.options import SidecarOptions
from friction_hil_drivers.canopen.wire.queue_full import QueueFullError
from friction_hil_drivers.cia402.units import DriveUnits

from friction_hil.daemon.pacing import LockedPacer
from friction_hil.drive import AxisFacts, Command, DriveState, Feedback, Mode
from friction_hil.drive.phase_lock import PhaseLock
from friction_hil.errors import DriveError
from tests.messages import codes_in

T = 1_000_000
ENABLED = 0x1237
OPTIONS = SidecarOptions.model_validate(
    {
        "tpdos": [
            {"cob_id": 0x181, "entries": [0x6041, 0x6064]},
            {"cob_id": 0x281, "entries": [0x60770010, 0x60610008]},
        ],
        "rpdos": [{"cob_id": 0x201, "entries": [0x6040, 0x607A]}],
        "offset": {"cob_id": 0x501, "entries": [0x60B2]},
    }
)


class World:
    """Clock and bus: a schedule of frames, and what was sent."""

    is_real = True

    def __init__(self):
        self.ns, self.frames, self.sent, self.error = 0, [], [], None

    def add(self, time_ns, can_id, data=b""):
        self.frames.append((round(time_ns), can_id, data))

    def now_ns(self):
        return self.ns

    def doze_until(self, deadline_ns):
        return False

    def sleep_until(self, deadline_ns):
        self.ns = max(self.ns, deadline_ns)

    def receive(self, timeout):
        end = self.ns + round(timeout * 1e9)
        if self.frames and self.frames[0][0] <= end:
            time_ns, can_id, data = self.frames.pop(0)
            self.ns = max(self.ns, time_ns) + 2_000
            return can_id, data
        self.ns = end
        return None

    def send(self, can_id, data):
        if self.error is not None:
            raise self.error
        self.sent.append((self.ns, can_id, data))


def master_and_drive(world, cycles, *, ppm=0.0, jitter_ns=0, lost=(), seed=1, first=0, phase_ns=0):
    """SYNC, the drive's answers 150 us and the master's RPDO 400 us later; position and target are 1000 a cycle."""
    numbers = random.Random(seed)
    for k in range(first, first + cycles):
        at = phase_ns + k * T * (1.0 + ppm * 1e-6) + numbers.randint(-jitter_ns, jitter_ns)
        if k not in lost:
            world.add(at, 0x080)
            world.add(at + 150_000, 0x181, word(ENABLED) + (1000 * k).to_bytes(4, "little"))
            world.add(at + 160_000, 0x281, word(7) + b"\x08")
            world.add(at + 400_000, 0x201, word(0x0F) + (1000 * k + 2500).to_bytes(4, "little"))
    return world


def word(value):
    return value.to_bytes(2, "little")


def axis_of(options=OPTIONS):
    facts = AxisFacts("x", "node 1", 1e-4, 1e-3, 1.5e-3, 0.75e-3)
    return SidecarAxis(facts, 1, Mode.CSP, DriveUnits(1e5, 1e5, 0.5), 1e-3, options)


def reported(axis):
    heard = Feedback()
    axis.report(heard, 0)
    return heard


class Sidecar:
    """An exchange with its pacer, locked by the first SYNCs of a world, which is a master and a drive unless given."""

    def __init__(self, world=None, *, cycles=300, lost=(), max_missed=10, acquired=50, heartbeat=None):
        self.world = world = world or master_and_drive(World(), cycles, lost=lost)
        world.frames.sort(key=lambda frame: frame[0])
        self.axis, self.lock = axis_of(), PhaseLock(1e-3)
        stamps = []
        while len(stamps) < acquired:
            if world.receive(1.0)[0] == 0x080:
                stamps.append(world.now_ns())
        assert self.lock.acquire(stamps) == ""
        how = {"period_s": 1e-3, "sync_id": 0x80, "max_missed": max_missed, "heartbeat": heartbeat, "dry_run": False}
        self.exchange = SidecarExchange(world, [self.axis], world, self.lock, **how)
        self.pacer = LockedPacer(world, 1e-3, lambda cycle: None, self.lock)
        self.exchange.start()
        self.pacer.start()
        self.feedback, self.command, self.cycle = [Feedback()], Command(), 0

    def step(self, torque=0.1):
        self.cycle = self.pacer.wait(self.cycle)
        self.exchange.receive(self.feedback, self.pacer.end_ns(self.cycle))
        self.command.torque = torque
        self.exchange.send([self.command])
        self.cycle += 1
        return self.feedback[0]

    def steps(self, count):
        return [(one.is_fresh, one.position, one.message) for one in (self.step() for _ in range(count))]

    def messages(self, count):
        return [message for _, _, message in self.steps(count) if message]


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("ppm", [-200.0, 200.0])
def test_jitter_and_drift_lose_no_cycle(ppm, seed):
    sidecar = Sidecar(master_and_drive(World(), 4000, ppm=ppm, jitter_ns=100_000, seed=seed))
    positions = []
    for _ in range(3900):
        heard = sidecar.step()
        assert heard.is_fresh, (sidecar.cycle, heard.missing)
        assert heard.message == ""
        positions.append(round(heard.position * 1e5))
        # the set-point of the cycle before, which the drive's demand reaches 1.5 periods after this position
        assert round(heard.position_demand * 1e5) == positions[-1] - 1000 + 2500
    assert {b - a for a, b in itertools.pairwise(positions)} == {1000}
    assert sidecar.lock.is_locked


@pytest.mark.parametrize("heartbeat", [None, (126, 0.05)])
def test_nothing_is_sent_but_offsets_and_a_configured_heartbeat(heartbeat):
    sidecar = Sidecar(heartbeat=heartbeat)
    sidecar.steps(200)
    assert sidecar.exchange.send_zero() == []
    sent = [(can_id, data) for _, can_id, data in sidecar.world.sent]
    beats = [frame for frame in sent if frame == (0x77E, b"\x05")]
    offsets = [data for can_id, data in sent if can_id == 0x501]
    assert 4 <= len(beats) <= 5 if heartbeat else not beats
    assert len(offsets) == 201 == len(sent) - len(beats)
    assert offsets[-2:] == [word(200), b"\0\0"]


@pytest.mark.parametrize(
    ("trouble", "told"),
    [("silent", "not been heard"), ("pre-operational", "not Operational"), ("full", "queue is full")],
)
def test_a_drive_that_may_keep_the_last_offset_is_told(trouble, told):
    world = master_and_drive(World(), 200 if trouble == "silent" else 300)
    if trouble == "pre-operational":
        world.add(190 * T, 0x701, b"\x7f")
    sidecar = Sidecar(world)
    sidecar.steps(200)
    if trouble == "full":
        world.error = QueueFullError("the queue is full")
    [text] = sidecar.exchange.send_zero()
    assert text.startswith("x: 60B2h torque offset may hold the last offset and not 0: ")
    assert told in text
    assert text.endswith("[FH-128]")


@pytest.mark.parametrize("length", [1, 3, 10])
def test_missing_syncs_are_bridged_and_the_cycles_after_them_are_right(length):
    heard = Sidecar(lost=range(150, 150 + length)).steps(220)
    assert sum(not is_fresh for is_fresh, _, _ in heard) == length
    assert not any(message for _, _, message in heard)
    positions = [round(position * 1e5) for is_fresh, position, _ in heard if is_fresh]
    assert {b - a for a, b in itertools.pairwise(positions)} == {1000, 1000 * (length + 1)}


def test_a_master_that_stops_is_told_and_the_loop_keeps_its_pace():
    sidecar = Sidecar(cycles=150)
    sidecar.steps(80)
    before = sidecar.world.now_ns()
    heard = sidecar.steps(100)
    assert "SYNC (080h) did not come for 11 periods" in heard[-1][2]
    assert heard[-1][2].endswith("[FH-248]")
    assert sidecar.world.now_ns() - before == pytest.approx(100 * T, abs=T)


def test_a_master_whose_clock_jumps_is_followed():
    world = master_and_drive(master_and_drive(World(), 150), 300, first=150, phase_ns=600_000)
    heard = Sidecar(world).steps(300)
    assert not any(message for _, _, message in heard)
    assert sum(not is_fresh for is_fresh, _, _ in heard[100:]) < 10
    assert all(is_fresh for is_fresh, _, _ in heard[150:])


def test_a_second_sync_producer_is_told():
    world = master_and_drive(World(), 300)
    for k in range(150, 300):
        world.add(k * T + 430_000, 0x080)
    heard = Sidecar(world).steps(200)
    assert not heard[90][2]
    assert "two controllers send it" in heard[-1][2]


@pytest.mark.parametrize("count", [3, 8, 15])
def test_a_master_that_catches_up_after_a_stall_is_no_second_producer(count):
    world = master_and_drive(World(), 400, lost=range(150, 150 + count))
    for k in range(count):
        world.add((150 + count) * T - 300_000 + k * 10_000, 0x080)
    heard = Sidecar(world, max_missed=20).steps(300)
    assert not any(message for _, _, message in heard)
    assert all(is_fresh for is_fresh, _, _ in heard[150:])


def test_a_tpdo_of_another_length_is_no_feedback_and_named():
    world = master_and_drive(World(), 120)
    for k in range(120, 200):
        for late_ns, can_id, size in ((0, 0x080, 0), (100_000, 0x181, 8), (110_000, 0x281, 3)):
            world.add(k * T + late_ns, can_id, bytes(size))
    sidecar = Sidecar(world)
    sidecar.steps(100)
    heard = sidecar.step()
    assert (heard.is_fresh, heard.missing) == (False, "181h has 8 bytes, but its entries 6")
    assert heard.state is DriveState.OPERATION_ENABLED  # the last that was heard


@pytest.mark.parametrize(
    ("mode", "controlword", "is_wanted"),
    [(8, 0x0F, True), (8, 0x1F, True), (6, 0x0F, False), (8, 0x0B, False), (8, 0x07, False)],  # 0Bh: quick stop
)
def test_offset_is_wanted_only_in_the_configured_mode_and_while_the_master_wants_the_drive_enabled(
    mode, controlword, is_wanted
):
    axis = axis_of()
    axis.begin_cycle()
    axis.handlers[0x181](word(ENABLED) + bytes(4))
    axis.handlers[0x281](b"\0\0" + bytes([mode]))
    axis.handlers[0x201](word(controlword) + bytes(4))
    heard = reported(axis)
    assert (heard.is_fresh, heard.is_offset_wanted) == (True, is_wanted)


@pytest.mark.parametrize("bits", [8, 16, 32])
def test_before_its_tpdo_came_the_state_of_a_drive_is_unknown(bits):
    status = {"cob_id": 0x281, "entries": [0x60410000 | bits], "is_synchronous": False}
    tpdos = [{"cob_id": 0x181, "entries": [0x6064]}, status]
    offset = {"cob_id": 0x501, "entries": [0x60B2]}
    axis = axis_of(SidecarOptions.model_validate({"tpdos": tpdos, "offset": offset}))
    for state in (DriveState.UNKNOWN, DriveState.OPERATION_ENABLED):
        axis.begin_cycle()
        axis.handlers[0x181](bytes(4))
        heard = reported(axis)
        assert (heard.is_fresh, heard.state) == (True, state)
        axis.handlers[0x281]((0x37).to_bytes(bits // 8, "little"))


def test_emergencies_and_reboots_are_noticed_and_are_no_fault():
    axis = axis_of()
    axis.handlers[0x081](bytes.fromhex("1186080000000000"))
    axis.handlers[0x701](b"\0")
    heard = reported(axis)
    emergency, restart = heard.notices
    assert emergency == "emergency 8611h following error, error register 08h"
    assert restart.startswith("node 1 restarted")
    assert (heard.error, heard.message) == ("8611h following error", "")


def test_an_offset_of_somebody_else_is_a_fault_at_its_first_frame():
    world = master_and_drive(World(), 400)
    world.add(200.5 * T, 0x501, b"\x64\x00")
    heard = Sidecar(world).steps(300)
    first = next(k for k, (_, _, message) in enumerate(heard) if message)
    assert abs(first + 50 - 200) <= 2
    assert codes_in(heard[first][2]) == "FH-249"


def test_the_daemons_own_offsets_on_a_bus_that_echoes_them_are_none_of_somebody_else():
    axis = axis_of()
    for _ in range(100):
        axis.sent()
        axis.handlers[0x501](b"\0\0")
    assert reported(axis).message == ""
    axis.handlers[0x501](b"\0\0")
    assert "FH-249" in reported(axis).message


@pytest.mark.parametrize("ratio", [1.25, 1.1, 1.5, 2.0, 0.8])
def test_a_sync_whose_period_changes_in_mid_run_is_named(ratio):
    world = master_and_drive(World(), 100)
    for k in range(1500):
        at = 100 * T + k * ratio * T
        world.add(at, 0x080)
        world.add(at + 150_000, 0x181, word(ENABLED) + bytes(4))
        world.add(at + 160_000, 0x281, b"\x07\x00\x08")
    first, *_ = Sidecar(world).messages(1000)
    assert "FH-248" in first
    assert "(period_s)" in first or "more than once a period" in first


@pytest.mark.parametrize("share", [0.3, 1.0])
def test_tpdos_that_come_twice_in_each_cycle_are_those_of_two_nodes(share):
    world, numbers = master_and_drive(World(), 1000), random.Random(2)
    for time_ns, can_id, data in list(world.frames):
        if can_id == 0x181 and time_ns > 300 * T and numbers.random() < share:
            world.add(time_ns + 90_000, can_id, data)
    messages = Sidecar(world).messages(900)
    assert bool(messages) is (share == 1.0)
    assert all("181h of node 1 comes twice in each cycle: two nodes have this number" in text for text in messages)


def heard_rhythm(*, every=1, double=0.0, period=1.0, late_ns=0):
    """What is heard of a TPDO that comes with every so many SYNCs, and a share of it twice."""
    heard, numbers, frames = HeardPdos(0x080), random.Random(4), []
    for k in range(250):
        frames.append((k * T * period, 0x080))
        if k % every == 0:
            frames.append((k * T * period + 200_000, 0x181))
            if numbers.random() < double:
                frames.append((k * T * period + 200_000 + late_ns, 0x181))
    for at, can_id in sorted(frames):
        heard.take(can_id, 8, round(at))
    return heard


@pytest.mark.parametrize("late_ns", [0, 300_000, 900_000])
def test_two_nodes_are_told_from_frames_that_a_bus_doubles(late_ns):
    """The second node may be so slow that its TPDO comes after the next SYNC."""
    for double in (0.0, 0.4):
        heard_rhythm(double=double, late_ns=late_ns).require_one_sender(0x181, "x", 1)
    with pytest.raises(DriveError, match=r"181h.*FH-264"):
        heard_rhythm(double=1.0, late_ns=late_ns).require_one_sender(0x181, "x", 1)


def test_the_rhythm_of_tpdos_and_the_period_of_sync_are_known():
    assert [heard_rhythm(every=every).syncs_between(0x181) for every in (1, 2, 3)] == [1, 2, 3]
    assert heard_rhythm(period=1.01).wrong_period(1e-3) == ""
    assert heard_rhythm(period=1.25).wrong_period(1e-3) == "comes every 1.25 ms and not every 1 ms (period_s)"
    assert HeardPdos(0x080).wrong_period(1e-3) == ""


def test_neither_lost_syncs_nor_a_busy_computer_look_like_another_period():
    numbers = random.Random(5)
    lost, busy = HeardPdos(0x080), HeardPdos(0x080)
    for k in range(250):
        if numbers.random() > 0.2:
            lost.take(0x080, 0, k * T)
        busy.take(0x080, 0, (k - k % 4 + 4) * T)  # frames are read four at a time
    assert lost.wrong_period(1e-3) == busy.wrong_period(1e-3) == ""
