"""The residual layer: found where it is, silent in noise, bounded, forgotten, and on only where it is a gain."""

import math
from copy import deepcopy

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import friction_hil as fh
from friction_hil.learning import estimate
from friction_hil.learning.estimate import Mechanics
from friction_hil.learning.layer import Layer, between, columns, pairs
from friction_hil.learning.proposal import Step
from friction_hil.learning.residual import Residual
from friction_hil.learning.thresholds import LAYER_SHARE as SHARE
from friction_hil.learning.thresholds import WINDOW_TICKS
from friction_hil.learning.window import Window
from tests.compensators import INERTIA, LUGRE, PERIOD_S
from tests.learning_records import COUNT, Driven, motion

LEVEL = LUGRE.level
LAYER = Layer(pairs("ripple", (7.0, 24.0)), (0.006, 0.0, 0.0, -0.008))
DISTANCE = LEVEL / 2000.0  # over which the bristles of the model bend
REVERSAL = {"distance": [DISTANCE, 8 * DISTANCE, 60 * DISTANCE], "positive": [0.0, 0.006, 0.0]}
SPEED = {"velocity": [0.5, 1.0, 2.0], "positive": [0.0, 0.005, 0.0]}
WINDOW_S = 6.0


def ripple(layer, position):
    """Torque of the harmonics of a layer on a rotary axis."""
    parts = zip(layer.features, layer.amplitudes, strict=True)
    return sum(a * (np.cos if each.part == "cosine" else np.sin)(each.at * position) for each, a in parts)


def torque_of(layer, model=LUGRE, **course):
    """Torque that a layer adds along a motion."""
    position, velocity = motion(np.arange(8000) * PERIOD_S, **course)
    both = [
        each.simulate(velocity, PERIOD_S, position=position, load_torque=np.sin(position))
        for each in (layer.on(model), model)
    ]
    return both[0] - both[1]


def left_over(torque, begin_s=0.0, amplitude=1.0, true=LUGRE, weight=0.0):
    """What the model leaves of a window of ``true`` friction; ``torque`` is a function of position beside it."""
    t = np.arange(round((WINDOW_S + 1.0) / PERIOD_S)) * PERIOD_S + begin_s
    position, _ = motion(t, amplitude=amplitude)
    velocity = np.diff(position, prepend=position[0]) / PERIOD_S
    load = weight * np.sin(position)
    friction = true.simulate(velocity, PERIOD_S, position=position, load_torque=load)
    inertial = INERTIA * np.append(np.diff(velocity), 0.0) / PERIOD_S
    rows = Window(
        PERIOD_S, position, friction + inertial + load + torque(position), position, load, np.full(t.size, math.nan)
    )
    mechanics = Mechanics(INERTIA, (0.0, weight, 0.0))
    return estimate.left_over(rows, estimate.first_belief(LUGRE, mechanics, {}), COUNT, 1.0)


def noise(seed, correlated_s, size=0.02):
    """Noise of a size in friction levels, white or correlated."""

    def of(position):
        values = np.random.default_rng(seed).standard_normal(position.size)
        length = max(round(correlated_s / PERIOD_S), 1)
        values = np.convolve(values, np.ones(length), "same")
        return size * LEVEL * values / np.std(values)

    return of


@pytest.mark.parametrize("axis", ["rotary", "linear"])
def test_a_model_with_the_layer_has_its_torque_beside_the_own(axis):
    own = [{"order": 24.0, "cosine": 0.001, "sine": 0.002}]
    model = fh.models.create("lugre", axis=axis, modifiers={"ripple": own}, **LUGRE.given)
    position, velocity = motion(np.arange(400) * PERIOD_S, amplitude=1.0)
    torques = [each.simulate(velocity, PERIOD_S, position=position) for each in (model, LAYER.on(model))]
    expected = ripple(LAYER, position * (math.tau if axis == "linear" else 1.0))
    np.testing.assert_allclose(torques[1] - torques[0], expected, atol=1e-12)
    assert [each["order"] for each in LAYER.on(model).modifiers["ripple"]] == [24.0, 7.0]


@given(seed=st.integers(0, 10**6))
@settings(max_examples=25, deadline=None)
def test_every_layer_is_linear_in_its_amplitudes_and_within_its_bound(seed):
    random = np.random.default_rng(seed)
    features = (*LAYER.features, *pairs("reversal", (1e-4, 1e-3)), *pairs("speed", (0.1, 1.0)))
    layer = Layer(features, tuple(random.uniform(-0.02, 0.02, len(features)).tolist()))
    position, velocity = motion(np.arange(3000) * PERIOD_S, amplitude=0.3, frequency=1.0)

    def gradient(model, free):
        return model.simulate_with_gradient(velocity, PERIOD_S, free=free, position=position)[1]

    torque = torque_of(layer, amplitude=0.3, frequency=1.0)[:3000]
    np.testing.assert_allclose(columns(LUGRE, features, gradient) @ layer.amplitudes, torque, atol=1e-12)
    assert np.max(np.abs(torque)) <= layer.most
    third = between(None, layer, 1.0 / 3.0)
    np.testing.assert_allclose(torque_of(third, amplitude=0.3, frequency=1.0)[:3000], torque / 3.0, atol=1e-12)
    assert layer.limited(0.01).most == pytest.approx(0.01)


@pytest.mark.parametrize(
    ("modifiers", "amplitude", "weight", "words"),
    [
        ({"reversal": REVERSAL}, 0.2, 0.0, "distance since reversal"),
        ({"speed": SPEED}, 0.6, 0.0, "speed"),
        ({"load": {"motoring": 0.12, "driven": 0.1}}, 0.6, 2.0 * LEVEL, "load"),
    ],
)
def test_what_depends_on_distance_speed_or_load_is_found_and_named(modifiers, amplitude, weight, words):
    true = fh.models.create("lugre", modifiers=modifiers, **LUGRE.given)
    residual = Residual(LUGRE)
    found = [
        residual.look(left_over(noise(k, 0.0, 0.003), k * WINDOW_S, amplitude, true, weight), None) for k in range(2)
    ]
    assert found[0].layer is None  # it has to be there twice
    assert str(found[1].layer) == words
    assert found[1].layer.most <= SHARE * LEVEL * (1.0 + 1e-12)
    assert found[1].explained > 0.5


def test_harmonics_of_the_position_are_found():
    found = Residual(LUGRE).look(left_over(lambda q: ripple(LAYER, q) + noise(1, 0.0)(q)), None)
    assert sorted({each.at for each in found.layer.features}) == [7.0, 24.0]
    position = np.linspace(0.0, 2.0, 500)
    assert np.max(np.abs(ripple(found.layer, position) - ripple(LAYER, position))) < 0.1 * LAYER.most
    assert found.explained > 0.5


@given(seed=st.integers(0, 10**6), correlated_s=st.sampled_from([0.0, 0.005, 0.05]))
@settings(max_examples=8, deadline=None)
def test_noise_is_left_alone(seed, correlated_s):
    residual = Residual(LUGRE)
    for k in range(2):
        assert residual.look(left_over(noise(seed + k, correlated_s), begin_s=k * WINDOW_S), None).layer is None


def test_rest_shows_no_layer():
    at_rest = left_over(lambda q: np.full(q.size, 0.03), amplitude=0.0)
    assert Residual(LUGRE).look(at_rest, None).layer is None


@pytest.mark.parametrize("factor", [0.5, 30.0])
def test_the_torque_of_a_layer_is_at_most_a_share_of_the_level(factor):
    found = Residual(LUGRE).look(left_over(lambda q: factor * ripple(LAYER, q)), None).layer
    largest = float(np.max(np.abs(ripple(found, np.linspace(0.0, math.tau, 20000)))))
    assert largest <= min(SHARE * LEVEL, 1.01 * factor * LAYER.most) + 1e-12
    assert found.most == pytest.approx(min(SHARE * LEVEL, factor * LAYER.most), rel=0.01)


def test_a_layer_follows_what_changes_and_ends_with_it():
    residual, used = Residual(LUGRE), None
    for k in range(30):
        factor = 1.0 if k < 10 else 0.5
        seen = left_over(lambda q, f=factor, k=k: f * ripple(LAYER, q) + noise(k, 0.0)(q), begin_s=k * WINDOW_S)
        used = residual.look(seen, used).layer or used
    assert used.most == pytest.approx(0.5 * LAYER.most, rel=0.2)
    ends = [residual.look(left_over(noise(k, 0.0)), used).is_spent for k in range(3)]
    assert ends == [False, True, True]


ON_TRIAL = {"true": LAYER.on(LUGRE), "amplitude": 1.0, "seed": 1}


@pytest.fixture(scope="module")
def handed_over():
    driven = Driven(LUGRE, gain=1.0)
    return driven.take(5 * WINDOW_TICKS, until=Step.LAYER, error=1e-3, **ON_TRIAL)


@pytest.fixture
def rippled(handed_over):
    """A learner on an axis with cogging, at the moment at which a layer is handed over."""
    return deepcopy(handed_over)


def test_a_layer_that_helps_is_kept_and_told(rippled):
    _, last = rippled.proposals[-1]
    assert last.step is Step.LAYER
    assert {7.0, 24.0} <= {each["order"] for each in last.model.modifiers["ripple"]}
    rippled.take(WINDOW_TICKS + 14, until=Step.BACK, error=3e-4, **ON_TRIAL)
    figures = rippled.learner.figures.residual_layer
    assert figures.state == "on"
    assert figures.error_after < 0.5 * figures.error_before
    at, before = rippled.ticks, len(rippled.proposals)  # it is off at once where the position jumps

    def slip(rows):
        rows["position"][100:] += 0.01

    rippled.take(4, until=Step.BACK, change=slip, error=3e-4, **ON_TRIAL)
    assert rippled.ticks - at <= 4
    _, back = rippled.proposals[before]
    assert (back.step, dict(back.model.modifiers)) == (Step.BACK, {})
    assert figures.state == "no longer a gain"


def test_a_layer_without_a_gain_is_off(rippled):
    rippled.take(WINDOW_TICKS + 14, until=Step.BACK, error=1e-3, **ON_TRIAL)
    _, back = rippled.proposals[-1]
    assert (back.step, dict(back.model.modifiers)) == (Step.BACK, {})
    assert rippled.learner.figures.residual_layer.state == "no gain"


def test_an_axis_without_a_residual_never_gets_a_layer():
    driven = Driven().take(6 * WINDOW_TICKS, error=1e-3, amplitude=1.0, seed=1)
    assert Step.LAYER not in [each.step for _, each in driven.proposals]
    assert driven.learner.figures.residual_layer.state == "noise only"
