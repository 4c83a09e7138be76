"""How a run of the loop ends: on request, by a limit, by a fault of a drive, or without feedback."""

import math
import re

import numpy as np
import pytest

from friction_hil.daemon.safety import LoopState
from friction_hil.drive import DriveState, Request
from tests.loop_run import (
    CONTROLLER,
    LIMITS,
    MODES,
    ORDINARY,
    SINE,
    STOPPED_BY_FAULT,
    Fails,
    Run,
    axis,
    heard,
    in_state,
)
from tests.messages import codes_in
from tests.servo_drives import PERIOD_S


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("stop_at", [30, 60, 200, 700])
def test_a_stop_request_brings_the_axis_to_rest_without_a_step(mode, stop_at):
    run = Run(axis(mode), stop_at=stop_at)
    asked = run.requests()
    assert Request.QUICK_STOP not in asked
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
    assert np.count_nonzero(run.column("state") == LoopState.RUNNING) == pytest.approx(700, abs=1)
    assert run.events() == ["enabling", "running", "stopping", "disabling", "done"]
    assert run.result.cycles == len(run.sink.rows)
    np.testing.assert_allclose(run.column("time_s"), run.column("cycle") * PERIOD_S)


def slips(per_cycle):
    """The encoder slips for a while."""

    def disturb(cycle, feedback):
        feedback[0].position += per_cycle * (min(max(cycle, 300), 400) - 300)

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
    ("limits", "disturb", "code"),
    [
        ({"velocity": 6.0}, slips(8e-3), "x FH-107"),
        ({"velocity": 6.0}, slips(-8e-3), "x FH-107"),
        ({"following_error": 0.05}, freezes, "x FH-109"),
        ({"position": [-0.5, 0.5], "following_error": 10.0}, carried, "x FH-108"),
        ({"velocity": 6.0}, jumps, "x FH-104"),
    ],
)
def test_each_limit_is_a_fault_that_ends_in_quick_stop_then_disabled(mode, limits, disturb, code):
    run = Run(axis(mode, limits=LIMITS | limits), disturb=disturb, duration_s=3.0, faults=None)
    assert code in codes_in(run.result.faults)
    assert run.requests() == STOPPED_BY_FAULT
    assert "fault_stopping" in run.events()
    assert run.events("fault") == run.result.faults
    run.assert_within_limits()


def test_in_cst_the_torque_of_the_loops_own_control_ramps_down_after_a_fault_too():
    limits = LIMITS | {"torque": 0.6, "torque_slew": 20.0, "following_error": 0.15}
    run = Run(axis("cst", controller=CONTROLLER | {"velocity_gain": 0.1}, limits=limits), disturb=freezes, faults=None)
    assert codes_in(run.result.faults[0]) == "x FH-109"
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

    run = Run(axis(mode, limits=LIMITS | {"following_error": 100.0}), disturb=hold, duration_s=3.0, faults=None)
    assert "the drive reports a velocity of" in run.result.faults[0]
    assert run.requests() == STOPPED_BY_FAULT
    assert max(abs(velocity) for _, velocity in at) < 1.3 * LIMITS["velocity"]


@pytest.mark.parametrize("part", [0.1, 0.5])
def test_lost_feedback_does_not_hide_standstill(part):
    """A tenth, or half, of the cycles bring nothing: the axis is at rest, and disabled soon after it."""
    rng = np.random.default_rng(1)

    def lose(cycle, feedback):
        feedback[0].is_fresh = rng.random() >= part

    lossy = Run(duration_s=0.3, disturb=lose)
    assert lossy.result.cycles - Run(duration_s=0.3).result.cycles < 50


def test_notices_of_the_drives_are_recorded_each_time_and_listed_once():
    def say(cycle, feedback):
        if cycle in (100, 200, 300):
            feedback[1].notices += ["emergency 8611h following error", f"in cycle {cycle // 200}"]

    run = Run(axis(), axis(node=2), disturb=say, duration_s=0.4)
    assert run.result.warnings == []
    told = ["y: emergency 8611h following error", "y: in cycle 0", "y: in cycle 1"]
    assert run.result.notices == told
    assert run.events("notice") == [*told[:2], told[0], told[2], told[0], told[2]]


def reads_back(*states):
    """Drives that say in which states they were left."""
    return lambda drives: setattr(drives, "read_back", states or None)


@pytest.mark.parametrize(
    ("states", "faults"),
    [([DriveState.UNKNOWN], ["x FH-103", "x FH-120"]), ([], ["x FH-103"])],
    ids=["read back", "not"],
)
def test_a_drive_whose_line_is_gone_is_unknown_and_nothing_else(states, faults):
    gone = {"is_fresh": False, "state": DriveState.OPERATION_ENABLED, "missing": "the line is gone"}  # the last state
    run = Run(disturb=heard(400, **gone), before=reads_back(*states), duration_s=2.0, faults=faults)
    assert "the line is gone" in run.result.faults[0]
    assert run.result.drive_states == [DriveState.UNKNOWN]


def test_only_gaps_that_ended_count_as_bridged_and_the_reasons_are_named():
    gaps = {100: (3, "busy"), 200: (10, "no reply"), 300: (1, "busy"), 400: (100_000, "the line is gone")}

    def lose(cycle, feedback):
        for begin, (length, reason) in gaps.items():
            if begin <= cycle < begin + length:
                feedback[0].is_fresh, feedback[0].missing = False, reason

    run = Run(disturb=lose, duration_s=1.0, faults=None)
    assert "the line is gone" in run.result.faults[0]
    gaps = run.axes[0].gaps
    assert (gaps.bridged, gaps.reasons) == (14, {"busy": 4, "no reply": 10})
    assert gaps.stale > 5000


def lost(state=DriveState.UNKNOWN, until=100_000):
    message = "node 1 restarted (boot-up message) [FH-231]"
    return heard(300, until, is_fresh=False, is_reachable=False, state=state, message=message)


@pytest.mark.parametrize(
    ("state", "longest_s"),
    [(DriveState.UNKNOWN, 1.0), (DriveState.OPERATION_ENABLED, 5.0), (DriveState.SWITCH_ON_DISABLED, 0.0)],
)
def test_a_lost_drive_does_not_keep_the_others_waiting(state, longest_s):
    run = Run(axis(), axis(node=2), disturb=lost(state), faults=None)
    assert codes_in(run.result.faults[0]) == "x FH-231"
    requests = [command.request for command in run.commands[1]]
    begin = requests.index(Request.QUICK_STOP)
    assert begin == 300
    disabled = requests.index(Request.DISABLE)
    assert disabled - begin < 300, "the healthy axis is disabled as soon as it stands"
    assert longest_s * 1000 <= run.result.cycles - disabled <= longest_s * 1000 + 10
    assert not any("standstill" in fault or "still powered 2 s" in fault for fault in run.result.faults)


def test_a_drive_that_is_back_is_stopped_like_the_others():
    run = Run(axis(), axis(node=2), disturb=lost(until=302), faults=["x FH-231"])
    assert run.requests(0) == run.requests(1) == STOPPED_BY_FAULT


@pytest.mark.parametrize(
    ("states", "faults"),
    [
        ((DriveState.SWITCH_ON_DISABLED, DriveState.FAULT), []),
        ((DriveState.UNKNOWN, DriveState.SWITCH_ON_DISABLED), ["x FH-120"]),
        ((DriveState.READY_TO_SWITCH_ON, DriveState.QUICK_STOP_ACTIVE), ["y FH-116"]),
        ((), []),  # nothing is read back: the last cycle's feedback counts
    ],
)
def test_the_states_after_the_stop_are_recorded_and_power_is_a_fault(states, faults):
    run = Run(axis(), axis(node=2), before=reads_back(*states), duration_s=0.2, faults=faults)
    told = states or (DriveState.SWITCH_ON_DISABLED,) * 2
    assert tuple(run.result.drive_states) == told
    assert run.events("drive_state") == [f"{name}: {state.words}" for name, state in zip("xy", told, strict=True)]


def test_a_path_that_leaves_the_limits_is_refused_before_anything_is_enabled():
    limits = LIMITS | {"position": [-0.5, 0.5]}
    Run(axis(limits=limits), duration_s=0.1)
    run = Run(axis(limits=limits), disturb=heard(position=0.4), faults=None)
    (fault,) = run.result.faults
    assert re.match("x: from 0.4 rad .* from 0.1 to 0.7 rad", fault)
    assert Request.ENABLE not in run.requests()


def test_a_drive_fault_in_motion_stops_all_axes_and_is_not_reset():
    run = Run(
        axis(),
        axis(node=2),
        before=in_state(DriveState.FAULT, 400, k=1),
        is_fault_reset_wanted=True,
        faults=["y FH-105"],
    )
    assert run.requests(0) == run.requests(1) == STOPPED_BY_FAULT
    speed = np.abs(run.column("velocity_estimate"))
    assert speed[400] > 0.3  # the healthy axis was brought to rest before it was disabled
    assert speed[run.column("state") == LoopState.DISABLING].max() <= 0.03


def held_in(*states, begin=0):
    """Drives that are in other states than the loop wants, None for as it wants, with what their statuswords say."""

    def disturb(cycle, feedback):
        for one, state in zip(feedback, states, strict=False):
            if state is not None and cycle >= begin:
                one.state, one.status, one.error = state, "6041h = 0240h", "DC link under-voltage"

    return disturb


SAID = "(6041h = 0240h; DC link under-voltage)"


@pytest.mark.parametrize("state", [DriveState.SWITCHED_ON, DriveState.SWITCH_ON_DISABLED])
def test_a_drive_that_leaves_operation_enabled_by_itself_is_a_fault_that_says_why(state):
    run = Run(disturb=held_in(state, begin=400), faults=["x FH-106"])
    assert f"{state.words} {SAID}" in run.result.faults[0]


def test_a_drive_that_is_never_enabled_is_given_up_by_its_name_and_state():
    states = None, DriveState.SWITCH_ON_DISABLED, DriveState.SWITCHED_ON
    run = Run(axis(), axis(node=2), axis(node=3), disturb=held_in(*states), faults=["y FH-114", "z FH-114"])
    for state, fault in zip(states[1:], run.result.faults, strict=True):
        assert "within 5 s" in fault
        assert f"{state.words} {SAID}" in fault
    for k in range(3):
        assert run.requests(k) == ORDINARY
        assert np.all(run.torques(k) == 0.0)


def test_a_drive_that_stays_powered_is_told_of_and_not_one_that_was_given_up_before():
    run = Run(axis(), disturb=held_in(DriveState.OPERATION_ENABLED), duration_s=0.2, faults=["x FH-116"])
    assert "2 s after" in run.result.faults[0]
    states = DriveState.SWITCH_ON_DISABLED, DriveState.OPERATION_ENABLED  # one does not enable, the other not disable
    Run(axis(), axis(node=2), disturb=held_in(*states), faults=["x FH-114", "y FH-116"])


@pytest.mark.parametrize(
    ("until", "fault"),
    [(10_000, "y FH-115"), (5_270, "FH-115")],  # at rest in the cycle that gives up, but not for long enough
)
def test_an_axis_that_its_quick_stop_does_not_stop_is_told_of(until, fault):
    def creep(cycle, feedback):
        feedback[1].position += 2e-4 * max(min(cycle, until) - 300, 0)
        if cycle == 300:
            feedback[0].message = "the node has been reset"

    run = Run(axis(), axis(node=2), disturb=creep, faults=["x FH-118", fault])
    assert "within 5 s" in run.result.faults[1]
    assert ("quick stop active" in run.result.faults[1]) == (fault == "y FH-115")


def in_fault(clears=True, again_when_enabled=0):
    """A drive found in fault; it may not leave it, or fall back as often as given when it is enabled."""
    falls = [again_when_enabled]

    def before(drives):
        request = drives.pending[0] and drives.pending[0].request
        is_tripped = request is Request.ENABLE and falls[0] > 0
        falls[0] -= is_tripped
        if drives.cycle == 0 or is_tripped:
            drives.states[0] = DriveState.FAULT
        if is_tripped or (request is Request.RESET_FAULT and not clears):
            drives.pending[0] = None

    return before


def trips_when_enabled(drives):
    pending = drives.pending[0]
    if pending is not None and pending.request is Request.ENABLE:
        drives.states[0] = DriveState.FAULT


RESET = [Request.LISTEN, Request.RESET_FAULT, Request.ENABLE, Request.DISABLE]


@pytest.mark.parametrize(
    ("before", "is_wanted", "requests", "faults"),
    [
        (in_fault(), False, [Request.LISTEN, Request.DISABLE], ["x FH-105"]),
        (in_fault(), True, RESET, []),
        (in_fault(clears=False), True, [Request.LISTEN, Request.RESET_FAULT, Request.DISABLE], ["x FH-105"]),
        (in_fault(again_when_enabled=50), True, RESET, ["x FH-105"]),
        (trips_when_enabled, True, ORDINARY, ["x FH-105"]),
    ],
    ids=["without the word", "on the word", "not cleared", "comes back", "of a healthy drive"],
)
def test_a_fault_of_a_drive_at_the_start_is_reset_once_and_on_the_users_word_alone(before, is_wanted, requests, faults):
    """A drive that trips when it is enabled must not be pushed back in again and again."""
    run = Run(before=before, is_fault_reset_wanted=is_wanted, duration_s=0.3, faults=None)
    assert codes_in(run.result.faults[:1]) == faults
    assert run.requests() == requests
    if requests[-2] is Request.RESET_FAULT:
        assert run.result.cycles == pytest.approx(1000, abs=5)


def test_a_reset_of_the_drives_fault_does_not_hide_a_failed_computation():
    def sabotage(axes):
        one = axes[0].compensator
        axes[0].compensator = Fails(one, until=0)

    run = Run(before=in_fault(), is_fault_reset_wanted=True, on_axes=sabotage, duration_s=0.3, faults=None)
    assert "x FH-111" in codes_in(run.result.faults)
    assert Request.ENABLE not in run.requests()


def test_without_any_feedback_nothing_is_enabled():
    run = Run(disturb=heard(is_fresh=False), faults=["x FH-101"])
    assert run.requests() == [Request.DISABLE]


def test_the_first_feedback_may_take_its_time_and_silence_in_motion_is_bridged_shortly():
    run = Run(axis(), axis(node=2), disturb=heard(0, 300, k=1, position=math.nan), duration_s=0.2)
    assert run.column("cycle")[0] == 300
    run = Run(disturb=heard(300, 306, is_fresh=False), duration_s=0.6)
    assert np.count_nonzero(run.column("is_fresh") == 0.0) == 6
    assert np.abs(run.error()).max() < 0.02


@pytest.mark.parametrize("trajectory", [SINE, {"kind": "hold"}])
def test_an_axis_that_nobody_sees_is_not_taken_to_stand(trajectory):
    run = Run(axis(trajectory=trajectory), disturb=heard(300, is_fresh=False), faults=None)
    assert codes_in(run.result.faults[0]) == "x FH-103"
    assert run.requests() == STOPPED_BY_FAULT
    # nobody knows that it stands: the drive holds it until the time is up
    stops = run.column("state") == LoopState.FAULT_STOPPING
    assert np.count_nonzero(stops) == pytest.approx(5000, abs=2)
    assert abs(run.drives.servos[0].true_velocity) < 1e-3
    assert np.all(run.column("compensation")[stops][400:] == 0.0)
