"""Dual numbers for compiled code: exact derivatives of any kernel, from the source that computes its value.

A dual number is a value and its partial derivatives with respect to `WIDTH` parameters. A kernel called with duals
instead of numbers is compiled once more, by the same rules, and carries the partials through every operation
(forward-mode automatic differentiation; Griewank and Walther, Evaluating Derivatives, 2nd ed., SIAM 2008, section 3.1).
An equation is therefore written once, and its derivative always agrees with it. The value of a dual has the same bits
as the plain number; only the partials are computed with relaxed floating-point rules, which lets the compiler drop
those that are always zero.

Instead of an array of numbers, a kernel can take a `dual_array` with the same syntax inside: parameters with their
seeds (row k is 1 in the column of parameter k), a state, or an output.
"""

import operator
from collections.abc import Callable
from typing import Any

import numba
import numba.extending
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
    overload,
    register_model,
)
from numba.np.arrayobj import populate_array

from friction_hil.numerics.jit import OPTIONS

WIDTH = 7  # nonlinear parameters of LuGre with directions in identification; more parameters take several runs

intrinsic: Any = numba.extending.intrinsic  # for mypy: the result takes other arguments than the decorated function

_F8, _I8 = ir.DoubleType(), ir.IntType(64)
_RELAXED = ("fast",)
_VECTOR, _TABLE = types.Array(types.float64, 1, "C"), types.Array(types.float64, 2, "C")
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


def _unpack(context: Any, builder: Any, kind: Any, number: Any) -> tuple[Any, list[Any] | None]:
    """Return the value and partials of a number; the partials of a plain number are None."""
    if not isinstance(kind, DualType):
        return context.cast(builder, number, kind, types.float64), None
    dual = cgutils.create_struct_proxy(DUAL)(context, builder, value=number)
    return dual.value, [getattr(dual, name) for name in _PARTIALS]


def _pack(context: Any, builder: Any, value: Any, partials: list[Any]) -> Any:
    dual = cgutils.create_struct_proxy(DUAL)(context, builder)
    dual.value = value
    for name, partial in zip(_PARTIALS, partials, strict=True):
        setattr(dual, name, partial)
    return dual._getvalue()


@lower_cast(types.Float, DualType)
@lower_cast(types.Integer, DualType)
def _from_number(context: Any, builder: Any, kind: Any, _: Any, number: Any) -> Any:
    value = context.cast(builder, number, kind, types.float64)
    return _pack(context, builder, value, [ir.Constant(_F8, 0.0)] * WIDTH)


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
        a, da = _unpack(context, builder, sig.args[0], args[0])
        b, db = _unpack(context, builder, sig.args[1], args[1])
        return lower(context, builder, a, da, b, db)

    for kinds in ((DualType, DualType), (DualType, types.Float), (types.Float, DualType)):
        lower_builtin(symbol, *kinds)(lowered)


def _define_arithmetic(symbol: Any, rule: Callable[..., tuple[Any, Any, Any]]) -> None:
    """Define a binary operation; ``rule`` returns its value and its slopes over both operands, with None for 1."""

    def lower(context: Any, b: Any, x: Any, dx: Any, y: Any, dy: Any) -> Any:
        value, slope_x, slope_y = rule(b, x, y)
        partials = []
        for i in range(WIDTH):
            terms = [_scaled(b, d[i], slope) for d, slope in ((dx, slope_x), (dy, slope_y)) if d is not None]
            partials.append(terms[0] if len(terms) == 1 else b.fadd(*terms, flags=_RELAXED))
        return _pack(context, b, value, partials)

    _define_binary(symbol, DUAL, lower)


def _scaled(builder: Any, partial: Any, slope: Any) -> Any:
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
    value, partials = _unpack(context, builder, DUAL, args[0])
    assert partials is not None
    return _pack(context, builder, builder.fneg(value), [builder.fneg(d) for d in partials])


@intrinsic
def primal(_: Any, x: Any) -> Any:
    """Return the value of a number without its partials."""

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        return _unpack(context, builder, sig.args[0], args[0])[0]

    return types.float64(x), generate


@intrinsic
def chain(_: Any, value: Any, slope: Any, x: Any) -> Any:
    """Return a function's dual: its ``value``, and its ``slope`` times the partials of the argument ``x``."""

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        _, partials = _unpack(context, builder, DUAL, args[2])
        assert partials is not None
        return _pack(context, builder, args[0], [_scaled(builder, d, args[1]) for d in partials])

    return DUAL(types.float64, types.float64, DUAL), generate


@intrinsic
def fma(_: Any, x: Any, y: Any, z: Any) -> Any:
    """Compute x y + z with a single rounding."""
    return types.float64(types.float64, types.float64, types.float64), lambda c, builder, s, args: builder.fma(*args)


@intrinsic
def borrowed(_: Any, array: Any, begin: Any) -> Any:
    """Return a view of a contiguous array from an index of its first dimension on, without a reference to the array.

    The caller must keep the array alive. Numba counts the references of slices with atomic operations, which would take
    longer than a whole step of a model. A view of an array inside a structured array has the same type as any other, so
    that kernels are compiled once for both.
    """

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        source = context.make_array(sig.args[0])(context, builder, value=args[0])
        view = context.make_array(sig.return_type)(context, builder)
        shape, strides = (cgutils.unpack_tuple(builder, each) for each in (source.shape, source.strides))
        start = builder.mul(args[1], strides[0])
        populate_array(
            view,
            data=cgutils.pointer_add(builder, source.data, start),
            shape=[builder.sub(shape[0], args[1]), *shape[1:]],
            strides=strides,
            itemsize=source.itemsize,
            meminfo=None,
        )
        return view._getvalue()

    return types.Array(array.dtype, array.ndim, "C")(array, types.int64), generate


@intrinsic
def borrowed_at(_: Any, address: Any, length: Any) -> Any:
    """Return a view of ``length`` numbers at an address: as an argument, a number is cheaper than an array."""

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        view = context.make_array(_VECTOR)(context, builder)
        size = ir.Constant(_I8, 8)
        data = builder.inttoptr(args[0], view.data.type)
        populate_array(view, data=data, shape=[args[1]], strides=[size], itemsize=size, meminfo=None)
        return view._getvalue()

    return _VECTOR(types.int64, types.int64), generate


def overloaded(function: Any) -> Any:
    """Decorate an implementation of ``function`` for compiled code that depends on the types of its arguments."""
    return overload(function, jit_options=OPTIONS, strict=False)


def differentiable(function: Any, value_of: Any, slope_of: Any) -> None:
    """Let compiled code call ``function`` with one number or dual.

    Parameters
    ----------
    function : callable
        Function that kernels call.
    value_of : compiled callable
        x -> f(x).
    slope_of : compiled callable
        x, f(x) -> df/dx.
    """

    @overloaded(function)
    def choose(x: Any) -> Any:
        if isinstance(x, DualType):

            def of_dual(x):  # type: ignore[no-untyped-def]
                plain = primal(x)
                value = value_of(plain)
                return chain(value, slope_of(plain, value), x)

            return of_dual
        return lambda x: value_of(x)


# --- containers


class DualArrayType(types.Type):
    """Numba's type of an array of duals."""

    def __init__(self) -> None:
        super().__init__("DualArray")


DUAL_ARRAY = DualArrayType()
_MEMBERS = (("values", _VECTOR), ("partials", _TABLE))
register_model(DualArrayType)(
    type(
        "_DualArrayModel",
        (models.StructModel,),
        {"__init__": lambda self, dmm, fe: models.StructModel.__init__(self, dmm, fe, list(_MEMBERS))},
    )
)
for _name, _ in _MEMBERS:
    make_attribute_wrapper(DualArrayType, _name, _name)


@intrinsic
def dual_array(_: Any, values: Any, partials: Any) -> Any:
    """Return an array of duals, made of two arrays of numbers: values (n,) and partials (n, WIDTH)."""

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        pair = cgutils.create_struct_proxy(DUAL_ARRAY)(context, builder)
        for (name, kind), member in zip(_MEMBERS, args, strict=True):
            setattr(pair, name, member)
            context.nrt.incref(builder, kind, member)
        return pair._getvalue()

    return DUAL_ARRAY(_VECTOR, _TABLE), generate


def _partial_pointers(context: Any, builder: Any, kind: Any, row: Any) -> list[Any]:
    """Return pointers to the partials of a row."""
    data = context.make_array(kind)(context, builder, value=row).data
    return [builder.gep(data, [ir.Constant(_I8, i)]) for i in range(WIDTH)]


@intrinsic
def _join(_: Any, value: Any, row: Any) -> Any:
    """Return the dual of a value and a row of partials."""

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        pointers = _partial_pointers(context, builder, sig.args[1], args[1])
        return _pack(context, builder, args[0], [builder.load(each) for each in pointers])

    return DUAL(types.float64, row), generate


@intrinsic
def _write_partials(_: Any, row: Any, x: Any) -> Any:
    """Write the partials of ``x`` to a row."""

    def generate(context: Any, builder: Any, sig: Any, args: Any) -> Any:
        _, partials = _unpack(context, builder, DUAL, args[1])
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
