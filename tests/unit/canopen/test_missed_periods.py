"""Velocities that follow from positions, when the loop misses periods: divided by the time that passed."""

import math
import struct

import numpy as np
import pytest
from friction_hil_drivers.canopen.connect.mapping import MappedPdo
from friction_hil_drivers.cia402 import objects
from friction_hil_drivers.serial_line.axis import SerialAxis, make_scales
from friction_hil_drivers.serial_line.protocol import Image
from friction_hil_drivers.serial_line.units import AxisUnits
from hypothesis import given
from hypothesis import strategies as st

from friction_hil.drive import Feedback
from friction_hil.drive.encoder import derived_velocity
from tests.canopen_axis_bench import TPDO1, UNITS, Bench
from tests.loop_run import MODES, LateClock, Run, axis
from tests.serial_bench import CIA402, TinyDescription
from tests.unit.canopen.test_sidecar_exchange import Sidecar, T

COUNTS = UNITS.counts_per_unit
MAX_MISSED = 20
PERIOD_NS = 4_000_000
missed = st.lists(
    st.tuples(st.sampled_from([0] * 6 + [1, 2, 5, 15, MAX_MISSED]), st.sampled_from([0.0, 0.0, 0.01, 0.4, 0.9])),
    min_size=3,
    max_size=40,
)  # periods before a cycle, and its lateness within its own, in periods
speeds = st.floats(-50.0, 50.0)


def times_ns(pattern):
    """When each cycle samples the position, ns; a cycle in which nothing was missed waits for its time."""
    cycle, times = 0, []
    for periods, late in pattern:
        cycle += 1 + periods
        times.append(round((cycle + late) * PERIOD_NS))
    return times


class Canopen:
    """A drive without 606Ch; each cycle sends SYNC at ``time_ns``."""

    def __init__(self):
        tpdos = (MappedPdo(TPDO1, (objects.STATUSWORD, objects.POSITION_ACTUAL), struct.Struct("<Hi")),)
        self.bench = Bench(tpdos=tpdos, period_s=PERIOD_NS * 1e-9, heartbeat_s=1e3)

    def velocity(self, time_ns, counts, *, is_lost=False):
        frames = [] if is_lost else [(TPDO1, struct.pack("<Hi", 0x0637, counts))]
        return self.bench.cycle(*frames, after_ms=(time_ns - self.bench.now_ns) / 1_000_000).velocity


class Serial:
    """A drive on a serial line that reports its position alone, asked for it at ``time_ns``."""

    def __init__(self):
        signals = {name: unit for name, unit in CIA402["signals"].items() if name != "velocity"}
        description = TinyDescription.model_validate(CIA402 | {"signals": signals})
        units = AxisUnits(counts_per_unit=COUNTS, rated_torque=0.64)
        scales = make_scales("x", description, units, kind="rotary", is_inverted=False)
        self.image = Image()
        self.axis = SerialAxis("x", description, scales, self.image, (), period_s=PERIOD_NS * 1e-9)

    def velocity(self, time_ns, counts, *, is_lost=False):
        if not is_lost:
            self.image.put(("position", "status"), (counts, 0x0637))
        feedback = Feedback()
        self.axis.fill(feedback, time_ns * 1e-9, "")
        return feedback.velocity


@pytest.mark.parametrize("drive", [Canopen, Serial])
@given(missed, speeds, st.integers(0, 3))
def test_a_constant_velocity_is_found_within_a_count_whatever_was_missed(drive, pattern, speed, lost):
    one = drive()
    first, *later = times_ns(pattern)
    one.velocity(first - PERIOD_NS, round(speed * (first - PERIOD_NS) * 1e-9 * COUNTS))
    one.velocity(first, round(speed * first * 1e-9 * COUNTS))
    for k, time_ns in enumerate(later):
        found = one.velocity(time_ns, round(speed * time_ns * 1e-9 * COUNTS), is_lost=k % 5 < lost and k % 5 > 0)
        assert abs(found - speed) <= 2.0 / COUNTS / (PERIOD_NS * 1e-9)


@pytest.mark.parametrize("drive", [Canopen, Serial])
@given(missed, st.floats(0.1, 20.0), st.floats(0.1, 3.0))
def test_a_smooth_motion_gives_no_velocity_that_the_axis_did_not_have(drive, pattern, amplitude, hz):
    one, period_s, rate = drive(), PERIOD_NS * 1e-9, math.tau * hz
    times = times_ns(pattern)
    before_ns, bound = 0, 0.0
    for k, time_ns in enumerate((times[0] - PERIOD_NS, *times)):
        found = one.velocity(time_ns, round(amplitude * math.sin(rate * time_ns * 1e-9) * COUNTS))
        elapsed_s = (time_ns - before_ns) * 1e-9
        if k == 1:
            bound = 1.0 / COUNTS / period_s + amplitude * rate**2 * period_s
        elif k > 1:  # a mean over the time that passed; over less than a period, with the velocity before
            window_s = max(elapsed_s, period_s)
            bound *= 1.0 - min(elapsed_s / period_s, 1.0)
            bound += 1.0 / COUNTS / window_s + amplitude * rate**2 * window_s
        if k:
            assert abs(found - amplitude * rate * math.cos(rate * time_ns * 1e-9)) <= bound + 1e-9
        before_ns = time_ns


@given(st.lists(st.tuples(st.integers(1, 8), st.integers(1, MAX_MISSED), st.floats(0.0, 0.99)), max_size=6))
def test_a_sidecar_that_was_held_up_finds_the_velocity_of_the_axis(holds):
    """1000 counts a period: exactly that, in whatever part of a period the loop comes back."""
    cycles = 130 + sum(cycles + periods + 1 for cycles, periods, _ in holds)
    sidecar = Sidecar(cycles=cycles, max_missed=MAX_MISSED)
    for _ in range(5):
        sidecar.step()
    for cycles, periods, part in (*holds, (10, 0, 0.0)):
        for _ in range(cycles):
            heard = sidecar.step()
            assert heard.message == ""
            assert not heard.is_fresh or heard.velocity == pytest.approx(1000 / 1e5 / 1e-3)
        sidecar.world.ns += round((periods + part) * T)


class Held:
    """A clock that is late now and then, and a drive whose axis goes on meanwhile and that reports no velocity."""

    def __init__(self, late):
        self.clock = LateClock({call: periods * T for call, periods in late.items()})
        self.before_ns, self.elapsed_s = 0, 1e-3
        self.position = self.velocity = math.nan

    def advance(self, drives):
        now_ns = self.clock.now_ns()
        self.elapsed_s, self.before_ns = (now_ns - self.before_ns) * 1e-9, now_ns
        for servo in drives.servos:
            servo.advance(round(max(self.elapsed_s - 1e-3, 0.0) * servo.steps_per_second))

    def derive(self, cycle, feedback):
        [one] = feedback
        if math.isnan(self.position):
            self.velocity = 0.0
        else:
            self.velocity = derived_velocity(one.position - self.position, self.elapsed_s, self.velocity, 1e-3)
        self.position, one.velocity = one.position, self.velocity


@pytest.mark.parametrize("mode", MODES)
def test_a_loop_that_was_held_up_finds_no_fault_and_compensates_as_before(mode):
    """In csp the axis has stopped meanwhile, without set-points: its friction is then that of a slower axis."""
    held = Held({350: 15, 400: 3, 440: 18})
    limits = {"torque": 0.6 if mode == "cst" else 0.3, "torque_slew": 300.0, "velocity": 3.0, "following_error": 0.5}
    motion = {"kind": "triangle", "amplitude": 1.0, "frequency": 0.5, "rounding": 0.2}
    subject = axis(mode, trajectory=motion, limits=limits)
    run = Run(
        subject, before=held.advance, disturb=held.derive, clock=held.clock, duration_s=0.6, max_missed=MAX_MISSED
    )
    assert run.result.faults == []
    assert run.result.missed == 36
    compensation = run.column("compensation")
    gaps = np.flatnonzero(np.diff(run.column("time_s")) > 1.5e-3) + 1
    assert gaps.size == 3
    for k in gaps:
        steady, after = compensation[k - 1], compensation[k : k + 5]
        assert abs(steady) > 0.07
        if mode == "csp":
            assert np.abs(after).max() <= 0.13
        else:
            assert after == pytest.approx(steady, rel=0.05)
