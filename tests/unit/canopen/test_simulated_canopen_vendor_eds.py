"""A simulated drive that follows a vendor's EDS: its types, access rights, fixed mappings, gaps and sloppiness."""

import struct
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.canopen_bench import NODE, PLAIN, Bench


def variable(section: str, kind: int, default: object = None, access: str = "rw", **more: object) -> str:
    """Return the section of one variable."""
    lines = [f"[{section}]", f"ParameterName=object {section}", f"DataType=0x{kind:04X}", f"AccessType={access}"]
    lines += [] if default is None else [f"DefaultValue={default}"]
    return "\n".join([*lines, *(f"{key}={value}" for key, value in more.items()), ""])


def record(index: str, *subs: str, kind: int = 0x9) -> str:
    return f"[{index}]\nParameterName=record {index}\nObjectType=0x{kind:X}\n" + "".join(subs)


def pdo(number: int, *, is_receive: bool, cob_id: object, words: list[int], access: str = "rw", kind: int = 1) -> str:
    """Return both records of a PDO, whose mapping has no room for more."""
    parameter, mapping = (0x1400, 0x1600) if is_receive else (0x1800, 0x1A00)
    head, body = f"{parameter + number:04X}", f"{mapping + number:04X}"
    return record(
        head,
        variable(f"{head}sub0", 5, 2, "ro"),
        variable(f"{head}sub1", 7, cob_id, access),
        variable(f"{head}sub2", 5, kind, access),
    ) + record(
        body,
        variable(f"{body}sub0", 5, len(words), access),
        *(variable(f"{body}sub{n:X}", 7, f"0x{word:08X}", access) for n, word in enumerate(words, 1)),
    )


MANDATORY = (
    variable("1000", 7, "0x00020192", "const")
    + variable("1001", 5, 0, "ro", PDOMapping=1)
    + record("1018", variable("1018sub0", 5, 4, "ro"), variable("1018sub1", 7, "0x2A", "ro"))
)
SERVO = MANDATORY + "".join(
    (
        variable("6040", 6, 0, "rww", PDOMapping=1),
        variable("6041", 6, None, "ro", PDOMapping=1),
        variable("6060", 2, 0, "rww", PDOMapping=1),
        variable("6061", 2, 0, "ro", PDOMapping=1),
        variable("6064", 4, 0, "ro", PDOMapping=1),
        variable("606C", 4, 0, "ro", PDOMapping=1),
        variable("6071", 3, 0, "rww", PDOMapping=1),
        variable("6077", 3, 0, "ro", PDOMapping=1),
        variable("607A", 4, 0, "rww", PDOMapping=1),
        variable("60FF", 4, 0, "rww", PDOMapping=1),
        pdo(0, is_receive=True, cob_id="$NODEID+0x200", words=[0x60400010, 0x60FF0020]),
        pdo(0, is_receive=False, cob_id="$NODEID+0x40000180", words=[0x60410010, 0x60640020]),
    )
)


@pytest.fixture
def drive(tmp_path: Path) -> Any:
    """Return a function that makes a bench from the text of an EDS."""

    def make(text: str, **options: Any) -> Bench:
        path = tmp_path / "vendor.eds"
        path.write_text("[DeviceInfo]\nVendorName=somebody\n" + text)
        return Bench(PLAIN, eds=path, **options)

    return make


# Data types


@pytest.mark.parametrize(
    ("kind", "default", "data"),
    [
        (0x08, "1.5", struct.pack("<f", 1.5)),
        (0x11, "-2.25", struct.pack("<d", -2.25)),
        (0x10, "-5", b"\xfb\xff\xff"),
        (0x15, "-5", b"\xfb" + b"\xff" * 7),
        (0x04, "0xFFFFFFFE", b"\xfe\xff\xff\xff"),
        (0x09, "iPOS", b"iPOS"),
        (0x0A, "01 02 03", b"\x01\x02\x03"),
        (0x0B, "ab", b"a\0b\0"),
        (0x05, "300", b"\x2c"),
    ],
)
def test_values_on_the_wire(drive: Any, kind: int, default: str, data: bytes) -> None:
    bench = drive(MANDATORY + variable("2000", kind, default))
    assert bench.node.dictionary.find(0x2000, 0).upload() == data
    beyond_its_type = ["2000h:00: the default 300 does not fit its type; 44 is used"]
    assert bench.node.notes == (beyond_its_type if default == "300" else [])


def test_a_mapping_takes_no_more_than_the_file_has_room_for(drive: Any) -> None:
    bench = drive(SERVO)
    bench.write(0x1400, 1, "I", 0x80000205)
    bench.write(0x1600, 0, "B", 0)
    assert bench.try_write(0x1600, 3, "I", 0x60710010) == 0x06090011
    assert bench.try_write(0x1600, 0, "B", 3) == 0x06090031


# Objects and access rights


def test_limits_and_compact_arrays_of_the_file(drive: Any) -> None:
    limits = variable("2000", 4, 5, LowLimit="0xFFFFFFF6", HighLimit="10")
    limits += variable("2001", 4, 5, LowLimit="0", HighLimit="0") + variable("2002", 5, 1, LowLimit="", HighLimit="7")
    bench = drive(SERVO + limits + variable("1016", 7, 0, "rw", ObjectType=8, CompactSubObj=4))
    assert [bench.try_write(0x2000, 0, "i", value) for value in (-10, 11, -11)] == [0, 0x06090031, 0x06090032]
    assert bench.try_write(0x2001, 0, "i", -11) == 0, "an editor filled them in"
    assert bench.try_write(0x2002, 0, "B", 8) == 0x06090031
    assert bench.read(0x1016, 0, "B") == 4
    bench.write(0x1016, 4, "I", 126 << 16 | 50)
    assert (bench.read(0x1016, 4), bench.read(0x1016, 1)) == (126 << 16 | 50, 0)
    assert bench.try_write(0x1016, 5, "I", 0) == 0x06090011


# Modes and units


UNITS = "".join(
    (
        record(
            "608F", variable("608Fsub0", 5, 2, "ro"), variable("608Fsub1", 7, 4096, "ro"), variable("608Fsub2", 7, 1)
        ),
        variable("6076", 7, 500, "ro"),
        variable("60A9", 7, "0x00B44700", "ro"),
    )
)


@pytest.mark.parametrize("increments", [0, 1])
def test_units_that_the_file_leaves_open(drive: Any, increments: int) -> None:
    text = UNITS.replace("=4096", f"={increments}").replace("DefaultValue=500", "DefaultValue=0")
    bench = drive(SERVO + text.replace("0x00B44700", "0"))
    assert (bench.read(0x608F, 1), bench.read(0x6076), bench.read(0x60A9)) == (1 << 20, 640, 0x00B50300)


def test_unknown_unit_is_told(drive: Any) -> None:
    bench = drive(SERVO + UNITS.replace("0x00B44700", "0x00123400"))
    assert bench.read(0x60A9) == 0x00123400
    assert "00123400h" in bench.node.notes[0]


# Sloppiness


KINDS, ODD = st.integers(1, 0x1C), st.sampled_from([None, "", "0", "1", "-1", "0xFFFFFFFF", "x"])
RECORDS = [f"{index:04X}sub{sub}" for index in (0x1404, 0x1604, 0x1800, 0x1A00, 0x1016) for sub in (0, 1, 2, 3, 5)]
TAKEN = {0x1000, 0x1001, 0x1018, 0x1404, 0x1604, 0x1800, 0x1A00, 0x1016}


@given(
    st.dictionaries(st.integers(0x1000, 0x7000).filter(lambda index: index not in TAKEN), st.tuples(KINDS, ODD)),
    st.dictionaries(st.sampled_from(RECORDS), st.tuples(KINDS, st.sampled_from([None, "1", "-1"]))),
)
def test_any_file_makes_a_node(tmp_path_factory: Any, variables: dict[int, Any], records: dict[str, Any]) -> None:
    path = tmp_path_factory.mktemp("eds") / "any.eds"
    text = "".join(variable(f"{index:04X}", *how) for index, how in variables.items())
    for index in sorted({section[:4] for section in records}):
        text += record(index, *(variable(name, *how) for name, how in records.items() if name.startswith(index)))
    path.write_text("[DeviceInfo]\nVendorName=somebody\n" + MANDATORY + text)
    bench = Bench(PLAIN, eds=path)
    bench.nmt(0x01)
    bench.sync(2)
    bench.nmt(0x82)
    assert (bench.read(0x1000), bench.node.number) == (0x00020192, NODE)


def test_odd_widths_in_a_pdo(drive: Any) -> None:
    text = SERVO + variable("2000", 0x10, -2, "ro", PDOMapping=1) + variable("2001", 0x18, 7, "rww", PDOMapping=1)
    bench = drive(text)
    bench.map(0x1800, 0x1A00, 0x185, 1, [0x20000018, 0x20010028])
    bench.nmt(0x01)
    assert bench.sync() == [(0x185, b"\xfe\xff\xff\x07\0\0\0\0")]


def test_a_live_value_in_another_type(drive: Any) -> None:
    text = SERVO.replace(variable("6064", 4, 0, "ro", PDOMapping=1), variable("6064", 7, 0, "ro", PDOMapping=1))
    text = text.replace(variable("6041", 6, None, "ro", PDOMapping=1), variable("6041", 3, None, "ro", PDOMapping=1))
    bench = drive(text, position=-1.0)
    assert bench.read(0x6064) > 1 << 31, "two's complement"
    bench.write(0x6040, 0, "H", 6)
    assert bench.read(0x6041, 0, "h") & 0x6F == 0x21


def test_consumer_heartbeats_as_many_as_the_file_has(drive: Any) -> None:
    entries = [variable(f"1016sub{n}", 7, 0) for n in (1, 2, 3)]
    bench = drive(SERVO + record("1016", variable("1016sub0", 5, 127, "ro"), *entries, kind=8))
    bench.write(0x1016, 3, "I", 126 << 16 | 50)
    assert bench.try_write(0x1016, 1, "I", 126 << 16 | 50) == 0x06040043
    bench.send(0x77E, b"\x05")
    bench.sync(60)
    assert bench.emergencies == ["8130"]
