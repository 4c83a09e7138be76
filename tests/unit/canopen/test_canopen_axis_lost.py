"""An axis whose node is out of reach, or whose feedback comes late: stops by SDO, and frames without their SYNC."""

import itertools
import struct

import pytest

from friction_hil.drive import DriveState, Mode, Request
from tests.canopen_axis_bench import (
    BOOT_UP,
    HEARTBEAT,
    MS,
    NODE,
    OPERATIONAL,
    PRE_OPERATIONAL,
    SDO_ANSWER,
    Bench,
    answers,
)
from tests.messages import codes_in

QUICK_STOP, DISABLE = ((0x605, bytes.fromhex(f"2b406000{word}000000")) for word in ("02", "00"))
READ_STATE, READ_POSITION, READ_ERROR = ((0x605, bytes.fromhex(f"40{i}600000000000")) for i in ("41", "64", "3f"))
NMT_START = (0x000, bytes([0x01, NODE]))
WRITTEN = bytes.fromhex("6040600000000000")
NO_OBJECT = bytes.fromhex("8064600000000206")
FOLLOWING_ERROR = bytes.fromhex("4b3f600011860000")


def statusword(word):
    return struct.pack("<BHBHxx", 0x4B, 0x6041, 0, word)


def position(value):
    return struct.pack("<BHBi", 0x43, 0x6064, 0, value)


class Stopped(Bench):
    """An enabled axis whose node says what its NMT state is; frames beside the RPDO, answered by hand."""

    def __init__(self, heartbeat=PRE_OPERATIONAL, *, is_asked=False):
        super().__init__(Mode.CSV, heartbeat=OPERATIONAL)
        self.heard()
        self.heartbeat(heartbeat)
        if is_asked:
            self.cycle()
            assert self.ask() == [NMT_START, QUICK_STOP]

    def ask(self, request=Request.QUICK_STOP):
        return self.axis.other_frames(request, self.now_ns) if self.axis.needs_other_frames else []

    def answer(self, data, after_ms=1):
        """Answer by SDO; the feedback and the frames of the next cycle."""
        self.take((SDO_ANSWER, data))
        feedback = self.cycle(after_ms=after_ms)
        return feedback, self.ask()


def test_a_node_that_left_operational_is_started_and_stopped_by_sdo_at_once():
    bench = Stopped()
    feedback = bench.cycle()
    assert (feedback.is_reachable, feedback.state) == (False, DriveState.UNKNOWN)
    assert bench.ask() == [NMT_START, QUICK_STOP]
    assert not bench.axis.is_proved_unpowered
    assert bench.answer(WRITTEN)[1] == [READ_STATE]
    feedback, frames = bench.answer(statusword(0x0217))
    assert (feedback.state, frames) == (DriveState.QUICK_STOP_ACTIVE, [READ_POSITION])
    assert bench.answer(position(400))[1] == [READ_STATE]
    assert bench.answer(statusword(0x0217))[1] == [READ_POSITION]
    for _ in range(2):  # it stands for a while before its power is taken
        assert bench.answer(position(500), after_ms=26)[1] in ([READ_STATE], [NMT_START, READ_STATE])
        assert bench.answer(statusword(0x0217))[1] == [READ_POSITION]
    assert bench.answer(position(500))[1] == [DISABLE]
    assert bench.answer(WRITTEN)[1] == [READ_STATE]
    feedback, frames = bench.answer(statusword(0x0250))
    assert (feedback.state, frames) == (DriveState.SWITCH_ON_DISABLED, [])
    assert bench.axis.is_proved_unpowered
    assert codes_in(feedback.message) == "FH-232"
    for _ in range(300):  # it stops answering: it is not called unpowered any more
        bench.heartbeat(PRE_OPERATIONAL)
        feedback = bench.cycle()
        bench.ask()
    assert feedback.state is DriveState.UNKNOWN
    assert not bench.axis.is_proved_unpowered


def test_a_node_that_is_back_in_operational_is_stopped_by_rpdos_again():
    bench = Stopped(is_asked=True)
    feedback = bench.heard(state=0x0217)
    assert feedback.is_reachable
    assert bench.command(Request.QUICK_STOP)[:4] == "0200"
    assert bench.ask() == []
    assert codes_in(bench.heard(state=0x0217).message) == "FH-232"


def test_the_tpdos_of_the_cycle_in_which_a_node_left_do_not_prove_that_it_is_back():
    bench = Bench(heartbeat=OPERATIONAL)
    bench.heard()
    assert not bench.cycle(*answers(), (HEARTBEAT, PRE_OPERATIONAL)).is_reachable
    assert bench.heard().is_reachable  # these answer a SYNC that came after it


def test_a_restarted_node_gets_no_rpdo_and_no_start_and_its_state_is_unknown():
    bench = Stopped(BOOT_UP)
    feedback = bench.cycle()
    assert (feedback.is_reachable, feedback.state) == (False, DriveState.UNKNOWN)
    assert bench.ask() == [QUICK_STOP]
    bench.heartbeat(PRE_OPERATIONAL)
    assert bench.answer(WRITTEN)[1] == [READ_STATE]
    feedback, frames = bench.answer(statusword(0x0250))
    assert (feedback.is_reachable, feedback.state, frames) == (False, DriveState.SWITCH_ON_DISABLED, [])
    assert bench.axis.is_proved_unpowered
    bench.heartbeat(BOOT_UP)  # once more: what was read before does not count
    assert bench.cycle().state is DriveState.UNKNOWN
    assert bench.ask() == [QUICK_STOP]
    assert not bench.axis.is_proved_unpowered
    assert not bench.heard().is_reachable, "not even if TPDOs come"


def test_what_follows_the_first_cause_is_told_beside_it_and_heartbeats_in_another_state_are_heartbeats():
    bench = Stopped()
    for _ in range(20):
        assert codes_in(bench.cycle(after_ms=100).notices) == []
        bench.heartbeat(PRE_OPERATIONAL)
    told = [notice for _ in range(5) for notice in bench.cycle(after_ms=100).notices]
    assert told == ["no heartbeat from node 5 for more than 300 ms [FH-230]"]
    assert codes_in(bench.cycle().message) == "FH-232"


def test_a_loss_that_is_over_and_was_reported_does_not_end_the_next_start():
    bench = Bench(heartbeat=OPERATIONAL)
    bench.heard()
    bench.heartbeat(PRE_OPERATIONAL)
    codes = [codes_in(bench.heard().message)]
    for heartbeat, state in ((None, 0x0237), (OPERATIONAL, 0x0250), (None, 0x0250)):  # first it still has power
        if heartbeat is not None:
            bench.heartbeat(heartbeat)
        bench.command(Request.DISABLE)
        codes.append(codes_in(bench.heard(state=state).message))
    assert codes == ["FH-232", "FH-232", "FH-232", ""]
    bench.heartbeat(BOOT_UP)  # its configuration is lost: no reset brings that back
    for _ in range(3):
        bench.command(Request.DISABLE)
        assert codes_in(bench.heard(state=0x0250).message) == "FH-231"


def test_without_an_answer_the_stop_goes_on_and_ends_with_disable_voltage():
    bench, sent = Stopped(), []
    for _ in range(1000):
        bench.heartbeat(PRE_OPERATIONAL)
        assert bench.cycle().state is DriveState.UNKNOWN
        sent += bench.ask()
    commands = [frame for frame in sent if frame[0] == 0x605]
    assert 15 <= len(commands) <= 25
    assert commands[:5] == [QUICK_STOP] * 5
    assert commands[-5:] == [DISABLE] * 5
    assert not bench.axis.is_proved_unpowered


def conversation(ms, position_of=lambda now_ms: position(0), state_of=lambda now_ms: 0x0217):
    """What a drive is asked by SDO that answers after 2 ms each time, in quick stop unless told; with the times."""
    bench, asked = Stopped(), []
    bench.cycle()
    frames = bench.ask()
    while bench.now_ns < ms * MS:
        frame, now_ms = next((frame for frame in frames if frame[0] == 0x605), None), bench.now_ns // MS
        if frame is not None:
            asked.append((now_ms, frame))
        answer = WRITTEN
        if frame == READ_STATE:
            answer = statusword(state_of(now_ms))
        elif frame == READ_POSITION:
            answer = position_of(now_ms)
        bench.heartbeat(PRE_OPERATIONAL)
        frames = bench.answer(answer, after_ms=2)[1]
    return asked


def quick_stopping(position_of, ms):
    """The commands that are written until it is over, with their times."""
    asked = conversation(ms, lambda now_ms: position(round(position_of(now_ms))))
    return [(at, frame) for at, frame in asked if frame in (QUICK_STOP, DISABLE)]


def words_of(commands):
    return [word for _, word in commands]


@pytest.mark.parametrize("speed", [0.4, -0.4])  # counts/ms
def test_an_axis_that_brakes_in_either_direction_does_not_stand(speed):
    """And a quick stop that does not end is followed by disable after two seconds."""
    commands = quick_stopping(lambda now_ms: speed * min(now_ms, 400), 1000)
    assert 445 < next(at for at, word in commands if word == DISABLE) < 470
    commands = quick_stopping(lambda now_ms: speed * now_ms, 2200)
    assert (commands[0][1], commands[-1][1]) == (QUICK_STOP, DISABLE)
    assert all(at >= 1990 for at, word in commands if word == DISABLE), "it is braking until then"


@pytest.mark.parametrize("step", [1, -1])
def test_what_is_no_faster_than_standstill_is_disabled_soon(step):
    """Two counts in 50 ms are the noise of an encoder, three are motion."""
    commands = quick_stopping(lambda now_ms: 2 * step * (now_ms % 8 > 3), 200)
    assert words_of(commands)[:2] == [QUICK_STOP, DISABLE]
    assert 50 <= commands[1][0] <= 70
    assert words_of(quick_stopping(lambda now_ms: 3 * step * (now_ms // 45), 1000)) == [QUICK_STOP]


def test_a_position_that_wraps_round_is_no_motion():
    commands = quick_stopping(lambda now_ms: -(2**31) if now_ms % 8 > 3 else 2**31 - 1, 200)
    assert 50 <= commands[1][0] <= 70


def test_where_the_position_is_refused_a_quick_stop_has_half_a_second():
    commands = conversation(600, lambda now_ms: NO_OBJECT)
    assert 500 <= next(at for at, word in commands if word == DISABLE) <= 510


def test_a_drive_that_stops_after_its_fault_is_let_alone_until_it_has_done_so():
    asked = conversation(2100, state_of=lambda now_ms: 0x021F)
    commands = [(at, word) for at, word in asked if word != READ_STATE]
    assert words_of(commands)[:2] == [QUICK_STOP, DISABLE]
    assert 2000 <= commands[1][0] <= 2010


def test_a_drive_that_does_not_obey_gets_the_quick_stop_for_a_tenth_of_a_second_only():
    asked = conversation(300, state_of=lambda now_ms: 0x0237)
    assert QUICK_STOP in [word for at, word in asked if 90 <= at <= 100]
    assert {word for at, word in asked if at > 110} == {READ_STATE, DISABLE}


def test_a_drive_without_power_is_asked_ten_times_a_second_whether_that_is_still_so():
    asked = conversation(1000, state_of=lambda now_ms: 0x0250 if now_ms < 800 else 0x0237)
    assert asked[0][1] == QUICK_STOP
    reads = [at for at, word in asked if at < 800]
    assert all(100 <= after - before <= 104 for before, after in itertools.pairwise(reads[1:]))
    assert len(reads) == 9
    assert DISABLE in [word for at, word in asked if at > 800], "it has power again"


def test_an_answer_to_another_request_or_in_segments_is_not_taken():
    """A statusword fits into one frame; what looks like the segment of one may belong to another client."""
    bench = Stopped(is_asked=True)
    for stray in (statusword(0x0250), position(0), bytes.fromhex("8000100000000206"), b"", bytes(8)):
        feedback, frames = bench.answer(stray)
        assert (feedback.state, frames) == (DriveState.UNKNOWN, []), stray
    assert bench.answer(WRITTEN)[1] == [READ_STATE]
    for stray in ("4141600002000000", "0b50020000000000"):
        feedback, frames = bench.answer(bytes.fromhex(stray))
        assert (feedback.state, frames) == (DriveState.UNKNOWN, []), stray
    assert bench.answer(statusword(0x0250))[0].state is DriveState.SWITCH_ON_DISABLED


def test_a_drive_that_is_not_heard_any_more_is_stopped_by_sdo_too():
    """TPDOs do not come, RPDOs may get there: both ways are tried, and no word follows from the old state."""
    bench = Bench(Mode.CSV)
    bench.heard()
    for _ in range(15):
        feedback = bench.cycle()
    assert (feedback.is_reachable, feedback.state) == (True, DriveState.OPERATION_ENABLED)
    assert bench.command(Request.DISABLE)[:4] == "0000"
    assert bench.command(Request.QUICK_STOP)[:4] == "0200"
    assert bench.axis.other_frames(Request.ENABLE, bench.now_ns) == []
    assert bench.axis.other_frames(Request.QUICK_STOP, bench.now_ns) == [QUICK_STOP]
    assert not bench.cycle(after_ms=300).is_reachable


@pytest.mark.parametrize("is_restarted", [False, True])
def test_a_node_that_answers_no_sdo_is_started_unless_it_restarted(is_restarted):
    """A node without heartbeat does not say that another master has stopped it: then it has no SDO either."""
    bench = Bench(Mode.CSV)
    bench.heard()
    if is_restarted:
        bench.heartbeat(BOOT_UP)
    sent, starts_ms = [], []
    for _ in range(350):
        bench.cycle()
        frames = bench.axis.other_frames(Request.QUICK_STOP, bench.now_ns)
        sent += frames
        starts_ms += [bench.now_ns // MS] * (NMT_START in frames)
    assert {after - before for before, after in itertools.pairwise(starts_ms)} <= {50}
    assert {frame for frame in sent if frame != NMT_START} == {QUICK_STOP}
    assert (NMT_START in sent) is not is_restarted
    assert is_restarted or sent.index(NMT_START) == 2, "after two requests without an answer"


def test_a_node_that_has_answered_is_started_only_after_two_more_requests_without_an_answer():
    bench, sent = Bench(Mode.CSV), []
    bench.heard()
    for _ in range(200):
        bench.cycle()
        for frame in bench.axis.other_frames(Request.QUICK_STOP, bench.now_ns):
            sent.append(frame)
            if sent == [QUICK_STOP]:
                bench.take((SDO_ANSWER, WRITTEN))
    assert sent[:4] == [QUICK_STOP, READ_STATE, QUICK_STOP, NMT_START]


@pytest.mark.parametrize(("cycles", "count"), [(1, 1), (220, 5), (400, 5)])
def test_the_error_code_of_a_fault_without_emergency_is_asked_for_five_times(cycles, count):
    bench, asked = Bench(), []
    bench.heard()
    for _ in range(cycles):
        assert bench.heard(state=0x0218).error == ""
        if bench.axis.needs_other_frames:
            frames = bench.axis.other_frames(Request.QUICK_STOP, bench.now_ns)
            asked += [(bench.now_ns // MS, frame) for frame in frames]
    assert words_of(asked) == [READ_ERROR] * count
    assert [after - before for (before, _), (after, _) in itertools.pairwise(asked)] == [50] * (count - 1)
    if cycles < 400:  # the fifth one may still be answered
        bench.take((SDO_ANSWER, FOLLOWING_ERROR))
        assert bench.heard(state=0x0218).error == "8611h following error"
        assert not bench.axis.needs_other_frames


def test_the_stop_does_not_wait_for_another_answer_and_what_was_asked_for_it_does_not_end_it():
    """Nor is the answer to a request of the stop waited for once RPDOs reach the drive again."""
    bench = Bench(heartbeat=OPERATIONAL)
    bench.heard()
    for heartbeat, last in ((OPERATIONAL, READ_ERROR), (PRE_OPERATIONAL, QUICK_STOP), (OPERATIONAL, READ_ERROR)):
        bench.heartbeat(heartbeat)
        bench.cycle(*(answers(state=0x0218) if heartbeat == OPERATIONAL else ()))
        assert bench.axis.other_frames(Request.QUICK_STOP, bench.now_ns)[-1] == last


def test_a_glitch_of_half_the_counters_range_is_over_with_the_next_cycle():
    bench = Bench()
    first, second, glitch, *after = [
        bench.heard(counts).position for counts in (1000, 1010, 1020 - (1 << 31), 1030, 1040)
    ]
    assert abs(glitch) > 1e6
    assert [first, second, *after] == [1.0, 1.01, 1.03, 1.04]


# --- late feedback


def come(bench, *counts, without_sync=""):
    """A cycle in which several sets of TPDOs come."""
    return bench.cycle(*(frame for each in counts for frame in answers(each)), without_sync=without_sync)


def test_tpdos_that_come_late_are_found_by_a_cycle_without_sync():
    bench = Bench()
    come(bench, 1)
    for _ in range(5):
        come(bench)
    come(bench, 2)  # of five cycles ago
    assert bench.axis.answers.is_doubtful
    assert not bench.axis.answers.is_complete, "newer ones are waited for"
    assert not come(bench, 3, without_sync="a probe").is_fresh
    for counts in (4, 5):
        feedback = come(bench, counts)
        assert not feedback.is_fresh
        assert feedback.missing == "the TPDOs of node 5 answer SYNC 4 cycles late [FH-235]"
    feedback = come(bench, 6, 7, 8, 9, 10)  # what was held up comes at once: the last one is that of this cycle
    assert (feedback.is_fresh, feedback.position) == (True, 0.010)


def test_lost_tpdos_are_not_taken_for_late_ones():
    bench = Bench()
    assert come(bench, 1, 2).position == 0.001, "a second answer to the same SYNC does not count"
    for _ in range(3):
        come(bench)
    assert come(bench, 5).is_fresh
    assert bench.axis.answers.is_doubtful
    assert not come(bench, without_sync="a probe").is_fresh
    assert come(bench, 7).is_fresh
    assert bench.axis.answers.is_complete
    assert not bench.axis.answers.is_doubtful


def test_tpdos_that_come_after_their_cycle_say_so():
    bench = Bench()
    come(bench, 1)
    come(bench)
    bench.take(*answers(2))
    assert come(bench).missing.endswith("too late in its cycle [FH-235]")


# --- health of the node, and what belongs to a SYNC


def test_an_empty_heartbeat_says_nothing():
    bench = Bench()
    bench.heard()
    for heartbeat in (b"", PRE_OPERATIONAL):  # nor does one before the first in Operational
        bench.heartbeat(heartbeat)
        assert bench.axis.state is DriveState.OPERATION_ENABLED
    assert bench.heard().message == ""


def test_a_node_whose_heartbeat_is_lost_is_out_of_reach_with_its_first_missing_answer():
    bench = Bench(heartbeat_s=0.02, heartbeat=OPERATIONAL)
    for _ in range(70):
        feedback = bench.heard()
    assert (feedback.is_reachable, codes_in(feedback.message)) == (True, "FH-230")
    assert not bench.cycle().is_reachable


def test_what_comes_in_a_cycle_without_sync_answers_no_sync():
    bench = Bench()
    for _ in range(3):
        bench.heard()
    feedback = come(bench, 9, without_sync="no SYNC was sent")
    assert (feedback.is_fresh, feedback.missing) == (False, "no SYNC was sent")


def test_a_tpdo_that_is_lost_after_another_was_is_not_said_to_come_late():
    bench = Bench()
    assert "too late" not in bench.cycle().missing
    bench.heard()
    for _ in range(2):
        assert bench.cycle(answers()[0]).missing == "TPDO 2 of node 5 did not arrive in time"


def test_a_late_tpdo_and_that_of_this_sync_complete_the_set():
    bench = Bench()
    bench.heard()
    tpdo1, tpdo2 = answers(7)
    assert not bench.cycle(tpdo1).is_fresh
    bench.axis.begin_cycle(bench.now_ns + MS)
    bench.take(tpdo1, tpdo2)
    assert not bench.axis.answers.is_complete
    bench.take(tpdo2)
    assert bench.axis.answers.is_complete
