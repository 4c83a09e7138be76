"""An axis whose node is out of reach, or whose feedback comes late: stops by SDO, and frames without their SYNC."""

import itertools
import struct

import pytest

from friction_hil.drive import DriveState, Feedback, Mode, Request
from tests.canopen_axis_bench import (
    BOOT_UP,
    HEARTBEAT,
    MS,
    NODE,
    OPERATIONAL,
    PRE_OPERATIONAL,
    TPDO1,
    TPDO2,
    Bench,
)
from tests.messages import codes_in

QUICK_STOP_BY_SDO = (0x605, bytes.fromhex("2b40600002000000"))
DISABLE_BY_SDO = (0x605, bytes.fromhex("2b40600000000000"))
READ_STATE = (0x605, bytes.fromhex("4041600000000000"))
READ_POSITION = (0x605, bytes.fromhex("4064600000000000"))
NMT_START = (0x000, bytes([0x01, NODE]))
WRITTEN = bytes.fromhex("6040600000000000")


def statusword(word):
    return struct.pack("<BHBHxx", 0x4B, 0x6041, 0, word)


def position(value):
    return struct.pack("<BHBi", 0x43, 0x6064, 0, value)


class Stopped(Bench):
    """An enabled axis whose node says what its NMT state is; frames beside the RPDO, answered by hand."""

    def __init__(self, heartbeat, mode=Mode.CSV):
        super().__init__(mode)
        self.axis.handlers[HEARTBEAT](OPERATIONAL)
        self.heard(mode=mode)
        self.heartbeat(heartbeat)

    def heartbeat(self, data):
        self.axis.handlers[HEARTBEAT](data)

    def ask(self, request=Request.QUICK_STOP):
        return self.axis.other_frames(request, self.now_ns) if self.axis.needs_other_frames else []

    def answer(self, data, after_ms=1, request=Request.QUICK_STOP):
        """Answer by SDO; the feedback and the frames of the next cycle."""
        self.axis.handlers[0x585](data)
        feedback = self.cycle(after_ms=after_ms)
        return feedback, self.ask(request)


def test_a_node_that_left_operational_is_started_and_stopped_by_sdo_at_once():
    bench = Stopped(PRE_OPERATIONAL)
    feedback = bench.cycle()
    assert (feedback.is_reachable, feedback.state) == (False, DriveState.UNKNOWN)
    assert bench.ask() == [NMT_START, QUICK_STOP_BY_SDO]
    assert bench.answer(WRITTEN)[1] == [READ_STATE]
    feedback, frames = bench.answer(statusword(0x0217))
    assert feedback.state is DriveState.QUICK_STOP_ACTIVE
    assert frames == [READ_POSITION]
    frames = bench.answer(position(400))[1]
    assert frames == [READ_STATE]
    assert bench.answer(statusword(0x0217))[1] == [READ_POSITION]
    for _ in range(2):  # it stands for a while before its power is taken
        assert bench.answer(position(500), after_ms=26)[1] in ([READ_STATE], [NMT_START, READ_STATE])
        assert bench.answer(statusword(0x0217), after_ms=1)[1] == [READ_POSITION]
    assert bench.answer(position(500))[1] == [DISABLE_BY_SDO]
    assert bench.answer(WRITTEN)[1] == [READ_STATE]
    feedback, frames = bench.answer(statusword(0x0250))
    assert feedback.state is DriveState.SWITCH_ON_DISABLED
    assert frames == []
    assert bench.axis.is_proved_unpowered
    assert codes_in(feedback.message) == "FH-232"


def test_a_node_that_is_back_in_operational_is_stopped_by_rpdos_again():
    bench = Stopped(PRE_OPERATIONAL)
    bench.cycle()
    assert bench.ask() == [NMT_START, QUICK_STOP_BY_SDO]
    feedback = bench.heard(state=0x0217, mode=9)
    assert feedback.is_reachable
    assert bench.command(Request.QUICK_STOP)[:4] == "0200"
    assert bench.ask() == []
    assert bench.heard(state=0x0217, mode=9).message.startswith("node 5 left Operational")


def test_the_tpdos_of_the_cycle_in_which_a_node_left_do_not_prove_that_it_is_back():
    bench = Bench(Mode.CSV)
    bench.axis.handlers[HEARTBEAT](OPERATIONAL)
    bench.heard(mode=9)
    first, second = struct.pack("<Hih", 0x0637, 0, 0), struct.pack("<ib", 0, 9)
    assert not bench.cycle((TPDO1, first), (TPDO2, second), (HEARTBEAT, PRE_OPERATIONAL)).is_reachable
    assert bench.heard(mode=9).is_reachable  # these answer a SYNC that came after it


def test_a_restarted_node_gets_no_rpdo_and_no_start_and_its_state_is_unknown():
    bench = Stopped(BOOT_UP)
    feedback = bench.cycle()
    assert (feedback.is_reachable, feedback.state) == (False, DriveState.UNKNOWN)
    assert bench.ask() == [QUICK_STOP_BY_SDO]
    bench.heartbeat(PRE_OPERATIONAL)
    feedback, frames = bench.answer(WRITTEN)
    assert frames == [READ_STATE]
    feedback, frames = bench.answer(statusword(0x0250))
    assert (feedback.is_reachable, feedback.state, frames) == (False, DriveState.SWITCH_ON_DISABLED, [])
    bench.heartbeat(BOOT_UP)  # once more: what was read before does not count
    feedback = bench.cycle()
    assert feedback.state is DriveState.UNKNOWN
    assert bench.ask() == [QUICK_STOP_BY_SDO]
    assert not bench.heard(mode=9).is_reachable, "not even if TPDOs come"


def test_heartbeats_in_another_state_are_heartbeats():
    bench = Stopped(PRE_OPERATIONAL)
    for _ in range(20):
        feedback = bench.cycle(after_ms=100)
        assert "no heartbeat" not in "".join(feedback.notices)
        bench.heartbeat(PRE_OPERATIONAL)
    assert codes_in(feedback.message) == "FH-232"


def test_what_follows_the_first_cause_is_told_beside_it():
    bench = Stopped(PRE_OPERATIONAL)
    told = [notice for _ in range(5) for notice in bench.cycle(after_ms=100).notices]
    assert told == ["no heartbeat from node 5 for more than 300 ms [FH-230]"]
    assert codes_in(bench.cycle().message) == "FH-232"


def test_a_loss_that_is_over_and_was_reported_does_not_end_the_next_start():
    bench = Bench()
    bench.axis.handlers[HEARTBEAT](OPERATIONAL)
    bench.heard()
    bench.axis.handlers[HEARTBEAT](PRE_OPERATIONAL)
    said = "node 5 left Operational: it is pre-operational [FH-232]"
    assert bench.heard().message == said
    bench.command(Request.DISABLE)
    assert bench.heard(state=0x0237).message == said, "it still has power"
    bench.axis.handlers[HEARTBEAT](OPERATIONAL)
    bench.command(Request.DISABLE)
    assert bench.heard(state=0x0250).message == said
    bench.command(Request.DISABLE)
    assert bench.heard(state=0x0250).message == ""
    bench.axis.handlers[HEARTBEAT](BOOT_UP)  # its configuration is lost: no reset brings that back
    for _ in range(3):
        bench.command(Request.DISABLE)
        assert "restarted" in bench.heard(state=0x0250).message


def test_without_an_answer_the_stop_goes_on_and_ends_with_disable_voltage():
    bench = Stopped(PRE_OPERATIONAL)
    sent = []
    for _ in range(1000):
        bench.heartbeat(PRE_OPERATIONAL)
        assert bench.cycle().state is DriveState.UNKNOWN
        sent += bench.ask()
    commands = [frame for frame in sent if frame[0] == 0x605]
    assert 15 <= len(commands) <= 25
    assert commands[:5] == [QUICK_STOP_BY_SDO] * 5
    assert commands[-5:] == [DISABLE_BY_SDO] * 5
    assert not bench.axis.is_proved_unpowered


def test_a_drive_that_does_not_obey_the_quick_stop_is_disabled():
    bench = Stopped(PRE_OPERATIONAL)
    bench.cycle()
    bench.ask()
    words = []
    for _ in range(100):
        frames = bench.answer(WRITTEN)[1]
        frames = [frame for frame in bench.answer(statusword(0x0237))[1] if frame[0] == 0x605]
        words += frames
    assert words[0] == QUICK_STOP_BY_SDO
    assert words[-1] == DISABLE_BY_SDO


def conversation(ms, position_of=lambda now_ms: position(0), state_of=lambda now_ms: 0x0217):
    """What a drive is asked by SDO that answers after 2 ms each time, in quick stop unless told; with the times."""
    bench, asked = Stopped(PRE_OPERATIONAL), []
    bench.cycle()
    frames = bench.ask()
    while bench.now_ns < ms * MS:
        frame = next((frame for frame in frames if frame[0] == 0x605), None)
        answer = WRITTEN
        if frame is not None:
            asked.append((bench.now_ns // MS, frame))
        if frame == READ_STATE:
            answer = statusword(state_of(bench.now_ns // MS))
        elif frame == READ_POSITION:
            answer = position_of(bench.now_ns // MS)
        bench.heartbeat(PRE_OPERATIONAL)
        frames = bench.answer(answer, after_ms=2)[1]
    return asked


def quick_stopping(position_of, ms):
    """The commands that are written until it is over, with their times."""
    asked = conversation(ms, lambda now_ms: position(round(position_of(now_ms))))
    return [(at, frame) for at, frame in asked if frame in (QUICK_STOP_BY_SDO, DISABLE_BY_SDO)]


@pytest.mark.parametrize("speed", [0.4, -0.4])  # counts/ms
def test_a_quick_stop_that_does_not_end_is_followed_by_disable(speed):
    commands = quick_stopping(lambda now_ms: speed * now_ms, 2200)
    words = [word for _, word in commands]
    assert words[0] == QUICK_STOP_BY_SDO
    assert words[-1] == DISABLE_BY_SDO
    assert all(at >= 1990 for at, word in commands if word == DISABLE_BY_SDO), "it is braking until then"


@pytest.mark.parametrize("speed", [0.4, -0.4])
def test_an_axis_that_brakes_in_either_direction_does_not_stand(speed):
    commands = quick_stopping(lambda now_ms: speed * min(now_ms, 400), 1000)
    assert 445 < next(at for at, word in commands if word == DISABLE_BY_SDO) < 470


@pytest.mark.parametrize("step", [1, -1])
def test_what_is_no_faster_than_standstill_is_disabled_soon(step):
    """Two counts in 50 ms are the noise of an encoder, three are motion."""
    commands = quick_stopping(lambda now_ms: 2 * step * (now_ms % 8 > 3), 200)
    assert [word for _, word in commands][:2] == [QUICK_STOP_BY_SDO, DISABLE_BY_SDO]
    assert 50 <= commands[1][0] <= 70
    faster = quick_stopping(lambda now_ms: 3 * step * (now_ms // 45), 1000)
    assert [word for _, word in faster] == [QUICK_STOP_BY_SDO]


def test_a_position_that_wraps_round_is_no_motion():
    commands = quick_stopping(lambda now_ms: -(2**31) if now_ms % 8 > 3 else 2**31 - 1, 200)
    assert 50 <= commands[1][0] <= 70


def test_where_the_position_is_refused_a_quick_stop_has_half_a_second():
    commands = conversation(600, lambda now_ms: bytes.fromhex("8064600000000206"))
    (at, _), *_ = [one for one in commands if one[1] == DISABLE_BY_SDO]
    assert 500 <= at <= 510


def test_a_drive_that_stops_after_its_fault_is_let_alone_until_it_has_done_so():
    asked = conversation(2100, state_of=lambda now_ms: 0x021F)
    words = [(at, word) for at, word in asked if word != READ_STATE]
    assert words[0][1] == QUICK_STOP_BY_SDO
    assert words[1][1] == DISABLE_BY_SDO
    assert 2000 <= words[1][0] <= 2010


def test_a_drive_that_does_not_obey_gets_the_quick_stop_for_a_tenth_of_a_second_only():
    asked = conversation(300, state_of=lambda now_ms: 0x0237)
    assert QUICK_STOP_BY_SDO in [word for at, word in asked if 90 <= at <= 100]
    assert {word for at, word in asked if at > 110} == {READ_STATE, DISABLE_BY_SDO}


def test_a_drive_without_power_is_asked_ten_times_a_second_whether_that_is_still_so():
    asked = conversation(1000, state_of=lambda now_ms: 0x0250 if now_ms < 800 else 0x0237)
    assert asked[0][1] == QUICK_STOP_BY_SDO
    reads = [at for at, word in asked if at < 800]
    assert all(100 <= after - before <= 104 for before, after in itertools.pairwise(reads[1:]))
    assert len(reads) == 9
    assert DISABLE_BY_SDO in [word for at, word in asked if at > 800], "it has power again"


def test_before_the_first_answer_nothing_is_proved():
    bench = Stopped(PRE_OPERATIONAL)
    bench.cycle()
    assert bench.ask() == [NMT_START, QUICK_STOP_BY_SDO]
    assert not bench.axis.is_proved_unpowered
    bench.answer(WRITTEN)
    bench.answer(statusword(0x0250))
    assert bench.axis.is_proved_unpowered
    bench.heartbeat(BOOT_UP)
    bench.cycle()
    assert bench.ask() == [QUICK_STOP_BY_SDO]
    assert not bench.axis.is_proved_unpowered, "nor by what it said before its restart"


def test_a_drive_that_stops_answering_is_not_called_unpowered_any_more():
    bench = Stopped(PRE_OPERATIONAL)
    bench.cycle()
    bench.ask()
    bench.answer(WRITTEN)
    assert bench.answer(statusword(0x0250))[0].state is DriveState.SWITCH_ON_DISABLED
    assert bench.axis.is_proved_unpowered
    for _ in range(300):
        bench.heartbeat(PRE_OPERATIONAL)
        feedback = bench.cycle()
        bench.ask()
    assert feedback.state is DriveState.UNKNOWN
    assert not bench.axis.is_proved_unpowered


def test_an_answer_to_another_request_is_not_taken():
    bench = Stopped(PRE_OPERATIONAL)
    bench.cycle()
    bench.ask()
    for stray in (statusword(0x0250), position(0), bytes.fromhex("8000100000000206"), b"", bytes(8)):
        feedback, frames = bench.answer(stray)
        assert (feedback.state, frames) == (DriveState.UNKNOWN, [])


def test_an_answer_in_segments_counts_as_none():
    """A statusword fits into one frame; what looks like the segment of one may belong to another client."""
    bench = Stopped(PRE_OPERATIONAL)
    bench.cycle()
    bench.ask()
    assert bench.answer(WRITTEN)[1] == [READ_STATE]
    for frame in ("4141600002000000", "0b50020000000000"):
        feedback, frames = bench.answer(bytes.fromhex(frame))
        assert (feedback.state, frames) == (DriveState.UNKNOWN, [])
    assert bench.answer(statusword(0x0250))[0].state is DriveState.SWITCH_ON_DISABLED


def test_a_drive_that_is_not_heard_any_more_is_stopped_by_sdo_too():
    """TPDOs do not come, RPDOs may get there: both ways are tried, and no word follows from the old state."""
    bench = Bench(Mode.CSV)
    bench.heard(mode=9)
    for _ in range(15):
        feedback = bench.cycle()
    assert (feedback.is_reachable, feedback.state) == (True, DriveState.OPERATION_ENABLED)
    assert bench.command(Request.DISABLE)[:4] == "0000"
    assert bench.command(Request.QUICK_STOP)[:4] == "0200"
    assert bench.axis.other_frames(Request.ENABLE, bench.now_ns) == []
    assert bench.axis.other_frames(Request.QUICK_STOP, bench.now_ns) == [QUICK_STOP_BY_SDO]
    assert not bench.cycle(after_ms=300).is_reachable


@pytest.mark.parametrize("is_restarted", [False, True])
def test_a_node_that_answers_no_sdo_is_started_unless_it_restarted(is_restarted):
    """A node without heartbeat does not say that another master has stopped it: then it has no SDO either."""
    bench = Bench(Mode.CSV)
    bench.heard(mode=9)
    if is_restarted:
        bench.axis.handlers[HEARTBEAT](BOOT_UP)
    sent, starts_ms = [], []
    for _ in range(350):
        bench.cycle()
        frames = bench.axis.other_frames(Request.QUICK_STOP, bench.now_ns)
        sent += frames
        starts_ms += [bench.now_ns // MS] * (NMT_START in frames)
    assert {after - before for before, after in itertools.pairwise(starts_ms)} <= {50}
    asked = [frame for frame in sent if frame != NMT_START]
    assert asked == [QUICK_STOP_BY_SDO] * len(asked)
    assert (NMT_START in sent) is not is_restarted
    if not is_restarted:
        assert sent.index(NMT_START) == 2, "after two requests without an answer"


def test_a_node_that_has_answered_is_started_only_after_two_more_requests_without_an_answer():
    bench, sent = Bench(Mode.CSV), []
    bench.heard(mode=9)
    for _ in range(200):
        bench.cycle()
        for frame in bench.axis.other_frames(Request.QUICK_STOP, bench.now_ns):
            sent.append(frame)
            if sent == [QUICK_STOP_BY_SDO]:
                bench.axis.handlers[0x585](WRITTEN)
    assert sent[:4] == [QUICK_STOP_BY_SDO, READ_STATE, QUICK_STOP_BY_SDO, NMT_START]


def test_the_error_code_of_a_fault_without_emergency_is_read():
    bench = Bench()
    bench.heard()
    assert bench.heard(state=0x0218).error == ""
    [(can_id, data)] = bench.axis.other_frames(Request.QUICK_STOP, bench.now_ns)
    assert (can_id, data.hex()) == (0x605, "403f600000000000")
    bench.axis.handlers[0x585](bytes.fromhex("4b3f600011860000"))
    assert bench.heard(state=0x0218).error == "8611h following error"
    assert not bench.axis.needs_other_frames


def test_an_error_code_that_is_not_answered_is_asked_for_five_times():
    bench, asked = Bench(), []
    bench.heard()
    for _ in range(400):
        bench.heard(state=0x0218)
        if bench.axis.needs_other_frames:
            asked += [
                (bench.now_ns // MS, *frame) for frame in bench.axis.other_frames(Request.QUICK_STOP, bench.now_ns)
            ]
    assert [data.hex() for _, _, data in asked] == ["403f600000000000"] * 5
    assert [after - before for (before, *_), (after, *_) in itertools.pairwise(asked)] == [50] * 4
    bench = Bench()
    bench.heard()
    for _ in range(220):
        bench.heard(state=0x0218)
        if bench.axis.needs_other_frames:
            bench.axis.other_frames(Request.QUICK_STOP, bench.now_ns)
    bench.axis.handlers[0x585](bytes.fromhex("4b3f600011860000"))
    assert bench.heard(state=0x0218).error == "8611h following error", "the fifth one is answered"


def test_the_stop_does_not_wait_for_another_answer_and_what_was_asked_for_it_does_not_end_it():
    """Nor is the answer to a request of the stop waited for once RPDOs reach the drive again."""
    bench = Bench(Mode.CSV)
    bench.axis.handlers[HEARTBEAT](OPERATIONAL)
    bench.heard(mode=9)
    bench.heard(state=0x0218, mode=9)
    [(_, data)] = bench.axis.other_frames(Request.QUICK_STOP, bench.now_ns)
    assert data.hex() == "403f600000000000"
    bench.axis.handlers[HEARTBEAT](PRE_OPERATIONAL)
    bench.cycle()
    assert bench.axis.other_frames(Request.QUICK_STOP, bench.now_ns)[-1] == QUICK_STOP_BY_SDO
    bench.axis.handlers[HEARTBEAT](OPERATIONAL)
    bench.heard(state=0x0218, mode=9)
    [(_, data)] = bench.axis.other_frames(Request.QUICK_STOP, bench.now_ns)
    assert data.hex() == "403f600000000000"


def test_a_glitch_of_half_the_counters_range_is_over_with_the_next_cycle():
    bench = Bench()
    for counts in (1000, 1010):
        bench.heard(counts=counts)
    assert abs(bench.heard(counts=1020 - (1 << 31)).position) > 1e6
    assert bench.heard(counts=1030).position == 1.03
    assert bench.heard(counts=1040).position == 1.04


# --- late feedback


def cycle_of(bench, tpdos, is_probe=False):
    bench.now_ns += MS
    bench.axis.begin_cycle(bench.now_ns, "a probe" if is_probe else "")
    for counts in tpdos:
        bench.axis.handlers[TPDO1](struct.pack("<Hih", 0x0637, counts, 0))
        bench.axis.handlers[TPDO2](struct.pack("<ib", 0, 8))
    feedback = Feedback()
    bench.axis.report(feedback, bench.now_ns)
    return feedback


def test_tpdos_that_come_late_are_found_by_a_cycle_without_sync():
    bench = Bench()
    cycle_of(bench, [1])
    for _ in range(5):
        cycle_of(bench, [])
    cycle_of(bench, [2])  # of five cycles ago
    assert bench.axis.answers.is_doubtful
    assert not bench.axis.answers.is_complete, "newer ones are waited for"
    assert not cycle_of(bench, [3], is_probe=True).is_fresh
    for counts in (4, 5):
        feedback = cycle_of(bench, [counts])
        assert not feedback.is_fresh
        assert feedback.missing == "the TPDOs of node 5 answer SYNC 4 cycles late [FH-235]"
    feedback = cycle_of(bench, [6, 7, 8, 9, 10])  # what was held up comes at once: the last one is that of this cycle
    assert feedback.is_fresh
    assert feedback.position == 0.010


def test_lost_tpdos_are_not_taken_for_late_ones():
    bench = Bench()
    cycle_of(bench, [1])
    for _ in range(3):
        cycle_of(bench, [])
    assert cycle_of(bench, [5]).is_fresh
    assert bench.axis.answers.is_doubtful
    assert not cycle_of(bench, [], is_probe=True).is_fresh
    assert cycle_of(bench, [7]).is_fresh
    assert bench.axis.answers.is_complete
    assert not bench.axis.answers.is_doubtful


def test_a_second_answer_to_the_same_sync_does_not_count():
    bench = Bench()
    assert cycle_of(bench, [1, 2]).position == 0.001


def test_tpdos_that_come_after_their_cycle_say_so():
    bench = Bench()
    cycle_of(bench, [1])
    cycle_of(bench, [])
    bench.axis.handlers[TPDO1](struct.pack("<Hih", 0x0637, 2, 0))
    bench.axis.handlers[TPDO2](struct.pack("<ib", 0, 8))
    feedback = cycle_of(bench, [])
    assert feedback.missing.endswith("too late in its cycle [FH-235]")


# --- health of the node, and what belongs to a SYNC


def test_an_empty_heartbeat_says_nothing():
    bench = Bench()
    bench.heard()
    bench.axis.handlers[HEARTBEAT](b"")
    assert bench.axis.state is DriveState.OPERATION_ENABLED
    bench.axis.handlers[HEARTBEAT](PRE_OPERATIONAL)  # nor does one before the first in Operational
    assert bench.axis.state is DriveState.OPERATION_ENABLED
    assert bench.heard().message == ""


def test_a_node_whose_heartbeat_is_lost_is_out_of_reach_with_its_first_missing_answer():
    bench = Bench(heartbeat_s=0.02)
    bench.axis.handlers[HEARTBEAT](OPERATIONAL)
    for _ in range(70):
        feedback = bench.heard()
    assert (feedback.is_reachable, "FH-230" in feedback.message) == (True, True)
    assert not bench.cycle().is_reachable


def test_what_comes_in_a_cycle_without_sync_answers_no_sync():
    bench = Bench()
    for _ in range(3):
        bench.heard()
    bench.now_ns += MS
    bench.axis.begin_cycle(bench.now_ns, "no SYNC was sent")
    for can_id, data in ((TPDO1, struct.pack("<Hih", 0x0637, 9, 0)), (TPDO2, bytes(5))):
        bench.axis.handlers[can_id](data)
    feedback = Feedback()
    bench.axis.report(feedback, bench.now_ns)
    assert (feedback.is_fresh, feedback.missing) == (False, "no SYNC was sent")


def test_a_tpdo_that_is_lost_after_another_was_is_not_said_to_come_late():
    bench = Bench()
    assert "too late" not in bench.cycle().missing
    bench.heard()
    tpdo1 = (TPDO1, struct.pack("<Hih", 0x0637, 0, 0))
    for _ in range(2):
        assert bench.cycle(tpdo1).missing == "TPDO 2 of node 5 did not arrive in time"


def test_a_late_tpdo_and_that_of_this_sync_complete_the_set():
    bench = Bench()
    bench.heard()
    tpdo1, tpdo2 = (TPDO1, struct.pack("<Hih", 0x0637, 7, 0)), (TPDO2, bytes(5))
    assert not bench.cycle(tpdo1).is_fresh
    bench.axis.begin_cycle(bench.now_ns + MS)
    for can_id, data in (tpdo1, tpdo2):
        bench.axis.handlers[can_id](data)
    assert not bench.axis.answers.is_complete
    bench.axis.handlers[TPDO2](tpdo2[1])
    assert bench.axis.answers.is_complete
