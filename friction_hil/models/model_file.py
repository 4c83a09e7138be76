"""Contents of a model file: friction, mechanics and provenance of one axis."""

import re
from pathlib import Path
from typing import Any, Literal, Self

import numpy as np
from pydantic import PrivateAttr, ValidationError, model_validator

from friction_hil import friction
from friction_hil.checked_yaml.messages import Mistake, refuse
from friction_hil.checked_yaml.section import MOST_TORQUE, Section, key
from friction_hil.compensator.load import Position, gravity_torque
from friction_hil.compensator.temperature import HIGHEST, LOWEST
from friction_hil.errors import UsageError
from friction_hil.friction import Axis, FrictionModel, InvalidParameterError, Network, NetworkStructure
from friction_hil.friction.modifiers import NAMES as MODIFIERS
from friction_hil.friction.modifiers import check_modifiers
from friction_hil.friction.parameters import check_all

_TORQUE = {"ge": -MOST_TORQUE, "le": MOST_TORQUE}
_CELSIUS: dict[str, float] = {"ge": LOWEST, "le": HIGHEST}
_LEAST_THERMAL_S = 1.0  # time constant
NETWORK = "network"  # a trained network, the only model without a family in the registry


class Base(Section):
    """Base model of a network: name, parameters and modifiers."""

    model: str = key("name of the friction model; 'friction-hil models' lists them")
    parameters: dict[str, Any] = key("parameters of the model, SI; 'friction-hil models NAME' describes them")
    modifiers: dict[str, Any] = key(f"modifiers of the friction: {', '.join(MODIFIERS)}", default={})

    @model_validator(mode="after")
    def _check(self) -> Self:
        refuse(self, friction_mistakes(self.model, self.parameters, self.modifiers))
        return self


class TrainedNetwork(Section):
    """A trained network, as 'friction-hil train' writes it; see friction_hil/friction/network.py."""

    structure: Literal["gated", "narx", "static"] = key("structure of the network")
    hidden: list[int] = key("number of tanh units of each hidden layer; one or two layers")
    states: int = key("number of states of a gated network, or of past torques of a narx", default=0)
    lags: int = key("number of past velocities of a narx", default=0)
    inputs: list[Literal["position", "load_torque", "temperature"]] = key("inputs besides the velocity", default=[])
    orders: list[float] = key("orders of the position harmonics that are inputs", "1/rad or 1/m", default=[])
    period_s: float = key("sampling period of the training", "s")
    torque_scale: float = key("unit of the torques of the network", "N m or N")
    bound: float = key("largest torque, in torque scales")
    speed_limit: float = key("highest speed of the training", "rad/s or m/s")
    rates: list[float] = key("bounds of the rates of the states of a gated network", "1/rad or 1/m", default=[])
    stroke: float = key("stroke of the stop of a gated network", "rad or m", default=0.0)
    least_speed: float = key(
        "beside a base model: speed below which the torque of the network fades out", "rad/s or m/s", default=0.0
    )
    speeds: list[float] = key("three characteristic speeds of the friction", "rad/s or m/s")
    ranges: dict[str, tuple[float, float]] = key("smallest and largest value of each other input", default={})
    level: float = key("largest torque of slow motion", "N m or N")
    weights: list[float] = key("weights, in the order of friction_hil/friction/network.py")
    base: Base | None = key(
        "base model, to whose torque the torque of the network is added; by default none", default=None
    )

    @model_validator(mode="after")
    def _check(self) -> Self:
        try:
            _ = self.network
        except InvalidParameterError as error:
            refuse(self, [((error.parameter,) if error.parameter else (), str(error))])
        except UsageError as error:
            refuse(self, [(("structure",), str(error))])
        return self

    @property
    def network(self) -> Network:
        """The trained network."""
        structure = NetworkStructure(
            kind=self.structure,
            hidden=tuple(self.hidden),
            states=self.states,
            lags=self.lags,
            has_position="position" in self.inputs,
            has_load="load_torque" in self.inputs,
            has_temperature="temperature" in self.inputs,
            orders=tuple(self.orders),
        )
        return Network(
            structure=structure,
            period_s=self.period_s,
            torque_scale=self.torque_scale,
            bound=self.bound,
            speed_limit=self.speed_limit,
            speeds=self.speeds,
            rates=self.rates,
            stroke=self.stroke,
            least_speed=self.least_speed,
            ranges=self.ranges,
            level=self.level,
            weights=np.array(self.weights),
            is_residual=self.base is not None,
        )


class Friction(Section):
    """A friction model with its parameters, or a trained network."""

    model: str = key("name of the friction model ('friction-hil models' lists them), or network")
    parameters: dict[str, Any] = key(
        "parameters of the model, SI; 'friction-hil models NAME' describes them", default={}
    )
    modifiers: dict[str, Any] = key(f"modifiers of the friction: {', '.join(MODIFIERS)}", default={})
    network: TrainedNetwork | None = key("trained network; only for the model network", default=None)

    @model_validator(mode="after")
    def _check(self) -> Self:
        refuse(self, self._mistakes())
        return self

    def _mistakes(self) -> list[Mistake]:
        if self.model != NETWORK:
            if self.network is not None:
                return [(("network",), f"belongs to the model {NETWORK}, not to {self.model}")]
            if not self.parameters and "parameters" not in self.model_fields_set:
                return [(("parameters",), "is missing: parameters of the model, SI")]
            return friction_mistakes(self.model, self.parameters, self.modifiers)
        if self.network is None:
            return [(("network",), "is missing: the trained network, as 'friction-hil train' writes it")]
        if self.parameters:
            return [(("parameters",), "a network has no parameters; those of its base model belong to network.base")]
        if self.network.base is not None:
            return [(("modifiers",), "belong to network.base")] if self.modifiers else []
        own = sorted(set(self.modifiers) - {"viscous", "ripple", "reversal", "speed"})
        return [(("modifiers", name), "a network without base model has no level to modify") for name in own]

    def create(self, axis: Axis) -> FrictionModel:
        """Create a new model."""
        if self.network is None:
            return friction.create(self.model, modifiers=self.modifiers, axis=axis, **self.parameters)
        base = self.network.base
        if base is None:
            return friction.FrictionModel(friction.NETWORK_ALONE, {}, self.modifiers, axis, self.network.network)
        family = friction.describe(base.model)
        return friction.FrictionModel(family, base.parameters, base.modifiers, axis, self.network.network)


class Gravity(Section):
    """Torque of gravity over position q: constant + sine sin(q) + cosine cos(q)."""

    constant: float = key("constant part", "N m or N", default=0.0, **_TORQUE)
    sine: float = key("factor of sin(position)", "N m or N", default=0.0, **_TORQUE)
    cosine: float = key("factor of cos(position)", "N m or N", default=0.0, **_TORQUE)

    def at(self, position: Position) -> Position:
        """Return the torque at a position or at each of an array, N m or N, positive if it opposes positive motion."""
        return gravity_torque(self.constant, self.sine, self.cosine, position)


class Load(Section):
    """Load behind the transmission, where it is known by itself; parts of the axis's inertia and friction."""

    inertia: float = key("inertia or mass of the load, at the axis; part of the whole", "kg m^2 or kg", gt=0, le=1e9)
    stiffness: float | None = key(
        "stiffness of the coupling between motor and load; by default stiff",
        "N m/rad or N/m",
        default=None,
        gt=0,
        le=1e15,
    )
    damping: float = key("damping of the coupling", "N m s/rad or N s/m", default=0.0, ge=0, le=1e12)
    friction: float | None = key(
        "friction level of the load, part of that of the model; by default not known by itself",
        "N m or N",
        default=None,
        ge=0,
        le=MOST_TORQUE,
    )


class Mechanics(Section):
    """Mechanics of the axis apart from friction."""

    inertia: float = key("inertia or mass of motor and load, at the axis", "kg m^2 or kg", default=0.0, ge=0, le=1e9)
    offset: float = key("constant torque that is not friction", "N m or N", default=0.0, **_TORQUE)
    gravity: Gravity = key("torque of gravity", default=Gravity())
    delay_s: float = key("time from the command of a torque to its start", "s", default=0.0, ge=0, le=10)
    torque_lag_s: float = key("time constant of the torque", "s", default=0.0, ge=0, le=10)
    torque_ratio: float = key(
        "torque that the drive reports, over the torque commanded, in which this file is given",
        default=1.0,
        ge=0.1,
        le=10,
    )
    backlash: float = key("whole width of the gap between motor and load", "rad or m", default=0.0, ge=0, le=1e3)
    encoder: Literal["motor", "load"] = key(
        "side of the transmission on which the drive's position encoder is", default="motor"
    )
    load: Load | None = key("load behind the transmission; by default not known by itself", default=None)

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.load is not None and not self.load.inertia < self.inertia:
            refuse(self, [(("load", "inertia"), f"is part of mechanics.inertia, {self.inertia:g}, and so below it")])
        return self


class Thermal(Section):
    """Lumped thermal model of motor and transmission, for an axis whose temperature is not measured."""

    capacity: float = key("heat capacity", "J/K", gt=0, le=1e9)
    resistance: float = key("thermal resistance to the surroundings", "K/W", gt=0, le=1e9)
    ambient: float = key("temperature of the surroundings", "deg C", default=20.0, **_CELSIUS)
    initial: float | None = key(
        "temperature of the axis when a run begins; by default ambient, an axis that has cooled down",
        "deg C",
        default=None,
        **_CELSIUS,
    )
    copper_loss: float = key(
        "heat per square of torque: winding resistance over the square of the torque constant",
        "W/(N m)^2 or W/N^2",
        default=0.0,
        ge=0,
        le=1e9,
    )

    @model_validator(mode="after")
    def _check(self) -> Self:
        if self.capacity * self.resistance < _LEAST_THERMAL_S:
            message = f"times resistance is the time constant; it must be at least {_LEAST_THERMAL_S:g} s"
            refuse(self, [(("capacity",), message)])
        return self


class TorqueSignal(Section):
    """Signal of the recordings in which the torque was known but for its gain; see `identify --unknown-gain`."""

    column: str = key("column of the recordings, as `--column torque=` names it; empty if not known", default="")
    gain: float = key("torque per unit of the signal", "N m or N per unit of the signal", gt=0, le=MOST_TORQUE)
    back_emf: float = key(
        "torque that is lost per velocity: torque = gain * signal - back_emf * velocity",
        "N m s/rad or N s/m",
        default=0.0,
        **_TORQUE,
    )


NOT_IDENTIFIED = "not identified"  # beginning of a flag in `fit`: the friction is that of another axis


class ModelFile(Section):
    """Friction model and mechanics of one axis."""

    version: Literal[1] = key("version of this format", default=1)
    axis: Literal["rotary", "linear"] = key("rotary: rad, N m; linear: m, N")
    friction: Friction = key("friction model")
    mechanics: Mechanics = key("inertia, offset, gravity, delays", default=Mechanics())
    thermal: Thermal | None = key("thermal model, where the temperature is not measured; by default none", default=None)
    torque_signal: TorqueSignal | None = key(
        "gain of the signal that the recordings hold in place of a torque; recordings of the daemon need none",
        default=None,
    )
    fit: dict[str, Any] | None = key("provenance: recordings, errors, range of validity", default=None)

    _source_path: Path | None = PrivateAttr(default=None)

    @model_validator(mode="after")
    def _check(self) -> Self:
        try:
            _ = self.signal
        except ValidationError as error:
            refuse(self, [(("fit", "drive", *each["loc"]), each["msg"]) for each in error.errors()])
        if self.thermal is not None and not self.friction_model.depends_on_temperature:
            message = "has no effect: the friction has no modifier temperature, and no network with that input"
            refuse(self, [(("thermal",), message)])
        return self

    @property
    def signal(self) -> TorqueSignal | None:
        """Signal of the recordings and its gain: ``torque_signal``, or ``fit.drive`` of files before there was that."""
        drive = (self.fit or {}).get("drive")
        return TorqueSignal.model_validate(drive) if drive and self.torque_signal is None else self.torque_signal

    @property
    def is_of_other_axis(self) -> str:
        """The flag that says so, if the friction was not identified on this axis; else empty."""
        flags = (self.fit or {}).get("flags", ())
        return next((each for each in flags if str(each).startswith(NOT_IDENTIFIED)), "")

    @property
    def source_path(self) -> Path | None:
        """Path of the file from which this was loaded; None if it was given inline."""
        return self._source_path

    @property
    def friction_model(self) -> FrictionModel:
        """The friction model, a new object at each access."""
        return self.friction.create(self.axis)


def friction_mistakes(model: str, parameters: dict[str, Any], modifiers: dict[str, Any]) -> list[Mistake]:
    """Check model, parameters and modifiers against the registry of friction models."""
    try:
        family = friction.describe(model)
    except UsageError as error:
        return [(("model",), str(error))]
    known = {parameter.name: parameter for parameter in family.parameters}
    mistakes: list[Mistake] = []
    for name, value in parameters.items():
        try:
            if name in known:
                known[name].check(model, value)
            else:
                check_all(model, family.parameters, {name: value})
        except UsageError as error:
            mistakes.append((("parameters", name), str(error)))
    for name, parameter in known.items():
        if parameter.default is None and name not in parameters:
            try:
                check_all(model, family.parameters, {**family.example, name: None})
            except UsageError as error:
                mistakes.append((("parameters", name), str(error)))
    if mistakes:
        return mistakes
    try:
        family.check(check_all(model, family.parameters, parameters))
    except InvalidParameterError as error:
        return [(("parameters", *([error.parameter] if error.parameter else [])), str(error))]
    for name, content in modifiers.items():
        try:
            check_modifiers(family, parameters, {name: content})
        except InvalidParameterError as error:
            mistakes.append((("modifiers", *_steps(error.parameter or name)), str(error)))
    return mistakes


def _steps(path: str) -> list[str | int]:
    """Split ``ripple[0].order`` into ``ripple, 0, order``."""
    return [int(step) if step.isdigit() else step for step in re.findall(r"\w+", path)]
