"""Feedback of an earlier cycle, and missed periods, in whole cycles of an axis: no fault of its own making."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from friction_hil.daemon.axis import AxisLoop
from friction_hil.daemon.realtime import SteppedClock
from friction_hil.daemon.row import AxisRow
from friction_hil.daemon.safety import LoopState
from friction_hil.drive import Command, DriveState, Feedback
from friction_hil.motion.trajectory import PathTime
from tests.loop_run import LIMITS, MODES, LateClock, Run, axis, heard
from tests.servo_drives import PERIOD_S, ServoDrives, configuration

SINE = {"kind": "sine", "amplitude": 0.5, "frequency": 0.5, "ramp_s": 0.1}  # 1.57 rad/s
CLOSE = LIMITS | {"velocity": 2.5}
SPEED = 0.5 * math.pi
MS = 1_000_000


def moving(mode, velocity):
    """Changes of an axis that follows a sine of 1.57 rad/s, with this limit of the velocity."""
    return {"trajectory": SINE, "limits": MODES[mode].get("limits", LIMITS) | {"velocity": velocity}}


def smooth(mode, duration_s=2.0, **changes):
    """The same motion without any disturbance."""
    return Run(axis(mode, **changes), duration_s=duration_s)


def steps_of(run, k=0):
    """Largest step of the positions that were sent while the axes ran, per second."""
    sent = np.array([command.position for command in run.commands[k]])
    return np.abs(np.diff(sent[np.flatnonzero(run.column("state") == LoopState.RUNNING)])).max() / PERIOD_S


def late_frames(*cycles):
    """Nothing comes in the cycle before each of these; in it comes what the drive has sampled a period earlier."""
    earlier = {}

    def disturb(cycle, feedback):
        f = feedback[0]
        values = (f.position, f.velocity, f.torque)
        if cycle + 1 in cycles:
            f.is_fresh = False
        elif cycle in cycles:
            f.position, f.velocity, f.torque = earlier["values"]
        earlier["values"] = values

    return disturb


@pytest.mark.parametrize("mode", MODES)
def test_a_frame_of_the_cycle_before_is_neither_a_fault_nor_double_speed(mode):
    changes = moving(mode, 2.5) | {"trajectory": SINE | {"amplitude": 0.4}}
    run = Run(axis(mode, **changes), disturb=late_frames(*range(200, 1500, 37)), duration_s=1.5)
    estimate, demand = run.running("velocity_estimate", "velocity_demand")
    (expected,) = smooth(mode, 1.5, **changes).running("velocity_estimate")
    assert np.abs(estimate).max() < 1.35 * np.abs(demand).max()
    count = min(expected.size, estimate.size)
    # double speed would be an error of 1.26 rad/s; in cst the loop's own controller acts on the late position
    assert np.abs(estimate[:count] - expected[:count]).max() < 0.5


class Loop:
    """One axis, fed by hand; `step` returns its fault."""

    def __init__(self, torque_slew=CLOSE["torque_slew"], **changes):
        limits = CLOSE | {"following_error": None, "torque_slew": torque_slew}
        config = configuration(x=axis(limits=limits, trajectory={"kind": "hold"}, **changes))
        (facts,) = ServoDrives(config).connect()
        self.resolution = facts.position_resolution
        self.one = AxisLoop("x", config.axes["x"], facts, PERIOD_S, PathTime(0.25))
        self.row = AxisRow(np.full(self.one.row_width, math.nan), [])
        self.cycle = -1
        self.position = 0.0

    def step(self, speed, reported=None, is_fresh=True, shown=None):
        self.cycle += 1
        self.position += speed * PERIOD_S
        position, velocity = self.position if shown is None else shown, speed if reported is None else reported
        feedback = Feedback(position, velocity, 0.0, DriveState.OPERATION_ENABLED, is_fresh)
        return self.one.compute(self.cycle, LoopState.RUNNING, math.nan, feedback, Command(), self.row).fault

    @property
    def estimate(self):
        return self.one.compensator.velocity_estimate


@settings(max_examples=25, deadline=None)
@given(
    st.floats(0.1, 0.95),
    st.lists(st.tuples(st.integers(4, 20), st.integers(1, 3)), min_size=1, max_size=6),
    st.sampled_from([{}, {"velocity": "tracking", "acceleration": 50.0}]),
)
def test_however_late_single_frames_are_the_estimate_stays_that_of_the_motion(part, frames, estimator):
    """After some cycles without any, a frame comes that is older by as many."""
    axis, speed = Loop(compensation=estimator), part * CLOSE["velocity"]
    for _ in range(60):
        axis.step(speed)
    for even, missing in frames:
        for _ in range(even):
            assert axis.step(speed) is None
        for _ in range(missing):
            assert axis.step(speed, is_fresh=False) is None
        assert axis.step(speed, shown=axis.position + speed * PERIOD_S * (1 - missing)) is None
        assert abs(axis.estimate - speed) < 0.12 * CLOSE["velocity"]
        assert axis.step(speed) is None
        assert abs(axis.estimate - speed) < 0.12 * CLOSE["velocity"]  # slower ones are not known from other changes


@settings(max_examples=40, deadline=None)
@given(
    st.floats(-0.98, 0.98),
    st.one_of(st.floats(20.0, 10_000.0), st.just(math.inf)),
    st.floats(1.02, 50.0),
    st.sampled_from(["true", "frozen", "zero", "lagging"]),
    st.sampled_from([{}, {"velocity": "tracking", "acceleration": 50.0}, {"velocity": "drive"}]),
)
def test_a_real_overspeed_is_a_fault_within_three_cycles_whatever_the_drive_reports(
    before, rise, after, report, velocity
):
    """A runaway, slow or harder than any torque; by far more than the check of jumps lets pass too."""
    limit = CLOSE["velocity"]
    axis, speed, lagging = Loop(compensation=velocity), before * limit, before * limit
    for _ in range(40):
        assert axis.step(speed) is None
    cycles, fault = 0, None
    while fault is None and cycles < 3:
        speed = min(speed + rise * PERIOD_S, after * limit)
        lagging += 0.1 * (speed - lagging)
        fault = axis.step(speed, {"true": speed, "frozen": before * limit, "zero": 0.0, "lagging": lagging}[report])
        cycles += speed > limit * (1.0 + 1e-9) + 2.0 * axis.resolution / PERIOD_S
    assert fault is not None
    assert fault.endswith("[FH-107]") or "but its position changes by" in fault


def test_a_single_sample_beyond_the_limit_is_no_fault_where_the_drive_reports_less():
    axis, late = Loop(), {60: 0.6e-3, 61: -0.6e-3}  # sampled late: the next is on time
    for cycle in range(82):
        axis.position += late.get(cycle, 0.0)
        assert axis.step(2.3) is None


def stalled(late, *axes, **settings):
    """A run in which the drives go on by themselves while the loop is late, by periods at the n-th call."""
    clock = LateClock({call: periods * MS for call, periods in late.items()})
    passed = {"calls": -1}

    def before(drives):
        for _ in range(passed["calls"] + 1, clock.calls + 1):
            passed["calls"] += 1
            for servo in drives.servos:
                servo.advance(late.get(passed["calls"], 0) * round(PERIOD_S * servo.steps_per_second))

    return Run(*axes, clock=clock, before=before, **settings)


@pytest.mark.parametrize("missed", [1, 4, 9])
def test_after_missed_periods_no_axis_is_asked_for_more_than_its_limit(missed):
    """At the speed and the limit of config/single_axis_csp.yaml."""
    changes = moving("csp", 5.0)
    run = stalled({1100: missed}, axis(**changes), duration_s=2.0)
    assert run.result.missed == missed
    assert steps_of(run) < 1.1 * SPEED
    lag = run.column("path_lag_s")[run.column("state") == LoopState.RUNNING]
    assert lag.max() == pytest.approx(missed * PERIOD_S)
    assert lag[0] == lag[-1] == 0.0
    extra = np.abs(run.column("torque")).max() - np.abs(smooth("csp", **changes).column("torque")).max()
    assert extra < 0.45  # N m: less than the motion needs to start from rest in a period, where the drive has stood


@pytest.mark.parametrize("mode", ["csv", "cst"])
def test_an_axis_that_goes_on_by_itself_over_missed_periods_finds_its_path_where_it_is(mode):
    """Without a new velocity or torque a drive keeps the last one: a path that waited would be left behind."""
    changes = moving(mode, 5.0)
    run = stalled({700: 5, 1100: 9}, axis(mode, **changes), duration_s=2.0)
    assert run.result.missed == 14
    assert not run.running("path_lag_s")[0].any()
    assert np.abs(run.error()).max() < 1.2 * np.abs(smooth(mode, **changes).error()).max()


def test_in_csv_a_position_that_is_far_off_asks_for_less_than_the_velocity_limit():
    """A drive that has stood now and then, as one may whose clock is locked to SYNC."""

    def lag_behind(cycle, feedback):
        feedback[0].position += 0.0039 * sum(cycle >= begin for begin in range(1000, 1060, 10))

    run = Run(axis("csv", **moving("csv", 2.0)), disturb=lag_behind, duration_s=2.0)
    sent = np.abs([command.velocity for command in run.commands[0]])
    assert 1.7 < sent.max() <= 0.5 * (2.0 + SPEED) * (1.0 + 1e-9)


def losing(lost):
    """What a run needs in which the commands of these cycles do not get to the drive, and are reported as lost."""

    def lose(drives):
        if drives.cycle in lost:
            drives.pending = [None]

    def report(cycle, feedback):
        feedback[0].is_setpoint_lost = cycle in lost

    return {"before": lose, "disturb": report}


@pytest.mark.parametrize("count", [1, 9])
def test_after_set_points_that_did_not_get_to_the_drive_the_path_goes_on_from_the_last_one(count):
    changes, lost = moving("csp", 2.0), range(1000, 1000 + count)
    run = Run(axis(**changes), **losing(lost), duration_s=2.0)
    assert run.column("path_lag_s")[lost[-1]] == pytest.approx(count * PERIOD_S)
    expected = np.abs(smooth("csp", **changes).column("velocity_estimate")).max()
    assert np.abs(run.column("velocity_estimate")).max() < 1.15 * expected


@settings(max_examples=25, deadline=None)
@given(st.lists(st.tuples(st.floats(-0.5, 0.5), st.booleans()), max_size=60))
def test_torque_stays_within_a_step_of_all_that_the_drive_may_have(cycles):
    """A command that is reported as lost may have been on the wire, or in the drive, all the same."""
    writer, command = Loop(torque_slew=20.0).one._command, Command()
    had, is_lost = [0.0], False
    for wanted, is_next_lost in cycles:
        feedback = Feedback(state=DriveState.OPERATION_ENABLED, is_setpoint_lost=is_lost)
        writer.write(command, LoopState.RUNNING, 0.0, 0.0, 0.0, None, wanted, feedback)
        assert all(abs(command.torque - before) <= 20.0 * PERIOD_S * (1.0 + 1e-9) for before in had)
        is_lost = is_next_lost
        had = [*had, command.torque] if is_lost else [command.torque]


@pytest.mark.parametrize("mode", ["csp", "cst"])
def test_after_commands_that_did_not_get_to_the_drive_its_torque_makes_one_step(mode):
    lost = {cycle for start in range(400, 1400, 25) for cycle in range(start, start + 6)}
    limits = MODES[mode].get("limits", LIMITS) | {"torque_slew": 10.0}
    run = Run(axis(mode, trajectory=SINE, limits=limits), **losing(lost), duration_s=1.5)
    taken = np.array([torque for cycle, torque in enumerate(run.torques()) if cycle + 1 not in lost])
    assert np.abs(np.diff(taken[100:-100])).max() == pytest.approx(10.0 * PERIOD_S)


def test_two_axes_stay_on_their_circle_over_missed_periods():
    circle = {"kind": "circle", "radius": 0.3, "frequency": 1.0, "ramp_s": 0.1}
    axes = axis(trajectory=circle), axis(node=2, trajectory=circle | {"phase": -0.5 * math.pi})
    run = stalled({400: 5, 700: 3, 720: 8, 900: 1}, *axes, duration_s=1.5)
    assert max(steps_of(run, k) for k in range(2)) < 1.1 * 2.0 * math.pi * 0.3
    moving = run.column("state") == LoopState.RUNNING
    x, y = (run.column("position_demand", name)[moving] for name in "xy")
    start = [run.column("position", name)[moving][0] for name in "xy"]
    radius = np.hypot(x - start[0] + 0.3, y - start[1])
    assert np.abs(radius - 0.3).max() < 1e-4  # of the encoders, by which the path's beginning is set


def test_a_loop_that_is_too_slow_for_its_period_does_not_slow_the_motion_down():
    """Every cycle takes one and a half periods."""
    clock = SteppedClock()

    def slow(drives):
        if drives.cycle > 60:
            clock.sleep_until(clock.now_ns() + 3 * MS // 2)

    run = Run(clock=clock, before=slow, duration_s=2.0)
    (warning,) = (text for text in run.result.warnings if "too slow" in text)
    assert "10 times in " in warning
    moving = run.column("state") == LoopState.RUNNING
    lag = run.column("path_lag_s")[moving]
    assert lag.max() <= 10 * PERIOD_S
    assert lag[-1] == 0.0
    prompt, path = Run(duration_s=2.0), {}
    for one in (prompt, run):
        is_on_time = one.column("path_lag_s") == 0.0
        path[one] = one.column("time_s")[is_on_time], one.column("position_demand")[is_on_time]
    np.testing.assert_allclose(path[run][1], np.interp(path[run][0], *path[prompt]), atol=2e-2)


def test_a_fault_names_the_periods_that_were_missed_shortly_before():
    run = stalled({700: 4}, axis(**moving("csp", 5.0)), disturb=heard(720, velocity=9.0), duration_s=1.0, faults=None)
    assert run.result.faults[0].endswith("4 periods were missed 22 ms before [FH-107]")
    assert run.events("fault") == run.result.faults
