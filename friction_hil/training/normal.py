"""Normal equations of a tall and thin Jacobian, accumulated block by block, and their solution.

Compiled for one thread instead of using a BLAS: two threads of a BLAS take twice as long with matrices of this shape,
and their division of the work changes the bits of the sum. Here every operation is correctly rounded and the order is
fixed. The run time is about 0.7 times that of one thread of OpenBLAS.
"""

from typing import Any

import numpy as np

from friction_hil.friction import lanes
from friction_hil.numerics.dual import cgutils, intrinsic, ir, types
from friction_hil.numerics.jit import Array, compiled

# Size of the tile of the result that stays in registers while the rows of a block are added: 12 sums of 4 numbers, so
# that no multiply-add waits for the one before it.
ROWS, COLUMNS = 6, 8


def _vector() -> Any:
    return ir.VectorType(ir.DoubleType(), COLUMNS)


@intrinsic
def _add_tile(_: Any, block: Any, rows: Any, i: Any, j: Any, matrix: Any) -> Any:
    """Add to ``matrix[i : i + ROWS, j : j + COLUMNS]`` the products of those columns of ``block``, summed over rows.

    Vector instructions are given explicitly, because the compiler does not derive them from a loop over numbers.
    """

    def generate(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        source, count, first, second, target = args
        sources = context.make_array(signature.args[0])(context, builder, value=source)
        targets = context.make_array(signature.args[4])(context, builder, value=target)
        row_bytes = cgutils.unpack_tuple(builder, sources.strides)[0]
        target_bytes = cgutils.unpack_tuple(builder, targets.strides)[0]
        vectors, zero = _vector().as_pointer(), ir.Constant(_vector(), [0.0] * COLUMNS)
        sums = [cgutils.alloca_once_value(builder, zero) for _ in range(ROWS)]
        for slot in sums:
            builder.store(zero, slot)
        with cgutils.for_range(builder, count) as loop:
            row = cgutils.pointer_add(builder, sources.data, builder.mul(loop.index, row_bytes))
            right = builder.load(builder.bitcast(builder.gep(row, [second]), vectors), align=8)
            for a, slot in enumerate(sums):
                one = builder.load(builder.gep(row, [builder.add(first, ir.Constant(first.type, a))]))
                left = lanes.spread(builder, _vector(), one)
                builder.store(lanes.fma(builder, left, right, builder.load(slot)), slot)
        for a, slot in enumerate(sums):
            down = builder.mul(builder.add(first, ir.Constant(first.type, a)), target_bytes)
            into = builder.gep(cgutils.pointer_add(builder, targets.data, down), [second])
            into = builder.bitcast(into, vectors)
            builder.store(builder.fadd(builder.load(into, align=8), builder.load(slot)), into, align=8)
        return context.get_dummy_value()

    return types.void(block, types.int64, types.int64, types.int64, matrix), generate


@compiled
def add_products(block: Array, rows: int, columns: int, matrix: Array) -> None:
    """Add the products of the columns of ``block`` to the lower triangle of ``matrix``.

    ``block`` is (most rows, width), of which ``rows`` and ``columns`` are in use; ``width`` is `padded` (columns), and
    unused columns are zero. ``matrix`` is (width, width), changed in place; elements above the diagonal are undefined.
    """
    for i in range(0, columns, ROWS):
        for j in range(0, i + ROWS, COLUMNS):
            _add_tile(block, rows, i, j, matrix)


@compiled
def padded(columns: int) -> int:
    """Return ``columns`` rounded up to a multiple of `ROWS`, and that to a multiple of `COLUMNS`."""
    rows = (columns + ROWS - 1) // ROWS * ROWS
    return (rows + COLUMNS - 1) // COLUMNS * COLUMNS


@compiled
def solve(matrix: Array, right: Array, solution: Array, factor: Array) -> bool:
    """Solve a symmetric positive definite system by Cholesky's decomposition; False if it is not positive definite.

    ``solution`` is undefined then. Only the lower triangle of ``matrix`` (m, m) is read. ``right`` and ``solution`` are
    (m,). ``factor`` (m, m) is filled with the lower triangular factor.
    """
    size = right.shape[0]
    for i in range(size):
        total = right[i]
        for j in range(i + 1):
            rest = matrix[i, j]
            for k in range(j):
                rest -= factor[i, k] * factor[j, k]
            if i == j:
                if not rest > 0.0:
                    return False
                factor[i, i] = np.sqrt(rest)
            else:
                factor[i, j] = rest / factor[j, j]
        for k in range(i):
            total -= factor[i, k] * solution[k]
        solution[i] = total / factor[i, i]
    for i in range(size - 1, -1, -1):
        total = solution[i]
        for k in range(i + 1, size):
            total -= factor[k, i] * solution[k]
        solution[i] = total / factor[i, i]
    return True
