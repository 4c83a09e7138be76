"""Numba's types of dual numbers and of arrays of them, and their arithmetic; see `friction_hil.numerics.dual`.

This module is imported once there is something to compile: it needs numba.
"""

import operator
from collections.abc import Callable
from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils
from numba.core.typeconv.castgraph import Conversion
from numba.core.typing.templates import AbstractTemplate, infer_global, signature
from numba.extending import (
    lower_builtin,
    lower_cast,
    make_attribute_wrapper,
    models,
    register_model,
)

from friction_hil.numerics.dual import WIDTH, intrinsic, overloaded, primal

_F8, I8 = ir.DoubleType(), ir.IntType(64)
_RELAXED = ("fast",)
VECTOR, TABLE = types.Array(types.float64, 1, "C"), types.Array(types.float64, 2, "C")
_PARTIALS = [f"d{i}" for i in range(WIDTH)]


class DualType(types.Type):
    """Numba's type of a dual number."""

    def __init__(self) -> None:
        super().__init__("Dual")

    def can_convert_from(self, typingctx: Any, other: Any) -> Any:
        """Accept a plain number, whose partials are zero."""
        return Conversion.safe if isinstance(other, (types.Float, types.Integer)) else None

    def unify(self, typingctx: Any, other: Any) -> Any:
        """Return the common type of a dual and a number, if branches assign both to one variable."""
        return self if isinstance(other, (types.Float, types.Integer)) else None


DUAL = DualType()
register_model(DualType)(
    type(
        "_DualModel",
        (models.StructModel,),
        {
            "__init__": lambda self, dmm, fe: models.StructModel.__init__(
                self, dmm, fe, [(name, types.float64) for name in ("value", *_PARTIALS)]
            )
        },
    )
)


# --- building blocks


def unpack(context: Any, builder: Any, kind: Any, number: Any) -> tuple[Any, list[Any] | None]:
    """Return the value and partials of a number; the partials of a plain number are None."""
    if not isinstance(kind, DualType):
        return context.cast(builder, number, kind, types.float64), None
    dual = cgutils.create_struct_proxy(DUAL)(context, builder, value=number)
    return dual.value, [getattr(dual, name) for name in _PARTIALS]


def pack(context: Any, builder: Any, value: Any, partials: list[Any]) -> Any:
    """Return the dual of a value and its partials."""
    dual = cgutils.create_struct_proxy(DUAL)(context, builder)
    dual.value = value
    for name, partial in zip(_PARTIALS, partials, strict=True):
        setattr(dual, name, partial)
    return dual._getvalue()


@lower_cast(types.Float, DualType)
@lower_cast(types.Integer, DualType)
def _from_number(context: Any, builder: Any, kind: Any, _: Any, number: Any) -> Any:
    value = context.cast(builder, number, kind, types.float64)
    return pack(context, builder, value, [ir.Constant(_F8, 0.0)] * WIDTH)


def _types_of_binary(result: Any, args: Any) -> Any:
    numbers = (types.Float, types.Integer, DualType)
    if len(args) == 2 and any(isinstance(a, DualType) for a in args) and all(isinstance(a, numbers) for a in args):
        return signature(result, *(a if isinstance(a, DualType) else types.float64 for a in args))
    return None


def _define_binary(symbol: Any, result: Any, lower: Callable[..., Any]) -> None:
    infer_global(symbol)(
        type("_Binary", (AbstractTemplate,), {"generic": lambda self, args, kws: _types_of_binary(result, args)})
    )

    def lowered(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        a, da = unpack(context, builder, sig.args[0], args[0])
        b, db = unpack(context, builder, sig.args[1], args[1])
        return lower(context, builder, a, da, b, db)

    for kinds in ((DualType, DualType), (DualType, types.Float), (types.Float, DualType)):
        lower_builtin(symbol, *kinds)(lowered)


def _define_arithmetic(symbol: Any, rule: Callable[..., tuple[Any, Any, Any]]) -> None:
    """Define a binary operation; ``rule`` returns its value and its slopes over both operands, with None for 1."""

    def lower(context: Any, b: Any, x: Any, dx: Any, y: Any, dy: Any) -> Any:
        value, slope_x, slope_y = rule(b, x, y)
        partials = []
        for i in range(WIDTH):
            terms = [scaled(b, d[i], slope) for d, slope in ((dx, slope_x), (dy, slope_y)) if d is not None]
            partials.append(terms[0] if len(terms) == 1 else b.fadd(*terms, flags=_RELAXED))
        return pack(context, b, value, partials)

    _define_binary(symbol, DUAL, lower)


def scaled(builder: Any, partial: Any, slope: Any) -> Any:
    """Return a partial times a slope; None stands for 1."""
    return partial if slope is None else builder.fmul(partial, slope, flags=_RELAXED)


def _quotient(b: Any, x: Any, y: Any) -> tuple[Any, Any, Any]:
    value, inverse = b.fdiv(x, y), b.fdiv(ir.Constant(_F8, 1.0), y, flags=_RELAXED)
    return value, inverse, b.fneg(b.fmul(value, inverse, flags=_RELAXED))


_define_arithmetic(operator.add, lambda b, x, y: (b.fadd(x, y), None, None))
_define_arithmetic(operator.sub, lambda b, x, y: (b.fsub(x, y), None, ir.Constant(_F8, -1.0)))
_define_arithmetic(operator.mul, lambda b, x, y: (b.fmul(x, y), y, x))
_define_arithmetic(operator.truediv, _quotient)


def _define_comparison(symbol: Any, sign: str) -> None:
    def lower(context: Any, builder: Any, x: Any, _dx: Any, y: Any, _dy: Any) -> Any:
        compare = builder.fcmp_unordered if sign == "!=" else builder.fcmp_ordered
        return compare(sign, x, y)

    _define_binary(symbol, types.boolean, lower)


for _symbol, _sign in (
    (operator.lt, "<"),
    (operator.le, "<="),
    (operator.gt, ">"),
    (operator.ge, ">="),
    (operator.eq, "=="),
    (operator.ne, "!="),
):
    _define_comparison(_symbol, _sign)

infer_global(operator.neg)(
    type(
        "_Negative",
        (AbstractTemplate,),
        {"generic": lambda self, args, kws: signature(DUAL, DUAL) if args == (DUAL,) else None},
    )
)


@lower_builtin(operator.neg, DualType)
def _negative(context: Any, builder: Any, _: Any, args: Any) -> Any:
    value, partials = unpack(context, builder, DUAL, args[0])
    assert partials is not None
    return pack(context, builder, builder.fneg(value), [builder.fneg(d) for d in partials])


# --- containers


class DualArrayType(types.Type):
    """Numba's type of an array of duals."""

    def __init__(self) -> None:
        super().__init__("DualArray")


DUAL_ARRAY = DualArrayType()
MEMBERS = (("values", VECTOR), ("partials", TABLE))
register_model(DualArrayType)(
    type(
        "_DualArrayModel",
        (models.StructModel,),
        {"__init__": lambda self, dmm, fe: models.StructModel.__init__(self, dmm, fe, list(MEMBERS))},
    )
)
for _name, _ in MEMBERS:
    make_attribute_wrapper(DualArrayType, _name, _name)


def _partial_pointers(context: Any, builder: Any, kind: Any, row: Any) -> list[Any]:
    """Return pointers to the partials of a row."""
    data = context.make_array(kind)(context, builder, value=row).data
    return [builder.gep(data, [ir.Constant(I8, i)]) for i in range(WIDTH)]


@intrinsic
def _join(_: Any, value: Any, row: Any) -> Any:
    """Return the dual of a value and a row of partials."""

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        pointers = _partial_pointers(context, builder, sig.args[1], args[1])
        return pack(context, builder, args[0], [builder.load(each) for each in pointers])

    return DUAL(types.float64, row), generate


@intrinsic
def _write_partials(_: Any, row: Any, x: Any) -> Any:
    """Write the partials of ``x`` to a row."""

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        _, partials = unpack(context, builder, DUAL, args[1])
        assert partials is not None
        pointers = _partial_pointers(context, builder, sig.args[0], args[0])
        for partial, pointer in zip(partials, pointers, strict=True):
            builder.store(partial, pointer)
        return context.get_dummy_value()

    return types.void(row, DUAL), generate


@overloaded(operator.getitem)
def _get(container: Any, k: Any) -> Any:
    if isinstance(container, DualArrayType):
        return lambda container, k: _join(container.values[k], container.partials[k])
    return None


@overloaded(operator.setitem)
def _set(container: Any, k: Any, x: Any) -> Any:
    if isinstance(container, DualArrayType):

        def to_array(container, k, x):  # type: ignore[no-untyped-def]
            container.values[k] = primal(x)
            _write_partials(container.partials[k], x)

        return to_array
    return None


@overloaded(abs)
def _absolute(x: Any) -> Any:
    return (lambda x: -x if x < 0.0 else x) if isinstance(x, DualType) else None


def define() -> None:
    """Do nothing: by its import, this module has told numba of duals."""
