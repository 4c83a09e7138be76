"""The cyclic phase of two drives, frame by frame: what is sent when, how long is waited, and when the heartbeat ends.

Bus and clock are a wire on the bench: time passes only while the exchange waits, and to the nanosecond; simulated time
stands meanwhile.
"""

import struct
from collections import deque

import pytest
from friction_hil_drivers.canopen.connect.watchdogs import NOT_WATCHED, Watch
from friction_hil_drivers.canopen.cycle.axis import CanopenAxis
from friction_hil_drivers.canopen.cycle.exchange import CyclicExchange
from friction_hil_drivers.canopen.wire.queue_full import QueueFullError

from friction_hil.drive import Command, Feedback, Request
from friction_hil.errors import DriveError
from tests.canopen_axis_bench import MS, OPERATIONAL, PRE_OPERATIONAL, answers, drive_of
from tests.messages import codes_in

SYNC, MASTER = 0x80, 0x77E
ENABLED, OFF = 0x0637, 0x0650


class Node:
    """A drive in CSP: answers SYNC after 0.1 ms, and SDO after 0.5 ms if it does."""

    def __init__(self, number, first_tpdo=0x180):
        self.number = number
        self.ids = [first_tpdo + number + offset for offset in (0, 0x100, 0x80)]
        self.statusword = ENABLED
        self.is_answering = self.has_sdo = True

    def axis(self, watch=NOT_WATCHED, **how):
        drive = drive_of(ids=self.ids, name=f"n{self.number}", watch=watch, **how)
        return CanopenAxis(drive, self.number, 0.1)

    def answers(self, can_id, data):
        if can_id == SYNC and self.is_answering:
            sets = answers(state=self.statusword)
            yield from ((100_000, (own, content)) for own, (_, content) in zip(self.ids, sets, strict=False))
        if can_id == 0x600 + self.number and self.has_sdo:
            index = struct.unpack_from("<H", data, 1)[0]
            answer = struct.pack("<BHBi", 0x43, index, 0, 900)
            if data[0] == 0x2B:
                answer = struct.pack("<BHB4x", 0x60, index, 0)
            elif index == 0x6041:
                answer = struct.pack("<BHBHxx", 0x4B, index, 0, self.statusword)
            yield 500_000, (0x580 + self.number, answer)


class Wire:
    """Bus and clock."""

    def __init__(self, nodes, is_real=True):
        self.nodes, self.is_real = nodes, is_real
        self.ns = self.waited_ns = 0
        self.sent = []  # (time, identifier, data), or the length of a remote frame
        self.coming = deque()
        self.full = ()  # identifiers of frames that it does not take
        self._looks = 0

    def now_ns(self):
        self._looks += 1
        assert self._looks < 1000, "the exchange waits for ever"
        return self.ns

    def send(self, can_id, data):
        if can_id in self.full:
            raise QueueFullError("the queue is full")
        self.sent.append((self.ns, can_id, bytes(data)))
        for node in self.nodes:
            for delay, frame in node.answers(can_id, data):
                self.coming.append((self.ns + delay, frame))

    def send_remote(self, can_id, length):
        self.sent.append((self.ns, can_id, length))

    def receive(self, timeout):
        if not self.is_real:
            if self.coming:
                return self.coming.popleft()[1]
            self.waited_ns += round(timeout * 1e9)
            return None
        until = self.ns + round(timeout * 1e9)
        if self.coming and self.coming[0][0] <= until:
            at, frame = self.coming.popleft()
            self.ns, self._looks = max(self.ns, at), 0
            return frame
        if until > self.ns:
            self.ns, self._looks = until, 0
        return None

    def times(self, can_id):
        return [at for at, each, _ in self.sent if each == can_id]


class Cycles:
    """Two drives, 5 and 6, at 1 kHz; the daemon is node 126."""

    def __init__(self, *nodes, is_real=True, watches=(), heartbeat_s=0.01, period_ms=1, drives=None, **what):
        self.nodes = nodes or (Node(5), Node(6))
        self.wire = Wire(self.nodes, is_real)
        watches = watches or [NOT_WATCHED] * len(self.nodes)
        self.axes = [node.axis(watch, **(drives or {})) for node, watch in zip(self.nodes, watches, strict=True)]
        given = {"dry_run": False, "master_node": 126, "max_missed": 4} | what
        times = {"period_s": period_ms * 1e-3, "heartbeat_s": heartbeat_s}
        self.exchange = CyclicExchange(self.wire, self.axes, self.wire, **times, **given)
        self.exchange.start()
        self.begin_ns, self.period_ns = 0, period_ms * MS
        self.feedback = [Feedback() for _ in self.axes]

    def receive(self):
        """Begin a cycle at its time; the feedback."""
        self.wire.ns = max(self.begin_ns, self.wire.ns)
        for feedback in self.feedback:
            feedback.notices.clear()
        self.exchange.receive(self.feedback, self.begin_ns + self.period_ns)
        return self.feedback

    def send(self, *requests):
        self.exchange.send([Command(request) for request in requests or [Request.ENABLE] * len(self.axes)])

    def cycle(self, *requests, count=1):
        for _ in range(count):
            self.receive()
            self.send(*requests)
            self.begin_ns += self.period_ns
        return self.feedback

    def heard(self, node, state):
        self.wire.coming.append((self.wire.ns, (0x700 + node, state)))

    def lose(self, number):
        """A node leaves Operational, in which it has been, and is silent."""
        self.heard(5 + number, OPERATIONAL)
        self.cycle()
        self.nodes[number].is_answering = False
        self.heard(5 + number, PRE_OPERATIONAL)

    @property
    def lost(self):
        return [one.is_setpoint_lost for one in self.feedback]

    @property
    def fresh(self):
        return [one.is_fresh for one in self.feedback]

    @property
    def messages(self):
        return [codes_in(one.message) for one in self.feedback]


# --- waiting


def test_sync_is_the_first_frame_of_a_cycle_and_what_came_before_is_not_waited_for():
    cycles = Cycles()
    cycles.exchange.warm_caches()
    assert cycles.wire.sent == []
    cycles.begin_ns = 7 * MS
    cycles.heard(5, OPERATIONAL)
    cycles.receive()
    assert cycles.wire.sent == [(7 * MS, SYNC, b"")]
    assert cycles.wire.ns == 7 * MS + 100_000, "no longer than until the last TPDO"
    assert (cycles.fresh, cycles.lost, cycles.messages) == ([True] * 2, [False] * 2, [""] * 2)
    cycles.heard(5, PRE_OPERATIONAL)
    cycles.begin_ns += MS
    cycles.receive()
    assert cycles.messages[0] == "FH-232", "taken before SYNC"


def test_a_frame_of_a_stranger_is_passed_over():
    cycles = Cycles()
    for first_ns in (0, 50_000):
        cycles.wire.coming += [(cycles.begin_ns + first_ns, (can_id, b"")) for can_id in (0x123, 0x124)]
        cycles.receive()
        assert cycles.fresh == [True, True]
        cycles.begin_ns += MS


def test_missing_feedback_is_awaited_until_a_quarter_of_the_period_is_left():
    cycles = Cycles()
    cycles.cycle()
    cycles.nodes[1].is_answering = False
    cycles.receive()
    assert cycles.fresh == [True, False]
    assert cycles.wire.ns == cycles.begin_ns + 750_000
    cycles.begin_ns += MS
    cycles.wire.ns = cycles.begin_ns + 750_000  # the loop was late
    cycles.receive()
    assert cycles.wire.ns == cycles.begin_ns + 750_000


def test_a_cycle_without_sync_comes_once_feedback_is_doubtful_and_not_within_50_of_the_last_one():
    cycles = Cycles()
    without = []
    for number in range(1, 200):
        cycles.nodes[0].is_answering = number not in (2, 60, 170)
        syncs = len(cycles.wire.times(SYNC))
        feedback, _ = cycles.cycle()
        is_without = len(cycles.wire.times(SYNC)) == syncs
        without += [number] * is_without
        assert feedback.is_setpoint_lost is is_without, "drives take a command over at SYNC"
        assert ("SYNC was left out" in feedback.missing) is is_without
    assert without == [50, 100, 172]


# --- simulated time


@pytest.mark.parametrize("silences", [(2, 2), (2,)])
def test_in_simulated_time_a_drive_has_10_s_and_the_third_silence_in_a_row_ends_the_run(silences):
    cycles = Cycles(is_real=False)
    for silent in silences:
        if len(silences) > 1:  # otherwise it is silent from the first cycle on
            cycles.nodes[1].is_answering = True
            cycles.cycle()
        cycles.nodes[1].is_answering = False
        for _ in range(silent):
            before = cycles.wire.waited_ns
            cycles.receive()
            assert cycles.wire.waited_ns - before == 10_000 * MS
    with pytest.raises(DriveError, match=r"FH-234"):
        cycles.receive()
    assert len(cycles.wire.times(SYNC)) == (7 if len(silences) > 1 else 3)


def test_in_simulated_time_a_drive_out_of_reach_is_hardly_waited_for_and_ends_nothing():
    cycles = Cycles(is_real=False)
    cycles.cycle()
    cycles.lose(1)
    cycles.receive()
    for _ in range(10):
        before = cycles.wire.waited_ns
        cycles.receive()
        assert cycles.wire.waited_ns - before == 50 * MS
    assert [feedback.is_reachable for feedback in cycles.feedback] == [True, False]


def test_in_simulated_time_lost_feedback_makes_no_cycle_without_sync_and_no_command_is_too_old():
    cycles = Cycles(is_real=False)
    for number in range(1, 120):
        cycles.nodes[0].is_answering = number != 2
        cycles.receive()
        cycles.wire.ns += 100 * MS
        cycles.send()
    assert len(cycles.wire.times(SYNC)) == len(cycles.wire.times(0x205)) == 119


# --- commands


def test_the_commands_follow_the_feedback_and_a_drive_that_is_listened_to_gets_none():
    cycles = Cycles()
    cycles.cycle(Request.LISTEN, Request.LISTEN, count=20)
    assert {can_id for _, can_id, _ in cycles.wire.sent} == {SYNC}, "no heartbeat before the first command"
    assert cycles.lost == [False, False]
    cycles.cycle(Request.LISTEN, Request.ENABLE)
    assert [can_id for _, can_id, _ in cycles.wire.sent[-3:]] == [SYNC, 0x206, MASTER]
    cycles.receive()
    assert cycles.lost == [False, False]


def test_a_dry_run_sends_nothing_but_sync():
    cycles = Cycles(drives={"rpdos": ()}, dry_run=True)
    cycles.exchange.warm_caches()
    cycles.cycle(count=30)
    assert {can_id for _, can_id, _ in cycles.wire.sent} == {SYNC}
    assert cycles.exchange.last_frames() is None


@pytest.mark.parametrize("request_", [Request.ENABLE, Request.RESET_FAULT])
@pytest.mark.parametrize(("age_ns", "is_sent"), [(3_900_000, True), (4_100_000, False)])
def test_a_command_that_gives_power_is_sent_up_to_an_age_of_as_many_periods_as_are_bridged(request_, age_ns, is_sent):
    cycles = Cycles()
    cycles.cycle()
    cycles.receive()
    cycles.wire.ns = cycles.begin_ns + age_ns
    cycles.send(request_, Request.QUICK_STOP)
    assert len(cycles.wire.times(0x205)) == 1 + is_sent
    assert cycles.wire.times(0x206)[-1] == cycles.wire.ns, "a stop is never too old"
    cycles.begin_ns += 10 * MS
    first, _ = cycles.receive()
    assert cycles.lost == [not is_sent, False]
    told = [notice.partition(" [")[0] for notice in first.notices if "was not sent" in notice]
    assert told == ([] if is_sent else ["a command was not sent because it was 4 ms old"])


def test_commands_that_the_bus_does_not_take_are_lost_and_a_fault_when_they_are_more_than_is_bridged():
    cycles = Cycles()
    for missed in (4, 4, 5):
        cycles.wire.full = (0x205,)
        for number in range(missed):
            cycles.cycle()
            assert cycles.lost == [number > 0] * 2
        cycles.wire.full = ()
        cycles.cycle()
        assert cycles.lost == [True, True]
        assert cycles.messages == (["" if missed == 4 else "the queue is full"] * 2)
    cycles.cycle()
    assert cycles.lost == [False, False]


def test_a_heartbeat_that_the_bus_does_not_take_is_sent_in_the_next_cycle():
    cycles = Cycles()
    cycles.wire.full = (MASTER,)
    cycles.cycle(count=2)
    assert cycles.lost == [False, False]
    cycles.wire.full = ()
    cycles.cycle()
    assert cycles.wire.times(MASTER) == [cycles.wire.ns]


def test_a_sync_that_the_bus_does_not_take_leaves_the_command_without_effect():
    cycles = Cycles()
    cycles.cycle()
    cycles.wire.full = (SYNC,)
    feedback, _ = cycles.receive()
    assert (feedback.is_setpoint_lost, feedback.missing) == (True, "SYNC was not sent: the queue is full")


def test_a_drive_out_of_reach_is_stopped_by_sdo_and_gets_no_rpdo():
    cycles = Cycles()
    cycles.cycle()
    cycles.lose(1)
    before = len(cycles.wire.times(0x206))
    cycles.cycle(Request.QUICK_STOP, Request.QUICK_STOP)
    assert len(cycles.wire.times(0x206)) == before
    assert (0x606, bytes.fromhex("2b40600002000000")) in [(can_id, data) for _, can_id, data in cycles.wire.sent]
    cycles.receive()
    assert cycles.lost == [False, True]


# --- watchdogs


@pytest.mark.parametrize("is_received", [True, False])
def test_the_heartbeat_goes_out_with_the_first_command_and_then_in_its_period(is_received):
    cycles = Cycles()
    if not is_received:  # a command at time zero
        cycles.send()
    for _ in range(35):
        cycles.receive()
        cycles.wire.ns = cycles.begin_ns + (300_000 if cycles.begin_ns % (20 * MS) else 700_000)
        cycles.send()
        cycles.begin_ns += MS
    assert [at // MS for at in cycles.wire.times(MASTER)] == [0, 10, 20, 30], "a little early is not too early"
    assert {data for _, can_id, data in cycles.wire.sent if can_id == MASTER} == {b"\x05"}
    assert is_received or cycles.wire.times(MASTER)[0] == 0


def test_each_guarded_node_is_asked_in_its_own_period():
    watches = [Watch(beat_s=0.004, is_guarded=True), Watch(beat_s=0.006, is_guarded=True)]
    cycles = Cycles(watches=watches, heartbeat_s=1.0)
    cycles.cycle(Request.LISTEN, Request.LISTEN, count=3)
    assert not cycles.wire.times(0x705)
    cycles.cycle(count=25)
    assert [at // MS for at in cycles.wire.times(0x705)] == [3, 7, 11, 15, 19, 23, 27]
    assert [at // MS for at in cycles.wire.times(0x706)] == [3, 9, 15, 21, 27]
    assert {length for _, can_id, length in cycles.wire.sent if can_id in (0x705, 0x706)} == {1}
    assert len(cycles.wire.times(MASTER)) == 1


def test_the_watchdog_rpdo_comes_in_turn_and_carries_the_controlword_in_force():
    watches = [Watch(rpdo_id=0x505, feed_cycles=4), Watch(rpdo_id=0x506, feed_cycles=4)]
    cycles = Cycles(watches=watches)
    words = []
    for number in range(16):
        cycles.cycle(*[Request.ENABLE if number < 8 else Request.QUICK_STOP] * 2)
        words.append([(can_id, data.hex()) for _, can_id, data in cycles.wire.sent if can_id in (0x505, 0x506)])
        cycles.wire.sent.clear()
    assert [[can_id for can_id, _ in each] for each in words] == [[0x505], [], [0x506], []] * 4
    seen = [data for each in words for _, data in each]
    assert seen == ["0000", "0f00", "0f00", "0f00", "0f00", "0200", "0200", "0200"]


def test_a_controlword_is_in_force_only_after_the_next_sync():
    cycles = Cycles(Node(5), watches=[Watch(rpdo_id=0x505)])
    cycles.cycle(count=3)
    cycles.wire.sent.clear()
    cycles.send(Request.QUICK_STOP)
    cycles.send(Request.QUICK_STOP)
    for full in ((SYNC,), ()):
        cycles.wire.full = full
        cycles.receive()
        cycles.send(Request.QUICK_STOP)
    assert [data.hex() for _, can_id, data in cycles.wire.sent if can_id == 0x505] == ["0f00"] * 3 + ["0200"]


class Losing(Cycles):
    """Drive 6 has left Operational; what remains of the heartbeat is looked at."""

    def __init__(self, statusword, *, has_sdo, other=OFF):
        super().__init__(period_ms=5)
        self.cycle(count=2)
        self.heard(6, OPERATIONAL)
        self.cycle(count=10)
        self.nodes[0].statusword, self.nodes[1].statusword = other, statusword
        self.nodes[1].has_sdo, self.nodes[1].is_answering = has_sdo, False
        self.lost_ns = self.begin_ns

    def last_beat_s(self, seconds):
        """Time of the last heartbeat after the loss, within so many seconds."""
        while self.begin_ns < self.lost_ns + seconds * 1e9:
            if self.begin_ns % (100 * MS) == 0 or self.begin_ns == self.lost_ns:
                self.heard(6, PRE_OPERATIONAL)
            self.cycle(Request.QUICK_STOP, Request.QUICK_STOP)
        return (self.wire.times(MASTER)[-1] - self.lost_ns) * 1e-9


def test_where_nothing_else_is_left_the_heartbeat_ends_after_a_fifth_of_a_second():
    cycles = Losing(ENABLED, has_sdo=False)
    assert cycles.last_beat_s(1.0) == pytest.approx(0.2, abs=0.012)
    cycles.heard(6, OPERATIONAL)
    cycles.nodes[1].is_answering = True
    before = len(cycles.wire.times(MASTER))
    cycles.cycle(Request.QUICK_STOP, Request.QUICK_STOP, count=20)
    assert len(cycles.wire.times(MASTER)) - before == 10, "it is back"
    cycles.nodes[1].is_answering, cycles.lost_ns = False, cycles.begin_ns
    cycles.nodes[1].statusword = ENABLED
    assert cycles.last_beat_s(1.0) == pytest.approx(0.2, abs=0.012), "the time counts from the second loss"


def test_a_drive_that_answers_and_one_in_reach_with_power_have_time_until_3_s_are_over():
    assert Losing(ENABLED, has_sdo=True).last_beat_s(3.3) == pytest.approx(3.0, abs=0.012)
    assert Losing(ENABLED, has_sdo=False, other=ENABLED).last_beat_s(3.3) == pytest.approx(3.0, abs=0.012)


def test_the_heartbeat_goes_on_when_the_lost_drive_has_no_power():
    assert Losing(OFF, has_sdo=True).last_beat_s(3.3) > 3.27


# --- what else is told


class Alarm:
    """Another master."""

    def __init__(self):
        self.message, self.handlers = "", {0x234: self.take}

    def take(self, data):
        self.message = "another master"


def test_another_master_is_the_message_of_each_axis_or_told_once_beside_its_own():
    cycles = Cycles(alarm=Alarm())
    cycles.cycle(count=2)
    cycles.lose(1)
    assert cycles.messages == ["", ""]
    cycles.wire.coming.append((cycles.begin_ns, (0x234, b"")))
    first, second = cycles.cycle()
    assert cycles.messages == ["another master", "FH-232"]
    assert "another master" not in first.notices
    assert "another master" in second.notices
    _, second = cycles.cycle()
    assert "another master" not in second.notices


def test_axes_of_one_node_share_its_heartbeats_and_emergencies():
    cycles = Cycles(Node(5), Node(5, first_tpdo=0x190))
    for state, is_answering in ((OPERATIONAL, True), (PRE_OPERATIONAL, False)):
        cycles.heard(5, state)
        for node in cycles.nodes:
            node.is_answering = is_answering
        assert [feedback.is_reachable for feedback in cycles.cycle()] == [is_answering] * 2


@pytest.mark.parametrize(
    ("is_real", "request_", "is_some"),
    [(True, Request.ENABLE, True), (True, Request.LISTEN, False), (False, Request.ENABLE, False)],
)
def test_drives_are_left_with_their_watchdogs_fed_where_they_have_begun_to_watch(is_real, request_, is_some):
    cycles = Cycles(is_real=is_real)
    cycles.cycle(request_, request_)
    assert (cycles.exchange.last_frames() is not None) is is_some
