"""How a run of the loop ends: on request, by a limit, by a fault of a drive, or without feedback."""

import math

import numpy as np
import pytest

from friction_hil.daemon.safety import LoopState
from friction_hil.drive import DriveState, Request
from tests.loop_run import CONTROLLER, LIMITS, MODES, ORDINARY, SINE, STOPPED_BY_FAULT, Drives, Run, axis
from tests.messages import codes_in
from tests.servo_drives import PERIOD_S, configuration, make_loop

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
        feedback[0].velocity = 3.0 if cycle < 599 else 0.0
    else:
        carried.at = feedback[0].position


def jumps(cycle, feedback):
    if 300 <= cycle < 320:
        feedback[0].position += 100.0


def freezes(cycle, feedback):
    """The encoder, from which the drive derives its velocity."""
    if cycle >= 300:
        feedback[0].position, feedback[0].velocity = freezes.at, 0.0
    else:
        freezes.at = feedback[0].position


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize(
    ("limits", "disturb", "words"),
    [
        ({"velocity": 6.0}, slips(8e-3), "[FH-107]"),
        ({"velocity": 6.0}, slips(-8e-3), "[FH-107]"),
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


@pytest.mark.parametrize("mode", ["csv", "cst"])
def test_a_frozen_position_does_not_hide_the_velocity_that_the_drive_reports(mode):
    """6064h is held, 606Ch is true: the axis must not run away unseen."""
    at = []

    def hold(cycle, feedback):
        if cycle >= 300:
            at.append((feedback[0].position, feedback[0].velocity))
            feedback[0].position = at[0][0]

    run = Run(axis(mode, limits=LIMITS | {"following_error": 100.0}), disturb=hold, duration_s=3.0)
    assert "the drive reports a velocity of" in run.result.faults[0]
    assert run.requests() == STOPPED_BY_FAULT
    assert max(abs(velocity) for _, velocity in at) < 1.3 * LIMITS["velocity"]


@pytest.mark.parametrize("part", [0.1, 0.3, 0.5])
def test_lost_feedback_does_not_hide_standstill(part):
    """A tenth, or half, of the cycles bring nothing: the axis is at rest, and disabled soon after it."""
    rng = np.random.default_rng(1)

    def lose(cycle, feedback):
        feedback[0].is_fresh = rng.random() >= part

    plain, lossy = Run(duration_s=0.3), Run(duration_s=0.3, disturb=lose)
    assert lossy.result.faults == []
    assert lossy.result.cycles - plain.result.cycles < 50


def test_notices_of_the_drives_are_recorded_each_time_and_listed_once():
    def say(cycle, feedback):
        if cycle in (100, 200, 300):
            feedback[1].notices += ["emergency 8611h following error", f"in cycle {cycle // 200}"]

    run = Run(axis(), axis(node=2), disturb=say, duration_s=0.4)
    assert run.result.faults == run.result.warnings == []
    told = ["y: emergency 8611h following error", "y: in cycle 0", "y: in cycle 1"]
    assert run.result.notices == told
    assert run.events("notice") == [*told[:2], told[0], told[2], told[0], told[2]]


# --- a drive that is silent


class Unplugged(Drives):
    """The line of a drive is gone: nothing is heard, and nothing can be read back."""

    def receive(self, feedback, end_ns):
        super().receive(feedback, end_ns)
        if self.cycle > 400:
            feedback[0].is_fresh, feedback[0].state = False, DriveState.OPERATION_ENABLED  # the last one reported
            feedback[0].missing = "the line is gone"

    def close(self):
        super().close()
        return (DriveState.UNKNOWN,)


def test_a_drive_whose_line_is_gone_is_unknown_and_nothing_else():
    loop, _, _ = make_loop(configuration(x=axis()), Unplugged(configuration(x=axis())), duration_s=2.0)
    assert loop.run().faults == [
        "x: no usable feedback for more than 10 cycles: the line is gone [FH-103]",
        "x: the state of the drive after the stop is unknown: it may have power [FH-120]",
    ]


def test_only_gaps_that_ended_count_as_bridged_and_the_reasons_are_named():
    busy = "unit 1 refuses: server device busy (exception 6)"
    gaps = {100: (3, busy), 200: (10, "no reply in time"), 300: (1, busy), 400: (100_000, "the line is gone")}

    def lose(cycle, feedback):
        for begin, (length, reason) in gaps.items():
            if begin <= cycle < begin + length:
                feedback[0].is_fresh, feedback[0].missing = False, reason

    run = Run(disturb=lose, duration_s=1.0)
    assert "the line is gone" in run.result.faults[0]
    (one,) = run.axes
    assert (one.gaps.bridged, one.gaps.reasons) == (14, {busy: 4, "no reply in time": 10})
    assert one.gaps.stale > 5000


# --- a drive out of reach


def lost(state=DriveState.UNKNOWN, until=100_000):
    def disturb(cycle, feedback):
        if 300 <= cycle < until:
            one = feedback[0]
            one.is_fresh, one.is_reachable, one.state = False, False, state
            one.message = "node 1 restarted (boot-up message) [FH-231]"

    return disturb


@pytest.mark.parametrize(
    ("state", "longest_s"),
    [(DriveState.UNKNOWN, 1.0), (DriveState.OPERATION_ENABLED, 5.0), (DriveState.SWITCH_ON_DISABLED, 0.0)],
)
def test_a_lost_drive_does_not_keep_the_others_waiting(state, longest_s):
    run = Run(axis(), axis(node=2), disturb=lost(state))
    assert codes_in(run.result.faults[0]) == "x FH-231"
    requests = [command.request for command in run.commands[1]]
    begin = requests.index(Request.QUICK_STOP)
    assert begin == 300
    disabled = requests.index(Request.DISABLE)
    assert disabled - begin < 300, "the healthy axis is disabled as soon as it stands"
    assert longest_s * 1000 <= run.result.cycles - disabled <= longest_s * 1000 + 10
    assert not any("standstill" in fault or "still powered 2 s" in fault for fault in run.result.faults)


def test_a_drive_that_is_back_is_stopped_like_the_others():
    run = Run(axis(), axis(node=2), disturb=lost(until=302))
    assert len(run.result.faults) == 1
    assert run.requests(0) == run.requests(1) == STOPPED_BY_FAULT
    run.assert_left_disabled()


class ReadsBack(Drives):
    """Drives that say in which state they were left."""

    states_at_close: tuple[DriveState, ...] | None = None

    def close(self):
        super().close()
        return self.states_at_close


@pytest.mark.parametrize(
    ("states", "faults"),
    [
        ((DriveState.SWITCH_ON_DISABLED, DriveState.FAULT), []),
        (
            (DriveState.UNKNOWN, DriveState.SWITCH_ON_DISABLED),
            ["x: the state of the drive after the stop is unknown: it may have power [FH-120]"],
        ),
        (
            (DriveState.READY_TO_SWITCH_ON, DriveState.QUICK_STOP_ACTIVE),
            ["y: still powered after the stop: the drive is in quick stop active [FH-116]"],
        ),
        (None, []),  # nothing is read back: the last cycle's feedback counts
    ],
)
def test_the_states_after_the_stop_are_recorded_and_power_is_a_fault(states, faults):
    config = configuration(x=axis(), y=axis(node=2))
    drives = ReadsBack(config)
    drives.states_at_close = states
    loop, sink, _ = make_loop(config, drives, duration_s=0.2)
    result = loop.run()
    assert result.faults == faults
    told = states or (DriveState.SWITCH_ON_DISABLED,) * 2
    assert tuple(result.drive_states) == told
    expected = [f"{name}: {state.words}" for name, state in zip("xy", told, strict=True)]
    assert [text for _, kind, text in sink.events if kind == "drive_state"] == expected


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
    assert codes_in(run.result.faults) == ["y FH-105"]
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
    assert codes_in(run.result.faults) == ["x FH-106"]
    run.assert_left_disabled()


def test_what_the_statusword_says_of_a_drive_that_left_operation_is_told():
    def leaves(cycle, feedback):
        if cycle >= 400:
            feedback[0].state, feedback[0].status = DriveState.SWITCH_ON_DISABLED, "6041h = 0240h: no voltage"
            feedback[0].error = "DC link under-voltage"

    said = "switch on disabled (6041h = 0240h: no voltage; DC link under-voltage) [FH-106]"
    assert Run(disturb=leaves).result.faults == [f"x: the drive left Operation enabled: {said}"]


def test_a_drive_that_is_never_enabled_is_given_up_by_its_name_and_state():
    def refuse(cycle, feedback):
        feedback[1].state = DriveState.SWITCH_ON_DISABLED
        feedback[2].state, feedback[2].error = DriveState.SWITCHED_ON, "DC link undervoltage"

    run = Run(axis(), axis(node=2), axis(node=3), disturb=refuse)
    assert run.result.faults == [
        "y: not enabled within 5 s: the drive is in switch on disabled [FH-114]",
        "z: not enabled within 5 s: the drive is in switched on (DC link undervoltage) [FH-114]",
    ]
    for k in range(3):
        assert run.requests(k) == ORDINARY
        assert np.all(run.torques(k) == 0.0)
    run.assert_left_disabled()


def test_what_the_statusword_says_of_a_drive_that_is_never_enabled_is_told():
    def refuse(cycle, feedback):
        feedback[0].state, feedback[0].status = DriveState.SWITCH_ON_DISABLED, "6041h = 0240h: no voltage"
        feedback[0].error = "DC link under-voltage"

    expected = "the drive is in switch on disabled (6041h = 0240h: no voltage; DC link under-voltage) [FH-114]"
    assert Run(disturb=refuse).result.faults == [f"x: not enabled within 5 s: {expected}"]


def test_a_drive_that_stays_powered_is_told_of():
    def stays(cycle, feedback):
        feedback[0].state = DriveState.OPERATION_ENABLED

    run = Run(disturb=stays, duration_s=0.2)
    text = "x: still powered 2 s after the request to disable: the drive is in operation enabled [FH-116]"
    assert run.result.faults == [text]


def test_what_was_given_up_before_is_not_told_of_another_axis_later():
    """One drive does not enable; the other one, which did, does not switch off either."""

    def differ(cycle, feedback):
        feedback[0].state = DriveState.SWITCH_ON_DISABLED
        feedback[1].state = DriveState.OPERATION_ENABLED

    assert codes_in(Run(axis(), axis(node=2), disturb=differ).result.faults) == ["x FH-114", "y FH-116"]


@pytest.mark.parametrize(
    ("until", "axis_at_fault", "drive"),
    [
        (10_000, "y: ", ": the drive is in quick stop active"),
        (5_270, "", ""),  # at rest in the cycle that gives up, but not for long enough
    ],
)
def test_an_axis_that_its_quick_stop_does_not_stop_is_told_of(until, axis_at_fault, drive):
    def creep(cycle, feedback):
        feedback[1].position += 2e-4 * max(min(cycle, until) - 300, 0)
        if cycle == 300:
            feedback[0].message = "the node has been reset"

    run = Run(axis(), axis(node=2), disturb=creep)
    assert run.result.faults == [
        "x: the node has been reset [FH-118]",
        f"{axis_at_fault}no standstill within 5 s of the quick stop; the request to disable follows{drive} [FH-115]",
    ]


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
    assert codes_in(run.result.faults) == ["x FH-105"]
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


def test_a_reset_of_the_drives_fault_does_not_hide_a_failed_computation():
    def sabotage(axes):
        compensator = axes[0].compensator

        class FailsOnce:
            def step(self, *inputs):
                axes[0].compensator = compensator
                raise ZeroDivisionError("by hand")

            def __getattr__(self, name):
                return getattr(compensator, name)

        axes[0].compensator = FailsOnce()

    run = Run(before=in_fault(), is_fault_reset_wanted=True, on_axes=sabotage, duration_s=0.3)
    assert "x FH-111" in codes_in(run.result.faults)
    assert Request.ENABLE not in run.requests()
    run.assert_left_disabled()


# --- no feedback


def test_without_any_feedback_nothing_is_enabled():
    def silent(cycle, feedback):
        feedback[0].is_fresh = False

    run = Run(disturb=silent)
    assert codes_in(run.result.faults) == ["x FH-101"]
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
    assert run.result.faults[0] == "x: no usable feedback for more than 10 cycles [FH-103]"
    assert run.requests() == STOPPED_BY_FAULT
    # nobody knows that it stands: the drive holds it until the time is up
    stops = run.column("state") == LoopState.FAULT_STOPPING
    assert np.count_nonzero(stops) == pytest.approx(5000, abs=2)
    assert abs(run.drives.servos[0].true_velocity) < 1e-3
    assert np.all(run.column("compensation")[stops][400:] == 0.0)
    run.assert_left_disabled()
