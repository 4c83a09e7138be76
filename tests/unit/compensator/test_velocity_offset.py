"""Compensation through the velocity loop of a drive that takes no torque: the torque it makes, bounds, never worse."""

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from friction_hil.compensator.velocity_offset import SetpointShift, VelocityOffset
from friction_hil.config import Configuration
from friction_hil.daemon.assembly import make_velocity_offset
from friction_hil.daemon.axis import AxisLoop
from friction_hil.daemon.safety import LoopState
from friction_hil.drive import AxisFacts
from friction_hil.errors import ConfigurationError, OptionError, UsageError
from friction_hil.motion.trajectory import PathTime, sine_path
from friction_hil.rehearsal import Motion, Rehearsal
from friction_hil.servo.config import Loops, ServoConfig
from tests.examples import THOROUGH
from tests.servo_drives import PERIOD_S, axis_dict, configuration, run

GAIN, HZ = 0.08, 12.0
LOOP = {"velocity_gain": GAIN, "integral_hz": HZ, "limit": 20.0, "slew": 1e5}
SUBSTEPS = 200  # of the drive's loop in a period
torques = st.lists(st.floats(-1.0, 1.0), min_size=1, max_size=60)
thorough = settings(max_examples=THOROUGH)


def made(gain=GAIN, hz=HZ, limit=1e6, slew=1e9):
    return VelocityOffset(PERIOD_S, gain, hz, limit, slew, 0.5)


def by_velocity(mode="csp", loops=(GAIN, HZ), shift=None, **changes) -> Configuration:
    loop = LOOP | {"velocity_gain": loops[0], "integral_hz": loops[1]} | (shift or {})
    own = {"controller": {"position_gain": 40.0}} if mode == "csv" else {}
    return configuration(
        x=axis_dict(mode=mode, compensation={"fade_s": 0.1, "velocity_offset": loop}, **own, **changes)
    )


@thorough
@given(torques, st.floats(1e-3, 1e3), st.floats(0.0, 100.0))
def test_a_pi_loop_makes_of_it_the_torque_that_was_asked_for(wanted, gain, hz):
    """The loop is integrated on its own, in small steps; the mean over each period counts."""
    offset, integral = made(gain, hz), 0.0
    for cycle, torque in enumerate(wanted):
        sent, given = offset.step(float(cycle), torque), 0.0
        for _ in range(SUBSTEPS):
            integral += math.tau * hz * sent * PERIOD_S / SUBSTEPS
            given += gain * (sent + integral) / SUBSTEPS
        if torque != 0.0:  # without compensation the integral is forgotten
            assert given == pytest.approx(torque, abs=0.01)


def test_what_is_held_is_left_to_the_integral_part_and_a_loop_without_one_is_given_it_all():
    offset, plain = made(), made(hz=0.0)
    sent = [offset.step(float(k), 0.1) for k in range(200)]
    assert sent[0] == pytest.approx(0.1 / GAIN, rel=0.05)
    assert sent[-1] == pytest.approx(0.0, abs=1e-5)
    assert [plain.step(float(k), 0.1) for k in range(200)] == [0.1 / GAIN] * 200


@thorough
@given(
    st.lists(st.tuples(st.integers(1, 5), st.floats()), min_size=2, max_size=60),
    st.floats(0.01, 10.0),
    st.floats(1.0, 1e4),
    st.floats(0.0, 5e3),
)
def test_nothing_breaks_limit_or_slew_and_after_it_the_offset_ends(asked, limit, slew, hz):
    offset, cycle, before = made(hz=hz, limit=limit, slew=slew), 0, 0.0
    for passed, torque in asked:
        cycle += passed
        sent = offset.step(float(cycle), torque)
        assert abs(sent) <= limit
        assert abs(sent - before) <= slew * passed * PERIOD_S * (1.0 + 1e-9) + 1e-12
        before = sent
    for k in range(1, 20_000):
        before = offset.step(float(cycle + k), 0.0)
    assert before == pytest.approx(0.0, abs=1e-6 * limit)


def test_many_cycles_at_once_give_the_same_bits_and_compiling_changes_nothing():
    cycles = np.cumsum(np.random.default_rng(3).integers(1, 3, 500)).astype(float)
    torque = 0.1 * np.sign(np.sin(0.05 * cycles))
    one, other = made(limit=1.0, slew=300.0), made(limit=1.0, slew=300.0)
    one.compile()
    singly = [one.step(*pair) for pair in zip(cycles, torque, strict=True)]
    np.testing.assert_array_equal(other.replay(cycles, torque), singly)
    np.testing.assert_array_equal(one.state, other.state)


@pytest.mark.parametrize(
    "changes", [{"gain": 0.0}, {"gain": math.nan}, {"hz": -1.0}, {"hz": math.inf}, {"limit": 0.0}, {"slew": math.inf}]
)
def test_gains_and_bounds_out_of_range_are_refused(changes):
    with pytest.raises(UsageError):
        made(**changes)


@thorough
@given(
    st.lists(st.floats(-20.0, 20.0), min_size=1, max_size=60),
    st.floats(1.0, 500.0),
    st.floats(0.0, 1.5),
    st.floats(0.0, 1e-2),
)
def test_a_drive_makes_of_a_shifted_set_point_the_velocity_that_was_asked_for(
    wanted, position_gain, feedforward, inertia
):
    """Its loop and its feed-forward are computed from the set-points alone, by their differences."""
    shift = SetpointShift(PERIOD_S, GAIN, position_gain, feedforward, inertia)
    sent = np.array([0.0, 0.0, *map(shift.next, wanted)])
    rate = np.diff(sent) / PERIOD_S
    made = position_gain * sent[2:] + feedforward * rate[1:] + inertia / GAIN * np.diff(rate) / PERIOD_S
    assert made == pytest.approx(wanted, abs=1e-6)
    if inertia == 0.0:
        assert np.abs(sent).max() <= np.abs(wanted).max() / position_gain * (1.0 + 1e-9)
    shift.clear()
    assert shift.next(0.0) == 0.0


@pytest.mark.parametrize("given", [(0.0, 1.0, 0.0), (math.nan, 1.0, 0.0), (9.0, -1.0, 0.0), (9.0, 1.0, math.inf)])
def test_a_shift_without_a_position_loop_is_refused(given):
    with pytest.raises(UsageError):
        SetpointShift(PERIOD_S, GAIN, *given)


# --- in the loop


FACTS = AxisFacts("x", "", math.tau / 2**20, 6.4e-4, 2.5e-3, 1.5e-3, takes_velocity_offset=True)


def reduction(config, servo, motion):
    rehearsal = Rehearsal(config.axes["x"], FACTS, PERIOD_S)
    model = config.axes["x"].model
    without, outcome = (rehearsal.run(servo, model, motion, is_compensated=on) for on in (False, True))
    return without.rms / outcome.rms


MOTIONS = [Motion(sine_path(0.5, 1.0, 0.0), 2.0, 0.5, 1.0), Motion(sine_path(0.02, 0.5, 0.0), 2.0, 0.5, 2.0)]


@pytest.mark.parametrize("motion", MOTIONS, ids=["wide", "small"])
@pytest.mark.parametrize("gain", [0.06, 0.2])
def test_it_lowers_the_error_threefold_and_is_never_worse_with_gains_30_percent_off(gain, motion):
    servo = ServoConfig(loops=Loops(position_gain=100.0, velocity_gain=gain, integral_hz=HZ))
    assert reduction(by_velocity(loops=(gain, HZ)), servo, motion) > 3.0
    for of_gain, of_corner in ((1.3, 1.0), (0.7, 1.0), (1.0, 1.3), (1.0, 0.7), (0.7, 1.3)):
        assert reduction(by_velocity(loops=(gain * of_gain, HZ * of_corner)), servo, motion) > 1.5


@pytest.mark.parametrize("motion", MOTIONS, ids=["wide", "small"])
@pytest.mark.parametrize("feeds_acceleration", [False, True])
def test_a_drive_that_takes_nothing_but_positions_is_compensated_and_never_made_worse(feeds_acceleration, motion):
    loops = Loops(position_gain=100.0, velocity_gain=0.2, integral_hz=HZ, inertia_feedforward=float(feeds_acceleration))
    servo, inertia = ServoConfig(loops=loops), 2e-4 * feeds_acceleration

    def lowered(position=1.0, velocity=1.0):
        shift = {"position_gain": 100.0 * position, "inertia": inertia}
        return reduction(by_velocity(loops=(0.2 * velocity, HZ), shift=shift), servo, motion)

    assert lowered() > 3.0
    for wrong in (0.7, 1.3):
        assert lowered(position=wrong) > 1.0
        assert lowered(velocity=wrong) > 1.0


def test_the_loop_of_the_daemon_shifts_the_set_point_and_ends_without_a_shift():
    config = by_velocity(shift={"position_gain": 50.0, "inertia": 2e-4})
    servo = ServoConfig(loops=Loops(position_gain=50.0, velocity_gain=GAIN, integral_hz=HZ))
    result, rows, _ = run(config, servo=servo, duration_s=3.0)
    assert result.faults == []
    assert not any(rows.column("x", "command"))
    offset = np.array(rows.column("x", "velocity_offset"))
    assert np.abs(offset).max() > 0.5
    assert offset[-1] == pytest.approx(0.0, abs=1e-3)
    with_, without = (np.array(rows.column("x", name)) for name in ("position", "position_demand"))
    assert np.sqrt(np.mean((with_ - without)[1500:2500] ** 2)) < 1e-3


@pytest.mark.parametrize("shift", [None, {"position_gain": 50.0, "inertia": 2e-4}], ids=["offset", "shift"])
def test_at_the_end_of_a_motion_no_set_point_jumps_while_the_drive_still_has_power(shift):
    servo = ServoConfig(loops=Loops(position_gain=50.0, velocity_gain=GAIN, integral_hz=HZ))
    result, rows, drives = run(by_velocity(shift=shift), servo=servo, duration_s=1.1, power_off_cycles=20)
    assert result.faults == []
    ending = np.array(rows.column("x", "state")) == LoopState.DISABLING
    sent = np.array([position for _, position, _ in drives.sent[0]])
    begin = np.flatnonzero(ending)[0]
    assert np.abs(np.diff(sent[begin - 5 : begin + 15])).max() < 1e-6
    assert np.ptp(np.array(rows.column("x", "position"))[begin : begin + 20]) < 1e-3


def test_a_shifted_set_point_does_not_leave_the_position_limits():
    limits = axis_dict()["limits"] | {"position": [-0.3062, 0.3062]}
    shift = {"position_gain": 2.0, "velocity_feedforward": 0.0}
    _, _, drives = run(by_velocity(shift=shift, limits=limits), duration_s=1.6)
    sent = np.array([position for _, position, _ in drives.sent[0]])
    assert (sent.min(), sent.max()) == (-0.3062, 0.3062)


@pytest.mark.parametrize("mode", ["csp", "csv"])
def test_the_loop_of_the_daemon_sends_it_in_place_of_the_torque(mode):
    config, servo = by_velocity(mode), ServoConfig(loops=Loops(velocity_gain=GAIN, integral_hz=HZ))
    result, rows, _ = run(config, servo=servo, duration_s=3.0)
    assert result.faults == []
    assert not any(rows.column("x", "command"))
    offset, torque = (np.array(rows.column("x", name)) for name in ("velocity_offset", "compensation"))
    assert np.abs(offset).max() > 0.5 * np.abs(torque).max() / GAIN
    assert offset[-1] == pytest.approx(0.0, abs=1e-3)
    assert all(abs(b - a) <= LOOP["slew"] * PERIOD_S for a, b in pairwise(offset))


@pytest.mark.parametrize(
    ("changes", "key", "told"),
    [
        ({"mode": "cst", "controller": {"position_gain": 9.0, "velocity_gain": 0.1}}, "velocity_offset", "mode cst"),
        ({"trajectory": {"kind": "master"}}, "velocity_offset", "beside a master"),
        (
            {
                "mode": "csv",
                "controller": {"position_gain": 9.0},
                "compensation": {"velocity_offset": LOOP | {"position_gain": 9.0}},
            },
            "velocity_offset",
            "remove position_gain",
        ),
        ({"compensation": {"velocity_offset": LOOP | {"position_gain": math.inf}}}, "position_gain", ""),
        ({"compensation": {"velocity_offset": LOOP | {"velocity_gain": None}}}, "velocity_offset", "identify RUN.mcap"),
        ({"compensation": {"velocity_offset": LOOP | {"limit": math.nan}}}, "limit", ""),
        ({"compensation": {"velocity_offset": LOOP | {"slew": 0.0}}}, "slew", ""),
    ],
)
def test_a_configuration_that_cannot_be_is_refused(changes, key, told):
    with pytest.raises(ConfigurationError) as caught:
        configuration(x=axis_dict(**{"compensation": {"velocity_offset": LOOP}} | changes))
    (problem,) = [str(each) for each in caught.value.problems if "velocity_offset" in str(each)]
    assert key in problem
    assert told in problem


def test_a_drive_that_takes_none_or_steps_too_coarsely_is_refused():
    config = by_velocity()
    with pytest.raises(OptionError, match=r"velocity_offset: .*takes no velocity offset"):
        AxisLoop("x", config.axes["x"], replace(FACTS, takes_velocity_offset=False), PERIOD_S, PathTime(0.1))
    with pytest.raises(OptionError, match=r"velocity_offset\.limit: is 20, less than a step"):
        make_velocity_offset(config.axes["x"], replace(FACTS, velocity_resolution=21.0), PERIOD_S)
    coarse = make_velocity_offset(config.axes["x"], replace(FACTS, velocity_resolution=6.0), PERIOD_S)
    assert coarse.limit == 18.0, "rounding does not exceed the limit"
