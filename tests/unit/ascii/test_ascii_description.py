"""Descriptions of drives that speak text: templates, checksums, what is refused with which words, the ready ones."""

import binascii
import math
import re
from pathlib import Path

import pytest
import yaml
from friction_hil_drivers.ascii import DESCRIPTIONS
from friction_hil_drivers.ascii.checksum import Checker, Checksum, checksum_function
from friction_hil_drivers.ascii.description import AsciiDescription, AsciiSignal
from friction_hil_drivers.ascii.messages import sealer
from friction_hil_drivers.ascii.options import AsciiOptions
from friction_hil_drivers.ascii.template import LineFormat
from friction_hil_drivers.serial_line.description import ready
from hypothesis import example, given
from hypothesis import strategies as st
from pydantic import ValidationError

from friction_hil.checked_yaml.files import read_section
from friction_hil.errors import ConfigurationError

SMALL = {
    "version": 1,
    "protocol": "ascii",
    "name": "drive under test",
    "sources": ["this test"],
    "signals": {
        "position": {"unit": "turn"},
        "status": {"bits": 16},
        "control": {"bits": 8, "is_signed": False},
        "torque_command": {"unit": "N m"},
    },
    "messages": {
        "feedback": {"request": "f {axis}", "reply": "{position:float} {status:int}"},
        "torque": {"request": "c {axis} {torque_command:float}"},
        "on": {"request": "on {axis}", "sets": {"control": 1}},
        "off": {"request": "off {axis}", "sets": {"control": 0}},
    },
    "states": [{"state": "operation_enabled", "value": 1}, {"state": "ready_to_switch_on", "value": 0}],
    "modes": {"cst": {"commands": ["torque_command"]}},
    "enable": [{"write": {"control": 1}, "until": "operation_enabled"}],
    "disable": [{"write": {"control": 0}, "until": "ready_to_switch_on"}],
}


def changed(path, value):
    """SMALL with one value replaced."""
    *parents, last = path.split("/")
    copy = dict(SMALL)
    place = copy
    for key in parents:
        place[key] = dict(place[key])
        place = place[key]
    place[last] = value
    return copy


def test_the_example_of_the_readme_is_a_whole_description(tmp_path):
    text = (Path(__file__).parents[3] / "drivers/serial_drives.md").read_text()
    (example,) = re.findall(r"^```yaml\n(version: 1\nprotocol: ascii\n.*?)^```", text, re.DOTALL | re.MULTILINE)
    path = tmp_path / "example.yaml"
    path.write_text(example)
    description = read_section(path, AsciiDescription)
    assert description.checksum is not None
    assert set(description.modes) == {"cst"}
    small = AsciiDescription.model_validate(SMALL)
    assert set(small.units()) == {"position", "status", "control", "torque_command"}
    assert small.units()["position"].counter_bits is None
    assert not small.is_answering_all


@pytest.mark.parametrize(
    ("path", "value", "words"),
    [
        ("messages/torque/request", "c {axis} {torque_comand:float}", "'torque_command'"),
        ("messages/torque/request", "c {axis} {torque_command}", "float, int, hex"),
        ("messages/torque/request", "c {axis} {torque_command:double}", "float, int, hex"),
        ("messages/torque/request", "c {axis} {torque_command:float", "brace"),
        ("messages/torque/request", "c {torque_command:float}{position:float}", "without text between"),
        ("messages/torque/request", "c {torque_command:float} {torque_command:float}", "twice"),
        ("messages/torque/request", "c {torque_command:float}\n", "line ends"),
        ("messages/torque/request", " ", "empty"),
        ("messages/torque/request", "c {torque_command:int}", "bits"),
        ("messages/feedback/reply", "{position:float} {status:float}", "it has no bits"),
        ("messages/feedback/reply", ["{position:float} {status:int}", "{position:float}"], "the same fields"),
        ("messages/feedback/reply", "{position:float}", "the signal status"),
        ("messages/feedback/request", "f {status:int}", "reads position"),
        ("messages/on/sets", {"contol": 1}, "'control'"),
        ("messages/on/sets", {"control": 2}, "only set other numbers"),
        ("messages/on/reply", "ok", "another reply"),
        ("enable", [{"write": {"control": 1, "torque_command": 0}}], "no message writes"),
        ("modes", {"cst": {"commands": ["torque_command", "position"]}}, "no messages write"),
        ("watchdog", {"signal": "status"}, "no message writes"),
        ("acknowledge", "{status:int}", "acknowledge"),
        ("error_replies", {"(": "open"}, "regular expression"),
        ("error_replies", {"(a+)+b": "slow"}, "repeats a group"),
        ("checksum", {"kind": "xor", "form": "decimal"}, "a prefix"),
        ("checksum", {"kind": "crc16"}, "a polynomial"),
        ("checksum", {"kind": "crc8", "polynomial": 0x1021}, "8 bits"),
        ("request_end", "\t", "request_end"),
    ],
)
def test_a_mistake_is_refused_with_what_would_be_right(path, value, words):
    with pytest.raises(ValidationError) as caught:
        AsciiDescription.model_validate(changed(path, value))
    assert words in str(caught.value)


@pytest.mark.parametrize("key", ["overvoltage", "1.5", "012", "1_0", "true", "''", "1" * 401])
def test_an_error_without_a_number_is_told_with_its_line_and_what_would_be_right(tmp_path, key):
    path = tmp_path / "drive.yaml"
    text = yaml.safe_dump(SMALL) + "errors:\n  1: undervoltage\n  0x3210: overvoltage\n  -2: too cold\n"
    path.write_text(text)
    assert read_section(path, AsciiDescription).errors.keys() == {1, 0x3210, -2}
    path.write_text(text + f"  {key}: too hot\n")
    with pytest.raises(ConfigurationError) as caught:
        read_section(path, AsciiDescription)
    (problem,) = caught.value.problems
    assert (problem.line, problem.field) == (text.count("\n") + 1, f"errors.{key.strip(chr(39))}")
    assert problem.message.startswith("is no whole number")


def test_a_ready_description_loads_and_says_where_it_comes_from():
    assert {"odrive", "odrive_pro", "copley_ascii"} <= set(ready(DESCRIPTIONS))
    for path in ready(DESCRIPTIONS).values():
        description = read_section(path, AsciiDescription)
        assert description.protocol == "ascii", path
        assert all(source.strip() for source in description.sources), path
        assert set(description.inferred) <= set(description.signals), path


def options(**given):
    return AsciiOptions.model_validate({"line": {"port": "/dev/ttyUSB0"}, "description": "odrive"} | given)


@pytest.mark.parametrize("axis", ["a b", "{0}", "0\n", "x" * 17, True, 1.5])
def test_an_axis_is_a_number_or_a_text_that_can_stand_in_a_line(axis):
    assert options(axis=1).axis == "1"
    assert options(axis=".b").address == "axis .b"
    assert options().address == "the only drive"
    with pytest.raises(ValidationError):
        options(axis=axis)


# Checksums, against the check values of the usual catalogues: of the characters 123456789

ALL_ONES = {"initial": 0xFFFF, "final_xor": 0xFFFF}
CATALOGUE = {
    "CRC-8/ROHC": ({"kind": "crc8", "polynomial": 0x07, "initial": 0xFF, "is_reflected": True}, 0xD0),
    "CRC-8/I-432-1": ({"kind": "crc8", "polynomial": 0x07, "final_xor": 0x55}, 0xA1),
    "CRC-16/GENIBUS": ({"kind": "crc16", "polynomial": 0x1021, **ALL_ONES}, 0xD64E),
    "CRC-16/MODBUS": ({"kind": "crc16", "polynomial": 0x8005, "initial": 0xFFFF, "is_reflected": True}, 0x4B37),
    "CRC-16/X-25": ({"kind": "crc16", "polynomial": 0x1021, "is_reflected": True, **ALL_ONES}, 0x906E),
    "sum": ({"kind": "sum"}, 0xDD),  # 477
    "xor": ({"kind": "xor"}, 0x31),  # 1 to 8 cancel out, and the 3s but one
}


@pytest.mark.parametrize("name", CATALOGUE)
def test_a_checksum_has_its_published_check_value(name):
    settings, expected = CATALOGUE[name]
    assert checksum_function(Checksum.model_validate(settings))(b"123456789") == expected


@given(st.binary(max_size=64))
def test_crc_16_is_that_of_the_standard_library(data):
    xmodem = Checksum(kind="crc16", polynomial=0x1021)
    assert checksum_function(xmodem)(data) == binascii.crc_hqx(data, 0)


def seal(checker, line):
    return sealer(checker, b"")(line)


def test_lines_of_the_manuals_have_the_checksums_that_stand_there():
    odrive = Checker(Checksum(kind="xor", form="decimal", prefix="*"))
    assert seal(odrive, b"r vbus_voltage ") == b"r vbus_voltage *93"
    assert seal(odrive, b"f 0") == b"f 0*118"  # 66h ^ 20h ^ 30h
    assert odrive.remove(b"f 0*118") == b"f 0"
    nmea = Checker(Checksum(kind="xor", prefix="*", skip=1))
    sentence = b"$GPGLL,5300.97914,N,00259.98174,E,125926,A"
    assert seal(nmea, sentence) == sentence + b"*28"
    assert nmea.remove(sentence + b"*28") == sentence


checks = st.sampled_from(
    [Checker(Checksum.model_validate(given_settings)) for given_settings, _ in CATALOGUE.values()]
    + [Checker(Checksum(kind="xor", form="decimal", prefix="*")), Checker(Checksum(kind="sum", prefix="%", skip=2))]
)
texts = st.text(st.characters(min_codepoint=32, max_codepoint=126), max_size=40).map(str.encode)


@given(checks, texts)
def test_a_checksum_comes_off_again(checker, line):
    sealed = seal(checker, line)
    assert checker.remove(sealed) == line
    assert checker.remove(line + sealed[len(line) :].lower()) == line  # some drives write hexadecimal so
    assert len(line) < len(sealed) <= len(line) + checker.size


@given(checks, texts.filter(lambda line: len(line) > 2), st.data())
def test_one_flipped_bit_is_found(checker, line, data):
    sealed = bytearray(seal(checker, line))
    place = data.draw(st.integers(2, len(line) - 1))
    sealed[place] ^= 1 << data.draw(st.integers(0, 7))
    with pytest.raises(ValueError, match="wrong checksum"):
        checker.remove(bytes(sealed))


def line_format(kind, name="number", **signal):
    return LineFormat(f"v {{{name}:{kind}}} end", {name: AsciiSignal.model_validate(signal)}, "0")


def there_and_back(form, value):
    (name,) = form.names
    line = form.write({name: value})
    assert len(line) <= form.size
    numbers = form.read(line)
    assert numbers is not None
    return numbers[0]


@example(digits=12, whole=12, fraction=-1.0)
@given(digits=st.integers(0, 12), whole=st.integers(1, 12), fraction=st.floats(-1.0, 1.0))
def test_a_float_comes_back_to_its_digits_over_the_whole_range(digits, whole, fraction):
    form = line_format("float", digits=digits, whole_digits=whole)
    value = fraction * (10.0**whole - 10.0**-digits)
    assert b"e" not in form.write({"number": value})[2:-4].lower()
    # a range of more than 16 digits ends a little earlier than it says
    assert there_and_back(form, value) == pytest.approx(value, rel=0.0, abs=0.5 * 10.0**-digits + 2.0 * math.ulp(value))


@given(st.floats(min_value=1e6, allow_infinity=False), st.sampled_from([-1.0, 1.0]))
def test_a_float_beyond_its_digits_saturates(value, sign):
    assert there_and_back(line_format("float", digits=3), sign * value) == sign * 999999.999


widths = st.sampled_from([8, 16, 32, 64])


@given(kind=st.sampled_from(["int", "hex"]), bits=widths, is_signed=st.booleans(), data=st.data())
def test_an_integer_comes_back_over_the_whole_range(kind, bits, is_signed, data):
    low, high = (-(1 << bits - 1), (1 << bits - 1) - 1) if is_signed else (0, (1 << bits) - 1)
    value = float(data.draw(st.sampled_from([low, high, 0]) | st.integers(low, high)))
    form = line_format(kind, bits=bits, is_signed=is_signed)
    expected = float(min(max(int(value), low), high))  # 2^64 - 1 is no float
    assert there_and_back(form, value) == expected
    assert there_and_back(form, value + 0.4) in (expected, expected + 1.0 if bits == 64 else expected)


@given(bits=widths, is_signed=st.booleans(), value=st.floats(-1e30, 1e30))
def test_an_integer_beyond_its_width_saturates_and_hexadecimal_digits_may_be_small(bits, is_signed, value):
    low, high = (-(1 << bits - 1), (1 << bits - 1) - 1) if is_signed else (0, (1 << bits) - 1)
    expected = float(min(max(round(value), low), high))
    assert there_and_back(line_format("int", bits=bits, is_signed=is_signed), value) == expected
    form = line_format("hex", bits=bits, is_signed=is_signed)
    line = form.write({"number": value})
    assert form.read(line) == form.read(line.lower()) == [expected]


@given(kind=st.sampled_from(["int", "hex"]), bits=widths, value=st.floats(-1e12, 1e12))
def test_a_position_wraps_where_its_counter_does(kind, bits, value):
    number = there_and_back(line_format(kind, "position_command", bits=bits, unit="count"), value)
    assert (int(number) - round(value)) % (1 << bits) == 0
    assert -(1 << bits - 1) <= number < 1 << bits - 1


@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize(
    "form",
    [line_format("float"), line_format("int", bits=16), line_format("int", "position_command", bits=32)],
)
def test_what_is_not_finite_is_not_written(form, value):
    with pytest.raises(ValueError, match="cannot be sent"):
        form.write({form.names[0]: value})
    with pytest.raises(ValueError, match=f"value of {form.names[0]}"):
        form.write({})


@pytest.mark.parametrize(
    ("kind", "text", "number"),
    [
        ("float", b"v  -1.5e-3 end", -1.5e-3),
        ("float", b"v .5 end ", 0.5),
        ("float", b"v 7 end", 7.0),
        *(("float", b"v %s end" % text, None) for text in (b"nan", b"inf", b"1_0", b"0x10", b"1.0 2.0")),
        *(("float", text, None) for text in (b"v end", b"v 1.0", b"w 1.0 end")),
        ("int", b"v +12 end", 12.0),
        ("int", b"v -32768 end", -32768.0),
        ("int", b"v 1.5 end", None),
        ("int", b"v \xb2 end", None),
        ("hex", b"v ff end", 255.0),
        ("hex", b"v FFFE end", -2.0),
        ("hex", b"v 0xff end", None),
        ("float", b"v 1e999 end", ValueError),  # too large for its signal
        ("int", b"v 32768 end", ValueError),
        ("int", b"v -32769 end", ValueError),
        ("hex", b"v 10000 end", ValueError),
    ],
)
def test_what_is_a_number_and_what_is_none(kind, text, number):
    form = line_format(kind, **({} if kind == "float" else {"bits": 16}))
    if number is ValueError:
        with pytest.raises(ValueError, match="number"):
            form.read(text)
        return
    assert form.read(text) == (None if number is None else [number])


def test_a_drive_without_a_name_is_asked_without_a_blank():
    signals = {"position": AsciiSignal(bits=32)}
    assert LineFormat("{axis} g r0x32", signals, "").write({}) == b"g r0x32"
    assert LineFormat("{axis} g r0x32", signals, "2").write({}) == b"2 g r0x32"
    assert LineFormat("100%{axis} {position:int}%", signals, "b").write({"position": 3}) == b"100%b 3%"
