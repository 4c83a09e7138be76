"""Networks as friction models: one step everywhere, bounded, at rest, beyond their range, in a model file."""

import math
import pickle

import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st

import friction_hil as fh
from friction_hil.compensator import Compensator, CompensatorSettings
from friction_hil.friction.network import seen_velocity
from friction_hil.models import InvalidParameterError
from friction_hil.reports.model_picture import slow_cycle
from tests.compensators import PERIOD_S, columns, compensator
from tests.networks import STRUCTURES, alone, beside, model_file, random_network

every_structure = pytest.mark.parametrize("name", list(STRUCTURES))
COUNT = STRUCTURES["gated"].weights
INPUTS = {"position": 0.3, "load_torque": 0.05, "temperature": 30.0}


def motion(samples=3000, seed=1):
    return 0.02 * np.cumsum(np.random.default_rng(seed).standard_normal(samples))


@every_structure
def test_a_step_and_a_whole_array_are_the_same_bits_also_after_pickling(name):
    model, velocity = alone(random_network(name)), motion(500)
    runner = model.start()
    stepped = [runner.step(v, 1e-3, **INPUTS) for v in velocity[:250]]
    other = pickle.loads(pickle.dumps(runner))
    stepped += [other.step(v, 1e-3, **INPUTS) for v in velocity[250:]]
    np.testing.assert_array_equal(model.simulate(velocity, 1e-3, **INPUTS), stepped)


@given(st.sampled_from(sorted(STRUCTURES)), st.integers(0, 99), st.floats(0.1, 50.0), st.floats(1e-6, 1.0))
def test_no_weights_and_no_input_take_it_beyond_its_bound(name, seed, size, dt):
    network = random_network(name, seed, size)
    velocity = np.random.default_rng(seed).choice([0.0, 1e-9, -0.02, 3.0, -1e3, 1e12], 300)
    dt = network.period_s if name == "narx" else dt
    torque = alone(network).simulate(velocity, dt, **INPUTS)
    assert np.abs(torque).max() <= network.bound * network.torque_scale * (1.0 + 1e-12)


@pytest.mark.parametrize("name", ["gated", "gated_2", "every_input"])
def test_at_rest_a_gated_network_keeps_its_state(name):
    model, velocity = alone(random_network(name)), np.zeros(5000)
    velocity[:200] = motion(200) + 0.1
    torque = model.simulate(velocity, 1e-3, **INPUTS)
    assert len(set(torque[200:])) == 1
    assert torque[-1] != 0.0


@pytest.mark.parametrize("name", ["gated", "gated_2"])
def test_a_gated_network_hardly_depends_on_the_period(name):
    """A velocity that is held for 4 ms, in one sample or in four, or in sixteen."""
    model, held = alone(random_network(name)), 0.05 * np.sin(np.arange(500) * 0.05)
    coarse = model.simulate(held, 4e-3)
    for count in (4, 16):
        fine = model.simulate(held.repeat(count), 4e-3 / count)[count - 1 :: count]
        assert np.abs(fine - coarse).max() < 0.02 * np.ptp(coarse)


@pytest.mark.parametrize("name", ["gated", "gated_2"])
@pytest.mark.parametrize("count", [2, 3, 16])
def test_a_long_sample_is_steps_of_the_trained_period(name, count):
    """The state after a motion is the same to the last few bits, however the samples were divided."""
    network = random_network(name)
    for motion_before in (motion(40, 1), motion(41, 2)):
        ends = [
            alone(network).simulate([*np.repeat(motion_before, each), 0.0], network.period_s * count / each)[-1]
            for each in (1, count)
        ]
        np.testing.assert_allclose(ends[0], ends[1], rtol=1e-10)


@pytest.mark.parametrize(
    ("name", "seed", "dt", "count", "tolerance"),
    [("gated", 0, 1e-2, 4000, 1e-9), *(("narx", seed, 2e-3, 25_000, 1e-6) for seed in range(3))],
)
def test_steady_state_is_where_a_long_motion_ends(name, seed, dt, count, tolerance):
    """That of a narx at its own period."""
    model, speeds = alone(random_network(name, seed, period_s=2e-3)), np.array([-1.5, -0.02, 0.3])
    ends = [model.simulate(np.full(count, speed), dt)[-1] for speed in speeds]
    np.testing.assert_allclose(model.steady_state(speeds), ends, rtol=tolerance)
    assert model.steady_state([0.0])[0] == 0.0


def test_a_narx_that_oscillates_at_constant_speed_has_the_mean_for_its_steady_state():
    quiet = random_network("narx", size=0.0)
    weights = quiet.weights.copy()
    weights[-2] = -4.0  # of the latest torque in the linear path: it alternates between the bounds
    weights[quiet.structure.outputs_begin] = 0.1
    model = alone(random_network("narx", weights=weights))
    assert np.ptp(model.simulate(np.full(100, 0.3), 1e-3)[-4:]) > 0.1
    assert abs(model.steady_state([0.3])[0]) < 1e-9


@pytest.mark.parametrize("name", sorted(set(STRUCTURES) - {"every_input"}))
def test_every_network_alone_can_be_drawn(name):
    cycle = slow_cycle(alone(random_network(name)))
    assert np.isfinite(cycle.torque).all()
    assert set(cycle.leg) == set(range(6))


def test_presliding_stiffness_is_the_slope_of_a_creeping_motion():
    network = random_network()
    creeping = alone(network).simulate(np.full(4, network.speeds[2]), 1e-6)
    assert alone(network).presliding_stiffness == pytest.approx(
        np.diff(creeping)[0] / (network.speeds[2] * 1e-6), rel=0.05
    )
    assert alone(random_network("static")).presliding_stiffness == 0.0


def test_a_residual_adds_to_its_model_and_fades_out_beyond_its_range():
    network = random_network(is_residual=True)
    lugre = fh.models.create("lugre", **fh.models.describe("lugre").example)
    for speed, fraction in ((1.9, 1.0), (2.5, 0.5), (3.0, 0.0), (30.0, 0.0)):
        velocity = np.full(2000, speed)
        plain, both = lugre.simulate(velocity, 1e-3)[-1], beside(network).simulate(velocity, 1e-3)[-1]
        learned = alone(random_network()).simulate(np.full(2000, min(speed, 2.0)), 1e-3)[-1]
        assert both - plain == pytest.approx(fraction * learned, rel=1e-3, abs=1e-12)
    beyond = alone(random_network("static")).simulate([2.0, 2.1, 1e3, 1e9], 1e-3)
    assert len(set(beyond)) == 1  # alone it stays what it is at its end


def test_modifiers_of_the_model_beside_it_stay_what_they_are():
    network, velocity = random_network(is_residual=True), motion(400)
    modifiers = {"ripple": [{"order": 3, "cosine": 0.01, "sine": 0.02}], "load": {"motoring": 0.1}}
    inputs = {"position": np.cumsum(velocity) * 1e-3, "load_torque": 0.2}
    with_both = beside(network, "lugre", modifiers).simulate(velocity, 1e-3, **inputs)
    example = fh.models.describe("lugre").example
    without = fh.models.create("lugre", modifiers=modifiers, **example).simulate(velocity, 1e-3, **inputs)
    np.testing.assert_allclose(with_both, without + alone(network).simulate(velocity, 1e-3), atol=1e-12)


def test_what_a_network_needs_is_asked_for():
    model = alone(random_network("every_input"))
    for known, missing in (({}, "position"), ({"position": 0.0}, "load_torque")):
        with pytest.raises(fh.errors.UsageError, match=missing):
            model.simulate([0.1], 1e-3, **known)
    with pytest.raises(fh.errors.UsageError, match="trained"):
        model.simulate_with_gradient([0.1], 1e-3)


@pytest.mark.parametrize("make", [alone, beside])
@pytest.mark.parametrize("velocity", ["difference", "kalman"])
def test_a_compensator_replays_a_network_step_for_step(make, velocity):
    settings_of = CompensatorSettings(
        period_s=1e-3, position_resolution=1e-5, torque_limit=0.3, inertia=2e-4, velocity=velocity
    )
    one, other = (Compensator(make(random_network()), settings_of) for _ in range(2))
    position = 1e-3 * np.cumsum(motion(600))
    rows = columns(600, position=np.round(position / 1e-5) * 1e-5, velocity_demand=0.1, velocity_demand_ahead=0.1)
    torque, _ = one.replay(rows)
    np.testing.assert_array_equal(torque, [other.step(*row) for row in np.transpose(rows).tolist()])
    assert np.abs(torque).max() > 0.01


@pytest.mark.parametrize("make", [alone, beside])
def test_a_compensator_gives_the_whole_model(make):
    model = make(random_network())
    one, runner = compensator(model, source="demand"), model.start()
    expected = [runner.step(0.1, PERIOD_S) for _ in range(100)]
    torque, _ = one.replay(columns(100, velocity_demand=0.1, velocity_demand_ahead=0.1))
    np.testing.assert_allclose(torque[20:], expected[20:], rtol=1e-12)


def test_an_opposite_level_velocity_does_not_reverse_the_direction():
    """If the measured velocity is opposite to the reference velocity, the features keep the latter's direction."""
    p = random_network().values
    assert seen_velocity(p, 0.5, 0.3) == 0.3
    assert seen_velocity(p, 0.5, -0.3) == 0.003
    assert seen_velocity(p, -0.5, 0.3) == -0.003
    assert seen_velocity(p, 1e-4, 0.0) == 1e-4
    assert seen_velocity(p, 0.0, 0.0) == 0.0


@every_structure
def test_a_model_file_gives_back_the_same_network(name, tmp_path):
    network = random_network(name)
    path = tmp_path / "net.yaml"
    path.write_text(yaml.safe_dump(model_file(network), sort_keys=False))
    model = fh.models.load(path)
    np.testing.assert_array_equal(model.values, alone(network).values)
    assert model.level == 0.12


def test_a_residual_comes_with_its_model(tmp_path):
    example = dict(fh.models.describe("lugre").example)
    content = model_file(random_network())
    content["friction"]["network"]["base"] = {"model": "lugre", "parameters": example}
    path = tmp_path / "net.yaml"
    path.write_text(yaml.safe_dump(content))
    np.testing.assert_array_equal(fh.models.load(path).values, beside(random_network(is_residual=True)).values)


@pytest.mark.parametrize(
    ("changed", "field", "words"),
    [
        ({"weights": None}, "friction.network.weights", "is missing"),
        ({"weights": [0.1] * 7}, "friction.network.weights", "7 numbers"),
        ({"weights": [1e5] * COUNT}, "friction.network.weights", "within"),
        ({"weights": [".nan"] * COUNT}, "friction.network.weights", "number"),
        ({"structure": "lstm"}, "friction.network.structure", "gated"),
        ({"hidden": [0]}, "friction.network", "1 to 64 units"),
        ({"hidden": [4, 4, 4]}, "friction.network", "one or two layers"),
        ({"states": 0}, "friction.network", "1 to 5 states"),
        ({"speeds": [0.1, 0.2]}, "friction.network.speeds", "three"),
        ({"speed_limit": -1.0}, "friction.network.speed_limit", "above zero"),
        ({"stroke": None}, "friction.network.stroke", "trained again"),
        ({"stroke": -1e-3}, "friction.network.stroke", "above zero"),
        ({"inputs": ["position"]}, "friction.network.ranges", "position"),
        ({"color": "red"}, "friction.network.color", "not a key here"),
        ({"/network": None}, "friction.network", "is missing"),
        ({"/parameters": {"a": 1.0}}, "friction.parameters", "no parameters"),
        ({"/modifiers": {"load": {"motoring": 0.1}}}, "friction.modifiers.load", "no level"),
        ({"/model": "lugre"}, "friction.network", "belongs to the model network"),
    ],
)
def test_a_mistake_in_the_file_is_reported_with_its_field_and_line(changed, field, words, tmp_path):
    """Keys of the network, or with a stroke of the friction; None takes one away."""
    content = model_file(random_network())
    ((name, value),) = changed.items()
    section = content["friction"] if name.startswith("/") else content["friction"]["network"]
    section[name.strip("/")] = value
    if value is None:
        del section[name.strip("/")]
    path = tmp_path / "net.yaml"
    path.write_text(yaml.safe_dump(content))
    with pytest.raises(fh.errors.ConfigurationError) as caught:
        fh.models.load(path)
    assert any(problem.field.startswith(field) and words in problem.message for problem in caught.value.problems)
    assert all(problem.line for problem in caught.value.problems)


@pytest.mark.parametrize(
    ("changes", "parameter"),
    [
        ({"level": math.nan}, "level"),
        ({"bound": 0.0}, "bound"),
        ({"stroke": math.inf}, "stroke"),
        ({"speeds": (0.1, math.inf, 0.2)}, "speeds"),
        ({"weights": np.full(COUNT, math.nan)}, "weights"),
    ],
)
def test_numbers_that_are_not_finite_are_refused(changes, parameter):
    with pytest.raises(InvalidParameterError) as caught:
        random_network(**changes)
    assert caught.value.parameter == parameter
