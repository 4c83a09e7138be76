"""The command of one axis, cycle by cycle: torque and set-point in each mode and state, and the last limit."""

import itertools
import math
from types import SimpleNamespace

import pytest

from friction_hil.daemon.assembly import make_velocity_offset
from friction_hil.daemon.command import CommandWriter
from friction_hil.daemon.safety import MOVING, LoopState, SafetyLimits
from friction_hil.daemon.static_torque import StaticTorque
from friction_hil.drive import AxisFacts, Command, DriveState, Feedback
from friction_hil.motion.trajectory import Setpoint
from tests.servo_drives import PERIOD_S, axis_dict, configuration

ENABLED, OFF = DriveState.OPERATION_ENABLED, DriveState.SWITCH_ON_DISABLED
STEP = 0.1  # N m in a period
FACTS = AxisFacts("x", "", 1e-6, 1e-4, 2.5e-3, 1.5e-3)
WEIGHT, FRICTION = 0.25, 0.5  # N m
GAINS = {"position_gain": 20.0, "velocity_gain": 0.05, "integral_hz": 0.0}
CONTROLLERS = {"csp": {}, "csv": {"controller": {"position_gain": 20.0}}, "cst": {"controller": GAINS}}
RUNNING, FAULT_STOPPING, DISABLING = LoopState.RUNNING, LoopState.FAULT_STOPPING, LoopState.DISABLING
ENABLING, FIRST_MOTION = LoopState.ENABLING, LoopState.FIRST_MOTION
RESTING = [state for state in LoopState if state not in MOVING]


class Axis:
    """One axis; each call of `write` is a cycle."""

    def __init__(self, mode="csp", weight=WEIGHT, slew=STEP / PERIOD_S, sent=None, velocity=30.0):
        config = configuration(x=axis_dict(mode=mode, **CONTROLLERS[mode])).axes["x"]
        path = SimpleNamespace(has_setpoint=True, to_send=lambda time_s: sent)  # demands always the same
        self.writer = CommandWriter(config, SafetyLimits(1.0, velocity, slew), path, PERIOD_S, 0.0)
        if weight:  # without a fade from what was before
            self.writer.adopt(level(weight), 0.0, 0.0)
            self.writer.adopt(level(weight), PERIOD_S, 0.0)
            self.write(LoopState.IDLE)
            self.write(LoopState.IDLE)

    def write(
        self, state, drive=ENABLED, position=0.0, velocity=0.0, now=None, compensation=FRICTION, is_lost=False, cycles=1
    ):
        feedback = Feedback(state=drive)
        feedback.is_setpoint_lost = is_lost
        for _ in range(cycles):
            command = Command(velocity=77.0, position=88.0)
            self.writer.write(command, state, 0.0, position, velocity, now, compensation, feedback)
        return command

    def torques(self, state, count, **what):
        return [self.write(state, **what).torque for _ in range(count)]


def level(torque):
    return StaticTorque(10.0, torque, 0.0, 0.0, 0.0)


def at(position=0.0, velocity=0.0, acceleration=0.0):
    return Setpoint(position, velocity, acceleration)


def test_a_velocity_offset_has_its_own_limit_and_goes_to_zero_where_the_axis_is_not_to_move():
    loop = {"velocity_gain": 0.1, "integral_hz": 10.0, "limit": 2.0, "slew": 500.0}
    config = configuration(x=axis_dict(compensation={"velocity_offset": loop})).axes["x"]
    offset = make_velocity_offset(config, FACTS, PERIOD_S)
    writer = CommandWriter(config, SafetyLimits(1.0, 30.0, 1.0), None, PERIOD_S, 0.0, offset)

    def sent(state, wanted, drive=ENABLED, is_lost=False):
        feedback, command = Feedback(state=drive, is_setpoint_lost=is_lost), Command()
        writer.write_velocity_offset(command, state, wanted, feedback)
        return command.velocity_offset

    assert [sent(RUNNING, 9.0) for _ in range(5)] == [0.5, 1.0, 1.5, 2.0, 2.0]
    assert sent(RUNNING, math.nan) == 1.5
    assert sent(RUNNING, 1.0, is_lost=True) == 1.5, "the drive may have 2.0 still"
    assert [sent(FAULT_STOPPING, 1.0), sent(FAULT_STOPPING, 1.0, DriveState.UNKNOWN)] == [1.0, 1.0]
    assert [sent(FAULT_STOPPING, 1.0, OFF), sent(FAULT_STOPPING, 1.0, OFF)] == [0.5, 0.0]
    sent(RUNNING, 0.5)
    assert [sent(state, 0.5) for state in RESTING if state is not FAULT_STOPPING] == [0.0] * (len(RESTING) - 1)


def test_a_shifted_set_point_is_sent_while_the_axis_moves_and_the_shift_begins_anew():
    loop = {"velocity_gain": 0.1, "integral_hz": 10.0, "limit": 2.0, "slew": 500.0}
    loop |= {"position_gain": 10.0, "velocity_feedforward": 0.0}
    config = configuration(x=axis_dict(compensation={"velocity_offset": loop})).axes["x"]
    offset = make_velocity_offset(config, FACTS, PERIOD_S)
    writer = CommandWriter(config, SafetyLimits(1.0, 30.0, 1.0), None, PERIOD_S, 0.0, offset)

    def sent(state, wanted):
        command = Command(position=3.0)
        writer.write_velocity_offset(command, state, wanted, Feedback(state=ENABLED))
        return command.position, command.velocity_offset

    assert [sent(RUNNING, 9.0) for _ in range(2)] == [(pytest.approx(3.05), 0.0), (pytest.approx(3.1), 0.0)]
    for state in RESTING:
        assert [sent(state, 9.0) for _ in range(9)] == [(3.0, 0.0)] * 9
    assert sent(RUNNING, 0.0)[0] == pytest.approx(3.0)
    assert sent(RUNNING, 9.0)[0] == pytest.approx(3.05)


@pytest.mark.parametrize("state", [RUNNING, FAULT_STOPPING, ENABLING])
def test_what_an_arm_needs_is_fed_as_a_weight_is_within_what_its_load_leaves(state):
    axis = Axis(weight=0.0, slew=1e6)
    writer = axis.writer
    assert (writer.arm_torque, writer.arm_load, writer.static) == (0.0, 0.0, 0.0)
    writer.adopt(StaticTorque(0.8, 0.1, 0.0, 0.0, 0.0, per_load=0.5), 0.0, 0.0)
    found = []
    for torque, load in ((0.2, 0.3), (0.9, 0.4), (-0.9, -0.4), (0.9, 9.0)):
        writer.arm_torque, writer.arm_load = torque, load
        sent = axis.write(state, compensation=0.0).torque
        assert sent == writer.static
        found.append(sent)
    assert found == pytest.approx([0.3, 0.6, -0.6, 0.0])


@pytest.mark.parametrize("is_compiled", [False, True])
@pytest.mark.parametrize("mode", ["csp", "csv", "cst"])
def test_the_torque_rises_from_zero_by_a_step_in_each_period(mode, is_compiled):
    axis = Axis(mode, weight=0.0)
    assert (axis.writer.offset_sent, axis.writer.effort) == ((0.0, 0.0), 0.0)
    if is_compiled:
        axis.writer.compile()
    assert axis.torques(RUNNING, 7) == pytest.approx([0.1, 0.2, 0.3, 0.4, 0.5, 0.5, 0.5])
    assert axis.torques(RUNNING, 3, compensation=math.nan) == pytest.approx([0.4, 0.3, 0.2])
    assert axis.torques(RUNNING, 20, compensation=7.0)[-1] == 1.0


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_after_a_lost_command_the_torque_is_within_a_step_of_each_that_the_drive_may_have(sign):
    axis = Axis(weight=0.0)
    assert axis.write(RUNNING, compensation=-sign, is_lost=True).torque == pytest.approx(-sign * STEP)
    axis = Axis(weight=0.0)
    assert axis.write(RUNNING, compensation=sign).torque == pytest.approx(sign * STEP)
    assert axis.write(RUNNING, compensation=-sign, is_lost=True).torque == pytest.approx(0.0)
    assert axis.write(RUNNING, compensation=sign, is_lost=True).torque == pytest.approx(sign * STEP)
    assert axis.write(RUNNING, compensation=sign, is_lost=True).torque == pytest.approx(sign * STEP)
    assert axis.write(RUNNING, compensation=sign).torque == pytest.approx(sign * 2.0 * STEP), "that one has arrived"


@pytest.mark.parametrize("state", [LoopState.IDLE, LoopState.WAITING, LoopState.DONE])
def test_an_axis_that_is_not_in_use_gets_no_torque_at_once(state):
    axis = Axis()
    axis.write(RUNNING, cycles=20)
    assert axis.write(state).torque == 0.0
    assert axis.write(RUNNING).torque == pytest.approx(STEP), "the next one begins at zero again"


@pytest.mark.parametrize("state", [ENABLING, FIRST_MOTION])
@pytest.mark.parametrize("drive", [ENABLED, OFF])
def test_an_axis_that_is_being_enabled_gets_its_weight_and_no_compensation(state, drive):
    axis = Axis()
    axis.write(state, drive, cycles=20)
    assert axis.write(state, drive).torque == pytest.approx(WEIGHT)


@pytest.mark.parametrize("mode", ["csp", "csv", "cst"])
@pytest.mark.parametrize("drive", DriveState)
def test_while_it_is_stopped_the_torque_stays_only_as_long_as_the_drive_may_have_power(drive, mode):
    """The compensation fades by itself after a fault; a request to disable ends it."""
    left = {FAULT_STOPPING: WEIGHT + FRICTION, DISABLING: WEIGHT}
    for state, torque in left.items():
        axis = Axis(mode)
        assert axis.torques(RUNNING, 20)[-1] == pytest.approx(WEIGHT + FRICTION)
        may_have_power = drive is DriveState.UNKNOWN or drive.is_powered
        seen = [WEIGHT + FRICTION, *axis.torques(state, 20, drive=drive)]
        assert seen[-1] == pytest.approx(torque if may_have_power else 0.0)
        assert all(abs(one - before) <= STEP + 1e-9 for before, one in itertools.pairwise(seen))


def test_the_weight_is_that_of_the_demanded_path_and_else_of_the_axis():
    weight, quarter = StaticTorque(10.0, 0.0, 0.0, 0.3, 0.0), 0.5 * math.pi
    axis, other = Axis(weight=0.0, slew=math.inf), Axis("cst", weight=0.0, slew=math.inf)
    axis.writer.adopt(weight, 0.0, 2.0)
    for one in (axis, other):
        one.writer.adopt(weight, PERIOD_S, 2.0)
        one.write(LoopState.IDLE, cycles=2)
    assert axis.write(ENABLING, position=0.5 * quarter, velocity=0.25 * quarter).torque == pytest.approx(0.3)
    other.writer.most = 0.0
    there = at(0.5 * quarter, 0.25 * quarter)
    assert other.write(RUNNING, now=there, compensation=0.0).torque == pytest.approx(0.3)


def test_another_feed_forward_comes_without_a_step_and_is_all_there_is_after_its_fade():
    axis = Axis(weight=0.0, slew=math.inf)
    assert axis.torques(ENABLING, 2) == [0.0, 0.0]
    axis.writer.adopt(level(0.5), 5.0 * PERIOD_S, 0.0)
    assert axis.torques(ENABLING, 8) == pytest.approx([0.0, 0.1, 0.2, 0.3, 0.4, 0.5, 0.5, 0.5])
    axis.writer.adopt(level(-0.5), 5.0 * PERIOD_S, 0.0)
    assert axis.torques(ENABLING, 8) == pytest.approx([0.5, 0.3, 0.1, -0.1, -0.3, -0.5, -0.5, -0.5])
    other = Axis(weight=0.0, slew=math.inf)
    other.writer.adopt(level(0.5), 5.0 * PERIOD_S, 0.0)
    assert other.torques(ENABLING, 3) == pytest.approx([0.0, 0.1, 0.2]), "before the first cycle too"


@pytest.mark.parametrize("drive", [ENABLED, DriveState.SWITCHED_ON])
@pytest.mark.parametrize("state", RESTING)
@pytest.mark.parametrize("mode", ["csp", "csv", "cst"])
def test_the_set_point_follows_the_axis_except_where_it_waits_with_power(mode, state, drive):
    """Following itself under a weight it would sink; held while something else moves it, it would jump later."""
    axis = Axis(mode)
    axis.write(LoopState.IDLE, OFF, position=0.1)
    command = axis.write(state, drive, position=0.2)
    kept = {(FIRST_MOTION, "csp"), (FIRST_MOTION, "cst")} | ({(ENABLING, "csp")} if drive is ENABLED else set())
    assert command.position == (0.1 if (state, mode) in kept else 0.2)
    assert command.velocity == 0.0
    assert axis.writer.held_position == command.position


@pytest.mark.parametrize("mode", ["csp", "csv", "cst"])
def test_an_axis_that_never_moved_or_waited_for_the_others_is_not_held_while_it_is_disabled(mode):
    assert Axis(mode, weight=0.0).write(DISABLING, position=0.2).position == 0.2
    waited = Axis("csp")
    waited.write(FIRST_MOTION)
    assert waited.write(DISABLING, position=0.2).position == 0.2


def test_in_csp_the_last_set_point_of_a_motion_stays_until_the_drive_has_no_power():
    axis = Axis("csp", sent=at(0.3))
    assert axis.write(RUNNING, now=at(0.3), position=0.299).position == 0.3
    assert [axis.write(DISABLING, position=0.299 - 1e-3 * k).position for k in range(3)] == [0.3] * 3
    assert axis.write(DISABLING, OFF, position=0.2).position == 0.2
    assert axis.write(DISABLING, position=0.1).position == 0.1, "once over, it stays over"
    axis.write(RUNNING, now=at(0.3), position=0.299)
    axis.write(FAULT_STOPPING, position=0.25)
    assert axis.write(DISABLING, position=0.25).position == 0.25, "a fault ends it"


def torque_of(error=0.0, speed=0.0):
    return GAINS["velocity_gain"] * (GAINS["position_gain"] * error + speed)


@pytest.mark.parametrize("is_compiled", [False, True])
@pytest.mark.parametrize("before", [None, LoopState.IDLE, ENABLING])
def test_in_cst_the_torque_is_that_of_the_controller_from_the_first_cycle_on(before, is_compiled):
    axis = Axis("cst", weight=0.0, slew=math.inf)
    if is_compiled:
        axis.writer.compile()
    if before is not None:
        axis.write(before, cycles=3)
    seen = axis.write(RUNNING, now=at(0.3, 1.0), velocity=0.5, compensation=0.0).torque
    assert seen == pytest.approx(torque_of(0.3, 0.5))
    assert axis.writer.effort == seen
    assert axis.write(RUNNING, now=None, compensation=0.2).torque == pytest.approx(0.2), "without a path: no controller"


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_controller_and_compensation_stay_within_their_bound_in_both_directions(sign):
    axis = Axis("cst", slew=math.inf)
    axis.writer.most = 0.1
    assert axis.write(RUNNING, now=at(0.4 * sign), compensation=0.0).torque == pytest.approx(0.1 * sign + WEIGHT)
    assert axis.writer.effort == pytest.approx(0.1 * sign)
    assert axis.write(RUNNING, now=at(), compensation=0.05 * sign).torque == pytest.approx(0.05 * sign + WEIGHT)
    waiting = Axis("cst", slew=math.inf)
    waiting.writer.most = 0.1
    waiting.write(ENABLING)
    assert waiting.write(FIRST_MOTION, position=-0.4 * sign).torque == pytest.approx(0.1 * sign + WEIGHT)


def test_in_cst_the_controller_holds_the_axis_until_the_drive_has_no_power():
    """Where it came to rest: neither a step of torque, nor a motion towards the set-point."""
    axis = Axis("cst", slew=math.inf)
    before = axis.write(RUNNING, now=at(0.3), compensation=0.0).torque
    assert before == pytest.approx(WEIGHT + torque_of(0.3))
    assert axis.torques(DISABLING, 5) == pytest.approx([before] * 5)
    assert axis.write(DISABLING, position=0.1).torque == pytest.approx(before - torque_of(0.1))
    assert axis.write(DISABLING, position=0.1).position == 0.0
    assert axis.write(DISABLING, DriveState.SWITCHED_ON).torque == 0.0
    assert axis.write(DISABLING, position=0.1).torque == pytest.approx(WEIGHT), "once over, it stays over"


def test_a_fault_ends_the_controller_and_an_axis_that_waited_in_cst_is_disabled_without_a_step():
    axis, waited = Axis("cst", slew=math.inf), Axis("cst", slew=math.inf)
    axis.write(RUNNING, now=at(0.3), compensation=0.0)
    assert axis.write(FAULT_STOPPING, compensation=0.0).torque == pytest.approx(WEIGHT)
    assert axis.write(DISABLING).torque == pytest.approx(WEIGHT)
    waited.write(ENABLING)
    assert waited.torques(FIRST_MOTION, 2) == pytest.approx([WEIGHT] * 2)
    assert waited.write(FIRST_MOTION, position=-0.1).torque == pytest.approx(WEIGHT + torque_of(0.1))
    assert waited.torques(DISABLING, 3) == pytest.approx([WEIGHT] * 3)


def test_in_csp_what_is_sent_is_the_path_with_the_offset_of_the_motor():
    axis = Axis("csp", sent=at(0.5, 2.0))
    axis.writer.offset_sent = (0.25, 1.0)
    command = axis.write(RUNNING, now=at(0.4, 2.0), position=9.0)
    assert (command.position, command.velocity) == (0.75, 3.0)
    command = axis.write(RUNNING, now=None)
    assert (command.position, command.velocity) == (88.0, 0.0), "without a path nothing is written"


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize(
    ("speed", "error", "expected"),
    [(2.0, 0.1, 4.0), (2.0, 2.0, 6.0), (0.0, 2.0, 5.0), (10.0, 2.0, 10.0), (20.0, 2.0, 10.0), (2.0, -2.0, -6.0)],
)
def test_in_csv_the_velocity_follows_the_position_within_half_of_what_the_path_leaves(speed, error, expected, sign):
    axis = Axis("csv", sent=at(0.5, sign * speed), velocity=10.0)
    command = axis.write(RUNNING, now=at(sign * error))
    assert command.velocity == pytest.approx(sign * expected)
