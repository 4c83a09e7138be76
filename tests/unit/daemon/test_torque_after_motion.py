"""The torque that a drive is commanded once its axis is not to move any more."""

import numpy as np
import pytest

from friction_hil.daemon.control.message import Action
from friction_hil.daemon.safety import LoopState
from friction_hil.drive import DriveState
from tests.loop_run import LIMITS, Run, axis
from tests.servo_drives import PERIOD_S
from tests.unit.daemon.test_control_changes import Changed

OFFSET = 0.05  # N m, of the model: held as long as the drive has power


def with_offset(**changes):
    given = axis(**changes)
    given["model"]["mechanics"]["offset"] = OFFSET
    return given


def test_a_drive_that_keeps_its_power_after_the_request_to_disable_gets_no_compensation():
    """It has stopped the axis before the compensation has faded out: only what holds the load stays."""

    def breaks(cycle, feedback):
        if cycle >= 1200:
            feedback[0].message = "something is wrong"

    run = Run(with_offset(compensation={"fade_s": 1.0}), duration_s=2.0, disturb=breaks, power_off_cycles=150)
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
