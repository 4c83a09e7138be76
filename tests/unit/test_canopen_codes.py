"""Codes of fault messages: each is raised somewhere, and README.md explains each."""

import re
from pathlib import Path

from friction_hil_drivers.canopen import codes

FOLDER = Path(codes.__file__).parent
NAMES = {name: code for name, code in vars(codes).items() if name.isupper() and isinstance(code, str)}


def test_every_code_is_in_the_range_of_this_driver_and_has_one_name() -> None:
    assert sorted(NAMES.values()) == sorted(set(NAMES.values())) == sorted(codes.TITLES)
    assert all(200 <= int(code.removeprefix("FH-")) < 250 for code in codes.TITLES)


def test_every_code_is_used() -> None:
    text = "".join(path.read_text() for path in FOLDER.glob("*.py"))
    assert set(re.findall(r"codes\.([A-Z_]+)", text)) == set(NAMES)


def test_the_readme_explains_every_code_in_order() -> None:
    rows = re.findall(r"^\| (FH-\d+) \| .+ \| .+ \| .+ \|$", (FOLDER / "README.md").read_text(), re.MULTILINE)
    assert rows == sorted(codes.TITLES)


def test_a_code_ends_a_message() -> None:
    assert codes.coded("no heartbeat from node 5", codes.HEARTBEAT_LOST) == "no heartbeat from node 5 [FH-230]"
