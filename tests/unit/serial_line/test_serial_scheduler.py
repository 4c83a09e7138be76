"""Scheduler of a serial line: requests one after the other, and no reply taken for that of another request."""

import pytest
from friction_hil_drivers.modbus.framing import RtuFraming
from friction_hil_drivers.serial_line.protocol import Image
from friction_hil_drivers.serial_line.scheduler import BusScheduler
from hypothesis import given
from hypothesis import strategies as st
from pymodbus.framer import FramerRTU

from tests.serial_rig import CHARACTER_MS, MS, REPLY_LIMIT_MS, SILENCE_CHARS, SILENCE_MS, Ask, Bench, Push, Tell


def test_requests_go_one_after_the_other_with_silence_between():
    bench = Bench(**{"position?": b"12;", "velocity?": b"-3;"})
    bench.ask("position")
    bench.ask("velocity")
    bench.scheduler.poll()
    bench.scheduler.poll()
    assert bench.line.sent == [b"position?"]
    bench.time.pass_ms(SILENCE_MS - 0.01)
    bench.scheduler.poll()
    assert bench.line.sent == [b"position?"]
    assert bench.scheduler.due_ns == bench.time.ns + 10_000
    bench.time.pass_ms(0.01)
    bench.scheduler.poll()
    assert bench.line.sent == [b"position?", b"velocity?"]
    bench.scheduler.poll()
    assert bench.is_finished
    assert bench.image.values == {"position": 12.0, "velocity": -3.0}
    assert bench.image.fresh == {"position", "velocity"}


def test_a_command_without_a_reply_takes_its_time_on_the_wire():
    bench = Bench(**{"position?": b"12;"})
    bench.image.values["torque_command"] = 0.25
    bench.say(Tell(bench.image, "torque_command"), Ask(bench.image, "position"))
    bench.scheduler.poll()
    sent_ms = len(b"torque_command=0.25;") * CHARACTER_MS
    bench.time.pass_ms(sent_ms + SILENCE_MS - 0.01)
    bench.scheduler.poll()
    assert bench.line.sent == [b"torque_command=0.25;"]
    bench.time.pass_ms(0.01)
    bench.scheduler.poll()
    assert bench.line.sent[1:] == [b"position?"]


def test_a_reply_in_pieces_is_put_together():
    bench = Bench()
    bench.ask()
    for piece in (b"1", b"2", b".", b"5", b";"):
        bench.go(0.3)
        assert "position" not in bench.image.fresh
        bench.line.arrived += piece
    bench.go(0.3)
    assert bench.image.values["position"] == 12.5


def test_a_late_reply_is_never_taken_for_the_present_one():
    bench = Bench()
    assert bench.cycle() is None  # nobody answers
    bench.image.fresh.clear()
    bench.ask()
    bench.go(1.0)
    assert bench.line.sent == [b"position?"], "nothing is sent while the reply before may still come"
    bench.line.arrived += b"1;"  # of the first cycle
    bench.answers["position?"] = b"2;"
    bench.scheduler.poll()
    assert not bench.image.fresh, "it does not even look fresh"
    bench.go(5.0)
    bench.scheduler.end_cycle()
    assert bench.line.sent == [b"position?"] * 2
    assert bench.image.values["position"] == 2.0


def test_a_silent_drive_does_not_keep_others_from_being_asked_and_commanded():
    bench = Bench(**{"there?": b"2;"})
    bench.image.values["torque_command"] = 0.0
    silent, there = Ask(bench.image, "silent", "first"), Ask(bench.image, "there", "second")
    asked = 0
    for _ in range(30):
        bench.image.fresh.clear()
        bench.say(silent, there, Tell(bench.image, "torque_command"))
        bench.go(5.0)
        bench.scheduler.end_cycle()
        asked += "there" in bench.image.fresh
    # only where the silent one is asked again, each time its reply cannot come any more, the others have to wait
    lost = 30 * 5.0 / (REPLY_LIMIT_MS + 5.0)
    assert asked >= 30 - lost - 1.5
    assert bench.line.sent.count(b"torque_command=0;") == asked
    assert bench.line.sent.count(b"silent?") == pytest.approx(lost, abs=1.5)


@pytest.mark.parametrize("reply_limit_ms", [0.0, 2.0])
def test_whoever_was_silent_is_asked_after_the_others(reply_limit_ms):
    """Where its reply cannot come any more in the next cycle, it would keep them from being asked in each one."""
    bench = Bench(reply_limit_ms=reply_limit_ms, **{"there?": b"2;"})
    silent, there = Ask(bench.image, "silent", "first"), Ask(bench.image, "there", "second")
    asked = 0
    for _ in range(20):
        bench.image.fresh.clear()
        bench.say(silent, there)
        bench.go(5.0)
        bench.scheduler.end_cycle()
        asked += "there" in bench.image.fresh
    assert asked == 19


def test_what_was_asked_before_the_line_went_away_is_still_known_for_late():
    bench = Bench()
    bench.ask()
    bench.go(1.0)
    bench.line.pull_out()
    bench.go(1.0)
    bench.line.is_back = True
    while not bench.line.is_open:
        bench.go(1.0)
    bench.line.arrived = b"1;"  # a converter in between has kept it
    bench.ask()
    bench.go(5.0)
    assert "position" not in bench.image.fresh or bench.image.values["position"] != 1.0


def test_a_late_reply_that_comes_in_pieces_is_waited_for_without_spinning():
    bench = Bench(**{"there?": b"2;"})
    bench.miss("silent", "first")
    bench.line.arrived += b"9"
    bench.ask("there", "second")
    bench.scheduler.poll()
    assert bench.scheduler.due_ns > bench.time.ns


def test_who_owes_a_reply_goes_on_owing_it_when_another_one_speaks():
    bench = Bench()
    bench.miss("first", "first")
    bench.miss("second", "second")
    bench.line.arrived += b"of the second one;"  # no reply to the first request
    bench.go(5.0)
    bench.ask("first", "first")
    bench.go(5.0)
    assert bench.line.sent == [b"first?", b"second?"]


def test_a_late_reply_does_not_touch_what_is_fresh_of_another_drive():
    bench = Bench(**{"there?": b"2;"})
    bench.miss("silent", "first")
    bench.image.fresh.clear()
    bench.ask("there", "second")
    bench.go(1.0)
    bench.line.arrived += b"9;"
    bench.go(1.0)
    assert bench.image.fresh == {"there"}
    assert "silent" not in bench.image.values


@pytest.mark.parametrize("limit_ms", [REPLY_LIMIT_MS, 0.0])  # 0: replies are numbered, and a late one is known for one
def test_a_reply_that_never_comes_is_waited_for_no_longer_than_its_limit(limit_ms):
    bench = Bench(reply_limit_ms=limit_ms)
    assert bench.cycle() is None
    bench.answers["position?"] = b"7;"
    cycles = 0
    while bench.cycle() is None:
        assert "no reply in time" in bench.scheduler.last_error
        cycles += 1
    assert cycles == pytest.approx(limit_ms / 5.0, abs=1.5 if limit_ms else 0.0)


@pytest.mark.parametrize("turnaround_s", [0.0, 2e-3])
def test_what_could_not_be_answered_in_this_cycle_is_not_asked(turnaround_s):
    """Else its reply came late, the next cycle began with waiting for it, and so did all after that."""
    bench = Bench(**{"position?": b"12;"})
    bench.line.options = bench.line.options.model_copy(update={"turnaround_s": turnaround_s})
    bench.scheduler = BusScheduler(bench.line, [bench.image], SILENCE_CHARS, 0.05, bench.time)
    needed_ms = (len("position?") + 8 + SILENCE_CHARS) * CHARACTER_MS + 1e3 * turnaround_s
    bench.scheduler.deadline_ns = bench.time.ns + round((needed_ms - 0.01) * MS)
    bench.ask()
    bench.scheduler.poll()
    assert bench.line.sent == []
    assert bench.is_finished
    assert "no time was left" in bench.scheduler.last_error
    bench.scheduler.end_cycle()
    bench.scheduler.deadline_ns = bench.time.ns + round((needed_ms + 0.01) * MS)
    bench.ask()
    bench.go(0.3)
    assert bench.image.values["position"] == 12.0


@given(st.binary(max_size=30))
def test_noise_before_a_request_is_dropped_and_told(noise):
    bench = Bench(**{"position?": b"12;"})
    bench.line.arrived = noise
    assert bench.cycle() == 12.0
    assert bench.scheduler.last_error.startswith("not asked for") == bool(noise)


def test_a_reply_that_comes_after_its_limit_is_told_with_its_request_and_its_times():
    framing = RtuFraming()
    bench = Bench(show=framing.show)
    assert bench.cycle() is None
    bench.go(REPLY_LIMIT_MS)
    late = bytes.fromhex("01 17 02 00 07")
    late += FramerRTU.compute_CRC(late).to_bytes(2, "big")
    bench.line.arrived = late
    bench.answers["position?"] = b"12;"
    assert bench.cycle() == 12.0
    for part in (f"{late.hex(' ')} (unit 1, function 23)", " 55 ms ", "(reading position)", " 50 ms", "reply_limit_s"):
        assert part in bench.scheduler.last_error


def test_a_broken_reply_is_told_with_its_bytes_and_then_the_line_must_fall_silent():
    bench = Bench(**{"position?": b"12"})
    assert bench.cycle() is None
    assert bench.scheduler.last_error == "reading position: no whole reply in time, only '12'"
    bench = Bench(**{"position?": b"1x;9;"})  # the rest of it looks like a reply
    assert bench.cycle() is None
    assert "b'1x'" in bench.scheduler.last_error
    bench.answers["position?"] = b"12;"
    assert bench.cycle() == 12.0


@pytest.mark.parametrize("noise", [b"\xf7#;", b";"])
def test_on_a_line_that_never_falls_silent_everything_is_said_all_the_same(noise):
    """Among it that drives are to be disabled; and in every cycle what needs no reply."""
    bench = Bench()
    bench.image.values.update(torque_command=0.25)

    def pass_noisily(ms):
        for _ in range(round(10 * ms)):
            bench.line.arrived += noise
            bench.scheduler.poll()
            bench.time.pass_ms(0.1)

    for _ in range(20):
        bench.ask()
        pass_noisily(4.0)
        bench.scheduler.end_cycle()
        bench.say(Tell(bench.image, "torque_command"))
        bench.scheduler.flush()
        pass_noisily(6.0)
        bench.scheduler.end_cycle()
    assert bench.line.sent[-10:].count(b"torque_command=0.25;") >= 5
    pass_noisily(100.0)
    bench.say(Tell(bench.image, "torque_command", is_answered=True))
    said = len(bench.line.sent)
    pass_noisily(40.0)
    assert bench.line.sent[said:] == [b"torque_command=0.25;"]


def test_a_refusal_is_complete_and_the_next_request_follows_at_once():
    bench = Bench(**{"position?": b"!;", "velocity?": b"3;"})
    bench.ask("position")
    bench.ask("velocity")
    bench.go(1.0)
    assert bench.image.values == {"velocity": 3.0}
    assert "the drive refuses" in bench.scheduler.last_error


def test_the_reason_of_a_silence_is_not_that_there_is_no_time_to_ask_again():
    bench = Bench()
    bench.cycle()
    told = bench.scheduler.last_error
    assert "no reply in time" in told
    bench.go(REPLY_LIMIT_MS)  # nobody waits for that reply any more
    bench.scheduler.deadline_ns = bench.time.ns
    bench.ask()
    bench.scheduler.poll()
    assert bench.scheduler.last_error == told


def test_refused_commands_are_counted_until_they_are_taken():
    """Also where another one is taken, as a position beside an offset: nothing would be compensated."""
    bench = Bench(**{"position=1;": b";", "torque=1;": b"!;"})
    bench.image.values.update(position=1.0, velocity=1.0, torque=1.0)
    tells = [Tell(bench.image, name, is_answered=True) for name in ("position", "torque")]
    for count in range(1, 4):
        bench.say(Push(bench.image, "velocity"), *tells)
        bench.go(5.0)
        assert bench.scheduler.refusals.count == count
    bench.answers["torque=1;"] = b";"
    bench.say(*tells)
    bench.go(5.0)
    assert bench.scheduler.refusals.count == 0


def test_done_is_called_for_an_answer_in_time_and_for_no_other():
    calls = []
    bench = Bench()
    bench.ask(done=lambda: calls.append("first"))
    bench.go(5.0)
    bench.scheduler.end_cycle()
    bench.line.arrived += b"1;"
    bench.go(1.0)
    assert calls == []
    bench.answers["position?"] = b"2;"
    bench.ask(done=lambda: calls.append("second"))
    bench.go(5.0)
    assert calls == ["second"]


def test_a_line_that_is_gone_is_said_and_used_again_when_it_is_back():
    bench = Bench(**{"position?": b"12;"})
    bench.line.descriptor = 0  # as of a daemon that was started without standard input
    assert bench.cycle() == 12.0
    bench.line.pull_out()
    for _ in range(5):
        assert bench.cycle() is None
        assert bench.is_finished, "nobody waits for a line that is gone"
    assert "gone" in bench.scheduler.last_error
    asked = len(bench.line.sent)
    bench.line.is_back = True
    for _ in range(100):
        if bench.cycle() is not None:
            break
    assert bench.image.fresh == {"position"}
    assert len(bench.line.sent) == asked + 1, "what was to be asked meanwhile is not asked later"


def test_a_command_that_waited_when_the_line_went_away_is_not_sent_when_it_is_back():
    """Whoever opens the line again, as the end of a run does, must not move the axis by what was wanted before."""
    bench = Bench(**{"position?": b"12;"})
    assert bench.cycle() == 12.0
    bench.go(SILENCE_MS)
    bench.line.pull_out()
    bench.line.write = bench.line.read  # a line may be lost while it is written to
    bench.line.read = lambda **_: b""
    bench.ask("position")
    bench.ask("velocity")
    bench.scheduler.poll()
    assert not bench.line.is_open
    del bench.line.write
    bench.line.is_back = True
    assert bench.line.reopen()
    sent = len(bench.line.sent)
    bench.go(200.0)
    assert bench.line.sent[sent:] == []
    assert bench.is_finished


def test_a_line_that_is_gone_is_looked_for_five_times_a_second():
    bench, tried = Bench(), []
    bench.line.reopen = lambda: bool(tried.append(bench.time.ns))
    bench.ask()
    bench.line.pull_out()
    gone_ns = bench.time.ns
    bench.go(1100.0, each=1.0)
    assert [(each - gone_ns) // MS for each in tried] == [200, 400, 600, 800, 1000]


def test_what_is_still_on_its_way_takes_its_time_before_the_deadline():
    bench = Bench()
    bench.scheduler = BusScheduler(bench.line, [bench.image], 0.0, 0.05, bench.time)
    bench.image.values["torque_command"] = 0.25
    said, asked = len("torque_command=0.25;"), len("position?") + 8
    tell, ask = Tell(bench.image, "torque_command"), Ask(bench.image, "position")
    for left_ms, is_asked in ((-0.01, False), (0.01, True)):
        sent = len(bench.line.sent)
        bench.scheduler.deadline_ns = bench.time.ns + round(((2 * said + asked) * CHARACTER_MS + left_ms) * MS)
        for exchange in (tell, tell, ask):
            bench.say(exchange)
            bench.scheduler.poll()
        assert (b"position?" in bench.line.sent[sent:]) is is_asked
        bench.scheduler.end_cycle()
        bench.go(10.0)


class Both(Ask):
    """A request to two drives at once, of which one may be left out."""

    def __init__(self, image):
        super().__init__(image, "both")
        self.addressees = self.unanswered = frozenset(("first", "second"))
        self.second = Ask(image, "second", "second")

    def without(self, addressees):
        return self.second if addressees == {"first"} else None


def test_a_request_to_several_drives_is_made_to_those_that_owe_nothing_and_done_is_called_for_it():
    calls = []
    bench = Bench(**{"second?": b"2;", "third?": b"3;"})
    bench.miss("first", "first")
    bench.say(Both(bench.image), done=lambda: calls.append("both"))
    bench.say(Both(bench.image), Ask(bench.image, "third", "third"), done=lambda: calls.append("third"))
    bench.go(5.0)
    assert bench.line.sent == [b"first?", b"second?", b"second?", b"third?"]
    assert calls == ["both", "third"]
    assert bench.image.values == {"second": 2.0, "third": 3.0}


def test_the_moment_at_which_there_is_something_to_do_is_known_where_nothing_needs_to_arrive_first():
    bench = Bench(**{"position?": b"12;"})
    bench.line.descriptor = 0
    bench.say(Ask(bench.image, "position"), Ask(bench.image, "velocity"), Ask(bench.image, "torque"))
    bench.scheduler.poll()
    assert bench.scheduler.due_ns is None, "a reply is awaited"
    bench.scheduler.poll()
    assert bench.scheduler.due_ns == bench.time.ns + round(SILENCE_MS * MS)
    bench.line.close()
    assert bench.scheduler.due_ns is None


def test_where_replies_have_no_name_the_next_one_after_a_broken_one_is_dropped_and_those_that_may_follow():
    bench = Bench(**{"position?": b"1x;"})
    bench.scheduler = BusScheduler(bench.line, [bench.image, Image()], 0.0, 0.05, bench.time, anonymous_reply_s=5e-3)
    bench.ask()
    bench.go(4.0)
    bench.answers["position?"] = b"12;"
    bench.ask()
    bench.scheduler.poll()
    bench.scheduler.poll()
    assert bench.line.sent == [b"position?"] * 2
    assert not bench.image.fresh
    assert bench.scheduler.due_ns == bench.time.ns + 5 * MS, "for as long as a reply takes"
    bench.ask()
    bench.go(4.9)
    assert len(bench.line.sent) == 2
    bench.go(0.4)
    assert len(bench.line.sent) == 3
    assert bench.image.values == {"position": 12.0}
