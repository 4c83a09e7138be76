"""The step of every model with its modifiers. The daemon, replay, fitting and the simulated servo call it.

The parameters of a model are a flat array, ``p``::

    0                1 if there are modifiers or a network, otherwise 0
    1, 2, 3          index of the first parameter for negative motion, of the first modifier and of the network
                     (0: no network)
    4 ...            the model's own parameters, in the order of its family's `pack`

The state is another flat array, ``s``: the states of the family from index 0 on, the direction of the last motion, the
distance since the last reversal and the torque there of the modifier ``reversal``, and the state of the network.

Each family has the functions ``step(p, s, velocity, level_velocity, dt, extra, scale, applied_torque, epsilon)`` and
``steady(p, velocity, extra, scale)``. There ``p`` starts at the family's own parameters, and ``extra`` and ``scale``
are the effect of load and temperature on the level (`curves.modified`).
"""

import math
from typing import Any

import numpy as np

from friction_hil.friction import karnopp, modifiers, network
from friction_hil.friction.curves import direction
from friction_hil.friction.dispatch import (
    FAMILY_STATES,
    KIND,
    LAST_STATIC,
    each_step,
    family_run,
    family_steady,
    family_step,
    may_have_network,
    number,
)
from friction_hil.friction.elementary import part, whole
from friction_hil.numerics.dual import borrowed_at, dual_types, intrinsic, overloaded, primal, types
from friction_hil.numerics.jit import Array, compiled, compiled_for_one_sample, inserted

HEADER, BEGIN_OF_NETWORK = 4, 3
_CACHED = 32768  # samples, 256 KiB: small enough to be in the cache at the second pass
PLAIN_ROOM = 768  # length of p: a full table for each direction, and the modifiers
PARAMETER_ROOM = 2048  # length of p for a model with a network
DIRECTION = FAMILY_STATES
NETWORK = DIRECTION + modifiers.REVERSAL_STATES
STATE_ROOM = NETWORK + network.STATE_ROOM
WHOLE_ROOM = 2 + PARAMETER_ROOM + STATE_ROOM

_level_extra, _level_scale = modifiers.level_extra, modifiers.level_scale
_fast_torque, _ripple_torque = modifiers.fast_torque, modifiers.ripple_torque
_reversal_torque, _speed_torque, _settled_torque = (
    modifiers.reversal_torque,
    modifiers.speed_torque,
    modifiers.settled_torque,
)
_network_step = network.step


def _learned_torque(kind: Any, p: Array, s: Array, *inputs: Any) -> float:
    """Compute the torque of the network, N m; 0 without a network and under automatic differentiation.

    The tag of the family, or for parameters in a record the length of the array, decides at compile time whether there
    can be a network, because its code takes as long to compile as everything else.
    """
    raise NotImplementedError  # exists in compiled code only


@overloaded(_learned_torque)
def _choose_learned_torque(kind: Any, p: Any, s: Any, *inputs: Any) -> Any:
    is_short = isinstance(p, types.NestedArray) and p.shape[0] <= PLAIN_ROOM
    if isinstance(p, dual_types.DualArrayType) or is_short or not may_have_network(kind):
        return lambda kind, p, s, *inputs: 0.0

    def of_network(kind, p, s, *inputs):  # type: ignore[no-untyped-def]
        begin = int(p[BEGIN_OF_NETWORK])
        return _network_step(part(p, begin), part(s, NETWORK), *inputs) if begin > 0 else 0.0

    return of_network


@inserted
def step(
    kind: Any,  # number or tag of the family; see `dispatch`
    p: Array,  # parameters
    s: Array,  # state, changed in place
    # drives the state, sets the direction and is that of the modifiers ``reversal`` and ``speed``, rad/s
    velocity: float,
    level_velocity: float,  # at which level, damping and viscous friction are evaluated, rad/s
    dt: float,  # time for which ``velocity`` is held, s, above zero
    position: float,  # for the ripple, rad
    load_torque: float,  # for the load dependence, N m, positive if it opposes positive motion
    temperature: float,  # deg C; NaN for the reference temperature
    applied_torque: float,  # that friction balances while a static map sticks (``velocity`` 0, ``epsilon`` 0), N m
    # Width over which the jump of a static map at zero velocity is smoothed, rad/s; 0 for the exact map. Dynamic models
    # have no jump and ignore it.
    epsilon: float,
) -> float:
    """Advance the state over one sample and return the friction torque.

    Velocity and level velocity are equal except in a compensator, which takes them from different sources.
    """
    own_state = part(s, 0)
    if p[0] == 0.0:
        own = part(p, HEADER)
        return family_step(kind, own, own_state, velocity, level_velocity, dt, 0.0, 1.0, applied_torque, epsilon)
    m = part(p, whole(p[2]))
    beside = _ripple_torque(m, position)
    if m[modifiers.REVERSAL] > 0.0:
        beside = beside + _reversal_torque(part(m, whole(m[modifiers.REVERSAL])), part(s, DIRECTION), velocity, dt)
    pushed = applied_torque - beside
    if velocity != 0.0:
        s[DIRECTION] = direction(velocity, 0.0)
    sign = primal(s[DIRECTION])
    is_stuck = velocity == 0.0 or (number(kind) == KIND.karnopp and abs(velocity) < primal(p[HEADER + karnopp.BAND]))
    if is_stuck and epsilon == 0.0 and number(kind) <= LAST_STATIC:
        sign = direction(primal(pushed), 0.0)  # the level is that of the direction in which it would break away
    own = part(p, whole(p[1]) if sign < 0.0 else HEADER)
    extra, scale = _level_extra(m, load_torque, sign), _level_scale(m, temperature)
    torque = family_step(kind, own, own_state, velocity, level_velocity, dt, extra, scale, pushed, epsilon)
    fast = _fast_torque(m, level_velocity)
    if m[modifiers.SPEED] > 0.0:
        fast = fast + _speed_torque(part(m, whole(m[modifiers.SPEED])), velocity)
    if is_stuck and epsilon == 0.0 and number(kind) <= LAST_STATIC:
        fast = 0.0  # at rest, friction balances the applied torque only
    learned = _learned_torque(kind, p, s, velocity, level_velocity, dt, position, load_torque, temperature)
    return torque + fast + beside + learned


@intrinsic
def _plain(_: Any, p: Any) -> Any:
    """Return parameters without a network as an array of the type that they have in a record."""
    return types.NestedArray(types.float64, (PLAIN_ROOM,))(p), lambda context, builder, signature, args: args[0]


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
    """Call `step` for a model without a network whose number, epsilon, parameters and state are one array."""
    model = borrowed_at(address, WHOLE_ROOM)
    kind, epsilon, p, s = int(model[0]), model[1], _plain(part(model, 2)), part(model, 2 + PARAMETER_ROOM)
    return step(kind, p, s, velocity, velocity, dt, position, load_torque, temperature, applied_torque, epsilon)


@compiled_for_one_sample
def step_with_network(
    address: int,
    velocity: float,
    dt: float,
    position: float,
    load_torque: float,
    temperature: float,
    applied_torque: float,
) -> float:
    """Do the same as `step_whole` for any model."""
    model = borrowed_at(address, WHOLE_ROOM)
    kind, epsilon, p, s = int(model[0]), model[1], part(model, 2), part(model, 2 + PARAMETER_ROOM)
    return step(kind, p, s, velocity, velocity, dt, position, load_torque, temperature, applied_torque, epsilon)


@compiled_for_one_sample
def step_plain(address: int, velocity: float, dt: float) -> float:
    """Call the family's step for a model without modifiers: the fast form of `step_whole`."""
    model = borrowed_at(address, WHOLE_ROOM)
    kind, epsilon, p, s = int(model[0]), model[1], part(model, 2 + HEADER), part(model, 2 + PARAMETER_ROOM)
    return family_step(kind, p, s, velocity, velocity, dt, 0.0, 1.0, 0.0, epsilon)


def prepare(function: Any, numbers: int) -> None:
    """Compile a step for an address and ``numbers`` floats, and disable further compilation.

    Otherwise an int or a numpy scalar as argument would start a new compilation in the middle of a loop.
    """
    if not function.signatures:
        function.compile((types.int64, *[types.float64] * numbers))
        function.disable_compile()


@compiled
def is_finite(values: Array) -> bool:
    """Return True if no element is infinite or NaN."""
    wrong = 0
    for k in range(values.shape[0]):
        wrong += not math.isfinite(values[k])  # a count is vectorised, an early exit is not
    return wrong == 0


@compiled
def is_positive(values: Array) -> bool:
    """Return True if every element is above zero."""
    wrong = 0
    for k in range(values.shape[0]):
        wrong += not values[k] > 0.0
    return wrong == 0


@compiled
def run_plain(kind: Any, p: Array, s: Array, velocity: Array, dt: float, applied_torque: float, torque: Array) -> bool:
    """Do the work of `run` for a model without modifiers, with one ``dt`` and one ``applied_torque``.

    Most calls need only this, and it compiles much faster than `run`. The simulation stops at the first block with a
    velocity that is not finite.
    """
    own = part(p, HEADER)
    for begin in range(0, velocity.shape[0], _CACHED):
        v = velocity[begin : begin + _CACHED]
        is_checked = family_run(kind, own, s, v, dt, applied_torque, part(torque, begin))
        if not (is_checked or is_finite(v)):
            return False
    return True


def run_any(kind: int, p: Array, velocity: Array, dt: float) -> Array:
    """Simulate a model without modifiers from rest; return the torque, (n,), with the same bits as `run_plain`.

    The family is selected by number, which is slower but compiled once for all families.
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
    """Fill ``torque`` for every sample; return True if every ``velocity`` is finite.

    ``kind`` is the family's tag. The inputs after ``velocity`` have one element, or one per sample.
    """
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
    """Fill ``torque`` with the steady torque at every constant ``velocity``, without ripple; 0 at rest.

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
        if m[modifiers.SPEED] > 0.0:
            torque[k] += _speed_torque(part(m, whole(m[modifiers.SPEED])), v)
        if m[modifiers.REVERSAL] > 0.0:
            torque[k] += _settled_torque(part(m, whole(m[modifiers.REVERSAL])), direction(v, 0.0))
