"""Configuration of one axis: limits, model, compensation, motion, and the keys of its driver."""

import functools
from collections.abc import Iterator, Mapping
from typing import Annotated, Any, Literal, Self

from pydantic import (
    BaseModel,
    Field,
    SerializeAsAny,
    SerializerFunctionWrapHandler,
    StringConstraints,
    ValidationInfo,
    field_validator,
    model_serializer,
    model_validator,
)

from friction_hil.checked_yaml.messages import Mistake, refuse, validate
from friction_hil.checked_yaml.section import (
    MOST_ACCELERATION,
    MOST_POSITION,
    MOST_S,
    MOST_TORQUE,
    MOST_TORQUE_SLEW,
    MOST_VELOCITY,
    POSITION,
    TORQUE,
    VELOCITY,
    Section,
    key,
    keys,
)
from friction_hil.compensator import Compensator, CompensatorSettings
from friction_hil.config.drivers import DRIVERS, SIMULATED_DRIVES, driver_names, load_driver
from friction_hil.config.own_loop import OWN_LOOP, without_driver
from friction_hil.config.trajectories import AxisExperiment, Trajectory, peak_speed
from friction_hil.errors import UsageError
from friction_hil.models.model_file import ModelFile

NAME_PATTERN = "^[a-z][a-z0-9_]*$"
Position = Annotated[float, Field(ge=-MOST_POSITION, le=MOST_POSITION)]
Name = Annotated[str, StringConstraints(pattern=NAME_PATTERN)]


class AxisLimits(Section):
    """Limits checked in every cycle. Torque and slew rate are clipped; exceeding another limit is a fault."""

    torque: float = key(
        "limit of abs(compensation) in csp and csv, of the whole torque in cst", TORQUE, gt=0, le=MOST_TORQUE
    )
    torque_slew: float | None = key(
        "limit of the slew rate of the torque", f"{TORQUE} per s", default=None, gt=0, le=MOST_TORQUE_SLEW
    )
    velocity: float = key("limit of abs(velocity)", VELOCITY, gt=0, le=MOST_VELOCITY)
    following_error: float | None = key(
        "limit of abs(position demand - position)", POSITION, default=None, gt=0, le=MOST_POSITION
    )
    position: tuple[Position, Position] | None = key("lowest and highest position", POSITION, default=None)


class Adaptation(Section):
    """Slow, bounded adaptation of the friction level to the measured torque, separately for each direction."""

    time_s: float = key(
        "time constant of the adaptation, in time of steady sliding", "s", default=20.0, ge=0.1, le=MOST_S
    )
    bound: float = key("largest relative change of the level", "1", default=0.3, gt=0, lt=1)


class MotorOffset(Section):
    """Offset of the motor's position that keeps the load on the path, across backlash and twist of the transmission."""

    acceleration: float = key(
        "acceleration of the offset, which the drive can follow", f"{VELOCITY} per s", gt=0, le=MOST_ACCELERATION
    )
    velocity: float | None = key(
        "velocity of the offset; by default half of what the motion leaves of limits.velocity, and never more",
        VELOCITY,
        default=None,
        gt=0,
        le=MOST_VELOCITY,
    )


class VelocityOffset(Section):
    """Compensation by the demand of the drive's velocity loop, for a drive without a torque input."""

    velocity_gain: float = key(
        "gain of the drive's velocity loop, torque per velocity error", "N m s/rad or N s/m", gt=0, le=1e9
    )
    integral_hz: float = key("corner frequency of that loop's integral part; 0: it has none", "Hz", ge=0, le=5e3)
    limit: float = key("limit of abs(velocity offset)", VELOCITY, gt=0, le=MOST_VELOCITY)
    slew: float = key("limit of the slew rate of the velocity offset", f"{VELOCITY} per s", gt=0, le=MOST_ACCELERATION)
    position_gain: float | None = key(
        "gain of the drive's position loop: the offset is made by shifting the position set-point, for a drive that "
        "takes nothing else (csp); by default the drive takes the velocity offset itself",
        "1/s",
        default=None,
        gt=0,
        le=1e6,
    )
    velocity_feedforward: float = key(
        "with position_gain: gain of the drive's feed-forward of the set-point's velocity", "1", default=1.0, ge=0, le=2
    )
    inertia: float = key(
        "with position_gain: inertia by which the drive feeds the set-point's acceleration forward; 0: it does not",
        "kg m^2 or kg",
        default=0.0,
        ge=0,
        le=1e9,
    )

    @model_validator(mode="before")
    @classmethod
    def _check_gains(cls, given: Any) -> Any:
        if isinstance(given, Mapping) and (missing := [name for name in _GAINS if given.get(name) is None]):
            raise ValueError(
                f"needs {' and '.join(missing)} of the drive's velocity loop, from its own settings or from a recorded "
                "run without compensation: 'friction-hil identify RUN.mcap' prints them"
            )
        return given


_GAINS = ("velocity_gain", "integral_hz")


class Compensation(Section):
    """Computation of the compensation from the model's torque."""

    enabled: bool = key("false: the compensation is computed and recorded, but not commanded", default=True)
    gain: float = key("factor of the model's torque", "1", default=0.9, ge=0, le=1.5)
    gain_negative: float | None = key(
        "factor for negative torque; by default the same as gain", "1", default=None, ge=0, le=1.5
    )
    source: Literal["auto", "measured", "demand"] = key(
        "velocity for the model: measured, demanded, or a safe combination of both (auto)", default="auto"
    )
    fade_s: float = key("time to fade the compensation in and out", "s", default=0.5, gt=0, le=MOST_S)
    baseline_s: float = key(
        "duration of motion without compensation at the start, as a reference", "s", default=0.0, ge=0, le=MOST_S
    )
    velocity: Literal["difference", "tracking", "kalman", "drive"] = key(
        "velocity estimate: encoder difference, tracking loop, Kalman filter with the torque, or the drive's velocity",
        default="difference",
    )
    smoothing: float = key(
        "coefficient of a one-pole filter on the difference or the drive's velocity; 1: no filter",
        "1",
        default=1.0,
        gt=0,
        le=1,
    )
    acceleration: float | None = key(
        "largest acceleration that the tracking loop follows",
        f"{VELOCITY} per s",
        default=None,
        gt=0,
        le=MOST_ACCELERATION,
    )
    max_acceleration: float | None = key(
        "acceleration above which a measured position is rejected as a glitch; by default limits.velocity / period_s",
        f"{VELOCITY} per s",
        default=None,
        gt=0,
        le=MOST_ACCELERATION,
    )
    dead_band: float = key(
        "velocity below which the compensation is reduced in proportion",
        VELOCITY,
        default=0.0,
        ge=0,
        le=MOST_VELOCITY,
    )
    gravity: bool = key(
        "feed gravity and offset of the model file, and the torque of an arm, forward from enabling on; false for a "
        "drive that does this itself. "
        "Without enabled: true this is done in cst with a controller only; beside a master it is never done",
        default=True,
    )
    adaptation: Adaptation | None = key("slow adaptation of the friction level; by default off", default=None)
    learning: Literal["off", "propose", "on"] = key(
        "parameters refined from ordinary motion: on tries them and keeps what lowers the error, propose only says "
        "what it would try",
        default="off",
    )
    transmission: MotorOffset | None = key(
        "offset of the motor across mechanics.backlash and twist (mechanics.load.stiffness) of the model file; by "
        "default off",
        default=None,
    )
    velocity_offset: VelocityOffset | None = key(
        "compensation by a velocity offset in place of the torque offset, for a drive without a torque input (csp and "
        "csv); by default off",
        default=None,
    )

    @property
    def is_by_velocity(self) -> bool:
        """Return True if the drive is given a velocity offset in place of a torque."""
        return self.velocity_offset is not None and not self.is_by_position

    @property
    def is_by_position(self) -> bool:
        """Return True if the drive is given neither, but shifted position set-points."""
        return self.velocity_offset is not None and self.velocity_offset.position_gain is not None

    @model_validator(mode="after")
    def _check_acceleration(self) -> "Compensation":
        if self.velocity == "tracking" and self.acceleration is None:
            raise ValueError("velocity: tracking needs acceleration, the largest acceleration to follow")
        return self


class Controller(Section):
    """Control loops of the daemon: position P and velocity PI in cst, position P in csv."""

    position_gain: float = key("gain of the position loop, velocity per position error", "1/s", ge=0, le=1e6)
    velocity_gain: float = key(
        "gain of the velocity loop, torque per velocity error (cst)", "N m s/rad or N s/m", default=0.0, ge=0, le=1e9
    )
    integral_hz: float = key(
        "corner frequency of the velocity loop's integral part (cst)", "Hz", default=0.0, ge=0, le=5e3
    )


class Shadow(Section):
    """A model that is evaluated and recorded, but not commanded."""

    name: Name = key("name; the column in the recording is shadow_NAME")
    model: ModelFile = key("model file (a path), or its content")


class AxisConfig(Section):
    """One motor with its drive.

    In a file, the driver's keys are on the same level as these; `split_options` moves them under ``options``.
    """

    driver: str = key("driver for the drive; without one, the axis is that of a loop of your own", default=OWN_LOOP)
    mode: Literal["csp", "csv", "cst"] = key(
        "command of each cycle: position (csp), velocity (csv), both with a torque offset, or torque (cst)"
    )
    limits: AxisLimits = key("limits checked in every cycle")
    model: ModelFile = key("friction model of the axis: a model file (a path), or its content")
    compensation: Compensation = key("application of the model's torque", default=Compensation())
    shadows: tuple[Shadow, ...] = key("further models, recorded for comparison but not commanded", default=())
    trajectory: Trajectory = key(
        "motion: kind circle, sine, triangle, strokes, sequence, experiment, multisine, hold, none or master"
    )
    controller: Controller | None = key("controller of the daemon (modes cst and csv)", default=None)
    experiment: AxisExperiment | None = key(
        "bounds of the motion by which 'tune' identifies the friction of the axis", default=None
    )
    simulation: SerializeAsAny[BaseModel] | None = key("simulated drive, started by 'simulate'", default=None)
    options: SerializeAsAny[BaseModel] = Field(json_schema_extra={"is_key": False})

    @field_validator("driver")
    @classmethod
    def _check_driver(cls, name: str) -> str:
        try:
            driver_options(name, DRIVERS)
        except UsageError as error:
            raise ValueError(str(error)) from None
        return name

    @field_validator("options", mode="plain")
    @classmethod
    def _validate_options(cls, value: Any, info: ValidationInfo) -> BaseModel:
        if "driver" not in info.data:  # already reported
            return Section()
        return validate(driver_options(info.data["driver"], DRIVERS), value, keys(cls))

    @field_validator("simulation", mode="plain")
    @classmethod
    def _validate_simulation(cls, value: Any, info: ValidationInfo) -> BaseModel | None:
        if value is None or "driver" not in info.data:
            return None
        driver = info.data["driver"]
        try:
            options = driver_options(driver, SIMULATED_DRIVES)
        except UsageError as error:
            simulated = ", ".join(driver_names(SIMULATED_DRIVES))
            raise ValueError(f"there are simulated drives for {simulated}: {error}") from None
        return validate(options, value)

    @model_validator(mode="after")
    def _check(self) -> Self:
        refuse(self, _mistakes(self))
        return self

    @model_serializer(mode="wrap")
    def _flatten(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        values: dict[str, Any] = handler(self)
        return {"driver": values.pop("driver"), **values.pop("options"), **values}


def split_options(axis: Mapping[str, Any]) -> dict[str, Any]:
    """Move the keys of an axis that are not common to all drivers under ``options``."""
    axis = without_driver(axis)
    common = {name: value for name, value in axis.items() if name in keys(AxisConfig)}
    return {**common, "options": {name: value for name, value in axis.items() if name not in common}}


@functools.cache
def driver_options(driver: str, group: str) -> type[BaseModel]:
    """Return the pydantic model of a driver's keys; a `UsageError`: the driver is not installed, or it is broken."""
    try:
        return (load_driver(driver) if group == DRIVERS else load_driver(driver, SIMULATED_DRIVES)).Options
    except ImportError as error:
        raise UsageError(f"the driver {driver!r} cannot be imported: {error}") from error


def _mistakes(axis: AxisConfig) -> Iterator[Mistake]:
    """Check mode, trajectory, controller and limits of an axis against each other."""
    kind = axis.trajectory.kind
    has_setpoint = kind != "none"
    if not has_setpoint and axis.mode != "cst":
        yield ("trajectory", "kind"), f"'none' has no set-point, but mode {axis.mode} needs one; try kind: hold"
    yield from _controller_mistakes(axis, has_setpoint)
    yield from _limit_mistakes(axis, has_setpoint)
    yield from compensation_mistakes(axis)
    names = [shadow.name for shadow in axis.shadows]
    for index, name in enumerate(names):
        if name in names[:index]:
            yield (
                ("shadows", index),
                f"another shadow has the name {name!r} already; use a different name: {{name: ..., model: ...}}",
            )


def _controller_mistakes(axis: AxisConfig, has_setpoint: bool) -> Iterator[Mistake]:
    given = axis.controller
    if axis.trajectory.kind == "master":
        if given is not None:
            yield ("controller",), "is not possible here: with trajectory kind master another one controls the axis"
    elif axis.mode == "cst" and has_setpoint:
        if given is None:
            yield ("controller",), "is missing: mode cst needs position_gain, velocity_gain and integral_hz"
        elif given.velocity_gain == 0.0:
            yield ("controller", "velocity_gain"), "must be above zero in mode cst, where the daemon closes this loop"
    elif given is not None and axis.mode == "cst":
        yield ("controller",), "is not possible here: trajectory kind none has no set-point"
    elif given is not None and axis.mode == "csp":
        yield ("controller",), "is only for modes cst and csv; in csp the drive closes all loops"
    elif given is not None and (given.velocity_gain or given.integral_hz):
        yield ("controller",), "may only have position_gain in csv, where the drive closes the velocity loop"


def _limit_mistakes(axis: AxisConfig, has_setpoint: bool) -> Iterator[Mistake]:
    limits = axis.limits
    if limits.following_error is not None and not has_setpoint:
        yield ("limits", "following_error"), "needs a set-point, but trajectory kind none has none: remove this limit"
    if limits.position is not None and not limits.position[0] < limits.position[1]:
        low, high = limits.position
        yield ("limits", "position"), f"must be [lowest, highest], not [{low:g}, {high:g}]"
    speed = peak_speed(axis.trajectory)
    if speed > limits.velocity:
        message = f"is {limits.velocity:g}, but the trajectory moves at up to {speed:.4g} (rad/s or m/s)"
        yield ("limits", "velocity"), message
    yield from _travel_mistakes(axis)
    if axis.experiment is not None:
        if axis.experiment.velocity > limits.velocity:
            yield ("experiment", "velocity"), f"is above limits.velocity, {limits.velocity:g}"
        if axis.experiment.axis not in (None, axis.model.axis):
            yield ("experiment", "axis"), f"is {axis.experiment.axis}, but the model is for a {axis.model.axis} axis"


def _travel_mistakes(axis: AxisConfig) -> Iterator[Mistake]:
    """Check that the motions fit between the position limits from one start at least."""
    if axis.limits.position is None:
        return
    low, high = axis.limits.position
    motions = [
        (("trajectory", name), reach)
        for name in ("radius", "amplitude", "travel")
        if (reach := getattr(axis.trajectory, name, None)) is not None
    ]
    if axis.experiment is not None:
        motions.append((("experiment", "travel"), axis.experiment.travel))
    for steps, reach in motions:
        if 2.0 * reach > high - low > 0.0:
            text = f"is {reach:g} to either side, but limits.position [{low:g}, {high:g}] leaves room for"
            yield steps, f"{text} {0.5 * (high - low):g} at most, from its middle"


def _offset_obstacle(axis: AxisConfig) -> str:
    """Return why the motor cannot have an offset; empty if it can."""
    mechanics, load = axis.model.mechanics, axis.model.mechanics.load
    if load is None or load.friction is None or (mechanics.backlash == 0.0 and load.stiffness is None):
        return (
            "needs in the model file mechanics.load with inertia and friction, and mechanics.backlash, the width of "
            "the gap, or mechanics.load.stiffness"
        )
    if mechanics.backlash > 0.0 and load.friction == 0.0:
        return (
            "needs mechanics.load.friction above zero in the model file: a load without friction floats in the gap, "
            "where no offset holds it"
        )
    if mechanics.encoder == "load":
        return (
            "is not possible with mechanics.encoder: load in the model file: there the loops of the drive close over "
            "the transmission, and an offset would move the load off its path"
        )
    if axis.trajectory.kind == "master":
        return "is not possible beside a master (trajectory kind master): only the torque offset is this program's"
    if axis.trajectory.kind == "none":
        return "needs a set-point, but trajectory kind none has none"
    return ""


def _velocity_offset_obstacle(axis: AxisConfig) -> str:
    """Return why an axis cannot be compensated by a velocity offset; empty if it can."""
    if axis.trajectory.kind == "master":
        return (
            "is not possible beside a master (trajectory kind master), which may use the velocity offset itself: only "
            "the torque offset is this program's"
        )
    if axis.compensation.is_by_position and axis.mode == "csv":
        return "is not made by position_gain in mode csv, which has no position set-point: remove position_gain"
    return "is not needed in mode cst, where the torque itself is commanded: remove it" if axis.mode == "cst" else ""


def _learning_obstacle(axis: AxisConfig) -> str:
    """Return why the parameters of an axis cannot be learned; empty if they can."""
    if axis.model.mechanics.inertia == 0.0:
        return "needs mechanics.inertia in the model file"
    if axis.model.friction_model.network is not None:
        return "is not possible with a network: only the parameters of the other models are learned"
    if axis.compensation.transmission is not None:
        return "is not possible with transmission, which follows the model's own friction"
    if axis.trajectory.kind in ("none", "master"):
        return f"needs a set-point of this program, but trajectory kind {axis.trajectory.kind} has none"
    return ""


def compensation_mistakes(axis: AxisConfig) -> Iterator[Mistake]:
    """Yield what of the compensation the axis's model does not allow."""
    given = axis.compensation
    knows_inertia = axis.model.mechanics.inertia > 0.0
    if given.velocity == "kalman" and not knows_inertia:
        yield ("compensation", "velocity"), "kalman needs mechanics.inertia in the model file"
    elif given.adaptation is not None and not knows_inertia:
        yield ("compensation", "adaptation"), "needs mechanics.inertia in the model file"
    elif given.learning != "off" and (obstacle := _learning_obstacle(axis)):
        yield ("compensation", "learning"), obstacle
    elif given.transmission is not None and (obstacle := _offset_obstacle(axis)):
        yield ("compensation", "transmission"), obstacle
    elif given.velocity_offset is not None and (obstacle := _velocity_offset_obstacle(axis)):
        yield ("compensation", "velocity_offset"), obstacle
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
