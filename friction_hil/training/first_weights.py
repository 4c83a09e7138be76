"""First weights of a training: random, but close to friction models that the data suggest. Pure."""

import math
from typing import Any

import numpy as np

from friction_hil.friction import NetworkStructure, network
from friction_hil.numerics.jit import Array
from friction_hil.training.layout import Samples
from friction_hil.training.objective import NetworkRun

_ELEMENT_UNITS = 6  # units of the first layer that `_draw_elements` sets
_SLIDING = 0.9  # of the stop's stroke: beyond, the axis slides


def first_weights(p: Array, structure: NetworkStructure, samples: Samples, random: np.random.Generator) -> Array:
    """Draw small random weights (weights,) whose output is a static map of the inputs, fitted to the samples.

    A gated network thus starts as Dahl's model with a level that depends on the velocity. ``p``: the header is used,
    the weights are not. `friction_hil.training.constraints` is still to be applied.
    """
    searched = 0.3 * random.standard_normal(structure.weights)
    begin, stride = structure.outputs_begin, structure.output_weights
    searched[begin:] *= 0.1
    run = NetworkRun(p, samples)
    p = p.copy()
    p[network.HEADER : network.HEADER + begin] = searched[:begin]
    run.simulate(p, is_free=True)
    last = run.trace[:, sum(structure.hidden) - structure.hidden[-1] : sum(structure.hidden)]
    columns = np.column_stack([np.ones(len(samples)), last, run.inputs]) * np.sqrt(run.weight)[:, None]
    ridge = 1e-3 * np.eye(columns.shape[1])
    fitted = np.linalg.solve(columns.T @ columns + ridge, columns.T @ (np.sqrt(run.weight) * run.target))
    if structure.kind == "gated" and structure.states > 1 and _has_room_for_elements(structure):
        _draw_elements(structure, run, searched, random)
    else:
        summed = max(structure.states - 1, 1) if structure.kind == "gated" else 1
        for index in range(begin, begin + summed * stride, stride):
            searched[index : index + fitted.size] += fitted / summed
    if structure.kind == "gated":
        gates = searched[structure.weights - structure.states * network.GATES * network.GATE_WEIGHTS :]
        _draw_gates(p, run, gates.reshape(structure.states, network.GATES, network.GATE_WEIGHTS), random)
    return searched


def _has_room_for_elements(structure: NetworkStructure) -> bool:
    return len(structure.hidden) == 1 and structure.hidden[0] >= _ELEMENT_UNITS


def _draw_elements(structure: NetworkStructure, run: NetworkRun, searched: Array, random: np.random.Generator) -> None:
    """Set the weights of the layers and outputs to those of equal elements whose level is the last state, in place.

    The target of the last state is an even function of the velocity, made of two pairs of units and fitted to sliding.
    A third pair gives the level the sign of the direction x of motion: tanh(x + g) + tanh(x - g) is odd in x and
    decreases with g, which decreases with the level.
    """
    width, inputs, states = structure.hidden[0], structure.inputs, structure.states
    bias, weights = searched[:width], searched[width : width * (1 + inputs)].reshape(inputs, width)
    fed = searched[slice(*structure.feedback_weights)].reshape(states, width)
    outs = searched[structure.outputs_begin :][: structure.outputs * structure.output_weights]
    outs = outs.reshape(structure.outputs, structure.output_weights)
    direct = searched[structure.outputs_begin + outs.size :]
    fed *= 0.1
    weights[:, :_ELEMENT_UNITS] *= 0.1
    x, direction = run.inputs, network.VELOCITY_FEATURES - 1
    bias[:_ELEMENT_UNITS] = (1.5, -1.5, 1.5, 1.5, 1.5, 1.5)
    weights[direction, :2], fed[-1, :2] = 1.0, (-0.8, 0.8)
    curves = [np.ones(len(x))]
    for pair, feature in ((2, 1), (4, 2)):
        slope = random.uniform(2.0, 8.0)
        weights[feature, pair : pair + 2] = slope, -slope
        curves.append(np.tanh(1.5 + slope * x[:, feature]) + np.tanh(1.5 - slope * x[:, feature]))
    sliding = np.sqrt(run.weight * (run.gate_features[network.VELOCITY_FEATURES] > _SLIDING))
    columns = np.column_stack([*curves, np.abs(x[:, 0])]) * sliding[:, None]
    ridge = 1e-6 * np.eye(columns.shape[1])
    fitted = np.linalg.solve(columns.T @ columns + ridge, columns.T @ (sliding * np.abs(run.target)))
    level = float(np.mean((np.column_stack(curves) @ fitted[:-1])[sliding > 0.0])) if np.any(sliding) else 1.0
    outs[-2, 0] += fitted[0] / level
    outs[-2, 3:5] += fitted[1] / level
    outs[-2, 5:7] += fitted[2] / level
    own = level / (states - 1)  # 2.3 (tanh(x + g) + tanh(x - g)) - 1.8 x is 1 at x = 1 and rises like the level
    outs[:-2, 1:3] += 2.3 * own
    outs[:-2, 1 + width + direction] -= 1.8 * own
    direct[1] += fitted[-1]


def _draw_gates(p: Array, run: NetworkRun, gates: Array, random: np.random.Generator) -> None:
    """Set ``gates`` (states, 2, `GATE_WEIGHTS`), in place, to random rates and knees of a plausible size.

    With several states, all but the last yield after strokes spread about that of the stop, like the elements of a
    Maxwell-slip model. The last state follows its target with a random time constant while the axis slides, and faster
    while it sticks.
    """
    states, speed = len(gates), np.abs(run.samples.velocity)
    is_moving = speed > 0.0
    middle = float(np.median(run.path[is_moving])) if np.any(is_moving) else 1.0
    if states == 1:
        rates, near = 10.0 ** random.uniform(-0.5, 1.0, 1) / middle, 10.0 ** random.uniform(-1.0, 0.3, 1)
        knees = near if random.uniform() < 0.5 else np.full(1, 2.0 * p[network.BOUND])  # never reached, as in LuGre
    else:
        elements = states - 1
        ratio, centre = 10.0 ** random.uniform(0.2, 0.6), p[network.STROKE] * 10.0 ** random.uniform(-0.3, 0.1)
        knees = 10.0 ** random.uniform(-2.0, -0.5, states)
        strokes = centre * ratio ** (np.arange(states) - 0.5 * (elements - 1))
        rates = np.maximum(1.0, 1.0 / (elements * knees)) / strokes
    gates[:, 0, 0] = _bend(np.log(rates), p[network.RATE_MIDDLE], p[network.RATE_HALF])
    gates[:, 1, 0] = _bend(np.log(knees / p[network.BOUND]), network.KNEE_MIDDLE, network.KNEE_HALF)
    if states > 1 and np.any(is_moving):
        per_s = 10.0 ** random.uniform(1.0, 2.3)
        rate = per_s / np.maximum(speed[is_moving], 0.1 * p[network.SPEEDS + 1])
        seen = run.gate_features[:, is_moving].T
        slid = seen[:, network.VELOCITY_FEATURES] + seen[:, network.VELOCITY_FEATURES + 1] - 1.0
        stuck = random.uniform(1.0, 3.0) * (1.0 - np.tanh(4.0 * (slid - random.uniform(0.2, 0.9))))
        wanted = _bend(np.log(rate) + stuck, p[network.RATE_MIDDLE], p[network.RATE_HALF])
        columns = np.column_stack([np.ones(len(seen)), seen])
        ridge = 1e-9 * len(columns) * np.eye(columns.shape[1])
        gates[-1, 0] = np.linalg.solve(columns.T @ columns + ridge, columns.T @ wanted)
        gates[-1, 1, 0] = _bend(math.log(2.0), network.KNEE_MIDDLE, network.KNEE_HALF)


def _bend(logarithm: Any, middle: float, half: float) -> Any:
    """Return the argument of a gate's tanh that gives this logarithm."""
    return np.arctanh(np.clip((logarithm - middle) / half, -0.97, 0.97))
