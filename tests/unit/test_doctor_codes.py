"""The codes of findings: each one used stands on the page that explains it, and each on the page is used."""

import re
from pathlib import Path

from friction_hil.doctor import codes
from friction_hil.drive.finding import Finding, complaints

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "friction_hil/doctor/README.md"
SOURCES = [
    path
    for folder in (ROOT / "friction_hil", ROOT / "drivers")
    for path in folder.rglob("*.py")
    if path != Path(codes.__file__)
]
IN_CODE = re.compile(r'"(FH-[34]\d\d)"')
ROW = re.compile(r"^\| (FH-\d+) \| (.+?) \| (.+?) \| (.+) \|$", re.MULTILINE)


def used():
    return {code for path in SOURCES for code in IN_CODE.findall(path.read_text(encoding="utf-8"))}


def test_the_codes_in_use_the_table_and_the_page_are_the_same():
    rows = [row[0] for row in ROW.findall(PAGE.read_text(encoding="utf-8"))]
    assert rows == sorted(rows)
    assert len(rows) == len(set(rows))
    assert set(rows) == set(codes.CODES) == used()


def test_no_two_codes_have_the_same_title():
    assert len(set(codes.CODES.values())) == len(codes.CODES)


def test_a_row_of_the_page_has_message_cause_and_remedy():
    rows = ROW.findall(PAGE.read_text(encoding="utf-8"))
    assert all(text.strip(" .") for row in rows for text in row)


def test_the_code_ends_the_message():
    finding = Finding("memory", "warn", "memory is not locked", "raise memlock", "FH-310")
    assert list(complaints([finding, Finding("kernel", "pass", "PREEMPT_RT")])) == [
        "memory is not locked; raise memlock [FH-310]"
    ]
    assert str(Finding("kernel", "pass", "PREEMPT_RT")) == "PREEMPT_RT"
