"""The step of every model with its modifiers: loop, replay, fitting and simulated plant call it.

A model's parameters are one flat array, ``p``::

    0                whether there are modifiers, or a network
    1, 2, 3          where the parameters for negative motion begin, the modifiers, and the network (0: none)
    4 ...            the model's own parameters, in the order of its family's `pack`

and its state another, ``s``: the family's own states from 0 on, the direction of the last motion, and the state of
the network. Each family has ``step(p, s, velocity, level_velocity, dt, extra, scale, applied_torque, epsilon)`` and
``steady(p, velocity, extra, scale)``, with ``p`` beginning at its own parameters; ``extra`` and ``scale`` are
what load and temperature do to its level.
"""

import math
from typing import Any

import numpy as np
from numba import types

from friction_hil.friction import modifiers, network
from friction_hil.friction.curves import direction
from friction_hil.friction.dispatch import (
    FAMILY_STATES,
    KARNOPP,
    LAST_STATIC,
    each_step,
    family_run,
    family_steady,
    family_step,
    number,
)
from friction_hil.friction.elementary import part, whole
from friction_hil.numerics.dual import DualArrayType, borrowed_at, overloaded, primal
from friction_hil.numerics.jit import Array, compiled, compiled_for_one_sample, inlined

HEADER = 4
_CACHED = 32768  # samples, a quarter of a megabyte: what is read twice is still in the cache
PLAIN_ROOM = 640  # a full table for each direction, and the modifiers
PARAMETER_ROOM = 2048  # of a model with a network
DIRECTION = FAMILY_STATES
NETWORK = DIRECTION + 1
STATE_ROOM = NETWORK + network.STATE_ROOM
WHOLE_ROOM = 2 + PARAMETER_ROOM + STATE_ROOM

_level_extra, _level_scale = modifiers.level_extra, modifiers.level_scale
_fast_torque, _ripple_torque = modifiers.fast_torque, modifiers.ripple_torque
_network_step = network.step_apart


def _learned_torque(p: Array, s: Array, *inputs: Any) -> float:
    """Torque of the network, N m; 0 without one, and to automatic differentiation, which has no use for it.

    Parameters in a record say by their room whether there can be one: its code takes as long to compile as all the
    rest.
    """
    raise NotImplementedError  # compiled code only


@overloaded(_learned_torque)
def _choose_learned_torque(p: Any, s: Any, *inputs: Any) -> Any:
    if isinstance(p, DualArrayType) or (isinstance(p, types.NestedArray) and p.shape[0] <= PLAIN_ROOM):
        return lambda p, s, *inputs: 0.0

    def of_network(p, s, *inputs):  # type: ignore[no-untyped-def]
        begin = int(p[3])
        return _network_step(part(p, begin), part(s, NETWORK), *inputs) if begin > 0 else 0.0

    return of_network


@inlined
def step(
    kind: Any,
    p: Array,
    s: Array,
    velocity: float,
    level_velocity: float,
    dt: float,
    position: float,
    load_torque: float,
    temperature: float,
    applied_torque: float,
    epsilon: float,
) -> float:
    """Advance the state over one sample and return the friction torque.

    Parameters
    ----------
    kind
        Number or tag of the family; see `dispatch`.
    p, s
        Parameters and state; the state is changed in place.
    velocity, level_velocity
        The velocity that drives the state and the direction, and the one at which the level, the damping and
        the viscous part are taken, rad/s. The same, except in a compensator, which knows them from different
        sources.
    dt
        Time over which ``velocity`` is held, s, above zero.
    position
        For the ripple, rad.
    load_torque
        For load dependence, N m, positive where it opposes positive motion.
    temperature
        For temperature dependence, deg C; NaN for the reference.
    applied_torque
        Torque that friction balances while a static map sticks (``velocity`` 0, ``epsilon`` 0), N m.
    epsilon
        Width over which a static map's jump at zero velocity is smoothed, rad/s; 0 for the exact map.
        Dynamic models have no jump and ignore it.
    """
    own_state = part(s, 0)
    if p[0] == 0.0:
        own = part(p, HEADER)
        return family_step(kind, own, own_state, velocity, level_velocity, dt, 0.0, 1.0, applied_torque, epsilon)
    m = part(p, whole(p[2]))
    ripple = _ripple_torque(m, position)
    pushed = applied_torque - ripple
    if velocity != 0.0:
        s[DIRECTION] = direction(velocity, 0.0)
    sign = primal(s[DIRECTION])
    is_stuck = velocity == 0.0 or (number(kind) == KARNOPP and abs(velocity) < primal(p[HEADER + 5]))
    if is_stuck and epsilon == 0.0 and number(kind) <= LAST_STATIC:
        sign = direction(primal(pushed), 0.0)  # it holds with the level of the side to which it would break away
    own = part(p, whole(p[1]) if sign < 0.0 else HEADER)
    extra, scale = _level_extra(m, load_torque, sign), _level_scale(m, temperature)
    torque = family_step(kind, own, own_state, velocity, level_velocity, dt, extra, scale, pushed, epsilon)
    fast = _fast_torque(m, level_velocity)
    if is_stuck and epsilon == 0.0 and number(kind) <= LAST_STATIC:
        fast = 0.0  # friction balances what is applied, and nothing else
    learned = _learned_torque(p, s, velocity, level_velocity, dt, position, load_torque, temperature)
    return torque + fast + ripple + learned


@compiled_for_one_sample
def step_whole(
    address: int,
    velocity: float,
    dt: float,
    position: float,
    load_torque: float,
    temperature: float,
    applied_torque: float,
) -> float:
    """`step` of a model whose number, epsilon, parameters and state are one array at an address."""
    model = borrowed_at(address, WHOLE_ROOM)
    kind, epsilon, p, s = int(model[0]), model[1], part(model, 2), part(model, 2 + PARAMETER_ROOM)
    return step(kind, p, s, velocity, velocity, dt, position, load_torque, temperature, applied_torque, epsilon)


@compiled_for_one_sample
def step_plain(address: int, velocity: float, dt: float) -> float:
    """`step_whole` without all that a model without modifiers has no need of."""
    model = borrowed_at(address, WHOLE_ROOM)
    kind, epsilon, p, s = int(model[0]), model[1], part(model, 2 + HEADER), part(model, 2 + PARAMETER_ROOM)
    return family_step(kind, p, s, velocity, velocity, dt, 0.0, 1.0, 0.0, epsilon)


def prepare(function: Any, numbers: int) -> None:
    """Compile `step_plain` or `step_whole` for an address and numbers, once and for all.

    Otherwise a whole number or a numpy scalar would have it compiled anew, in the middle of a loop.
    """
    if not function.signatures:
        function.compile((types.int64, *[types.float64] * numbers))
        function.disable_compile()


@compiled
def is_finite(values: Array) -> bool:
    """Whether no element is infinite or NaN."""
    wrong = 0
    for k in range(values.shape[0]):
        wrong += not math.isfinite(values[k])  # counting goes in vector registers; leaving at the first does not
    return wrong == 0


@compiled
def is_positive(values: Array) -> bool:
    """Whether every element is above zero."""
    wrong = 0
    for k in range(values.shape[0]):
        wrong += not values[k] > 0.0
    return wrong == 0


@compiled
def run_plain(kind: Any, p: Array, s: Array, velocity: Array, dt: float, applied_torque: float, torque: Array) -> bool:
    """`run` of a model without modifiers, with one ``dt`` and one ``applied_torque``.

    Most need no more, and the rest takes longer to compile than this.
    """
    own = part(p, HEADER)
    for begin in range(0, velocity.shape[0], _CACHED):
        v = velocity[begin : begin + _CACHED]
        is_seen = family_run(kind, own, s, v, dt, applied_torque, part(torque, begin))
        if not (is_seen or is_finite(v)):
            return False
    return True


def run_any(kind: int, p: Array, velocity: Array, dt: float) -> Array:
    """Torque, (n,), of a model without modifiers, from rest: the bits of `run_plain`.

    It takes the family by number: slower, but compiled once for all of them, and quickly where the loop's step is.
    """
    torque = np.empty(velocity.size)
    each_step(kind, p[HEADER:], np.zeros(STATE_ROOM), velocity, dt, 0.0, torque)
    return torque


@compiled
def run(
    kind: Any,
    p: Array,
    s: Array,
    velocity: Array,
    dt: Array,
    position: Array,
    load_torque: Array,
    temperature: Array,
    applied_torque: Array,
    torque: Array,
) -> bool:
    """Fill ``torque`` with that of every sample; return whether every ``velocity`` is finite, and stop where not.

    ``kind`` is the family's tag. The inputs after ``velocity`` have one element, or one a sample.
    """
    if p[0] == 0.0 and dt.shape[0] == 1 and applied_torque.shape[0] == 1:
        return run_plain(kind, p, s, velocity, dt[0], applied_torque[0], torque)
    dt_stride = 1 if dt.shape[0] > 1 else 0
    position_stride = 1 if position.shape[0] > 1 else 0
    load_stride = 1 if load_torque.shape[0] > 1 else 0
    temperature_stride = 1 if temperature.shape[0] > 1 else 0
    applied_stride = 1 if applied_torque.shape[0] > 1 else 0
    for k in range(velocity.shape[0]):
        torque[k] = step(
            kind,
            p,
            s,
            velocity[k],
            velocity[k],
            dt[k * dt_stride],
            position[k * position_stride],
            load_torque[k * load_stride],
            temperature[k * temperature_stride],
            applied_torque[k * applied_stride],
            0.0,
        )
    return is_finite(velocity)


@compiled
def steady_curve(kind: Any, p: Array, velocity: Array, load_torque: float, temperature: float, torque: Array) -> None:
    """Fill ``torque`` with what the model settles on at every constant ``velocity``, without ripple; 0 at rest.

    ``kind`` is the family's tag.
    """
    for k in range(velocity.shape[0]):
        v = velocity[k]
        if p[0] == 0.0:
            torque[k] = family_steady(kind, part(p, HEADER), v, 0.0, 1.0)
            continue
        m = part(p, whole(p[2]))
        own = part(p, whole(p[1]) if v < 0.0 else HEADER)
        extra, scale = _level_extra(m, load_torque, direction(v, 0.0)), _level_scale(m, temperature)
        torque[k] = family_steady(kind, own, v, extra, scale) + _fast_torque(m, v)
