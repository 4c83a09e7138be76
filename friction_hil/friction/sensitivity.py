"""Gradient of the simulated torque: the kernel runs on dual numbers (forward sensitivities)."""

from typing import Any

import numpy as np

from friction_hil.friction import kernel
from friction_hil.numerics.dual import WIDTH, borrowed, dual_array
from friction_hil.numerics.jit import Array, compiled, inner

_run, _run_plain = kernel.run, kernel.run_plain
_BLOCK = 1024


@inner
def _of_block(values: Array, begin: int, end: int) -> Array:
    """Return the samples of an input that has one element for all samples, or one per sample."""
    return values[begin:end] if values.shape[0] > 1 else values


@inner
def _fill(gradient: Array, first: int, begin: int, samples: int, partials: Array) -> None:
    """Copy the ``partials`` of a block to the columns of ``gradient`` from ``first`` on."""
    for k in range(samples):
        for i in range(min(WIDTH, gradient.shape[1] - first)):
            gradient[begin + k, first + i] = partials[k, i]


@compiled
def run_plain(
    kind: Any,
    p: Array,
    seeds: Array,
    s: Array,
    state_gradient: Array,
    velocity: Array,
    dt: float,
    applied_torque: float,
    torque: Array,
    gradient: Array,
    first: int,
) -> None:
    """Do the work of `run` for a model without modifiers, with one ``dt`` and one ``applied_torque``."""
    parameters = dual_array(borrowed(p, 0), borrowed(seeds, 0))
    state = dual_array(borrowed(s, 0), borrowed(state_gradient, 0))
    partials = np.empty((_BLOCK, WIDTH))
    for begin in range(0, velocity.shape[0], _BLOCK):
        v = velocity[begin : begin + _BLOCK]
        of_block = dual_array(borrowed(torque, begin), borrowed(partials, 0))
        _run_plain(kind, parameters, state, v, dt, applied_torque, of_block)
        _fill(gradient, first, begin, v.shape[0], partials)


@compiled
def run(
    kind: Any,
    p: Array,
    seeds: Array,
    s: Array,
    state_gradient: Array,
    velocity: Array,
    dt: Array,
    position: Array,
    load_torque: Array,
    temperature: Array,
    applied_torque: Array,
    torque: Array,
    gradient: Array,
    first: int,
) -> None:
    """Run `friction_hil.friction.kernel.run` and fill up to WIDTH columns of ``gradient``, starting at ``first``.

    ``seeds`` (PLAIN_ROOM, WIDTH) holds the derivative of each element of ``p`` over the parameter of each column.
    ``state_gradient`` (STATE_ROOM, WIDTH) belongs to ``s`` and advances with it.
    """
    parameters = dual_array(borrowed(p, 0), borrowed(seeds, 0))
    state = dual_array(borrowed(s, 0), borrowed(state_gradient, 0))
    partials = np.empty((_BLOCK, WIDTH))
    for begin in range(0, velocity.shape[0], _BLOCK):
        end = min(begin + _BLOCK, velocity.shape[0])
        _run(
            kind,
            parameters,
            state,
            velocity[begin:end],
            _of_block(dt, begin, end),
            _of_block(position, begin, end),
            _of_block(load_torque, begin, end),
            _of_block(temperature, begin, end),
            _of_block(applied_torque, begin, end),
            dual_array(borrowed(torque, begin), borrowed(partials, 0)),
        )
        _fill(gradient, first, begin, end - begin, partials)
