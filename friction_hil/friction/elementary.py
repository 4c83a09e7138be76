"""Elementary functions for the kernels, for floats and for the dual numbers of `friction_hil.numerics.dual`.

The exponential is implemented here for two reasons. It has no branches and no tables, so that the compiler
vectorises loops over arrays. And it uses only correctly rounded operations, so that its bits are the same in such
a loop, in a single step and on every processor; the exponential of a C library does not guarantee that.
"""

import math
from typing import Any

import numpy as np

from friction_hil.numerics.dual import (
    WIDTH,
    borrowed,
    chain,
    differentiable,
    dual_array,
    dual_types,
    fma,
    overloaded,
    primal,
)
from friction_hil.numerics.jit import Array, inner

_LARGEST = 708.0  # e^-x is a normal number up to here; larger x give zero
_PER_LN2 = 1.0 / math.log(2.0)
_LN2_HIGH, _LN2_LOW = 6.93147180369123816490e-01, 1.90821492927058770002e-10  # their sum is ln 2 to 33 digits
_SHIFT = 6755399441055744.0  # 1.5 * 2^52: adding it rounds to an integer and leaves that in the low bits
_ONE_BITS = 4607182418800017408  # bit pattern of 1.0
_C2, _C3, _C4, _C5, _C6, _C7, _C8, _C9, _C10, _C11, _C12, _C13 = (1.0 / math.factorial(k) for k in range(2, 14))


@inner
def _reduced(x: float) -> tuple[float, float, float]:
    """Reduce e^-x = 2^k (1 + q) for 0 <= x <= `_LARGEST`; return k, 2^k and q."""
    shifted = fma(x, -_PER_LN2, _SHIFT)
    k = shifted - _SHIFT
    r = fma(k, -_LN2_LOW, fma(k, -_LN2_HIGH, -x))  # abs(r) <= ln(2) / 2
    r2 = r * r
    r4 = r2 * r2
    # Taylor polynomial of e^r - 1 in Estrin's scheme, which has short dependency chains
    low = fma(fma(r, _C5, _C4), r2, fma(r, _C3, _C2))
    middle = fma(fma(r, _C9, _C8), r2, fma(r, _C7, _C6))
    high = fma(fma(r, _C13, _C12), r2, fma(r, _C11, _C10))
    q = fma(fma(fma(high, r4, middle), r4, low), r2, r)
    bits = (np.float64(shifted).view(np.int64) << 52) + _ONE_BITS
    return k, np.int64(bits).view(np.float64), q


@inner
def _decay(x: float) -> float:
    is_zero = x >= _LARGEST
    _, scale, q = _reduced(_LARGEST if is_zero else x)
    return 0.0 if is_zero else fma(q, scale, scale)


@inner
def _approach(x: float) -> float:
    is_one = x >= _LARGEST
    k, scale, q = _reduced(_LARGEST if is_one else x)
    far = 1.0 if is_one else 1.0 - fma(q, scale, scale)
    return 0.0 - q if k == 0.0 else far


def decay(x: float) -> float:
    """Compute e^-x for x >= 0, to 1 unit in the last place; 0 from 708 on."""
    return math.exp(-x)


def approach(x: float) -> float:
    """Compute 1 - e^-x for x >= 0, to 2 units in the last place even for small x."""
    return -math.expm1(-x)


@inner
def _power(x: float, y: float) -> float:
    if y == 1.0:
        return x
    return x * x if y == 2.0 else x**y


def power(x: float, y: float) -> float:
    """Compute x^y for x >= 0 and y >= 0; exactly x and x * x for y = 1 and 2."""
    return x**y


def sin(x: float) -> float:
    """Compute the sine."""
    return math.sin(x)


def cos(x: float) -> float:
    """Compute the cosine."""
    return math.cos(x)


def tanh(x: float) -> float:
    """Compute the hyperbolic tangent."""
    return math.tanh(x)


def log(x: float) -> float:
    """Compute the natural logarithm."""
    return math.log(x)


def log1p(x: float) -> float:
    """Compute ln(1 + x) with full relative precision for small x."""
    return math.log1p(x)


def expm1(x: float) -> float:
    """Compute e^x - 1 with full relative precision for small x."""
    return math.expm1(x)


def toward(start: float, end: float, fraction: float) -> float:
    """Interpolate from ``start`` to ``end``: start + fraction (end - start), rounded once after the difference."""
    return start + fraction * (end - start)


def whole(x: float) -> int:
    """Return the integer that ``x`` holds."""
    return int(x)


def is_differentiated(x: float) -> bool:
    """Return True if ``x`` carries partial derivatives; known at compile time."""
    return False


def part(values: Array, begin: int) -> Array:
    """Return a view of the values from index ``begin`` on."""
    return values[begin:]


def buffer(parameters: Array, length: int) -> Array:
    """Allocate an array for ``length`` results that depend on the parameters."""
    return np.empty(length)


differentiable(decay, _decay, inner(lambda x, value: -value))
differentiable(approach, _approach, inner(lambda x, value: 1.0 - value))
differentiable(sin, inner(lambda x: math.sin(x)), inner(lambda x, value: math.cos(x)))
differentiable(cos, inner(lambda x: math.cos(x)), inner(lambda x, value: -math.sin(x)))
differentiable(tanh, inner(lambda x: math.tanh(x)), inner(lambda x, value: 1.0 - value * value))
differentiable(log, inner(lambda x: math.log(x)), inner(lambda x, value: 1.0 / x))
differentiable(log1p, inner(lambda x: math.log1p(x)), inner(lambda x, value: 1.0 / (1.0 + x)))
differentiable(expm1, inner(lambda x: math.expm1(x)), inner(lambda x, value: 1.0 + value))


@overloaded(power)
def _choose_power(x: Any, y: Any) -> Any:
    if isinstance(x, dual_types.DualType) or isinstance(y, dual_types.DualType):

        def of_duals(x, y):  # type: ignore[no-untyped-def]
            base, exponent = primal(x), primal(y)
            value = _power(base, exponent)
            if base == 0.0:
                return chain(value, 0.0, x + y)
            return chain(value, value * exponent / base, x + 0.0 * y) + chain(0.0, value * math.log(base), y + 0.0 * x)

        return of_duals
    return lambda x, y: _power(x, y)


@overloaded(toward)
def _choose_toward(start: Any, end: Any, fraction: Any) -> Any:
    if all(isinstance(each, dual_types.DualType) for each in (start, end, fraction)):

        def of_duals(start, end, fraction):  # type: ignore[no-untyped-def]
            change = end - start
            by_fraction, by_change = chain(0.0, primal(change), fraction), chain(0.0, primal(fraction), change)
            slopes = chain(0.0, 1.0, start) + by_fraction + by_change
            return chain(fma(primal(fraction), primal(change), primal(start)), 1.0, slopes)

        return of_duals
    return lambda start, end, fraction: fma(fraction, end - start, start)


@overloaded(whole)
def _choose_whole(x: Any) -> Any:
    return lambda x: int(primal(x))


@overloaded(is_differentiated)
def _choose_is_differentiated(x: Any) -> Any:
    return (lambda x: True) if isinstance(x, dual_types.DualType) else (lambda x: False)


@overloaded(part)
def _choose_part(values: Any, begin: Any) -> Any:
    if isinstance(values, dual_types.DualArrayType):
        return lambda values, begin: dual_array(borrowed(values.values, begin), borrowed(values.partials, begin))
    return lambda values, begin: borrowed(values, begin)


@overloaded(buffer)
def _choose_buffer(parameters: Any, length: Any) -> Any:
    if isinstance(parameters, dual_types.DualArrayType):
        return lambda parameters, length: dual_array(np.empty(length), np.empty((length, WIDTH)))
    return lambda parameters, length: np.empty(length)


_SMALL = 1e-5  # below this the next term of the series is less than the last bit


@inner
def mean_decay(x: float) -> float:
    """Compute the mean of e^-t for t from 0 to ``x``, of either sign: (1 - e^-x) / x."""
    if x > _SMALL:
        return approach(x) / x
    if x < -_SMALL:
        return approach(-x) / (-x * decay(-x))
    return 1.0 - x * (0.5 - x * (1.0 / 6.0 - x / 24.0))  # the quotient's derivative would suffer from cancellation
