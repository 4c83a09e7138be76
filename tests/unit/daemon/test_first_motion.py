"""The first motion: small whatever an increment of the velocity target means, and right about the factor."""

import math
import re

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from friction_hil.daemon.first_motion import FirstMotion, likely_unit
from friction_hil.daemon.safety import SafetyLimits
from friction_hil.errors import FrictionHilError

PERIOD_S = 1e-3
LIMITS = SafetyLimits(torque=0.3, velocity=10.0, position_low=-4.0, position_high=4.0)
COUNT = 2.0 * math.pi / 65536


class Axis:
    """An axis that follows its velocity target with a first-order lag, whatever its true unit is."""

    def __init__(self, factor=1.0, reported=1.0, lag_s=5e-3, position=0.0, delay=2, drift=0.0, lost=0.0):
        self.factor, self.reported, self.lag_s, self.drift, self.lost = factor, reported, lag_s, drift, lost
        self.position, self.velocity = position, 0.0
        self.targets = [0.0] * delay
        self.path = [position]

    def step(self, target, period_s, resolution):
        self.targets.append(target)
        wanted = self.factor * self.targets.pop(0)
        wanted = math.copysign(max(abs(wanted) - self.lost, 0.0), wanted) + self.drift
        self.velocity += (wanted - self.velocity) * -math.expm1(-period_s / self.lag_s)
        self.position += self.velocity * period_s
        self.path.append(self.position)
        return round(self.position / resolution) * resolution, self.velocity * self.reported


def examine(axis, step, limits=LIMITS, period_s=PERIOD_S, resolution=COUNT, patience_s=15.0):
    """Run a first motion; return it and its fault."""
    motion = FirstMotion("x", "rad", limits, period_s, resolution, step)
    for _ in range(round(patience_s / period_s)):
        position, velocity = axis.step(motion.target, period_s, resolution)
        if fault := motion.take(position, velocity):
            return motion, fault
        if motion.is_done:
            return motion, None
    raise AssertionError("the first motion does not end")


@settings(max_examples=60, deadline=None)
@given(
    exponent=st.floats(-6.0, 6.0),
    step=st.sampled_from([1e-7, COUNT, 1e-3, 0.0105]),
    bits=st.integers(12, 24),
    start=st.floats(-3.0, 3.0),
)
def test_a_wrong_unit_moves_the_axis_a_little_and_is_told_with_its_factor(exponent, step, bits, start):
    factor, resolution = 10.0**exponent, 2.0 * math.pi / 2**bits
    axis = Axis(factor, position=start)
    motion, fault = examine(axis, step, resolution=resolution)
    moved = max(abs(position - start) for position in axis.path)
    one_increment = factor * step * (0.01 + 3 * PERIOD_S)  # way in the time that the drive needs to follow
    assert moved <= 1.5 * motion.bound + one_increment
    if factor > 1.5:
        assert fault is not None
        assert fault.endswith("[FH-123]")
        if motion.bound > 20.0 * factor * step * 0.1:  # the increment is small enough to be measured
            told = float(fault.split("turns ")[1].split(" times")[0])
            assert told == pytest.approx(factor, rel=0.2)
    if 0.85 < factor < 1.15:
        assert fault is None


@settings(max_examples=40, deadline=None)
@given(
    step=st.sampled_from([1e-7, COUNT, 1e-3, 0.0105]),
    lag_s=st.floats(1e-4, 0.03),
    period_s=st.sampled_from([2.5e-4, 1e-3, 4e-3, 2e-2]),
    start=st.floats(-3.9, 3.9),
    velocity=st.floats(1.0, 300.0),
    bits=st.integers(10, 24),
)
def test_the_right_unit_is_confirmed_and_the_axis_returns(step, lag_s, period_s, start, velocity, bits):
    limits = SafetyLimits(torque=0.3, velocity=velocity, position_low=-4.0, position_high=4.0)
    axis = Axis(lag_s=lag_s, position=start)
    motion, fault = examine(axis, step, limits, period_s, 2.0 * math.pi / 2**bits)
    assert fault is None
    assert motion.take_warning() is None
    assert motion.target == 0.0
    assert max(abs(position - start) for position in axis.path) <= motion.bound + 3.0 * step * period_s
    assert abs(axis.position - start) < 0.3 * motion.bound
    assert all(-4.0 <= position <= 4.0 for position in axis.path)


@pytest.mark.parametrize(
    ("axis", "step", "words"),
    [
        ({"reported": 9.55}, COUNT, r" 9\.6.*\[FH-123\]$"),
        ({"factor": -1.0}, COUNT, r"\[FH-125\]$"),
        ({"factor": 0.0}, COUNT, r"\[FH-124\]$"),
        ({}, 11.0, r"limits\.velocity"),
    ],
    ids=["unit of the reported velocity", "direction", "does not move", "increment beyond the limit"],
)
def test_what_is_wrong_is_told(axis, step, words):
    moved = Axis(**axis)
    motion, fault = examine(moved, step)
    assert re.search(words, fault)
    if words.endswith("velocity"):
        assert moved.position == 0.0, "it never leaves"
    if "124" in words:
        assert motion.target == 0.0


def test_an_axis_that_loses_a_part_of_its_target_to_friction_is_a_warning():
    motion, fault = examine(Axis(lost=0.06), COUNT)
    assert fault is None
    assert "reaches only" in motion.take_warning()


@pytest.mark.parametrize(("drift", "part_lost"), [(-0.2, 0), (0.0, 7)], ids=["a load that settles", "missing feedback"])
def test_a_load_that_settles_after_enabling_and_missing_feedback_are_waited_for(drift, part_lost):
    axis, cycle = Axis(drift=drift), 0
    motion = FirstMotion("x", "rad", LIMITS, PERIOD_S, COUNT, COUNT)
    while not motion.is_done:
        axis.drift = drift if cycle < 150 else 0.0
        is_usable = not part_lost or cycle % part_lost != 0
        assert motion.take(*axis.step(motion.target, PERIOD_S, COUNT), is_usable=is_usable) is None
        cycle += 1
        assert cycle < 8000


@pytest.mark.parametrize("is_known", [False, True])
def test_periods_that_the_daemon_missed_are_no_wrong_unit(is_known):
    """Every third period is a cycle; the drive is as it should be. Without its time, the axis seems to be too fast."""
    axis, said = Axis(), None
    motion = FirstMotion("x", "rad", LIMITS, PERIOD_S, COUNT, COUNT)
    for cycle in range(12000):
        position, velocity = axis.step(motion.target, PERIOD_S, COUNT)
        if cycle % 3 == 0:
            said = motion.take(position, velocity) or said
        elif is_known:
            motion.take(math.nan, math.nan, is_usable=False)
        if motion.is_done or said:
            break
    assert motion.is_done is is_known
    assert said is None if is_known else said.endswith("[FH-123]")


@pytest.mark.parametrize(
    ("size", "unit", "name"),
    [
        (2.0 * math.pi / 60.0, "rad", "rpm"),
        (2.0 * math.pi / 600.0, "rad", "0.1 rpm"),
        (math.pi / 180.0, "rad", "deg/s"),
        (1e-3, "m", "mm/s"),
        (COUNT, "rad", "counts/s"),
        (0.5, "rad", ""),
        (-1.0, "rad", ""),
    ],
)
def test_a_likely_unit_is_named(size, unit, name):
    assert likely_unit(size, unit, COUNT) == name


def test_an_encoder_too_coarse_for_the_position_limits_is_refused():
    with pytest.raises(FrictionHilError, match="too coarse"):
        FirstMotion("x", "rad", SafetyLimits(0.3, 10.0, position_low=-0.1, position_high=0.1), PERIOD_S, 0.01, COUNT)
