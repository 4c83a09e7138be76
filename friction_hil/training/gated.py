"""Derivative of the torque of a gated network over its weights, from the trace of a run and the states' sensitivities.

Everything that does not depend on the sensitivities is computed for a block of samples first (`plan_rows`). Every
sample then takes one pass over the sensitivities (`gated_row`).
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
from friction_hil.numerics.jit import Array, compiled, inlined, inner


@inlined
def units_length(p: Array) -> int:
    """Return the length that the layers take in a row of the trace."""
    return whole(p[WIDTH]) + whole(p[SECOND]) + SPARE


@inlined
def layer_slopes(p: Array, h: Array, begin: int, factor: float, slopes: Array) -> None:
    """Fill ``slopes`` with ``factor`` times the slopes of an output over the input sums of all units.

    The first layer (width) comes first, the second follows at ``width + SPARE``; the `SPARE` elements behind each are
    undefined. ``begin`` is the index of the output's first weight for the last layer.
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
    """Fill ``over_fed_back`` (feedbacks) with the slopes of an output over the values fed back to the first layer."""
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


@inlined
def _layers_length(p: Array) -> int:
    """Return the length that the padded weights of the layers take in a row of sensitivities."""
    width, second = whole(p[WIDTH]), whole(p[SECOND])
    return _padded(width) * (1 + whole(p[INPUTS]) + whole(p[FEEDBACKS])) + _padded(second) * (1 + width)


@compiled
def row_length(p: Array) -> int:
    """Return the length of the sensitivities of one fed-back value in `fill_rows`.

    For a gated network every group of weights begins at a multiple of `LANES`: a vector that is read shortly after it
    was written, but shifted, makes the processor wait until the data are in the cache.
    """
    if p[STRUCTURE] != GATED:
        return p.shape[0] - HEADER + SPARE
    inputs, feedbacks = whole(p[INPUTS]), whole(p[FEEDBACKS])
    outputs = (1 + feedbacks) * _padded(output_weights(p))
    return _layers_length(p) + outputs + _padded(1 + inputs) + feedbacks * GATES * _padded(GATE_WEIGHTS) + LANES


@inlined
def _slopes_length(p: Array) -> int:
    return _padded(whole(p[WIDTH]) + SPARE + whole(p[SECOND]) + SPARE)


@inlined
def plan_width(p: Array) -> int:
    """Return the length of a row of `plan_rows`."""
    feedbacks, inputs = whole(p[FEEDBACKS]), whole(p[INPUTS])
    vectors = _padded(1 + inputs + feedbacks) + _padded(output_weights(p)) + _padded(GATE_WEIGHTS)
    return vectors + (1 + feedbacks) * (_slopes_length(p) + feedbacks) + 2 + 3 * feedbacks


@inner
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
    """Fill ``flat_plan`` (end - begin, `plan_width`) with all terms of `gated_row` that need no sensitivities.

    A row holds: 1, inputs and fed-back values; 1, last layer and inputs; 1 and the inputs of the gates; for the damping
    and for every state the slopes of `layer_slopes` and those over the fed-back values; the slope of the torque over
    the damping and over the states after the step; for every state its slopes over its target and over the sums in its
    gates. The plan is written long before it is read, for the reason given in `row_length`.
    """
    units, feedbacks, inputs = units_length(p), whole(p[FEEDBACKS]), whole(p[INPUTS])
    width, second = whole(p[WIDTH]), whole(p[SECOND])
    count, each = second if second > 0 else width, output_weights(p)
    outputs = HEADER + width * (1 + inputs + feedbacks) + (second * (1 + width) if second > 0 else 0)
    stride, slopes_length = plan_width(p), _slopes_length(p)
    to_last = _padded(1 + inputs + feedbacks)
    to_gate = to_last + _padded(each)
    to_slopes = to_gate + _padded(GATE_WEIGHTS)
    to_numbers = to_slopes + (1 + feedbacks) * (slopes_length + feedbacks)
    flat_x, flat_trace = x.reshape(-1), trace.reshape(-1)
    for k in range(begin, end):
        plan = part(flat_plan, (k - begin) * stride)
        step, x_k = part(flat_trace, k * trace.shape[1]), part(flat_x, k * inputs)
        last, gate, numbers = part(plan, to_last), part(plan, to_gate), part(plan, to_numbers)
        targets, fed_back = part(step, units), part(step, units + 1 + feedbacks)
        fractions, soft, turns = part(fed_back, feedbacks), part(fed_back, 2 * feedbacks), part(fed_back, 3 * feedbacks)
        plan[0] = last[0] = gate[0] = 1.0
        for i in range(inputs):
            plan[1 + i] = last[1 + count + i] = x_k[i]
        for i in range(GATE_FEATURES):
            gate[1 + i] = seen[i, k]
        for j in range(count):
            last[1 + j] = step[units - SPARE - count + j]
        damping, gained = targets[feedbacks], 0.0
        for i in range(feedbacks):
            plan[1 + inputs + i] = fed_back[i]
            if i < summed(p):
                gained += fractions[i] * (targets[i] - fed_back[i])
        numbers[0], numbers[1] = gained, 1.0 + damping
        slopes = part(plan, to_slopes)
        layer_slopes(p, step, outputs + feedbacks * each + 1, gained, slopes)
        over = part(slopes, slopes_length)
        put_over_fed_back(p, slopes, over)
        for i in range(summed(p)):
            over[i] -= damping
        for i in range(feedbacks):
            new = soft[i] if abs(targets[i]) < p[BOUND] else 0.0
            slopes = part(over, feedbacks)
            over = part(slopes, slopes_length)
            layer_slopes(p, step, outputs + i * each + 1, new, slopes)
            put_over_fed_back(p, slopes, over)
            over[i] += 1.0 - soft[i]
            numbers[2 + 3 * i], numbers[3 + 3 * i], numbers[4 + 3 * i] = new, turns[i], turns[feedbacks + i]


@inlined
def _add_layers(p: Array, ones: Array, h: Array, slopes: Array, row: Array) -> None:
    """Add to ``row`` the derivative over the weights of the layers: ``slopes`` times the inputs of every unit.

    ``slopes`` are those of `layer_slopes`; ``ones`` are 1, the inputs and the fed-back values.
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
    """Do the same as `gated_row` in one pass, for a network of one state while the axis moves."""
    inputs, width, second, each = whole(p[INPUTS]), whole(p[WIDTH]), whole(p[SECOND]), output_weights(p)
    first, above = width * (2 + inputs), second * (1 + width)
    last_at = _padded(2 + inputs)
    gate_at = last_at + _padded(each)
    slopes_at = gate_at + _padded(GATE_WEIGHTS)
    over_at = slopes_at + _slopes_length(p)
    state_at = over_at + 1
    own_at = state_at + _slopes_length(p)
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
    for j in range(0, each, LANES):  # damping and direct path do not change the state
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
def _advance_sensitivities(p: Array, step: Array, plan: Array, s: Array, after: Array, wide: Array, used: int) -> None:
    """Advance the sensitivities ``s`` of a moving network; fill ``wide`` (used) with the derivative of its torque.

    ``after`` (feedbacks, row_length) is for intermediate results. The direct path is left out.
    """
    feedbacks, inputs, each_wide = whole(p[FEEDBACKS]), whole(p[INPUTS]), _padded(output_weights(p))
    gate_wide, stride = _padded(GATE_WEIGHTS), used + LANES
    layers = _layers_length(p)
    damped = layers + feedbacks * each_wide
    gates = damped + each_wide + _padded(1 + inputs)
    last = part(plan, _padded(1 + inputs + feedbacks))
    gate = part(last, each_wide)
    slopes = part(gate, gate_wide)
    slopes_length = _slopes_length(p)
    numbers = part(slopes, (1 + feedbacks) * (slopes_length + feedbacks))
    over = part(slopes, slopes_length)
    for w in range(0, used, LANES):
        put_products(wide, w, s, w, stride, over, feedbacks)
    _add_layers(p, plan, step, slopes, wide)
    for j in range(0, each_wide, LANES):
        add_scaled(wide, damped + j, last, j, numbers[0])
    for i in range(feedbacks):
        # a single state changes in place
        after_i, new = part(s if feedbacks == 1 else after, i * stride), numbers[2 + 3 * i]
        slopes = part(over, feedbacks)
        over = part(slopes, slopes_length)
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


@inlined
def _put_rest(p: Array, s: Array, wide: Array, used: int) -> None:
    """Fill ``wide`` (used) with the derivative at rest, where the states and their sensitivities stay."""
    _put_group(s, 0, wide, 0, used)
    for i in range(1, summed(p)):
        for w in range(0, used, LANES):
            add_scaled(wide, w, s, i * (used + LANES) + w, 1.0)


@inlined
def _put_packed(p: Array, wide: Array, row: Array) -> int:
    """Copy the groups of weights from ``wide``, where they are padded, to ``row``; return the number of weights."""
    feedbacks, inputs = whole(p[FEEDBACKS]), whole(p[INPUTS])
    width, second, each = whole(p[WIDTH]), whole(p[SECOND]), output_weights(p)
    count, each_wide, gate_wide = 1 + inputs + feedbacks, _padded(each), _padded(GATE_WEIGHTS)
    layers = _layers_length(p)
    direct = layers + (1 + feedbacks) * each_wide
    gates = direct + _padded(1 + inputs)
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
    return to


@inlined
def gated_row(p: Array, path: float, step: Array, plan: Array, s: Array, after: Array, wide: Array, row: Array) -> None:
    """Fill ``row`` with the derivative of the torque of a gated network; advance its sensitivities ``s``.

    ``plan`` is a row of `plan_rows`. ``after`` (feedbacks, row_length) and ``wide`` (row_length) are for intermediate
    results.
    """
    units, feedbacks, inputs = units_length(p), whole(p[FEEDBACKS]), whole(p[INPUTS])
    direct = _layers_length(p) + (1 + feedbacks) * _padded(output_weights(p))
    used = direct + _padded(1 + inputs) + feedbacks * GATES * _padded(GATE_WEIGHTS)
    if path > 0.0:
        _advance_sensitivities(p, step, plan, s, after, wide, used)
    else:
        _put_rest(p, s, wide, used)
    for j in range(0, _padded(1 + inputs), LANES):
        add_scaled(wide, direct + j, plan, j, 1.0)
    weights = _put_packed(p, wide, row)
    if abs(step[units + 1 + 6 * feedbacks]) >= p[BOUND]:
        for w in range(weights):
            row[w] = 0.0
