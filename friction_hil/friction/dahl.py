"""Dahl friction: presliding as a yielding spring, without a Stribeck curve."""

from friction_hil.friction.curves import direction, modified, sliding
from friction_hil.friction.elementary import approach, buffer, decay, expm1, is_differentiated, log, log1p, toward
from friction_hil.friction.family import Family
from friction_hil.friction.parameters import COULOMB, VISCOUS, Parameter, positive
from friction_hil.numerics.jit import Array, inlined

_SIGMA0 = Parameter(
    "sigma0",
    "sigma0",
    "N m/rad",
    "presliding stiffness: slope of torque over position at zero torque",
    is_lower_allowed=False,
)
_EXPONENT = Parameter("exponent", "i", "1", "shape of the stress-strain curve", is_lower_allowed=False, default=1.0)
_BLOCK = 256  # samples; their intermediate results stay in the first-level cache


@inlined
def _path(p: Array, level: float, velocity: float, dt: float) -> float:
    """Compute the path travelled in ``dt`` in units of Fc / sigma0: sigma0 abs(v) dt / Fc."""
    return p[0] * abs(velocity) * dt / level


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

    With w = 1 - (F/Fc) sgn v, Dahl's equation is dw/dx = -(sigma0/Fc) w^i along the path x, which has a closed
    solution for any exponent. If load or temperature lower Fc below abs(F), w is negative, and the exponent 1 is used.
    """
    exponent, viscous = p[2], p[3]
    level = modified(p[1], extra, scale)
    sign = direction(velocity, 0.0)
    before = s[0]
    path = _path(p, level, velocity, dt)
    after = toward(before, level * sign, approach(path))
    rest = 1.0 - before * sign / level
    if exponent != 1.0 and velocity != 0.0 and rest > 0.0:
        # w^q - q path - 1, in a form that keeps its precision for exponents close to 1
        q = 1.0 - exponent
        remaining = expm1(q * log(rest)) - q * path
        after = level * sign
        if remaining > -1.0:
            after = level * sign * (0.0 - expm1(log1p(remaining) / q))
    elif is_differentiated(exponent) and rest > 0.0:
        # zero, but with the derivative over the exponent, which the branch for exponent 1 does not contain
        after = after + (exponent - 1.0) * level * sign * rest * decay(path) * path * (log(rest) - 0.5 * path)
    s[0] = after
    return after + viscous * level_velocity


_step = step


@inlined
def run(p: Array, s: Array, velocity: Array, dt: float, applied_torque: float, torque: Array) -> bool:
    """Fill ``torque`` for every sample, with the same bits as `step`; faster where the exponent is 1."""
    if p[2] != 1.0 or is_differentiated(p[2]):
        for k in range(velocity.shape[0]):
            torque[k] = _step(p, s, velocity[k], velocity[k], dt, 0.0, 1.0, applied_torque, 0.0)
        return False
    # Results that do not depend on the state are computed first, in loops that the compiler vectorises.
    level = modified(p[1], 0.0, 1.0)
    settled, fraction, spring = buffer(p, _BLOCK), buffer(p, _BLOCK), buffer(p, _BLOCK)
    for begin in range(0, velocity.shape[0], _BLOCK):
        v = velocity[begin : begin + _BLOCK]
        for k in range(v.shape[0]):
            settled[k] = level * direction(v[k], 0.0)
        for k in range(v.shape[0]):
            fraction[k] = approach(_path(p, level, v[k], dt))
        held = s[0]
        for k in range(v.shape[0]):
            held = toward(held, settled[k], fraction[k])
            spring[k] = held
        s[0] = held
        for k in range(v.shape[0]):
            torque[begin + k] = spring[k] + p[3] * v[k]
    return False  # the velocities have not been checked


@inlined
def steady(p: Array, velocity: float, extra: float, scale: float) -> float:
    """Compute the torque at constant ``velocity``; 0 at rest."""
    return sliding(modified(p[1], extra, scale), p[3], velocity, velocity, 0.0)


FAMILY = Family(
    name="dahl",
    summary="presliding spring that yields towards the Coulomb level; any exponent",
    formula="dF/dx = sigma0 |1 - (F/Fc) sgn v|^i sgn(1 - (F/Fc) sgn v);  torque F + Fv v",
    source="P. Dahl, The Aerospace Corporation TOR-0158(3107-18)-1, 1968; AIAA Journal 14(12), 1976",
    parameters=(_SIGMA0, positive(COULOMB), _EXPONENT, VISCOUS),
    states=("torque [N m]",),
    example={"sigma0": 2000.0, "coulomb": 0.08, "exponent": 1.0, "viscous": 2e-3},
)
