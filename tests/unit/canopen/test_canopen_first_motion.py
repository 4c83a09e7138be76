"""Whole runs of the loop on a simulated CANopen drive whose units are not those that are assumed."""

import numpy as np
import pytest
from friction_hil_drivers.canopen.drives import CanopenDrives

from friction_hil.daemon.realtime import SteppedClock
from friction_hil.daemon.safety import LoopState
from friction_hil.daemon.stop import StopRequest
from tests.canopen_bench import NODE, Bench, BenchBus
from tests.loop_run import MODES
from tests.messages import codes_in
from tests.servo_drives import PERIOD_S, axis_dict, configuration, make_loop

LIMITS = {"torque": 0.3, "torque_slew": 300.0, "velocity": 10.0, "following_error": 0.5, "position": [-4.0, 4.0]}
BOUND = 0.04  # rad: 0.05 rad by the velocity limit, 0.08 by the position limits; a stop takes a little more
ENCODER = {"encoder": {"counts": 65536}}
NO_UNIT = [0x60A9]


class Run:
    """A run of one axis on the bench, and what its true position and velocity were."""

    def __init__(
        self, manners=None, missing=(), servo=None, position=0.0, duration_s=1.0, dry_run=False, stop_at=None, **changes
    ):
        config = configuration(x=axis_dict(node=NODE, **{"limits": LIMITS, **MODES["csv"], **changes}))
        self.bench = Bench({**ENCODER, **(servo or {})}, position=position, manners=manners, missing=missing)
        bus = BenchBus(self.bench)
        clock, stop = SteppedClock(), StopRequest()
        drives = CanopenDrives(config, config.axes, clock, dry_run=dry_run, bus=bus)
        self.position, self.velocity = [], []
        receive, connect = drives.receive, drives.connect

        def watched(feedback, end_ns):
            receive(feedback, end_ns)
            stop.is_requested |= len(self.position) == stop_at
            self.position.append(self.bench.servo.true_position)
            self.velocity.append(self.bench.servo.velocity)

        def connected():
            self.facts = connect()
            return self.facts

        drives.receive, drives.connect = watched, connected
        loop, self.sink, _ = make_loop(config, drives, stop=stop, clock=clock, duration_s=duration_s, dry_run=dry_run)
        self.result = loop.run()
        bus.shutdown()
        self.state = np.array(self.sink.column("x", "state"))

    def moved(self, state=None):
        """Largest distance from the start, over the whole run or in one state."""
        away = np.abs(np.array(self.position) - self.position[0])[: len(self.state)]
        return float(away.max() if state is None else away[self.state == state].max())

    @property
    def fastest(self):
        return float(np.abs(self.velocity).max())

    @property
    def codes(self):
        return [codes_in(fault).partition(" ")[2] for fault in self.result.faults]


@pytest.mark.parametrize(
    ("unit", "guess"),
    [(name, name) for name in ("rpm", "0.1 rpm", "0.01 rpm", "deg/s")] + [("rev/s", None), ("rad/s", None)],
)
def test_a_drive_in_another_unit_is_found_out_by_a_small_motion(unit, guess):
    run = Run({"velocity_unit": unit}, NO_UNIT)
    assert run.codes == ["FH-123"]
    assert guess is None or f"that looks like {guess};" in run.result.faults[0]
    assert LoopState.RUNNING not in run.state
    assert run.moved() < 2.0 * BOUND
    assert run.fastest < (8.0 if unit == "rev/s" else 2.0)  # one increment; it was 22 rad/s
    assert not run.bench.statusword & 0x04  # disabled


@pytest.mark.deep
@pytest.mark.parametrize("unit", ["counts/s", "rpm", "0.1 rpm", "deg/s", "0.01 rad/s"])
def test_with_the_right_unit_the_run_goes_on_as_before(unit):
    run = Run({"velocity_unit": unit}, NO_UNIT, velocity_unit=unit)
    assert run.result.faults == []
    assert run.moved(LoopState.FIRST_MOTION) < BOUND
    assert run.moved() > 0.29  # the trajectory, which began where the axis stood
    first = run.state == LoopState.FIRST_MOTION
    assert 0.3 < np.count_nonzero(first) * PERIOD_S < 3.0
    assert np.abs(run.position[np.flatnonzero(first)[-1]]) < 0.25 * BOUND  # and back again
    assert np.all(np.array(run.sink.column("x", "command"))[first] == 0.0)


def test_60a9h_is_believed_and_yet_examined():
    run = Run({"velocity_unit": "0.1 rpm"})
    assert run.result.faults == []
    assert LoopState.FIRST_MOTION in run.state
    assert "0.1 rpm" in run.facts[0].units[1].value


@pytest.mark.parametrize("position", [0.0, 3.0, -3.0])
def test_a_reversed_drive_is_found_out(position):
    run = Run({"is_reversed": True}, position=position)
    assert run.codes == ["FH-125"]
    assert run.moved() < BOUND


def test_torque_of_the_wrong_sign_is_found_out_before_the_axis_is_fast():
    run = Run({"is_reversed": True}, **MODES["cst"] | {"limits": LIMITS | {"torque": 0.5, "velocity": 30.0}})
    assert run.codes[0] == "FH-125"
    assert run.moved() < 0.5


@pytest.mark.parametrize("mode", [{}, {"controller": None, **MODES["csp"]}, MODES["cst"]], ids=["csv", "csp", "cst"])
def test_a_blocked_axis_is_found_out(mode):
    limits = {"limits": LIMITS | {"following_error": None}} if mode else {}
    run = Run(servo={"mechanics": {"inertia": 1e6}}, duration_s=3.0, **mode | limits)
    assert any("does not move although" in fault for fault in run.result.faults)
    assert mode or run.codes == ["FH-124"]


@pytest.mark.parametrize("load", [-0.1, 0.1])
def test_a_hanging_load_is_no_fault(load):
    run = Run(servo={"mechanics": {"inertia": 2e-4, "load_torque": load}}, limits=LIMITS | {"following_error": 3.0})
    assert not [fault for fault in run.result.faults if "first motion" in fault]


@pytest.mark.parametrize(
    "how", [{"controller": None, **MODES["csp"]}, MODES["cst"], {"missing": NO_UNIT, "dry_run": True}]
)
def test_other_modes_and_a_dry_run_have_no_first_motion(how):
    run = Run({"velocity_unit": "rpm"}, **how)
    assert LoopState.FIRST_MOTION not in run.state
    assert run.result.faults == []
    assert (run.moved() < 1e-3) is ("dry_run" in how)


def test_a_stop_in_the_first_motion_is_no_fault():
    run = Run(stop_at=400)
    assert run.result.faults == []
    states = [text for _, kind, text in run.sink.events if kind == "state"]
    assert states == ["enabling", "first_motion", "fault_stopping", "disabling", "done"]
    assert not run.bench.statusword & 0x04
