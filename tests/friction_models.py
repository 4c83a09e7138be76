"""Random friction models, with and without modifiers, and random motions for them; shared by the model tests."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

import friction_hil as fh

DYNAMIC = ("armstrong", "bouc_wen", "dahl", "elasto_plastic", "gms", "lugre")
STATIC_MAPS = ("coulomb", "karnopp", "power_law", "stribeck", "table")
NAMES = tuple(sorted((*DYNAMIC, *STATIC_MAPS)))
MODIFIERS = ("direction", "load", "reversal", "ripple", "speed", "temperature", "viscous")
ABSCISSA = {"reversal": "distance", "speed": "velocity"}

_factors = st.floats(0.5, 2.0)
_viscous = {"lugre": "sigma2", "elasto_plastic": "sigma2", "power_law": "factor"}


def decades(low: float, high: float) -> st.SearchStrategy[float]:
    """Numbers between two bounds, every decade alike."""
    return st.floats(math.log10(low), math.log10(high)).map(lambda power: float(10.0**power))


def _level(draw: Any, name: str, level: float) -> dict[str, Any]:
    """Levels of the model, all near ``level``."""
    if name == "bouc_wen":
        return {}
    levels = {"coulomb": level}
    if name in ("coulomb", "stribeck", "karnopp", "lugre", "elasto_plastic", "gms"):
        levels["static"] = level * draw(st.floats(0.8, 3.0))
    if name == "armstrong":
        levels["static_released"] = level * draw(st.floats(1.0, 2.0))
        levels["static_rested"] = levels["static_released"] * draw(st.floats(1.0, 2.0))
    return levels


def _shape(draw: Any, name: str, level: float) -> dict[str, Any]:
    """Everything but the levels and the viscous part."""
    shape: dict[str, Any] = {}
    if name in ("stribeck", "karnopp", "armstrong", "lugre", "elasto_plastic", "gms"):
        shape["stribeck_velocity"] = draw(decades(1e-3, 10.0))
    if name in ("stribeck", "karnopp"):
        shape["stribeck_exponent"] = draw(st.sampled_from([0.5, 1.0, 2.0]))
    if name == "karnopp":
        shape["stick_velocity"] = shape["stribeck_velocity"] * draw(decades(1e-3, 1.0))
    if name == "armstrong":
        shape |= {"lag_s": draw(st.sampled_from([0.0, 1e-3, 0.0125])), "rise_s": draw(decades(1e-3, 10.0))}
        shape["stiffness"] = level * draw(decades(10.0, 1e5))
    if name == "power_law":
        shape["exponent"] = draw(st.sampled_from([0.3, 0.5, 1.0, 1.7]))
    if name in ("dahl", "lugre", "elasto_plastic"):
        shape["sigma0"] = level * draw(decades(10.0, 1e5))
    if name == "dahl":
        shape["exponent"] = draw(st.sampled_from([0.5, 0.9, 1.0, 1.5, 2.0, 3.0]))
    if name in ("lugre", "elasto_plastic"):
        shape["damping_velocity"] = draw(st.sampled_from([0.1, 10.0, math.inf]))
    if name == "elasto_plastic":
        shape["breakaway_ratio"] = draw(st.floats(0.05, 0.95))
    if name == "gms":
        shape |= _elements(draw, level)
    if name == "bouc_wen":
        shape |= {"stiffness": level * draw(decades(10.0, 1e5)), "A": draw(_factors)}
        shape["exponent"] = draw(st.sampled_from([1.0, 1.3, 2.0, 3.0]))
        # the settled deflection is a torque of `level` over the stiffness
        yielding = shape["A"] * (shape["stiffness"] / level) ** shape["exponent"]
        fraction = draw(st.floats(0.5, 1.0))  # gamma <= beta, where it dissipates
        shape |= {"beta": fraction * yielding, "gamma": (1.0 - fraction) * yielding}
    return shape


def _elements(draw: Any, level: float) -> dict[str, Any]:
    count = draw(st.integers(2, 6))
    shares = [draw(st.floats(0.05, 1.0)) for _ in range(count)]
    weights = [fraction / sum(shares) for fraction in shares]
    stiffness = [level * weight / draw(decades(1e-5, 1e-2)) for weight in weights]
    return {"weight": weights, "stiffness": stiffness, "attraction": level * draw(decades(1.0, 1e3))}


def _table(draw: Any, level: float) -> dict[str, Any]:
    """Points of one direction that serve both, or of each."""
    sides = draw(st.sampled_from([(1.0,), (-1.0,), (-1.0, 1.0)]))
    points = []
    for sign in sides:
        gaps = draw(st.lists(decades(1e-3, 1.0), min_size=1, max_size=6))
        points += [[sign * float(v), sign * level * draw(_factors)] for v in np.cumsum(gaps)]
    return {"points": points, "interpolation": draw(st.sampled_from(["monotone", "linear"]))}


@st.composite
def parameters(draw: Any, name: str, *, is_bounded: bool = False) -> dict[str, Any]:
    """Parameters of a model; with ``is_bounded`` without any part that grows with velocity."""
    level = draw(decades(1e-3, 1e3))
    if name == "table":
        return _table(draw, level)
    values = _level(draw, name, level) | _shape(draw, name, level)
    values[_viscous.get(name, "viscous")] = 0.0 if is_bounded else level * draw(st.floats(0.0, 10.0))
    if name in ("lugre", "elasto_plastic"):
        values["sigma1"] = 0.0 if is_bounded else level * draw(st.floats(0.0, 10.0))
    return values


def level_of(name: str, values: dict[str, Any]) -> float:
    """Greatest torque that a model of these parameters reaches without its viscous part."""
    if name == "table":
        return max(abs(torque) for _, torque in values["points"])
    if name == "bouc_wen":
        settled = (values.get("A", 1.0) / (values["beta"] + values["gamma"])) ** (1.0 / values.get("exponent", 1.0))
        return float(values["stiffness"] * settled)
    names = ("coulomb", "static", "static_released", "static_rested")
    return float(max(values[one] for one in names if one in values))


@st.composite
def modifiers(draw: Any, name: str, values: dict[str, Any], *, allowed: tuple[str, ...] = MODIFIERS) -> dict[str, Any]:
    """Some modifiers that fit a model of these parameters."""
    level = level_of(name, values)
    chosen: dict[str, Any] = {}
    for kind in allowed:
        if not draw(st.booleans()):
            continue
        if kind == "direction" and name != "table":
            changed = [one for one in ("coulomb", "static", "beta") if one in values]
            changed.append(_viscous.get(name, "viscous"))
            chosen[kind] = {
                side: {one: values[one] * draw(_factors) for one in changed} for side in ("positive", "negative")
            }
        elif kind == "load":
            chosen[kind] = {"motoring": draw(st.floats(0.0, 1.0)), "driven": draw(st.floats(0.0, 1.0))}
        elif kind == "ripple":
            orders = draw(st.lists(st.integers(1, 40), min_size=1, max_size=3, unique=True))
            amplitudes = st.floats(-0.1 * level, 0.1 * level, allow_subnormal=False)
            chosen[kind] = [{"order": one, "cosine": draw(amplitudes), "sine": draw(amplitudes)} for one in orders]
        elif kind in ABSCISSA:
            gaps = draw(st.lists(decades(1e-4, 1.0), min_size=1, max_size=4))
            torques = st.lists(
                st.floats(-0.1 * level, 0.1 * level, allow_subnormal=False), min_size=len(gaps), max_size=len(gaps)
            )
            points = [float(x) for x in np.cumsum(gaps)]
            chosen[kind] = {ABSCISSA[kind]: points, "positive": draw(torques), "negative": draw(torques)}
        elif kind == "temperature":
            chosen[kind] = {"reference": draw(st.floats(10.0, 50.0)), "coefficient": draw(st.floats(-0.02, 0.02))}
        elif kind == "viscous":
            chosen[kind] = {"quadratic": level * draw(st.floats(0.0, 1.0)), "cubic": level * draw(st.floats(0.0, 1.0))}
    return chosen


@st.composite
def models(draw, names=NAMES, *, allowed=MODIFIERS, is_bounded=False):
    """A model, plain or with some of the ``allowed`` modifiers."""
    name = draw(st.sampled_from(names))
    values = draw(parameters(name, is_bounded=is_bounded))
    if is_bounded:
        allowed = tuple(kind for kind in allowed if kind != "viscous")
    chosen = draw(modifiers(name, values, allowed=allowed)) if allowed and draw(st.booleans()) else {}
    return fh.models.create(name, **values, **({"modifiers": chosen} if chosen else {}))


def again(model: fh.models.FrictionModel, changes: dict[str, Any] | None = None, **modified: Any) -> Any:
    """The same model with other parameters or other modifiers."""
    chosen = dict(model.modifiers) | modified
    extra = {"modifiers": chosen} if chosen else {}
    return fh.models.create(model.name, **model.parameters | (changes or {}), **extra)


def mirrored(model: fh.models.FrictionModel) -> Any:
    """The mirrored model: opposite inputs give the opposite torque."""
    changes: dict[str, Any] = {}
    modified: dict[str, Any] = {}
    if model.name == "table":
        changes["points"] = [[-v, -torque] for v, torque in model.parameters["points"]]
    if "direction" in model.modifiers:
        sides = model.modifiers["direction"]
        modified["direction"] = {
            side: sides[other] for side, other in (("positive", "negative"), ("negative", "positive")) if other in sides
        }
    for kind in ABSCISSA:
        if kind in model.modifiers:
            curve = model.modifiers[kind]
            modified[kind] = curve | {"positive": curve["negative"], "negative": curve["positive"]}
    if "ripple" in model.modifiers:
        modified["ripple"] = [one | {"cosine": -one["cosine"]} for one in model.modifiers["ripple"]]
    return again(model, changes, **modified)


def level_bound(model: fh.models.FrictionModel, inputs: dict[str, Any]) -> float:
    """Bound of the torque of a model without viscous parts, for these inputs."""
    sides = model.modifiers.get("direction", {})
    cases = [dict(model.parameters) | dict(sides.get(side, {})) for side in ("positive", "negative")]
    level = max(level_of(model.name, case) for case in [dict(model.parameters), *cases])
    least = min(level_of(model.name, case) for case in [dict(model.parameters), *cases])
    load, warmth = model.modifiers.get("load"), model.modifiers.get("temperature")
    bound = level
    if load:
        extra = max(load["motoring"], load["driven"]) * float(np.abs(inputs["load_torque"]).max())
        # Bouc-Wen scales its torque, and may come from the other direction's level
        bound = level * (1.0 + extra / least) if model.name == "bouc_wen" else level + extra
    if warmth and inputs.get("temperature") is not None:
        change = warmth["coefficient"] * (np.asarray(inputs["temperature"]) - warmth["reference"])
        bound *= max(float((1.0 + change).max()), 1.0)
    ripple = sum(abs(one["cosine"]) + abs(one["sine"]) for one in model.modifiers.get("ripple", []))
    curves = [model.modifiers[kind] for kind in ABSCISSA if kind in model.modifiers]
    beside = sum(max(map(abs, [*each["positive"], *each["negative"]])) for each in curves)
    return float(bound + ripple + beside)


@dataclass(frozen=True)
class Motion:
    """Velocities with the lengths of their samples and what else a model is fed."""

    velocity: np.ndarray
    dt: np.ndarray | float
    inputs: dict[str, np.ndarray]

    def simulate(self, model: Any) -> Any:
        """Torque of the model over this motion."""
        return model.simulate(self.velocity, self.dt, **self.inputs)

    def steps(self) -> Any:
        """Arguments of `Runner.step`, sample by sample."""
        lengths = np.broadcast_to(self.dt, self.velocity.shape)
        for k, (v, dt) in enumerate(zip(self.velocity, lengths, strict=True)):
            yield float(v), float(dt), {name: float(values[k]) for name, values in self.inputs.items()}

    def opposite(self) -> "Motion":
        """The same motion in the opposite direction; the temperature is unchanged."""
        turned = {name: values if name == "temperature" else -values for name, values in self.inputs.items()}
        return Motion(-self.velocity, self.dt, turned)


def speeds(fastest: float = 1e3) -> st.SearchStrategy[float]:
    """Velocities of both signs over all decades, and standstill."""
    moving = st.builds(math.copysign, decades(1e-7 * fastest, fastest), st.sampled_from([-1.0, 1.0]))
    return st.one_of(st.just(0.0), moving)


@st.composite
def motions(draw, model, *, fastest=1000.0, periods=None, longest=30):
    """A motion with every input that the model's modifiers ask for, and an applied torque."""
    velocity = draw(arrays(float, st.integers(1, longest), elements=speeds(fastest)))
    same = velocity.shape
    dt = draw(periods if periods is not None else decades(1e-6, 1.0))
    steps = dt * draw(arrays(float, same, elements=st.floats(0.5, 2.0))) if draw(st.booleans()) else dt
    level = level_of(model.name, dict(model.parameters))
    torques = arrays(float, same, elements=st.floats(-3.0 * level, 3.0 * level, allow_subnormal=False))
    inputs = {"applied_torque": draw(torques)}
    if "ripple" in model.modifiers:
        inputs["position"] = draw(arrays(float, same, elements=st.floats(-100.0, 100.0, allow_subnormal=False)))
    if "load" in model.modifiers:
        inputs["load_torque"] = draw(torques)
    if "temperature" in model.modifiers and draw(st.booleans()):
        inputs["temperature"] = draw(arrays(float, same, elements=st.floats(-20.0, 120.0)))
    return Motion(velocity, steps, inputs)
