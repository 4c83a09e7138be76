"""Generalised Maxwell-slip: elastic elements in parallel that slip one by one; hysteresis with non-local memory."""

from collections.abc import Mapping
from typing import Any

from friction_hil.friction.curves import direction, gaussian_level, modified, sliding
from friction_hil.friction.elementary import approach, buffer, whole
from friction_hil.friction.family import Family, Packed
from friction_hil.friction.parameters import (
    COULOMB,
    STATIC,
    STRIBECK_VELOCITY,
    VISCOUS,
    InvalidParameterError,
    NumberList,
    Parameter,
    positive,
)
from friction_hil.numerics.dual import primal
from friction_hil.numerics.jit import Array, inlined

MAX_ELEMENTS = 20
STATES = 2 * MAX_ELEMENTS
_HEAD = 6  # values before the elements: attraction, coulomb, static, stribeck_velocity, viscous, number of elements
_SUM_TOLERANCE = 1e-6
_BLOCK = 256  # samples; their intermediate results stay in the first-level cache

_STIFFNESS = NumberList(
    "stiffness",
    "k_i",
    "N m/rad",
    "stiffness of each element",
    is_lower_allowed=False,
    least=2,
    most=MAX_ELEMENTS,
)
_WEIGHT = NumberList(
    "weight",
    "alpha_i",
    "1",
    "fraction of the level that each element carries; they sum to 1",
    is_lower_allowed=False,
    least=2,
    most=MAX_ELEMENTS,
)
_ATTRACTION = Parameter(
    "attraction", "C", "N m/s", "rate at which a slipping element approaches its level", is_lower_allowed=False
)


@inlined
def _level_at(p: Array, velocity: float, extra: float, scale: float) -> float:
    """Compute the level s(v), N m."""
    return modified(gaussian_level(velocity, p[1], p[2], p[3]), extra, scale)


@inlined
def _approached(p: Array, level: float, dt: float) -> float:
    """Compute the fraction of the distance to its level that a slipping element covers in ``dt``."""
    return approach(p[0] * dt / level)


@inlined
def _advanced(
    torque: float, slip: float, sign: float, bound: float, fraction: float, gain: float
) -> tuple[float, float]:
    """Advance the torque of an element and its direction of slip, ``slip``, by one step.

    ``sign`` is the direction of motion, ``bound`` the level of the element, ``fraction`` the result of `_approached`,
    and ``gain`` the torque that its spring gains if it sticks.
    """
    if sign != 0.0 and (slip == sign or torque * sign > bound):
        return torque + fraction * (bound * sign - torque), sign
    torque = torque + gain
    if torque * sign >= bound:
        return bound * sign, sign
    return torque, 0.0


@inlined
def step(
    p: Array,
    s: Array,
    velocity: float,
    level_velocity: float,
    dt: float,
    extra: float,
    scale: float,
    applied_torque: float,
    epsilon: float,
) -> float:
    """Compute the torque of one sample, exact for ``velocity`` held over ``dt``; see `friction_hil.friction.kernel`.

    The state of element i is its torque in s[2 i] and its direction of slip in s[2 i + 1], 0 while it sticks. An
    element that breaks away within a step ends the step at its level.
    """
    level = _level_at(p, level_velocity, extra, scale)
    count = whole(p[5])
    sign = direction(velocity, 0.0)
    fraction = _approached(p, level, dt)
    total = p[4] * level_velocity
    for i in range(count):
        bound = p[_HEAD + count + i] * level
        gain = p[_HEAD + i] * (velocity * dt)
        s[2 * i], s[2 * i + 1] = _advanced(s[2 * i], s[2 * i + 1], sign, bound, fraction, gain)
        total = total + s[2 * i]
    return total


@inlined
def run(p: Array, s: Array, velocity: Array, dt: float, applied_torque: float, torque: Array) -> bool:
    """Fill ``torque`` for every sample, with the same bits as `step`, but faster.

    Results that do not depend on the state are computed first, in loops that the compiler vectorises; then follows
    one element after the other, with its state in registers.
    """
    count = whole(p[5])
    level, fraction, total = buffer(p, _BLOCK), buffer(p, _BLOCK), buffer(p, _BLOCK)
    for begin in range(0, velocity.shape[0], _BLOCK):
        v = velocity[begin : begin + _BLOCK]
        for k in range(v.shape[0]):
            level[k] = _level_at(p, v[k], 0.0, 1.0)
        for k in range(v.shape[0]):
            fraction[k] = _approached(p, level[k], dt)
        for k in range(v.shape[0]):
            total[k] = p[4] * v[k]
        for i in range(count):
            stiffness, weight = p[_HEAD + i], p[_HEAD + count + i]
            held, slip = s[2 * i], primal(s[2 * i + 1])
            for k in range(v.shape[0]):
                sign = direction(v[k], 0.0)
                held, slip = _advanced(held, slip, sign, weight * level[k], fraction[k], stiffness * (v[k] * dt))
                total[k] = total[k] + held
            s[2 * i], s[2 * i + 1] = held, slip
        for k in range(v.shape[0]):
            torque[begin + k] = total[k]
    return False  # the velocities have not been checked


@inlined
def steady(p: Array, velocity: float, extra: float, scale: float) -> float:
    """Compute the torque at constant ``velocity``; 0 at rest."""
    return sliding(_level_at(p, velocity, extra, scale), p[4], velocity, velocity, 0.0)


def _check(parameters: Mapping[str, Any]) -> None:
    stiffness, weight = parameters["stiffness"], parameters["weight"]
    if len(stiffness) != len(weight):
        raise InvalidParameterError(
            f"gms: weight has {len(weight)} elements and stiffness {len(stiffness)}; the numbers must be equal",
            "weight",
        )
    if abs(sum(weight) - 1.0) > _SUM_TOLERANCE:
        raise InvalidParameterError(f"gms: the elements of weight sum to {sum(weight):.9g}, not to 1", "weight")


def _pack(parameters: Mapping[str, Any]) -> Packed:
    stiffness, weight = parameters["stiffness"], parameters["weight"]
    scalars = ("attraction", "coulomb", "static", "stribeck_velocity", "viscous")
    return Packed(
        [*(parameters[name] for name in scalars), float(len(weight)), *stiffness, *weight],
        [*scalars, None, *_STIFFNESS.element_names(len(weight)), *_WEIGHT.element_names(len(weight))],
    )


FAMILY = Family(
    name="gms",
    summary="Maxwell-slip elements: presliding hysteresis with non-local memory, Stribeck curve, lag",
    formula=(
        "element i sticks: dF_i/dt = k_i v, until |F_i| = alpha_i s(v);  "
        "it slips: dF_i/dt = C (alpha_i sgn v - F_i / s(v)), until v crosses zero;  "
        "s(v) = Fc + (Fs - Fc) exp(-(v/vs)^2);  F = sum F_i + Fv v"
    ),
    source="Lampaert, Al-Bender, Swevers, Proceedings of the International Tribology Conference / IEEE PhysCon, 2003",
    parameters=(_STIFFNESS, _WEIGHT, _ATTRACTION, positive(COULOMB), positive(STATIC), STRIBECK_VELOCITY, VISCOUS),
    states=("torque of each element [N m]", "direction of slip of each element"),
    example={
        "stiffness": [1600.0, 560.0, 200.0, 60.0],
        "weight": [0.25, 0.3, 0.25, 0.2],
        "attraction": 10.0,
        "coulomb": 0.08,
        "static": 0.12,
        "stribeck_velocity": 0.2,
        "viscous": 2e-3,
    },
    check=_check,
    pack=_pack,
)
