"""Conversion of input arrays to the layout of the kernels.

A read-only array is copied: to numba it is another type, for which every kernel would be compiled once more.
"""

import numpy as np
from numpy.typing import ArrayLike

from friction_hil.errors import UsageError
from friction_hil.friction import kernel
from friction_hil.numerics.jit import Array


def vector(name: str, values: ArrayLike) -> Array:
    """Return ``values`` as a contiguous, writeable float64 vector, without checking that they are finite."""
    try:
        array = np.ascontiguousarray(values, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise UsageError(f"{name} must be an array of numbers: {error}") from None
    if array.ndim != 1:
        raise UsageError(f"{name} must have one dimension, not shape {array.shape}")
    return _writeable(array)


def per_sample(name: str, values: ArrayLike, samples: int) -> Array:
    """Return ``values`` as an array of one element or of ``samples`` elements, all finite."""
    try:
        array = np.atleast_1d(np.asarray(values, dtype=np.float64))
    except (TypeError, ValueError) as error:
        raise UsageError(f"{name} must be a number or an array of numbers: {error}") from None
    if array.shape not in ((1,), (samples,)):
        raise UsageError(f"{name} must be a number or have shape ({samples},), not {array.shape}")
    array = _writeable(np.ascontiguousarray(array))
    require_finite(name, array)
    return array


def _writeable(array: Array) -> Array:
    return array if array.flags.writeable else array.copy()


def checked_out(out: Array, shape: tuple[int, ...]) -> Array:
    """Return ``out`` if a kernel can write a result of that shape into it; otherwise raise UsageError."""
    if not isinstance(out, np.ndarray) or out.dtype != np.float64 or out.shape != shape:
        raise UsageError(f"out must be an array of float64 of shape {shape}")
    if not (out.flags.c_contiguous and out.flags.writeable):
        raise UsageError("out must be contiguous and writeable")
    return out


def require_finite(name: str, array: Array) -> None:
    """Raise UsageError if an element is infinite or NaN; the message gives its index."""
    if kernel.is_finite(array):
        return
    wrong = np.flatnonzero(~np.isfinite(array))
    if wrong.size:
        raise UsageError(f"{name} must be finite; element {wrong[0]} is {array[wrong[0]]} ({wrong.size} in all)")
