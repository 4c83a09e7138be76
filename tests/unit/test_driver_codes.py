"""Codes of the drivers' fault messages: each is raised somewhere, and a README explains each."""

import re
from pathlib import Path
from types import ModuleType

import pytest
from friction_hil_drivers.canopen import codes as canopen_codes
from friction_hil_drivers.serial_line import codes as serial_codes

from friction_hil.doctor.codes import CODES
from friction_hil.drive.codes import FaultCode, coded
from friction_hil.errors import DriveError

DRIVERS = Path(canopen_codes.__file__).parents[2]
CANOPEN = canopen_codes, {*range(200, 250), *range(264, 300)}, DRIVERS / "friction_hil_drivers/canopen/README.md"
SERIAL = serial_codes, set(range(250, 264)), DRIVERS / "README.md"
EACH_DRIVER = pytest.mark.parametrize(("codes", "numbers", "readme"), [CANOPEN, SERIAL], ids=["canopen", "serial"])


def names(codes: ModuleType) -> dict[str, str]:
    return {name: code for name, code in vars(codes).items() if name.isupper() and isinstance(code, str)}


@EACH_DRIVER
def test_every_code_is_in_the_range_of_its_driver_and_has_one_name(
    codes: ModuleType, numbers: set[int], readme: Path
) -> None:
    assert sorted(names(codes).values()) == sorted(set(names(codes).values())) == sorted(codes.TITLES)
    assert all(int(code.removeprefix("FH-")) in numbers for code in codes.TITLES)


@EACH_DRIVER
def test_every_code_is_used(codes: ModuleType, numbers: set[int], readme: Path) -> None:
    assert codes.__file__ is not None
    text = "".join(path.read_text() for path in Path(codes.__file__).parent.glob("*.py"))
    assert set(re.findall(r"codes\.([A-Z_0-9]+)", text)) - {"REMEDIES"} == set(names(codes))


@EACH_DRIVER
def test_the_readme_explains_every_code_in_order(codes: ModuleType, numbers: set[int], readme: Path) -> None:
    rows = re.findall(r"^\| (FH-\d+) \| .+ \| .+ \| (.+) \|$", readme.read_text(), re.MULTILINE)
    assert [code for code, _ in rows] == sorted(codes.TITLES)
    assert dict(rows) == codes.REMEDIES


def test_a_code_ends_a_message() -> None:
    assert coded("no heartbeat from node 5", canopen_codes.HEARTBEAT_LOST) == "no heartbeat from node 5 [FH-230]"
    assert str(DriveError("no reply", "check the wires", "FH-253")) == "no reply; check the wires [FH-253]"


def test_no_code_has_two_meanings() -> None:
    all_codes = [*map(str, FaultCode), *canopen_codes.TITLES, *serial_codes.TITLES, *CODES]
    assert len(all_codes) == len(set(all_codes))
