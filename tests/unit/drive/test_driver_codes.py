"""Codes of the drivers' fault messages: each is raised somewhere, and explained."""

import doctest
import re
from pathlib import Path
from types import ModuleType

import pytest
from friction_hil_drivers.canopen import codes as canopen_codes
from friction_hil_drivers.cia402 import codes as cia402_codes
from friction_hil_drivers.serial_line import codes as serial_codes

from friction_hil.drive import codes
from friction_hil.drive.codes import FaultCode, coded
from friction_hil.errors import DriveError

CANOPEN = canopen_codes, {*range(200, 250), *range(264, 300)}
CIA402 = cia402_codes, set(range(200, 250))
SERIAL = serial_codes, set(range(250, 264))
EACH = [CANOPEN, CIA402, SERIAL]
EACH_DRIVER = pytest.mark.parametrize(("codes", "numbers"), EACH, ids=["canopen", "cia402", "serial"])


def names(codes: ModuleType) -> dict[str, str]:
    return {name: code for name, code in vars(codes).items() if name.isupper() and isinstance(code, str)}


@EACH_DRIVER
def test_every_code_is_in_its_drivers_range_has_one_name_and_is_used(codes: ModuleType, numbers: set[int]) -> None:
    of_objects = set() if codes is cia402_codes else set(cia402_codes.EXPLANATIONS)
    own = set(codes.EXPLANATIONS) - of_objects
    assert sorted(names(codes).values()) == sorted(set(names(codes).values())) == sorted(own)
    assert all(int(code.removeprefix("FH-")) in numbers for code in codes.EXPLANATIONS)
    assert codes.__file__ is not None
    text = "".join(path.read_text() for path in Path(codes.__file__).parent.rglob("*.py"))
    assert set(re.findall(r"\bcodes\.([A-Z_0-9]+)", text)) - {"EXPLANATIONS", "REMEDIES"} == set(names(codes))


def test_a_code_ends_a_message() -> None:
    assert coded("no heartbeat from node 5", canopen_codes.HEARTBEAT_LOST) == "no heartbeat from node 5 [FH-230]"
    assert str(DriveError("no reply", "check the wires", "FH-253")) == "no reply; check the wires [FH-253]"


ROOT = Path(__file__).parents[3]


@pytest.mark.parametrize("code", FaultCode, ids=str)
def test_codes_lie_in_their_ranges_have_messages_of_their_own_and_are_used(code, sources):
    assert 101 <= code.number <= 199
    assert re.fullmatch(r"FH-\d{3}", str(code))
    assert [other.explanation.message for other in FaultCode].count(code.explanation.message) == 1
    assert f"FaultCode.{code.name}" in sources


@pytest.fixture(scope="module")
def sources():
    rooms = (ROOT / "friction_hil/daemon", ROOT / "drivers/friction_hil_drivers")
    return "".join(path.read_text() for room in rooms for path in room.rglob("*.py"))


def test_a_message_gets_one_code():
    once = FaultCode.LOOP_LATE.append_to("the loop was late")
    assert once == "the loop was late [FH-113]"
    assert FaultCode.EXCHANGE_FAILED.append_to(once) == once
    with_advice = "the bus does not open; ip link set can0 up [FH-201]"
    assert FaultCode.EXCHANGE_FAILED.append_to(with_advice) == with_advice
    assert FaultCode.LOOP_LATE.append_to("limits [-1, 1]") == "limits [-1, 1] [FH-113]"


def test_the_examples_of_the_module_hold():
    assert doctest.testmod(codes) == (0, 3)
