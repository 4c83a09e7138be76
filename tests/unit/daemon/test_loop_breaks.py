"""What breaks under a run of the loop, the bus or our own computation: the drives are disabled all the same."""

import contextlib
import math
import mmap
import re
import resource
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from friction_hil import compensator
from friction_hil.daemon.failure import Reserve
from friction_hil.daemon.realtime import SteppedClock
from friction_hil.daemon.safety import LoopState
from friction_hil.drive import DriveState, Request
from friction_hil.drive.codes import code_of
from friction_hil.errors import BusError
from tests.loop_run import MODES, STOPPED_BY_FAULT, Drives, Fails, Run, axis
from tests.messages import codes_in
from tests.servo_drives import configuration, make_loop

FILE = "unit/daemon/test_loop_breaks.py"  # as messages show it
BUG = rf"program error: RuntimeError: a bug \({FILE}:\d+, broken\); please report it \[FH-126\]"
BROKEN = [
    (BusError("the bus is gone"), r"the bus is gone \[FH-117\]"),
    (RuntimeError("a bug"), BUG),
    (MemoryError(), rf"there is no memory left \({FILE}:\d+, broken\) \[FH-127\]"),
]


@pytest.mark.parametrize(("error", "fault"), BROKEN)
@pytest.mark.parametrize(("where", "begin"), [("receive", 300), ("send", 300), ("send", 0), ("close", 0)])
def test_whatever_breaks_the_drives_are_disabled_and_the_bus_is_left(where, begin, error, fault):
    """Once, or each time where it begins with the first cycle; what cannot be read back is unknown."""

    def before(drives):
        if drives.cycle != begin:
            return
        original = getattr(drives, where)

        def broken(*_):
            if begin:
                setattr(drives, where, original)
            if where == "close":
                original()
            raise error

        setattr(drives, where, broken)

    run = Run(before=before, duration_s=0.4)
    assert re.fullmatch(fault, run.result.faults[0])
    assert codes_in(run.result.faults[1:]) == ["x FH-120"] * (where == "close")
    assert run.drives.closed == 1
    if where == "close":
        assert run.result.drive_states == [DriveState.UNKNOWN]
    if begin:
        assert (run.commands[0][-1].request, run.commands[0][-1].torque) == (Request.DISABLE, 0.0)


class Ready(SteppedClock):
    """Has time before each cycle, in which caches are warmed."""

    def doze_until(self, deadline_ns):
        return True


def test_memory_that_ran_out_is_there_again_once_the_reserve_is_released():
    reserve, hog = Reserve(), []
    size = int(Path("/proc/self/statm").read_text().split()[0]) * mmap.PAGESIZE
    before = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (size + (16 << 20), before[1]))
    try:
        with contextlib.suppress(MemoryError):
            while True:
                hog.append(bytes(1 << 20))
        with pytest.raises(MemoryError):
            bytes(8 << 20)
        reserve.release()
        assert len(bytes(8 << 20)) == 8 << 20
    finally:
        resource.setrlimit(resource.RLIMIT_AS, before)


def test_the_reserve_is_released_before_the_drives_are_stopped():
    config = configuration()
    drives = Drives(config)
    original, there = drives.send, []

    def starving(commands):
        there.append(loop.reserve.is_there)
        if len(there) == 300:
            raise MemoryError
        original(commands)

    drives.send = starving
    loop, *_ = make_loop(config, drives)
    loop.run()
    assert there == [True] * 300 + [False]


@pytest.mark.parametrize("where", ["step", "warm"])
def test_a_computation_without_memory_ends_the_loop(where):
    def starve(*_):
        raise MemoryError

    def before(drives):
        if where == "warm" and drives.cycle == 400:
            drives.warm_caches = starve

    def sabotage(axes):
        if where == "step":
            axes[0].shadows["bad"] = SimpleNamespace(step=starve)

    run = Run(before=before, clock=Ready(), on_axes=sabotage)
    assert [code_of(fault) for fault in run.result.faults] == ["FH-127"]
    assert run.commands[0][-1].request is Request.DISABLE


def test_the_recording_has_the_calls_that_led_to_a_program_error():
    def before(drives):
        if drives.cycle == 400:
            raise KeyError("[FH-230] " + "long " * 100)

    run = Run(before=before)
    (fault,) = run.result.faults
    assert code_of(fault) == "FH-126"
    assert len(fault.encode()) < 170  # an event of the recording holds it as a whole
    first, *calls = [(name, text) for _, name, text in run.sink.events if name in ("fault", "traceback")]
    assert first == ("fault", fault)
    assert calls[-1][1].endswith(", before")
    assert any(text.startswith("friction_hil/daemon/loop.py:") for _, text in calls)


@pytest.mark.parametrize("mode", MODES)
def test_a_mistake_in_the_computation_stops_the_axes_in_good_order(mode):
    def sabotage(axes):
        axes[0].compensator = Fails(axes[0].compensator, 400)

    run = Run(axis(mode), axis(mode, node=2), on_axes=sabotage)
    assert codes_in(run.result.faults) == ["x FH-111"]
    assert run.requests(0) == run.requests(1) == STOPPED_BY_FAULT
    broken = run.column("cycle") >= 400
    assert np.all(run.torques()[np.flatnonzero(broken)] == 0.0)
    assert np.isnan(run.column("compensation")[broken]).all()
    assert np.isfinite(run.column("compensation", "y")[broken]).all()
    assert max(abs(one.true_velocity) for one in run.drives.servos) < 0.05
    assert np.count_nonzero(run.column("state", "y") == LoopState.FAULT_STOPPING) < 1000  # it saw the standstill
    run.assert_left_disabled()


def test_a_model_that_overflows_is_a_fault():
    def poison(axes):
        axes[0].compensator.state.view(compensator.STATE)["friction"] = math.nan

    run = Run(on_axes=poison)
    assert any("not finite" in fault for fault in run.result.faults)
    assert np.all(run.torques() == 0.0)
    run.assert_left_disabled()


def test_warming_the_caches_changes_no_bit_of_what_is_commanded():
    assert Run(duration_s=0.4).commands == Run(duration_s=0.4, clock=Ready()).commands


def break_warming(drives):
    if drives.cycle == 400:
        drives.warm_caches = lambda: 1 / 0


def break_velocity(cycle, feedback):
    if cycle == 400:
        feedback[1].velocity = None


@pytest.mark.parametrize(
    ("what", "fault"), [({"before": break_warming}, "FH-112"), ({"disturb": break_velocity}, "y FH-111")]
)
def test_what_fails_elsewhere_stops_the_axes_in_good_order_too(what, fault):
    run = Run(axis(), axis(node=2), clock=Ready(), **what)
    assert codes_in(run.result.faults) == [fault]
    assert run.requests(0) == run.requests(1) == STOPPED_BY_FAULT
    run.assert_left_disabled()


def test_a_warning_of_the_cycle_in_which_the_computation_fails_is_not_lost():
    def sabotage(axes):
        axes[0].shadows["bad"] = Fails(None)
        notices = axes[0].notices
        axes[0].notices = SimpleNamespace(next=lambda *arguments: notices.next(*arguments) or "look out")

    run = Run(on_axes=sabotage)
    assert codes_in(run.result.faults) == ["x FH-111"]
    assert run.result.warnings == ["look out"]
