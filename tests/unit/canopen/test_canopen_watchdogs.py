"""Watchdogs of a drive: armed by what it has, quiet while the daemon lives, and acting when it is gone.

Time is that of the simulated node, so nothing here depends on the speed of the machine.
"""

import math
import struct
import time

import pytest
from friction_hil_drivers.canopen.connect.watchdog_times import contradictions, watchdog_times
from friction_hil_drivers.canopen.connect.watchdogs import Watch, feeders
from friction_hil_drivers.canopen.drives import CanopenDrives
from friction_hil_drivers.cia402.access import Abort, AbortError
from hypothesis import given
from hypothesis import strategies as st

from friction_hil.cli import main
from friction_hil.config.schema import Realtime
from friction_hil.drive import DriveState, Request
from friction_hil.errors import ConfigurationError, DriveError
from tests.canopen_bench import NODE, Bench, BenchBus, BusClock, Driven, TimedBus
from tests.servo_drives import axis_dict, configuration

RPDO4 = 0x505
REACTION, CONSUMER, GUARD_TIME, ERROR_BEHAVIOUR = 0x6007, 0x1016, 0x100C, 0x1029
HEARTBEAT_MS, TIMER_MS = 60, 20
ALONE_MS = 20  # of heartbeat and guarding where no RPDO has a timer
WITHOUT_TIMER = [{"index": 0x1400, "subindex": 5, "abort": 0x06090011}]
ONE_RPDO = (0x1401, 0x1402, 0x1403)


class RealTimeBus(BenchBus):
    """Its drive has a clock of its own: while the daemon is silent, time goes on."""

    def send(self, msg, timeout=None):
        if msg.is_remote_frame:
            self.sent.append((msg.arbitration_id, None))
            self.bench.send_remote(msg.arbitration_id)
        else:
            super().send(msg, timeout)


HIGH, HIDDEN, WRITE_ONLY = 0x06090031, 0x08000020, 0x06010001


def refuses(index, access, abort, **where):
    """Manners of a drive that aborts an access to an object."""
    return [{"index": index, "access": access, "abort": abort, **where}]


def limited(index, subindex, is_taken):
    """A drive that takes only some values for an object."""

    def prepare(bench):
        entry = bench.node.dictionary.at(index, subindex)
        accept = entry.on_write

        def write(value):
            if not is_taken(value):
                raise AbortError(Abort.VALUE)
            accept(value)

        entry.on_write = write

    return prepare


synchronous_only = limited(0x1400, 2, lambda value: value <= 240)  # it cannot be event-driven


class Watched(Driven):
    """A drive in csv, turning, whose daemon can die."""

    def __init__(self, *, missing=(), manners=None, sdo=(), prepare=None, max_missed=None, **keys):
        self.max_missed = max_missed
        bench = Bench(is_paced_by_sync=False, missing=missing, manners={"timer_at_sync_only": True, "sdo": sdo})
        if prepare is not None:
            prepare(bench)
        super().__init__("csv", bus=RealTimeBus(bench), **keys)
        try:
            (self.facts,) = self.drives.connect()
        except DriveError:
            self.close()
            raise
        self.watching = self.notes.partition("watches the daemon")[2].partition(";")[0]

    def changed(self, config):
        if self.max_missed is None:
            return config
        return config.model_copy(update={"realtime": Realtime(max_missed=self.max_missed)})

    @property
    def notes(self):
        return " ".join(self.facts.notes)

    def cycle(self, request, count=1, velocity=5.0):
        for _ in range(count):
            for frame in self.bench.at(self.clock.now_ns() * 1e-6 + 1.0):
                self.bus.hear(*frame)
            super().cycle(request, velocity=velocity)

    def turn(self):
        self.drives.start()
        self.cycle(Request.ENABLE, count=100)
        assert self.feedback.state is DriveState.OPERATION_ENABLED
        assert self.feedback.velocity == pytest.approx(5.0, rel=0.2)
        assert self.bench.emergencies == []

    def die(self, after_ms=200):
        """Nothing is sent any more; return after how long the drive had no torque, ms, infinity for never."""
        begin = self.clock.now_ns() * 1e-6
        for step in range(10 * after_ms):
            self.bench.at(begin + step / 10)
            if self.bench.servo.torque_demand == 0.0 and not self.bench.node.drive.state.is_powered:
                return step / 10
        return math.inf


@pytest.fixture
def drive():
    made = []

    def make(**keys):
        made.append(Watched(**keys))
        return made[-1]

    yield make
    for one in made:
        one.close()


@pytest.mark.parametrize(
    ("lacking", "means", "code"),
    [
        ({}, "RPDO 4 within 20 ms", "8250"),
        ({"missing": ONE_RPDO}, "RPDO 1 within 20 ms", "8250"),  # which is event-driven then
        ({"missing": ONE_RPDO, "sdo": WITHOUT_TIMER}, f"heartbeat (1016h:01) within {ALONE_MS} ms", "8130"),
        (
            {"missing": [*ONE_RPDO, CONSUMER], "sdo": WITHOUT_TIMER},
            f"node guarding (100Ch, 100Dh) within {ALONE_MS} ms",
            "8130",
        ),
    ],
)
def test_a_dead_daemon_stops_a_drive_by_what_it_has(drive, lacking, means, code):
    """Though it looks at the timers of synchronous RPDOs at SYNC only."""
    one = drive(**lacking)
    assert means in one.notes
    assert ("RPDO" in one.watching) is (code == "8250")
    if code == "8250":
        assert "not tried" in one.notes
        parameter = 0x1400 if lacking else 0x1403
        assert (one.bench.read(parameter, 2, "B"), one.bench.read(parameter, 5, "H")) == (255, TIMER_MS)
        if lacking:  # it takes effect when it arrives
            delays = one.facts.actuation_delay_s, one.facts.setpoint_delay_s
            assert delays == pytest.approx((1.0e-3, 1.5e-3))
    one.turn()
    if "guarding" in means:
        assert one.bench.read(0x1017, 0, "H") == 0
        assert sum(can_id == 0x700 + NODE for can_id, _ in one.bus.sent) == pytest.approx(20, abs=1)
    assert one.die() <= ALONE_MS + 10.0
    assert one.bench.emergencies[-1] == code


def test_a_timer_of_a_synchronous_rpdo_is_no_watchdog(drive):
    lacking = {"missing": [*ONE_RPDO, CONSUMER, GUARD_TIME], "prepare": synchronous_only}
    with pytest.raises(DriveError, match=r"is_watchdog_required.*\[FH-217\]"):
        drive(**lacking)
    one = drive(is_watchdog_required=False, **lacking)
    assert "does NOT watch the daemon" in one.notes
    assert one.bench.read(0x1400, 5, "H") == TIMER_MS  # set all the same
    one.turn()
    assert one.die() == math.inf  # what the refusal is for


@pytest.mark.parametrize("missing", [ONE_RPDO, [*ONE_RPDO, CONSUMER]], ids=["heartbeat", "guarding"])
@pytest.mark.parametrize("feed", range(1, 6))
def test_heartbeat_and_guarding_act_as_soon_as_a_timer_does(drive, missing, feed):
    """Whenever the daemon is killed: within the time that is shown, and neither before nor while it lives."""
    one = drive(missing=missing, sdo=WITHOUT_TIMER)
    one.turn()
    one.cycle(Request.ENABLE, count=feed)
    shown = one.facts.units[-1]
    assert shown.quantity == "watchdog"
    assert f"takes the torque within {TIMER_MS + 10} ms of the daemon's last frame" in shown.value
    assert TIMER_MS - 6 < one.die() <= TIMER_MS + 10


def test_a_drive_that_takes_longer_times_only_is_warned_of_or_refused_with_the_bridged_periods_that_it_can_meet(drive):
    """Its clock ticks slowly: it takes no time below 90 ms for its heartbeat consumer."""
    is_taken = lambda value: not 0 < value & 0xFFFF < 90  # noqa: E731
    slow = {"missing": [*ONE_RPDO, GUARD_TIME], "sdo": WITHOUT_TIMER, "prepare": limited(CONSUMER, 1, is_taken)}
    one = drive(**slow)
    assert "heartbeat (1016h:01) within 100 ms" in one.notes
    assert "within 110 ms, because it takes no time shorter than 100 ms" in one.notes
    assert "[FH-269]" in one.notes
    one.turn()
    assert TIMER_MS < one.die() <= 110.0
    one.close()
    with pytest.raises(DriveError, match=r"realtime.max_missed.*87.*\[FH-270\]"):
        drive(max_missed=10, **slow)
    one = drive(max_missed=87, **slow)
    assert "FH-269" not in one.notes
    assert "takes the torque within 114 ms" in one.facts.units[-1].value


def test_without_6007h_a_heartbeat_counts_if_its_loss_ends_operational(drive):
    one = drive(missing=[REACTION])
    for told in ("heartbeat (1016h:01)", "NMT Pre-operational (1029h:01 = 0)", "has not been seen"):
        assert told in one.notes
    assert "RPDO 4" not in one.notes  # its timer changes no state without 6007h


def test_entries_of_1016h_that_others_made_are_kept_and_one_of_a_daemon_before_is_taken_over(drive):
    one = drive(prepare=lambda bench: bench.write(CONSUMER, 1, "I", 7 << 16 | 500))
    assert one.bench.read(CONSUMER, 1) == 7 << 16 | 500
    assert one.bench.read(CONSUMER, 2) == 126 << 16 | HEARTBEAT_MS
    assert "heartbeat (1016h:02)" in one.notes
    assert "watches node 7 too, within 500 ms; it is kept" in one.notes
    one.close()
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


@pytest.mark.parametrize(
    ("keys", "named"), [({"watchdog_s": 0.005}, "x.watchdog_s"), ({"master_node": 125}, "y.master_node")]
)
def test_a_watchdog_shorter_than_what_is_bridged_or_another_master_is_a_mistake(keys, named):
    with pytest.raises(ConfigurationError, match=rf"axes\.{named}: "):
        configuration(x=axis_dict(node=NODE, **keys), y=axis_dict(node=6))


def test_a_consumer_entry_that_cannot_be_read_is_left_alone(drive):
    """It could not be restored: after the run the drive would miss a heartbeat that nobody sends."""
    one = drive(sdo=refuses(CONSUMER, "read", HIDDEN, subindex=1))
    assert "heartbeat (1016h:02)" in one.notes
    one.turn()
    one.drives.close()
    assert one.drives.leftovers == []
    assert [one.bench.node.dictionary.at(CONSUMER, subindex).value for subindex in (1, 2)] == [0, 0]


@pytest.mark.parametrize("index", [0x1017, 0x605A, 0x6007])
def test_no_optional_object_is_written_that_cannot_be_read(drive, index):
    before = Bench().node.dictionary.at(index, 0).value
    one = drive(sdo=refuses(index, "read", HIDDEN), is_watchdog_required=False)
    assert one.bench.node.dictionary.at(index, 0).value == before
    one.drives.close()
    assert one.drives.leftovers == []


@pytest.mark.parametrize("index", [0x6040, 0x60FF, 0x60B2])
def test_a_command_that_can_only_be_written_has_the_width_of_the_standard(drive, index):
    one = drive(sdo=refuses(index, "read", WRITE_ONLY))
    assert "taken as absent" not in one.notes
    one.turn()


NO_REACTION = {"missing": [REACTION, ERROR_BEHAVIOUR]}
NO_WATCH = {"missing": [REACTION, ERROR_BEHAVIOUR, CONSUMER, GUARD_TIME]}
REFUSED = {
    "missing": [*ONE_RPDO, GUARD_TIME],
    "prepare": synchronous_only,
    "sdo": refuses(CONSUMER, "write", HIGH),
}


@pytest.mark.parametrize(
    ("lacking", "cause"),
    [
        (REFUSED, r"1400h:02 refused FEh .*06090030h.*; 1016h:01 refused 007E0014h .*06090031h.*; no 100Ch"),
        (NO_REACTION, r"1016h and 100Ch could watch it, but .*: no 6007h, no 1029h\. If.*FH-217"),
        (NO_WATCH, r"neither 1016h nor 100Ch, but .*: no 6007h, no 1029h.*FH-217"),
    ],
)
def test_the_refusal_names_the_cause_that_was_found(drive, lacking, cause):
    with pytest.raises(DriveError, match=cause):
        drive(**lacking)


# --- times: longer than what the loop bridges, and not much longer


PERIODS = st.sampled_from([2.5e-4, 5e-4, 1e-3, 2e-3, 4e-3, 1e-2, 0.1])


def silence_ms(period_s, max_missed, between_ms):
    """The longest silence of a daemon that is well: between two frames, and all that it bridges in between."""
    return between_ms + 1e3 * period_s * max_missed


@given(PERIODS, st.integers(1, 40))
def test_by_default_nothing_trips_while_the_loop_bridges(period_s, max_missed):
    times = watchdog_times(period_s, max_missed)
    period_ms = 1e3 * period_s
    assert list(contradictions(period_s, max_missed, times)) == []
    assert times.timer_ms > silence_ms(period_s, max_missed, times.feed_cycles * period_ms)
    assert times.loss_ms > silence_ms(period_s, max_missed, 1e3 * times.beat_s)
    assert times.timer_ms <= times.loss_ms <= times.timer_ms + 3, "each acts as soon as the bridged periods allow"
    assert times.beat_s / period_s == pytest.approx(round(times.beat_s / period_s))
    assert times.timer_ms <= max(20.0, 1.4 * period_ms * (max_missed + 2))
    assert times.feed_cycles == 1 or times.feed_cycles * period_ms <= times.timer_ms / 4


@given(PERIODS, st.integers(1, 40), st.floats(0.002, 2.0), st.floats(0.005, 2.0))
def test_times_that_are_given_are_kept_or_refused(period_s, max_missed, watchdog_s, heartbeat_s):
    times = watchdog_times(period_s, max_missed, heartbeat_s, watchdog_s)
    assert (times.timer_ms, times.heartbeat_ms) == (round(1e3 * watchdog_s), round(1e3 * heartbeat_s))
    refused = {key for key, _ in contradictions(period_s, max_missed, times)}
    period_ms = 1e3 * period_s
    if times.timer_ms <= silence_ms(period_s, max_missed, times.feed_cycles * period_ms):
        assert "watchdog_s" in refused
    if times.loss_ms <= silence_ms(period_s, max_missed, times.heartbeat_ms):
        assert "heartbeat_s" in refused
    for key, text in contradictions(period_s, max_missed, times):
        least = float(text.split("at least ")[1].split(" s")[0])
        given_s = {"watchdog_s": watchdog_s, "heartbeat_s": heartbeat_s}
        again = watchdog_times(period_s, max_missed, **{**given_s, key: least})
        assert key not in {other for other, _ in contradictions(period_s, max_missed, again)}, text


def test_the_demo_stops_within_30_ms():
    times = watchdog_times(1e-3, 20)
    assert (times.timer_ms, times.feed_cycles, times.heartbeat_ms, times.loss_ms) == (25, 3, 20, 28)


@pytest.mark.parametrize(("key", "value"), [("watchdog_s", 0.02), ("heartbeat_s", 0.01)])
def test_a_contradiction_is_told_with_its_arithmetic(key, value):
    times = watchdog_times(1e-3, 20, **{key: value})
    [(found, text)] = contradictions(1e-3, 20, times)
    assert found == key
    assert "realtime.max_missed 20 + 2 cycles of 1 ms = 22 ms" in text
    assert {"watchdog_s": "20 ms after the last command", "heartbeat_s": "30 ms after the last heartbeat"}[key] in text


@given(PERIODS, st.integers(20, 2000))
def test_the_bridged_periods_that_a_drive_can_meet_have_a_time_that_it_takes(period_s, least_ms):
    times = watchdog_times(period_s, 1)
    if times.timer_ms >= least_ms:
        return
    again = watchdog_times(period_s, times.met_by(least_ms))
    assert again.timer_ms >= least_ms
    fewer = times.met_by(least_ms) - 1
    assert fewer < 1 or watchdog_times(period_s, fewer).timer_ms < least_ms


# --- doctor --try-watchdog: what a drive does when a watchdog lapses, as far as it is seen


class Tried(TimedBus):
    """A drive and a computer that is busy with something else now and then, in simulated time."""

    def __init__(self):
        self.bench = Bench(is_paced_by_sync=False, manners={"timer_at_sync_only": True})
        super().__init__([self.bench], 0.0)
        self.stalls_ms = []
        self.is_fed = False
        self.states = set()

    def send(self, msg, timeout=None):
        self.is_fed = self.is_fed or msg.arbitration_id == 0x77E
        super().send(msg, timeout)

    def recv(self, timeout=None):
        if self.is_fed and self.stalls_ms and timeout:
            self.pass_until(self.now_ms + self.stalls_ms.pop())
        return super().recv(timeout)

    def pass_until(self, now_ms):
        super().pass_until(now_ms)
        self.states.add(self.bench.node.drive.state.name)


@pytest.fixture
def tried(monkeypatch):
    """Try the watchdogs of a simulated drive; return the findings and the bus."""

    def attempt(*, prepare=None, stalls_ms=(), answer_ms=0.0):
        bus = Tried()
        monkeypatch.setattr(time, "monotonic", lambda: 1e-3 * bus.now_ms)
        monkeypatch.setattr(time, "sleep", lambda wait_s: bus.pass_until(bus.now_ms + 1e3 * wait_s))
        if prepare is not None:
            prepare(bus.bench.node)
        config = configuration(x=axis_dict(node=NODE))
        drives = CanopenDrives(config, config.axes, BusClock(bus), dry_run=False, bus=bus)
        drives.connect()
        bus.stalls_ms, bus.answer_ms = list(stalls_ms), answer_ms
        try:
            return list(drives.try_own_watchdogs("x")), bus
        finally:
            drives.close()
            bus.shutdown()

    return attempt


def results(findings):
    return [(finding.result, finding.code) for finding in findings]


@pytest.mark.parametrize("answer_ms", [0.0, 15.0, 60.0])
def test_each_means_is_tried_and_what_was_seen_is_told(tried, answer_ms):
    (rpdo, heartbeat), bus = tried(answer_ms=answer_ms)
    assert (rpdo.check, rpdo.result, rpdo.code) == ("x: RPDO 4", "warn", "FH-443")
    assert "8250h" in rpdo.detail
    assert "no reaction seen without torque" in rpdo.detail
    assert (heartbeat.check, heartbeat.result) == ("x: heartbeat (1016h:01)", "pass"), heartbeat.detail
    assert "NMT state pre-operational" in heartbeat.detail
    assert "OPERATION_ENABLED" not in bus.states  # no torque at any time
    assert "SWITCHED_ON" in bus.states
    assert bus.bench.node.drive.state.name == "SWITCH_ON_DISABLED"


SEEN, ALWAYS_LATE = [("warn", "FH-443"), ("pass", "")], [("warn", "FH-442")] * 2


@pytest.mark.parametrize(("stalls", "expected"), [(1, SEEN), (2, SEEN), (1000, ALWAYS_LATE)])
def test_a_drive_that_this_computer_fed_too_late_is_tried_again(tried, stalls, expected):
    """A computer that is always late proves nothing."""
    findings, bus = tried(stalls_ms=[300.0] * stalls)
    assert results(findings) == expected, findings
    assert bool(bus.stalls_ms) is (stalls == 1000)
    assert stalls < 1000 or all("this computer fed the drive" in finding.detail for finding in findings)


def test_a_watchdog_that_does_nothing_is_not_said_to_work(tried):
    def keep_quiet(node):
        node.dictionary.at(0x1029, 1).value = 1  # stays in Operational
        node.dictionary.at(0x1014, 0).value |= 0x80000000

    findings, bus = tried(prepare=keep_quiet)
    assert results(findings) == [("fail", "FH-442")] * 2
    assert all("not seen to act" in finding.detail for finding in findings)
    assert "OPERATION_ENABLED" not in bus.states


def test_without_a_configuration_there_is_nothing_to_try(capsys):
    assert main(["doctor", "--try-watchdog"]) == 2
    assert "--try-watchdog needs CONFIG" in capsys.readouterr().err
