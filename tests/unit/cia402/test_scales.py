"""Scales of a drive: SI units decoded, the configuration compared with the drive, and the table of both."""

import math

import numpy as np
import pytest
from friction_hil_drivers.canopen.options import CanopenOptions
from friction_hil_drivers.cia402.access import ObjectReader
from friction_hil_drivers.cia402.scales import (
    polarity_notes,
    read_scales,
    require_agreement,
    resolution_notes,
    unit_rows,
)
from friction_hil_drivers.cia402.units import (
    VELOCITY_UNITS,
    Measure,
    decode_position_unit,
    decode_velocity_unit,
    encode_unit,
    parse_velocity_unit,
)
from hypothesis import given
from hypothesis import strategies as st
from pydantic import ValidationError

from friction_hil.drive import Mode, unit_table
from friction_hil.errors import DriveError
from tests.servo_drives import axis_dict, configuration

RPM = 2.0 * math.pi / 60.0  # rad/s
ENCODER = {(0x608F, 1): 4096, (0x608F, 2): 1, (0x6076, 0): 640}
COUNTS = 4096 / (2.0 * math.pi)


def ratio(index, number):
    """A ratio of so many to one; None: the drive has no such object."""
    return {(index, 1): number, (index, 2): None if number is None else 1}


class Objects(ObjectReader):
    """Objects of a drive: values by index and subindex."""

    axis, where = "x", "node 5"

    def __init__(self, values):
        self.values = values

    def bytes_of(self, entry):
        value = self.values.get(entry.address)
        return None if value is None else (value % (1 << 32)).to_bytes(4, "little")


def scales(values, kind="rotary", **options):
    reader, given_ = Objects(values), CanopenOptions(node=5, **options)
    found = read_scales(reader, given_, kind)
    require_agreement(reader, given_, found)
    return found


# Units of 60A8h and 60A9h


@pytest.mark.parametrize(
    ("code", "scale", "measure", "text"),
    [
        (0x00B44700, RPM, Measure.ANGLE, "rpm"),
        (0xFFB44700, 0.1 * RPM, Measure.ANGLE, "0.1 rpm"),
        (0xFDB44700, 1e-3 * RPM, Measure.ANGLE, "0.001 rpm"),
        (0x00B50300, 1.0, Measure.COUNTS, "counts/s"),
        (0xFD010300, 1e-3, Measure.LENGTH, "0.001 m/s"),
        (0x00100300, 1.0, Measure.ANGLE, "rad/s"),
        (0xFF410300, 0.1 * math.pi / 180.0, Measure.ANGLE, "0.1 deg/s"),
        (0x00B40300, 2.0 * math.pi, Measure.ANGLE, "rev/s"),
        (0x03B44800, 1e3 * 2.0 * math.pi / 3600.0, Measure.ANGLE, "1000 rev/h"),
    ],
)
def test_a_unit_of_velocity_is_decoded_with_its_prefix(code, scale, measure, text):
    unit = decode_velocity_unit(code)
    assert (unit.scale, unit.measure, unit.text) == (pytest.approx(scale), measure, text)
    signed = decode_velocity_unit(code - (1 << 32))  # some drives declare 60A9h as signed
    assert signed == unit


@pytest.mark.parametrize(
    ("decode", "code"),
    [
        (decode_velocity_unit, 0x00B50000),  # a position
        (decode_position_unit, 0x00B50300),  # a velocity
        (decode_velocity_unit, 0x00770300),
        (decode_velocity_unit, 0x00B57700),
    ],
)
def test_zero_says_nothing_and_an_unknown_code_is_no_unit(decode, code):
    assert decode(0) is None
    with pytest.raises(ValueError, match=f"{code:08X}h"):
        decode(code)


@given(st.integers(-12, 12), st.sampled_from([0x01, 0x10, 0x41, 0xB4, 0xB5]), st.sampled_from([0x03, 0x47, 0x48]))
def test_a_prefix_is_a_power_of_ten_and_the_text_means_the_same(exponent, numerator, denominator):
    base = decode_velocity_unit(encode_unit(0, numerator, denominator))
    unit = decode_velocity_unit(encode_unit(exponent, numerator, denominator))
    assert unit.scale == pytest.approx(base.scale * 10.0**exponent, rel=1e-12)
    again = parse_velocity_unit(unit.text)
    assert (again.measure, again.scale) == (unit.measure, pytest.approx(unit.scale, rel=1e-6))


@given(st.floats(1e-9, 1e9), st.sampled_from(VELOCITY_UNITS))
def test_a_number_before_a_unit_multiplies_it(factor, name):
    assert parse_velocity_unit(f"{factor!r} {name}").scale == pytest.approx(factor * parse_velocity_unit(name).scale)


@pytest.mark.parametrize("text", ["", "rpm 0.1", "0 rpm", "-1 rpm", "nan rpm", "0.1rpm", "counts", "furlong/s"])
def test_what_is_no_unit_of_velocity_is_refused_with_those_that_are(text):
    with pytest.raises(ValidationError, match="counts/s"):
        CanopenOptions(node=1, velocity_unit=text)


# Position


@pytest.mark.parametrize(
    ("values", "counts"),
    [
        ({}, COUNTS),
        (ratio(0x6091, 1) | ratio(0x6092, 1), COUNTS),  # defaults say nothing
        ({(0x60A8, 0): 0x00B50000}, COUNTS),
        ({(0x60A8, 0): 0xFD410000}, 1000.0 * 180.0 / math.pi),
        ({(0x60A8, 0): 0xFA100000}, 1e6),
        (ratio(0x6092, 4096), COUNTS),
        # 10 turns of the motor are one of the shaft, which is 36000 position units
        (ratio(0x608F, None) | ratio(0x6091, 10) | ratio(0x6092, 36000), 3600.0 / (2.0 * math.pi)),
    ],
)
def test_counts_per_rad_follow_from_the_drives_objects(values, counts):
    assert scales(ENCODER | values).position.value == pytest.approx(counts)


@pytest.mark.parametrize(
    ("values", "given_", "told", "confirmation"),
    [
        (ratio(0x6091, 10), COUNTS, r"651\.8986.*give counts_per_unit.*FH-241", "608Fh 4096 per revolution agrees"),
        (ratio(0x6092, 10000), COUNTS, r"651\.8986.*give counts_per_unit.*FH-241", "608Fh 4096 per revolution agrees"),
        (ratio(0x608F, None), 652.0, "encoder resolution.*give counts_per_unit", "not cross-checked"),
        (ratio(0x608F, 1), 652.0, "encoder resolution.*give counts_per_unit", "not cross-checked"),
        (ratio(0x608F, 0), 652.0, "encoder resolution.*give counts_per_unit", "not cross-checked"),
    ],
)
def test_a_resolution_that_is_missing_a_default_or_open_is_asked_for(values, given_, told, confirmation):
    with pytest.raises(DriveError, match=told):
        scales(ENCODER | values)
    assert scales(ENCODER | values, counts_per_unit=given_).position.confirmation == confirmation


# Contradictions


@pytest.mark.parametrize(
    ("key", "value", "values", "numbers"),
    [
        ("counts_per_unit", 6519.0, {}, ("6519", "651.8986", "a factor of 10")),
        ("rated_torque", 6.4, {}, ("6.4", "0.64", "a factor of 10")),
        ("velocity_unit", "0.1 rpm", {(0x60A9, 0): 0x00B44700}, ("0.1 rpm", "60A9h rpm", "a factor of 10")),
    ],
)
def test_a_configuration_that_contradicts_the_drive_is_refused_unless_it_is_trusted(key, value, values, numbers):
    other = "rated_torque" if key == "counts_per_unit" else "counts_per_unit"
    for trust in ([], [other]):  # another key that is trusted does not help
        with pytest.raises(DriveError, match="FH-240") as caught:
            scales(ENCODER | values, **{key: value}, trust=trust)
        assert all(text in str(caught.value) for text in (*numbers, f"trust: [{key}]")), str(caught.value)
    trusted = scales(ENCODER | values, **{key: value}, trust=[key])
    one = {"counts_per_unit": trusted.position, "rated_torque": trusted.torque, "velocity_unit": trusted.velocity}[key]
    assert "trusted although" in one.confirmation


def is_accepted(values=ENCODER, **options):
    try:
        scales(values, **options)
    except DriveError:
        return False
    return True


@given(st.floats(0.9, 1.1))
def test_a_rounded_number_is_no_contradiction(ratio):
    assert is_accepted(counts_per_unit=COUNTS * ratio) == (abs(ratio - 1.0) <= 2e-3 * max(ratio, 1.0))
    assert is_accepted(rated_torque=0.64 * ratio) == (abs(ratio - 1.0) * 0.64 <= 1e-2 * 0.64 * ratio + 5e-4)


def test_a_small_rated_torque_may_differ_by_half_a_step_of_6076h():
    small = ENCODER | {(0x6076, 0): 3}
    assert scales(small, rated_torque=0.00345).torque.confirmation == "6076h agrees"
    assert not is_accepted(small, rated_torque=0.0037)


def test_a_linear_axis_is_compared_where_the_drive_counts_metres():
    options = {"kind": "linear", "counts_per_unit": 1e6, "rated_torque": 20.0}
    assert scales(ENCODER, **options).position.confirmation == "not cross-checked"  # counts of a revolution
    assert scales(ENCODER | {(0x60A8, 0): 0xFA010000}, **options).position.confirmation == "60A8h 1e-06 m agrees"
    with pytest.raises(DriveError, match="a factor of 1000"):
        scales(ENCODER | {(0x60A8, 0): 0xFD010000}, **options)
    assert "6076h 0.64, of the motor?" in scales(ENCODER, **options).torque.confirmation


# Velocity


@pytest.mark.parametrize(
    ("values", "options", "increments"),
    [
        ({}, {}, COUNTS),
        ({(0x60A9, 0): 0x00B50300}, {}, COUNTS),
        ({(0x60A9, 0): 0}, {}, COUNTS),
        ({(0x60A9, 0): 0x00B44700}, {}, 1.0 / RPM),
        ({(0x60A9, 0): 0xFFB44700}, {}, 10.0 / RPM),
        ({}, {"velocity_unit": "rpm"}, 1.0 / RPM),
        ({}, {"velocity_unit": "0.1 deg/s"}, 1800.0 / math.pi),
        ({(0x60A9, 0): 0x00770300}, {"velocity_unit": "counts/s"}, COUNTS),  # a code that is not known
        ({(0x6096, 1): 60, (0x6096, 2): 4096}, {}, 60 / 4096 * COUNTS),  # counts/s to rpm
        ({(0x60A9, 0): 0x00B50300, (0x6090, 1): 1000, (0x6090, 2): 1}, {}, 1000 / (2.0 * math.pi)),
    ],
)
def test_increments_of_velocity_follow_from_60a9h_or_the_key(values, options, increments):
    assert scales(ENCODER | values, **options).velocity.value == pytest.approx(increments)


LINEAR = {"kind": "linear", "counts_per_unit": 1e6, "rated_torque": 1.0}


@pytest.mark.parametrize(
    ("code", "options", "told"),
    [
        (0x00B44700, LINEAR, "60A9h of node 5 is rpm; a linear axis needs counts/s or m/s"),
        (None, {"velocity_unit": "mm/s"}, "velocity_unit of node 5 is mm/s; a rotary axis needs"),
        (0x00770300, {}, "60A9h SI unit velocity = 00770300h.*give velocity_unit"),
    ],
)
def test_a_unit_that_does_not_fit_the_axis_is_refused(code, options, told):
    with pytest.raises(DriveError, match=told):
        scales(ENCODER | ({} if code is None else {(0x60A9, 0): code}), **options)


@pytest.mark.parametrize(
    ("inverted", "command", "feedback"), [("none", 1, 1), ("command", -1, 1), ("feedback", 1, -1), ("both", -1, -1)]
)
@pytest.mark.parametrize("sign", [1, -1])
def test_an_inverted_axis_inverts_all_three_and_the_sign_of_the_torque_alone_can_be_inverted(
    sign, inverted, command, feedback
):
    units = scales(ENCODER).units(is_inverted=sign < 0, inverted_torque=inverted)
    assert (units.counts_per_unit, units.velocity_per_unit) == pytest.approx((sign * COUNTS, sign * COUNTS))
    assert units.torque_per_mille(0.64) == sign * command * 1000
    assert units.torque(1000) == pytest.approx(sign * feedback * 0.64)
    assert units.position_counts(1.0) * sign > 0


@pytest.mark.parametrize(
    ("polarity", "inverted", "said"),
    [
        (None, "none", ""),
        (0x00, "none", ""),
        (0xC0, "none", "C0h: position and velocity inverted; by CiA 402 the torque is not"),
        (0x80, "none", "80h: position inverted; by CiA 402 the torque is not"),
        (0x40, "none", "40h: velocity inverted"),
        (0xC0, "both", "C0h: position and velocity inverted"),
    ],
)
def test_what_the_drive_inverts_is_shown(polarity, inverted, said):
    notes = polarity_notes(polarity, inverted)
    assert len(notes) == bool(said)
    assert all(said in note for note in notes)
    assert any("set inverted_torque" in note for note in notes) == ("by CiA 402" in said)


# The table


def axis(**limits):
    return configuration(x=axis_dict(limits={"torque": 0.3, "velocity": 10.0, **limits})).axes["x"]


def test_the_table_says_for_each_unit_where_it_comes_from_and_what_confirms_it():
    found = scales(ENCODER, counts_per_unit=652.0)
    rows = unit_rows(found, axis(position=[-4.0, 4.0]).limits, Mode.CSV, "rotary")
    assert list(unit_table("x", rows)) == [
        "x: position: 652 counts per rad from counts_per_unit; 608Fh 4096 per revolution agrees; "
        "limit [-4, 4] rad = [-2608, 2608] counts",
        "x: velocity: 652 increments per rad/s from the assumption counts/s, as there is no 60A9h; "
        "not cross-checked; examined by the first motion; limit 10 rad/s = 6520 increments",
        "x: torque: 0.64 N m at 1000 per mille from 6076h; not cross-checked; limit 0.3 N m = 468 per mille",
    ]


def test_a_torque_that_is_coarse_beside_the_friction_is_told():
    level = float(axis().model.friction_model.steady_state(np.array([1.0]))[0])
    coarse = scales(ENCODER, rated_torque=50.0, trust=["rated_torque"])
    assert resolution_notes(scales(ENCODER), axis()) == []
    (note,) = resolution_notes(coarse, axis())
    assert "0.05 N m" in note
    assert f"{level:.3g} N m" in note
    (note,) = resolution_notes(coarse, axis(torque=0.03))
    assert "no torque can be sent" in note
