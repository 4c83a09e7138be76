"""What must fit together in a configuration beyond each key for itself."""

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING

from friction_hil.config.messages import Mistake, show
from friction_hil.errors import UsageError, choices

if TYPE_CHECKING:
    from friction_hil.config.schema import AxisConfig, BusConfig, Configuration

# For these interfaces every key is known here: those of BusConfig that they have beside interface and channel.
_BUS_KEYS = {
    "udp_multicast": ("port", "hop_limit"),
    "virtual": (),
    "socketcan": ("bitrate",),
    "slcan": ("bitrate",),
}


def bus_mistakes(bus: "BusConfig") -> Iterator[Mistake]:
    """Check that an interface has the keys that are given for it."""
    for name, value in bus.further.items():
        if isinstance(value, dict | list):
            yield (name,), "must be a single value: it is handed to python-can as it is"
        elif isinstance(value, float) and not math.isfinite(value):
            yield (name,), f"must be a finite number, not {show(value)}"
    allowed = _BUS_KEYS.get(bus.interface)
    if allowed is None:
        return
    for name in bus.further:
        yield (name,), f"is no key here; {choices(name, ('interface', 'channel', *allowed))}"
    for name in ("bitrate", "port", "hop_limit"):
        if getattr(bus, name) is not None and name not in allowed:
            yield (name,), f"has no meaning for the interface {bus.interface}: remove it"


def axis_mistakes(axis: "AxisConfig") -> Iterator[Mistake]:
    """Check mode, trajectory, controller and limits of an axis against each other."""
    kind = axis.trajectory.kind
    has_setpoint = kind != "none"
    if not has_setpoint and axis.mode != "cst":
        yield ("trajectory", "kind"), f"'none' has no set-point, which mode {axis.mode} needs; try kind: hold"
    yield from _controller_mistakes(axis, has_setpoint)
    yield from _limit_mistakes(axis, has_setpoint)
    yield from _compensation_mistakes(axis)
    names = [shadow.name for shadow in axis.shadows]
    for index, name in enumerate(names):
        if name in names[:index]:
            yield (
                ("shadows", index),
                f"a shadow is called {name!r} already; give one another: {{name: ..., model: ...}}",
            )


def _controller_mistakes(axis: "AxisConfig", has_setpoint: bool) -> Iterator[Mistake]:
    given = axis.controller
    if axis.mode == "cst" and has_setpoint:
        if given is None:
            yield ("controller",), "is missing: mode cst needs position_gain, velocity_gain and integral_hz"
        elif given.velocity_gain == 0.0:
            yield ("controller", "velocity_gain"), "must be above zero in mode cst, where the daemon closes this loop"
    elif given is not None and axis.mode == "cst":
        yield ("controller",), "has nothing to control: trajectory kind none has no set-point"
    elif given is not None and axis.mode == "csp":
        yield ("controller",), "belongs to modes cst and csv; in csp the drive's own controller is at work"
    elif given is not None and (given.velocity_gain or given.integral_hz):
        yield ("controller",), "in csv the drive closes the velocity loop: only position_gain can be given"


def _limit_mistakes(axis: "AxisConfig", has_setpoint: bool) -> Iterator[Mistake]:
    limits = axis.limits
    if limits.following_error is not None and not has_setpoint:
        yield ("limits", "following_error"), "there is none without a set-point (trajectory kind none): remove it"
    if limits.position is not None and not limits.position[0] < limits.position[1]:
        low, high = limits.position
        yield ("limits", "position"), f"must be [lowest, highest], not [{low:g}, {high:g}]"
    speed = _peak_speed(axis)
    if speed > limits.velocity:
        message = f"is {limits.velocity:g}, but the trajectory moves at up to {speed:.4g} (rad/s or m/s)"
        yield ("limits", "velocity"), message
    if axis.experiment is not None:
        if axis.experiment.velocity > limits.velocity:
            yield ("experiment", "velocity"), f"is beyond limits.velocity, {limits.velocity:g}"
        if axis.experiment.axis not in (None, axis.model.axis):
            yield ("experiment", "axis"), f"is {axis.experiment.axis}, but the model is of a {axis.model.axis} axis"


def _peak_speed(axis: "AxisConfig") -> float:
    trajectory = axis.trajectory
    if trajectory.kind == "circle":
        return math.tau * trajectory.frequency * trajectory.radius
    if trajectory.kind == "sine":
        return math.tau * trajectory.frequency * trajectory.amplitude
    if trajectory.kind == "triangle":
        return 4.0 * trajectory.frequency * trajectory.amplitude
    if trajectory.kind == "experiment":
        return trajectory.velocity
    return 0.0


def _compensation_mistakes(axis: "AxisConfig") -> Iterator[Mistake]:
    from friction_hil.compensator import Compensator, CompensatorSettings

    given = axis.compensation
    knows_inertia = axis.model.mechanics.inertia > 0.0
    if given.velocity == "kalman" and not knows_inertia:
        yield ("compensation", "velocity"), "kalman needs the inertia, in the mechanics of the model file"
    elif given.adaptation is not None and not knows_inertia:
        yield ("compensation", "adaptation"), "needs the inertia, in the mechanics of the model file"
    elif given.velocity in ("difference", "drive"):
        settings = CompensatorSettings(
            period_s=1e-3,
            position_resolution=1e-6,
            torque_limit=axis.limits.torque,
            velocity=given.velocity,
            smoothing=given.smoothing,
        )
        try:
            Compensator(axis.model.friction_model, settings)
        except UsageError as error:
            yield ("compensation", "smoothing"), str(error)


def configuration_mistakes(configuration: "Configuration") -> Iterator[Mistake]:
    """Check what concerns several axes, or the axes and the bus; drivers have a say through ``Options.check``."""
    period_us = 1e6 * configuration.period_s
    if configuration.realtime.spin_us >= period_us:
        yield ("realtime", "spin_us"), f"must be below the period, {period_us:g} us"
    by_driver: dict[str, dict[str, AxisConfig]] = {}
    for name, axis in configuration.axes.items():
        by_driver.setdefault(axis.driver, {})[name] = axis
    for axes in by_driver.values():
        check = getattr(type(next(iter(axes.values())).options), "check", None)
        if check is not None:
            for name, field, message in check(axes, configuration.bus):
                yield ("axes", name, *field.split(".")), message
