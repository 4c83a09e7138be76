"""Whole runs of the loop over simulated servos, for the tests of the loop."""

import math
from dataclasses import replace

import numpy as np

from friction_hil.daemon.realtime import SteppedClock
from friction_hil.daemon.safety import LoopState
from friction_hil.daemon.stop import StopRequest
from friction_hil.drive import DriveState, Request
from tests.messages import codes_in
from tests.servo_drives import PERIOD_S, TRUE_FRICTION, ServoDrives, axis_dict, configuration, make_loop

BELIEVED = TRUE_FRICTION | {"coulomb": 0.07, "static": 0.13, "sigma0": 2400.0, "stribeck_velocity": 0.23}
LIMITS = {"torque": 0.3, "torque_slew": 300.0, "velocity": 30.0, "following_error": 0.5}
CONTROLLER = {"position_gain": 30.0, "velocity_gain": 0.02, "integral_hz": 2.0}
MODES = {
    "csp": {"mode": "csp"},
    "csv": {"mode": "csv", "controller": {"position_gain": 60.0}},
    "cst": {"mode": "cst", "controller": CONTROLLER, "limits": LIMITS | {"torque": 0.6}},
}
SINE = {"kind": "sine", "amplitude": 0.3, "frequency": 1.0, "ramp_s": 0.25}


def axis(mode="csp", **changes):
    return axis_dict(**MODES[mode] | changes)


def model(**parameters):
    friction = {"model": "lugre", "parameters": TRUE_FRICTION | parameters}
    return {"axis": "rotary", "friction": friction, "mechanics": {"inertia": 2e-4, "torque_lag_s": 3e-4}}


class LateClock(SteppedClock):
    """Oversleeps: by so many nanoseconds at the n-th call."""

    def __init__(self, late):
        super().__init__()
        self.late, self.calls = late, -1

    def sleep_until(self, deadline_ns):
        self.calls += 1
        super().sleep_until(deadline_ns + self.late.get(self.calls, 0))


class Fails:
    """A computation that fails at a row of calls; all else of it is that of another one."""

    def __init__(self, other, begin=0, until=math.inf):
        self.other, self.begin, self.until, self.calls = other, begin, until, -1

    def step(self, *inputs):
        self.calls += 1
        if self.begin <= self.calls <= self.until:
            raise ZeroDivisionError("by hand")
        return self.other.step(*inputs)

    def __getattr__(self, name):
        return getattr(self.other, name)


def heard(begin=0, end=math.inf, k=0, **values):
    """A disturbance: from one cycle to another the feedback of a drive has these values."""

    def disturb(cycle, feedback):
        if begin <= cycle < end:
            for name, value in values.items():
                setattr(feedback[k], name, value)

    return disturb


def in_state(state, *cycles, k=0):
    """A hook by which a drive is in this state in these cycles, whatever it was asked for."""

    def before(drives):
        if drives.cycle in cycles:
            drives.states[k] = state

    return before


class Drives(ServoDrives):
    """Keeps every command; ``before`` is asked before each cycle and may do anything to the drives."""

    def __init__(self, config, before=None, **settings):
        super().__init__(config, **settings)
        self.before = before
        self.commands = [[] for _ in self.names]
        self.closed, self.read_back = 0, None  # states, once they are closed

    def receive(self, feedback, end_ns):
        if self.before is not None:
            self.before(self)
        super().receive(feedback, end_ns)

    def send(self, commands):
        for kept, command in zip(self.commands, commands, strict=True):
            kept.append(replace(command))
        super().send(commands)

    def close(self):
        self.closed += 1
        return self.read_back


class Run:
    """A run whose faults are those of the given codes (None: any) and which disables its drives, and what it left."""

    def __init__(self, *axes, before=None, on_axes=None, stop_at=None, faults=(), is_left_disabled=True, **given):
        self.config = configuration(**dict(zip("xyz", axes or (axis(),), strict=False)))
        stop = StopRequest()

        def hook(drives):
            if drives.cycle == stop_at:
                stop.is_requested = True
            if before is not None:
                before(drives)

        of_drives = {name: given.pop(name) for name in ("disturb", "servo", "power_off_cycles") if name in given}
        self.drives = Drives(self.config, hook, **of_drives)
        self.loop, self.sink, self.axes = make_loop(self.config, self.drives, stop=stop, **given)
        if on_axes is not None:
            on_axes(self.axes)
        self.result = self.loop.run()
        self.commands = self.drives.commands
        found = codes_in(self.result.faults)
        assert faults is None or found == list(faults), f"{self.result.faults}, and not {faults}"
        if is_left_disabled and not given.get("dry_run"):
            self.assert_left_disabled()

    def column(self, name, axis="x"):
        return np.array(self.sink.column(axis, name))

    def columns(self, *names):
        return [self.column(name) for name in names]

    def running(self, *names, axis="x"):
        """Columns of an axis while the axes run."""
        rows = self.column("state", axis) == LoopState.RUNNING
        return [self.column(name, axis)[rows] for name in names]

    def requests(self, k=0):
        """The requests to a drive, in their order, without repetitions."""
        all_of_them = [command.request for command in self.commands[k]]
        return [one for one, last in zip(all_of_them, [None, *all_of_them], strict=False) if one is not last]

    def torques(self, k=0):
        return np.array([command.torque for command in self.commands[k]])

    def events(self, name="state"):
        return [text for _, kind, text in self.sink.events if kind == name]

    def error(self, axis="x"):
        """Following error while the axes run."""
        demand, position = self.running("position_demand", "position", axis=axis)
        return demand - position

    def assert_left_disabled(self):
        assert self.drives.closed == 1
        for k, commands in enumerate(self.commands):
            assert commands[-1].request is Request.DISABLE
            assert commands[-1].torque == 0.0
            self.drives.activate(k, self.drives.servos[k])
            assert not self.drives.states[k].is_powered or self.drives.states[k] is DriveState.FAULT_REACTION_ACTIVE

    def assert_within_limits(self):
        for k, (name, config) in enumerate(self.config.axes.items()):
            torque, limits = self.torques(k), config.limits
            assert np.abs(torque).max() <= limits.torque, name
            asked = [command.request for command in self.commands[k]]
            powered = np.array([request in (Request.ENABLE, Request.QUICK_STOP) for request in asked])
            steps = np.abs(np.diff(torque))[powered[1:]]
            assert np.all(steps <= limits.torque_slew * PERIOD_S * (1.0 + 1e-9)), name


ORDINARY = [Request.LISTEN, Request.ENABLE, Request.DISABLE]
STOPPED_BY_FAULT = [Request.LISTEN, Request.ENABLE, Request.QUICK_STOP, Request.DISABLE]
