"""EDS files that are odd on purpose: a message or a dictionary, within bounded work, never an error of another kind."""

import os
import re
import signal
from contextlib import contextmanager
from pathlib import Path

import pytest
from friction_hil_drivers.canopen.connect.eds import SIMULATED_SERVO, load_eds
from friction_hil_drivers.canopen.connect.eds_check import compare_eds
from friction_hil_drivers.canopen.options import CanopenOptions
from friction_hil_drivers.canopen.simulated.eds_dictionary import eds_dictionary
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from friction_hil.drive import Mode
from friction_hil.errors import UsageError

TEXT = SIMULATED_SERVO.read_text()
SECTIONS = re.findall(r"^\[(\w+)\]", TEXT, re.MULTILINE)
KEYS = (
    *("ParameterName", "ObjectType", "DataType", "AccessType", "DefaultValue", "ParameterValue", "PDOMapping"),
    *("LowLimit", "HighLimit", "SubNumber", "CompactSubObj", "NrOfEntries", "Denotation", "StorageLocation", "Factor"),
)
KEYS += (
    "LowLimit",
    "HighLimit",
    "SubNumber",
    "CompactSubObj",
    "NrOfEntries",
    "Denotation",
    "StorageLocation",
    "Factor",
)
NUMBERS = ("4000000000", "-1", "254", "255", "256", "001", "08", "0x", "1e999", "nan", "9" * 5000)
ODD = (*NUMBERS, "", "$NODEID+0x180", "[x]")


@contextmanager
def within(seconds):
    """Fail where something takes far longer than it may: an endless loop must not hold up the tests."""

    def stop(*_):
        raise AssertionError(f"not done within {seconds} s")

    before = signal.signal(signal.SIGALRM, stop)
    signal.alarm(seconds)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


def edited(section, key, value):
    """The simulated servo's file with a key of a section set, or added; a section that it lacks follows at the end."""
    head, start, rest = TEXT.partition(f"[{section}]\n")
    if not start:
        return f"{TEXT}\n[{section}]\n{key}={value}\n"
    own, more = re.split(r"(?=^\[)|\Z", rest, maxsplit=1, flags=re.MULTILINE) if "\n[" in rest else (rest, "")
    lines = [line for line in own.splitlines() if not line.startswith(f"{key}=")]
    return "\n".join([head + f"[{section}]", f"{key}={value}", *lines, more])


@pytest.fixture
def use(tmp_path):
    """Check a configuration with a file, and make a simulated drive of it; return the reasons against it and notes."""
    path = tmp_path / "drive.eds"

    def used(text):
        path.write_text(text)
        with within(20):
            dictionary = load_eds(path, 5)
            options = CanopenOptions(node=5)
            compared = [compare_eds(dictionary, mode, options, is_compensated=True) for mode in (Mode.CSP, Mode.CST)]
            return [reason for reasons in compared for reason in reasons], eds_dictionary(path, 5).notes

    return used


edits = st.tuples(
    st.one_of(
        st.sampled_from(SECTIONS),
        st.from_regex(r"\A1[048A]0[0-3](sub[0-9A-F]{1,3}|Name|Value)?\Z"),
        st.sampled_from(("DummyUsage", "DeviceInfo", "DeviceComissioning", "Comments", "FileInfo", "comments")),
    ),
    st.sampled_from((*KEYS, "Lines", "NodeID", "Dummy0002", "VendorNumber", "Baudrate")),
    st.one_of(st.sampled_from(ODD), st.integers().map(str), st.text(st.characters(codec="utf-8"), max_size=8)),
)


@pytest.mark.deep
@settings(max_examples=12, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(edits)
@example(("1A00sub0", "DefaultValue", "4000000000"))
@example(("1600", "CompactSubObj", "254"))
@example(("1010Name", "NrOfEntries", "4000000000"))
@example(("Comments", "Lines", "4000000000"))
@example(("comments", "Lines", "x"))
@example(("1600sub0", "ParameterValue", "-4000000000"))
@example(("DeviceComissioning", "Baudrate", "x"))
@example(("1003", "ObjectType", "8"))
def test_every_edit_of_an_eds_is_a_message_or_a_drive(use, edit):
    told = "drive.eds"
    try:
        use(edited(*edit))
    except UsageError as error:
        told = str(error)
    assert "drive.eds" in told


def test_numbers_that_nobody_needs_and_zeros_in_front_make_no_difference(use):
    own = "[DeviceInfo]\nVendorNumber=001\nProductNumber=0x\nRevisionNumber=08\nBaudRate_500=none\n"
    text = re.sub(r"\[DeviceInfo\][^\[]*", own, edited("6041", "DataType", "0006"))
    assert "=001" in text
    assert use("\ufeff" + text) == ([], []), "nor does a byte order mark"


@pytest.mark.parametrize(
    ("edit", "told"),
    [
        (("6041", "DataType", "x"), "[6041] DataType=x: must be a number from 0 to 65535"),
        (("1010", "CompactSubObj", "4000000000"), "[1010] CompactSubObj=4000000000: must be a number from 0 to 254"),
        (("7777sub1", "ParameterName", "x"), "[7777sub1] belongs to no object"),
    ],
)
def test_a_mistake_is_named_with_its_section(use, edit, told):
    with pytest.raises(UsageError, match=re.escape(told)):
        use(edited(*edit))


def test_a_count_that_no_pdo_has_and_a_limit_that_makes_the_heartbeat_useless_are_told(use):
    reasons, _ = use(edited("1A00sub0", "DefaultValue", "4000000000"))
    assert [text for text in reasons if "4000000000 as the 1A00h" in text and "at most 64" in text]
    _, notes = use(edited("1016sub1", "HighLimit", "65535"))
    assert [note for note in notes if "1016h:01: HighLimit=65535 leaves no room for a node" in note]


def test_what_is_no_file_is_not_waited_for(tmp_path):
    os.mkfifo(tmp_path / "pipe.eds")
    (tmp_path / "zero.eds").symlink_to("/dev/zero")
    (tmp_path / "large.eds").write_bytes(b"")
    os.truncate(tmp_path / "large.eds", 1 << 30)
    for name in ("pipe", "zero", "large", "absent"):
        with within(20), pytest.raises(UsageError, match=f"{name}.eds"):
            load_eds(Path(tmp_path / f"{name}.eds"), 1)
