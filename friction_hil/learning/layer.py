"""The torque of a residual layer: a sum of features with amplitudes, as modifiers of a friction model."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from friction_hil import friction
from friction_hil.friction import FrictionModel
from friction_hil.friction.modifiers import SIDES
from friction_hil.learning import thresholds as th
from friction_hil.numerics.jit import Array

RIPPLE, REVERSAL, SPEED, LOAD = "ripple", "reversal", "speed", "load"  # groups of features: modifiers of a model
PARTS = {RIPPLE: ("cosine", "sine"), REVERSAL: SIDES, SPEED: SIDES, LOAD: ("motoring", "driven")}
_ABSCISSA = {REVERSAL: "distance", SPEED: "velocity"}


class Feature(NamedTuple):
    """What the torque of a layer depends on; the amplitude is that of a torque, N m or N."""

    group: str  # a key of `PARTS`
    # periods per revolution, on a linear axis per metre; distance since the last reversal, rad or m; speed, rad/s or
    # m/s; or load torque, N m or N, at which the friction is larger by the amplitude
    at: float
    part: str  # one of `PARTS` of the group


def pairs(group: str, places: Sequence[float]) -> tuple[Feature, ...]:
    """Return both features of a group at each of several places."""
    return tuple(Feature(group, at, part) for at in places for part in PARTS[group])


@dataclass(frozen=True, slots=True)
class Layer:
    """Torque that is added to that of a friction model."""

    features: tuple[Feature, ...]  # as `pairs` returns them
    amplitudes: tuple[float, ...]  # N m or N

    @property
    def groups(self) -> tuple[str, ...]:
        """Groups that it has features of."""
        return tuple(group for group in PARTS if any(each.group == group for each in self.features))

    @property
    def most(self) -> float:
        """Largest torque that it can give while the load is no larger than that of its features, N m or N."""
        found = 0.0
        for group in self.groups:
            own = np.reshape([a for each, a in self._each() if each.group == group], (-1, 2))
            found += math.fsum(np.hypot(own[:, 0], own[:, 1])) if group == RIPPLE else float(np.max(np.abs(own)))
        return found

    def _each(self) -> list[tuple[Feature, float]]:
        return list(zip(self.features, self.amplitudes, strict=True))

    def on(self, model: FrictionModel) -> FrictionModel:
        """Return a model with this torque beside its own.

        ``model`` has no modifiers of the layer's groups; a ripple is added to that of the model.
        """
        modifiers: dict[str, Any] = dict(model.modifiers)
        by_group: dict[str, dict[float, dict[str, float]]] = {}
        for each, amplitude in self._each():
            by_group.setdefault(each.group, {}).setdefault(each.at, {})[each.part] = amplitude
        for group, values in by_group.items():
            if group == RIPPLE:
                modifiers[group] = _with_harmonics(model.modifiers.get(group, ()), values)
            elif group == LOAD:
                modifiers[group] = {
                    part: math.fsum(each[part] / at for at, each in values.items()) for part in PARTS[group]
                }
            else:
                places = sorted(values)
                curve = {part: [values[at][part] for at in places] for part in SIDES}
                if group == REVERSAL:
                    places.append(th.CURVE_END * places[-1])
                    curve = {part: [*torques, 0.0] for part, torques in curve.items()}
                modifiers[group] = {_ABSCISSA[group]: places, **curve}
        return friction.create(model.name, modifiers=modifiers, axis=model.axis, **model.given)

    def limited(self, most: float) -> "Layer":
        """Return the layer with a torque of at most ``most``."""
        factor = min(1.0, most / self.most) if self.most > 0.0 else 1.0
        return Layer(self.features, tuple(factor * each for each in self.amplitudes))

    def __str__(self) -> str:
        orders = dict.fromkeys(each.at for each in self.features if each.group == RIPPLE)
        words = {RIPPLE: "ripple of order " + ", ".join(f"{each:g}" for each in orders)}
        words |= {REVERSAL: "distance since reversal", SPEED: "speed", LOAD: "load"}
        return " and ".join(words[group] for group in self.groups)


def between(layer: Layer | None, other: Layer | None, part: float) -> Layer | None:
    """Return what lies a part of the way from a layer to another one; None is a layer without torque."""
    if layer == other:
        return other
    found: dict[Feature, float] = {}
    for each, factor in ((layer, 1.0 - part), (other, part)):
        if each is not None:
            for feature, amplitude in zip(each.features, each.amplitudes, strict=True):
                found[feature] = found.get(feature, 0.0) + factor * amplitude
    return Layer(tuple(found), tuple(found.values()))


def columns(model: FrictionModel, features: Sequence[Feature], gradient: Any) -> Array:
    """Return the torque of each feature with an amplitude of one along a record, (n, m).

    ``model``: without modifiers of the features' groups, but for a ripple. ``gradient`` returns the derivatives (n, m)
    of a model's torque over weighted sums of parameters.
    """
    if not features:
        return np.asarray(gradient(model, []))
    layered = Layer(tuple(features), (0.0,) * len(features)).on(model)
    places = {group: sorted({each.at for each in features if each.group == group}) for group in PARTS}
    orders = [each["order"] for each in layered.modifiers.get(RIPPLE, ())]
    free = []
    for group, at, part in features:
        if group == LOAD:
            free.append({f"{LOAD}.{part}": 1.0 / at})
        elif group == RIPPLE:
            free.append({f"{RIPPLE}[{orders.index(at)}].{part}": 1.0})
        else:
            free.append({f"{group}.{part}[{places[group].index(at)}]": 1.0})
    return np.asarray(gradient(layered, free))


def _with_harmonics(present: Sequence[Any], added: dict[float, dict[str, float]]) -> list[dict[str, float]]:
    harmonics = [dict(each) for each in present]
    for order, parts in added.items():
        same = [each for each in harmonics if each["order"] == order]
        if same:
            for part in PARTS[RIPPLE]:
                same[0][part] += parts[part]
        else:
            harmonics.append({"order": order, **parts})
    return harmonics
