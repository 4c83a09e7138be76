"""An encoder at the load: from the frames of a drive to the recording and the figures of a run."""

import math
import struct
from dataclasses import replace

import numpy as np
import pytest
from friction_hil_drivers.canopen.drives import CanopenDrives
from friction_hil_drivers.canopen.load_encoder import LoadEncoder, LoadEncoderOptions
from friction_hil_drivers.canopen.mapping import MappedPdo
from hypothesis import given
from hypothesis import strategies as st

from friction_hil.daemon.realtime import SteppedClock
from friction_hil.daemon.safety import LoopState
from friction_hil.drive import Command, Feedback, Request
from friction_hil.errors import ConfigurationError, DriveError
from tests.canopen_bench import NODE, Bench, BenchBus
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


def driven(**load_encoder):
    bench = Bench()
    bus = BenchBus(bench)
    config = configuration(x=axis_dict(node=NODE, load_encoder=load_encoder))
    clock = SteppedClock()
    return bench, bus, clock, CanopenDrives(config, config.axes, clock, dry_run=False, bus=bus)


def test_the_object_is_mapped_beside_the_others_and_decoded():
    bench, bus, clock, drives = driven(index=STAND_IN, subindex=0, counts_per_unit=2000.0)
    (facts,) = drives.connect()
    assert facts.has_load_encoder
    drives.start()
    feedback = Feedback()
    for k in range(60):
        clock.sleep_until(clock.now_ns() + 1_000_000)
        drives.receive([feedback], 0)
        drives.send([Command(Request.ENABLE, position=1e-3 * k)])
        assert feedback.is_fresh
    counts = feedback.load_position * 2000.0
    per_unit = bench.servo.counts_per_unit
    assert counts == pytest.approx(round(counts), abs=1e-6)
    assert counts / per_unit == pytest.approx(0.057, abs=3e-3)  # the set-point of some cycles before
    drives.close()
    bus.shutdown()


@pytest.mark.parametrize(
    ("wrong", "text"),
    [({"counts_per_unit": 1.0}, "object 60E4h:01 load position"), ({"index": 0x6041, "subindex": 0}, "has 16 bits")],
)
def test_an_object_that_is_not_there_is_refused(wrong, text):
    _, bus, _, drives = driven(**{"counts_per_unit": 1.0} | wrong)
    with pytest.raises(DriveError, match=text):
        drives.connect()
    drives.close()
    bus.shutdown()


def test_its_scale_must_be_given():
    with pytest.raises(ConfigurationError, match=r"axes\.x\.load_encoder\.counts_per_unit"):
        configuration(x=axis_dict(load_encoder={}))


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
    without, compensated = (axis.load_errors.figures(each) for each in (1, 2))
    motor = axis.following_errors.figures(2)
    lag = 2e-4 * 0.3 * 2.0 * math.pi / math.sqrt(2.0)
    assert compensated.rms == pytest.approx(lag, rel=0.2)
    assert compensated.rms > 3.0 * motor.rms
    assert without.rms > compensated.rms
