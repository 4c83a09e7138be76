"""The loop with simulated servos, in simulated time: physics, limits, time, listening, and what breaks under it."""

import contextlib
import math
import mmap
import re
import resource
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from friction_hil import compensator
from friction_hil.daemon.failure import Reserve
from friction_hil.daemon.realtime import SteppedClock
from friction_hil.daemon.safety import LoopState
from friction_hil.drive import DriveState, Request
from friction_hil.drive.codes import code_of
from friction_hil.errors import BusError
from friction_hil.servo.config import ServoConfig
from tests.loop_run import (
    BELIEVED,
    LIMITS,
    MODES,
    ORDINARY,
    SINE,
    STOPPED_BY_FAULT,
    Drives,
    Fails,
    LateClock,
    Run,
    axis,
    heard,
    in_state,
    model,
)
from tests.messages import codes_in
from tests.servo_drives import PERIOD_S, configuration, make_loop


@pytest.mark.parametrize("mode", MODES)
def test_compensation_takes_the_friction_out_of_the_error(mode):
    compensation = {"fade_s": 0.1, "baseline_s": 1.5}
    run = Run(axis(mode, model=model(**BELIEVED), compensation=compensation), duration_s=3.25)
    error = run.error()
    before, after = error[500:1500], error[2250:3250]  # a period each
    assert np.sqrt(np.mean(after**2)) < np.sqrt(np.mean(before**2)) / 3.0
    assert np.abs(after).max() < np.abs(before).max() / 2.0
    assert run.requests() == ORDINARY
    run.assert_within_limits()


@pytest.mark.parametrize("mode", ["csp", "csv"])
def test_until_the_baseline_is_over_no_torque_is_added(mode):
    (command,) = Run(axis(mode, compensation={"fade_s": 0.1, "baseline_s": 0.5}), duration_s=1.0).running("command")
    assert np.all(command[:499] == 0.0)
    assert np.abs(command[600:]).max() > 0.05
    assert np.all(Run(axis(mode, compensation={"enabled": False}), duration_s=0.5).torques() == 0.0)


def test_cst_without_a_set_point_makes_the_axis_light_and_commands_the_compensation_alone():
    """Somebody pushes with less than friction: the free axis yields, for its friction is taken away."""
    pushed = ServoConfig.model_validate({"mechanics": {"load_torque": -0.1}})
    free = {"mode": "cst", "controller": None, "trajectory": {"kind": "none"}, "compensation": {"gain": 0.9}}
    free["limits"] = {"torque": 0.3, "torque_slew": 300.0, "velocity": 30.0}
    run = Run(axis(**free), servo=pushed, duration_s=0.15)
    np.testing.assert_array_equal(*run.running("command", "compensation"))
    assert np.isnan(run.column("position_demand")).all()
    bound = Run(axis(**free | {"compensation": {"enabled": False}}), servo=pushed, duration_s=0.15)
    assert abs(run.column("position")[-1]) > 3.0 * abs(bound.column("position")[-1])


def test_hold_stays_where_the_axis_is():
    run = Run(axis(trajectory={"kind": "hold"}), duration_s=0.5)
    assert np.ptp(run.column("position")) < 1e-4


def test_two_runs_are_the_same_bits():
    def rows():
        return np.array(Run(axis(model=model(**BELIEVED)), axis("cst", node=2), duration_s=0.5).sink.rows)

    np.testing.assert_array_equal(rows().view(np.int64), rows().view(np.int64))


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
            if begin <= cycle < begin + length and kind != "fault":
                f.position += {"jump": value, "creep": 0.04 * (cycle - begin)}.get(kind, 0.0)
                changes = {"stale": ("is_fresh", False), "state": ("state", state), "message": ("message", "gone")}
                if kind in ("position", "velocity", "torque") or kind in changes:
                    setattr(f, *changes.get(kind, (kind, value)))

    before = in_state(DriveState.FAULT, *drives_fault)
    quick = {"trajectory": SINE | {"ramp_s": 0.1, "frequency": 4.0}, "model": model(**BELIEVED)}
    quick |= {"compensation": {"fade_s": 0.02, "source": source}, "limits": LIMITS | {"torque_slew": 30.0}}
    run = Run(
        axis(mode, **quick),
        disturb=disturb,
        before=before,
        duration_s=0.25,
        is_fault_reset_wanted=is_reset,
        faults=None,
    )
    run.assert_within_limits()
    asked = run.requests()
    assert Request.ENABLE not in asked[asked.index(Request.DISABLE) :]
    assert asked.count(Request.ENABLE) <= 1 + 2 * len(drives_fault)
    assert Request.QUICK_STOP not in asked or run.result.faults


@pytest.mark.parametrize(("exchange_us", "is_told"), [(600, False), (1400, True)])
def test_an_exchange_that_outlasts_the_period_is_told_before_anything_moves(exchange_us, is_told):
    clock = SteppedClock()

    def exchange(drives):
        if drives.cycle < 100:
            clock.sleep_until(clock.now_ns() + 1000 * exchange_us)

    run = Run(clock=clock, before=exchange, duration_s=0.2)
    assert run.events("warning") == run.result.warnings
    told = [cycle for cycle, name, text in run.sink.events if name == "warning" and "take 1400 µs" in text]
    assert len(told) == is_told
    assert not told or told[0] <= next(cycle for cycle, _, text in run.sink.events if text == "enabling")


def test_missed_periods_are_counted_and_bridged_but_while_the_drives_are_idle_nothing_is_missed():
    run = Run(clock=LateClock({3: 20_000_000, 300: 3_200_000, 400: 1_000_000, 500: 999_999}), duration_s=1.0)
    assert run.result.missed == 4
    cycle = run.column("cycle")
    assert cycle[1:][np.diff(cycle) > 1.0].tolist()[-2:] == [323.0, 424.0]
    assert run.column("late_us")[cycle == 323.0] == pytest.approx(200.0)
    assert np.abs(run.error()).max() < 0.03


def test_lateness_is_told_in_percentiles():
    late = {k: 40_000 if k % 50 else 700_000 for k in range(2000)}
    result = Run(clock=LateClock(late), duration_s=0.5).result
    assert (result.late_p50_us, result.late_p99_us) == (40.0, 700.0)


def test_too_many_missed_periods_in_a_row_are_a_fault():
    Run(clock=LateClock({300: 9_000_000}), duration_s=1.0)
    run = Run(clock=LateClock({300: 10_000_000}), duration_s=1.0, faults=["FH-113"])
    assert run.requests() == STOPPED_BY_FAULT


def test_a_dry_run_listens_computes_and_sends_nothing():
    """It needs no room for the path either."""

    def moved_by_others(cycle, feedback):
        feedback[0].position = 0.3 * math.sin(6.0 * PERIOD_S * cycle)

    tight = axis(limits=LIMITS | {"position": [-0.01, 10.0]})
    run = Run(tight, disturb=moved_by_others, dry_run=True, duration_s=0.5)
    assert {command.request for command in run.commands[0]} == {Request.LISTEN}
    assert np.all(run.torques() == 0.0)
    assert len(run.sink.rows) == pytest.approx(500, abs=2)
    compensation, velocity = run.columns("compensation", "velocity_estimate")
    moving = np.abs(velocity) > 0.5
    assert np.all((compensation * velocity)[moving][100:] > 0.0)
    assert run.drives.pending == [None]


def test_an_axis_that_waits_for_the_others_does_not_sink():
    """The first axis carries a weight; the second takes half a second to be enabled."""

    def slow(drives):
        pending = drives.pending[1]
        if drives.cycle < 550 and pending is not None:
            drives.pending[1] = None

    heavy = ServoConfig.model_validate({"mechanics": {"load_torque": 0.4, "has_brake": True}})
    run = Run(axis(), axis(node=2), before=slow, servo=heavy, duration_s=0.3)
    waiting = (run.column("state") == LoopState.ENABLING) & (run.column("drive_state") == DriveState.OPERATION_ENABLED)
    assert np.count_nonzero(waiting) > 400
    position = run.column("position")[waiting]
    assert abs(position[-1] - position[0]) < 1e-3
    sent = [command.position for command in run.commands[0]]
    enabled = np.flatnonzero(waiting)
    assert len({sent[k] for k in enabled}) == 1
    assert np.abs(np.diff(sent[enabled[0] : enabled[-1] + 200], 2)).max() < 1e-4  # and it sets off from there


@pytest.mark.parametrize(
    ("lag", "ahead_s"), [({"torque_lag_s": 3e-4}, 1.8e-3), ({"delay_s": 4e-3}, 4.5e-3)], ids=["lag", "delay"]
)
def test_the_velocity_ahead_is_the_demand_when_the_torque_acts(lag, ahead_s):
    """1.5 periods until the middle of the period in which it acts, and the torque's own lag or delay."""
    run = Run(axis(model=model() | {"mechanics": {"inertia": 2e-4} | lag}), duration_s=1.0)
    t, now, ahead = run.running("time_s", "velocity_demand", "velocity_demand_ahead")
    np.testing.assert_allclose(ahead[:-5], np.interp(t[:-5] + ahead_s, t, now), atol=1e-4)


@pytest.mark.parametrize("mode", MODES)
def test_the_motor_crosses_the_backlash_in_every_mode_and_the_offset_is_recorded(mode):
    """The simulated axis has no gap: its motor is to follow the demand with the offset, as a motor in a gap would."""
    mechanics = {"inertia": 2e-4, "torque_lag_s": 3e-4, "backlash": 0.02, "load": {"inertia": 1e-4, "friction": 0.03}}

    def moved(transmission):
        given = {"model": model() | {"mechanics": mechanics}, "compensation": {"fade_s": 0.1, **transmission}}
        run = Run(axis(mode, **given), duration_s=2.0)
        run.assert_within_limits()
        return [each[600:] for each in run.running("motor_offset", "position_demand", "position")]

    offset, demand, position = moved({"transmission": {"acceleration": 100.0}})
    assert (offset.min(), offset.max()) == pytest.approx((-0.01, 0.01), rel=1e-3)
    none, plain_demand, plain = moved({})
    assert not none.any()
    error, plain_error = (np.sqrt(np.mean(each**2)) for each in (demand + offset - position, plain_demand - plain))
    assert error < plain_error + 0.1 * 0.01


FILE = "unit/daemon/test_loop.py"  # as messages show it
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

    run = Run(before=before, duration_s=0.4, faults=None, is_left_disabled=bool(begin) or where == "close")
    assert re.fullmatch(fault, run.result.faults[0])
    assert codes_in(run.result.faults[1:]) == ["x FH-120"] * (where == "close")
    assert run.drives.closed == 1
    if where == "close":
        assert run.result.drive_states == [DriveState.UNKNOWN]


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


@pytest.mark.parametrize("is_starved", [True, False])
def test_the_reserve_is_released_before_the_drives_are_stopped(is_starved):
    config = configuration()
    drives = Drives(config)
    original, there = drives.send, []

    def starving(commands):
        there.append(loop.reserve.is_there)
        if is_starved and len(there) == 300:
            raise MemoryError
        original(commands)

    drives.send = starving
    loop, *_ = make_loop(config, drives, duration_s=0.4)
    loop.run()
    assert there == [True] * (300 if is_starved else len(there) - 1) + [False]


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

    run = Run(before=before, clock=Ready(), on_axes=sabotage, faults=None)
    assert [code_of(fault) for fault in run.result.faults] == ["FH-127"]
    assert run.commands[0][-1].request is Request.DISABLE


def test_the_recording_has_the_calls_that_led_to_a_program_error():
    def before(drives):
        if drives.cycle == 400:
            raise KeyError("[FH-230] " + "long " * 100)

    run = Run(before=before, faults=None)
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

    run = Run(axis(mode), axis(mode, node=2), on_axes=sabotage, faults=["x FH-111"])
    assert run.requests(0) == run.requests(1) == STOPPED_BY_FAULT
    broken = run.column("cycle") >= 400
    assert np.all(run.torques()[np.flatnonzero(broken)] == 0.0)
    assert np.isnan(run.column("compensation")[broken]).all()
    assert np.isfinite(run.column("compensation", "y")[broken]).all()
    assert max(abs(one.true_velocity) for one in run.drives.servos) < 0.05
    assert np.count_nonzero(run.column("state", "y") == LoopState.FAULT_STOPPING) < 1000  # it saw the standstill


def test_a_model_that_overflows_is_a_fault():
    def poison(axes):
        axes[0].compensator.state.view(compensator.STATE)["friction"] = math.nan

    run = Run(on_axes=poison, faults=None)
    assert any("not finite" in fault for fault in run.result.faults)
    assert np.all(run.torques() == 0.0)


def test_warming_the_caches_changes_no_bit_of_what_is_commanded():
    assert Run(duration_s=0.4).commands == Run(duration_s=0.4, clock=Ready()).commands


def break_warming(drives):
    if drives.cycle == 400:
        drives.warm_caches = lambda: 1 / 0


@pytest.mark.parametrize(
    ("what", "fault"),
    [({"before": break_warming}, "FH-112"), ({"disturb": heard(400, 401, k=1, velocity=None)}, "y FH-111")],
)
def test_what_fails_elsewhere_stops_the_axes_in_good_order_too(what, fault):
    run = Run(axis(), axis(node=2), clock=Ready(), **what, faults=[fault])
    assert run.requests(0) == run.requests(1) == STOPPED_BY_FAULT


def test_a_warning_of_the_cycle_in_which_the_computation_fails_is_not_lost():
    def sabotage(axes):
        axes[0].shadows["bad"] = Fails(None)
        notices = axes[0].notices
        axes[0].notices = SimpleNamespace(next=lambda *arguments: notices.next(*arguments) or "look out")

    run = Run(on_axes=sabotage, faults=["x FH-111"])
    assert run.result.warnings == ["look out"]
