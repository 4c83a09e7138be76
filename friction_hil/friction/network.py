"""The forward step of a friction network: loop, replay and training call it.

A network is one flat array ``p``: the places named below, then its weights, in this order::

    bias of the first layer (width), its weights of the inputs (inputs x width) and of what is fed back
    (feedbacks x width)
    bias of the second layer (second) and its weights (width x second), where there is one
    for every output: bias, weights of the last layer, linear path
    gated only: bias and weights (inputs) of the direct path, then for the rate and the knee of each state a bias and
    weights of what its gates see (`GATE_FEATURES`)

Its state is another, ``s``: what is fed back (gated: the states y; narx: past torques, scaled, latest first), the
velocity features of past samples (narx) or the `MEMORIES` of the motion (gated), and room for intermediate results,
which means nothing between steps.

With x the inputs, y what is fed back and T(x, y), B(x, y) outputs of one or two tanh layers with a linear path beside
them, the torque over `TORQUE_SCALE` is

====== =====================================================================================================
static T(x)
narx   T(x, y), y the past torques
gated  c + l . x + sum of y+ + B(x, y) times sum of (y+ - y) TRAINED_DT / dt, the sums without the last of several
       states, which the others see through T. y+ is the exact solution of
       dy/dt = kappa abs(v) limited(T - y, +-w) over the step, T(x, y) and v held, for every state; y and T have as
       many components as there are states; ln kappa = RATE_MIDDLE + RATE_HALF tanh(r + q . g); ln (w / BOUND) =
       KNEE_MIDDLE + KNEE_HALF tanh(s + t . g); g are squares of the four velocity features, the stop in the
       direction of motion, and the way since motion began or turned
====== =====================================================================================================

cut off at `BOUND`, as is every T. A gated network is Dahl's and LuGre's form with the right-hand side learned: its
state stands still at rest, does not depend on the sampling period, and y+ is a weighted mean of y and a bounded T.
Farther from T than w a state is a spring of constant stiffness kappa w, as a Maxwell-slip element and the bristles of
the elasto-plastic model are below their break-away; within w it yields, as Dahl's and LuGre's do from the start.
T and B are held over a step, which the training only knows as long as `TRAINED_DT`: a longer sample is divided into
steps of about that length, and its damping is the mean of theirs.
The stop, one of the inputs, is Prandtl's: a spring that slips at its `STROKE`. What the gates see lets a state lag in
time (kappa like 1 / abs(v)) while the axis slides, and catch up while it sticks. That is how sliding Maxwell-slip
elements come to their level, which the last of several states is for. No gate sees a state: rates and knees of any
size then leave a contraction what it is.
B is the damping of the bristles: with l . x alone the error is five times as large. It multiplies the state's rate,
rather than standing beside the states, because that is what does not depend on the sampling period; and kappa, the
stiffness over the level in LuGre's model, changes with the velocity for the same reason.
"""

import math

from friction_hil.friction.elementary import approach, decay, part, toward, whole
from friction_hil.friction.lanes import LANES, add_products
from friction_hil.numerics.dual import fma
from friction_hil.numerics.jit import Array, compiled, inlined

STATIC, GATED, NARX = range(3)
MAX_HARMONICS = 8
VELOCITY_FEATURES = 4
SPARE = LANES - 1  # places behind the units of the layers, for vectors that reach beyond them
GATE_FEATURES = VELOCITY_FEATURES + 2
MEMORIES = 2  # of a gated network: the stop, and the way since motion began or turned
TURN_SHARE = 0.25  # of the stroke: as much of that way is seen; enough to tell a start from sliding
GATE_WEIGHTS = 1 + GATE_FEATURES
GATES = 2  # of every state: its rate and its knee
KNEE_MIDDLE, KNEE_HALF = 0.5 * math.log(0.01), 0.5 * math.log(400.0)  # knees: 0.005 to 2 bounds, never exceeded then

STRUCTURE = 0
INPUTS = 1  # how many numbers x has
FEEDBACKS = 2  # states of a gated network, past torques of a narx
LAGS = 3  # past samples whose velocity features are inputs
WIDTH = 4  # tanh units of the first layer
SECOND = 5  # and of the second, or 0
HARMONICS = 6
HAS_POSITION = 7
HAS_LOAD = 8
HAS_TEMPERATURE = 9
TRAINED_DT = 10  # s
TORQUE_SCALE = 11  # N m
BOUND = 12  # of T, of every state and of the torque, in units of TORQUE_SCALE
SPEED_LIMIT = 13  # top speed of the training, rad/s; features stay there beyond it
SPEEDS = 14  # three speeds at which friction changes, rad/s
FEATURE_FACTORS = 17  # two, which make the asinh features 1 at the speed limit
MIDDLES = 19  # of position, load and temperature
HALF_RANGES = 22  # of the same, above zero
RATE_MIDDLE, RATE_HALF = 25, 26  # of ln kappa, kappa in rad^-1: its bounds are exp(RATE_MIDDLE +- RATE_HALF)
ORDERS = 27  # of the harmonics, per rad
IS_RESIDUAL = ORDERS + MAX_HARMONICS  # beside a model: fades out beyond the speed limit
STROKE = IS_RESIDUAL + 1  # gated only: of the stop, rad
HEADER = STROKE + 1
STATE_ROOM = 256  # for the largest structure
MOST_STEPS = 16  # into which a sample is divided; a bound on the time it takes
_FARTHEST = 1e15  # rad: beyond, a float has no angle
_FADED = 1.5  # speed limits at which a residual has faded out


@inlined
def tanh(x: float) -> float:
    """Hyperbolic tangent, to 3 units in the last place, without branches and without a C library."""
    gone = approach(2.0 * abs(x))  # 1 - e^(-2 abs(x))
    return math.copysign(gone / (2.0 - gone), x)


@inlined
def limited(x: float, bound: float) -> float:
    """``x``, or the nearer one of +-``bound``."""
    return min(max(x, -bound), bound)


_tanh, _limited = tanh, limited


@inlined
def velocity_features(p: Array, velocity: float, x: Array) -> None:
    """Fill the first four of ``x``: friction lives on a logarithmic scale of velocity."""
    v = _limited(velocity, p[SPEED_LIMIT])
    x[0] = v / p[SPEED_LIMIT]
    x[1] = p[FEATURE_FACTORS] * math.asinh(v / p[SPEEDS])
    x[2] = p[FEATURE_FACTORS + 1] * math.asinh(v / p[SPEEDS + 1])
    x[3] = _tanh(v / p[SPEEDS + 2])


@inlined
def stop(p: Array, before: float, distance: float) -> float:
    """Prandtl's stop after it was moved: deflection over the stroke at which it slips, -1 to 1."""
    return _limited(before + distance / p[STROKE], 1.0)


@inlined
def since_turn(p: Array, before: float, distance: float) -> float:
    """Way since the motion began or turned, signed, -1 to 1 from `TURN_SHARE` of the stroke on; 0 at rest.

    Elements of the Maxwell-slip model that have come to rest stick, in whichever direction they then move.
    """
    if distance == 0.0:
        return 0.0
    same = before if before * distance > 0.0 else 0.0
    return _limited(same + distance / (TURN_SHARE * p[STROKE]), 1.0)


@inlined
def gate_features(x: Array, since_turn: float, features: Array) -> None:
    """Fill ``features`` (`GATE_FEATURES`,) with what the gates see: the same in both directions of motion."""
    for i in range(VELOCITY_FEATURES):
        features[i] = x[i] * x[i]
    features[VELOCITY_FEATURES] = x[VELOCITY_FEATURES] * x[VELOCITY_FEATURES - 1]
    features[VELOCITY_FEATURES + 1] = abs(since_turn)


@inlined
def summed(p: Array) -> int:
    """How many states of a gated network add to the torque: of several all but the last."""
    return max(whole(p[FEEDBACKS]) - 1, 1)


@inlined
def other_features(p: Array, position: float, load_torque: float, temperature: float, x: Array) -> None:
    """Fill ``x`` with those of the other inputs that the network has; a temperature of NaN is the middle one."""
    place = 0
    if p[HAS_POSITION] != 0.0:
        x[place] = _limited((position - p[MIDDLES]) / p[HALF_RANGES], 1.0)
        place += 1
    if p[HAS_LOAD] != 0.0:
        x[place] = _limited((load_torque - p[MIDDLES + 1]) / p[HALF_RANGES + 1], 1.0)
        place += 1
    if p[HAS_TEMPERATURE] != 0.0:
        relative = _limited((temperature - p[MIDDLES + 2]) / p[HALF_RANGES + 2], 1.0)
        x[place] = 0.0 if math.isnan(temperature) else relative
        place += 1
    for k in range(whole(p[HARMONICS])):
        angle = _limited(p[ORDERS + k] * position, _FARTHEST)  # the cosine of infinity is no number
        x[place] = math.cos(angle)
        x[place + 1] = math.sin(angle)
        place += 2


@inlined
def add_product(weights: Array, inputs: Array, count: int, sums: Array, width: int) -> None:
    """Add to ``sums`` (width,) the product of ``weights`` (count, width) with ``inputs`` (count,).

    What stands within `SPARE` places behind the sums is lost, and as many behind the weights are read.
    """
    for j in range(0, width, LANES):
        add_products(sums, j, weights, j, width, inputs, count)


@inlined
def squash(sums: Array, width: int) -> None:
    """Replace ``sums`` by their hyperbolic tangents, and `SPARE` places behind them as well."""
    for j in range((width + SPARE) // LANES * LANES):
        sums[j] = _tanh(sums[j])


_add_product, _squash = add_product, squash


@inlined
def layers(p: Array, x: Array, fed_back: Array, h: Array) -> int:
    """Fill ``h`` with the outputs of the first and second layer; return where the weights of the outputs begin."""
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
    """T of the output whose weights begin there, not yet cut off."""
    width, second, inputs = whole(p[WIDTH]), whole(p[SECOND]), whole(p[INPUTS])
    last = part(h, width if second > 0 else 0)
    count = second if second > 0 else width
    linear = begin + 1 + count
    even, odd = p[begin], 0.0  # two sums, because each addition waits for the one before it
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
    """How many weights each output has."""
    width, second = whole(p[WIDTH]), whole(p[SECOND])
    return (
        1 + (second if second > 0 else width) + whole(p[INPUTS]) + (whole(p[FEEDBACKS]) if p[STRUCTURE] == NARX else 0)
    )


_layers, _output, _output_weights = layers, output, output_weights


@inlined
def rate_bend(p: Array, begin: int, features: Array) -> float:
    """Where the gate whose weights begin there is between its bounds, -1 to 1."""
    total = p[begin]
    for i in range(GATE_FEATURES):
        total = fma(p[begin + 1 + i], features[i], total)
    return _tanh(total)


@inlined
def rate(p: Array, bend: float) -> float:
    """Rate kappa of a gate, rad^-1."""
    return decay(-fma(p[RATE_HALF], bend, p[RATE_MIDDLE]))


@inlined
def per_knee(p: Array, bend: float) -> float:
    """1 / w of a knee."""
    return decay(fma(KNEE_HALF, bend, KNEE_MIDDLE)) / p[BOUND]


@inlined
def travelled(distance: float, way: float, per_knee: float) -> tuple[float, float, float, float]:
    """How far a state goes towards its aim in one step.

    Parameters
    ----------
    distance, way, per_knee : float
        T - y, kappa abs(v) dt and 1 / w.

    Returns
    -------
    tuple
        Share of the distance that it goes; 1 less the slope of what is left of the distance over the distance; how
        many knees the distance is, and how many of them lie beyond the first.
    """
    knees = abs(distance) * per_knee
    beyond = max(knees - 1.0, 0.0)
    straight = min(beyond, way)
    begun = straight / max(knees, 1.0)
    soft = approach(way - straight)
    return fma(1.0 - begun, soft, begun), soft, knees, beyond


_rate_bend, _rate, _per_knee, _travelled, _summed = rate_bend, rate, per_knee, travelled, summed


@inlined
def outputs(p: Array, x: Array, fed_back: Array, aims: Array, h: Array) -> tuple[float, int]:
    """Fill ``aims`` and ``h`` of a gated network as `advance` does.

    Returns
    -------
    tuple
        What its direct path gives, and where the weights of the gates begin.
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
    p: Array,
    x: Array,
    features: Array,
    path: float,
    tempo: float,
    damped: float,
    fed_back: Array,
    after: Array,
    aims: Array,
    h: Array,
) -> tuple[float, float]:
    """Torque over its scale, from inputs and what is fed back, and the damping in it.

    Parameters
    ----------
    p
        Network.
    x, features : (inputs,) and (`GATE_FEATURES`,) array
        What the layers and what the gates see; a network without gates does not look at the latter.
    path, tempo : float
        abs(v) dt of the step, rad, and TRAINED_DT / dt of the sample.
    damped : float
        Damping of the earlier steps of the same sample.
    fed_back, after : (feedbacks,) array
        Before and after the step. May be the same array.
    aims : (1 + feedbacks,) array
        Filled with T of every output, cut off, and B.
    h : (width + second + SPARE,) array
        Filled with the outputs of the layers.
    """
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
        way = _rate(p, _rate_bend(p, gate, features)) * path
        knee = _per_knee(p, _rate_bend(p, gate + GATE_WEIGHTS, features))
        share, _, _, _ = _travelled(aims[i] - before, way, knee)
        after[i] = toward(before, aims[i], share)
        if i < _summed(p):
            total += after[i]
            damped += damping * ((after[i] - before) * tempo)
    return _limited(total + damped, bound), damped


_velocity_features, _other_features, _advance, _stop = velocity_features, other_features, advance, stop
_since_turn, _gate_features = since_turn, gate_features


@inlined
def steps_of(p: Array, dt: float) -> int:
    """Into how many equal steps a sample is divided, each about as long as in the training; 1 where not gated."""
    return whole(min(max(dt / p[TRAINED_DT] + 0.5, 1.0), MOST_STEPS)) if p[STRUCTURE] == GATED else 1


@inlined
def share_inside(p: Array, speed: float) -> float:
    """Share of a residual: 1 up to the speed limit, then less, 0 in the end."""
    return min(max((_FADED - speed / p[SPEED_LIMIT]) / (_FADED - 1.0), 0.0), 1.0)


@inlined
def seen_velocity(p: Array, velocity: float, level_velocity: float) -> float:
    """Velocity of the inputs: as fast as the one, in the direction of the other.

    Where the level has stayed behind, on the other side, it creeps with the slowest of the characteristic speeds.
    """
    speed = math.copysign(1.0, velocity) * level_velocity
    return math.copysign(max(speed, min(abs(velocity), p[SPEEDS + 2])), velocity)


_share_inside, _seen_velocity, _steps_of = share_inside, seen_velocity, steps_of


@inlined
def step(
    p: Array,
    s: Array,
    velocity: float,
    level_velocity: float,
    dt: float,
    position: float,
    load_torque: float,
    temperature: float,
) -> float:
    """Advance the state over one sample, over which ``velocity`` is held, and return the friction torque, N m.

    Parameters
    ----------
    p, s
        Network and state; the state is changed in place.
    velocity, level_velocity
        rad/s. The one that drives the state and decides the direction, and the one that says how fast: the same,
        except in a compensator; see `friction_hil.friction.kernel`.
    dt, position, load_torque, temperature
        s, rad, N m, deg C. What is no input of the network is not looked at. A narx ignores ``dt``.
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
        torque *= _share_inside(p, abs(velocity))
    return torque


_step = step


@compiled
def step_apart(
    p: Array,
    s: Array,
    velocity: float,
    level_velocity: float,
    dt: float,
    position: float,
    load_torque: float,
    temperature: float,
) -> float:
    """`step`, compiled by itself: what is compiled for every family would take minutes with it inside."""
    return _step(p, s, velocity, level_velocity, dt, position, load_torque, temperature)
