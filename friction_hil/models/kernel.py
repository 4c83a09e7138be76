"""One compiled step for every model, chosen by number: loop, replay, fitting and simulated plant call it."""

import numpy as np

from friction_hil.jit import Array, compiled
from friction_hil.models import coulomb, dahl, lugre, stribeck

COULOMB, STRIBECK, DAHL, LUGRE = range(4)
KINDS = {"coulomb": COULOMB, "stribeck": STRIBECK, "dahl": DAHL, "lugre": LUGRE}
FAMILIES = {family.name: family for family in (coulomb.FAMILY, stribeck.FAMILY, dahl.FAMILY, lugre.FAMILY)}

PARAMETER_ROOM = 8
STATE_ROOM = 1

_coulomb_step, _coulomb_steady = coulomb.step, coulomb.steady
_stribeck_step, _stribeck_steady = stribeck.step, stribeck.steady
_dahl_step, _dahl_steady = dahl.step, dahl.steady
_lugre_step, _lugre_steady = lugre.step, lugre.steady


@compiled
def step(
    kind: int,
    p: Array,
    s: Array,
    velocity: float,
    level_velocity: float,
    dt: float,
    applied_torque: float,
    epsilon: float,
) -> float:
    """Advance the state over one sample and return the friction torque.

    Parameters
    ----------
    kind
        Number of the model, from `KINDS`.
    p, s
        Parameters, in the order of the family, and state, changed in place.
    velocity, level_velocity
        The velocity that drives the state and the direction, and the one at which the level, the damping and
        the viscous part are taken, rad/s. The same, except in a compensator, which knows them from different
        sources.
    dt
        Time over which ``velocity`` is held, s, above zero.
    applied_torque
        Torque that friction balances while a static map sticks (``velocity`` 0, ``epsilon`` 0), N m.
    epsilon
        Width over which a static map's jump at zero velocity is smoothed, rad/s; 0 for the exact map.
        Dynamic models have no jump and ignore it.
    """
    if kind == LUGRE:
        return _lugre_step(p, s, velocity, level_velocity, dt, applied_torque, epsilon)
    if kind == DAHL:
        return _dahl_step(p, s, velocity, level_velocity, dt, applied_torque, epsilon)
    if kind == STRIBECK:
        return _stribeck_step(p, s, velocity, level_velocity, dt, applied_torque, epsilon)
    return _coulomb_step(p, s, velocity, level_velocity, dt, applied_torque, epsilon)


@compiled
def steady(kind: int, p: Array, velocity: float) -> float:
    """Torque that the model settles on at constant ``velocity``, N m; 0 at rest."""
    if kind == LUGRE:
        return _lugre_steady(p, velocity)
    if kind == DAHL:
        return _dahl_steady(p, velocity)
    if kind == STRIBECK:
        return _stribeck_steady(p, velocity)
    return _coulomb_steady(p, velocity)


@compiled
def simulate(kind: int, p: Array, s: Array, velocity: Array, dt: Array, applied_torque: Array) -> Array:
    """Torque of every sample; ``dt`` and ``applied_torque`` have one element, or one a sample."""
    n = velocity.shape[0]
    dt_stride = 1 if dt.shape[0] > 1 else 0
    applied_stride = 1 if applied_torque.shape[0] > 1 else 0
    torque = np.empty(n)
    for k in range(n):
        v = velocity[k]
        torque[k] = step(kind, p, s, v, v, dt[k * dt_stride], applied_torque[k * applied_stride], 0.0)
    return torque


@compiled
def steady_curve(kind: int, p: Array, velocity: Array) -> Array:
    """Steady torque at every ``velocity``."""
    torque = np.empty(velocity.shape[0])
    for k in range(velocity.shape[0]):
        torque[k] = steady(kind, p, velocity[k])
    return torque
