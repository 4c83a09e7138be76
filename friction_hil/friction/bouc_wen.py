"""Bouc-Wen hysteresis: gears and harmonic drives."""

from collections.abc import Mapping
from typing import Any

from friction_hil.friction.curves import direction, modified, sliding
from friction_hil.friction.elementary import approach, buffer, is_differentiated, log1p, mean_decay, power
from friction_hil.friction.family import Family
from friction_hil.friction.parameters import VISCOUS, InvalidParameterError, Parameter
from friction_hil.numerics.jit import Array, inlined

_STIFFNESS = Parameter("stiffness", "k", "N m/rad", "torque over hysteretic deflection z", is_lower_allowed=False)
_A = Parameter("A", "A", "1", "slope of z over position at z = 0", is_lower_allowed=False, default=1.0)
_BETA = Parameter("beta", "beta", "rad^-n", "part of the yielding that depends on the direction of motion")
_GAMMA = Parameter(
    "gamma", "gamma", "rad^-n", "part of the yielding that does not; beta + gamma must be above zero", lower=None
)
_EXPONENT = Parameter(
    "exponent", "n", "1", "sharpness of the transition from elastic to sliding", lower=1.0, default=1.0
)
_SUBSTEPS = 32
_LONGEST = 1e6  # path over the settled deflection: far beyond where everything has settled, and finite
_PATH_PER_SUBSTEP = 0.125
_SETTLING = 50.0  # path, over the settled deflection, after which nothing is left to settle in double precision
_BLOCK = 256  # samples; their intermediate results stay in the nearest cache


@inlined
def _settled(p: Array) -> float:
    """Deflection on which a long motion settles, rad."""
    return power(p[1] / (p[2] + p[3]), 1.0 / p[4])


@inlined
def _ratio(p: Array) -> float:
    """Yielding on the way back to z = 0, over that on the way from there."""
    return (p[2] - p[3]) / (p[2] + p[3])


@inlined
def _path(p: Array, settled: float, velocity: float, dt: float) -> float:
    """Path travelled in ``dt``, A abs(v) dt, over the settled deflection."""
    path = p[1] * abs(velocity) * dt / settled
    return path if path < _LONGEST else _LONGEST + 0.0 * p[1]


@inlined
def _yielding(relative: float, exponent: float) -> float:
    """abs(w)^(n-1), with w the deflection over the settled one; no power where it is 1 anyway."""
    if exponent == 1.0 and not is_differentiated(exponent):
        return 1.0
    return power(abs(relative), exponent - 1.0)


@inlined
def _share(path: float, slope: float) -> float:
    """Integral of exp(-slope x) along ``path``, ``slope`` >= 0: what a rate that falls so makes of the path."""
    x = path * slope
    return path * (approach(x) / x if x > 0.0 else 1.0 - 0.5 * x)


@inlined
def _away(z: float, target: float, yielding: float, share: float) -> float:
    """Deflection after a step away from zero: dz/dx = target - yielding z, never past the target."""
    after = z + share * (target - yielding * z)
    return target if abs(after) > abs(target) and abs(z) <= abs(target) else after


@inlined
def _back(z: float, target: float, yielding: float, slope: float, path: float) -> tuple[float, float]:
    """Deflection after a step back to zero and no further, and how much of the ``path`` it took."""
    rate = target - yielding * z
    if rate * target <= 0.0:  # with beta = 0 nothing brings it back from the settled deflection, nor from beyond
        return z, path
    after = z + path * mean_decay(path * slope) * rate
    if after * target < 0.0:
        return after, path
    # the linear equation dz/dx = rate - slope (z - z0) reaches zero after the path `crossing`
    bend = slope * z / rate
    # the series where the quotient's derivative would cancel
    share = log1p(bend) / bend if abs(bend) > 1e-5 else 1.0 - bend * (0.5 - bend * (1.0 / 3.0 - 0.25 * bend))
    crossing = 0.0 - z / rate * share
    return 0.0 * z, crossing if crossing < path else path


@inlined
def _deflected(p: Array, z: float, settled: float, sign: float, path: float) -> float:
    """Deflection after a ``path`` in the direction ``sign``.

    With w = z sgn v over the settled deflection, dw/dx = 1 - w^n for w >= 0 and 1 + r |w|^n below. Rosenbrock-
    Euler steps, exact for n = 1 and otherwise of second order, never past z = 0 nor past the settled deflection;
    after 32 of them what is left goes in one. What has settled stays so: that takes no steps.
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
            z = _away(z, target, yielding, _share(h, exponent * yielding))
        left = left - h
    return z


@inlined
def _torque(p: Array, settled: float, z: float, velocity: float, extra: float, scale: float) -> float:
    """Torque at a deflection; load and temperature change it as they change its level."""
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
    """Torque of one sample; see `friction_hil.friction.kernel`."""
    settled = _settled(p)
    s[0] = _deflected(p, s[0], settled, direction(velocity, 0.0), _path(p, settled, velocity, dt))
    return _torque(p, settled, s[0], level_velocity, extra, scale)


_step = step


@inlined
def run(p: Array, s: Array, velocity: Array, dt: float, applied_torque: float, torque: Array) -> None:
    """Fill ``torque`` with that of every sample: the bits of `step`, faster where the exponent is 1."""
    if p[4] != 1.0 or is_differentiated(p[4]):
        for k in range(velocity.shape[0]):
            torque[k] = _step(p, s, velocity[k], velocity[k], dt, 0.0, 1.0, applied_torque, 0.0)
        return
    # What does not depend on the state first, in loops that the compiler turns into vector instructions.
    settled, ratio = _settled(p), _ratio(p)
    target, path = buffer(p, _BLOCK), buffer(p, _BLOCK)
    share, deflection = buffer(p, _BLOCK), buffer(p, _BLOCK)
    for begin in range(0, velocity.shape[0], _BLOCK):
        v = velocity[begin : begin + _BLOCK]
        for k in range(v.shape[0]):
            target[k] = settled * direction(v[k], 0.0)
        for k in range(v.shape[0]):
            path[k] = _path(p, settled, v[k], dt)
        for k in range(v.shape[0]):
            share[k] = _share(path[k], 1.0)
        z = s[0]
        for k in range(v.shape[0]):
            if z * target[k] < 0.0:
                z, taken = _back(z, target[k], ratio, ratio, path[k])
                z = _away(z, target[k], 1.0, _share(path[k] - taken, 1.0))
            else:
                z = _away(z, target[k], 1.0, share[k])
            deflection[k] = z
        s[0] = z
        for k in range(v.shape[0]):
            torque[begin + k] = _torque(p, settled, deflection[k], v[k], 0.0, 1.0)


@inlined
def steady(p: Array, velocity: float, extra: float, scale: float) -> float:
    """Torque at constant ``velocity``; 0 at rest."""
    level = p[0] * _settled(p)
    return sliding(modified(level, extra, scale), p[5], velocity, velocity, 0.0)


def _check(parameters: Mapping[str, Any]) -> None:
    beta, gamma = parameters["beta"], parameters["gamma"]
    if not beta + gamma > 0.0:
        raise InvalidParameterError(
            f"bouc_wen: beta + gamma = {beta + gamma:g} must be above zero, or the deflection has no bound", "gamma"
        )


FAMILY = Family(
    name="bouc_wen",
    summary="smooth hysteresis of gears and harmonic drives, in position alone",
    formula="dz/dt = A v - beta |v| |z|^(n-1) z - gamma v |z|^n;  F = k z + Fv v",
    source="Wen, Journal of the Engineering Mechanics Division ASCE 102(2), 1976",
    parameters=(_STIFFNESS, _A, _BETA, _GAMMA, _EXPONENT, VISCOUS),
    states=("hysteretic deflection z [rad]",),
    example={"stiffness": 400.0, "A": 1.0, "beta": 3000.0, "gamma": 2000.0, "exponent": 1.0, "viscous": 2e-3},
    note="it dissipates in every cycle as long as gamma <= beta",
    check=_check,
    level=lambda p: p["stiffness"] * (p["A"] / (p["beta"] + p["gamma"])) ** (1.0 / p["exponent"]),
)
