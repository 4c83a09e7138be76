"""Selection of a family's functions, at compile time or at run time.

A kernel receives the family either as a number or as a *tag*, a tuple whose length gives the number. A number is
compared in every sample. A tag is part of the type, so that numba compiles the kernel separately for each family
and includes no code of the others, and none of networks for a model without one.
"""

from collections import namedtuple
from typing import Any

from friction_hil.friction import (
    armstrong,
    bouc_wen,
    coulomb,
    dahl,
    elasto_plastic,
    gms,
    karnopp,
    lugre,
    power_law,
    stribeck,
    table,
)
from friction_hil.numerics.dual import forwarded, overloaded, types
from friction_hil.numerics.jit import Array, compiled, inner

# The one list of families: a place in it is the family's number. Static maps come first.
_ORDER = (coulomb, stribeck, karnopp, table, power_law, armstrong, dahl, lugre, elasto_plastic, gms, bouc_wen)
FAMILIES = {module.FAMILY.name: module.FAMILY for module in _ORDER}
# the numbers by the families' names, as attributes, which compiled code takes for constants
KIND: Any = namedtuple("KIND", FAMILIES)(*range(len(FAMILIES)))
LAST_STATIC = sum(family.is_static for family in FAMILIES.values()) - 1
FAMILY_STATES = max(getattr(module, "STATES", 0) for module in _ORDER)


def tag(kind: int, *, has_network: bool = False) -> tuple[float, ...]:
    """Return the tag of the family with this number, of integers for a model without a network, or of floats."""
    return (0.0 if has_network else 0,) * (kind + 1)


def may_have_network(kind: Any) -> bool:
    """Return False if ``kind``, the type of a number or tag, is that of a tag without a network."""
    return not (isinstance(kind, types.UniTuple) and isinstance(kind.dtype, types.Integer))


def number(kind: Any) -> int:
    """Return the number of a family that is given as a number or as a tag."""
    return kind if isinstance(kind, int) else len(kind) - 1


@overloaded(number)
def _choose_number(kind: Any) -> Any:
    if not isinstance(kind, types.UniTuple):
        return lambda kind: kind
    known = kind.count - 1
    return lambda kind: known


@inner
def _step_by_number(
    kind: int,
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
    # written out, because numba cannot index a table of functions that it inlines; the usual models come first
    if kind == KIND.lugre:
        return lugre.step(p, s, velocity, level_velocity, dt, extra, scale, applied_torque, epsilon)
    if kind == KIND.gms:
        return gms.step(p, s, velocity, level_velocity, dt, extra, scale, applied_torque, epsilon)
    if kind == KIND.dahl:
        return dahl.step(p, s, velocity, level_velocity, dt, extra, scale, applied_torque, epsilon)
    if kind == KIND.stribeck:
        return stribeck.step(p, s, velocity, level_velocity, dt, extra, scale, applied_torque, epsilon)
    if kind == KIND.karnopp:
        return karnopp.step(p, s, velocity, level_velocity, dt, extra, scale, applied_torque, epsilon)
    if kind == KIND.armstrong:
        return armstrong.step(p, s, velocity, level_velocity, dt, extra, scale, applied_torque, epsilon)
    if kind == KIND.table:
        return table.step(p, s, velocity, level_velocity, dt, extra, scale, applied_torque, epsilon)
    if kind == KIND.power_law:
        return power_law.step(p, s, velocity, level_velocity, dt, extra, scale, applied_torque, epsilon)
    if kind == KIND.elasto_plastic:
        return elasto_plastic.step(p, s, velocity, level_velocity, dt, extra, scale, applied_torque, epsilon)
    if kind == KIND.bouc_wen:
        return bouc_wen.step(p, s, velocity, level_velocity, dt, extra, scale, applied_torque, epsilon)
    return coulomb.step(p, s, velocity, level_velocity, dt, extra, scale, applied_torque, epsilon)


def family_step(kind: Any, *arguments: Any) -> float:
    """Call ``step`` of the family."""
    return float(_ORDER[number(kind)].step(*arguments))


@forwarded(family_step)
def _choose_step(kind: Any) -> tuple[Any, int]:
    return (_ORDER[kind.count - 1].step, 1) if isinstance(kind, types.UniTuple) else (_step_by_number, 0)


def family_steady(kind: Any, *arguments: Any) -> float:
    """Call ``steady`` of the family, which must be given as a tag."""
    return float(_ORDER[number(kind)].steady(*arguments))


@forwarded(family_steady)
def _choose_steady(kind: Any) -> tuple[Any, int]:
    return _ORDER[kind.count - 1].steady, 1


@compiled
def each_step(kind: Any, p: Array, s: Array, velocity: Array, dt: float, applied_torque: float, torque: Array) -> bool:
    """Do the work of `family_run` by single steps; with a number it is slower, but compiled once for all families."""
    for k in range(velocity.shape[0]):
        v = velocity[k]
        torque[k] = family_step(kind, p, s, v, v, dt, 0.0, 1.0, applied_torque, 0.0)
    return False


def family_run(kind: Any, *arguments: Any) -> bool:
    """Simulate a whole array with constant ``dt``, by the family's own ``run`` if it has one.

    The arguments after the tag ``kind`` are p, s, velocity (n,), dt, applied_torque and torque (n,), which is
    filled. Returns True if every velocity was checked and is finite. Static maps make this check, because their
    loops are as cheap as a pass over the velocities; dynamic models return False.
    """
    return each_step(kind, *arguments)


@forwarded(family_run)
def _choose_run(kind: Any) -> tuple[Any, int]:
    chosen = getattr(_ORDER[kind.count - 1], "run", None)
    return (each_step, 0) if chosen is None else (chosen, 1)
