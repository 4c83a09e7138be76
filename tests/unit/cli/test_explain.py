"""`friction-hil explain`: every code of the daemon, of doctor and of the drivers has message, cause and remedy."""

import json
import re
from pathlib import Path

import pytest
from friction_hil_drivers.canopen import codes as canopen_codes
from friction_hil_drivers.serial_line import codes as serial_codes

from friction_hil.cli import main
from friction_hil.doctor.codes import CODES
from friction_hil.doctor.explanations import explanations
from friction_hil.drive.codes import FaultCode

ROOT = Path(__file__).parents[3]


def test_no_code_has_two_meanings_none_is_left_out_and_every_cell_says_something():
    codes = [*map(str, FaultCode), *canopen_codes.EXPLANATIONS, *serial_codes.EXPLANATIONS, *CODES]
    assert sorted(codes) == list(explanations())
    assert [code for code, each in explanations().items() if not all(text.strip(" .") for text in each)] == []


def test_every_code_that_sources_and_pages_name_is_explained():
    known = set(explanations())
    for folder in ("friction_hil", "drivers", "tools", "config"):
        for path in (ROOT / folder).rglob("*"):
            if path.suffix in {".py", ".md", ".yaml", ".js"}:
                assert set(re.findall(r"\bFH-\d{3}\b", path.read_text())) <= known, path


@pytest.mark.parametrize("code", ["FH-113", "fh-113", "113"])
def test_a_code_is_explained(code, capsys):
    assert main(["explain", code]) == 0
    shown = capsys.readouterr().out
    assert shown.splitlines() == [f"{name}: {text}" for name, text in explanations()["FH-113"]._asdict().items()]


def test_all_codes_are_listed_for_people_and_for_programs_and_where_there_is_none(capsys):
    assert main(["explain"]) == 0
    assert re.findall(r"^FH-\d{3}", capsys.readouterr().out, re.MULTILINE) == list(explanations())
    assert main(["explain", "--json"]) == 0
    assert json.loads(capsys.readouterr().out).keys() == explanations().keys()
    assert main(["explain", "FH-999"]) == 2
    assert "'friction-hil explain'" in capsys.readouterr().err
