"""Bouc-Wen hysteresis: gears and harmonic drives."""

from collections.abc import Mapping
from typing import Any

from friction_hil.friction.curves import direction, modified, sliding
from friction_hil.friction.elementary import approach, buffer, is_differentiated, log1p, mean_decay, power
from friction_hil.friction.family import Family
from friction_hil.friction.parameters import VISCOUS, InvalidParameterError, Parameter
from friction_hil.numerics.jit import Array, inlined

_STIFFNESS = Parameter("stiffness", "k", "N m/rad", "torque per hysteretic deflection z", is_lower_allowed=False)
_A = Parameter("A", "A", "1", "slope of z over position at z = 0", is_lower_allowed=False, default=1.0)
_BETA = Parameter("beta", "beta", "rad^-n", "yielding that depends on the direction of motion")
_GAMMA = Parameter(
    "gamma",
    "gamma",
    "rad^-n",
    "yielding that does not depend on the direction of motion; beta + gamma must be above zero",
    lower=None,
)
_EXPONENT = Parameter(
    "exponent", "n", "1", "sharpness of the transition from elastic to sliding", lower=1.0, default=1.0
)
_SUBSTEPS = 32
_LONGEST = 1e6  # longest path, in settled deflections: far beyond settling, and finite
_PATH_PER_SUBSTEP = 0.125
_SETTLING = 50.0  # path, in settled deflections, after which the deflection has settled to double precision
_BLOCK = 256  # samples; their intermediate results stay in the first-level cache


@inlined
def _settled(p: Array) -> float:
    """Compute the deflection that a long motion settles to, rad."""
    return power(p[1] / (p[2] + p[3]), 1.0 / p[4])


@inlined
def _ratio(p: Array) -> float:
    """Compute the ratio of the yielding while abs(z) falls to the yielding while it rises."""
    return (p[2] - p[3]) / (p[2] + p[3])


@inlined
def _path(p: Array, settled: float, velocity: float, dt: float) -> float:
    """Compute the path travelled in ``dt``, A abs(v) dt, in settled deflections."""
    path = p[1] * abs(velocity) * dt / settled
    return path if path < _LONGEST else _LONGEST + 0.0 * p[1]


@inlined
def _yielding(relative: float, exponent: float) -> float:
    """Compute abs(w)^(n-1), with w the deflection over the settled deflection; without a power where n is 1."""
    if exponent == 1.0 and not is_differentiated(exponent):
        return 1.0
    return power(abs(relative), exponent - 1.0)


@inlined
def _decayed_path(path: float, slope: float) -> float:
    """Compute the integral of exp(-slope x) for x from 0 to ``path``, with ``slope`` >= 0."""
    x = path * slope
    return path * (approach(x) / x if x > 0.0 else 1.0 - 0.5 * x)


@inlined
def _away(z: float, target: float, yielding: float, decayed: float) -> float:
    """Compute the deflection after a step away from zero: dz/dx = target - yielding z, not beyond the target.

    ``decayed`` is the `_decayed_path` of the step.
    """
    after = z + decayed * (target - yielding * z)
    return target if abs(after) > abs(target) and abs(z) <= abs(target) else after


@inlined
def _back(z: float, target: float, yielding: float, slope: float, path: float) -> tuple[float, float]:
    """Compute the deflection after a step towards zero, which ends at zero, and the part of ``path`` it used."""
    rate = target - yielding * z
    if rate * target <= 0.0:  # with beta = 0 a deflection at or beyond the settled one does not return
        return z, path
    after = z + path * mean_decay(path * slope) * rate
    if after * target < 0.0:
        return after, path
    # the linear equation dz/dx = rate - slope (z - z0) reaches zero after the path `crossing`
    bend = slope * z / rate
    # a series where the derivative of the quotient would suffer from cancellation
    factor = log1p(bend) / bend if abs(bend) > 1e-5 else 1.0 - bend * (0.5 - bend * (1.0 / 3.0 - 0.25 * bend))
    crossing = 0.0 - z / rate * factor
    return 0.0 * z, crossing if crossing < path else path


@inlined
def _deflected(p: Array, z: float, settled: float, sign: float, path: float) -> float:
    """Compute the deflection after a ``path`` in the direction ``sign``.

    With w = z sgn v over the settled deflection, dw/dx = 1 - w^n for w >= 0 and 1 + r |w|^n for w < 0. It is
    integrated by Rosenbrock-Euler steps, which are exact for n = 1 and of second order otherwise and stop at z = 0
    and at the settled deflection. The 32nd step takes the rest of the path. A settled deflection takes no steps.
    """
    exponent, ratio, target = p[4], _ratio(p), settled * sign
    left = path
    for k in range(_SUBSTEPS):
        if left <= 0.0:
            break
        if exponent != 1.0 and (z == target or (left > _SETTLING and z * target >= 0.0)):
            return target
        h = left
        if exponent != 1.0 and k < _SUBSTEPS - 1 and h > _PATH_PER_SUBSTEP:
            h = _PATH_PER_SUBSTEP + 0.0 * h
        yielding = _yielding(z / settled, exponent)
        if z * target < 0.0:
            z, h = _back(z, target, ratio * yielding, exponent * (ratio * yielding), h)
        else:
            z = _away(z, target, yielding, _decayed_path(h, exponent * yielding))
        left = left - h
    return z


@inlined
def _torque(p: Array, settled: float, z: float, velocity: float, extra: float, scale: float) -> float:
    """Compute the torque at a deflection, scaled by the effect of load and temperature on the level."""
    level = p[0] * settled
    return modified(level, extra, scale) / level * (p[0] * z) + p[5] * velocity


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
    """Compute the torque of one sample; see `friction_hil.friction.kernel`."""
    settled = _settled(p)
    s[0] = _deflected(p, s[0], settled, direction(velocity, 0.0), _path(p, settled, velocity, dt))
    return _torque(p, settled, s[0], level_velocity, extra, scale)


_step = step


@inlined
def run(p: Array, s: Array, velocity: Array, dt: float, applied_torque: float, torque: Array) -> bool:
    """Fill ``torque`` for every sample, with the same bits as `step`; faster where the exponent is 1."""
    if p[4] != 1.0 or is_differentiated(p[4]):
        for k in range(velocity.shape[0]):
            torque[k] = _step(p, s, velocity[k], velocity[k], dt, 0.0, 1.0, applied_torque, 0.0)
        return False
    # Results that do not depend on the state are computed first, in loops that the compiler vectorises.
    settled, ratio = _settled(p), _ratio(p)
    target, path = buffer(p, _BLOCK), buffer(p, _BLOCK)
    decayed, deflection = buffer(p, _BLOCK), buffer(p, _BLOCK)
    for begin in range(0, velocity.shape[0], _BLOCK):
        v = velocity[begin : begin + _BLOCK]
        for k in range(v.shape[0]):
            target[k] = settled * direction(v[k], 0.0)
        for k in range(v.shape[0]):
            path[k] = _path(p, settled, v[k], dt)
        for k in range(v.shape[0]):
            decayed[k] = _decayed_path(path[k], 1.0)
        z = s[0]
        for k in range(v.shape[0]):
            if z * target[k] < 0.0:
                z, used = _back(z, target[k], ratio, ratio, path[k])
                z = _away(z, target[k], 1.0, _decayed_path(path[k] - used, 1.0))
            else:
                z = _away(z, target[k], 1.0, decayed[k])
            deflection[k] = z
        s[0] = z
        for k in range(v.shape[0]):
            torque[begin + k] = _torque(p, settled, deflection[k], v[k], 0.0, 1.0)
    return False  # the velocities have not been checked


@inlined
def steady(p: Array, velocity: float, extra: float, scale: float) -> float:
    """Compute the torque at constant ``velocity``; 0 at rest."""
    level = p[0] * _settled(p)
    return sliding(modified(level, extra, scale), p[5], velocity, velocity, 0.0)


def _check(parameters: Mapping[str, Any]) -> None:
    beta, gamma = parameters["beta"], parameters["gamma"]
    if not beta + gamma > 0.0:
        raise InvalidParameterError(
            f"bouc_wen: beta + gamma = {beta + gamma:g} must be above zero; otherwise the deflection is unbounded",
            "gamma",
        )


FAMILY = Family(
    name="bouc_wen",
    summary="smooth hysteresis of gears and harmonic drives, independent of the rate",
    formula="dz/dt = A v - beta |v| |z|^(n-1) z - gamma v |z|^n;  F = k z + Fv v",
    source="Wen, Journal of the Engineering Mechanics Division ASCE 102(2), 1976",
    parameters=(_STIFFNESS, _A, _BETA, _GAMMA, _EXPONENT, VISCOUS),
    states=("hysteretic deflection z [rad]",),
    example={"stiffness": 400.0, "A": 1.0, "beta": 3000.0, "gamma": 2000.0, "exponent": 1.0, "viscous": 2e-3},
    note="dissipates energy in every cycle if gamma <= beta",
    check=_check,
    stiffness=lambda p: p["stiffness"] * p["A"],
    level=lambda p: p["stiffness"] * (p["A"] / (p["beta"] + p["gamma"])) ** (1.0 / p["exponent"]),
)
