"""The residual layer: found where it is, silent in noise, bounded, forgotten, and on only where it is a gain."""

import math
from dataclasses import asdict

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import friction_hil as fh
from friction_hil.daemon import learning_words
from friction_hil.daemon.learning_board import first_report
from friction_hil.learning.estimate import LeftOver
from friction_hil.learning.figures import LayerFigures
from friction_hil.learning.motions import WINDOW_TICKS
from friction_hil.learning.proposal import Step
from friction_hil.learning.residual import SHARE, Layer, Residual
from tests.compensators import LUGRE, PERIOD_S
from tests.unit.test_learning import Driven, motion

LEVEL = LUGRE.level
LAYER = Layer((7.0, 24.0), ((0.006, 0.0), (0.0, -0.008)))
WINDOW_S = 6.0


def left_over(torque, begin_s=0.0, amplitude=1.0):
    """What a model leaves of a window: ``torque`` is a function of position and number of rows."""
    t = np.arange(round(WINDOW_S / PERIOD_S)) * PERIOD_S + begin_s
    position, velocity = motion(t, amplitude=amplitude)
    slopes = np.column_stack([np.ones(t.size), np.sign(velocity), velocity])
    return LeftOver(position, velocity, torque(position), slopes, np.full(t.size, 1e-5), WINDOW_S)


def noise(seed, correlated_s):
    """Noise of 2 % of the level, white or correlated."""

    def of(position):
        values = np.random.default_rng(seed).standard_normal(position.size)
        length = max(round(correlated_s / PERIOD_S), 1)
        values = np.convolve(values, np.ones(length), "same")
        return 0.02 * LEVEL * values / np.std(values)

    return of


@pytest.mark.parametrize("axis", ["rotary", "linear"])
def test_a_model_with_the_layer_has_its_torque_beside_the_own(axis):
    ripple = [{"order": 24.0, "cosine": 0.001, "sine": 0.002}]
    model = fh.models.create("lugre", axis=axis, modifiers={"ripple": ripple}, **LUGRE.given)
    layer = Layer(LAYER.orders, LAYER.amplitudes, is_linear=axis == "linear")
    position, velocity = motion(np.arange(400) * PERIOD_S, amplitude=1.0)
    own, both = (each.simulate(velocity, PERIOD_S, position=position) for each in (model, layer.on(model)))
    np.testing.assert_allclose(both - own, layer.torque(position), atol=1e-12)
    assert [each["order"] for each in layer.on(model).modifiers["ripple"]] == [24.0, 7.0]


def test_harmonics_of_the_position_are_found():
    found = Residual(LUGRE).look(left_over(lambda q: LAYER.torque(q) + noise(1, 0.0)(q)), None)
    assert sorted(found.layer.orders) == [7.0, 24.0]
    position = np.linspace(0.0, 2.0, 500)
    assert np.max(np.abs(found.layer.torque(position) - LAYER.torque(position))) < 0.1 * LAYER.most
    assert found.explained > 0.5


@given(seed=st.integers(0, 10**6), correlated_s=st.sampled_from([0.0, 0.005, 0.05]))
@settings(max_examples=8, deadline=None)
def test_noise_is_left_alone(seed, correlated_s):
    residual = Residual(LUGRE)
    for k in range(2):
        assert residual.look(left_over(noise(seed + k, correlated_s), begin_s=k * WINDOW_S), None).layer is None


@pytest.mark.parametrize("factor", [0.5, 30.0])
def test_the_torque_of_a_layer_is_at_most_a_share_of_the_level(factor):
    found = Residual(LUGRE).look(left_over(lambda q: factor * LAYER.torque(q)), None).layer
    largest = float(np.max(np.abs(found.torque(np.linspace(0.0, math.tau, 20000)))))
    assert largest <= min(SHARE * LEVEL, 1.01 * factor * LAYER.most) + 1e-12
    assert found.most == pytest.approx(min(SHARE * LEVEL, factor * LAYER.most), rel=0.01)


def test_rest_shows_no_layer():
    at_rest = left_over(lambda q: np.full(q.size, 0.03), amplitude=0.0)
    assert Residual(LUGRE).look(at_rest, None).layer is None


def test_a_layer_follows_what_changes_and_ends_with_it():
    residual, used = Residual(LUGRE), None
    for k in range(30):
        factor = 1.0 if k < 10 else 0.5
        seen = left_over(lambda q, f=factor, k=k: f * LAYER.torque(q) + noise(k, 0.0)(q), begin_s=k * WINDOW_S)
        used = residual.look(seen, used).layer or used
    assert used.most == pytest.approx(0.5 * LAYER.most, rel=0.2)
    ends = [residual.look(left_over(noise(k, 0.0)), used).is_spent for k in range(3)]
    assert ends == [False, True, True]


# on trial


def rippled(seconds_of_error):
    """A learner on an axis with cogging, at the moment at which a layer is handed over."""
    return Driven(LUGRE, gain=1.0).take(
        5 * WINDOW_TICKS, until=Step.LAYER, error=seconds_of_error, true=LAYER.on(LUGRE), amplitude=1.0, seed=1
    )


def test_a_layer_that_helps_is_kept_and_told():
    driven = rippled(1e-3)
    _, last = driven.proposals[-1]
    assert last.step is Step.LAYER
    assert {7.0, 24.0} <= {each["order"] for each in last.model.modifiers["ripple"]}
    driven.take(WINDOW_TICKS + 14, until=Step.BACK, error=3e-4, true=LAYER.on(LUGRE), amplitude=1.0, seed=1)
    figures = driven.learner.figures.layer
    assert figures.state == "on"
    assert figures.error_after < 0.5 * figures.error_before


def test_a_layer_without_a_gain_is_off():
    driven = rippled(1e-3)
    driven.take(WINDOW_TICKS + 14, until=Step.BACK, error=1e-3, true=LAYER.on(LUGRE), amplitude=1.0, seed=1)
    _, back = driven.proposals[-1]
    assert (back.step, dict(back.model.modifiers)) == (Step.BACK, {})
    assert driven.learner.figures.layer.state == "no gain"


def test_an_axis_without_a_residual_never_gets_a_layer():
    driven = Driven().take(6 * WINDOW_TICKS, error=1e-3, amplitude=1.0, seed=1)
    assert Step.LAYER not in [each.step for _, each in driven.proposals]
    assert driven.learner.figures.layer.state == "noise only"


@pytest.mark.parametrize(
    ("figures", "words"),
    [
        (LayerFigures(), ""),
        (LayerFigures("no gain", 0.4, 2, 5e-3, None, "ripple of order 7"), "; residual layer: no gain, off"),
        (
            LayerFigures("on", 0.4, 1, 5.1e-3, 1.9e-3, "ripple of order 7"),
            "; residual layer: ripple of order 7, error 5.10 mrad -> 1.90 mrad, on",
        ),
    ],
)
def test_the_last_line_of_a_run_names_the_layer(figures, words):
    report = first_report("on", "rad", 0.9) | {"residual_layer": asdict(figures)}
    assert learning_words.result(report) == f"re-identified 0 times{words}"


def test_a_layer_is_off_at_once_where_the_position_jumps():
    driven = rippled(1e-3)
    driven.take(WINDOW_TICKS + 14, error=3e-4, true=LAYER.on(LUGRE), amplitude=1.0, seed=1)
    at, before = driven.ticks, len(driven.proposals)

    def slip(rows):
        rows["position"][100:] += 0.01

    driven.take(4, until=Step.BACK, change=slip, error=3e-4, true=LAYER.on(LUGRE), amplitude=1.0, seed=1)
    assert driven.ticks - at <= 4
    _, back = driven.proposals[before]
    assert (back.step, dict(back.model.modifiers)) == (Step.BACK, {})
    assert driven.learner.figures.layer.state == "no longer a gain"


def test_a_report_has_the_figures_of_the_layer_before_anything_was_learned():
    assert first_report("on", "rad", 0.9)["residual_layer"] == asdict(LayerFigures())
