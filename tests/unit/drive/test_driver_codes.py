"""Codes of the drivers' fault messages: each is raised somewhere, and explained."""

import re
from pathlib import Path
from types import ModuleType

import pytest
from friction_hil_drivers.canopen import codes as canopen_codes
from friction_hil_drivers.cia402 import codes as cia402_codes
from friction_hil_drivers.serial_line import codes as serial_codes

from friction_hil.drive.codes import coded
from friction_hil.errors import DriveError

CANOPEN = canopen_codes, {*range(200, 250), *range(264, 300)}
CIA402 = cia402_codes, set(range(200, 250))
SERIAL = serial_codes, set(range(250, 264))
EACH_DRIVER = pytest.mark.parametrize(
    ("codes", "numbers"), [CANOPEN, CIA402, SERIAL], ids=["canopen", "cia402", "serial"]
)


def names(codes: ModuleType) -> dict[str, str]:
    return {name: code for name, code in vars(codes).items() if name.isupper() and isinstance(code, str)}


@EACH_DRIVER
def test_every_code_is_in_the_range_of_its_driver_and_has_one_name(codes: ModuleType, numbers: set[int]) -> None:
    of_objects = set() if codes is cia402_codes else set(cia402_codes.EXPLANATIONS)
    own = set(codes.EXPLANATIONS) - of_objects
    assert sorted(names(codes).values()) == sorted(set(names(codes).values())) == sorted(own)
    assert all(int(code.removeprefix("FH-")) in numbers for code in codes.EXPLANATIONS)


@EACH_DRIVER
def test_every_code_is_used(codes: ModuleType, numbers: set[int]) -> None:
    assert codes.__file__ is not None
    text = "".join(path.read_text() for path in Path(codes.__file__).parent.rglob("*.py"))
    assert set(re.findall(r"\bcodes\.([A-Z_0-9]+)", text)) - {"EXPLANATIONS", "REMEDIES"} == set(names(codes))


def test_a_code_ends_a_message() -> None:
    assert coded("no heartbeat from node 5", canopen_codes.HEARTBEAT_LOST) == "no heartbeat from node 5 [FH-230]"
    assert str(DriveError("no reply", "check the wires", "FH-253")) == "no reply; check the wires [FH-253]"
