"""Drives for tests of the loop: simulated servos behind the drive port, without a bus, in stepped time."""

import math
import os
from collections.abc import Callable, Sequence
from dataclasses import replace

from friction_hil.config import from_dict
from friction_hil.daemon.axis import AxisLoop
from friction_hil.daemon.log import LoopResult
from friction_hil.daemon.loop import Loop
from friction_hil.daemon.realtime import SteppedClock
from friction_hil.daemon.run import LoopSettings
from friction_hil.daemon.stop import StopRequest
from friction_hil.drive import AxisFacts, Command, Drives, DriveState, Feedback, Mode, Request
from friction_hil.friction import describe
from friction_hil.motion.trajectory import PathTime
from friction_hil.recordings import columns
from friction_hil.servo.config import ServoConfig
from friction_hil.servo.servo import Servo

PERIOD_S = 1e-3
TRUE_FRICTION = dict(describe("lugre").example)


def axis_dict(**changes):
    """An axis of a configuration, as a dict, with some keys changed."""
    return {
        "driver": "canopen",
        "node": 1,
        "mode": "csp",
        "limits": {"torque": 0.3, "torque_slew": 300.0, "velocity": 30.0, "following_error": 0.5},
        "model": {
            "axis": "rotary",
            "friction": {"model": "lugre", "parameters": dict(TRUE_FRICTION)},
            "mechanics": {"inertia": 2e-4, "torque_lag_s": 3e-4},
        },
        "compensation": {"fade_s": 0.1},
        "trajectory": {"kind": "sine", "amplitude": 0.3, "frequency": 1.0, "ramp_s": 0.25},
        **changes,
    }


def configuration(**axes):
    """A configuration with the given axes (dicts)."""
    data = {
        "version": 1,
        "period_s": PERIOD_S,
        "bus": {"interface": "virtual", "channel": f"test-{os.getpid()}"},  # a node has one daemon on a machine
        "axes": axes or {"x": axis_dict()},
    }
    return from_dict(data, "test")


class ServoDrives(Drives):
    """Simulated servos as `friction_hil.drive.Drives`: commands act from the next cycle on.

    ``disturb(cycle, feedback)`` may change what the loop sees; ``states`` overrides a drive's state. A drive that is to
    be disabled follows its commands for another ``power_off_cycles``: its brake takes time to close.
    """

    def __init__(
        self,
        config,
        *,
        servo=None,
        disturb: Callable[[int, list[Feedback]], None] | None = None,
        power_off_cycles: int = 0,
    ) -> None:
        self.modes = [Mode[axis.mode.upper()] for axis in config.axes.values()]
        self.names = list(config.axes)
        self.are_by_velocity = [axis.compensation.velocity_offset is not None for axis in config.axes.values()]
        self.period_s = config.period_s
        self.servos = [Servo(servo or ServoConfig()) for _ in self.names]
        for one in self.servos:
            one.set_period(config.period_s)
        self.states = [DriveState.SWITCH_ON_DISABLED] * len(self.names)
        self.pending: list[Command | None] = [None] * len(self.names)
        self.sent: list[list[tuple[Request, float, float]]] = [[] for _ in self.names]
        self.disturb = disturb
        self.power_off_cycles = power_off_cycles
        self._on_cycles = [0] * len(self.names)  # since the request to disable
        self.cycle = 0
        self.is_closed = False

    def connect(self) -> Sequence[AxisFacts]:
        delays = {Mode.CSP: 2.5, Mode.CSV: 2.0, Mode.CST: 1.5}
        facts = [
            AxisFacts(name, "servo", 1.0 / s.counts_per_unit, 6.4e-4, delays[m] * self.period_s, 1.5 * self.period_s)
            for name, s, m in zip(self.names, self.servos, self.modes, strict=True)
        ]
        return [replace(each, takes_velocity_offset=by) for each, by in zip(facts, self.are_by_velocity, strict=True)]

    def start(self) -> None:
        pass

    def receive(self, feedback, end_ns) -> None:
        for k, servo in enumerate(self.servos):
            servo.advance(round(self.period_s * servo.steps_per_second))
            self.activate(k, servo)
            f = feedback[k]
            f.position, f.velocity, f.torque = servo.position, servo.velocity, servo.torque
            f.state, f.is_fresh, f.error, f.message = self.states[k], True, "", ""
        if self.disturb is not None:
            self.disturb(self.cycle, feedback)
        self.cycle += 1

    def activate(self, k, servo) -> None:
        command = self.pending[k]
        self.pending[k] = None
        if command is None:
            return
        self._on_cycles[k] = self._on_cycles[k] + 1 if command.request is Request.DISABLE else 0
        if self.states[k].is_powered and 0 < self._on_cycles[k] <= self.power_off_cycles:
            pass
        elif self.states[k] is not DriveState.FAULT:
            self.states[k] = {
                Request.ENABLE: DriveState.OPERATION_ENABLED,
                Request.DISABLE: DriveState.SWITCH_ON_DISABLED,
                Request.QUICK_STOP: DriveState.QUICK_STOP_ACTIVE,
                Request.RESET_FAULT: DriveState.SWITCH_ON_DISABLED,
            }[command.request]
        elif command.request is Request.RESET_FAULT:
            self.states[k] = DriveState.SWITCH_ON_DISABLED
        if self.states[k] is DriveState.OPERATION_ENABLED:
            mode = self.modes[k]
            position = round(command.position * servo.counts_per_unit) / servo.counts_per_unit  # as a drive takes it
            target = {Mode.CSP: position, Mode.CSV: command.velocity, Mode.CST: command.torque}[mode]
            servo.command(mode, target, command.velocity_offset, 0.0 if mode is Mode.CST else command.torque)
        elif self.states[k] is DriveState.QUICK_STOP_ACTIVE:
            servo.quick_stop(200.0)
        else:
            servo.command(0, 0.0)

    def warm_caches(self) -> None:
        pass

    def send(self, commands) -> None:
        for k, c in enumerate(commands):
            assert math.isfinite(c.position)
            assert math.isfinite(c.velocity)
            assert math.isfinite(c.torque)
            self.sent[k].append((c.request, c.position, c.torque))
            if c.request is not Request.LISTEN:
                self.pending[k] = replace(c)

    def close(self) -> None:
        self.is_closed = True


class Rows:
    """Keeps rows and events, as a recorder would."""

    def __init__(self, config) -> None:
        self.names = list(config.axes)
        self.rows = []
        self.events = []

    def push(self, row) -> None:
        self.rows.append(row.copy())

    def event(self, cycle, name, text) -> None:
        self.events.append((cycle, name, text))

    def column(self, axis, name):
        """One column of one axis over all cycles, as a list."""
        width = self.rows[0].size // len(self.names)
        index = self.names.index(axis) * width + columns.NAMES.index(name)
        return [float(row[index]) for row in self.rows]


def make_loop(config, drives, *, axis=AxisLoop, sink=None, stop=None, clock=None, journal=None, **settings):
    """Return a loop over ``drives``, its sink and its axes."""
    path_time = PathTime(0.25)
    axes = [
        axis(name, config.axes[name], facts, config.period_s, path_time)
        for name, facts in zip(config.axes, drives.connect(), strict=True)
    ]
    sink = sink or Rows(config)
    settings = LoopSettings(period_s=config.period_s, **settings)
    clock, stop = clock or SteppedClock(), stop or StopRequest()
    return Loop(drives, axes, path_time, clock, sink, settings, stop, journal), sink, axes


def run(config, **settings) -> tuple[LoopResult, Rows, ServoDrives]:
    """A whole run."""
    of_drives = {key: settings.pop(key) for key in ("disturb", "servo", "power_off_cycles") if key in settings}
    drives = ServoDrives(config, **of_drives)
    loop, sink, _ = make_loop(config, drives, **settings)
    return loop.run(), sink, drives
