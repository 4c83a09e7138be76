"""Feed-forward of gravity and offset, in each mode: a pendulum neither sags nor drifts, nor has torque for ever."""

import numpy as np
import pytest

from friction_hil.checked_yaml.text import dump
from friction_hil.cli.work.config import check_files
from friction_hil.config import load, self_contained
from friction_hil.daemon.control.message import Action
from friction_hil.daemon.safety import LoopState
from friction_hil.daemon.static_torque import static_torque, static_torque_note
from friction_hil.drive import DriveState, Request
from friction_hil.motion.trajectory import sine_path
from friction_hil.rehearsal import Motion, Rehearsal
from friction_hil.servo.config import ServoConfig, ServoMechanics
from friction_hil.servo.parts import Gravity as Pendulum
from tests.loop_run import LIMITS, Run, heard
from tests.readme_commands import ROOT
from tests.servo_drives import PERIOD_S, axis_dict, configuration
from tests.unit.daemon.test_control_changes import Changed
from tests.unit.rehearsal.test_rehearsal import facts

SINE, COSINE = 0.3, 0.25  # N m
CONTROLLERS = {
    "csp": {},
    "csv": {"controller": {"position_gain": 30.0}},
    "cst": {"controller": {"position_gain": 25.0, "velocity_gain": 0.03, "integral_hz": 4.0}},
}


def axis(mode, *, torque=1.0, guided=False, error=1.0, offset=0.0, **compensation):
    given = axis_dict(mode=mode, **({} if guided else CONTROLLERS[mode]))
    given["limits"] |= {"torque": torque}
    given["model"]["mechanics"] |= {"gravity": {"sine": SINE * error, "cosine": COSINE * error}, "offset": offset}
    given["compensation"] |= compensation
    given["trajectory"] = {"kind": "sine", "amplitude": 0.5, "frequency": 0.5, "ramp_s": 0.25}
    if guided:
        given["trajectory"] = {"kind": "none"}
        del given["limits"]["following_error"]
    return given


def run(given, servo=None, duration_s=3.0, **settings):
    return Run(given, servo=servo or pendulum(), duration_s=duration_s, **settings)


def pendulum():
    """With a brake, so that it stands until it is enabled."""
    return ServoConfig(mechanics=ServoMechanics(has_brake=True, gravity=Pendulum(sine=SINE, cosine=COSINE)))


def moved(given, servo=None, duration_s=3.0):
    """Following error while it moves, position, and torque sent, of a run without fault."""
    one = run(given, servo, duration_s)
    return one.error(), *one.columns("position", "command")


@pytest.mark.parametrize(("mode", "rms", "peak"), [("csp", 2.0, 2.5), ("csv", 4.0, 3.0), ("cst", 6.0, 5.0)])
def test_it_follows_better_and_does_not_sag_when_it_is_enabled(mode, rms, peak):
    without, _, _ = moved(axis(mode, gravity=False))
    fed, _, _ = moved(axis(mode))
    later = round(1.0 / PERIOD_S)
    assert np.std(fed[later:]) < np.std(without[later:]) / rms
    assert np.abs(fed[:later]).max() < np.abs(without[:later]).max() / peak


@pytest.mark.parametrize("error", [1.0, 1.15, 0.85])
def test_a_guided_pendulum_stays_where_it_is(error):
    """Friction holds what an error of 15 % leaves."""
    _, position, _ = moved(axis("cst", guided=True, error=error), duration_s=1.0)
    assert np.ptp(position) < 1e-3
    _, fallen, _ = moved(axis("cst", guided=True, gravity=False), duration_s=1.0)
    assert np.ptp(fallen) > 0.3


@pytest.mark.parametrize("mode", ["csp", "cst"])
def test_the_offset_of_the_model_is_fed_forward_too(mode):
    """A constant weight, which identification without a pendulum finds as an offset."""
    servo = ServoConfig(mechanics=ServoMechanics(has_brake=True, load_torque=0.25))
    fed, left = (moved(axis(mode, error=0.0, offset=0.25, gravity=each), servo, 1.0)[0] for each in (True, False))
    assert np.abs(fed).max() < 0.5 * np.abs(left).max()


@pytest.mark.parametrize("mode", ["csp", "csv", "cst"])
def test_it_stays_within_the_limit_and_the_slew(mode):
    run(axis(mode, torque=0.2), duration_s=1.0, faults=None).assert_within_limits()


@pytest.mark.parametrize(
    ("mode", "changes", "words"),
    [
        *((mode, {"torque": 0.2}, "leaves 0.092 N m") for mode in ("csp", "csv")),
        ("cst", {"torque": 0.2}, "leaves 0.2 N m"),
        *((mode, {"torque": 0.1}, "leaves 0 N m") for mode in ("csp", "csv")),
        ("csp", {}, "up to 0.391 N m"),
        ("csp", {"torque": 0.1, "gravity": False}, ""),
        ("csp", {"error": 0.01}, ""),
    ],
)
def test_the_check_of_a_configuration_says_where_the_limit_is_too_small(mode, changes, words, tmp_path, capsys):
    config = configuration(x=axis(mode, **changes))
    note = static_torque_note(config.axes["x"])
    assert words in note
    assert (note == "") == (words == "")
    is_too_small = words.startswith("leaves")
    assert ("limits.torque" in note) == is_too_small
    file = tmp_path / "axis.yaml"
    file.write_text(dump(self_contained(config)))
    assert check_files([str(file)], as_json=False) == 0
    printed = " ".join(capsys.readouterr().out.split())
    assert (f"axes.x.limits.torque: {words} " in printed) == is_too_small
    assert ("note" in printed) == is_too_small


def test_it_leaves_the_friction_its_torque_in_both_directions():
    """0.39 N m of gravity would leave nothing of 0.2 N m to one direction, if only the sum were limited."""
    one = run(axis("csp", torque=0.2))
    command, compensation = one.columns("command", "compensation")
    faded_in = slice(round(1.0 / PERIOD_S), round(3.0 / PERIOD_S))
    fed = (command - compensation)[faded_in]
    assert 0.075 < fed.min() < fed.max() < 0.092 + 1e-9  # 0.0755 N m of gravity at one end of the path
    assert np.ptp(compensation[faded_in]) > 0.15


@pytest.mark.parametrize("changes", [{"enabled": False}, {"gravity": False}])
def test_nothing_is_commanded_in_csp_where_it_is_off(changes):
    _, _, command = moved(axis("csp", gain=0.0, **changes), duration_s=1.0)
    assert not command.any()


@pytest.mark.parametrize(("mode", "error"), [("cst", 1.0), ("cst", 0.7), ("csp", 1.0), ("csv", 1.0)])
def test_it_does_not_sag_until_the_brake_has_closed(mode, error):
    """Wherever the path has left it; in cst the loop's controller holds what the model does not know."""
    one = run(axis(mode, error=error), duration_s=0.6, power_off_cycles=300)
    position, command, state, drive = one.columns("position", "command", "state", "drive_state")
    disabling, off = state == LoopState.DISABLING, drive == DriveState.SWITCH_ON_DISABLED
    assert disabling.sum() > 300
    assert np.ptp(position[disabling]) < 3e-3
    held = command[disabling & ~off]
    assert np.abs(held).min() > 0.1
    assert np.abs(command[disabling & off]).max() < 0.1  # of one cycle
    assert one.torques()[-1] == 0.0
    assert np.abs(np.diff(held)).max() < 0.01  # of a weight of 0.3 N m


def test_guided_by_hand_it_is_held_until_the_brake_has_closed_too():
    one = run(axis("cst", guided=True), duration_s=0.3, power_off_cycles=300)
    assert np.ptp(one.column("position")[one.column("state") == LoopState.DISABLING]) < 1e-3


def test_a_drive_that_keeps_its_power_gets_no_torque_for_ever():
    one = run(axis("cst"), duration_s=0.3, power_off_cycles=10**6, faults=["x FH-116"], is_left_disabled=False)
    assert (one.column("state") == LoopState.DISABLING).sum() * PERIOD_S == pytest.approx(2.0, abs=0.01)
    assert (one.requests()[-1], one.torques()[-1]) == (Request.DISABLE, 0.0)


@pytest.mark.parametrize("has_gravity", [True, False])
def test_a_rehearsal_has_the_error_of_the_loop(has_gravity):
    given = axis("cst", gravity=has_gravity)
    error, _, _ = moved(given, duration_s=5.0)
    scored = error[round(2.5 / PERIOD_S) :][: round(2.0 / PERIOD_S)]
    motion = Motion(sine_path(0.5, 0.5, 0.0), 2.0, ramp_s=0.25, start_s=2.5)
    config = configuration(x=given).axes["x"]
    outcome = Rehearsal(config, facts("cst", pendulum()), PERIOD_S).run(pendulum(), config.model, motion)
    assert outcome.rms == pytest.approx(np.sqrt(np.mean(scored**2)), rel=0.05)


def test_a_weight_that_raises_the_friction_leaves_less_of_the_limit_for_itself():
    """Else both together would meet the limit, which would take the compensation of one direction away."""
    lift = load(ROOT / "config/machines/worm_gear.yaml").axes["lift"]
    friction = lift.model.friction_model
    both = max(abs(friction.steady_state([-1e-9, 1e-9], load_torque=20.0)))
    assert static_torque(lift).largest == 20.0
    assert static_torque(lift).bound == pytest.approx(lift.limits.torque - lift.compensation.gain * both)


OFFSET = 0.05  # N m, of the model: held as long as the drive has power


def with_offset(**changes):
    given = axis_dict(**changes)
    given["model"]["mechanics"]["offset"] = OFFSET
    return given


def test_a_drive_that_keeps_its_power_after_the_request_to_disable_gets_no_compensation():
    """It has stopped the axis before the compensation has faded out: only what holds the load stays."""

    breaks = heard(1200, message="something is wrong")
    run = Run(
        with_offset(compensation={"fade_s": 1.0}), duration_s=2.0, disturb=breaks, power_off_cycles=150, faults=None
    )
    assert run.result.faults
    state, drive, command, compensation = run.columns("state", "drive_state", "command", "compensation")
    kept = (state == LoopState.DISABLING) & (drive != DriveState.SWITCH_ON_DISABLED)
    assert kept.sum() > 100
    assert np.abs(compensation[kept]).min() > 0.005, "there is one that could be sent"
    first = 1 + int(2.0 * LIMITS["torque"] / (LIMITS["torque_slew"] * PERIOD_S))
    assert command[kept][first:] == pytest.approx(OFFSET)


def test_a_daemon_that_waits_commands_no_torque():
    slow = LIMITS | {"torque_slew": 2.0}  # what was commanded before would last for some cycles
    run = Changed(with_offset(limits=slow), plan={400: Action.STOP}, until=1500)
    state, command = run.columns("state", "command")
    waiting = state == LoopState.WAITING
    assert waiting.sum() > 50
    assert np.abs(command[np.flatnonzero(waiting)[0] - 1]) > 0.01, "there was one"
    assert set(command[waiting]) == {0.0}
    assert {c.torque for c, waits in zip(run.commands[0], waiting, strict=False) if waits} == {0.0}
