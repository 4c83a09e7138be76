"""The forward step of a friction network. The daemon, replay and training call it.

A network is one flat array ``p``: a header with the indices named below, followed by the weights in this order::

    first layer: bias (width), weights of the inputs (inputs x width), weights of the feedback (feedbacks x width)
    second layer, if there is one: bias (second), weights (width x second)
    for every output: bias, weights of the last layer, weights of the linear path
    gated only: bias and weights (inputs) of the direct path; then for the rate and the knee of each state a bias and
    the weights of the gate features (`GATE_FEATURES`)

The state is another flat array, ``s``: the feedback (gated: the states y; narx: past torques, scaled, latest first),
then the velocity features of past samples (narx) or the `MEMORIES` of the motion (gated), then working memory whose
content is not used by the next step.

With the inputs x, the feedback y, and the outputs T(x, y) and B(x, y) of one or two tanh layers with a parallel linear
path, the torque over `TORQUE_SCALE` is

====== =====================================================================================================
static T(x)
narx   T(x, y), y the past torques
gated  c + l . x + sum of y+ + B(x, y) times sum of (y+ - y) TRAINED_DT / dt. Of several states, the sums omit the
       last one, which acts on the others through T. y and T have one component per state. y+ is the exact solution
       of dy/dt = kappa abs(v) limited(T - y, +-w) over the step for constant T(x, y) and v, with
       ln kappa = RATE_MIDDLE + RATE_HALF tanh(r + q . g), ln (w / BOUND) = KNEE_MIDDLE + KNEE_HALF tanh(s + t . g).
       The gate features g are the squares of the four velocity features, the stop in the direction of motion, and
       the distance since the start of motion or the last reversal
====== =====================================================================================================

limited to +-`BOUND`, as is every T.

A gated network has the form of Dahl's and LuGre's equations with a learned right-hand side: its state does not change
at rest, it does not depend on the sampling period, and y+ is a weighted mean of y and a bounded T. If the distance to
T exceeds the knee w, a state acts as a spring of constant stiffness kappa w, as Maxwell-slip elements and the bristles
of the elasto-plastic model do below break-away; within w it yields, as Dahl's and LuGre's states do from the start.
T and B are constant over a step, and training uses steps of `TRAINED_DT`. A longer sample is therefore divided into
steps of about that length, and its damping is the mean of theirs.

The stop, one of the inputs, is Prandtl's stop: a spring that slips at its `STROKE`. The gate features let a state lag
in time (kappa proportional to 1 / abs(v)) while the axis slides, and catch up while it sticks. Sliding Maxwell-slip
elements approach their level in this way; the last of several states is there to learn it. The gates do not depend on
the states, so that the state equation remains a contraction for rates and knees of any size.

B is the damping of the bristles; with l . x alone the error is five times as large. It multiplies the rate of the
states because the rate does not depend on the sampling period. For the same reason kappa, in LuGre's model the
stiffness over the level, is a function of the velocity.
"""

import math

from friction_hil.friction.elementary import approach, decay, part, toward, whole
from friction_hil.friction.lanes import LANES, add_products
from friction_hil.numerics.dual import fma
from friction_hil.numerics.jit import Array, compiled, inlined

STATIC, GATED, NARX = range(3)
MAX_HARMONICS = 8
VELOCITY_FEATURES = 4
SPARE = LANES - 1  # elements behind the units of the layers, for vectors that extend beyond them
GATE_FEATURES = VELOCITY_FEATURES + 2
MEMORIES = 2  # of a gated network: the stop, and the distance since the start of motion or the last reversal
TURN_FRACTION = 0.25  # of the stroke: limit of that distance; enough to distinguish a start from sliding
GATE_WEIGHTS = 1 + GATE_FEATURES
GATES = 2  # of every state: its rate and its knee
KNEE_MIDDLE, KNEE_HALF = 0.5 * math.log(0.01), 0.5 * math.log(400.0)  # of ln (w / BOUND): w is 0.005 to 2 bounds

STRUCTURE = 0
INPUTS = 1  # length of x
FEEDBACKS = 2  # states of a gated network, past torques of a narx
LAGS = 3  # past samples whose velocity features are inputs
WIDTH = 4  # tanh units of the first layer
SECOND = 5  # tanh units of the second layer, or 0
HARMONICS = 6
HAS_POSITION = 7
HAS_LOAD = 8
HAS_TEMPERATURE = 9
TRAINED_DT = 10  # s
TORQUE_SCALE = 11  # N m
BOUND = 12  # of T, of every state and of the torque, in units of TORQUE_SCALE
SPEED_LIMIT = 13  # highest speed of the training, rad/s; the velocity features are constant beyond it
SPEEDS = 14  # three characteristic speeds of the friction, rad/s
FEATURE_FACTORS = 17  # two factors, which scale the asinh features to 1 at the speed limit
MIDDLES = 19  # of position, load and temperature
HALF_RANGES = 22  # of position, load and temperature, above zero
RATE_MIDDLE, RATE_HALF = 25, 26  # of ln kappa, kappa in rad^-1: its bounds are exp(RATE_MIDDLE +- RATE_HALF)
ORDERS = 27  # of the harmonics, per rad
IS_RESIDUAL = ORDERS + MAX_HARMONICS  # added to a model: fades out beyond what the training visited, see `support`
STROKE = IS_RESIDUAL + 1  # gated only: stroke of the stop, rad
LEAST_SPEED = STROKE + 1  # of a residual: slowest speed of the training that the encoder resolves, rad/s; 0 if all
HEADER = LEAST_SPEED + 1
STATE_ROOM = 256  # length of the state of the largest structure
MOST_STEPS = 16  # into which a sample is divided; limits the computing time
_FARTHEST = 1e15  # rad; beyond it a float has no precision left for an angle
_FADED = 1.5  # speed, in speed limits, at which a residual has faded out; at 1 / 2 least speeds it has, too
_FADED_BESIDE = 0.25  # distance beyond the range of another input, in half ranges, at which a residual has faded out


@inlined
def tanh(x: float) -> float:
    """Compute the hyperbolic tangent to 3 units in the last place, without branches and without a C library."""
    complement = approach(2.0 * abs(x))  # 1 - e^(-2 abs(x))
    return math.copysign(complement / (2.0 - complement), x)


@inlined
def limited(x: float, bound: float) -> float:
    """Limit ``x`` to +-``bound``."""
    return min(max(x, -bound), bound)


_tanh, _limited = tanh, limited


@inlined
def velocity_features(p: Array, velocity: float, x: Array) -> None:
    """Fill the first four elements of ``x``: velocity on linear and on logarithmic scales."""
    v = _limited(velocity, p[SPEED_LIMIT])
    x[0] = v / p[SPEED_LIMIT]
    x[1] = p[FEATURE_FACTORS] * math.asinh(v / p[SPEEDS])
    x[2] = p[FEATURE_FACTORS + 1] * math.asinh(v / p[SPEEDS + 1])
    x[3] = _tanh(v / p[SPEEDS + 2])


@inlined
def stop(p: Array, before: float, distance: float) -> float:
    """Move Prandtl's stop by ``distance``; return its deflection over the stroke at which it slips, -1 to 1."""
    return _limited(before + distance / p[STROKE], 1.0)


@inlined
def since_turn(p: Array, before: float, distance: float) -> float:
    """Compute the signed distance since the start of motion or the last reversal, over `TURN_FRACTION` of the stroke.

    It is limited to +-1, and 0 at rest. Maxwell-slip elements that have come to rest stick at first, whichever
    direction they move in next.
    """
    if distance == 0.0:
        return 0.0
    same = before if before * distance > 0.0 else 0.0
    return _limited(same + distance / (TURN_FRACTION * p[STROKE]), 1.0)


@inlined
def gate_features(x: Array, since_turn: float, features: Array) -> None:
    """Fill ``features`` (`GATE_FEATURES`,) with the inputs of the gates, which are even in the direction of motion."""
    for i in range(VELOCITY_FEATURES):
        features[i] = x[i] * x[i]
    features[VELOCITY_FEATURES] = x[VELOCITY_FEATURES] * x[VELOCITY_FEATURES - 1]
    features[VELOCITY_FEATURES + 1] = abs(since_turn)


@inlined
def summed(p: Array) -> int:
    """Return the number of states of a gated network that add to the torque: of several, all but the last."""
    return max(whole(p[FEEDBACKS]) - 1, 1)


@inlined
def other_features(p: Array, position: float, load_torque: float, temperature: float, x: Array) -> None:
    """Fill ``x`` with the other inputs of the network; a temperature of NaN is the middle of its range."""
    index = 0
    if p[HAS_POSITION] != 0.0:
        x[index] = _limited((position - p[MIDDLES]) / p[HALF_RANGES], 1.0)
        index += 1
    if p[HAS_LOAD] != 0.0:
        x[index] = _limited((load_torque - p[MIDDLES + 1]) / p[HALF_RANGES + 1], 1.0)
        index += 1
    if p[HAS_TEMPERATURE] != 0.0:
        relative = _limited((temperature - p[MIDDLES + 2]) / p[HALF_RANGES + 2], 1.0)
        x[index] = 0.0 if math.isnan(temperature) else relative
        index += 1
    for k in range(whole(p[HARMONICS])):
        angle = _limited(p[ORDERS + k] * position, _FARTHEST)  # the cosine of infinity would be NaN
        x[index] = math.cos(angle)
        x[index + 1] = math.sin(angle)
        index += 2


@inlined
def add_product(weights: Array, inputs: Array, count: int, sums: Array, width: int) -> None:
    """Add to ``sums`` (width,) the product of ``weights`` (count, width) with ``inputs`` (count,).

    The `SPARE` elements behind the sums are overwritten, and as many behind the weights are read.
    """
    for j in range(0, width, LANES):
        add_products(sums, j, weights, j, width, inputs, count)


@inlined
def squash(sums: Array, width: int) -> None:
    """Replace ``sums``, and up to `SPARE` elements behind them, by their hyperbolic tangents."""
    for j in range((width + SPARE) // LANES * LANES):
        sums[j] = _tanh(sums[j])


_add_product, _squash = add_product, squash


@inlined
def layers(p: Array, x: Array, fed_back: Array, h: Array) -> int:
    """Fill ``h`` with the outputs of the hidden layers; return the index of the first weight of the outputs."""
    width, second, inputs = whole(p[WIDTH]), whole(p[SECOND]), whole(p[INPUTS])
    feedbacks = whole(p[FEEDBACKS])
    for j in range(width):
        h[j] = p[HEADER + j]
    begin = HEADER + width
    _add_product(part(p, begin), x, inputs, h, width)
    begin += inputs * width
    _add_product(part(p, begin), fed_back, feedbacks, h, width)
    begin += feedbacks * width
    _squash(h, width)
    if second > 0:
        above = part(h, width)
        for j in range(second):
            above[j] = p[begin + j]
        begin += second
        _add_product(part(p, begin), h, width, above, second)
        begin += width * second
        _squash(above, second)
    return begin


@inlined
def output(p: Array, begin: int, x: Array, fed_back: Array, h: Array) -> float:
    """Compute the output T whose weights begin at ``begin``, before it is limited."""
    width, second, inputs = whole(p[WIDTH]), whole(p[SECOND]), whole(p[INPUTS])
    last = part(h, width if second > 0 else 0)
    count = second if second > 0 else width
    linear = begin + 1 + count
    even, odd = p[begin], 0.0  # two sums, because each addition has to wait for the previous one
    for i in range(inputs):
        even = fma(p[linear + i], x[i], even)
    if p[STRUCTURE] == NARX:
        for i in range(whole(p[FEEDBACKS])):
            odd = fma(p[linear + inputs + i], fed_back[i], odd)
    for j in range(0, count - 1, 2):
        even = fma(p[begin + 1 + j], last[j], even)
        odd = fma(p[begin + 2 + j], last[j + 1], odd)
    if count % 2 == 1:
        even = fma(p[begin + count], last[count - 1], even)
    return even + odd


@inlined
def output_weights(p: Array) -> int:
    """Return the number of weights of each output."""
    width, second = whole(p[WIDTH]), whole(p[SECOND])
    return (
        1 + (second if second > 0 else width) + whole(p[INPUTS]) + (whole(p[FEEDBACKS]) if p[STRUCTURE] == NARX else 0)
    )


_layers, _output, _output_weights = layers, output, output_weights


@inlined
def rate_bend(p: Array, begin: int, features: Array) -> float:
    """Compute the position of a gate between its bounds, -1 to 1; its weights begin at ``begin``."""
    total = p[begin]
    for i in range(GATE_FEATURES):
        total = fma(p[begin + 1 + i], features[i], total)
    return _tanh(total)


@inlined
def rate(p: Array, bend: float) -> float:
    """Compute the rate kappa of a gate, rad^-1."""
    return decay(-fma(p[RATE_HALF], bend, p[RATE_MIDDLE]))


@inlined
def per_knee(p: Array, bend: float) -> float:
    """Compute 1 / w of a knee."""
    return decay(fma(KNEE_HALF, bend, KNEE_MIDDLE)) / p[BOUND]


@inlined
def travelled(distance: float, path: float, per_knee: float) -> tuple[float, float, float, float]:
    """Compute how far a state moves towards its target T in one step.

    ``distance``, ``path`` and ``per_knee`` are T - y, kappa abs(v) dt and 1 / w. Returns the fraction of the distance
    that is covered; 1 minus the derivative of the remaining distance over the distance; the distance in knees; and the
    part of that beyond the first knee.
    """
    knees = abs(distance) * per_knee
    beyond = max(knees - 1.0, 0.0)
    straight = min(beyond, path)
    begun = straight / max(knees, 1.0)
    soft = approach(path - straight)
    return fma(1.0 - begun, soft, begun), soft, knees, beyond


_rate_bend, _rate, _per_knee, _travelled, _summed = rate_bend, rate, per_knee, travelled, summed


@inlined
def outputs(p: Array, x: Array, fed_back: Array, aims: Array, h: Array) -> tuple[float, int]:
    """Fill ``aims`` and ``h`` of a gated network as `advance` does.

    Returns the output of the direct path, and the index of the first weight of the gates.
    """
    begin = _layers(p, x, fed_back, h)
    feedbacks, stride = whole(p[FEEDBACKS]), _output_weights(p)
    for i in range(feedbacks):
        aims[i] = _limited(_output(p, begin + i * stride, x, fed_back, h), p[BOUND])
    begin += feedbacks * stride
    aims[feedbacks] = _output(p, begin, x, fed_back, h)
    begin += stride
    inputs = whole(p[INPUTS])
    total = p[begin]
    for i in range(inputs):
        total = fma(p[begin + 1 + i], x[i], total)
    return total, begin + 1 + inputs


_outputs = outputs


@inlined
def advance(
    p: Array,  # network
    x: Array,  # (inputs,), of the layers
    features: Array,  # (`GATE_FEATURES`,), inputs of the gates; a network without gates ignores them
    path: float,  # abs(v) dt of the step, rad
    tempo: float,  # TRAINED_DT / dt of the sample
    damped: float,  # damping of the earlier steps of the same sample
    fed_back: Array,  # (feedbacks,), feedback before the step
    after: Array,  # (feedbacks,), feedback after the step; may be the same array
    aims: Array,  # (1 + feedbacks,), filled with the limited T of every output, and B
    h: Array,  # (width + second + SPARE,), filled with the outputs of the layers
) -> tuple[float, float]:
    """Advance the feedback by one step; return the torque over its scale, and the damping it contains."""
    feedbacks, bound = whole(p[FEEDBACKS]), p[BOUND]
    if p[STRUCTURE] != GATED:
        total = _limited(_output(p, _layers(p, x, fed_back, h), x, fed_back, h), bound)
        aims[0] = total
        if feedbacks > 0:
            for i in range(feedbacks - 1, 0, -1):
                after[i] = fed_back[i - 1]
            after[0] = total
        return total, 0.0
    total, begin = _outputs(p, x, fed_back, aims, h)
    damping = aims[feedbacks]
    for i in range(feedbacks):
        before, gate = fed_back[i], begin + i * GATES * GATE_WEIGHTS
        scaled_path = _rate(p, _rate_bend(p, gate, features)) * path
        knee = _per_knee(p, _rate_bend(p, gate + GATE_WEIGHTS, features))
        fraction, _, _, _ = _travelled(aims[i] - before, scaled_path, knee)
        after[i] = toward(before, aims[i], fraction)
        if i < _summed(p):
            total += after[i]
            damped += damping * ((after[i] - before) * tempo)
    return _limited(total + damped, bound), damped


_velocity_features, _other_features, _advance, _stop = velocity_features, other_features, advance, stop
_since_turn, _gate_features = since_turn, gate_features


@inlined
def steps_of(p: Array, dt: float) -> int:
    """Return the number of equal steps of a sample, each about as long as in training; 1 if not gated."""
    return whole(min(max(dt / p[TRAINED_DT] + 0.5, 1.0), MOST_STEPS)) if p[STRUCTURE] == GATED else 1


@inlined
def inside(p: Array, index: int, value: float) -> float:
    """Compute 1 where input ``index`` is within its range, falling linearly to 0 at `_FADED_BESIDE` beyond it."""
    beyond = abs((value - p[MIDDLES + index]) / p[HALF_RANGES + index]) - 1.0
    return min(max(1.0 - beyond / _FADED_BESIDE, 0.0), 1.0)


_inside = inside


@inlined
def support(p: Array, speed: float, position: float, load_torque: float, temperature: float) -> float:
    """Compute the factor of a residual: 1 where the training had data, 0 where it had none.

    It falls linearly from 1 to 0 between the speed limit and `_FADED` times it, below the least speed down to half of
    it, and beyond the range of each other input. There the model beside the network remains.
    """
    factor = min(max((_FADED - speed / p[SPEED_LIMIT]) / (_FADED - 1.0), 0.0), 1.0)
    if p[LEAST_SPEED] > 0.0:
        factor *= min(max(2.0 * speed / p[LEAST_SPEED] - 1.0, 0.0), 1.0)
    if p[HAS_POSITION] != 0.0:
        factor *= _inside(p, 0, position)
    if p[HAS_LOAD] != 0.0:
        factor *= _inside(p, 1, load_torque)
    if p[HAS_TEMPERATURE] != 0.0 and not math.isnan(temperature):
        factor *= _inside(p, 2, temperature)
    return factor


@inlined
def seen_velocity(p: Array, velocity: float, level_velocity: float) -> float:
    """Return the velocity for the inputs: the speed of ``level_velocity`` in the direction of ``velocity``.

    If the two have opposite signs, the speed is at most the slowest of the characteristic speeds.
    """
    speed = math.copysign(1.0, velocity) * level_velocity
    return math.copysign(max(speed, min(abs(velocity), p[SPEEDS + 2])), velocity)


_support, _seen_velocity, _steps_of = support, seen_velocity, steps_of


@compiled  # inlined into every family it would take minutes to compile
def step(
    p: Array,  # network
    s: Array,  # state, changed in place
    velocity: float,  # drives the state and sets the direction, rad/s
    level_velocity: float,  # sets the speed, rad/s
    dt: float,  # s
    position: float,  # rad
    load_torque: float,  # N m
    temperature: float,  # deg C
) -> float:
    """Advance the state over one sample with ``velocity`` held, and return the friction torque, N m.

    The velocities are equal except in a compensator; see `friction_hil.friction.kernel`. Values that are not inputs of
    the network are ignored. A narx ignores ``dt``.
    """
    steps = _steps_of(p, dt)
    distance = velocity * dt / steps
    velocity = _seen_velocity(p, velocity, level_velocity)
    feedbacks, lags, inputs = whole(p[FEEDBACKS]), whole(p[LAGS]), whole(p[INPUTS])
    is_gated = p[STRUCTURE] == GATED
    past = part(s, feedbacks)
    x = part(past, MEMORIES if is_gated else VELOCITY_FEATURES * lags)
    features = part(x, inputs)
    aims = part(features, GATE_FEATURES)
    h = part(aims, 1 + feedbacks)
    _velocity_features(p, velocity, x)
    remembered = VELOCITY_FEATURES * lags
    for i in range(remembered):
        x[VELOCITY_FEATURES + i] = past[i]
    if is_gated:
        remembered = 1  # of the inputs
    _other_features(p, position, load_torque, temperature, part(x, VELOCITY_FEATURES + remembered))
    path, tempo, torque, damped = abs(distance), p[TRAINED_DT] / dt, 0.0, 0.0
    for _ in range(steps):
        if is_gated:
            past[0] = x[VELOCITY_FEATURES] = _stop(p, past[0], distance)
            past[1] = _since_turn(p, past[1], distance)
            _gate_features(x, past[1], features)
        torque, damped = _advance(p, x, features, path, tempo, damped, s, s, aims, h)
    torque *= p[TORQUE_SCALE]
    if not is_gated:
        for i in range(remembered - 1, -1, -1):
            past[i] = x[i]
    if p[IS_RESIDUAL] != 0.0:
        torque *= _support(p, abs(velocity), position, load_torque, temperature)
    return torque
