"""The numerical core of training: steps, exact derivatives, normal equations, Levenberg-Marquardt."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import least_squares

from friction_hil.errors import UsageError
from friction_hil.friction import network
from friction_hil.models import NetworkStructure
from friction_hil.training import constraints, gated, jacobian, levenberg, normal
from friction_hil.training.checks import at_rest, simulate
from friction_hil.training.excitation import excitation
from friction_hil.training.layout import Samples, empty, join
from friction_hil.training.objective import NetworkRun, Objective

DT = 1e-3
STRUCTURES = {
    "gated": NetworkStructure(hidden=(5,)),
    "gated, two states": NetworkStructure(hidden=(4,), states=2),
    "gated, two layers": NetworkStructure(hidden=(5, 3), has_position=True, orders=(7.0,)),
    "narx": NetworkStructure("narx", (5,), 2, 1),
    "narx, two layers": NetworkStructure("narx", (3, 6), 1, 2, has_load=True),
    "static": NetworkStructure("static", (6,), 0, has_position=True, has_load=True, has_temperature=True),
    "static, two layers": NetworkStructure("static", (4, 3), 0),
}
each_structure = pytest.mark.parametrize("structure", STRUCTURES.values(), ids=STRUCTURES.keys())
finite = st.floats(allow_nan=False, allow_infinity=False)


def samples(count=400, seed=3, dt=DT):
    random = np.random.default_rng(seed)
    velocity = excitation(1.2, dt, count, seed=seed)
    return Samples(
        dt,
        velocity,
        torque=0.1 * np.tanh(velocity / 0.01) + 0.02 * velocity + 0.001 * random.standard_normal(count),
        position=np.cumsum(velocity) * dt,
        load_torque=0.3 * random.standard_normal(count),
        temperature=np.where(random.uniform(size=count) < 0.1, np.nan, random.uniform(20.0, 40.0, count)),
    )


def random_network(structure, data, seed=0, size=0.4):
    p = empty(structure, data)
    p[network.HEADER :] = size * np.random.default_rng(seed).standard_normal(structure.weights)
    return p


def jacobian_of(p, run, is_free):
    data, weights = run.samples, p.size - network.HEADER
    run.simulate(p, is_free)
    rows = np.zeros((len(data), weights + network.SPARE))
    sensitivities = np.zeros((max(1, int(p[network.FEEDBACKS])), gated.row_length(p)))
    common = (data.starts, run.inputs, run.gate_features, run.path, run.trace)
    jacobian.fill_rows(p, *common, is_free, 0, len(data), sensitivities, rows, weights)
    return rows[:, :weights]


@each_structure
def test_training_runs_the_step_of_the_model(structure):
    data = samples()
    p = random_network(structure, data)
    run = NetworkRun(p, data)
    run.simulate(p, is_free=True)
    others = {"position": data.position, "load_torque": data.load_torque, "temperature": data.temperature}
    torque = simulate(structure, p, data.velocity, DT, **others)
    np.testing.assert_array_equal(torque, p[network.TORQUE_SCALE] * run.trace[:, -1])
    assert np.ptp(torque) > 0.0


def test_a_gated_network_is_the_formula():
    """An independent calculation in numpy of what the head of `network` says."""
    structure, data = STRUCTURES["gated"], samples(60)
    p = random_network(structure, data)
    w, width = p[network.HEADER :], 5
    first, bias = w[width : width * 7].reshape(6, width), w[:width]
    aim, damping = w[35:46], w[46:57]
    direct, gate, knee = w[57:63], w[63:70], w[70:77]
    assert structure.weights == 77
    expected, y, stop, way_since, stroke = [], 0.0, 0.0, 0.0, p[network.STROKE]
    for v in data.velocity:
        limit, speeds = p[network.SPEED_LIMIT], p[network.SPEEDS : network.SPEEDS + 3]
        x = np.array(
            [v / limit, *(np.arcsinh(v / speeds[:2]) / np.arcsinh(limit / speeds[:2])), np.tanh(v / speeds[2])]
        )
        stop = np.clip(stop + v * DT / stroke, -1.0, 1.0)
        way_since = (way_since if np.sign(way_since) == np.sign(v) else 0.0) + v * DT
        seen = np.array([*x**2, stop * x[3], min(abs(way_since) / (0.25 * stroke), 1.0)])
        x = np.append(x, stop)
        h = np.tanh(bias + np.append(x, y) @ first)
        goal = np.clip(aim[0] + aim[1:6] @ h + aim[6:] @ x, -p[network.BOUND], p[network.BOUND])
        kappa = np.exp(p[network.RATE_MIDDLE] + p[network.RATE_HALF] * np.tanh(gate[0] + gate[1:] @ seen))
        knee_at = 0.1 * p[network.BOUND] * 20.0 ** np.tanh(knee[0] + knee[1:] @ seen)
        left, way = goal - y, kappa * abs(v) * DT
        outside = np.clip((abs(left) - knee_at) / knee_at, 0.0, way)
        after = goal - (left - outside * knee_at * np.sign(left)) * np.exp(-(way - outside))
        total = direct[0] + direct[1:] @ x + after + (damping[0] + damping[1:6] @ h + damping[6:] @ x) * (after - y)
        expected.append(p[network.TORQUE_SCALE] * np.clip(total, -p[network.BOUND], p[network.BOUND]))
        y = after
    np.testing.assert_allclose(simulate(structure, p, data.velocity, DT), expected, rtol=1e-10, atol=1e-14)


@settings(max_examples=50, deadline=None)
@given(st.floats(-6.0, 6.0), st.floats(0.0, 30.0), st.floats(0.01, 10.0))
def test_a_state_goes_towards_its_aim_as_its_equation_says(distance, way, knee):
    """Small steps of d(distance)/d(way) = -limited(distance, knee); what is left keeps its sign and never grows."""
    count, left, slope = 20_000, distance, 1.0
    for _ in range(count):
        slope *= 1.0 - way / count * (abs(left) < knee)
        left -= way / count * min(max(left, -knee), knee)
    fraction, soft, _, _ = network.travelled(distance, way, 1.0 / knee)
    assert 0.0 <= fraction <= 1.0
    assert 0.0 <= soft <= 1.0
    assert (1.0 - fraction) * distance == pytest.approx(left, abs=5e-3 * max(abs(distance), 1e-9))
    assert 1.0 - soft == pytest.approx(slope, abs=1e-2)
    assert network.travelled(distance, 0.0, 1.0 / knee)[0] == 0.0


FREE = [(name, True) for name in STRUCTURES]
FED_BACK = [(name, False) for name in STRUCTURES if "gated" not in name]  # those are trained in free run alone


@pytest.mark.parametrize(("name", "is_free"), FREE + FED_BACK)
def test_the_jacobian_is_exact(name, is_free):
    """Against central differences of fourth order; the period differs from the one of the scales."""
    structure = STRUCTURES[name]
    p = random_network(structure, samples())
    data = join([samples(150, dt=0.8 * DT), samples(100, seed=5, dt=0.8 * DT)])
    run = NetworkRun(p, data)
    exact = jacobian_of(p, run, is_free)

    def torque(index, change):
        q = p.copy()
        q[network.HEADER + index] += change
        run.simulate(q, is_free)
        return run.trace[:, -1].copy()

    for index in range(structure.weights):
        step = 1e-4
        near, far = (torque(index, k * step) - torque(index, -k * step) for k in (1, 2))
        numeric = (8.0 * near - far) / (12.0 * step)
        np.testing.assert_allclose(exact[:, index], numeric, atol=1e-8 * (1.0 + np.max(np.abs(numeric))), rtol=0.0)


@each_structure
def test_the_gradient_over_searched_weights_is_that_of_the_cost(structure):
    data = samples()
    run = NetworkRun(empty(structure, data), data)
    constraint = constraints.Constraint(structure, 0.3)  # so that feedback is at its bound
    objective = Objective(empty(structure, data), run, constraint, 1e-3, is_free=True)
    at = 0.4 * np.random.default_rng(1).standard_normal(structure.weights)
    objective.cost(at)
    matrix, gradient = objective.normal_equations()
    np.testing.assert_allclose(matrix, matrix.T, atol=1e-14)
    for direction in np.random.default_rng(2).standard_normal((5, structure.weights)):
        slope = (objective.cost(at + 1e-6 * direction) - objective.cost(at - 1e-6 * direction)) / 2e-6
        assert 2.0 * gradient @ direction == pytest.approx(slope, rel=1e-5)


def test_weights_leave_samples_out():
    structure, data = STRUCTURES["gated"], samples()
    p = random_network(structure, data)
    weight = (np.arange(len(data)) % 100 < 60).astype(float)
    run = NetworkRun(p, data.weighted(weight))
    width = normal.padded(structure.weights + 1)
    matrix = np.zeros((width, width))
    mean = run.simulate(p, is_free=True)
    run.normal_equations(p, True, matrix)
    kept = np.column_stack([jacobian_of(p, run, True), run.trace[:, -1] - run.target])[weight > 0.0]
    size = structure.weights + 1
    np.testing.assert_allclose(np.tril(matrix[:size, :size]), np.tril(kept.T @ kept) / len(kept), atol=1e-12)
    assert mean == pytest.approx(matrix[size - 1, size - 1], rel=1e-12)


@settings(max_examples=40, deadline=None)
@given(
    st.sampled_from(sorted(STRUCTURES)),
    st.lists(st.tuples(finite, finite, finite, finite), min_size=1, max_size=30),
    st.integers(0, 99),
)
def test_the_torque_is_bounded_whatever_comes_in(name, inputs, seed):
    structure = STRUCTURES[name]
    p = random_network(structure, samples(), seed, size=30.0)
    columns = [np.array(column) for column in zip(*inputs, strict=True)]
    others = dict(zip(("position", "load_torque", "temperature"), columns[1:], strict=True))
    torque = simulate(structure, p, columns[0], DT, **others)
    assert np.all(np.abs(torque) <= p[network.BOUND] * p[network.TORQUE_SCALE] * (1.0 + 1e-12))


@settings(max_examples=30, deadline=None)
@given(st.sampled_from(["gated", "gated, two states", "gated, two layers"]), st.integers(0, 10_000))
def test_a_gated_network_forgets_how_it_began(name, seed):
    """The largest difference of two states never grows, and a long way leaves none of it."""
    structure, data = STRUCTURES[name], samples(300, seed=seed % 7)
    constraint = constraints.Constraint(structure, 0.8)
    p = random_network(structure, data)
    searched = 3.0 * np.random.default_rng(seed).standard_normal(structure.weights)
    p[network.HEADER :] = constraint.apply(searched)[0]
    assert constraint.feedback_gain(p[network.HEADER :]) < 0.8
    states = [np.zeros(structure.state_room) for _ in range(2)]
    states[0][: structure.states], states[1][: structure.states] = p[network.BOUND], -0.5 * p[network.BOUND]
    apart = math.inf
    for k in range(len(data)):
        one = slice(k, k + 1)
        for state in states:
            simulate(structure, p, data.velocity[one], DT, position=data.position[one], state=state)
        now = float(np.max(np.abs(states[0] - states[1])[: structure.states]))
        assert now <= apart * (1.0 + 1e-12) + 1e-15
        apart = now
    ends = [simulate(structure, p, np.full(200, 0.3), 1e6, state=state)[-1] for state in states]
    assert ends[0] == pytest.approx(ends[1], abs=1e-9)


@pytest.mark.parametrize("name", ["gated", "gated, two states"])
def test_a_gated_network_forgets_how_it_was_moved(name):
    """Two strokes one way, and what was before shows in the states alone, which come together."""
    structure, data = STRUCTURES[name], samples(300)
    p = random_network(structure, data)
    p[network.HEADER :] = constraints.Constraint(structure, 0.8).apply(p[network.HEADER :])[0]
    states = [np.zeros(structure.state_room) for _ in range(2)]
    for state, before in zip(states, (data.velocity, -2.0 * data.velocity[:170]), strict=True):
        simulate(structure, p, before, DT, state=state)
    memories = slice(structure.states, structure.states + network.MEMORIES)
    speed = 0.1 * p[network.STROKE] / DT
    for state in states:
        simulate(structure, p, np.full(21, speed), DT, state=state)
        np.testing.assert_array_equal(state[memories], 1.0)
    apart = [np.max(np.abs(np.subtract(*states))[: structure.states])]
    for velocity in data.velocity:
        for state in states:
            simulate(structure, p, np.array([velocity]), DT, state=state)
        apart.append(np.max(np.abs(np.subtract(*states))[: structure.states]))
    assert apart[0] > 0.0
    assert np.all(np.diff(apart) <= 1e-12)


def test_rest_and_turns_begin_a_way_anew():
    """At rest the torque stands still, yet elements that slipped before it stick after it."""
    structure, data = STRUCTURES["gated"], samples()
    p = random_network(structure, data)
    far, little = np.full(50, 0.1 * p[network.STROKE] / DT), np.full(1, 0.01 * p[network.STROKE] / DT)
    for course, stop, way in (
        ([far], 1.0, 1.0),
        ([far, -far[:5]], 0.5, -1.0),
        ([far, -little], 0.99, -0.04),
        ([far, np.zeros(1)], 1.0, 0.0),
        ([far, np.zeros(1), little], 1.0, 0.04),
    ):
        state = np.zeros(structure.state_room)
        simulate(structure, p, np.concatenate(course), DT, state=state)
        np.testing.assert_allclose(state[structure.states :][: network.MEMORIES], (stop, way), atol=1e-9)


@pytest.mark.parametrize("stroke", [1e-4, 1e-3])
def test_the_stroke_is_found_from_the_samples(stroke):
    velocity = excitation(1.2, DT, 10_000, seed=1)
    now, torque = 0.0, []
    for v in velocity:
        now = min(max(now + v * DT / stroke, -1.0), 1.0)
        torque.append(0.1 * now + 0.01 * v)
    assert empty(STRUCTURES["gated"], Samples(DT, velocity, np.array(torque)))[network.STROKE] == pytest.approx(
        stroke, rel=0.2
    )


def test_a_limit_cycle_at_rest_is_seen():
    gated, structure, data = STRUCTURES["gated"], NetworkStructure("narx", (2,), 2), samples()
    assert at_rest(gated, random_network(gated, data, seed=3), DT).is_steady
    p = empty(structure, data)
    p[-2:] = 1.9 * math.cos(0.1), -0.97  # poles at a radius of 0.985, then
    assert at_rest(structure, p, DT, seconds=5.0).is_steady
    p[network.HEADER + 10 :] = 0.0
    p[-2:] = 2.0 * math.cos(0.1), -1.0  # on the unit circle: what it was given before goes on for ever
    p[-6:-2] = 0.5
    rest = at_rest(structure, p, DT, seconds=5.0)
    assert not rest.is_steady
    assert rest.late_change > 0.0


@pytest.mark.parametrize(("rows", "columns"), [(1, 1), (7, 5), (64, 82), (33, 41)])
def test_products_are_those_of_numpy(rows, columns):
    random = np.random.default_rng(rows)
    width = normal.padded(columns)
    block, matrix = np.zeros((rows, width)), np.ones((width, width))
    block[:, :columns] = random.standard_normal((rows, columns))
    normal.add_products(block, rows, columns, matrix)
    np.testing.assert_allclose(np.tril(matrix), np.tril(1.0 + block.T @ block), rtol=1e-13, atol=1e-13)


def test_cholesky_solves_and_says_when_it_cannot():
    random = np.random.default_rng(0)
    tall = random.standard_normal((30, 12))
    matrix, right = tall.T @ tall, random.standard_normal(12)
    solution, factor = np.empty(12), np.empty((12, 12))
    assert normal.solve(matrix, right, solution, factor)
    np.testing.assert_allclose(solution, np.linalg.solve(matrix, right), rtol=1e-9)
    assert not normal.solve(matrix - 100.0 * np.eye(12), right, solution, factor)
    assert not normal.solve(np.full((12, 12), np.nan), right, solution, factor)


def osborne(at):
    """Model and slopes of two exponentials beside a constant."""
    t = np.arange(33) * 10.0
    one, other = np.exp(-at[3] * t), np.exp(-at[4] * t)
    slopes = np.column_stack([np.ones(33), one, other, -at[1] * t * one, -at[2] * t * other])
    return at[0] + at[1] * one + at[2] * other, slopes


TRUTH, START = np.array([0.3754, 1.9358, -1.4647, 0.01287, 0.02212]), np.array([0.5, 1.5, -1.0, 0.01, 0.02])


def searched(data, units=1.0, **options):
    """The search for the numbers of Osborne's first problem, in other units."""
    last = []

    def cost(at):
        model, slopes = osborne(at * units)
        last[:] = [model - data, slopes * units]
        return float(last[0] @ last[0])

    def linear():
        return last[1].T @ last[1], last[1].T @ last[0]

    return levenberg.minimise_unbounded(cost, linear, START / units, **options)


def test_the_search_finds_the_minimum_of_scipy():
    """Scales of 1 and of 0.01 in one vector."""
    data = osborne(TRUTH)[0] + 1e-3 * np.random.default_rng(0).standard_normal(33)
    solution = searched(data, iterations=200, tolerance=1e-14)
    given = {"jac": lambda at: osborne(at)[1], "method": "lm", "xtol": 1e-14, "ftol": 1e-14}
    reference = least_squares(lambda at: osborne(at)[0] - data, START, **given)
    assert solution.is_converged
    assert solution.cost == pytest.approx(2.0 * reference.cost, rel=1e-10)
    np.testing.assert_allclose(solution.at, reference.x, rtol=1e-4)


def test_the_search_is_not_changed_by_the_units_of_its_numbers():
    data, units = osborne(TRUTH)[0], np.array([1e4, 1e-3, 1.0, 1e2, 1e-5])
    costs = [searched(data, each, iterations=6).cost for each in (1.0, units)]
    assert costs[1] == pytest.approx(costs[0], rel=1e-6)


@pytest.mark.parametrize(
    ("make", "complaint"),
    [
        (lambda: Samples(DT, np.zeros(3), np.array([0.0, math.nan, 0.0])), "sample 1 is nan"),
        (lambda: Samples(DT, np.zeros(3), np.zeros(2)), "shape"),
        (lambda: join([samples(10), samples(10, dt=2 * DT)]), "sampling period"),
        (lambda: excitation(math.inf, DT, 100), "finite"),
        (lambda: NetworkStructure("gatd"), "did you mean 'gated'"),
        (lambda: NetworkStructure(hidden=(3, 3, 3)), "layers"),
        (lambda: NetworkStructure("static"), "no states"),
        (lambda: NetworkStructure(lags=1), "only a narx"),
        (lambda: NetworkStructure(orders=(math.nan,)), "orders"),
    ],
)
def test_what_is_wrong_is_refused(make, complaint):
    with pytest.raises(UsageError, match=complaint):
        make()


@settings(max_examples=25, deadline=None)
@given(st.floats(1e-3, 1e3), st.sampled_from([2.5e-4, 1e-3, 1e-2]), st.floats(2.0, 6.0), st.integers(0, 1000))
def test_an_excitation_covers_its_range(top, dt, length_s, seed):
    count = round(length_s / dt)  # several segments: a single one may go in one direction
    velocity = excitation(top, dt, count, seed=seed)
    assert velocity.shape == (count,)
    assert np.max(np.abs(velocity)) <= top * (1.0 + 1e-12)
    np.testing.assert_array_equal(velocity, excitation(top, dt, count, seed=seed))
    assert velocity.max() > 0.0 > velocity.min()


def test_an_excitation_has_every_decade_and_rests():
    speed = np.abs(excitation(1.2, DT, 20_000, seed=4))
    for low in (1e-3, 1e-2, 1e-1):
        assert np.mean((speed > low) & (speed <= 10.0 * low)) > 0.05
    assert np.mean(speed == 0.0) > 0.02
    assert np.max(speed) > 0.9
