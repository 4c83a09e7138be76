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
ENABLED, DISABLED = 0x1237, 0x0250
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
        self.ns, self.frames, self.sent = 0, [], []

    def add(self, time_ns, can_id, data=b""):
        self.frames.append((round(time_ns), can_id, data))

    def seal(self):
        self.frames.sort(key=lambda frame: frame[0])

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
        self.sent.append((self.ns, can_id, data))


def master_and_drive(world, cycles, *, ppm=0.0, jitter_ns=0, lost=(), status=ENABLED, seed=1, first=0, phase_ns=0):
    """SYNC, the drive's answers 150 us and the master's RPDO 400 us later; position and target are 1000 a cycle."""
    numbers = random.Random(seed)
    for k in range(first, first + cycles):
        at = phase_ns + k * T * (1.0 + ppm * 1e-6) + numbers.randint(-jitter_ns, jitter_ns)
        if k in lost:
            continue
        world.add(at, 0x080)
        word = status(k) if callable(status) else status
        world.add(at + 150_000, 0x181, word.to_bytes(2, "little") + (1000 * k).to_bytes(4, "little"))
        world.add(at + 160_000, 0x281, (7).to_bytes(2, "little") + b"\x08")
        world.add(at + 400_000, 0x201, b"\x0f\x00" + (1000 * k + 2500).to_bytes(4, "little"))


class Sidecar:
    """An exchange with its pacer, locked by the first SYNCs of a world."""

    def __init__(self, world, *, max_missed=10, acquired=50, heartbeat=None):
        world.seal()
        facts = AxisFacts("x", "node 1", 1e-4, 1e-3, 1.5e-3, 0.75e-3)
        units = DriveUnits(1e5, 1e5, 0.5)
        self.axis = SidecarAxis(facts, 1, Mode.CSP, units, 1e-3, OPTIONS)
        self.world, self.lock = world, PhaseLock(1e-3)
        stamps = []
        while len(stamps) < acquired:
            frame = world.receive(1.0)
            if frame[0] == 0x080:
                stamps.append(world.now_ns())
        assert self.lock.acquire(stamps) == ""
        self.exchange = SidecarExchange(
            world, [self.axis], world, self.lock, period_s=1e-3, sync_id=0x80, max_missed=max_missed,
            heartbeat=heartbeat, dry_run=False,
        )  # fmt: skip
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


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("ppm", [-200.0, 200.0])
def test_jitter_and_drift_lose_no_cycle(ppm, seed):
    world = World()
    master_and_drive(world, 4000, ppm=ppm, jitter_ns=100_000, seed=seed)
    sidecar = Sidecar(world)
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


def test_nothing_is_sent_but_offsets():
    world = World()
    master_and_drive(world, 300)
    sidecar = Sidecar(world)
    sidecar.steps(200)
    assert sidecar.exchange.send_zero() == []
    assert {can_id for _, can_id, _ in world.sent} == {0x501}
    assert len(world.sent) == 201
    assert [data for _, _, data in world.sent][-2:] == [(200).to_bytes(2, "little"), b"\0\0"]


@pytest.mark.parametrize("trouble", ["silent", "pre-operational", "full"])
def test_a_drive_that_may_keep_the_last_offset_is_told(trouble):
    world = World()
    master_and_drive(world, 200 if trouble == "silent" else 300)
    if trouble == "pre-operational":
        world.add(190 * T, 0x701, b"\x7f")
    sidecar = Sidecar(world)
    sidecar.steps(200)
    if trouble == "full":

        def send(can_id, data):
            raise QueueFullError("the queue is full")

        world.send = send
    [text] = sidecar.exchange.send_zero()
    assert text.startswith("x: 60B2h torque offset may hold the last offset and not 0: ")
    assert {"silent": "not been heard", "pre-operational": "not Operational", "full": "queue is full"}[trouble] in text
    assert text.endswith("[FH-128]")


def test_a_configured_heartbeat_is_sent():
    world = World()
    master_and_drive(world, 400)
    sidecar = Sidecar(world, heartbeat=(126, 0.05))
    sidecar.steps(300)
    beats = [data for _, can_id, data in world.sent if can_id == 0x77E]
    assert 6 <= len(beats) <= 7
    assert set(beats) == {b"\x05"}


@pytest.mark.parametrize("length", [1, 3, 10])
def test_missing_syncs_are_bridged_and_the_cycles_after_them_are_right(length):
    world = World()
    master_and_drive(world, 300, lost=range(150, 150 + length))
    sidecar = Sidecar(world)
    heard = sidecar.steps(220)
    stale = [k for k, (is_fresh, _, _) in enumerate(heard) if not is_fresh]
    assert len(stale) == length
    assert not any(message for _, _, message in heard)
    positions = [round(position * 1e5) for is_fresh, position, _ in heard if is_fresh]
    steps = [b - a for a, b in itertools.pairwise(positions)]
    assert sorted(set(steps)) == [1000, 1000 * (length + 1)]


def test_a_master_that_stops_is_told_and_the_loop_keeps_its_pace():
    world = World()
    master_and_drive(world, 150)
    sidecar = Sidecar(world)
    sidecar.steps(80)
    before = world.now_ns()
    heard = sidecar.steps(100)
    assert "SYNC (080h) did not come for 11 periods" in heard[-1][2]
    assert heard[-1][2].endswith("[FH-248]")
    assert world.now_ns() - before == pytest.approx(100 * T, abs=T)


def test_a_master_whose_clock_jumps_is_followed():
    world = World()
    master_and_drive(world, 150)
    master_and_drive(world, 300, first=150, phase_ns=600_000)
    sidecar = Sidecar(world)
    heard = sidecar.steps(300)
    assert not any(message for _, _, message in heard)
    assert sum(not is_fresh for is_fresh, _, _ in heard[100:]) < 10
    assert all(is_fresh for is_fresh, _, _ in heard[150:])


def test_a_second_sync_producer_is_told():
    world = World()
    master_and_drive(world, 300)
    for k in range(150, 300):
        world.add(k * T + 430_000, 0x080)
    sidecar = Sidecar(world)
    heard = sidecar.steps(200)
    assert not heard[90][2]
    assert "two controllers send it" in heard[-1][2]


@pytest.mark.parametrize("count", [3, 8, 15])
def test_a_master_that_catches_up_after_a_stall_is_no_second_producer(count):
    world = World()
    master_and_drive(world, 400, lost=range(150, 150 + count))
    for k in range(count):
        world.add((150 + count) * T - 300_000 + k * 10_000, 0x080)
    sidecar = Sidecar(world, max_missed=20)
    heard = sidecar.steps(300)
    assert not any(message for _, _, message in heard)
    assert all(is_fresh for is_fresh, _, _ in heard[150:])


def test_a_tpdo_of_another_length_is_no_feedback_and_named():
    world = World()
    master_and_drive(world, 120)
    for k in range(120, 200):
        world.add(k * T, 0x080)
        world.add(k * T + 100_000, 0x181, bytes(8))
        world.add(k * T + 110_000, 0x281, bytes(3))
    sidecar = Sidecar(world)
    sidecar.steps(100)
    heard = sidecar.step()
    assert not heard.is_fresh
    assert heard.missing == "181h has 8 bytes, but its entries 6"
    assert heard.state is DriveState.OPERATION_ENABLED  # the last that was heard


def test_offset_is_wanted_only_in_the_configured_mode_and_while_the_master_wants_the_drive_enabled():
    axis = Sidecar(_quiet()).axis
    heard = Feedback()

    def wanted(mode, controlword):
        axis.begin_cycle()
        axis.handlers[0x181](ENABLED.to_bytes(2, "little") + bytes(4))
        axis.handlers[0x281](b"\0\0" + bytes([mode]))
        axis.handlers[0x201](controlword.to_bytes(2, "little") + bytes(4))
        axis.report(heard, 0)
        assert heard.is_fresh
        return heard.is_offset_wanted

    assert wanted(8, 0x0F)
    assert wanted(8, 0x1F)
    assert not wanted(6, 0x0F)
    assert not wanted(8, 0x0B)  # quick stop
    assert not wanted(8, 0x07)


@pytest.mark.parametrize("bits", [8, 16, 32])
def test_before_its_tpdo_came_the_state_of_a_drive_is_unknown(bits):
    tpdos = [{"cob_id": 0x181, "entries": [0x6064]}, {"cob_id": 0x281, "entries": [0x60410000 | bits]}]
    tpdos[1]["is_synchronous"] = False
    options = SidecarOptions.model_validate({"tpdos": tpdos, "offset": {"cob_id": 0x501, "entries": [0x60B2]}})
    facts = AxisFacts("x", "node 1", 1e-4, 1e-3, 1.5e-3, 0.75e-3)
    axis, heard = SidecarAxis(facts, 1, Mode.CSP, DriveUnits(1e5, 1e5, 0.5), 1e-3, options), Feedback()
    for state in (DriveState.UNKNOWN, DriveState.OPERATION_ENABLED):
        axis.begin_cycle()
        axis.handlers[0x181](bytes(4))
        axis.report(heard, 1)
        assert (heard.is_fresh, heard.state) == (True, state)
        axis.handlers[0x281]((0x37).to_bytes(bits // 8, "little"))


def test_emergencies_and_reboots_are_noticed_and_are_no_fault():
    axis = Sidecar(_quiet()).axis
    heard = Feedback()
    axis.handlers[0x081](bytes.fromhex("1186080000000000"))
    axis.handlers[0x701](b"\0")
    axis.report(heard, 0)
    assert heard.notices == [
        "emergency 8611h following error, error register 08h",
        "node 1 restarted (boot-up message)",
    ]
    assert heard.error == "8611h following error"
    assert heard.message == ""


def _quiet():
    world = World()
    master_and_drive(world, 60)
    return world


def test_an_offset_of_somebody_else_is_a_fault_at_its_first_frame():
    world = World()
    master_and_drive(world, 400)
    world.add(200.5 * T, 0x501, b"\x64\x00")
    sidecar = Sidecar(world)
    heard = sidecar.steps(300)
    first = next(k for k, (_, _, message) in enumerate(heard) if message)
    assert abs(first + 50 - 200) <= 2
    assert codes_in(heard[first][2]) == "FH-249"


def test_the_daemons_own_offsets_on_a_bus_that_echoes_them_are_none_of_somebody_else():
    axis = Sidecar(filled(60)).axis
    feedback = Feedback()
    for _ in range(100):
        axis.sent()
        axis.handlers[0x501](b"\0\0")
    axis.report(feedback, 0)
    assert feedback.message == ""
    axis.handlers[0x501](b"\0\0")
    axis.report(feedback, 0)
    assert "FH-249" in feedback.message


@pytest.mark.parametrize("ratio", [1.25, 1.1, 1.5, 2.0, 0.8])
def test_a_sync_whose_period_changes_in_mid_run_is_named(ratio):
    world = World()
    master_and_drive(world, 100)
    for k in range(1500):
        at = 100 * T + k * ratio * T
        world.add(at, 0x080)
        world.add(at + 150_000, 0x181, ENABLED.to_bytes(2, "little") + bytes(4))
        world.add(at + 160_000, 0x281, b"\x07\x00\x08")
    messages = [message for _, _, message in Sidecar(world).steps(1000) if message]
    assert messages
    assert "FH-248" in messages[0]
    assert "(period_s)" in messages[0] or "more than once a period" in messages[0]


@pytest.mark.parametrize("share", [0.3, 1.0])
def test_tpdos_that_come_twice_in_each_cycle_are_those_of_two_nodes(share):
    world = World()
    master_and_drive(world, 1000)
    numbers = random.Random(2)
    for time_ns, can_id, data in list(world.frames):
        if can_id == 0x181 and time_ns > 300 * T and numbers.random() < share:
            world.add(time_ns + 90_000, can_id, data)
    messages = [message for _, _, message in Sidecar(world).steps(900) if message]
    assert bool(messages) is (share == 1.0)
    assert all("181h of node 1 comes twice in each cycle: two nodes have this number" in text for text in messages)


def filled(cycles):
    world = World()
    master_and_drive(world, cycles)
    return world


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
    heard_rhythm(double=0.0).require_one_sender(0x181, "x", 1)
    heard_rhythm(double=0.4, late_ns=late_ns).require_one_sender(0x181, "x", 1)
    with pytest.raises(DriveError, match=r"181h.*FH-264"):
        heard_rhythm(double=1.0, late_ns=late_ns).require_one_sender(0x181, "x", 1)


@pytest.mark.parametrize("every", [1, 2, 3])
def test_a_tpdo_that_comes_with_every_so_many_syncs_is_known(every):
    assert heard_rhythm(every=every).syncs_between(0x181) == every


def test_the_period_of_sync_is_compared():
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
