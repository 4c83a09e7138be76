"""Codes of faults: unique, and each is used."""

import re
from pathlib import Path

import pytest

from friction_hil.drive import codes
from friction_hil.drive.codes import FaultCode

ROOT = Path(__file__).parents[3]


@pytest.mark.parametrize("code", FaultCode, ids=str)
def test_codes_lie_in_their_ranges_and_have_messages_of_their_own(code):
    assert 101 <= code.number <= 199
    assert re.fullmatch(r"FH-\d{3}", str(code))
    assert [other.explanation.message for other in FaultCode].count(code.explanation.message) == 1


def test_every_code_is_used():
    rooms = (ROOT / "friction_hil/daemon", ROOT / "drivers/friction_hil_drivers")
    text = "".join(path.read_text() for room in rooms for path in room.rglob("*.py"))
    for code in FaultCode:
        assert f"FaultCode.{code.name}" in text


def test_a_message_gets_one_code():
    once = FaultCode.LOOP_LATE.append_to("the loop was late")
    assert once == "the loop was late [FH-113]"
    assert FaultCode.EXCHANGE_FAILED.append_to(once) == once
    with_advice = "the bus does not open; ip link set can0 up [FH-201]"
    assert FaultCode.EXCHANGE_FAILED.append_to(with_advice) == with_advice
    assert FaultCode.LOOP_LATE.append_to("limits [-1, 1]") == "limits [-1, 1] [FH-113]"


def test_the_examples_of_the_module_hold():
    import doctest

    assert doctest.testmod(codes).attempted == 3
    assert doctest.testmod(codes).failed == 0
