"""The codes of findings: each one used is explained, and each that is explained is used."""

import re
from pathlib import Path

from friction_hil.doctor import codes
from friction_hil.drive.finding import Finding, complaints

ROOT = Path(__file__).parents[3]
SOURCES = [
    path
    for folder in (ROOT / "friction_hil", ROOT / "drivers")
    for path in folder.rglob("*.py")
    if path != Path(codes.__file__)
]
IN_CODE = re.compile(r'"(FH-[34]\d\d)"')


def test_the_codes_in_use_are_those_that_are_explained():
    assert list(codes.CODES) == sorted(codes.CODES)
    assert set(codes.CODES) == {code for path in SOURCES for code in IN_CODE.findall(path.read_text(encoding="utf-8"))}


def test_no_two_codes_have_the_same_message():
    assert len({each.message for each in codes.CODES.values()}) == len(codes.CODES)


def test_the_code_ends_the_message():
    finding = Finding("memory", "warn", "memory is not locked", "raise memlock", "FH-310")
    assert list(complaints([finding, Finding("kernel", "pass", "PREEMPT_RT")])) == [
        "memory is not locked; raise memlock [FH-310]"
    ]
    assert str(Finding("kernel", "pass", "PREEMPT_RT")) == "PREEMPT_RT"
