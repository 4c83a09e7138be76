"""Runs of a network over a record, and the exact derivative of the torque over its weights.

In a free run the sensitivities of the fed-back values, one row for each, are propagated from sample to sample (Williams
and Zipser, Neural Computation 1(2), 1989). With few states and few weights that is cheaper than back-propagation
through time for every sample, and needs memory for one block of rows only.
"""

import numpy as np

from friction_hil.friction import network
from friction_hil.friction.elementary import approach, part, toward, whole
from friction_hil.friction.lanes import LANES, add_scaled, put_scaled
from friction_hil.friction.network import (
    BOUND,
    FEEDBACKS,
    GATE_FEATURES,
    GATE_WEIGHTS,
    GATED,
    GATES,
    HEADER,
    INPUTS,
    KNEE_HALF,
    LAGS,
    NARX,
    RATE_HALF,
    SECOND,
    SPARE,
    STRUCTURE,
    VELOCITY_FEATURES,
    WIDTH,
)
from friction_hil.numerics.dual import fma
from friction_hil.numerics.jit import Array, compiled, inlined, inner
from friction_hil.training.gated import (
    gated_row,
    layer_slopes,
    one_state_row,
    plan_rows,
    plan_width,
    put_over_fed_back,
    row_length,
    units_length,
)
from friction_hil.training.normal import add_products

BLOCK = 48  # rows of the Jacobian in one block, which stays in the first caches until its products are summed
GATE_BLOCK = 256  # samples whose gates are computed together

_advance, _outputs = network.advance, network.outputs
_limited, _rate, _tanh = network.limited, network.rate, network.tanh
_velocity_features, _other_features = network.velocity_features, network.other_features
_per_knee, _travelled, _stop = network.per_knee, network.travelled, network.stop
_summed, _since_turn, _gate_features = network.summed, network.since_turn, network.gate_features


@compiled
def fill_inputs(
    p: Array,
    starts: Array,
    velocity: Array,
    dt: float,
    position: Array,
    load_torque: Array,
    temperature: Array,
    x: Array,
) -> None:
    """Fill ``x`` (n, inputs) with the inputs of every sample; ``starts`` is 1 where a record begins, from rest."""
    is_gated = p[STRUCTURE] == GATED
    remembered = 1 if is_gated else VELOCITY_FEATURES * whole(p[LAGS])
    for k in range(velocity.shape[0]):
        row = x[k]
        _velocity_features(p, velocity[k], row)
        if is_gated:
            before = 0.0 if starts[k] != 0.0 else x[k - 1, VELOCITY_FEATURES]
            row[VELOCITY_FEATURES] = _stop(p, before, velocity[k] * dt)
        else:
            for i in range(remembered):
                row[VELOCITY_FEATURES + i] = 0.0 if starts[k] != 0.0 else x[k - 1, i]
        others = part(row, VELOCITY_FEATURES + remembered)
        _other_features(p, position[k], load_torque[k], temperature[k], others)


@compiled
def gate_features(p: Array, starts: Array, velocity: Array, dt: float, x: Array) -> Array:
    """Return the inputs of the gates in every sample, (`network.GATE_FEATURES`, n); ``x`` are those of the network."""
    result, features, way = np.empty((GATE_FEATURES, velocity.shape[0])), np.empty(GATE_FEATURES), 0.0
    for k in range(velocity.shape[0]):
        way = _since_turn(p, 0.0 if starts[k] != 0.0 else way, velocity[k] * dt)
        _gate_features(x[k], way, features)
        result[:, k] = features
    return result


@compiled
def trace_width(p: Array) -> int:
    """Return the length of a row of the trace that `run` writes.

    A row holds the layers, the targets of the states, the fed-back values, and the torque. For a gated network it also
    holds, for every state, the fraction of the distance to its target that it moves, its slope over the target, and its
    slopes over the sums in the gates of the rate and of the knee.
    """
    feedbacks = whole(p[FEEDBACKS])
    return units_length(p) + 1 + (6 if p[STRUCTURE] == GATED else 2) * feedbacks + 1


@inner
def _fill_gates(p: Array, begin: int, seen: Array, path: Array, first: int, end: int, gates: Array) -> None:
    """Fill ``gates`` (5, at least end - first): way, 1 / knee, slopes of both, fraction moved within the knee.

    These loops contain half of the exponentials of a network, and no sample depends on the one before: the compiler
    computes several samples at once.
    """
    bias, w0, w1, w2 = p[begin], p[begin + 1], p[begin + 2], p[begin + 3]
    w3, w4, w5 = p[begin + 4], p[begin + 5], p[begin + 6]
    half = p[RATE_HALF]
    x0, x1, x2, x3, x4, x5 = seen[0], seen[1], seen[2], seen[3], seen[4], seen[5]
    ways, knees, way_slopes, knee_slopes, near_fractions = gates[0], gates[1], gates[2], gates[3], gates[4]
    for k in range(end - first):
        m = first + k
        low = fma(w2, x2[m], fma(w1, x1[m], fma(w0, x0[m], bias)))
        bend = _tanh(fma(w5, x5[m], fma(w4, x4[m], fma(w3, x3[m], low))))
        way = _rate(p, bend) * path[m]
        ways[k], near_fractions[k] = way, approach(way)
        way_slopes[k] = way * (half * (1.0 - bend * bend))
    begin += GATE_WEIGHTS
    bias, w0, w1, w2 = p[begin], p[begin + 1], p[begin + 2], p[begin + 3]
    w3, w4, w5 = p[begin + 4], p[begin + 5], p[begin + 6]
    for k in range(end - first):
        m = first + k
        low = fma(w2, x2[m], fma(w1, x1[m], fma(w0, x0[m], bias)))
        bend = _tanh(fma(w5, x5[m], fma(w4, x4[m], fma(w3, x3[m], low))))
        knees[k] = _per_knee(p, bend)
        knee_slopes[k] = KNEE_HALF * (1.0 - bend * bend)


@inlined
def _gated_step(p: Array, inputs: Array, gates: Array, k: int, state: Array, row: Array, units: int) -> float:
    """Advance the states of a gated network, write the slopes to a ``row`` of the trace, and return the torque.

    As in `network.advance`, except that the gates of this sample are those of row ``k`` of ``gates``.
    """
    feedbacks, summed_states = whole(p[FEEDBACKS]), _summed(p)
    targets, fed_back = part(row, units), part(row, units + 1 + feedbacks)
    total, _ = _outputs(p, inputs, state, targets, row)
    damping, damped = targets[feedbacks], 0.0
    for i in range(feedbacks):
        before, way = state[i], gates[i, 0, k]
        distance = targets[i] - before
        knees = abs(distance) * gates[i, 1, k]
        fraction = soft = gates[i, 4, k]  # result of `travelled` within the knee
        over_way, over_knee = 1.0 - fraction, 0.0
        if knees > 1.0:
            fraction, soft, knees, beyond = _travelled(distance, way, gates[i, 1, k])
            is_straight = way <= beyond
            over_way = 1.0 / knees if is_straight else 1.0 - fraction
            over_knee = fraction if is_straight else (1.0 - fraction) * beyond
        state[i] = toward(before, targets[i], fraction)
        if i < summed_states:
            total += state[i]
            damped += damping * (state[i] - before)
        fed_back[feedbacks + i] = fraction
        fed_back[2 * feedbacks + i] = soft
        fed_back[3 * feedbacks + i] = distance * over_way * gates[i, 2, k]
        fed_back[4 * feedbacks + i] = distance * over_knee * gates[i, 3, k]
    return _limited(total + damped, p[BOUND])


@compiled
def run(
    p: Array,
    starts: Array,
    x: Array,
    seen: Array,
    path: Array,
    measured: Array,
    is_free: bool,
    trace: Array,
) -> None:
    """Run a network over records and write every step to ``trace`` (n, trace_width).

    If ``is_free``, the network is fed its own past outputs, otherwise the ``measured`` ones (n,), in units of the
    torque scale. ``seen`` is the result of `gate_features`.
    """
    feedbacks, units, n = whole(p[FEEDBACKS]), units_length(p), path.shape[0]
    fed_back, width, inputs = units + 1 + feedbacks, trace.shape[1], x.shape[1]
    is_gated, summed = p[STRUCTURE] == GATED, _summed(p)
    gates = np.empty((feedbacks if is_gated else 0, 5, GATE_BLOCK))
    first_gate = p.shape[0] - feedbacks * GATES * GATE_WEIGHTS
    state = np.zeros(max(feedbacks, 1))
    flat_x, flat_trace = x.reshape(-1), trace.reshape(-1)  # numba counts references of the rows of a 2-D array
    for begin in range(0, n, GATE_BLOCK):
        end = min(begin + GATE_BLOCK, n)
        for i in range(gates.shape[0]):
            _fill_gates(p, first_gate + i * GATES * GATE_WEIGHTS, seen, path, begin, end, gates[i])
        for k in range(begin, end):
            row, inputs_k = part(flat_trace, k * width), part(flat_x, k * inputs)
            if starts[k] != 0.0:
                state[:] = 0.0
            elif not is_free and feedbacks > 0:
                if not is_gated:
                    state[0] = measured[k - 1]
                else:
                    for i in range(summed):
                        state[i] += (measured[k - 1] - flat_trace[k * width - 1]) / summed
            for i in range(feedbacks):
                row[fed_back + i] = state[i]
            if not is_gated:
                targets = part(row, units)
                row[width - 1], _ = _advance(p, inputs_k, inputs_k, path[k], 1.0, 0.0, state, state, targets, row)
            else:
                row[width - 1] = _gated_step(p, inputs_k, gates, k - begin, state, row, units)


@inner
def _put_products(inputs: Array, count: int, slopes: Array, width: int, row: Array) -> None:
    """Fill ``row`` (count, width) with the products of inputs and slopes, followed by `SPARE` zeros."""
    for i in range(count):
        for j in range(0, width, LANES):
            put_scaled(row, i * width + j, slopes, j, inputs[i])
    for j in range(SPARE):
        row[count * width + j] = 0.0


@inner
def _output_gradient(
    p: Array, x: Array, fed_back: Array, h: Array, slopes: Array, row: Array, over_fed_back: Array
) -> None:
    """Fill ``row`` (weights + SPARE) and ``over_fed_back`` with the slopes of the output over both."""
    width, second, inputs = whole(p[WIDTH]), whole(p[SECOND]), whole(p[INPUTS])
    feedbacks = whole(p[FEEDBACKS])
    begin = width * (1 + inputs + feedbacks) + (second * (1 + width) if second > 0 else 0)
    layer_slopes(p, h, HEADER + begin + 1, 1.0, slopes)
    for j in range(width):
        row[j] = slopes[j]
    to = part(row, width)
    _put_products(x, inputs, slopes, width, to)
    to = part(to, inputs * width)
    _put_products(fed_back, feedbacks, slopes, width, to)
    put_over_fed_back(p, slopes, over_fed_back)
    if second > 0:
        to, above = part(to, feedbacks * width), part(slopes, width + SPARE)
        for j in range(second):
            to[j] = above[j]
        _put_products(h, width, above, second, part(to, second))
    last = part(h, width if second > 0 else 0)
    count = second if second > 0 else width
    to = part(row, begin)
    to[0] = 1.0
    for j in range(count):
        to[1 + j] = last[j]
    to = part(to, 1 + count)
    for i in range(inputs):
        to[i] = x[i]
    if p[STRUCTURE] == NARX:
        for i in range(feedbacks):
            to[inputs + i] = fed_back[i]
            over_fed_back[i] += p[HEADER + begin + 1 + count + inputs + i]


@inner
def _fed_back_row(
    p: Array,
    x: Array,
    step: Array,
    is_free: bool,
    slopes: Array,
    s: Array,
    over: Array,
    gradient: Array,
    row: Array,
    weights: int,
) -> None:
    """Fill ``row`` with the derivative of the torque of a static or narx network; advance its sensitivities ``s``."""
    units, feedbacks = units_length(p), whole(p[FEEDBACKS])
    fed_back = part(step, units + 1 + feedbacks)
    stride = weights + SPARE
    if abs(step[units]) >= p[BOUND]:
        for w in range(weights):
            row[w] = 0.0
    else:
        _output_gradient(p, x, fed_back, step, slopes, gradient, over)
        for w in range(weights):
            row[w] = gradient[w]
        if is_free:
            for i in range(feedbacks):
                for w in range(0, weights, LANES):
                    add_scaled(row, w, s, i * stride + w, over[i])
    if is_free and feedbacks > 0:
        for i in range(feedbacks - 1, 0, -1):
            for w in range(weights):
                s[i * stride + w] = s[(i - 1) * stride + w]
        for w in range(weights):
            s[w] = row[w]


@compiled
def fill_rows(
    p: Array,
    starts: Array,
    x: Array,
    seen: Array,
    path: Array,
    trace: Array,
    is_free: bool,
    begin: int,
    end: int,
    s: Array,
    rows: Array,
    weights: int,
) -> None:
    """Fill ``rows`` (end - begin, at least weights + SPARE) with the derivative of the torque in these samples.

    ``s`` (at least 1, row_length) are the sensitivities of the fed-back values, carried from block to block.
    """
    feedbacks, units = whole(p[FEEDBACKS]), units_length(p)
    sensitivity = s.reshape(-1)
    flat_x, flat_trace, flat_rows = x.reshape(-1), trace.reshape(-1), rows.reshape(-1)
    if p[STRUCTURE] == GATED:
        stride, length = plan_width(p), row_length(p)
        plan, after, wide = np.zeros(BLOCK * stride), np.zeros(feedbacks * length), np.zeros(length)
        for first in range(begin, end, BLOCK):
            last = min(first + BLOCK, end)
            plan_rows(p, x, seen, path, trace, first, last, plan)
            for k in range(first, last):
                if starts[k] != 0.0:
                    s[:] = 0.0
                step, row = part(flat_trace, k * trace.shape[1]), part(flat_rows, (k - begin) * rows.shape[1])
                plan_k = part(plan, (k - first) * stride)
                if feedbacks == 1 and path[k] > 0.0 and abs(step[units + 7]) < p[BOUND]:
                    one_state_row(p, step, plan_k, sensitivity, row)
                else:
                    gated_row(p, path[k], step, plan_k, sensitivity, after, wide, row)
        return
    slopes, over = np.zeros(units + SPARE), np.empty(max(feedbacks, 1))
    gradient = np.zeros(weights + SPARE)
    for k in range(begin, end):
        if starts[k] != 0.0:
            s[:] = 0.0
        inputs, step = part(flat_x, k * x.shape[1]), part(flat_trace, k * trace.shape[1])
        row = part(flat_rows, (k - begin) * rows.shape[1])
        _fed_back_row(p, inputs, step, is_free, slopes, sensitivity, over, gradient, row, weights)


@compiled
def normal_equations(
    p: Array,
    starts: Array,
    x: Array,
    seen: Array,
    path: Array,
    trace: Array,
    is_free: bool,
    target: Array,
    weight: Array,
    weights: int,
    matrix: Array,
) -> None:
    """Fill ``matrix`` with the products of the columns of [J, e], summed over all samples by their ``weight``.

    J is the derivative of the torque over the weights of the network, and e the torque minus the ``target``, both in
    units of the torque scale. ``matrix`` is square with `normal.padded` (weights + 1) columns; its lower triangle
    receives J' J, with J' e in row ``weights`` and e' e at the end of that row.
    """
    last = trace.shape[1] - 1
    s = np.zeros((max(whole(p[FEEDBACKS]), 1), row_length(p)))
    rows = np.zeros((BLOCK + 1, matrix.shape[1]))  # one row more, because vector stores reach beyond a row
    largest = np.max(weight)
    flat_rows, length = rows.reshape(-1), rows.shape[1]
    matrix[:] = 0.0
    for begin in range(0, path.shape[0], BLOCK):
        end = min(begin + BLOCK, path.shape[0])
        fill_rows(p, starts, x, seen, path, trace, is_free, begin, end, s, rows, weights)
        used = 0
        for k in range(begin, end):
            if weight[k] > 0.0:
                root = np.sqrt(weight[k] / largest)
                if root != 1.0 or used < k - begin:  # else the row is in place already
                    for w in range(0, weights, LANES):
                        put_scaled(flat_rows, used * length + w, flat_rows, (k - begin) * length + w, root)
                for w in range(weights, length):
                    flat_rows[used * length + w] = 0.0
                flat_rows[used * length + weights] = root * (trace[k, last] - target[k])
                used += 1
        add_products(rows, used, weights + 1, matrix)
    matrix *= largest


@compiled
def squared_error(trace: Array, target: Array, weight: Array) -> float:
    """Return the weighted sum of squared errors of a run, in units of the torque scale squared."""
    last = trace.shape[1] - 1
    total = 0.0
    for k in range(target.shape[0]):
        error = trace[k, last] - target[k]
        total += weight[k] * error * error
    return total
