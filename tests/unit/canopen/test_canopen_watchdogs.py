"""Watchdogs of a drive: armed by what it has, quiet while the daemon lives, and acting when it is gone.

Time is that of the simulated node, so nothing here depends on the speed of the machine.
"""

import struct

import can
import pytest
from friction_hil_drivers.canopen.connect.watchdogs import Feeder, Watch, feeders
from friction_hil_drivers.cia402.access import Abort, AbortError

from friction_hil.config.schema import Realtime
from friction_hil.drive import Command, DriveState, Request
from friction_hil.errors import ConfigurationError, DriveError
from tests.canopen_bench import NODE, Bench, BenchBus, Driven
from tests.servo_drives import axis_dict, configuration

RPDO4 = 0x505
REACTION, CONSUMER, GUARD_TIME, ERROR_BEHAVIOUR = 0x6007, 0x1016, 0x100C, 0x1029
HEARTBEAT_MS, TIMER_MS = 60, 20
ALONE_MS = 20  # of heartbeat and guarding where no RPDO has a timer
WITHOUT_TIMER = [{"index": 0x1400, "subindex": 5, "abort": 0x06090011}]
ONE_RPDO = (0x1401, 0x1402, 0x1403)
SYNC_ONLY = {"timer_at_sync_only": True}


class RealTimeBus(BenchBus):
    """Its drive has a clock of its own: while the daemon is silent, time goes on."""

    def send(self, msg, timeout=None):
        if msg.is_remote_frame:
            self.sent.append((msg.arbitration_id, None))
            self.bench.node.receive_remote(msg.arbitration_id)
        else:
            super().send(msg, timeout)


class Watched(Driven):
    """A drive in csv, turning, whose daemon can die."""

    def __init__(self, *, missing=(), manners=None, prepare=None, max_missed=None, **keys):
        self.max_missed = max_missed
        bench = Bench(is_paced_by_sync=False, missing=missing, manners=SYNC_ONLY | (manners or {}))
        if prepare is not None:
            prepare(bench)
        super().__init__("csv", bus=RealTimeBus(bench), **keys)
        try:
            (self.facts,) = self.drives.connect()
        except DriveError:
            self.close()
            raise

    def changed(self, config):
        if self.max_missed is None:
            return config
        return config.model_copy(update={"realtime": Realtime(max_missed=self.max_missed)})

    @property
    def notes(self):
        return " ".join(self.facts.notes)

    def cycle(self, request, count=1, velocity=5.0):
        for _ in range(count):
            now = self.clock.now_ns() + 1_000_000
            self.clock.sleep_until(now)
            for can_id, data in self.bench.at(now * 1e-6):
                self.bus.answers.put(can.Message(arbitration_id=can_id, data=data, is_extended_id=False))
            self.drives.receive([self.feedback], 0)
            self.drives.send([Command(request, velocity=velocity)])

    def turn(self):
        self.drives.start()
        self.cycle(Request.ENABLE, count=100)
        assert self.feedback.state is DriveState.OPERATION_ENABLED
        assert self.feedback.velocity == pytest.approx(5.0, rel=0.2)
        assert self.bench.emergencies == []

    def die(self, after_ms=200):
        """Nothing is sent any more; return after how long the drive had no torque, ms, None for never."""
        begin = self.clock.now_ns() * 1e-6
        for step in range(10 * after_ms):
            self.bench.at(begin + step / 10)
            if self.bench.servo.torque_demand == 0.0 and not self.bench.node.drive.state.is_powered:
                return step / 10
        return None


@pytest.fixture
def drive():
    made = []

    def make(**keys):
        made.append(Watched(**keys))
        return made[-1]

    yield make
    for one in made:
        one.close()


def test_a_dead_daemon_stops_a_drive_that_looks_at_timers_at_sync_only(drive):
    one = drive()
    assert "RPDO 4 within 20 ms" in one.notes
    assert "not tried" in one.notes
    assert (one.bench.read(0x1403, 2, "B"), one.bench.read(0x1403, 5, "H")) == (255, TIMER_MS)
    one.turn()
    assert one.die() <= 30.0
    assert one.bench.emergencies[-1] == "8250"


def test_a_dead_daemon_stops_a_drive_by_its_heartbeat_alone(drive):
    one = drive(missing=ONE_RPDO, manners={"sdo": WITHOUT_TIMER})
    assert "RPDO" not in one.notes.split("watches the daemon")[1].split(";")[0]
    assert f"heartbeat (1016h:01) within {ALONE_MS} ms" in one.notes
    one.turn()
    assert one.die() <= ALONE_MS + 10.0
    assert one.bench.emergencies[-1] == "8130"


def test_a_dead_daemon_stops_a_drive_by_node_guarding_alone(drive):
    one = drive(missing=[*ONE_RPDO, CONSUMER], manners={"sdo": WITHOUT_TIMER})
    assert f"node guarding (100Ch, 100Dh) within {ALONE_MS} ms" in one.notes
    assert one.bench.read(0x1017, 0, "H") == 0
    one.turn()
    assert sum(can_id == 0x700 + NODE for can_id, _ in one.bus.sent) == pytest.approx(20, abs=1)
    assert one.die() <= ALONE_MS + 10.0
    assert one.bench.emergencies[-1] == "8130"


def test_with_a_single_rpdo_that_one_is_event_driven(drive):
    one = drive(missing=ONE_RPDO)
    assert "RPDO 1 within 20 ms" in one.notes
    assert (one.bench.read(0x1400, 2, "B"), one.bench.read(0x1400, 5, "H")) == (255, TIMER_MS)
    assert one.facts.actuation_delay_s == pytest.approx(1.0e-3)  # it takes effect when it arrives
    assert one.facts.setpoint_delay_s == pytest.approx(1.5e-3)
    one.turn()
    assert one.die() <= 30.0


def synchronous_only(bench):
    """RPDO 1 of the drive cannot be event-driven."""
    entry = bench.node.dictionary.at(0x1400, 2)
    accept = entry.on_write

    def write(value):
        if value > 240:
            raise AbortError(Abort.VALUE)
        accept(value)

    entry.on_write = write


def test_a_timer_of_a_synchronous_rpdo_is_no_watchdog(drive):
    lacking = {"missing": [*ONE_RPDO, CONSUMER, GUARD_TIME], "prepare": synchronous_only}
    with pytest.raises(DriveError, match=r"is_watchdog_required.*\[FH-217\]"):
        drive(**lacking)
    one = drive(is_watchdog_required=False, **lacking)
    assert "does NOT watch the daemon" in one.notes
    assert one.bench.read(0x1400, 5, "H") == TIMER_MS  # set all the same
    one.turn()
    assert one.die() is None  # what the refusal is for


@pytest.mark.parametrize("missing", [ONE_RPDO, [*ONE_RPDO, CONSUMER]], ids=["heartbeat", "guarding"])
@pytest.mark.parametrize("feed", range(1, 6))
def test_heartbeat_and_guarding_act_as_soon_as_a_timer_does(drive, missing, feed):
    """Whenever the daemon is killed: within the time that is shown, and neither before nor while it lives."""
    one = drive(missing=missing, manners={"sdo": WITHOUT_TIMER})
    one.turn()
    one.cycle(Request.ENABLE, count=feed)
    shown = one.facts.units[-1]
    assert shown.quantity == "watchdog"
    assert f"takes the torque within {TIMER_MS + 10} ms of the daemon's last frame" in shown.value
    assert TIMER_MS - 6 < one.die() <= TIMER_MS + 10


def coarse(least_ms):
    """The drive takes no time below ``least_ms`` for its heartbeat consumer, as one whose clock ticks that slowly."""

    def prepare(bench):
        entry = bench.node.dictionary.at(CONSUMER, 1)
        accept = entry.on_write

        def write(value):
            if 0 < value & 0xFFFF < least_ms:
                raise AbortError(Abort.VALUE)
            accept(value)

        entry.on_write = write

    return prepare


SLOW = {"missing": [*ONE_RPDO, GUARD_TIME], "manners": {"sdo": WITHOUT_TIMER}, "prepare": coarse(90)}


def test_a_drive_that_takes_longer_times_only_is_warned_of_with_the_time(drive):
    one = drive(**SLOW)
    assert "heartbeat (1016h:01) within 100 ms" in one.notes
    assert "stops the drive within 110 ms, because it takes no time shorter than 100 ms" in one.notes
    assert "[FH-269]" in one.notes
    one.turn()
    assert TIMER_MS < one.die() <= 110.0


def test_bridged_periods_that_the_user_wrote_and_the_drive_cannot_meet_are_refused_with_those_that_it_can(drive):
    with pytest.raises(DriveError, match=r"realtime.max_missed.*87.*\[FH-270\]"):
        drive(max_missed=10, **SLOW)
    one = drive(max_missed=87, **SLOW)
    assert "FH-269" not in one.notes
    assert "takes the torque within 114 ms" in one.facts.units[-1].value


def test_without_a_reaction_nothing_counts(drive):
    lacking = [REACTION, ERROR_BEHAVIOUR]
    with pytest.raises(DriveError, match=r"\[FH-217\]"):
        drive(missing=lacking)


def test_without_6007h_a_heartbeat_counts_if_its_loss_ends_operational(drive):
    one = drive(missing=[REACTION])
    assert "heartbeat (1016h:01)" in one.notes
    assert "NMT Pre-operational (1029h:01 = 0)" in one.notes
    assert "has not been seen" in one.notes
    assert "RPDO 4" not in one.notes  # its timer changes no state without 6007h


def test_entries_of_1016h_that_others_made_are_kept(drive):
    one = drive(prepare=lambda bench: bench.write(CONSUMER, 1, "I", 7 << 16 | 500))
    assert one.bench.read(CONSUMER, 1) == 7 << 16 | 500
    assert one.bench.read(CONSUMER, 2) == 126 << 16 | HEARTBEAT_MS
    assert "heartbeat (1016h:02)" in one.notes
    assert "watches node 7 too, within 500 ms; it is kept" in one.notes


def test_an_entry_of_a_daemon_before_is_taken_over(drive):
    one = drive(prepare=lambda bench: bench.write(CONSUMER, 2, "I", 126 << 16 | 300))
    assert (one.bench.read(CONSUMER, 1), one.bench.read(CONSUMER, 2)) == (0, 126 << 16 | HEARTBEAT_MS)


def test_the_watchdog_rpdo_changes_nothing(drive):
    """It carries the controlword that is in force in the drive already, whatever is requested."""
    one = drive()
    one.drives.start()
    words = []
    receive = one.bench.node.receive

    def watch(can_id, data):
        if can_id == RPDO4:
            words.append((struct.unpack("<H", data)[0], one.bench.read(0x6040, 0, "H")))
        receive(can_id, data)

    one.bench.node.receive = watch
    for request in (Request.DISABLE, Request.ENABLE, Request.QUICK_STOP, Request.ENABLE, Request.DISABLE):
        one.cycle(request, count=37)
    assert all(sent == in_force for sent, in_force in words)
    assert len({sent for sent, _ in words}) >= 4
    assert len(words) == pytest.approx(5 * 37 / 5, abs=1)  # four times within the timer


def test_feeders_of_several_axes_take_turns():
    three = feeders([Watch(rpdo_id=0x500 + node, feed_cycles=5) for node in (1, 2, 3)])
    sent = [[one.next() is not None for one in three] for _ in range(50)]
    assert max(sum(row) for row in sent) == 1
    assert [sum(column) for column in zip(*sent, strict=True)] == [10, 10, 10]


def test_a_feeder_repeats_what_sync_has_brought_into_force():
    one = Feeder(Watch(rpdo_id=0x501, feed_cycles=1), 0)
    one.note(6)
    assert one.next() == b"\0\0"  # not yet
    one.taken_over()
    one.note(7)
    assert one.next() == b"\6\0"


def test_a_watchdog_shorter_than_what_is_bridged_is_a_mistake():
    with pytest.raises(ConfigurationError, match=r"axes.x.watchdog_s: "):
        configuration(x=axis_dict(node=NODE, watchdog_s=0.005))


def test_all_axes_of_a_bus_watch_one_master():
    with pytest.raises(ConfigurationError, match=r"axes.y.master_node: "):
        configuration(x=axis_dict(node=NODE), y=axis_dict(node=6, master_node=125))


HIGH = 0x06090031
HIDDEN, WRITE_ONLY = 0x08000020, 0x06010001


def answers(*entries):
    return {"manners": {"sdo": list(entries)}}


def test_a_consumer_entry_that_cannot_be_read_is_left_alone(drive):
    """It could not be restored: after the run the drive would miss a heartbeat that nobody sends."""
    one = drive(**answers({"index": CONSUMER, "subindex": 1, "access": "read", "abort": HIDDEN}))
    assert "heartbeat (1016h:02)" in one.notes
    one.turn()
    one.drives.close()
    assert one.drives.leftovers == []
    assert one.bench.node.dictionary.at(CONSUMER, 1).value == 0
    assert one.bench.node.dictionary.at(CONSUMER, 2).value == 0


@pytest.mark.parametrize("index", [0x1017, 0x605A, 0x6007])
def test_no_optional_object_is_written_that_cannot_be_read(drive, index):
    before = Bench().node.dictionary.at(index, 0).value
    one = drive(**answers({"index": index, "access": "read", "abort": HIDDEN}), is_watchdog_required=False)
    assert one.bench.node.dictionary.at(index, 0).value == before
    one.drives.close()
    assert one.drives.leftovers == []


@pytest.mark.parametrize("index", [0x6040, 0x60FF, 0x60B2])
def test_a_command_that_can_only_be_written_has_the_width_of_the_standard(drive, index):
    one = drive(**answers({"index": index, "access": "read", "abort": WRITE_ONLY}))
    assert "taken as absent" not in one.notes
    one.turn()


@pytest.mark.parametrize(
    ("lacking", "cause"),
    [
        (
            {
                "missing": [*ONE_RPDO, GUARD_TIME],
                "prepare": synchronous_only,
                **answers({"index": CONSUMER, "access": "write", "abort": HIGH}),
            },
            r"1400h:02 refused FEh \(abort 06090030h\).*; 1016h:01 refused 007E0014h \(abort 06090031h\).*; no 100Ch",
        ),
        (
            {"missing": [REACTION, ERROR_BEHAVIOUR]},
            r"daemon: 1016h and 100Ch could watch it, but nothing says what its loss does: no 6007h, no 1029h\. If",
        ),
        (
            {"missing": [REACTION, ERROR_BEHAVIOUR, CONSUMER, GUARD_TIME]},
            r"it has neither 1016h nor 100Ch, but nothing says what its loss does: no 6007h, no 1029h",
        ),
    ],
)
def test_the_refusal_names_the_cause_that_was_found(drive, lacking, cause):
    with pytest.raises(DriveError, match=cause):
        drive(**lacking)
