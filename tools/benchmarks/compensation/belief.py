"""The compensator's model of a plant's friction: the same family or another, with wrong parameters."""

from collections.abc import Container, Mapping
from typing import Any

from friction_hil import models
from friction_hil.friction.modifiers import SIDES
from friction_hil.models import FrictionModel

# The same quantity under two names
SYNONYMS = {"sigma0": "stiffness", "stiffness": "sigma0", "sigma2": "viscous", "viscous": "sigma2"}

_STICTION_TRAVEL = 5e-5  # rad or m: presliding distance assumed for a plant without presliding
_STRIBECK_VELOCITY = 0.1  # rad/s, assumed for a plant without one
_STIFFNESS_FRACTIONS = (0.4, 0.3, 0.2, 0.1)  # of Maxwell-slip elements with equal levels
_ATTRACTION_S = 0.01  # time in which a slipping element reaches its level


def converted(own: FrictionModel, name: str) -> FrictionModel:
    """Return a model of the family ``name`` with the friction of ``own``, modifiers included.

    Parameters of the same name are taken over. Of the others: viscous and sigma2 are the same; sigma0 is the
    presliding stiffness (of a static map: its level over 50 urad); coulomb and static are, where there is no such
    parameter, the break-away level; the Stribeck velocity of a model without is 0.1 rad/s; Maxwell-slip elements
    are four of equal level with 40, 30, 20 and 10 % of the stiffness, and slip within 10 ms.

    Raises
    ------
    UsageError
        The family has a parameter for which there is no rule.
    """
    if own.name == name:
        return own
    parameters = _derived(own, name)
    modifiers = dict(own.modifiers)
    if "direction" in modifiers:
        changes = modifiers["direction"]
        sides = {side: models.create(own.name, **{**own.given, **changes.get(side, {})}) for side in SIDES}
        modifiers["direction"] = {
            side: {key: value for key, value in _derived(model, name).items() if value != parameters[key]}
            for side, model in sides.items()
        }
    return models.create(name, modifiers=modifiers, axis=own.axis, **parameters)


def changed(
    own: FrictionModel,
    parameters: Mapping[str, Any],
    factors: Mapping[str, float],
    modifiers: Mapping[str, Any] | None,
) -> FrictionModel:
    """Return ``own`` with other values.

    Parameters
    ----------
    own : FrictionModel
    parameters : mapping
        Values that replace its own.
    factors : mapping
        Factors of its own values, in both directions of motion, by their name or synonym; factors of parameters that
        it does not have are ignored.
    modifiers : mapping or None
        Replace its own, if given.
    """

    def scaled(values: Mapping[str, Any]) -> dict[str, Any]:
        return {key: _times(value, _factor(key, factors)) for key, value in values.items()}

    changes = {key: value for key, value in own.parameters.items() if key in own.given or has_factor(key, factors)}
    kept = dict(own.modifiers)
    if "direction" in kept:
        kept["direction"] = {side: scaled(values) for side, values in kept["direction"].items()}
    kept = kept if modifiers is None else dict(modifiers)
    return models.create(own.name, modifiers=kept, axis=own.axis, **{**scaled(changes), **parameters})


def has_factor(name: str, others: Container[str]) -> bool:
    """True if ``name`` or its synonym is among the ``others``."""
    return name in others or SYNONYMS.get(name) in others


def _factor(name: str, factors: Mapping[str, float]) -> float:
    return factors.get(name, factors.get(SYNONYMS.get(name, ""), 1.0))


def _times(value: Any, factor: float) -> Any:
    if factor == 1.0 or isinstance(value, str):
        return value
    return [_times(each, factor) for each in value] if isinstance(value, list) else value * factor


def _derived(own: FrictionModel, name: str) -> dict[str, Any]:
    """Return the parameters of the family ``name`` for which there is a rule."""
    p, level = own.parameters, own.level
    stiffness = own.presliding_stiffness or level / _STICTION_TRAVEL
    viscous = p.get("viscous", p.get("sigma2", 0.0))
    rules = {
        "coulomb": level,
        "static": p.get("static_rested", p.get("coulomb", level)),
        "stribeck_velocity": _STRIBECK_VELOCITY,
        "viscous": viscous,
        "sigma2": viscous,
        "sigma0": stiffness,
    }
    if name == "gms":
        count = len(_STIFFNESS_FRACTIONS)
        rules["stiffness"] = [fraction * stiffness for fraction in _STIFFNESS_FRACTIONS]
        rules["weight"] = [1.0 / count] * count
        rules["attraction"] = level / _ATTRACTION_S
    names = [parameter.name for parameter in models.describe(name).parameters]
    return {each: p.get(each, rules.get(each)) for each in names if each in p or each in rules}
