"""Derivative of the torque of a gated network over its weights, from the trace of a run and the states' sensitivities.

What needs no sensitivities is calculated for a block of samples first; then every sample takes one pass over them.
"""

from friction_hil.friction.elementary import part, whole
from friction_hil.friction.lanes import LANES, add_scaled, carry, put_products, put_scaled, put_slopes
from friction_hil.friction.network import (
    BOUND,
    FEEDBACKS,
    GATE_FEATURES,
    GATE_WEIGHTS,
    GATED,
    GATES,
    HEADER,
    INPUTS,
    SECOND,
    SPARE,
    STRUCTURE,
    WIDTH,
    output_weights,
    summed,
)
from friction_hil.numerics.jit import Array, compiled, inlined


@inlined
def units_room(p: Array) -> int:
    """Return the room that the layers take in the trace."""
    return whole(p[WIDTH]) + whole(p[SECOND]) + SPARE


@inlined
def layer_slopes(p: Array, h: Array, begin: int, factor: float, slopes: Array) -> None:
    """Fill ``slopes`` with ``factor`` times those of an output over the sums that go into every unit.

    Those of the first layer (width), those of the second from ``width + SPARE`` on; what stands within `SPARE` places
    behind either means nothing. ``begin`` is where the output's weights of the last layer begin.
    """
    width, second = whole(p[WIDTH]), whole(p[SECOND])
    if second == 0:
        for j in range(0, width, LANES):
            put_slopes(slopes, j, p, begin + j, factor, h, j)
        return
    above = part(slopes, width + SPARE)
    for j in range(0, second, LANES):
        put_slopes(above, j, p, begin + j, factor, h, width + j)
    weights = HEADER + width * (1 + whole(p[INPUTS]) + whole(p[FEEDBACKS])) + second
    for i in range(width):
        total = 0.0
        for j in range(second):
            total += p[weights + i * second + j] * above[j]
        slopes[i] = total * (1.0 - h[i] * h[i])


@inlined
def put_over_fed_back(p: Array, slopes: Array, over_fed_back: Array) -> None:
    """Fill ``over_fed_back`` (feedbacks) with the slopes of an output over what is fed back to the first layer."""
    width = whole(p[WIDTH])
    for i in range(whole(p[FEEDBACKS])):
        weights = HEADER + (1 + whole(p[INPUTS]) + i) * width
        even, odd = 0.0, 0.0
        for j in range(0, width - 1, 2):
            even += p[weights + j] * slopes[j]
            odd += p[weights + j + 1] * slopes[j + 1]
        over_fed_back[i] = even + odd + (p[weights + width - 1] * slopes[width - 1] if width % 2 == 1 else 0.0)


@inlined
def _padded(count: int) -> int:
    return (count + LANES - 1) // LANES * LANES


@compiled
def row_room(p: Array) -> int:
    """Return how many places the sensitivities of one number that is fed back take in `fill_rows`.

    In those of a gated network every group of weights begins at a multiple of `LANES`: what is written in one vector
    and soon read in another, shifted one, makes the processor wait until it is in the cache.
    """
    if p[STRUCTURE] != GATED:
        return p.shape[0] - HEADER + SPARE
    width, second, inputs = whole(p[WIDTH]), whole(p[SECOND]), whole(p[INPUTS])
    feedbacks = whole(p[FEEDBACKS])
    layers = _padded(width) * (1 + inputs + feedbacks) + _padded(second) * (1 + width)
    outputs = (1 + feedbacks) * _padded(output_weights(p))
    return layers + outputs + _padded(1 + inputs) + feedbacks * GATES * _padded(GATE_WEIGHTS) + LANES


@inlined
def _slopes_room(p: Array) -> int:
    return _padded(whole(p[WIDTH]) + SPARE + whole(p[SECOND]) + SPARE)


@inlined
def plan_width(p: Array) -> int:
    """Return the length of a row of `plan_rows`."""
    feedbacks, inputs = whole(p[FEEDBACKS]), whole(p[INPUTS])
    vectors = _padded(1 + inputs + feedbacks) + _padded(output_weights(p)) + _padded(GATE_WEIGHTS)
    return vectors + (1 + feedbacks) * (_slopes_room(p) + feedbacks) + 2 + 3 * feedbacks


@compiled
def plan_rows(
    p: Array,
    x: Array,
    seen: Array,
    path: Array,
    trace: Array,
    begin: int,
    end: int,
    flat_plan: Array,
) -> None:
    """Fill ``flat_plan`` (end - begin, `plan_width`) with all of `gated_row` that does not need the sensitivities.

    1, inputs and what is fed back; 1, last layer and inputs; 1 and what the gates see; then for the
    damping and for every state the slopes of `layer_slopes`, and those over what is fed back; then the slope of the
    torque over the damping, its slope over the states after the step, and for every state its slopes over its aim and
    over the sums in its gates. It is written long before it is read, for the reason in `row_room`.
    """
    units, feedbacks, inputs = units_room(p), whole(p[FEEDBACKS]), whole(p[INPUTS])
    width, second = whole(p[WIDTH]), whole(p[SECOND])
    count, each = second if second > 0 else width, output_weights(p)
    outputs = HEADER + width * (1 + inputs + feedbacks) + (second * (1 + width) if second > 0 else 0)
    stride, slopes_room = plan_width(p), _slopes_room(p)
    to_last = _padded(1 + inputs + feedbacks)
    to_gate = to_last + _padded(each)
    to_slopes = to_gate + _padded(GATE_WEIGHTS)
    to_numbers = to_slopes + (1 + feedbacks) * (slopes_room + feedbacks)
    flat_x, flat_trace = x.reshape(-1), trace.reshape(-1)
    for k in range(begin, end):
        plan = part(flat_plan, (k - begin) * stride)
        step, x_k = part(flat_trace, k * trace.shape[1]), part(flat_x, k * inputs)
        last, gate, numbers = part(plan, to_last), part(plan, to_gate), part(plan, to_numbers)
        aims, fed_back = part(step, units), part(step, units + 1 + feedbacks)
        shares, soft, turns = part(fed_back, feedbacks), part(fed_back, 2 * feedbacks), part(fed_back, 3 * feedbacks)
        plan[0] = last[0] = gate[0] = 1.0
        for i in range(inputs):
            plan[1 + i] = last[1 + count + i] = x_k[i]
        for i in range(GATE_FEATURES):
            gate[1 + i] = seen[i, k]
        for j in range(count):
            last[1 + j] = step[units - SPARE - count + j]
        damping, gained = aims[feedbacks], 0.0
        for i in range(feedbacks):
            plan[1 + inputs + i] = fed_back[i]
            if i < summed(p):
                gained += shares[i] * (aims[i] - fed_back[i])
        numbers[0], numbers[1] = gained, 1.0 + damping
        slopes = part(plan, to_slopes)
        layer_slopes(p, step, outputs + feedbacks * each + 1, gained, slopes)
        over = part(slopes, slopes_room)
        put_over_fed_back(p, slopes, over)
        for i in range(summed(p)):
            over[i] -= damping
        for i in range(feedbacks):
            new = soft[i] if abs(aims[i]) < p[BOUND] else 0.0
            slopes = part(over, feedbacks)
            over = part(slopes, slopes_room)
            layer_slopes(p, step, outputs + i * each + 1, new, slopes)
            put_over_fed_back(p, slopes, over)
            over[i] += 1.0 - soft[i]
            numbers[2 + 3 * i], numbers[3 + 3 * i], numbers[4 + 3 * i] = new, turns[i], turns[feedbacks + i]


@inlined
def _add_layers(p: Array, ones: Array, h: Array, slopes: Array, row: Array) -> None:
    """Add to ``row`` the derivative over the weights of the layers: ``slopes`` times what goes into every unit.

    ``slopes`` are as of `layer_slopes`; ``ones`` are 1, the inputs and what is fed back.
    """
    width, second = whole(p[WIDTH]), whole(p[SECOND])
    count = 1 + whole(p[INPUTS]) + whole(p[FEEDBACKS])
    for i in range(count):
        for j in range(0, width, LANES):
            add_scaled(row, i * _padded(width) + j, slopes, j, ones[i])
    if second > 0:
        to, above = part(row, count * _padded(width)), part(slopes, width + SPARE)
        for i in range(1 + width):
            for j in range(0, second, LANES):
                add_scaled(to, i * _padded(second) + j, above, j, h[i - 1] if i > 0 else 1.0)


@inlined
def _put_group(values: Array, begin: int, row: Array, at: int, count: int) -> None:
    for j in range(0, count, LANES):
        put_scaled(row, at + j, values, begin + j, 1.0)


@inlined
def one_state_row(p: Array, step: Array, plan: Array, s: Array, row: Array) -> None:
    """As `gated_row`, for the usual network of one state while it moves: every number in one go."""
    inputs, width, second, each = whole(p[INPUTS]), whole(p[WIDTH]), whole(p[SECOND]), output_weights(p)
    first, above = width * (2 + inputs), second * (1 + width)
    last_at = _padded(2 + inputs)
    gate_at = last_at + _padded(each)
    slopes_at = gate_at + _padded(GATE_WEIGHTS)
    over_at = slopes_at + _slopes_room(p)
    state_at = over_at + 1
    own_at = state_at + _slopes_room(p)
    before, own = plan[over_at], plan[own_at]
    gained, after, new = plan[own_at + 1], plan[own_at + 2], plan[own_at + 3]
    for i in range(2 + inputs):
        one = plan[i]
        for j in range(0, width, LANES):
            at, to = i * _padded(width) + j, i * width + j
            carry(s, at, own, plan, state_at + j, one, row, to, before, after, plan, slopes_at + j, one)
    at = (2 + inputs) * _padded(width)
    if second > 0:
        y, z = state_at + width + SPARE, slopes_at + width + SPARE
        for i in range(1 + width):
            one = step[i - 1] if i > 0 else 1.0
            for j in range(0, second, LANES):
                to = first + i * second + j
                carry(s, at + j, own, plan, y + j, one, row, to, before, after, plan, z + j, one)
            at += _padded(second)
    to = first + above
    for j in range(0, each, LANES):
        carry(s, at + j, own, plan, last_at + j, new, row, to + j, before, after, plan, last_at + j, 0.0)
    at, to = at + _padded(each), to + each
    for j in range(0, each, LANES):  # the damping and the direct path change no state
        put_scaled(row, to + j, plan, last_at + j, gained)
    to += each
    for j in range(0, 1 + inputs, LANES):
        put_scaled(row, to + j, plan, j, 1.0)
    at, to = at + _padded(each) + _padded(1 + inputs), to + 1 + inputs
    for i in range(GATES):
        turn = plan[own_at + 4 + i]
        for j in range(0, GATE_WEIGHTS, LANES):
            carry(s, at + j, own, plan, gate_at + j, turn, row, to + j, before, after, plan, gate_at + j, 0.0)
        at, to = at + _padded(GATE_WEIGHTS), to + GATE_WEIGHTS


@inlined
def gated_row(p: Array, path: float, step: Array, plan: Array, s: Array, after: Array, wide: Array, row: Array) -> None:
    """Fill ``row`` with the derivative of the torque of a gated network; advance its sensitivities ``s``.

    ``plan`` is of `plan_rows`. ``after`` (feedbacks, row_room) and ``wide`` (row_room) are for intermediate results.
    """
    units, feedbacks, inputs = units_room(p), whole(p[FEEDBACKS]), whole(p[INPUTS])
    width, second, each = whole(p[WIDTH]), whole(p[SECOND]), output_weights(p)
    count = 1 + inputs + feedbacks
    layers = _padded(width) * count + _padded(second) * (1 + width)
    each_wide, gate_wide = _padded(each), _padded(GATE_WEIGHTS)
    damped = layers + feedbacks * each_wide
    direct = damped + each_wide
    gates = direct + _padded(1 + inputs)
    used = gates + feedbacks * GATES * gate_wide
    stride = used + LANES
    if path > 0.0:
        last = part(plan, _padded(1 + inputs + feedbacks))
        gate = part(last, each_wide)
        slopes = part(gate, gate_wide)
        slopes_room = _slopes_room(p)
        numbers = part(slopes, (1 + feedbacks) * (slopes_room + feedbacks))
        over = part(slopes, slopes_room)
        for w in range(0, used, LANES):
            put_products(wide, w, s, w, stride, over, feedbacks)
        _add_layers(p, plan, step, slopes, wide)
        for j in range(0, each_wide, LANES):
            add_scaled(wide, damped + j, last, j, numbers[0])
        for i in range(feedbacks):
            # a single one changes in place
            after_i, new = part(s if feedbacks == 1 else after, i * stride), numbers[2 + 3 * i]
            slopes = part(over, feedbacks)
            over = part(slopes, slopes_room)
            for w in range(0, used, LANES):
                put_products(after_i, w, s, w, stride, over, feedbacks)
            _add_layers(p, plan, step, slopes, after_i)
            for j in range(0, each_wide, LANES):
                add_scaled(after_i, layers + i * each_wide + j, last, j, new)
            for n in range(GATES):
                for j in range(0, gate_wide, LANES):
                    add_scaled(after_i, gates + (i * GATES + n) * gate_wide + j, gate, j, numbers[3 + 3 * i + n])
            if i < summed(p):
                for w in range(0, used, LANES):
                    add_scaled(wide, w, after_i, w, numbers[1])
        if feedbacks > 1:
            _put_group(after, 0, s, 0, feedbacks * stride)
    else:  # at rest the state stands still, and so does its derivative
        _put_group(s, 0, wide, 0, used)
        for i in range(1, summed(p)):
            for w in range(0, used, LANES):
                add_scaled(wide, w, s, i * stride + w, 1.0)
    for j in range(0, _padded(1 + inputs), LANES):
        add_scaled(wide, direct + j, plan, j, 1.0)
    for i in range(count):
        _put_group(wide, i * _padded(width), row, i * width, width)
    to = count * width
    for i in range(1 + width if second > 0 else 0):
        _put_group(wide, count * _padded(width) + i * _padded(second), row, to, second)
        to += second
    for i in range(1 + feedbacks):
        _put_group(wide, layers + i * each_wide, row, to, each)
        to += each
    _put_group(wide, direct, row, to, 1 + inputs)
    to += 1 + inputs
    for i in range(feedbacks * GATES):
        _put_group(wide, gates + i * gate_wide, row, to, GATE_WEIGHTS)
        to += GATE_WEIGHTS
    if abs(step[units + 1 + 6 * feedbacks]) >= p[BOUND]:
        for w in range(to):
            row[w] = 0.0
