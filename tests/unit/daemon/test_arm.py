"""Feed-forward of an arm, hostile-minded: what is fed in which state and mode, and what a joint that fails brings."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest

from friction_hil.config import load, self_contained
from friction_hil.daemon.control.message import Action, Change, pack
from friction_hil.daemon.control.packed import unpack
from friction_hil.daemon.control.prepare import prepare
from friction_hil.daemon.follower import FollowerAxis
from friction_hil.daemon.safety import MOVING, LoopState
from friction_hil.daemon.static_torque import StaticTorque, static_torque, static_torque_note
from friction_hil.drive import DriveState, Feedback
from friction_hil.errors import UsageError
from tests.arm_machine import ARM, DRIVE_INERTIA, MACHINE, NAMES, Arm, gravity, machine
from tests.loop_run import Fails, heard
from tests.messages import codes_in
from tests.servo_drives import PERIOD_S, ServoDrives

LIMITS = {"torque": (90.0, 25.0), "velocity_gain": (180.0, 42.0)}
HOLD = {"kind": "hold"}
MOVES = {"shoulder": {"kind": "sine", "amplitude": 0.4, "frequency": 0.8}}
MOVES["elbow"] = {"kind": "sine", "amplitude": 0.6, "frequency": 0.8, "phase": -1.2}


def edits(mode="csp", *, still=False, guided=False, **compensation):
    """Changes of the machine: its mode and compensation, limits that suit cst too, and a motion."""
    found = {}
    for k, name in enumerate(NAMES):
        axis = f"axes__{name}"
        found[f"{axis}__compensation"] = {"gain": 1.0, "fade_s": 0.1, **compensation}
        found[f"{axis}__limits__torque"] = LIMITS["torque"][k]
        found[f"{axis}__mode"] = mode
        found[f"{axis}__trajectory"] = HOLD if still else MOVES[name]
        if mode == "cst" and not guided:
            gain = LIMITS["velocity_gain"][k]
            found[f"{axis}__controller"] = {"position_gain": 40.0, "velocity_gain": gain, "integral_hz": 4.0}
        elif mode == "csv":
            found[f"{axis}__controller"] = {"position_gain": 20.0}
        if guided:
            found[f"{axis}__trajectory"] = {"kind": "none"}
            found[f"{axis}__limits__following_error"] = None
    return found


def weights(run):
    """Gravity at the measured positions of each cycle, (n, 2)."""
    return gravity(*run.columns("position").T).T


def assert_safe(run):
    """What is sent is finite, and within limit and slew."""
    sent = run.sent()
    limits = [run.config.axes[name].limits for name in NAMES]
    assert np.isfinite(sent).all()
    assert (np.abs(sent) <= [limit.torque for limit in limits]).all()
    powered = np.isin(run.states[1:], (*MOVING, LoopState.ENABLING, LoopState.FAULT_STOPPING))
    steps = np.abs(np.diff(sent, axis=0))[: powered.size][powered]
    assert (steps <= np.array([limit.torque_slew for limit in limits]) * PERIOD_S * (1.0 + 1e-9)).all()


@pytest.mark.parametrize(("mode", "drive"), [("csp", {}), ("csp", DRIVE_INERTIA), ("csv", {}), ("cst", {})])
def test_what_moves_the_arm_is_fed_ahead_of_all_joints_and_its_gears_load_the_friction(tmp_path, mode, drive):
    config = machine(tmp_path, ARM | {"drive_inertia": drive}, **edits(mode))
    run = Arm(config, duration_s=0.8)
    assert not run.result.faults
    moving = np.isin(run.states, MOVING)
    q, dq, ddq = (
        run.columns(name)[moving] for name in ("position_demand", "velocity_demand_ahead", "acceleration_demand_ahead")
    )
    q = q + [axis.lead_s for axis in run.axes] * dq
    arm = config.arm.dynamics
    whole = arm.inverse_dynamics(q, dq, ddq)
    np.testing.assert_allclose(run.columns("load_torque")[moving], whole - arm.armatures * ddq, rtol=1e-9, atol=1e-9)
    if drive:
        expected = whole - ddq * list(drive.values())
    elif mode == "cst":
        expected = whole
    else:  # the inertia of each joint is left to its drive, whatever that is
        expected = whole - np.diagonal(arm.inertia_matrix(q), axis1=1, axis2=2) * ddq
    np.testing.assert_allclose(run.columns("feedforward")[moving], expected, rtol=1e-9, atol=1e-9)
    assert np.abs(expected - gravity(*q.T).T).max() > 0.5, "more than weight"
    if mode != "cst":
        rest = run.columns("command") - run.columns("compensation") - run.columns("feedforward")
        assert np.abs(rest[moving][100:]).max() < 1e-9
    assert_safe(run)


@pytest.mark.parametrize(("mode", "times"), [("csp", 1.5), ("csv", 1.5), ("cst", 2.0)])
def test_it_follows_better_than_with_the_gravity_of_each_axis_alone(tmp_path, mode, times):
    alone = {
        f"axes__{name}__model__mechanics__gravity": model.model_dump(mode="json")
        for name, model in ((each, axis.model.mechanics.gravity) for each, axis in load(MACHINE).axes.items())
    }
    single, fed = (
        Arm(machine(tmp_path, arm, **edits(mode), **more), duration_s=1.7).error()[400:]
        for arm, more in ((None, alone), (ARM, {}))
    )
    assert (np.std(fed, axis=0) < np.std(single, axis=0)).all()
    assert np.std(fed[:, 1]) < np.std(single[:, 1]) / times


def test_a_drive_that_feeds_inertia_itself_gets_none_twice(tmp_path):
    """The simulated drives do: told that they do not, the daemon doubles it; untold, it leaves it to them."""
    errors = [
        np.std(Arm(machine(tmp_path, ARM | {"drive_inertia": each}, **edits()), duration_s=1.7).error()[400:], axis=0)
        for each in ({}, DRIVE_INERTIA, dict.fromkeys(NAMES, 0.0))
    ]
    assert (errors[0] < 0.6 * errors[2]).all()
    assert (errors[1] < 0.6 * errors[2]).all()


@pytest.mark.parametrize("mode", ["csp", "csv", "cst"])
def test_it_carries_the_weight_from_the_request_to_enable_until_power_is_off(tmp_path, mode):
    """With brakes, that open when the drive is enabled and close when it has no power."""
    run = Arm(machine(tmp_path, **edits(mode, still=True)), duration_s=0.3, power_off_cycles=300)
    assert not run.result.faults
    position, sent, weight = run.columns("position"), run.sent(), weights(run)
    assert np.ptp(position, axis=0).max() < 1e-3
    drive = run.columns("drive_state")
    waits = run.states == LoopState.ENABLING
    assert waits.any()
    enabled = np.flatnonzero(drive[:, 0] == DriveState.OPERATION_ENABLED)
    assert sent[enabled[0] + 1] == pytest.approx(weight[enabled[0] + 1], rel=0.9), "within the slew"
    off = np.flatnonzero((run.states == LoopState.DISABLING) & (drive[:, 0] == DriveState.OPERATION_ENABLED))
    assert off.size > 250
    near = {"csp": 1e-3, "csv": 1e-3, "cst": 3.0}[mode]  # in cst the loop's controller holds what friction takes
    assert np.abs(sent[off[10:]] - weight[off[10:]]).max() < near
    assert (sent[-1] == 0.0).all()
    assert_safe(run)


def test_without_it_the_same_arm_sags(tmp_path):
    """So that the test above can fail."""
    fallen = Arm(machine(tmp_path, None, **edits("csp", still=True)), duration_s=0.3)
    fed = Arm(machine(tmp_path, **edits("csp", still=True)), duration_s=0.3)
    assert np.abs(fed.error()).max() < 0.2 * np.abs(fallen.error()).max()


@pytest.mark.parametrize("mode", ["csp", "csv", "cst"])
def test_a_fault_in_motion_leaves_the_weight_alone_and_no_sag(tmp_path, mode):
    fault = heard(700, message="something is wrong")
    run = Arm(machine(tmp_path, **edits(mode)), duration_s=5.0, disturb=fault, power_off_cycles=200)
    assert len(run.result.faults) == 1
    stopping, disabling = (run.states == each for each in (LoopState.FAULT_STOPPING, LoopState.DISABLING))
    assert stopping.sum() >= 10
    assert disabling.sum() > 150
    assert run.columns("feedforward")[stopping][1:] == pytest.approx(weights(run)[stopping][1:], abs=0.5)
    powered = disabling & (run.columns("drive_state")[:, 0] != DriveState.SWITCH_ON_DISABLED)
    assert powered.sum() > 150
    assert np.ptp(run.columns("position")[disabling], axis=0).max() < 2e-3
    last = np.flatnonzero(powered)[20:]
    assert np.abs(run.sent()[last] - weights(run)[last]).max() < 1e-2, "weight, and no compensation or inertia"
    assert (run.sent()[-1] == 0.0).all()
    assert_safe(run)


def test_guided_by_hand_it_floats(tmp_path):
    """In cst without a controller; friction holds the rest, and without the arm it falls."""
    fed, left = (
        Arm(machine(tmp_path, **edits("cst", guided=True, gravity=each)), duration_s=0.6) for each in (True, False)
    )
    assert np.ptp(fed.columns("position"), axis=0).max() < 2e-3
    position, velocity = left.columns("position"), left.columns("velocity")
    assert np.ptp(position, axis=0).max() > 0.05
    ahead = gravity(*(position + [axis.lead_s for axis in left.axes] * velocity).T).T
    falling = np.isin(left.states, MOVING)
    assert left.columns("load_torque")[falling] == pytest.approx(ahead[falling], abs=0.02)


@pytest.mark.parametrize("value", [math.nan, math.inf, -1e300, 1e4])
@pytest.mark.parametrize("guided", [False, True])
def test_a_joint_without_usable_feedback_counts_where_it_was(tmp_path, value, guided):
    """Some cycles are bridged; more are a fault. What is sent to any joint stays finite, and near the weight."""
    mode = "cst" if guided else "csp"
    for end, has_fault in ((508, False), (540, True)):
        spoilt = heard(500, end, k=1, position=value)
        config = machine(tmp_path, **edits(mode, guided=guided))
        run = Arm(config, duration_s=0.7, disturb=spoilt)
        assert bool(run.result.faults) == has_fault
        fed, load = run.columns("feedforward"), run.columns("load_torque")
        assert np.isfinite(fed).all()
        assert np.isfinite(load).all()
        if not has_fault:
            assert np.abs(np.diff(load[450:600], axis=0)).max() < 0.5
            assert np.abs(np.diff(fed[450:600], axis=0)).max() < 0.5
        assert_safe(run)


def test_a_joint_that_is_silent_is_bridged(tmp_path):
    run = Arm(machine(tmp_path, **edits("cst", guided=True)), disturb=heard(400, 409, is_fresh=False), duration_s=0.7)
    assert not run.result.faults
    assert np.abs(np.diff(run.columns("feedforward")[390:450], axis=0)).max() < 0.5


def test_a_small_limit_leaves_the_friction_its_torque(tmp_path):
    """As the weight of an axis does: what is fed gets what the friction under that load leaves."""
    config = machine(tmp_path, **edits() | {"axes__shoulder__limits__torque": 25.0})
    run = Arm(config, duration_s=0.8)
    fed, load = run.columns("feedforward")[:, 0], run.columns("load_torque")[:, 0]
    moving = np.isin(run.states, MOVING)
    friction = config.axes["shoulder"].model.friction_model
    bound = 25.0 - friction.level - 0.17 * np.abs(load[moving])
    assert (np.abs(fed[moving]) <= np.maximum(bound, 0.0) + 1e-9).all()
    assert (np.abs(fed[moving]) < np.abs(load[moving])).any(), "it does not get all"
    assert_safe(run)


@pytest.mark.parametrize(
    "changes",
    [
        {"axes__elbow__compensation": {"gravity": False}},
        {"axes__elbow__compensation": {"enabled": False}},
        {
            "axes__elbow__compensation": {
                "velocity_offset": {"velocity_gain": 42.0, "integral_hz": 4.0, "limit": 0.2, "slew": 100.0}
            }
        },
    ],
)
def test_an_axis_where_it_is_off_gets_nothing_of_it_and_its_load_is_known_all_the_same(tmp_path, changes):
    config = machine(tmp_path, **edits() | changes)
    run = Arm(config, duration_s=0.5)
    fed, load, moving = run.columns("feedforward"), run.columns("load_torque"), np.isin(run.states, MOVING)
    assert not fed[:, 1].any()
    assert np.abs(fed[moving, 0]).min() > 1.0
    assert np.ptp(load[moving], axis=0).min() > 0.5
    assert_safe(run)
    assert (static_torque_note(config.axes["elbow"], 6.0) == "") == (not run.columns("feedforward")[:, 1].any())


class Master(ServoDrives):
    """Drives that another controller moves: they hold their positions, and say so."""

    is_follower = True

    def connect(self):
        return [replace(each, setpoint_delay_s=1.5 * PERIOD_S) for each in super().connect()]

    def receive(self, feedback, end_ns):
        super().receive(feedback, end_ns)
        for k, one in enumerate(feedback):
            one.state, one.is_offset_wanted = DriveState.OPERATION_ENABLED, True
            one.position_demand = (0.8, 0.7)[k] + 0.2 * math.sin(3.0 * self.cycle * PERIOD_S)
            self.servos[k].command(8, one.position_demand)

    def activate(self, k, servo):
        pass


def test_beside_a_master_nothing_is_fed_and_the_load_is_that_of_its_demand(tmp_path):
    config = machine(tmp_path, **edits())
    axes = {
        name: axis.model_copy(update={"trajectory": axis.trajectory.model_copy(update={"kind": "master"})})
        for name, axis in config.axes.items()
    }
    config = config.model_copy(update={"axes": axes})
    run = Arm(config, drives=Master(config), axis=FollowerAxis, is_follower=True, duration_s=0.6)
    assert not run.result.faults
    assert not run.columns("feedforward").any()
    known = np.isfinite(run.columns("position_demand")).all(axis=1)
    assert known.sum() > 500
    q, dq, ddq = (
        run.columns(name)[known][:-1]  # heard a cycle before
        for name in ("position_demand", "velocity_demand_ahead", "acceleration_demand_ahead")
    )
    arm = config.arm.dynamics
    q = q + [axis.lead_s + PERIOD_S for axis in run.axes] * dq
    expected = arm.inverse_dynamics(q, dq, ddq) - arm.armatures * ddq
    np.testing.assert_allclose(run.columns("load_torque")[known][1:], expected, rtol=1e-9, atol=1e-9)
    assert np.abs(expected - gravity(*q.T).T).max() > 1.0
    assert_safe(run)


def test_a_joint_whose_computation_fails_counts_where_its_drive_is(tmp_path):
    """The others carry what it does to them while all of them stop."""

    def breaks(loop):
        loop._axes[1].compensator = Fails(loop._axes[1].compensator, begin=600)

    wrong = heard(640, 660, k=1, position=-2.0)
    run = Arm(machine(tmp_path, **edits()), duration_s=2.0, on_loop=breaks, disturb=wrong, power_off_cycles=200)
    assert codes_in(run.result.faults) == ["elbow FH-111"]
    after = np.isin(run.states, (LoopState.FAULT_STOPPING, LoopState.DISABLING))
    where = run.columns("position")[:, 0]
    assert np.isfinite(where).all()
    fed = np.array(run.sink.column("shoulder", "feedforward"))[after][5:-5]
    elbow = run.drives.servos[1].position
    weight = gravity(where[after][5:-5], elbow)[0]
    assert fed[-50:] == pytest.approx(weight[-50:], abs=0.05)
    assert np.abs(np.diff(fed)).max() < 0.5, "what its drive says has to be possible"
    assert_safe(run)


@pytest.mark.parametrize(("failures", "most"), [(math.inf, 3.0), (1, 0.3)])
def test_where_the_computation_of_the_arm_itself_fails_its_weight_stays(tmp_path, failures, most):
    def breaks(loop):
        find, calls = loop._arm._find, itertools.count()
        loop._arm._find = lambda *given: 1 / 0 if 600 <= next(calls) < 600 + failures else find(*given)

    run = Arm(machine(tmp_path, **edits()), duration_s=2.0, on_loop=breaks, power_off_cycles=200)
    assert codes_in(run.result.faults) == ["arm FH-111"]
    assert all(axis.is_arm_lost for axis in run.axes)
    disabling = run.states == LoopState.DISABLING
    assert np.abs(run.sent()[np.flatnonzero(disabling)[20:100]] - weights(run)[disabling][20:100]).max() < most
    assert (run.sent()[-1] == 0.0).all()
    assert_safe(run)


def test_after_such_a_failure_nothing_is_started_again(tmp_path):
    """As after that of an axis: what is fed would be that of another pose."""
    said = []

    def starts(loop):
        run = loop._run
        run._machine.state, run._is_paused = LoopState.WAITING, True
        heard = [Feedback(position=0.8, is_fresh=True), Feedback(position=0.7, is_fresh=True)]
        for axis, one in zip(loop._axes, heard, strict=True):
            axis.supervisor.take(one)
        loop._axes[1].is_arm_lost = True
        said.append(run.start(heard))
        loop._axes[1].is_arm_lost = False
        said.append(run.start(heard))
        run._machine.state = LoopState.IDLE

    Arm(machine(tmp_path, **edits()), duration_s=0.01, on_loop=starts)
    assert said == ["elbow: its computation has failed: start the daemon again", ""]


def test_a_torque_that_is_no_number_stays_what_it_was(tmp_path):
    config = machine(tmp_path, **edits())

    def breaks(loop):
        axis = loop._axes[0]
        usual, calls = type(axis).arm_motion, iter(range(10**6))

        class Odd(type(axis)):
            __slots__ = ()

            def arm_motion(self, *given):
                motion = usual(self, *given)
                return motion if not 500 <= next(calls) < 520 else (motion[0], math.nan, 1e308)

        loop._axes[0].__class__ = Odd

    run = Arm(config, duration_s=0.8, on_loop=breaks)
    assert not run.result.faults
    for name in ("feedforward", "load_torque"):
        assert np.isfinite(run.columns(name)).all()
    assert_safe(run)


def test_the_order_of_axes_and_one_that_is_in_no_arm_change_nothing(tmp_path):
    arm = ARM | {"joints": dict(reversed(ARM["joints"].items()))}
    first, second = (Arm(machine(tmp_path, each, **edits()), duration_s=0.4) for each in (ARM, arm))
    for name in ("feedforward", "load_torque", "position"):
        np.testing.assert_allclose(first.columns(name), second.columns(name), rtol=1e-9, atol=1e-9)
    single = ARM | {"joints": {"shoulder": "joint1"}, "rotor_inertia": {}, "locked": {"joint2": 0.7}}
    run = Arm(machine(tmp_path, single, **edits(still=True)), duration_s=0.3)
    assert np.isnan(run.columns("load_torque")[:, 1]).all()
    assert not run.columns("feedforward")[:, 1].any()
    running = run.states == LoopState.RUNNING
    assert run.columns("feedforward")[running, 0] == pytest.approx(gravity(0.8, 0.7)[0], rel=1e-3)


def change(config, values):
    facts = ServoDrives(config).connect()
    prepared = prepare(self_contained(config), "test", values, facts, {}, has_network=False)
    return prepared.axes[list(config.axes).index("elbow")].static


def test_a_change_while_it_runs_knows_that_the_axis_is_of_an_arm(tmp_path):
    config = machine(tmp_path, **edits())
    elbow = static_torque(config.axes["elbow"], is_of_arm=True)
    level = config.axes["elbow"].model.friction_model.level
    assert (elbow.bound, elbow.per_load) == (pytest.approx(25.0 - level), 0.17)
    assert change(config, {"elbow.gravity": False}).bound == 0.0
    half = change(config, {"elbow.gain": 0.5})
    assert (half.bound, half.per_load) == (pytest.approx(25.0 - 0.5 * level), 0.085)
    for values in ({"elbow.adaptation": {}}, {"elbow.model": heavy(config)}):
        with pytest.raises(UsageError, match=r"elbow\.(adaptation|model\.mechanics\.gravity)"):
            change(config, values)


def heavy(config):
    model = config.axes["elbow"].model.model_dump(mode="json")
    return model | {"mechanics": model["mechanics"] | {"gravity": {"constant": 0.0, "sine": 6.0, "cosine": 0.0}}}


@pytest.mark.parametrize("wrong", [{"per_load": -1.0}, {"per_load": math.nan}, {"bound": 99.0}])
def test_a_change_is_sent_whole_or_refused(tmp_path, wrong):
    config = machine(tmp_path, **edits())
    run = Arm(config, duration_s=0.01)
    records = [axis.compensator.record for axis in run.axes]
    facts = run.drives.connect()
    axes = prepare(self_contained(config), "test", {"elbow.gain": 0.5}, facts, {}, has_network=False).axes
    sent = unpack(pack(Change(1, Action.NONE, axes)), records)
    assert sent.axes[1].static == axes[1].static
    axes[1] = replace(axes[1], static=axes[1].static._replace(**wrong))
    with pytest.raises(ValueError, match="feed-forward"):
        unpack(pack(Change(1, Action.NONE, axes)), records)


def test_the_bound_shrinks_with_the_load_and_never_turns_round():
    static = StaticTorque(10.0, 0.0, 0.0, 0.0, 0.0, per_load=0.5)
    assert [static.at(0.0, each, each) for each in (2.0, 8.0, -8.0, 30.0)] == [2.0, 6.0, -6.0, 0.0]
    assert static.at(math.nan, 2.0, 2.0) == 0.0
    assert static._replace(bound=0.0).at(0.0, 2.0, 2.0) == 0.0
