"""Runs of a network over a record, and the exact derivative of the error over its weights.

The derivative of a free run takes along the sensitivities of what is fed back, one row for each (Williams and
Zipser, Neural Computation 1(2), 1989): with few states and few weights that is cheaper than going back through
time for every sample, and it needs no more memory than a block of rows.
"""

import numpy as np

from friction_hil.jit import Array, compiled
from friction_hil.models import network
from friction_hil.models.elementary import approach, part, whole
from friction_hil.models.lanes import LANES, add_scaled, put_scaled, put_sum
from friction_hil.models.network import (
    BOUND,
    FEEDBACKS,
    GATE_WEIGHTS,
    GATED,
    HEADER,
    INPUTS,
    LAGS,
    NARX,
    RATE_HALF,
    SECOND,
    SPARE,
    STRUCTURE,
    VELOCITY_FEATURES,
    WIDTH,
)
from friction_hil.training.normal import add_products

BLOCK = 64  # rows of the Jacobian at a time: they stay in the nearest caches until their products are summed

_advance, _output_weights = network.advance, network.output_weights
_rate, _rate_bend = network.rate, network.rate_bend
_velocity_features, _other_features = network.velocity_features, network.other_features


@compiled
def fill_inputs(
    p: Array, starts: Array, velocity: Array, position: Array, load_torque: Array, temperature: Array, x: Array
) -> None:
    """Fill ``x`` (n, inputs) with those of every sample; ``starts`` is not 0 where a record begins, from rest."""
    remembered = VELOCITY_FEATURES * whole(p[LAGS])
    for k in range(velocity.shape[0]):
        row = x[k]
        _velocity_features(p, velocity[k], row)
        for i in range(remembered):
            row[VELOCITY_FEATURES + i] = 0.0 if starts[k] != 0.0 else x[k - 1, i]
        others = part(row, VELOCITY_FEATURES + remembered)
        _other_features(p, position[k], load_torque[k], temperature[k], others)


@compiled
def _units_room(p: Array) -> int:
    return whole(p[WIDTH]) + whole(p[SECOND]) + SPARE


@compiled
def trace_width(p: Array) -> int:
    """Return the length of a row of what `run` writes down: layers, aims, what was fed back, torque."""
    feedbacks = whole(p[FEEDBACKS])
    return _units_room(p) + 1 + 2 * feedbacks + 1


@compiled
def run(
    p: Array, starts: Array, x: Array, path: Array, tempo: float, measured: Array, is_free: bool, trace: Array
) -> None:
    """Run over a record and write every step down in ``trace`` (n, trace_width).

    Where ``is_free`` the network is fed its own past outputs, otherwise those that were ``measured`` (n,), in
    units of the torque scale.
    """
    feedbacks, units = whole(p[FEEDBACKS]), _units_room(p)
    aims = 1 + feedbacks
    last = units + aims + feedbacks
    state = np.zeros(max(feedbacks, 1))
    flat_x, flat_trace = x.reshape(-1), trace.reshape(-1)  # rows of a table would be counted as references
    for k in range(path.shape[0]):
        row = part(flat_trace, k * trace.shape[1])
        if starts[k] != 0.0:
            state[:] = 0.0
        elif not is_free and feedbacks > 0:
            if p[STRUCTURE] == NARX:
                state[0] = measured[k - 1]
            else:
                for i in range(feedbacks):
                    state[i] += (measured[k - 1] - trace[k - 1, last]) / feedbacks
        for i in range(feedbacks):
            row[units + aims + i] = state[i]
        row[last] = _advance(p, part(flat_x, k * x.shape[1]), path[k], tempo, state, state, part(row, units), row)


@compiled
def _layer_slopes(p: Array, h: Array, begin: int, slopes: Array) -> None:
    """Fill ``slopes`` (width + second) with those of an output over the sums that go into every unit.

    ``begin`` is where the output's weights of the last layer begin.
    """
    width, second = whole(p[WIDTH]), whole(p[SECOND])
    if second == 0:
        for j in range(width):
            slopes[j] = p[begin + j] * (1.0 - h[j] * h[j])
        return
    for j in range(second):
        slopes[width + j] = p[begin + j] * (1.0 - h[width + j] * h[width + j])
    weights = HEADER + width * (1 + whole(p[INPUTS]) + whole(p[FEEDBACKS])) + second
    for i in range(width):
        total = 0.0
        for j in range(second):
            total += p[weights + i * second + j] * slopes[width + j]
        slopes[i] = total * (1.0 - h[i] * h[i])


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
    p: Array, x: Array, fed_back: Array, h: Array, slopes: Array, place: int, row: Array, over_fed_back: Array
) -> None:
    """Fill ``row`` (weights + SPARE) with the slopes of output number ``place``, and ``over_fed_back`` with the others.

    Places of other outputs in ``row`` stay zero.
    """
    width, second, inputs = whole(p[WIDTH]), whole(p[SECOND]), whole(p[INPUTS])
    feedbacks = whole(p[FEEDBACKS])
    begin = width * (1 + inputs + feedbacks) + (second * (1 + width) if second > 0 else 0)
    begin += place * _output_weights(p)
    _layer_slopes(p, h, HEADER + begin + 1, slopes)
    for j in range(width):
        row[j] = slopes[j]
    to = part(row, width)
    _put_products(x, inputs, slopes, width, to)
    to = part(to, inputs * width)
    _put_products(fed_back, feedbacks, slopes, width, to)
    for i in range(feedbacks):
        weights = HEADER + (1 + inputs + i) * width
        even, odd = 0.0, 0.0
        for j in range(0, width - 1, 2):
            even += p[weights + j] * slopes[j]
            odd += p[weights + j + 1] * slopes[j + 1]
        over_fed_back[i] = even + odd + (p[weights + width - 1] * slopes[width - 1] if width % 2 == 1 else 0.0)
    if second > 0:
        to = part(to, feedbacks * width)
        for j in range(second):
            to[j] = slopes[width + j]
        _put_products(h, width, part(slopes, width), second, part(to, second))
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
    units, feedbacks = _units_room(p), whole(p[FEEDBACKS])
    fed_back = part(step, units + 1 + feedbacks)
    stride = weights + SPARE
    if abs(step[units]) >= p[BOUND]:
        for w in range(weights):
            row[w] = 0.0
    else:
        _output_gradient(p, x, fed_back, step, slopes, 0, gradient, over)
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
def _gated_row(
    p: Array,
    x: Array,
    path: float,
    tempo: float,
    step: Array,
    slopes: Array,
    s: Array,
    over: Array,
    gradient: Array,
    after: Array,
    row: Array,
    weights: int,
) -> None:
    """Fill ``row`` with the derivative of the torque of a gated network; advance its sensitivities ``s``.

    ``gradient`` (1 + feedbacks, weights + SPARE) and ``after`` (feedbacks, weights + SPARE) are room, zeros at first.
    """
    units, feedbacks = _units_room(p), whole(p[FEEDBACKS])
    aims, fed_back = part(step, units), part(step, units + 1 + feedbacks)
    inputs = whole(p[INPUTS])
    gates = weights - feedbacks * GATE_WEIGHTS
    stride = weights + SPARE
    bends, ways = part(over, feedbacks), part(over, 2 * feedbacks)
    if path > 0.0:
        damping = aims[feedbacks] * tempo
        last_gradient = part(gradient, feedbacks * stride)
        _output_gradient(p, x, fed_back, step, slopes, feedbacks, last_gradient, over)
        gained = 0.0
        for i in range(feedbacks):
            bends[i] = _rate_bend(p, HEADER + gates + i * GATE_WEIGHTS, x)
            ways[i] = approach(_rate(p, bends[i]) * path)
            gained += tempo * ways[i] * (aims[i] - fed_back[i])
        for w in range(0, weights, LANES):
            put_scaled(row, w, last_gradient, w, gained)
        for j in range(feedbacks):
            for w in range(0, weights, LANES):
                add_scaled(row, w, s, j * stride + w, gained * over[j])
        for i in range(feedbacks):
            way, here = ways[i], part(gradient, i * stride)
            after_i, s_i = part(after, i * stride), part(s, i * stride)
            own, new = 1.0 - way, 0.0
            if abs(aims[i]) < p[BOUND]:
                _output_gradient(p, x, fed_back, step, slopes, i, here, over)
                own, new = 1.0 - way + way * over[i], way
            for w in range(0, weights, LANES):
                put_sum(after_i, w, s_i, own, here, new)
            for j in range(feedbacks):
                if j != i:
                    for w in range(0, weights, LANES):
                        add_scaled(after_i, w, s, j * stride + w, new * over[j])
            turn = _rate(p, bends[i]) * path * (1.0 - way) * (aims[i] - fed_back[i])
            turn *= p[RATE_HALF] * (1.0 - bends[i] * bends[i])
            place = gates + i * GATE_WEIGHTS
            for j in range(GATE_WEIGHTS):
                value = turn * (x[j - 1] * x[j - 1] if j > 0 else 1.0)
                after_i[place + j] += value
            for w in range(0, weights, LANES):
                add_scaled(row, w, s_i, w, -damping)
                add_scaled(row, w, after_i, w, 1.0 + damping)
        for w in range(feedbacks * stride):
            s[w] = after[w]
    else:  # at rest the state stands still, and so does its derivative
        for w in range(weights):
            row[w] = s[w]
        for i in range(1, feedbacks):
            for w in range(weights):
                row[w] += s[i * stride + w]
    direct = gates - 1 - inputs
    row[direct] += 1.0
    for i in range(inputs):
        row[direct + 1 + i] += x[i]
    if abs(step[units + 1 + 2 * feedbacks]) >= p[BOUND]:
        for w in range(weights):
            row[w] = 0.0


@compiled
def fill_rows(
    p: Array,
    starts: Array,
    x: Array,
    path: Array,
    tempo: float,
    trace: Array,
    is_free: bool,
    begin: int,
    end: int,
    s: Array,
    rows: Array,
    weights: int,
) -> None:
    """Fill ``rows`` (end - begin, at least weights + SPARE) with the derivative of the torque in these samples.

    ``s`` (at least 1, weights + SPARE) are the sensitivities of what is fed back, carried from block to block.
    """
    feedbacks, units = whole(p[FEEDBACKS]), _units_room(p)
    slopes, over = np.empty(units), np.empty(max(3 * feedbacks, 1))
    gradient, after = np.zeros((1 + feedbacks) * (weights + SPARE)), np.zeros(max(feedbacks, 1) * (weights + SPARE))
    sensitivity = s.reshape(-1)
    flat_x, flat_trace, flat_rows = x.reshape(-1), trace.reshape(-1), rows.reshape(-1)
    for k in range(begin, end):
        if starts[k] != 0.0:
            s[:] = 0.0
        inputs, step = part(flat_x, k * x.shape[1]), part(flat_trace, k * trace.shape[1])
        row = part(flat_rows, (k - begin) * rows.shape[1])
        if p[STRUCTURE] == GATED:
            _gated_row(p, inputs, path[k], tempo, step, slopes, sensitivity, over, gradient, after, row, weights)
        else:
            _fed_back_row(p, inputs, step, is_free, slopes, sensitivity, over, gradient, row, weights)


@compiled
def normal_equations(
    p: Array,
    starts: Array,
    x: Array,
    path: Array,
    tempo: float,
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
    s = np.zeros((max(whole(p[FEEDBACKS]), 1), weights + SPARE))
    rows = np.zeros((BLOCK + 1, matrix.shape[1]))  # one more, for vectors that reach beyond a row
    matrix[:] = 0.0
    for begin in range(0, path.shape[0], BLOCK):
        end = min(begin + BLOCK, path.shape[0])
        fill_rows(p, starts, x, path, tempo, trace, is_free, begin, end, s, rows, weights)
        used = 0
        for k in range(begin, end):
            if weight[k] > 0.0:
                share = np.sqrt(weight[k])
                for w in range(weights):
                    rows[used, w] = share * rows[k - begin, w]
                rows[used, weights] = share * (trace[k, last] - target[k])
                used += 1
        add_products(rows, used, weights + 1, matrix)


@compiled
def squared_error(trace: Array, target: Array, weight: Array) -> float:
    """Sum of the squared errors of a run, in units of the torque scale squared."""
    last = trace.shape[1] - 1
    total = 0.0
    for k in range(target.shape[0]):
        error = trace[k, last] - target[k]
        total += weight[k] * error * error
    return total
