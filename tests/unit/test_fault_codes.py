"""Codes of faults: unique, explained on a page, and no message has one that is not in the table."""

import re
from pathlib import Path

import pytest

from friction_hil.drive import codes
from friction_hil.drive.codes import FaultCode

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "friction_hil/daemon/README.md"
SOURCES = [*(ROOT / "friction_hil").rglob("*.py"), *(ROOT / "drivers").rglob("*.py")]


def explained():
    """Code, message, cause and remedy of each row of the tables on the page."""
    rows = re.findall(r"^\| (FH-\d{3}) \| (.+?) \| (.+?) \| (.+?) \|$", PAGE.read_text(), re.MULTILINE)
    return {code: cells for code, *cells in rows}


def test_every_code_is_explained_on_the_page_and_nothing_else_is():
    assert set(explained()) == {str(code) for code in FaultCode}
    assert all(len(cell) > 3 for cells in explained().values() for cell in cells)
    assert {str(code): code.remedy for code in FaultCode} == {code: cells[-1] for code, cells in explained().items()}


@pytest.mark.parametrize("code", FaultCode, ids=str)
def test_codes_lie_in_their_ranges_and_have_titles_of_their_own(code):
    assert 101 <= code.number <= 199
    assert re.fullmatch(r"FH-\d{3}", str(code))
    assert [other.title for other in FaultCode].count(code.title) == 1


def test_every_code_in_the_sources_stands_on_a_page_and_those_of_the_daemon_in_the_table():
    pages = "".join(
        path.read_text() for folder in ("friction_hil", "drivers") for path in (ROOT / folder).rglob("*.md")
    )
    known = {str(code) for code in FaultCode}
    for path in SOURCES:
        used = set(re.findall(r"FH-\d{3}", path.read_text()))
        assert {code for code in used if code < "FH-200"} <= known, path
        assert used - known <= set(re.findall(r"FH-\d{3}", pages)), path


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
