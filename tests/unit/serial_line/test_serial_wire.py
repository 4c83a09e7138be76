"""Time on a serial line: the arithmetic by which a configuration is accepted or refused."""

import pytest
from friction_hil_drivers.serial_line.options import LineOptions
from friction_hil_drivers.serial_line.protocol import Image, Plan
from friction_hil_drivers.serial_line.wire import character_s, check_rate, wire_s

from friction_hil.errors import UsageError
from tests.serial_rig import Ask, Push, Word

LINE = LineOptions.model_validate({"port": "/dev/bench", "baud": 10_000, "turnaround_s": 2e-3})  # 1 ms a character
IMAGE = Image()
ASK, PUSH = Ask(IMAGE, "abc"), Push(IMAGE, "torque")  # 4 + 8 characters, 12
SHORT, LONG = Word(IMAGE, "a"), Word(IMAGE, "abc")  # 2 + 8, 4 + 8


def ms(*exchanges, silence=0.0, ahead=0):
    return pytest.approx(1e3 * wire_s(exchanges, LINE, silence, ahead))


def test_an_exchange_takes_its_characters_its_silences_and_the_turn_around():
    assert ms(ASK) == 4 + 2 + 8
    assert ms(ASK, silence=3.5) == 4 + 3.5 + 2 + 8 + 3.5
    assert ms(PUSH, silence=3.5) == 12 + 3.5
    assert ms(PUSH, ASK, ASK, silence=3.5) == 15.5 + 21 + 21


def test_on_a_tcp_connection_only_the_turn_around_is_known():
    """By its baud rate there would be no time left in a short period to hear what changes slowly."""
    connection = LINE.model_copy(update={"port": "tcp://127.0.0.1:502"})
    assert character_s(connection) == 0.0
    assert wire_s((PUSH, ASK), connection, 0.0) == 2e-3


def test_requests_that_go_out_together_overlap_with_replies():
    # the second request is out at 6 ms, while the reply to the first one comes in from 4 to 12 ms
    assert ms(SHORT, LONG, ahead=6) == 2 + 2 + 8 + 8
    assert ms(SHORT, LONG, ahead=5) == (2 + 2 + 8) + (4 + 2 + 8)
    assert ms(PUSH, SHORT, LONG, ahead=17) == 12 + (2 + 2 + 8) + (4 + 2 + 8), "the drive may still have the first 12"
    assert ms(PUSH, SHORT, LONG, ahead=18) == 12 + 2 + 2 + 8 + 8
    assert ms(SHORT, SHORT, ahead=64) == 2 * (2 + 2 + 8), "their replies look alike"


def test_a_period_that_is_too_short_is_refused_with_the_arithmetic():
    plan = Plan((SHORT,), (LONG,), (PUSH,))
    assert check_rate(plan, None, LINE, 0.0, 64, 0.0341) == "a cycle takes 34 ms of 34.1 ms on /dev/bench"
    with pytest.raises(UsageError, match="a cycle takes 34 ms, so 29 Hz at best") as error:
        check_rate(plan, None, LINE, 0.0, 64, 0.0339)
    assert "reading abc: 4 + 8 characters, 14 ms" in str(error.value)
    assert "overlap" in str(error.value)
    with pytest.raises(UsageError, match="a cycle takes 38 ms") as error:
        check_rate(plan, None, LINE, 0.0, 0, 0.0339)
    assert "overlap" not in str(error.value)
