"""An encoder at the load: from the frames of a drive to the recording and the figures of a run."""

import math
import struct
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from friction_hil_drivers.canopen.connect.mapping import MappedPdo
from friction_hil_drivers.cia402.load_encoder import LoadEncoder, LoadEncoderOptions, with_scale
from hypothesis import given
from hypothesis import strategies as st

from friction_hil.daemon.safety import LoopState
from friction_hil.errors import DriveError
from tests.canopen_bench import Bench, BenchBus, Driven
from tests.servo_drives import ServoDrives, axis_dict, configuration, make_loop

STAND_IN = 0x6062  # position demand: an INTEGER32 of the simulated drive that TPDOs can carry, in its counts


@given(st.integers(-(2**31), 2**31 - 1), st.lists(st.integers(-(2**30), 2**30), max_size=20), st.booleans())
def test_the_counter_is_followed_over_its_wraps(start, steps, is_inverted):
    options = LoadEncoderOptions(counts_per_unit=1000.0, is_inverted=is_inverted)
    encoder = LoadEncoder([MappedPdo(0x385, (options.entry,), struct.Struct("<i"))], options)
    total = start
    for step in [0, *steps]:
        total += step
        encoder.take([struct.pack("<i", (total + 2**31) % 2**32 - 2**31)])
        assert encoder.position == pytest.approx((-1.0 if is_inverted else 1.0) * total / 1000.0)


def test_the_object_is_mapped_beside_the_others_and_decoded():
    with Driven(load_encoder={"index": STAND_IN, "subindex": 0, "counts_per_unit": 2000.0}) as driven:
        assert driven.facts.has_load_encoder
        for k in range(60):
            assert driven.cycle(position=1e-3 * k).is_fresh
        counts = driven.feedback.load_position * 2000.0
        assert counts == pytest.approx(round(counts), abs=1e-6)
        # the set-point of some cycles before
        assert counts / driven.bench.servo.counts_per_unit == pytest.approx(0.057, abs=3e-3)


@pytest.mark.parametrize(
    ("wrong", "text"), [({"subindex": 2}, "60E4h:02 load position"), ({"index": 0x6041, "subindex": 0}, "has 16 bits")]
)
def test_an_object_that_is_not_there_is_refused(wrong, text):
    with pytest.raises(DriveError, match=text), Driven(load_encoder={"counts_per_unit": 1.0} | wrong):
        pass


TWO_MASSES = {
    "mechanics": {"inertia": 1e-4, "load": {"inertia": 1e-4, "stiffness": 5.0, "damping": 5e-3}},
    "encoder": {"load_counts": 40000},
}


def turning(servo, **load_encoder):
    """Drive of two masses whose motor runs ahead of its load; return it with what the driver reads of the load."""
    rows = []
    with Driven(bus=BenchBus(Bench(servo)), load_encoder=load_encoder) as driven:
        for k in range(200):
            before = driven.bench.servo.load_position, driven.bench.servo.true_position
            feedback = driven.cycle(position=2e-5 * k * k)
            assert feedback.is_fresh
            rows.append((*before, feedback.load_position))
    return driven.facts, np.array(rows)[50:]


def test_the_drive_itself_says_what_a_count_of_the_load_is():
    facts, rows = turning(TWO_MASSES)
    assert "encoder at the load: 6366.198 counts per rad (60E6h)" in facts.notes
    load, motor, read = rows.T
    assert np.ptp(motor - load) > 5.0 * math.tau / 40000
    counts = math.tau / 40000
    np.testing.assert_allclose(read[:-1], counts * np.floor(load[1:] / counts), atol=1e-9)


def test_a_scale_that_the_drive_contradicts_is_told_but_taken():
    facts, rows = turning(TWO_MASSES, counts_per_unit=63661.977)  # behind a gear of 10
    (note,) = [each for each in facts.notes if "encoder at the load" in each]
    assert "63661.98 counts per rad (load_encoder.counts_per_unit), although 60E6h of the drive says 6366.198" in note
    load, _, read = rows.T
    np.testing.assert_allclose(10.0 * read[:-1], load[1:], atol=math.tau / 40000)


@pytest.mark.parametrize(("index", "counts"), [(0x60E6, 1), (0x60E8, 10)])
@pytest.mark.parametrize(("kind", "unit"), [("rotary", "rad"), ("linear", "m")])
def test_a_scale_that_is_not_told_must_be_given(index, counts, kind, unit):
    """Increments of 1, which is a default, or a gear, on either side of which the encoder may turn."""
    values = {0x60E6: 40000, 0x60EB: 1, 0x60E8: 1, 0x60ED: 1} | {index: counts}
    access = SimpleNamespace(axis="x", where="node 5", find=lambda entry: values[entry.index])
    with pytest.raises(DriveError, match=rf"give load_encoder\.counts_per_unit \(counts per {unit} of the axis\)"):
        with_scale(access, LoadEncoderOptions(), kind)


class WithLoad(ServoDrives):
    """The load lags behind the motor by a fifth of its velocity, in ms, and has another zero."""

    def connect(self):
        return [replace(facts, has_load_encoder=True) for facts in super().connect()]

    def receive(self, feedback, end_ns):
        super().receive(feedback, end_ns)
        for each in feedback:
            each.load_position = 5.0 + each.position - 2e-4 * each.velocity


def test_it_is_recorded_and_the_error_of_the_load_is_reported():
    config = configuration(x=axis_dict(compensation={"fade_s": 0.1, "baseline_s": 1.5}))
    loop, sink, (axis,) = make_loop(config, WithLoad(config), duration_s=4.0)
    assert loop.run().faults == []

    def column(name):
        return np.array(sink.column("x", name))

    moving = column("state") == LoopState.RUNNING
    load, position, velocity = (column(name)[moving] for name in ("load_position", "position", "velocity"))
    np.testing.assert_allclose(load, position - 2e-4 * velocity, atol=2e-4)
    without, compensated = (axis.load.errors.figures(each) for each in (1, 2))
    motor = axis.following.errors.figures(2)
    lag = 2e-4 * 0.3 * 2.0 * math.pi / math.sqrt(2.0)
    assert compensated.rms == pytest.approx(lag, rel=0.2)
    assert compensated.rms > 3.0 * motor.rms
    assert without.rms > compensated.rms
