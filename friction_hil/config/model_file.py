"""The model file: friction, mechanics and provenance of one axis."""

import re
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, Self

from pydantic import PrivateAttr, model_validator

from friction_hil.config.messages import Mistake, refuse
from friction_hil.config.section import Section, key
from friction_hil.errors import UsageError

if TYPE_CHECKING:
    from friction_hil.models import FrictionModel


class Friction(Section):
    """A model of the registry and its parameters."""

    model: str = key("name of the friction model; 'friction-hil models' lists them")
    parameters: dict[str, Any] = key("the model's parameters, SI; 'friction-hil models NAME' describes them")
    modifiers: dict[str, Any] = key(
        "what changes the friction of any model: direction, viscous, load, temperature, ripple", default={}
    )

    @model_validator(mode="after")
    def _check(self) -> Self:
        refuse(self, friction_mistakes(self))
        return self


class Gravity(Section):
    """Torque of gravity over position q: constant + sine sin(q) + cosine cos(q)."""

    constant: float = key("constant part", "N m or N", default=0.0)
    sine: float = key("factor of sin(position)", "N m or N", default=0.0)
    cosine: float = key("factor of cos(position)", "N m or N", default=0.0)


class Mechanics(Section):
    """What the axis is beside its friction."""

    inertia: float = key("inertia or mass, seen at the axis", "kg m^2 or kg", default=0.0, ge=0)
    offset: float = key("constant torque that is no friction", "N m or N", default=0.0)
    gravity: Gravity = key("torque of gravity", default=Gravity())
    delay_s: float = key("from commanding a torque to its start", "s", default=0.0, ge=0)
    torque_lag_s: float = key("time constant of the torque", "s", default=0.0, ge=0)


class ModelFile(Section):
    """What is known of one axis: its friction model and mechanics."""

    version: Literal[1] = key("version of this format", default=1)
    axis: Literal["rotary", "linear"] = key("rotary: rad, N m; linear: m, N")
    friction: Friction = key("friction model")
    mechanics: Mechanics = key("inertia, offset, gravity, delays", default=Mechanics())
    fit: dict[str, Any] | None = key("provenance: recordings, errors, range of validity", default=None)

    _source_path: Path | None = PrivateAttr(default=None)

    @property
    def source_path(self) -> Path | None:
        """The file that this was loaded from; None for what stood inline."""
        return self._source_path

    @property
    def friction_model(self) -> "FrictionModel":
        """The friction model, made anew at each call."""
        from friction_hil import models

        friction = self.friction
        return models.create(friction.model, modifiers=friction.modifiers, axis=self.axis, **friction.parameters)


def friction_mistakes(friction: Friction) -> list[Mistake]:
    """Check model, parameters and modifiers against the registry of friction models."""
    from friction_hil import models
    from friction_hil.models.modifiers import check_modifiers
    from friction_hil.models.parameters import InvalidParameterError, check_all

    try:
        family = models.describe(friction.model)
    except UsageError as error:
        return [(("model",), str(error))]
    known = {parameter.name: parameter for parameter in family.parameters}
    mistakes: list[Mistake] = []
    for name, value in friction.parameters.items():
        try:
            if name in known:
                known[name].check(friction.model, value)
            else:
                check_all(friction.model, family.parameters, {name: value})
        except UsageError as error:
            mistakes.append((("parameters", name), str(error)))
    for name, parameter in known.items():
        if parameter.default is None and name not in friction.parameters:
            try:
                check_all(friction.model, family.parameters, {**family.example, name: None})
            except UsageError as error:
                mistakes.append((("parameters", name), str(error)))
    if mistakes:
        return mistakes
    try:
        family.check(check_all(friction.model, family.parameters, friction.parameters))
    except InvalidParameterError as error:
        return [(("parameters", *([error.parameter] if error.parameter else [])), str(error))]
    for name, content in friction.modifiers.items():
        try:
            check_modifiers(family, friction.parameters, {name: content})
        except InvalidParameterError as error:
            mistakes.append((("modifiers", *_steps(error.parameter or name)), str(error)))
    return mistakes


def _steps(place: str) -> list[str | int]:
    """Turn ``ripple[0].order`` into ``ripple, 0, order``."""
    return [int(step) if step.isdigit() else step for step in re.findall(r"\w+", place)]
