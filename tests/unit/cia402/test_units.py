"""Drive integers and SI units: rounding, wrapping, saturation, and no value that is not finite."""

import math
import struct

import pytest
from friction_hil_drivers.cia402.units import DriveUnits, wrap
from hypothesis import given
from hypothesis import strategies as st

COUNTS = 1048576 / (2.0 * math.pi)
UNITS = DriveUnits(COUNTS, COUNTS, 0.64)
INVERTED = DriveUnits(-COUNTS, -COUNTS, -0.64)
both = pytest.mark.parametrize("units", [UNITS, INVERTED])


@given(st.integers(-(1 << 40), 1 << 40))
def test_wrapping_is_what_32_bits_hold(counts):
    (expected,) = struct.unpack("<i", struct.pack("<q", counts)[:4])
    assert wrap(counts) == expected


@both
@given(position=st.floats(-1e4, 1e4))
def test_a_position_comes_back_within_half_a_count(units, position):
    counts = units.position_counts(position)
    assert -(1 << 31) <= counts < 1 << 31
    assert counts / units.counts_per_unit == pytest.approx(position, abs=0.5001 / COUNTS)


def test_a_position_beyond_32_bits_wraps_as_the_drives_own_does():
    turns = (1 << 31) / COUNTS  # 2048 revolutions
    assert UNITS.position_counts(turns) == -(1 << 31)
    assert UNITS.position_counts(turns - 1.0 / COUNTS) == (1 << 31) - 1
    assert INVERTED.position_counts(3.0 * turns) == -(1 << 31)


@both
@given(torque=st.floats(-20.0, 20.0))
def test_a_torque_is_rounded_towards_zero(units, torque):
    per_mille = units.torque_per_mille(torque)
    sent = units.torque(per_mille)
    assert abs(sent) <= abs(torque) * (1.0 + 1e-9)
    assert abs(torque - sent) < 0.64e-3 * (1.0 + 1e-9)
    assert sent * torque >= 0.0
    assert units.torque_per_mille(-torque) == -per_mille


@given(st.integers(-32767, 32767), st.floats(1e-3, 1e4))
def test_a_torque_of_whole_steps_comes_back(per_mille, rated):
    units = DriveUnits(COUNTS, COUNTS, rated)
    assert units.torque_per_mille(units.torque(per_mille)) == per_mille


@both
@given(value=st.floats(allow_nan=False, allow_infinity=False))
def test_what_does_not_fit_saturates_with_its_sign(units, value):
    if not math.isfinite(value * COUNTS) or not math.isfinite(value / 0.64 * 1000.0):
        return
    sign = math.copysign(1.0, value * units.rated_torque)
    for number, bits in ((units.torque_per_mille(value), 16), (units.velocity_increments(value), 32)):
        assert -(1 << (bits - 1)) <= number < 1 << (bits - 1)
        assert number * sign >= 0
        struct.pack("<h" if bits == 16 else "<i", number)


@both
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf, 1e308])
def test_what_is_no_finite_number_never_reaches_a_drive(units, value):
    for encode in (units.position_counts, units.velocity_increments, units.torque_per_mille):
        with pytest.raises(ValueError, match="cannot be sent to a drive"):
            encode(value)


@pytest.mark.parametrize(
    ("torque", "rated", "per_mille"), [(0.3, 0.64, 468), (0.03, 50.0, 0), (0.0999, 50.0, 1), (0.64, 0.64, 1000)]
)
def test_no_torque_becomes_larger_than_it_was_commanded(torque, rated, per_mille):
    for sign in (1, -1):
        assert DriveUnits(COUNTS, COUNTS, rated).torque_per_mille(sign * torque) == sign * per_mille
        assert DriveUnits(-COUNTS, -COUNTS, -rated).torque_per_mille(sign * torque) == -sign * per_mille
    assert (UNITS.torque(1000), INVERTED.torque(-500)) == pytest.approx((0.64, 0.32))
