"""Arrays that users give, as the kernels take them."""

import numpy as np
from numpy.typing import ArrayLike

from friction_hil.errors import UsageError
from friction_hil.friction import kernel
from friction_hil.numerics.jit import Array


def vector(name: str, values: ArrayLike) -> Array:
    """``values`` as the kernels take them; whether they are finite is not asked."""
    try:
        array = np.ascontiguousarray(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise UsageError(f"{name} must be an array of numbers: {error}") from None
    if array.ndim != 1:
        raise UsageError(f"{name} must have one dimension, not shape {array.shape}")
    return array


def per_sample(name: str, values: ArrayLike, samples: int) -> Array:
    """``values`` as an array of one element or ``samples``, all finite."""
    try:
        array = np.atleast_1d(np.asarray(values, dtype=np.float64))
    except (TypeError, ValueError) as error:
        raise UsageError(f"{name} must be a number or an array of numbers: {error}") from None
    if array.shape not in ((1,), (samples,)):
        raise UsageError(f"{name} must be a number or have shape ({samples},), not {array.shape}")
    require_finite(name, array)
    return np.ascontiguousarray(array)


def checked_out(out: Array, shape: tuple[int, ...]) -> Array:
    """``out``, if a kernel can write a result of that shape into it."""
    if not isinstance(out, np.ndarray) or out.dtype != np.float64 or out.shape != shape:
        raise UsageError(f"out must be an array of float64 of shape {shape}")
    if not (out.flags.c_contiguous and out.flags.writeable):
        raise UsageError("out must be contiguous and writeable")
    return out


def require_finite(name: str, array: Array) -> None:
    """Raise UsageError where an element is infinite or NaN, and say which."""
    if kernel.is_finite(array):
        return
    wrong = np.flatnonzero(~np.isfinite(array))
    if wrong.size:
        raise UsageError(f"{name} must be finite; element {wrong[0]} is {array[wrong[0]]} ({wrong.size} in all)")
