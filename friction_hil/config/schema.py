"""The configuration as pydantic models: every key with its meaning, unit, default and bounds."""

import functools
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import (
    BaseModel,
    ConfigDict,
    Field,
    PrivateAttr,
    SerializeAsAny,
    SerializerFunctionWrapHandler,
    StringConstraints,
    ValidationInfo,
    field_validator,
    model_serializer,
    model_validator,
)

from friction_hil.config.checks import axis_mistakes, bus_mistakes, configuration_mistakes
from friction_hil.config.messages import refuse, validate
from friction_hil.config.model_file import ModelFile
from friction_hil.config.section import POSITION, TORQUE, VELOCITY, Section, key, keys
from friction_hil.drive import DRIVERS, SIMULATED_DRIVES, driver_names, load_driver
from friction_hil.errors import UsageError

NAME_PATTERN = "^[a-z][a-z0-9_]*$"
Name = Annotated[str, StringConstraints(pattern=NAME_PATTERN)]


class BusConfig(Section):
    """The bus, as python-can knows it."""

    # what an interface with options of its own takes beside these keys goes to python-can as it is
    model_config = ConfigDict(extra="allow")

    interface: str = key("interface of python-can: socketcan, slcan, udp_multicast, virtual, pcan, kvaser, ...")
    channel: int | str = key("channel of the interface: can0, /dev/ttyACM0, 239.74.163.2, ...")
    bitrate: int | None = key(
        "bit rate; for socketcan what 'ip link' has set, to compute the bus load", "bit/s", default=None, gt=0
    )
    port: int | None = key("UDP port of udp_multicast", default=None, ge=1, le=65535)
    hop_limit: int | None = key(
        "how many routers udp_multicast passes; 0 stays on this machine", default=None, ge=0, le=255
    )

    @model_validator(mode="before")
    @classmethod
    def _stay_on_this_machine(cls, value: Any) -> Any:
        if isinstance(value, dict) and value.get("interface") == "udp_multicast":
            return {**value, "hop_limit": 0 if value.get("hop_limit") is None else value["hop_limit"]}
        return value

    @model_validator(mode="after")
    def _check(self) -> Self:
        refuse(self, bus_mistakes(self))
        return self

    @property
    def further(self) -> dict[str, Any]:
        """Keys that this version does not know, for python-can."""
        return dict(self.model_extra or {})


class Limits(Section):
    """Limits that hold in every cycle; passing one is a fault, but torque and slew, which are clipped."""

    torque: float = key("bound on abs(compensation) in csp and csv, on the whole torque in cst", TORQUE, gt=0)
    torque_slew: float | None = key("fastest change of the torque", f"{TORQUE} per s", default=None, gt=0)
    velocity: float = key("bound on abs(velocity)", VELOCITY, gt=0)
    following_error: float | None = key("bound on abs(position demand - position)", POSITION, default=None, gt=0)
    position: tuple[float, float] | None = key("lowest and highest position", POSITION, default=None)


class Adaptation(Section):
    """Slow, bounded adaptation of the friction level to what the torque shows, for each direction."""

    time_s: float = key("time over which it learns, of steady sliding", "s", default=20.0, ge=0.1)
    bound: float = key("largest relative change of the level", "1", default=0.3, gt=0, lt=1)


class Compensation(Section):
    """How the model's torque becomes the compensation."""

    enabled: bool = key("false: computed and recorded, never commanded", default=True)
    gain: float = key("share of the model's torque that is applied", "1", default=0.9, ge=0, le=1.5)
    gain_negative: float | None = key(
        "the same for negative torque; by default as gain", "1", default=None, ge=0, le=1.5
    )
    source: Literal["auto", "measured", "demand"] = key(
        "velocity that the model sees: measured, demanded, or of both what helps and is safe", default="auto"
    )
    fade_s: float = key("time to fade in and out", "s", default=0.5, gt=0)
    baseline_s: float = key("motion without compensation first, to compare with", "s", default=0.0, ge=0)
    velocity: Literal["difference", "tracking", "kalman", "drive"] = key(
        "measured velocity: encoder difference, tracking loop, Kalman observer with the torque, or the drive's own",
        default="difference",
    )
    smoothing: float = key(
        "one-pole coefficient on the difference or the drive's velocity; 1 does not smooth",
        "1",
        default=1.0,
        gt=0,
        le=1,
    )
    acceleration: float | None = key(
        "largest acceleration that the tracking loop follows", f"{VELOCITY} per s", default=None, gt=0
    )
    max_acceleration: float | None = key(
        "a position that would need more is passed over as a glitch", f"{VELOCITY} per s", default=None, gt=0
    )
    dead_band: float = key("velocity below which less is applied, in proportion", VELOCITY, default=0.0, ge=0)
    adaptation: Adaptation | None = key("slow adaptation of the friction level; off by default", default=None)

    @model_validator(mode="after")
    def _is_complete(self) -> "Compensation":
        if self.velocity == "tracking" and self.acceleration is None:
            raise ValueError("velocity: tracking needs acceleration, the largest that is to be followed")
        return self


_RAMP = key("time to reach full speed from rest, and to come to rest", "s", default=1.0, gt=0)


class Circle(Section):
    """x = radius cos(2 pi frequency t + phase); a second axis a quarter behind (phase -pi/2) makes the circle."""

    kind: Literal["circle"]
    radius: float = key("amplitude of this axis", POSITION, gt=0)
    frequency: float = key("rounds per second", "Hz", gt=0)
    phase: float = key("phase of this axis", "rad", default=0.0)
    ramp_s: float = _RAMP


class Sine(Section):
    """x = amplitude sin(2 pi frequency t + phase)."""

    kind: Literal["sine"]
    amplitude: float = key("amplitude", POSITION, gt=0)
    frequency: float = key("periods per second", "Hz", gt=0)
    phase: float = key("phase", "rad", default=0.0)
    ramp_s: float = _RAMP


class Triangle(Section):
    """Constant speed to and fro, with rounded corners."""

    kind: Literal["triangle"]
    amplitude: float = key("amplitude", POSITION, gt=0)
    frequency: float = key("periods per second", "Hz", gt=0)
    rounding: float = key("share of a quarter period over which a corner is rounded", "1", default=0.1, gt=0, le=0.5)


class ExperimentBounds(Section):
    """How far and how fast an axis may move to show its friction."""

    velocity: float = key("highest speed, where travel leaves room for it", VELOCITY, gt=0)
    travel: float = key("largest distance from the start, to either side", POSITION, gt=0)
    acceleration: float | None = key("highest acceleration", f"{VELOCITY} per s", default=None, gt=0)
    duration_s: float = key("length", "s", default=60.0, ge=10)
    ramp_s: float = _RAMP


class AxisExperiment(ExperimentBounds):
    """What `tune` has to be told of an axis."""

    axis: Literal["rotary", "linear"] | None = key(
        "kind of the axis while its model file is not there yet: rotary (by default) or linear", default=None
    )


class Experiment(ExperimentBounds):
    """Swelling sines from presliding to full speed, back to the start, then rest: the motion for `identify`."""

    kind: Literal["experiment"]


class Hold(Section):
    """Stay where the axis is."""

    kind: Literal["hold"]


class NoTrajectory(Section):
    """No set-point: the torque is the compensation alone (mode cst). The axis can be moved by hand."""

    kind: Literal["none"]


Trajectory = Annotated[Circle | Sine | Triangle | Experiment | Hold | NoTrajectory, Field(discriminator="kind")]


class Controller(Section):
    """The daemon's own loops: position P and velocity PI in cst; position P alone over the drive's loop in csv."""

    position_gain: float = key("velocity per position error", "1/s", ge=0)
    velocity_gain: float = key("torque per velocity error (cst)", "N m s/rad or N s/m", default=0.0, ge=0)
    integral_hz: float = key("corner frequency of the velocity loop's integral part (cst)", "Hz", default=0.0, ge=0)


class Shadow(Section):
    """A model that is evaluated and recorded, never commanded."""

    name: Name = key("its column in the recording is shadow_NAME")
    model: ModelFile = key("model file (a path), or its content")


class AxisConfig(Section):
    """One motor with its drive.

    In a file the driver's own keys stand beside these; `split_options` gathers them under ``options``.
    """

    driver: str = key("which driver speaks to the drive")
    mode: Literal["csp", "csv", "cst"] = key(
        "what is commanded each cycle: position, velocity (both plus torque offset), or torque"
    )
    limits: Limits = key("limits that hold in every cycle")
    model: ModelFile = key("friction model of the axis: a model file (a path), or its content")
    compensation: Compensation = key("how the model's torque is applied", default=Compensation())
    shadows: tuple[Shadow, ...] = key("further models, recorded for comparison, never commanded", default=())
    trajectory: Trajectory = key("motion: kind circle, sine, triangle, experiment, hold or none")
    controller: Controller | None = key("the daemon's own controller (modes cst and csv)", default=None)
    experiment: AxisExperiment | None = key(
        "how far and how fast 'tune' may move the axis to learn its friction", default=None
    )
    simulation: SerializeAsAny[BaseModel] | None = key("the drive that 'simulate' puts on the bus", default=None)
    options: SerializeAsAny[BaseModel] = Field(json_schema_extra={"is_key": False})

    @field_validator("driver")
    @classmethod
    def _is_installed(cls, name: str) -> str:
        try:
            driver_options(name, DRIVERS)
        except UsageError as error:
            raise ValueError(str(error)) from None
        return name

    @field_validator("options", mode="plain")
    @classmethod
    def _validate_options(cls, value: Any, info: ValidationInfo) -> BaseModel:
        if "driver" not in info.data:  # already a mistake of its own
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
            raise ValueError(f"simulated drives exist for {simulated}: {error}") from None
        return validate(options, value)

    @model_validator(mode="after")
    def _check(self) -> Self:
        refuse(self, axis_mistakes(self))
        return self

    @model_serializer(mode="wrap")
    def _flatten(self, handler: SerializerFunctionWrapHandler) -> dict[str, Any]:
        values: dict[str, Any] = handler(self)
        return {"driver": values.pop("driver"), **values.pop("options"), **values}


class RecordingConfig(Section):
    """Where ``run`` records."""

    path: Path = key("MCAP file, seen from the directory that 'run' starts in; '--record' goes before it")


class Realtime(Section):
    """How punctual the loop shall be."""

    priority: int = key("SCHED_FIFO priority; 0: ordinary scheduling", default=80, ge=0, le=99)
    spin_us: int = key("busy waiting before each deadline, for less wake-up latency", "us", default=200, ge=0)
    max_missed: int = key(
        "periods in a row, missed or without feedback, that are bridged before it is a fault", default=10, ge=1
    )


class Configuration(Section):
    """Everything that ``run`` and ``simulate`` need to know."""

    version: Literal[1] = key("version of this format: 1")
    period_s: float = key("period of the loop", "s", ge=1e-4, le=1)
    bus: BusConfig | None = key("the CAN bus; drives on serial lines need none", default=None)
    axes: dict[Name, AxisConfig] = key("the axes by name", min_length=1)
    recording: RecordingConfig | None = key("where to record", default=None)
    realtime: Realtime = key("scheduling of the loop", default=Realtime())

    _source_path: Path | None = PrivateAttr(default=None)

    @property
    def source_path(self) -> Path | None:
        """The file that this was loaded from; relative paths of drivers start from its directory."""
        return self._source_path

    @model_validator(mode="after")
    def _check(self) -> Self:
        refuse(self, configuration_mistakes(self))
        return self


def split_options(axis: Mapping[str, Any]) -> dict[str, Any]:
    """Gather the keys of an axis that are not common to all drivers under ``options``."""
    common = {name: value for name, value in axis.items() if name in keys(AxisConfig)}
    return {**common, "options": {name: value for name, value in axis.items() if name not in common}}


@functools.cache
def driver_options(driver: str, group: str) -> type[BaseModel]:
    """Return the model of a driver's own keys.

    Raises
    ------
    UsageError
        No such driver is installed, or it is broken.
    """
    try:
        options = load_driver(driver, group).Options
    except ImportError as error:
        raise UsageError(f"the driver {driver!r} cannot be imported: {error}") from error
    if not (isinstance(options, type) and issubclass(options, BaseModel)):
        raise UsageError(f"the driver {driver!r} is broken: its Options is no pydantic model")
    return options
