"""Operations on four doubles at a time; the compiler does not vectorise loops as short as a network layer."""

from typing import Any

from friction_hil.numerics.dual import cgutils, intrinsic, ir, types

LANES = 4


def _four() -> Any:
    return ir.VectorType(ir.DoubleType(), LANES)


def spread(builder: Any, kind: Any, number: Any) -> Any:
    """Return a vector with the same number in every element."""
    first = builder.insert_element(ir.Constant(kind, ir.Undefined), number, ir.Constant(ir.IntType(32), 0))
    return builder.shuffle_vector(
        first, first, ir.Constant(ir.VectorType(ir.IntType(32), kind.count), [0] * kind.count)
    )


def fma(builder: Any, x: Any, y: Any, z: Any) -> Any:
    """Compute x y + z of vectors, rounded once."""
    kind = x.type
    function = ir.FunctionType(kind, [kind] * 3)
    return builder.call(
        cgutils.get_or_insert_function(builder.module, function, f"llvm.fma.v{kind.count}f64"), [x, y, z]
    )


def _vector_pointer(context: Any, builder: Any, kind: Any, array: Any, begin: Any) -> Any:
    """Return a pointer to the `LANES` elements of ``array`` from ``begin`` on."""
    data = context.make_array(kind)(context, builder, value=array).data
    return builder.bitcast(builder.gep(data, [begin]), _four().as_pointer())


@intrinsic
def add_scaled(_: Any, sums: Any, at: Any, values: Any, begin: Any, factor: Any) -> Any:
    """Add ``factor`` times `LANES` ``values`` from index ``begin`` to ``sums`` from index ``at``, rounded once."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        target = _vector_pointer(context, builder, signature.args[0], args[0], args[1])
        source = builder.load(_vector_pointer(context, builder, signature.args[2], args[2], args[3]), align=8)
        total = fma(builder, spread(builder, _four(), args[4]), source, builder.load(target, align=8))
        builder.store(total, target, align=8)
        return context.get_dummy_value()

    return types.void(sums, types.int64, values, types.int64, types.float64), generate


@intrinsic
def put_scaled(_: Any, target: Any, at: Any, values: Any, begin: Any, factor: Any) -> Any:
    """Store ``factor`` times `LANES` ``values`` from index ``begin`` in ``target`` from index ``at``."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        into = _vector_pointer(context, builder, signature.args[0], args[0], args[1])
        source = builder.load(_vector_pointer(context, builder, signature.args[2], args[2], args[3]), align=8)
        builder.store(builder.fmul(spread(builder, _four(), args[4]), source), into, align=8)
        return context.get_dummy_value()

    return types.void(target, types.int64, values, types.int64, types.float64), generate


def _sum_of_products(context: Any, builder: Any, signature: Any, args: Any, start: Any) -> Any:
    """Sum rows of `LANES` numbers times their factors; ``args`` are those of `add_products`."""
    total = cgutils.alloca_once_value(builder, start)
    builder.store(start, total)
    factors = context.make_array(signature.args[5])(context, builder, value=args[5]).data
    with cgutils.for_range(builder, args[6]) as loop:
        begin = builder.add(args[3], builder.mul(loop.index, args[4]))
        values = builder.load(_vector_pointer(context, builder, signature.args[2], args[2], begin), align=8)
        factor = spread(builder, _four(), builder.load(builder.gep(factors, [loop.index])))
        builder.store(fma(builder, factor, values, builder.load(total)), total)
    return builder.load(total)


@intrinsic
def add_products(_: Any, sums: Any, at: Any, values: Any, begin: Any, stride: Any, factors: Any, count: Any) -> Any:
    """Add to `LANES` ``sums`` from index ``at`` the products of ``count`` ``factors`` with as many rows of ``values``.

    Row i begins at ``begin + i stride``. The result is that of ``count`` calls of `add_scaled`, but the sums stay in
    a register.
    """

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        target = _vector_pointer(context, builder, signature.args[0], args[0], args[1])
        start = builder.load(target, align=8)
        builder.store(_sum_of_products(context, builder, signature, args, start), target, align=8)
        return context.get_dummy_value()

    return types.void(sums, types.int64, values, types.int64, types.int64, factors, types.int64), generate


@intrinsic
def put_products(_: Any, sums: Any, at: Any, values: Any, begin: Any, stride: Any, factors: Any, count: Any) -> Any:
    """Do the same as `add_products`, but start the sums at zero."""

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        target = _vector_pointer(context, builder, signature.args[0], args[0], args[1])
        start = ir.Constant(_four(), [0.0] * LANES)
        builder.store(_sum_of_products(context, builder, signature, args, start), target, align=8)
        return context.get_dummy_value()

    return types.void(sums, types.int64, values, types.int64, types.int64, factors, types.int64), generate


@intrinsic
def carry(
    _: Any,
    s: Any,
    at: Any,
    own: Any,
    y: Any,
    y_at: Any,
    a: Any,
    row: Any,
    to: Any,
    before: Any,
    after: Any,
    z: Any,
    z_at: Any,
    b: Any,
) -> Any:
    """Replace `LANES` numbers s by s' = own s + a y, and store before s + after s' + b z in ``row``.

    The groups of numbers begin at the indices ``at``, ``y_at``, ``to`` and ``z_at``.
    """

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        kinds = signature.args
        target = _vector_pointer(context, builder, kinds[0], args[0], args[1])
        old = builder.load(target, align=8)
        y_values = builder.load(_vector_pointer(context, builder, kinds[3], args[3], args[4]), align=8)
        z_values = builder.load(_vector_pointer(context, builder, kinds[10], args[10], args[11]), align=8)
        own_by, a_by, before_by, after_by, b_by = (spread(builder, _four(), args[i]) for i in (2, 5, 8, 9, 12))
        new = fma(builder, a_by, y_values, builder.fmul(own_by, old))
        builder.store(new, target, align=8)
        total = fma(builder, after_by, new, fma(builder, b_by, z_values, builder.fmul(before_by, old)))
        builder.store(total, _vector_pointer(context, builder, kinds[6], args[6], args[7]), align=8)
        return context.get_dummy_value()

    number, index = types.float64, types.int64
    return types.void(s, index, number, y, index, number, row, index, number, number, z, index, number), generate


@intrinsic
def put_slopes(_: Any, target: Any, at: Any, values: Any, begin: Any, factor: Any, h: Any, h_at: Any) -> Any:
    """Store ``factor`` times `LANES` ``values`` times 1 - h^2 in ``target`` from index ``at``.

    The values begin at the index ``begin``, the hyperbolic tangents ``h`` at ``h_at``. The result is the derivative of
    the weighted tangents over their arguments.
    """

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        kinds = signature.args
        weights = builder.load(_vector_pointer(context, builder, kinds[2], args[2], args[3]), align=8)
        units = builder.load(_vector_pointer(context, builder, kinds[5], args[5], args[6]), align=8)
        one = ir.Constant(_four(), [1.0] * LANES)
        slopes = builder.fsub(one, builder.fmul(units, units))
        result = builder.fmul(builder.fmul(spread(builder, _four(), args[4]), weights), slopes)
        builder.store(result, _vector_pointer(context, builder, kinds[0], args[0], args[1]), align=8)
        return context.get_dummy_value()

    index = types.int64
    return types.void(target, index, values, index, types.float64, h, index), generate
