"""The loop with simulated servos behind the drive port, in simulated time: physics, limits, and every way to end."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from friction_hil.drive import DriveState, Request
from friction_hil.errors import BusError
from friction_hil.loop import StopRequest
from friction_hil.realtime import SteppedClock
from friction_hil.safety import LoopState
from friction_hil.servo.config import ServoConfig
from tests.servo_drives import PERIOD_S, TRUE_FRICTION, ServoDrives, axis_dict, configuration, make_loop

BELIEVED = TRUE_FRICTION | {"coulomb": 0.07, "static": 0.13, "sigma0": 2400.0, "stribeck_velocity": 0.23}
LIMITS = {"torque": 0.3, "torque_slew": 300.0, "velocity": 30.0, "following_error": 0.5}
CONTROLLER = {"position_gain": 30.0, "velocity_gain": 0.02, "integral_hz": 2.0}
MODES = {
    "csp": {"mode": "csp"},
    "csv": {"mode": "csv", "controller": {"position_gain": 60.0}},
    "cst": {"mode": "cst", "controller": CONTROLLER, "limits": LIMITS | {"torque": 0.6}},
}
SINE = {"kind": "sine", "amplitude": 0.3, "frequency": 1.0, "ramp_s": 0.25}


def axis(mode="csp", **changes):
    return axis_dict(**MODES[mode] | changes)


def model(**parameters):
    friction = {"model": "lugre", "parameters": TRUE_FRICTION | parameters}
    return {"axis": "rotary", "friction": friction, "mechanics": {"inertia": 2e-4, "torque_lag_s": 3e-4}}


class Drives(ServoDrives):
    """Keeps every command; ``before`` is asked before each cycle and may do anything to the drives."""

    def __init__(self, config, before=None, **settings):
        super().__init__(config, **settings)
        self.before = before
        self.commands = [[] for _ in self.names]
        self.closed = 0

    def receive(self, feedback, deadline_ns):
        if self.before is not None:
            self.before(self)
        super().receive(feedback, deadline_ns)

    def send(self, commands):
        for kept, command in zip(self.commands, commands, strict=True):
            kept.append(replace(command))
        super().send(commands)

    def close(self):
        self.closed += 1


class Run:
    """A run, and what there is to see of it afterwards."""

    def __init__(self, *axes, before=None, disturb=None, servo=None, clock=None, on_axes=None, stop_at=None, **loop):
        self.config = configuration(**dict(zip("xyz", axes or (axis(),), strict=False)))
        stop = StopRequest()

        def hook(drives):
            if drives.cycle == stop_at:
                stop.is_requested = True
            if before is not None:
                before(drives)

        self.drives = Drives(self.config, hook, disturb=disturb, servo=servo)
        self.loop, self.sink, self.axes = make_loop(self.config, self.drives, stop=stop, **loop)
        if clock is not None:
            self.loop._clock = clock
        if on_axes is not None:
            on_axes(self.axes)
        self.result = self.loop.run()
        self.commands = self.drives.commands

    def column(self, name, axis="x"):
        return np.array(self.sink.column(axis, name))

    def requests(self, k=0):
        """The requests to a drive, in their order, without repetitions."""
        all_of_them = [command.request for command in self.commands[k]]
        return [one for one, last in zip(all_of_them, [None, *all_of_them], strict=False) if one is not last]

    def torques(self, k=0):
        return np.array([command.torque for command in self.commands[k]])

    def events(self, name="state"):
        return [text for _, kind, text in self.sink.events if kind == name]

    def error(self, axis="x"):
        """Following error while the axes run."""
        running = self.column("state", axis) == LoopState.RUNNING
        return (self.column("position_demand", axis) - self.column("position", axis))[running]

    def assert_left_disabled(self):
        assert self.drives.closed == 1
        for k, commands in enumerate(self.commands):
            assert commands[-1].request is Request.DISABLE
            assert commands[-1].torque == 0.0
            self.drives._activate(k, self.drives.servos[k])
            assert not self.drives.states[k].is_powered or self.drives.states[k] is DriveState.FAULT_REACTION_ACTIVE

    def assert_within_limits(self):
        for k, (name, config) in enumerate(self.config.axes.items()):
            torque, limits = self.torques(k), config.limits
            assert np.abs(torque).max() <= limits.torque, name
            asked = [command.request for command in self.commands[k]]
            powered = np.array([request in (Request.ENABLE, Request.QUICK_STOP) for request in asked])
            steps = np.abs(np.diff(torque))[powered[1:]]
            assert np.all(steps <= limits.torque_slew * PERIOD_S * (1.0 + 1e-9)), name


ORDINARY = [Request.LISTEN, Request.ENABLE, Request.DISABLE]
STOPPED_BY_FAULT = [Request.LISTEN, Request.ENABLE, Request.QUICK_STOP, Request.DISABLE]


# --- physics


@pytest.mark.parametrize("mode", MODES)
def test_compensation_takes_the_friction_out_of_the_error(mode):
    compensation = {"fade_s": 0.1, "baseline_s": 1.5}
    run = Run(axis(mode, model=model(**BELIEVED), compensation=compensation), duration_s=3.25)
    assert run.result.faults == []
    error = run.error()
    before, after = error[500:1500], error[2250:3250]  # a period each
    assert np.sqrt(np.mean(after**2)) < np.sqrt(np.mean(before**2)) / 3.0
    assert np.abs(after).max() < np.abs(before).max() / 2.0
    assert run.requests() == ORDINARY
    run.assert_within_limits()
    run.assert_left_disabled()


@pytest.mark.parametrize("mode", ["csp", "csv"])
def test_until_the_baseline_is_over_no_torque_is_added(mode):
    run = Run(axis(mode, compensation={"fade_s": 0.1, "baseline_s": 0.5}), duration_s=1.0)
    running = run.column("state") == LoopState.RUNNING
    assert np.all(run.column("command")[running][:499] == 0.0)
    assert np.abs(run.column("command")[running][600:]).max() > 0.05


def test_a_disabled_compensation_commands_nothing():
    run = Run(axis(compensation={"enabled": False}), duration_s=0.5)
    assert np.all(run.torques() == 0.0)
    assert run.result.faults == []


def test_two_axes_stay_on_their_circle():
    circle = {"kind": "circle", "radius": 0.5, "frequency": 1.0, "ramp_s": 0.25}
    run = Run(axis(trajectory=circle), axis(node=2, trajectory=circle | {"phase": -0.5 * math.pi}), duration_s=1.5)
    assert run.result.faults == []
    moving = np.isfinite(run.column("position_demand"))
    x, y = (run.column("position", name)[moving] for name in "xy")
    radius = np.hypot(x + 0.5, y)  # from rest on the circle, through start and stop
    assert np.abs(radius - 0.5).max() < 2e-3
    assert np.ptp(x) == pytest.approx(1.0, abs=0.01)
    run.assert_within_limits()
    run.assert_left_disabled()


def test_cst_without_a_set_point_makes_the_axis_light_and_commands_the_compensation_alone():
    """Somebody pushes with less than friction: the free axis yields, for its friction is taken away."""
    pushed = ServoConfig.model_validate({"mechanics": {"load_torque": -0.1}})
    free = {"mode": "cst", "controller": None, "trajectory": {"kind": "none"}, "compensation": {"gain": 0.9}}
    free["limits"] = {"torque": 0.3, "torque_slew": 300.0, "velocity": 30.0}
    run = Run(axis(**free), servo=pushed, duration_s=0.15)
    assert run.result.faults == []
    np.testing.assert_array_equal(run.column("command")[run.column("state") == LoopState.RUNNING],
                                  run.column("compensation")[run.column("state") == LoopState.RUNNING])  # fmt: skip
    assert np.isnan(run.column("position_demand")).all()
    bound = Run(axis(**free | {"compensation": {"enabled": False}}), servo=pushed, duration_s=0.15)
    assert abs(run.column("position")[-1]) > 3.0 * abs(bound.column("position")[-1])


def test_hold_stays_where_the_axis_is():
    run = Run(axis(trajectory={"kind": "hold"}), duration_s=0.5)
    assert np.ptp(run.column("position")) < 1e-4
    assert run.result.faults == []


def test_two_runs_are_the_same_bits():
    def rows():
        return np.array(Run(axis(model=model(**BELIEVED)), axis("cst", node=2), duration_s=0.5).sink.rows)

    np.testing.assert_array_equal(rows().view(np.int64), rows().view(np.int64))


# --- limits in every cycle


def test_torque_and_slew_are_in_force_when_they_are_reached():
    limits = LIMITS | {"torque": 0.05, "torque_slew": 2.0}
    run = Run(axis(limits=limits), duration_s=1.0)
    run.assert_within_limits()
    assert np.abs(run.torques()).max() == 0.05
    assert np.abs(np.diff(run.torques())).max() == pytest.approx(2e-3)


@pytest.mark.parametrize("mode", MODES)
def test_an_axis_that_somebody_turns_while_it_is_enabled_gets_no_jump_of_torque(mode):
    def turned(cycle, feedback):
        feedback[0].position += 5.0 * PERIOD_S * cycle

    limits = LIMITS | {"torque_slew": 0.5, "velocity": 300.0, "following_error": 100.0}
    run = Run(axis(mode, limits=limits, compensation={"fade_s": 0.02}), disturb=turned, duration_s=0.2)
    assert np.abs(run.torques()).max() > 0.01
    run.assert_within_limits()


def test_csv_never_asks_for_more_than_the_velocity_limit():
    """However far the axis is behind: the position loop above the drive's velocity loop is bounded."""

    def stuck(cycle, feedback):
        feedback[0].position = 0.0

    changes = {"controller": {"position_gain": 500.0}, "limits": LIMITS | {"velocity": 2.0, "following_error": 10.0}}
    run = Run(axis("csv", **changes), disturb=stuck, duration_s=0.6)
    assert max(abs(command.velocity) for command in run.commands[0]) == 2.0


garbage = st.sampled_from([math.nan, math.inf, -math.inf, 0.0, 1e-3, -0.04, 1.0, -50.0, 1e300])
disturbances = st.lists(
    st.tuples(
        st.integers(0, 450),
        st.integers(1, 25),  # cycles
        st.sampled_from(["position", "velocity", "torque", "jump", "stale", "state", "message", "fault", "creep"]),
        garbage,
        st.sampled_from(DriveState),
    ),
    max_size=6,
)


@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(disturbances, st.sampled_from(list(MODES)), st.sampled_from(["measured", "auto"]), st.booleans())
def test_no_disturbance_of_the_feedback_breaks_a_limit_or_leaves_a_drive_enabled(events, mode, source, is_reset):
    drives_fault = [begin for begin, _, kind, *_ in events if kind == "fault"]

    def disturb(cycle, feedback):
        f = feedback[0]
        for begin, length, kind, value, state in events:
            if not begin <= cycle < begin + length:
                continue
            if kind in ("position", "velocity", "torque"):
                setattr(f, kind, value)
            elif kind == "jump":
                f.position += value
            elif kind == "creep":
                f.position += 0.04 * (cycle - begin)
            elif kind == "stale":
                f.is_fresh = False
            elif kind == "state":
                f.state = state
            elif kind == "message":
                f.message = "no heartbeat"

    def before(drives):
        if drives.cycle in drives_fault:
            drives.states[0] = DriveState.FAULT

    quick = {"trajectory": SINE | {"ramp_s": 0.1, "frequency": 4.0}, "model": model(**BELIEVED)}
    quick |= {"compensation": {"fade_s": 0.02, "source": source}, "limits": LIMITS | {"torque_slew": 30.0}}
    run = Run(axis(mode, **quick), disturb=disturb, before=before, duration_s=0.25, is_fault_reset_wanted=is_reset)
    run.assert_within_limits()
    run.assert_left_disabled()
    asked = run.requests()
    assert Request.ENABLE not in asked[asked.index(Request.DISABLE) :]
    assert asked.count(Request.ENABLE) <= 1 + 2 * len(drives_fault)
    if Request.QUICK_STOP in asked:
        assert run.result.faults


# --- ways to end


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("stop_at", [30, 60, 200, 700])
def test_a_stop_request_brings_the_axis_to_rest_without_a_step(mode, stop_at):
    run = Run(axis(mode), stop_at=stop_at)
    assert run.result.faults == []
    asked = run.requests()
    assert Request.QUICK_STOP not in asked
    run.assert_left_disabled()
    run.assert_within_limits()
    if stop_at < 60:  # it never moved
        assert Request.DISABLE in asked
        return
    w, ramp = 2.0 * math.pi, 0.25
    bound = 0.3 * (w * w + w * 1.5 / ramp)  # of the acceleration, along the path and of the path time
    stopping = run.column("state") == LoopState.STOPPING
    compensation = run.column("compensation")[stopping]
    assert compensation[-1] == 0.0
    assert run.column("command")[-1] == 0.0
    enabled = [command for command in run.commands[0] if command.request is Request.ENABLE]
    if mode == "csp":
        positions = np.array([command.position for command in enabled])
        assert np.abs(np.diff(positions, 2)).max() <= 1.05 * bound * PERIOD_S**2
        assert positions[-1] == positions[-3]
    else:
        demand = run.column("velocity_demand")
        demand = demand[np.isfinite(demand)]
        assert np.abs(np.diff(demand)).max() <= 1.05 * bound * PERIOD_S
        assert demand[-1] == 0.0
    assert abs(run.column("velocity_estimate")[-1]) <= 0.03


def test_a_run_is_as_long_as_it_was_told():
    run = Run(duration_s=0.7)
    states = run.column("state")
    assert np.count_nonzero(states == LoopState.RUNNING) == pytest.approx(700, abs=1)
    assert run.events() == ["enabling", "running", "stopping", "disabling", "done"]
    assert run.result.cycles == len(run.sink.rows)
    np.testing.assert_allclose(run.column("time_s"), run.column("cycle") * PERIOD_S)


def slips(per_cycle, begin=300, end=400):
    """The encoder slips for a while."""

    def disturb(cycle, feedback):
        if begin <= cycle:
            feedback[0].position += per_cycle * (min(cycle, end) - begin)

    return disturb


def carried(cycle, feedback):
    """Somewhere else, whatever the drive does about it."""
    if cycle >= 300:
        feedback[0].position = carried.at + 3e-3 * min(cycle - 299, 300)
    else:
        carried.at = feedback[0].position


def jumps(cycle, feedback):
    if 300 <= cycle < 320:
        feedback[0].position += 100.0


def freezes(cycle, feedback):
    if cycle >= 300:
        feedback[0].position = freezes.at
    else:
        freezes.at = feedback[0].position


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize(
    ("limits", "disturb", "words"),
    [
        ({"velocity": 6.0}, slips(8e-3), "x: velocity"),
        ({"velocity": 6.0}, slips(-8e-3), "x: velocity"),
        ({"following_error": 0.05}, freezes, "x: following error"),
        ({"position": [-0.5, 0.5], "following_error": 10.0}, carried, "is outside [-0.5, 0.5] rad"),
        ({"velocity": 6.0}, jumps, "x: no usable feedback for more than 10 cycles"),
    ],
)
def test_each_limit_is_a_fault_that_ends_in_quick_stop_then_disabled(mode, limits, disturb, words):
    run = Run(axis(mode, limits=LIMITS | limits), disturb=disturb, duration_s=3.0)
    assert any(words in fault for fault in run.result.faults), run.result.faults
    assert run.requests() == STOPPED_BY_FAULT
    assert "fault_stopping" in run.events()
    assert run.events("fault") == run.result.faults
    run.assert_within_limits()
    run.assert_left_disabled()


def test_in_cst_the_torque_of_the_loops_own_control_ramps_down_after_a_fault_too():
    limits = LIMITS | {"torque": 0.6, "torque_slew": 20.0, "following_error": 0.15}
    run = Run(axis("cst", controller=CONTROLLER | {"velocity_gain": 0.1}, limits=limits), disturb=freezes)
    assert run.result.faults[0].startswith("x: following error")
    assert np.abs(run.torques()).max() > 0.3
    run.assert_within_limits()


def test_a_path_that_leaves_the_limits_is_refused_before_anything_is_enabled():
    def elsewhere(cycle, feedback):
        feedback[0].position += 0.4

    limits = LIMITS | {"position": [-0.5, 0.5]}
    assert Run(axis(limits=limits), duration_s=0.1).result.faults == []
    run = Run(axis(limits=limits), disturb=elsewhere)
    (fault,) = run.result.faults
    assert fault.startswith("x: from 0.4 rad the trajectory would go from 0.1 to 0.7 rad, outside the position limits")
    assert Request.ENABLE not in run.requests()


def test_a_drive_fault_in_motion_stops_all_axes_and_is_not_reset():
    def fails(drives):
        if drives.cycle == 400:
            drives.states[1] = DriveState.FAULT

    run = Run(axis(), axis(node=2), before=fails, is_fault_reset_wanted=True)
    assert run.result.faults == ["y: the drive is in fault: it does not say why"]
    for k in (0, 1):
        assert run.requests(k) == STOPPED_BY_FAULT
    speed = np.abs(run.column("velocity_estimate"))
    assert speed[400] > 0.3  # the healthy axis was brought to rest before it was disabled
    assert speed[run.column("state") == LoopState.DISABLING].max() <= 0.03
    run.assert_left_disabled()


def test_a_drive_that_leaves_operation_enabled_by_itself_is_a_fault():
    def leaves(cycle, feedback):
        if cycle >= 400:
            feedback[0].state = DriveState.SWITCHED_ON

    run = Run(disturb=leaves)
    assert run.result.faults == ["x: the drive left Operation enabled: switched on"]
    run.assert_left_disabled()


def test_a_drive_that_is_never_enabled_is_given_up():
    def refuses(cycle, feedback):
        feedback[0].state = DriveState.SWITCH_ON_DISABLED

    run = Run(disturb=refuses)
    assert run.result.faults == ["not every drive was enabled within 5 s"]
    assert run.requests() == ORDINARY
    assert np.all(run.torques() == 0.0)
    run.assert_left_disabled()


def test_a_drive_that_stays_powered_is_told_of():
    def stays(cycle, feedback):
        feedback[0].state = DriveState.OPERATION_ENABLED

    run = Run(disturb=stays, duration_s=0.2)
    assert run.result.faults == ["a drive is still powered 2 s after it was told to disable"]


# --- faults at the start


def in_fault(clears=True, again_when_enabled=0):
    """A drive found in fault; it may not leave it, or fall back as often as given when it is enabled."""
    falls = [again_when_enabled]

    def before(drives):
        if drives.cycle == 0:
            drives.states[0] = DriveState.FAULT
        pending = drives.pending[0]
        if pending is not None and pending.request is Request.RESET_FAULT and not clears:
            drives.pending[0] = None
        if pending is not None and pending.request is Request.ENABLE and falls[0]:
            falls[0] -= 1
            drives.states[0] = DriveState.FAULT
            drives.pending[0] = None

    return before


def test_a_fault_at_the_start_is_told_and_not_reset_without_the_users_word():
    run = Run(before=in_fault())
    assert run.result.faults == ["x: the drive is in fault: it does not say why; --reset-fault leaves it"]
    assert Request.RESET_FAULT not in run.requests()
    assert Request.ENABLE not in run.requests()


def test_on_the_users_word_a_fault_is_reset_and_the_run_goes_on():
    run = Run(before=in_fault(), is_fault_reset_wanted=True, duration_s=0.3)
    assert run.result.faults == []
    assert run.requests() == [Request.LISTEN, Request.RESET_FAULT, Request.ENABLE, Request.DISABLE]


def test_a_fault_that_cannot_be_reset_ends_the_run():
    run = Run(before=in_fault(clears=False), is_fault_reset_wanted=True)
    assert "in fault" in run.result.faults[0]
    assert Request.ENABLE not in run.requests()
    assert run.result.cycles == pytest.approx(1000, abs=5)
    run.assert_left_disabled()


def test_a_fault_that_comes_back_is_not_reset_again():
    """One word, one reset: a drive that trips when it is enabled must not be pushed back in again and again."""
    run = Run(before=in_fault(again_when_enabled=50), is_fault_reset_wanted=True)
    assert "in fault" in run.result.faults[0]
    assert run.requests() == [Request.LISTEN, Request.RESET_FAULT, Request.ENABLE, Request.DISABLE]


def test_a_new_fault_of_a_healthy_drive_is_not_covered_by_the_reset_either():
    def before(drives):
        pending = drives.pending[0]
        if pending is not None and pending.request is Request.ENABLE:
            drives.states[0] = DriveState.FAULT

    run = Run(before=before, is_fault_reset_wanted=True)
    assert "in fault" in run.result.faults[0]
    assert Request.RESET_FAULT not in run.requests()


# --- no feedback


def test_without_any_feedback_nothing_is_enabled():
    def silent(cycle, feedback):
        feedback[0].is_fresh = False

    run = Run(disturb=silent)
    assert run.result.faults == ["x: no usable feedback within 1 s of the start"]
    assert run.requests() == [Request.DISABLE]


def test_the_first_feedback_may_take_its_time():
    def late(cycle, feedback):
        if cycle < 300:
            feedback[1].position = math.nan

    run = Run(axis(), axis(node=2), disturb=late, duration_s=0.2)
    assert run.result.faults == []
    assert run.column("cycle")[0] == 300


def test_silence_in_motion_is_bridged_shortly():
    def silent(cycle, feedback):
        if 300 <= cycle < 306:
            feedback[0].is_fresh = False

    run = Run(disturb=silent, duration_s=0.6)
    assert run.result.faults == []
    assert np.count_nonzero(run.column("is_fresh") == 0.0) == 6
    assert np.abs(run.error()).max() < 0.02


@pytest.mark.parametrize("trajectory", [SINE, {"kind": "hold"}])
def test_an_axis_that_nobody_sees_is_not_taken_to_stand(trajectory):
    run = Run(
        axis(trajectory=trajectory), disturb=lambda cycle, feedback: setattr(feedback[0], "is_fresh", cycle < 300)
    )
    assert run.result.faults[0] == "x: no usable feedback for more than 10 cycles"
    assert run.requests() == STOPPED_BY_FAULT
    # nobody knows that it stands: the drive holds it until the time is up
    stops = run.column("state") == LoopState.FAULT_STOPPING
    assert np.count_nonzero(stops) == pytest.approx(5000, abs=2)
    assert abs(run.drives.servos[0].true_velocity) < 1e-3
    assert np.all(run.column("compensation")[stops][400:] == 0.0)
    run.assert_left_disabled()


# --- the world breaks


@pytest.mark.parametrize("error", [BusError("the bus is gone"), RuntimeError("a bug")])
@pytest.mark.parametrize("where", ["receive", "send"])
def test_whatever_breaks_the_drives_are_disabled_and_the_bus_is_left(where, error):
    config = configuration()
    drives = Drives(config)
    original, calls = getattr(drives, where), []

    def broken(*arguments):
        calls.append(0)
        if len(calls) == 300:
            raise error
        original(*arguments)

    setattr(drives, where, broken)
    loop, *_ = make_loop(config, drives)
    if isinstance(error, BusError):
        assert loop.run().faults == ["the bus is gone"]
    else:
        with pytest.raises(RuntimeError):
            loop.run()
    assert drives.closed == 1
    assert drives.commands[0][-1].request is Request.DISABLE
    assert drives.commands[0][-1].torque == 0.0


@pytest.mark.parametrize("error", [BusError("gone"), RuntimeError("a bug")])
def test_the_bus_is_left_even_if_the_last_word_fails(error):
    config = configuration()
    drives = Drives(config)

    def broken(commands):
        raise error

    drives.send = broken
    loop, *_ = make_loop(config, drives)
    if isinstance(error, BusError):
        assert loop.run().faults == ["gone"]
    else:
        with pytest.raises(RuntimeError):
            loop.run()
    assert drives.closed == 1


@pytest.mark.parametrize("mode", MODES)
def test_a_mistake_in_the_computation_stops_the_axes_in_good_order(mode):
    def sabotage(axes):
        original = axes[0].compensator.step
        compensator = axes[0].compensator

        class Broken:
            def step(self, cycle, *rest):
                if cycle >= 400:
                    raise ZeroDivisionError("by hand")
                return original(cycle, *rest)

            def __getattr__(self, name):
                return getattr(compensator, name)

        axes[0].compensator = Broken()

    run = Run(axis(mode), axis(mode, node=2), on_axes=sabotage)
    assert run.result.faults == ["x: the computation failed: ZeroDivisionError: by hand"]
    for k in (0, 1):
        assert run.requests(k) == STOPPED_BY_FAULT
    broken = run.column("cycle") >= 400
    assert np.all(run.torques()[np.flatnonzero(broken)] == 0.0)
    assert np.isnan(run.column("compensation")[broken]).all()
    assert np.isfinite(run.column("compensation", "y")[broken]).all()
    for one in run.drives.servos:
        assert abs(one.true_velocity) < 0.05
    assert np.count_nonzero(run.column("state", "y") == LoopState.FAULT_STOPPING) < 1000  # it saw the standstill
    run.assert_left_disabled()


def test_a_model_that_overflows_is_a_fault():
    def poison(axes):
        axes[0].compensator.state[:] = np.where(np.arange(axes[0].compensator.state.size) == 21, math.nan, -1.0)

    run = Run(on_axes=poison)
    assert any("not finite" in fault for fault in run.result.faults)
    assert np.all(run.torques() == 0.0)
    run.assert_left_disabled()


def test_a_failing_rehearsal_stops_the_axes_in_good_order():
    class Ready(SteppedClock):
        def doze_until(self, deadline_ns):
            return True

    def before(drives):
        if drives.cycle == 400:
            drives.rehearse = lambda: 1 / 0

    run = Run(before=before, clock=Ready())
    assert run.result.faults == ["the computation failed in rehearsal: ZeroDivisionError: division by zero"]
    assert run.requests() == STOPPED_BY_FAULT
    run.assert_left_disabled()


def test_rehearsals_change_no_bit_of_what_is_commanded():
    class Ready(SteppedClock):
        def doze_until(self, deadline_ns):
            return True

    plain, rehearsed = Run(duration_s=0.4), Run(duration_s=0.4, clock=Ready())
    assert plain.commands == rehearsed.commands


# --- time


class LateClock(SteppedClock):
    """Oversleeps: by so many nanoseconds at the n-th call."""

    def __init__(self, late):
        super().__init__()
        self.late, self.calls = late, -1

    def sleep_until(self, deadline_ns):
        self.calls += 1
        super().sleep_until(deadline_ns + self.late.get(self.calls, 0))


def test_missed_periods_are_counted_and_bridged():
    run = Run(clock=LateClock({300: 3_200_000, 400: 1_000_000, 500: 999_999}), duration_s=1.0)
    assert run.result.missed == 4
    assert run.result.faults == []
    cycle = run.column("cycle")
    assert sorted(cycle[1:][np.diff(cycle) > 1.0]) == [303.0, 404.0]
    assert run.column("late_us")[cycle == 303.0] == pytest.approx(200.0)
    assert np.abs(run.error()).max() < 0.03
    run.assert_left_disabled()


def test_too_many_missed_periods_in_a_row_are_a_fault():
    assert Run(clock=LateClock({300: 9_000_000}), duration_s=1.0).result.faults == []
    run = Run(clock=LateClock({300: 10_000_000}), duration_s=1.0)
    assert run.result.faults == ["the loop was late by 10000 us (10 periods)"]
    assert run.requests() == STOPPED_BY_FAULT
    run.assert_left_disabled()


def test_while_the_drives_are_idle_nothing_is_missed():
    run = Run(clock=LateClock({3: 20_000_000}), duration_s=0.1)
    assert (run.result.missed, run.result.faults) == (0, [])


def test_lateness_is_told_in_percentiles():
    late = {k: 40_000 if k % 50 else 700_000 for k in range(2000)}
    result = Run(clock=LateClock(late), duration_s=0.5).result
    assert (result.late_p50_us, result.late_p99_us) == (40.0, 700.0)


# --- listening


def test_a_dry_run_listens_computes_and_sends_nothing():
    def moved_by_others(cycle, feedback):
        feedback[0].position = 0.3 * math.sin(6.0 * PERIOD_S * cycle)

    run = Run(disturb=moved_by_others, dry_run=True, duration_s=0.5)
    assert run.result.faults == []
    assert {command.request for command in run.commands[0]} == {Request.LISTEN}
    assert np.all(run.torques() == 0.0)
    assert len(run.sink.rows) == pytest.approx(500, abs=2)
    compensation = run.column("compensation")
    moving = np.abs(run.column("velocity_estimate")) > 0.5
    assert np.all(compensation[moving][100:] * run.column("velocity_estimate")[moving][100:] > 0.0)
    assert run.drives.pending == [None]


def test_a_dry_run_needs_no_room_for_the_path():
    run = Run(axis(limits=LIMITS | {"position": [-0.01, 0.01]}), dry_run=True, duration_s=0.1)
    assert run.result.faults == []


# --- enabling


def test_an_axis_that_waits_for_the_others_does_not_sink():
    """The first axis carries a weight; the second takes half a second to be enabled."""

    def slow(drives):
        pending = drives.pending[1]
        if drives.cycle < 550 and pending is not None:
            drives.pending[1] = None

    heavy = ServoConfig.model_validate({"mechanics": {"load_torque": 0.4, "has_brake": True}})
    run = Run(axis(), axis(node=2), before=slow, servo=heavy, duration_s=0.3)
    assert run.result.faults == []
    waiting = (run.column("state") == LoopState.ENABLING) & (run.column("drive_state") == DriveState.OPERATION_ENABLED)
    assert np.count_nonzero(waiting) > 400
    position = run.column("position")[waiting]
    assert abs(position[-1] - position[0]) < 1e-3
    sent = [command.position for command in run.commands[0]]
    enabled = np.flatnonzero(waiting)
    assert len({sent[k] for k in enabled}) == 1
    assert np.abs(np.diff(sent[enabled[0] : enabled[-1] + 200], 2)).max() < 1e-4  # and it sets off from there


def test_the_velocity_ahead_is_the_demand_when_the_torque_acts():
    """1.5 periods until the middle of the period in which it acts, and the torque's own lag of 0.3 ms."""
    run = Run(duration_s=1.0)
    rows = run.column("state") == LoopState.RUNNING
    t, now, ahead = (run.column(name)[rows] for name in ("time_s", "velocity_demand", "velocity_demand_ahead"))
    np.testing.assert_allclose(ahead[:-5], np.interp(t[:-5] + 1.8e-3, t, now), atol=1e-4)
    delayed = model() | {"mechanics": {"inertia": 2e-4, "delay_s": 4e-3}}
    run = Run(axis(model=delayed), duration_s=1.0)
    ahead = run.column("velocity_demand_ahead")[rows]
    np.testing.assert_allclose(ahead[:-5], np.interp(t[:-5] + 4e-3, t, now), atol=1e-4)
