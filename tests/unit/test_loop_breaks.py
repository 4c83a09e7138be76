"""What breaks under a run of the loop, the bus or our own computation: the drives are disabled all the same."""

import math

import numpy as np
import pytest

from friction_hil import compensator
from friction_hil.daemon.realtime import SteppedClock
from friction_hil.daemon.safety import LoopState
from friction_hil.drive import Request
from friction_hil.errors import BusError
from tests.loop_run import MODES, STOPPED_BY_FAULT, Drives, Run, axis
from tests.servo_drives import configuration, make_loop


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
        assert loop.run().faults == ["the bus is gone [FH-117]"]
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
        assert loop.run().faults == ["gone [FH-117]"]
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
    assert run.result.faults == ["x: the computation failed: ZeroDivisionError: by hand [FH-111]"]
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
        axes[0].compensator.state.view(compensator.STATE)["friction"] = math.nan

    run = Run(on_axes=poison)
    assert any("not finite" in fault for fault in run.result.faults)
    assert np.all(run.torques() == 0.0)
    run.assert_left_disabled()


def test_a_failure_in_warming_the_caches_stops_the_axes_in_good_order():
    class Ready(SteppedClock):
        def doze_until(self, deadline_ns):
            return True

    def before(drives):
        if drives.cycle == 400:
            drives.warm_caches = lambda: 1 / 0

    run = Run(before=before, clock=Ready())
    assert run.result.faults == ["warming the caches failed: ZeroDivisionError: division by zero [FH-112]"]
    assert run.requests() == STOPPED_BY_FAULT
    run.assert_left_disabled()


def test_warming_the_caches_changes_no_bit_of_what_is_commanded():
    class Ready(SteppedClock):
        def doze_until(self, deadline_ns):
            return True

    plain, warmed = Run(duration_s=0.4), Run(duration_s=0.4, clock=Ready())
    assert plain.commands == warmed.commands


def test_an_axis_whose_velocity_is_no_number_stops_the_other_in_good_order():
    def disturb(cycle, feedback):
        if cycle == 400:
            feedback[1].velocity = None

    run = Run(axis(), axis(node=2), disturb=disturb)
    (fault,) = run.result.faults
    assert fault.startswith("y: the computation failed: TypeError")
    assert run.requests(0) == run.requests(1) == STOPPED_BY_FAULT
    run.assert_left_disabled()


def test_a_warning_of_the_cycle_in_which_the_computation_fails_is_not_lost():
    def sabotage(axes):
        class Fails:
            def step(self, *inputs):
                raise ZeroDivisionError("by hand")

        axes[0].shadows["bad"] = Fails()
        notices = axes[0]._notices

        class Notices:
            def next(self, *arguments):
                return notices.next(*arguments) or "look out"

        axes[0]._notices = Notices()

    run = Run(on_axes=sabotage)
    assert run.result.faults == ["x: the computation failed: ZeroDivisionError: by hand [FH-111]"]
    assert run.result.warnings == ["look out"]
