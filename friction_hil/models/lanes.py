"""Four numbers at a time: what the compiler does not find in loops as short as the layer of a friction network."""

from typing import Any

from llvmlite import ir
from numba import types
from numba.core import cgutils as untyped_cgutils

from friction_hil.dual import intrinsic

LANES = 4

cgutils: Any = untyped_cgutils  # for mypy: it has no types

_FOUR = ir.VectorType(ir.DoubleType(), LANES)


def spread(builder: Any, kind: ir.VectorType, number: Any) -> Any:
    """Vector with the same number in every place."""
    first = builder.insert_element(ir.Constant(kind, ir.Undefined), number, ir.Constant(ir.IntType(32), 0))
    return builder.shuffle_vector(
        first, first, ir.Constant(ir.VectorType(ir.IntType(32), kind.count), [0] * kind.count)
    )


def fma(builder: Any, x: Any, y: Any, z: Any) -> Any:
    """X y + z of vectors, rounded once."""
    kind = x.type
    function = ir.FunctionType(kind, [kind] * 3)
    return builder.call(
        cgutils.get_or_insert_function(builder.module, function, f"llvm.fma.v{kind.count}f64"), [x, y, z]
    )


def _place(context: Any, builder: Any, kind: Any, array: Any, begin: Any) -> Any:
    data = context.make_array(kind)(context, builder, value=array).data
    return builder.bitcast(builder.gep(data, [begin]), _FOUR.as_pointer())


@intrinsic
def add_scaled(_: Any, sums: Any, at: Any, values: Any, begin: Any, factor: Any) -> Any:
    """Add ``factor`` times the `LANES` ``values`` from ``begin`` on to the ``sums`` from ``at`` on, rounded once."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        target = _place(context, builder, signature.args[0], args[0], args[1])
        source = builder.load(_place(context, builder, signature.args[2], args[2], args[3]), align=8)
        total = fma(builder, spread(builder, _FOUR, args[4]), source, builder.load(target, align=8))
        builder.store(total, target, align=8)
        return context.get_dummy_value()

    return types.void(sums, types.int64, values, types.int64, types.float64), generate


@intrinsic
def put_scaled(_: Any, target: Any, at: Any, values: Any, begin: Any, factor: Any) -> Any:
    """Put ``factor`` times the `LANES` ``values`` from ``begin`` on into ``target`` from ``at`` on."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        into = _place(context, builder, signature.args[0], args[0], args[1])
        source = builder.load(_place(context, builder, signature.args[2], args[2], args[3]), align=8)
        builder.store(builder.fmul(spread(builder, _FOUR, args[4]), source), into, align=8)
        return context.get_dummy_value()

    return types.void(target, types.int64, values, types.int64, types.float64), generate


@intrinsic
def put_sum(_: Any, target: Any, at: Any, x: Any, a: Any, y: Any, b: Any) -> Any:
    """Put a x + b y of the `LANES` numbers from ``at`` on into ``target``, in the same places."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        kinds = signature.args
        first = builder.load(_place(context, builder, kinds[2], args[2], args[1]), align=8)
        second = builder.load(_place(context, builder, kinds[4], args[4], args[1]), align=8)
        total = fma(
            builder, spread(builder, _FOUR, args[3]), first, builder.fmul(spread(builder, _FOUR, args[5]), second)
        )
        builder.store(total, _place(context, builder, kinds[0], args[0], args[1]), align=8)
        return context.get_dummy_value()

    return types.void(target, types.int64, x, types.float64, y, types.float64), generate
