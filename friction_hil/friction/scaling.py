"""Parameters of a friction model whose torque is a multiple of that of another one."""

from collections.abc import Mapping, Sequence
from typing import Any

from friction_hil.friction.dispatch import FAMILIES
from friction_hil.friction.modifiers import CURVES, HARMONIC, VISCOUS
from friction_hil.friction.parameters import Parameter, PointList

_TORQUE = "N m"  # the units of all parameters that are proportional to the torque begin with it


def scaled_friction(
    family: str, parameters: Mapping[str, Any], modifiers: Mapping[str, Any], factor: float
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Return parameters and modifiers of the model whose torque is ``factor`` times that of the given ones.

    This is exact for each family: its torque is homogeneous of degree one in the parameters that contain a torque, and
    the load torque of the modifier ``load`` is multiplied by the same factor. ``family``: not a network, which has no
    parameters that could be scaled. ``factor``: above zero.
    """
    own = FAMILIES[family].parameters
    changed = {**modifiers}
    if "direction" in modifiers:
        changed["direction"] = {
            side: _scaled(own, values, factor) for side, values in dict(modifiers["direction"] or {}).items()
        }
    for each in (VISCOUS, *CURVES):
        if modifiers.get(each.name) is not None:
            changed[each.name] = _scaled(each.parameters, modifiers[each.name], factor)
    if "ripple" in modifiers:
        changed["ripple"] = [_scaled(HARMONIC.parameters, each, factor) for each in modifiers["ripple"] or ()]
    return _scaled(own, parameters, factor), changed


def _scaled(known: Sequence[Parameter], values: Mapping[str, Any], factor: float) -> dict[str, Any]:
    by_name = {each.name: each for each in known}
    return {name: _times(by_name[name], value, factor) for name, value in values.items()}


def _times(parameter: Parameter, value: Any, factor: float) -> Any:
    if value is None:  # the default, which is scaled with the parameter that it names
        return None
    if isinstance(parameter, PointList):
        return [[speed, factor * torque] for speed, torque in value]
    if not parameter.unit.startswith(_TORQUE):
        return value
    return [factor * each for each in value] if isinstance(value, Sequence) else factor * value
