"""Runs of a network over a record, and the exact derivative of the error over its weights.

The derivative of a free run takes along the sensitivities of what is fed back, one row for each (Williams and
Zipser, Neural Computation 1(2), 1989): with few states and few weights that is cheaper than going back through
time for every sample, and it needs no more memory than a block of rows.
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
from friction_hil.numerics.jit import Array, compiled
from friction_hil.training.gated import (
    gated_row,
    layer_slopes,
    one_state_row,
    plan_rows,
    plan_width,
    put_over_fed_back,
    row_room,
    units_room,
)
from friction_hil.training.normal import add_products

BLOCK = 48  # rows of the Jacobian at a time: they stay in the nearest caches until their products are summed
GATE_BLOCK = 256  # samples whose gates are calculated together

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
    """Fill ``x`` (n, inputs) with the inputs of every sample; ``starts`` is not 0 where a record begins, from rest."""
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
    """What the gates of a gated network see in every sample, (`network.GATE_FEATURES`, n); ``x`` its inputs."""
    result, features, way = np.empty((GATE_FEATURES, velocity.shape[0])), np.empty(GATE_FEATURES), 0.0
    for k in range(velocity.shape[0]):
        way = _since_turn(p, 0.0 if starts[k] != 0.0 else way, velocity[k] * dt)
        _gate_features(x[k], way, features)
        result[:, k] = features
    return result


@compiled
def trace_width(p: Array) -> int:
    """Return the length of a row of what `run` writes down.

    Layers, aims, what was fed back; gated: for every state the share of the distance to its aim that it goes, its slope
    over the aim, and its slopes over the sums in the gates of the rate and of the knee; torque.
    """
    feedbacks = whole(p[FEEDBACKS])
    return units_room(p) + 1 + (6 if p[STRUCTURE] == GATED else 2) * feedbacks + 1


@compiled
def _fill_gates(p: Array, begin: int, seen: Array, path: Array, first: int, end: int, gates: Array) -> None:
    """Fill ``gates`` (5, at least end - first) in these samples: way, 1 / w, slopes of both, share near T.

    In loops of their own, because the compiler then takes several samples at a time: half of the exponentials of a
    network are here, and none of them waits for the sample before it.
    """
    bias, w0, w1, w2 = p[begin], p[begin + 1], p[begin + 2], p[begin + 3]
    w3, w4, w5 = p[begin + 4], p[begin + 5], p[begin + 6]
    half = p[RATE_HALF]
    x0, x1, x2, x3, x4, x5 = seen[0], seen[1], seen[2], seen[3], seen[4], seen[5]
    ways, knees, way_slopes, knee_slopes, near_shares = gates[0], gates[1], gates[2], gates[3], gates[4]
    for k in range(end - first):
        m = first + k
        low = fma(w2, x2[m], fma(w1, x1[m], fma(w0, x0[m], bias)))
        bend = _tanh(fma(w5, x5[m], fma(w4, x4[m], fma(w3, x3[m], low))))
        way = _rate(p, bend) * path[m]
        ways[k], near_shares[k] = way, approach(way)
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
    """Run over a record and write every step down in ``trace`` (n, trace_width).

    Where ``is_free`` the network is fed its own past outputs, otherwise those that were ``measured`` (n,), in
    units of the torque scale. ``seen`` is of `gate_features`.
    """
    feedbacks, units, n = whole(p[FEEDBACKS]), units_room(p), path.shape[0]
    aims, width, inputs = units + 1 + feedbacks, trace.shape[1], x.shape[1]
    is_gated, summed = p[STRUCTURE] == GATED, _summed(p)
    gates = np.empty((feedbacks if is_gated else 0, 5, GATE_BLOCK))
    first_gate = p.shape[0] - feedbacks * GATES * GATE_WEIGHTS
    state = np.zeros(max(feedbacks, 1))
    flat_x, flat_trace = x.reshape(-1), trace.reshape(-1)  # rows of a table would be counted as references
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
                row[aims + i] = state[i]
            if not is_gated:
                aims_k = part(row, units)
                row[width - 1], _ = _advance(p, inputs_k, inputs_k, path[k], 1.0, 0.0, state, state, aims_k, row)
                continue
            aims_k = part(row, units)  # from here on as in `network.advance`, but for the gates
            total, _ = _outputs(p, inputs_k, state, aims_k, row)
            damping, damped = aims_k[feedbacks], 0.0
            for i in range(feedbacks):
                before, way = state[i], gates[i, 0, k - begin]
                distance = aims_k[i] - before
                knees = abs(distance) * gates[i, 1, k - begin]
                share = soft = gates[i, 4, k - begin]  # what `travelled` gives within the knee
                over_way, over_knee = 1.0 - share, 0.0
                if knees > 1.0:
                    share, soft, knees, beyond = _travelled(distance, way, gates[i, 1, k - begin])
                    is_straight = way <= beyond
                    over_way = 1.0 / knees if is_straight else 1.0 - share
                    over_knee = share if is_straight else (1.0 - share) * beyond
                state[i] = toward(before, aims_k[i], share)
                if i < summed:
                    total += state[i]
                    damped += damping * (state[i] - before)
                row[aims + feedbacks + i] = share
                row[aims + 2 * feedbacks + i] = soft
                row[aims + 3 * feedbacks + i] = distance * over_way * gates[i, 2, k - begin]
                row[aims + 4 * feedbacks + i] = distance * over_knee * gates[i, 3, k - begin]
            row[width - 1] = _limited(total + damped, p[BOUND])


@compiled
def _put_products(inputs: Array, count: int, slopes: Array, width: int, row: Array) -> None:
    """Fill ``row`` (count, width) with the products of both; zeros in `SPARE` places behind it."""
    for i in range(count):
        for j in range(0, width, LANES):
            put_scaled(row, i * width + j, slopes, j, inputs[i])
    for j in range(SPARE):
        row[count * width + j] = 0.0


@compiled
def _output_gradient(
    p: Array, x: Array, fed_back: Array, h: Array, slopes: Array, row: Array, over_fed_back: Array
) -> None:
    """Fill ``row`` (weights + SPARE) with the slopes of the only output, and ``over_fed_back`` with the others."""
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


@compiled
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
    units, feedbacks = units_room(p), whole(p[FEEDBACKS])
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

    ``s`` (at least 1, row_room) are the sensitivities of what is fed back, carried from block to block.
    """
    feedbacks, units = whole(p[FEEDBACKS]), units_room(p)
    sensitivity = s.reshape(-1)
    flat_x, flat_trace, flat_rows = x.reshape(-1), trace.reshape(-1), rows.reshape(-1)
    if p[STRUCTURE] == GATED:
        stride, room = plan_width(p), row_room(p)
        plan, after, wide = np.zeros(BLOCK * stride), np.zeros(feedbacks * room), np.zeros(room)
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

    J is the derivative of the torque over the weights of the network and e the torque less the ``target``, both in
    units of the torque scale. ``matrix`` is square, with room for `normal.room` (weights + 1) columns; its lower
    triangle has J' J, J' e in row ``weights``, and e' e at the end of that row.
    """
    last = trace.shape[1] - 1
    s = np.zeros((max(whole(p[FEEDBACKS]), 1), row_room(p)))
    rows = np.zeros((BLOCK + 1, matrix.shape[1]))  # one more, for vectors that reach beyond a row
    largest = np.max(weight)
    flat_rows, room = rows.reshape(-1), rows.shape[1]
    matrix[:] = 0.0
    for begin in range(0, path.shape[0], BLOCK):
        end = min(begin + BLOCK, path.shape[0])
        fill_rows(p, starts, x, seen, path, trace, is_free, begin, end, s, rows, weights)
        used = 0
        for k in range(begin, end):
            if weight[k] > 0.0:
                share = np.sqrt(weight[k] / largest)
                if share != 1.0 or used < k - begin:  # most rows are where they should be
                    for w in range(0, weights, LANES):
                        put_scaled(flat_rows, used * room + w, flat_rows, (k - begin) * room + w, share)
                for w in range(weights, room):
                    flat_rows[used * room + w] = 0.0
                flat_rows[used * room + weights] = share * (trace[k, last] - target[k])
                used += 1
        add_products(rows, used, weights + 1, matrix)
    matrix *= largest


@compiled
def squared_error(trace: Array, target: Array, weight: Array) -> float:
    """Sum of the squared errors of a run, in units of the torque scale squared."""
    last = trace.shape[1] - 1
    total = 0.0
    for k in range(target.shape[0]):
        error = trace[k, last] - target[k]
        total += weight[k] * error * error
    return total
