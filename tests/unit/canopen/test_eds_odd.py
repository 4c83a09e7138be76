"""EDS files that are odd on purpose: a message or a dictionary, within bounded work, never an error of another kind."""

import configparser
import os
import re
import signal
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import canopen
import pytest
from friction_hil_drivers.canopen.connect.eds import SIMULATED_SERVO, load_eds
from friction_hil_drivers.canopen.connect.eds_check import compare_eds
from friction_hil_drivers.canopen.options import CanopenOptions
from friction_hil_drivers.canopen.simulated.eds_dictionary import eds_dictionary
from friction_hil_drivers.canopen.wire import cia301
from friction_hil_drivers.cia402.objects import DataType
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from friction_hil.drive import Mode
from friction_hil.errors import UsageError
from tests.canopen_bench import NODE, Bench

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
@example(("1010Name", "NrOfEntries", "2"))
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


# --- the shipped EDS: complete, and the same as the table of objects and as what the simulated drive does


@pytest.fixture(scope="module")
def eds() -> Any:
    return canopen.import_od(str(SIMULATED_SERVO), NODE)


def variables(eds: Any) -> list[Any]:
    items = [item for item in eds.values() if item.index >= 0x1000]
    single = canopen.objectdictionary.ODVariable
    return [entry for item in items for entry in ([item] if isinstance(item, single) else item.values())]


def test_every_entry_has_type_access_and_default_and_is_that_of_the_table(eds: Any) -> None:
    known = {index for index, _ in cia301.TABLE}
    known |= {base + n for base in (0x1400, 0x1600, 0x1800, 0x1A00) for n in range(cia301.PDO_COUNT)}
    for variable in variables(eds):
        assert variable.data_type in set(DataType), variable
        assert variable.access_type in ("ro", "rw", "const"), variable
        assert variable.default is not None, variable
        if variable.min is not None and variable.max is not None:
            assert variable.min <= variable.default <= variable.max, variable
        assert variable.index in known, variable
        entry = cia301.TABLE.get((variable.index, variable.subindex))
        if entry is not None:  # the driver also knows objects of other drives
            assert (variable.data_type, variable.name) == (entry.type, entry.name)
    information = eds.device_information
    assert (information.nr_of_RXPDO, information.nr_of_TXPDO) == (cia301.PDO_COUNT, cia301.PDO_COUNT)
    assert eds[0x1018][2].default == information.product_number
    assert eds[0x1018][1].default == information.vendor_number
    assert load_eds(SIMULATED_SERVO, 7)[0x1014].default == 0x87


def test_lists_of_objects_match_the_sections() -> None:
    parser = configparser.RawConfigParser()
    parser.optionxform = str  # type: ignore[assignment, method-assign]
    parser.read(SIMULATED_SERVO)
    listed: list[int] = []
    for section in ("MandatoryObjects", "OptionalObjects", "ManufacturerObjects"):
        count = parser.getint(section, "SupportedObjects")
        listed += [int(parser.get(section, str(number)), 0) for number in range(1, count + 1)]
        assert len(parser.options(section)) == count + 1
    described = [int(name, 16) for name in parser.sections() if len(name) == 4]
    assert sorted(listed) == sorted(described)
    assert len(set(listed)) == len(listed)
    for name in parser.sections():
        if len(name) == 4 and parser.has_option(name, "SubNumber"):
            subindices = [s for s in parser.sections() if s.startswith(f"{name}sub")]
            assert len(subindices) == int(parser.get(name, "SubNumber"), 0), name
            highest = max(int(s[7:], 16) for s in subindices)
            counts_what_is_there = name == "1003" or int(name, 16) >> 8 in (0x16, 0x1A)
            if not counts_what_is_there:
                assert int(parser.get(f"{name}sub0", "DefaultValue"), 0) == highest, name


def test_simulated_drive_serves_exactly_the_eds(eds: Any) -> None:
    bench = Bench()
    present = {(variable.index, variable.subindex) for variable in variables(eds)}
    for index in sorted({index for index, _ in present}):
        for subindex in range(12):
            [(_, answer)] = bench.sdo(bytes([0x40, index & 0xFF, index >> 8, subindex, 0, 0, 0, 0]))
            abort = int.from_bytes(answer[4:], "little") if answer[0] == 0x80 else 0
            assert (abort in (0x06020000, 0x06090011)) == ((index, subindex) not in present), f"{index:X}:{subindex}"


# Foreign EDS files


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("missing.eds", None, "cannot be read"),
        ("drive.xml", "<xml/>", "should end in"),
        ("empty.eds", "", "no object"),
        ("garbage.eds", "this is no EDS", "no valid EDS"),
        ("twice.eds", "[1000]\n[1000]\n", "no valid EDS"),
        ("nameless.eds", "[1000]\nDataType=7\n", "no valid EDS"),
    ],
)
def test_unreadable_eds_is_a_clear_error(tmp_path: Path, name: str, text: str | None, message: str) -> None:
    path = tmp_path / name
    if text is not None:
        path.write_text(text)
    with pytest.raises(UsageError, match=message) as info:
        eds_dictionary(path, NODE)
    assert name in str(info.value)
