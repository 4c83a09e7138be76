"""Requests on a serial line that are sent before the reply to the last one, where the drive takes them in."""

import pytest
from friction_hil_drivers.serial_line.protocol import Image
from friction_hil_drivers.serial_line.scheduler import BusScheduler
from hypothesis import given
from hypothesis import strategies as st

from tests.serial_rig import Ahead, Ask, Bench, Push, Word


def test_requests_whose_replies_differ_go_out_together_and_are_answered_in_order():
    bench = Ahead()
    assert said(bench, bench.one, bench.three) == [b"a?abc?"]
    bench.line.arrived = b"a 1;ab"
    bench.scheduler.poll()
    assert (bench.image.fresh, bench.is_finished) == ({"a"}, False)
    bench.line.arrived = b"c 3;"
    bench.scheduler.poll()
    assert bench.image.values == {"a": 1.0, "abc": 3.0}
    assert bench.is_finished


def test_requests_whose_replies_look_alike_wait_for_each_other():
    bench = Ahead(a=b"a 1;", b=b"b 2;")
    assert said(bench, bench.one, bench.other) == [b"a?"]
    bench.scheduler.poll()
    assert bench.line.sent == [b"a?", b"b?"]


@pytest.mark.parametrize(("chars", "is_joint"), [(5, False), (len("a?abc?"), True)])
def test_as_much_is_sent_ahead_as_the_drive_takes_in(chars, is_joint):
    bench = Ahead(chars=chars)
    assert said(bench, bench.one, bench.three) == [b"a?abc?" if is_joint else b"a?"]


def test_what_the_drive_has_not_looked_at_yet_counts():
    bench = Ahead(chars=5)
    bench.image.values["t"] = 0.0
    assert said(bench, Push(bench.image, "t"), bench.one, Word(bench.image, "abc")) == [b"t=0;a?"]


def test_a_request_of_the_next_cycle_may_follow_one_that_is_not_answered_yet():
    bench = Ahead()
    bench.say(bench.three)
    bench.scheduler.flush()
    bench.say(bench.one)
    bench.scheduler.poll()
    assert bench.line.sent == [b"abc?", b"a?"]
    bench.line.arrived = b"abc 3;a 1;"
    bench.scheduler.poll()
    assert bench.image.values == {"a": 1.0, "abc": 3.0}


@given(st.integers(0, 3), st.integers(0, 3))
def test_of_requests_sent_together_no_late_reply_is_taken_for_a_present_one(first_cycle, second_cycle):
    """Some replies of each cycle come in time; the rest comes a cycle later, if it ever comes."""
    bench = Ahead()
    replies = [[b"a 1;", b"abc 1;"], [b"a 2;", b"abc 2;"]]
    seen = []
    for cycle, count in enumerate((first_cycle, second_cycle)):
        bench.image.fresh.clear()
        sent = len(bench.line.sent)
        bench.say(bench.one, bench.three)
        bench.go(1.0)
        if cycle:
            bench.line.arrived += b"".join(replies[0][min(first_cycle, 2) :])
            bench.go(1.0)
        if len(bench.line.sent) > sent:
            bench.line.arrived += b"".join(replies[cycle][:count])
        bench.go(3.0)
        bench.scheduler.end_cycle()
        seen += [(cycle, bench.image.values[name]) for name in bench.image.fresh]
    assert all(value == cycle + 1 for cycle, value in seen)
    assert len(seen) >= min(first_cycle, 2)


def test_after_a_broken_reply_the_other_ones_still_count():
    bench = Ahead()
    bench.say(bench.one, bench.three)
    bench.scheduler.poll()
    bench.line.arrived = b"xx 1;abc 3;"
    bench.scheduler.poll()
    assert bench.image.values == {"abc": 3.0}
    assert "xx in place of a" in bench.scheduler.last_error


@pytest.mark.parametrize("comes", ["before the next request", "before its reply"])
def test_a_refused_command_without_a_reply_counts_as_refused(comes):
    bench = Ahead()
    bench.image.values["torque"] = 0.1
    for count in range(1, 4):
        bench.image.fresh.clear()
        bench.say(Push(bench.image, "torque"))
        bench.scheduler.flush()
        if comes == "before the next request":
            bench.line.arrived += b"!;"
        bench.say(bench.one)
        bench.scheduler.poll()
        bench.line.arrived += (b"!;" if comes == "before its reply" else b"") + b"a 1;"
        bench.scheduler.poll()
        assert bench.image.fresh == {"a"}, "the reply proper is not lost"
        assert bench.scheduler.refusals.count == count
        assert bench.scheduler.last_error == "pushing torque: the drive refuses"
    bench.say(Push(bench.image, "torque"), bench.one)
    bench.scheduler.poll()
    bench.line.arrived += b"a 1;"
    bench.scheduler.poll()
    assert bench.scheduler.refusals.count == 0, "who answers what came after it has not refused it"
    bench = Ahead()
    bench.say(bench.one)
    bench.scheduler.poll()
    bench.line.arrived += b"!;"
    bench.scheduler.poll()
    assert bench.scheduler.refusals.count == 0, "nothing was commanded before"
    assert bench.scheduler.last_error == "reading a: the drive refuses"


def test_while_a_drive_owes_a_reply_what_has_to_wait_for_it_is_not_sent_later():
    bench = Ahead()
    bench.say(bench.one)
    bench.go(1.0)
    bench.scheduler.end_cycle()
    bench.image.values["torque"] = 0.1
    bench.say(Push(bench.image, "torque"), bench.three)
    bench.scheduler.flush()
    assert not bench.scheduler.queue
    assert bench.line.sent == [b"a?", b"torque=0.1;"]


def test_requests_are_said_at_once_only_where_no_silence_has_to_pass_between_them():
    silent, ahead = Bench(), Ahead()
    for bench, is_joint in ((silent, False), (ahead, True)):
        bench.image.values.update(torque=0.1, velocity=0.2)
        commands = [Push(bench.image, "torque"), Push(bench.image, "velocity")]
        assert said(bench, *commands) == [b"torque=0.1;velocity=0.2;" if is_joint else b"torque=0.1;"]
        assert bench.scheduler.sent == set(commands if is_joint else commands[:1])


def broken(bench, noisy_ms=0.0):
    """After a broken reply, and bytes that came for so long; then the line is quiet."""
    bench.image.values["t"] = 0.0
    bench.say(bench.one)
    bench.scheduler.poll()
    bench.line.arrived += b"xx 1;"
    for _ in range(round(10.0 * noisy_ms)):
        bench.scheduler.poll()
        bench.line.arrived += b"#"
        bench.time.pass_ms(0.1)
    bench.go(5.0)
    bench.line.sent.clear()
    return bench


def said(bench, *exchanges):
    """What is said at once, in whole writes."""
    bench.scheduler.enqueue(exchanges)
    bench.scheduler.poll()
    return bench.line.sent


def anonymous():
    """A line on which a reply does not show which of two drives it is from."""
    bench = Ahead()
    bench.scheduler = BusScheduler(
        bench.line, [bench.image, Image()], 0.0, 0.05, bench.time, ahead_chars=64, anonymous_reply_s=3e-3
    )
    return bench


def test_where_the_next_reply_may_be_an_old_one_each_request_is_said_alone():
    bench = broken(anonymous())
    assert said(bench, bench.one, bench.three) == [b"a?"]
    bench = broken(anonymous())
    assert said(bench, Push(bench.image, "t"), bench.one) == [b"t=0;", b"a?"]
    bench = broken(Ahead())
    assert said(bench, Push(bench.image, "t"), bench.one, bench.three) == [b"t=0;a?abc?"], "in step again"


def test_where_the_next_reply_may_be_an_old_one_the_next_request_waits_for_the_reply():
    bench = broken(anonymous())
    assert said(bench, bench.one) == [b"a?"]
    assert said(bench, bench.three) == [b"a?"]
    bench = broken(Ahead())
    assert said(bench, bench.one) == [b"a?"]
    assert said(bench, bench.three) == [b"a?", b"abc?"], "in step again"


def test_on_a_line_that_never_was_quiet_requests_go_together_but_not_behind_a_command():
    bench = broken(Ahead(), noisy_ms=200.0)
    assert said(bench, bench.one, bench.three) == [b"a?abc?"]
    bench = broken(Ahead(), noisy_ms=200.0)
    assert said(bench, Push(bench.image, "t"), bench.one) == [b"t=0;", b"a?"]


@pytest.mark.parametrize(("is_noisy", "is_command"), [(False, False), (False, True), (True, False), (True, True)])
def test_while_a_late_reply_is_coming_in_only_a_command_on_a_noisy_line_does_not_wait(is_noisy, is_command):
    bench = broken(Ahead(), noisy_ms=200.0 if is_noisy else 0.0)
    bench.say(bench.one)
    bench.go(5.0)
    bench.scheduler.end_cycle()
    bench.line.sent.clear()
    bench.line.arrived += b"a"
    bench.scheduler.poll()
    exchange = Push(bench.image, "t") if is_command else Ask(bench.image, "there", "second")
    assert said(bench, exchange) == [b"t=0;"] * (is_noisy and is_command)


def test_the_beginning_of_a_reply_stays_when_the_next_request_follows():
    bench = Ahead()
    bench.say(bench.three)
    bench.scheduler.poll()
    bench.line.arrived = b"ab"
    bench.say(bench.one)
    bench.scheduler.poll()
    assert bench.line.sent == [b"abc?", b"a?"]
    bench.line.arrived = b"c 3;a 1;"
    bench.scheduler.poll()
    assert bench.image.values == {"abc": 3.0, "a": 1.0}
