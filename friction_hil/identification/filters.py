"""The zero-phase filters of `friction_hil.filtering`, compiled for the many columns of a gradient."""

from functools import cache
from typing import Any

import numpy as np

from friction_hil import filtering
from friction_hil.jit import Array, compiled


@compiled
def _cascade(sections: Array, start: Array, x: Array, is_backward: bool) -> None:
    """Second-order sections over the rows of ``x`` (n, m), in place; they begin settled on the first row met.

    The columns are the innermost loop: they are independent, so that the compiler puts them into one vector.
    """
    n, m = x.shape
    count = sections.shape[0]
    state = np.empty((count, 2, m))
    first = n - 1 if is_backward else 0
    for i in range(count):
        for j in range(m):
            state[i, 0, j] = start[i, 0] * x[first, j]
            state[i, 1, j] = start[i, 1] * x[first, j]
    for step in range(n):
        k = n - 1 - step if is_backward else step
        for i in range(count):
            b0, b1, b2 = sections[i, 0], sections[i, 1], sections[i, 2]
            a1, a2 = sections[i, 4], sections[i, 5]
            for j in range(m):
                value = x[k, j]
                y = b0 * value + state[i, 0, j]
                state[i, 0, j] = b1 * value - a1 * y + state[i, 1, j]
                state[i, 1, j] = b2 * value - a2 * y
                x[k, j] = y


@cache
def _sections(kind: str, argument: float) -> tuple[Array, Array]:
    """Coefficients of a low-pass (argument: cut-off over sampling rate) or a decimator (factor), and settled states."""
    from scipy import signal

    if kind == "lowpass":
        sections = signal.butter(filtering.LOWPASS_ORDER, 2.0 * argument, output="sos")
    else:
        sections = signal.cheby1(
            filtering.DECIMATOR_ORDER,
            filtering.DECIMATOR_RIPPLE_DB,
            filtering.DECIMATOR_SHARE / argument,
            output="sos",
        )
    return np.ascontiguousarray(sections), np.ascontiguousarray(signal.sosfilt_zi(sections))


def _forward_backward(values: Array, kind: str, argument: float, padding: int) -> Array:
    """Filter the rows of ``values`` (n, m) both ways, extended oddly by ``padding`` rows at either end."""
    head = 2.0 * values[0] - values[padding:0:-1]
    tail = 2.0 * values[-1] - values[-2 : -padding - 2 : -1]
    extended = np.concatenate([head, values, tail])
    sections, start = _sections(kind, argument)
    _cascade(sections, start, extended, False)
    _cascade(sections, start, extended, True)
    return extended[padding:-padding]


def _columns(values: Array) -> Array:
    return np.ascontiguousarray(values.reshape(len(values), -1), dtype=np.float64)


def lowpass(values: Array, cutoff_hz: float, rate_hz: float) -> Array:
    """Do what `friction_hil.filtering.lowpass` does; (n,) or (n, m)."""
    filtered = _forward_backward(_columns(values), "lowpass", cutoff_hz / rate_hz, filtering.lowpass_padding())
    return filtered.reshape(values.shape)


def decimate(values: Array, factor: int) -> Array:
    """Do what `friction_hil.filtering.decimate` does; (n,) or (n, m)."""
    if factor == 1:
        return values
    filtered = _forward_backward(_columns(values), "decimate", float(factor), filtering.decimation_padding())
    kept: Any = filtered[filtering.decimated_rows(len(values), factor)]
    return np.ascontiguousarray(kept).reshape(-1, *values.shape[1:])
