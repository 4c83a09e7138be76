"""Estimates of the parameters of an axis from its ordinary record, and their coordinates."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import friction_hil as fh
from friction_hil.learning.coordinates import coordinates_of, value_of, with_values
from friction_hil.learning.estimate import MECHANICS, Mechanics, estimate, first_belief, lasting
from friction_hil.learning.thresholds import DEFAULT_ERROR
from tests.compensators import INERTIA, LUGRE, MODELS
from tests.learning_records import COUNT, DIRECTED, WRONG, record, window

# coordinates

SHARED = "elasto_plastic"  # one of its parameters is a share: it has an upper bound


@pytest.mark.parametrize("model", [*MODELS.values(), DIRECTED], ids=str)
def test_the_model_at_the_origin_is_the_model_of_the_file(model):
    found = coordinates_of(model, {})
    np.testing.assert_array_equal(found.model_at(np.zeros(len(found.names))).values, model.values)
    assert not {"stribeck_exponent", "weight[0]"} & set(found.names)


@pytest.mark.parametrize("model", [LUGRE, DIRECTED, *(MODELS[name] for name in ("gms", "table", SHARED))], ids=str)
@given(seed=st.integers(0, 1000))
@settings(max_examples=25, deadline=None)
def test_slopes_are_the_derivatives_of_the_parameters(model, seed):
    found = coordinates_of(model, {})
    x = np.random.default_rng(seed).uniform(-0.2, 0.2, len(found.names))
    for k, name in enumerate(found.names):
        step = 1e-6 * np.eye(len(x))[k]
        numeric = (found.at(x + step) - found.at(x - step))[k] / 2e-6
        assert numeric == pytest.approx(found.slopes(x)[k], rel=1e-6, abs=1e-12)
        assert value_of(with_values(model, {name: found.at(x)[k]}), name) == found.at(x)[k]


@pytest.mark.parametrize("name", [SHARED, "lugre"])
@given(x=st.lists(st.floats(-8.0, 8.0), min_size=10, max_size=10))
@settings(max_examples=25, deadline=None)
def test_any_coordinates_are_those_of_a_model(name, x):
    found = coordinates_of(MODELS[name], {})
    x = np.array(x[: len(found.names)])
    model = found.model_at(x)
    values = {each: value_of(model, each) for each in found.names}
    np.testing.assert_allclose(found.at(found.inverse(values)), [*values.values()], rtol=1e-6)


def test_what_is_shown_is_never_a_model_that_does_not_exist():
    """Gamma of a Bouc-Wen model may be negative, but not below -beta: the other values would not go with it."""
    model = fh.models.create("bouc_wen", **{**dict(MODELS["bouc_wen"].given), "beta": 0.6, "gamma": -0.5})
    belief = first_belief(model, Mechanics(INERTIA), {})
    x, covariance = belief.x.copy(), belief.covariance.copy()
    beta, gamma = (belief.coordinates.names.index(name) for name in ("beta", "gamma"))
    x[beta] = x[gamma] = -0.3
    covariance[beta, beta] *= 0.01
    found = replace(belief, x=x, covariance=covariance)
    np.testing.assert_array_equal(found.shown(belief.x), found.x)
    assert found.coordinates.model_at(found.x[:-MECHANICS]).name == "bouc_wen"


def test_standard_errors_of_the_model_file_are_what_is_known_at_first():
    found = coordinates_of(LUGRE, {"coulomb": 0.004, "static": 0.0, "sigma0": math.inf})
    errors = dict(zip(found.names, found.errors.tolist(), strict=True))
    assert (errors["coulomb"], errors["static"]) == pytest.approx((0.05, 0.01))
    assert errors["sigma0"] == errors["sigma2"] == DEFAULT_ERROR


def test_the_estimate_finds_the_true_parameters_within_its_errors():
    belief = first_belief(WRONG, Mechanics(1.05 * INERTIA), {})
    found = estimate(window(record(8.0, seed=1)), belief, COUNT, 2.0).belief
    for name in ("coulomb", "static", "stribeck_velocity"):
        off = abs(found.parameters[name] / value_of(LUGRE, name) - 1.0)
        assert off < max(3.0 * found.errors[name], 0.01), name
        assert off < 0.03, name
    assert found.errors["coulomb"] < 0.05 * DEFAULT_ERROR
    assert abs(1.05 * (1.0 + found.x[-MECHANICS]) - 1.0) < 0.05


def test_what_the_motion_does_not_show_stays_what_it_was():
    """A small slow motion says nothing of viscous friction, a fast one nothing of the bristles."""
    belief = first_belief(WRONG, Mechanics(INERTIA), {})
    slow = estimate(window(record(8.0, amplitude=0.002, seed=1)), belief, COUNT, 2.0).belief
    assert slow.errors["sigma2"] > 0.9 * DEFAULT_ERROR
    assert slow.parameters["sigma2"] == pytest.approx(value_of(WRONG, "sigma2"), rel=0.2)
    assert slow.errors["static"] < 0.1 * DEFAULT_ERROR
    fast = estimate(window(record(8.0, amplitude=3.0, frequency=1.0, seed=1)), belief, COUNT, 2.0).belief
    assert fast.errors["sigma0"] > 0.3 * DEFAULT_ERROR
    assert fast.errors["sigma2"] < 0.1 * DEFAULT_ERROR


def test_errors_cover_what_repeated_records_scatter_by():
    belief = first_belief(WRONG, Mechanics(INERTIA), {})
    found = [estimate(window(record(5.0, seed=seed)), belief, COUNT, 2.0).belief for seed in range(8)]
    scatter = np.std([each.x for each in found], axis=0, ddof=1)
    stated = np.sqrt(np.mean([np.diag(each.covariance) for each in found], axis=0))
    assert np.all(scatter < 2.0 * stated)


def test_age_makes_a_belief_less_sure_but_not_less_than_at_first():
    belief = first_belief(WRONG, Mechanics(INERTIA), {})
    found = estimate(window(record(6.0, seed=1)), belief, COUNT, 2.0).belief
    older = found.older(0.1, 60.0)
    assert found.errors["coulomb"] < older.errors["coulomb"] <= math.hypot(found.errors["coulomb"], 0.1) + 1e-12
    oldest = found.older(0.1, 1e6)
    assert oldest.errors == pytest.approx(belief.errors)
    np.testing.assert_array_equal(oldest.x, found.x)


@pytest.mark.parametrize("noise", [0.0, 0.3, 3.0])
def test_what_lasts_longer_than_a_row_is_told_from_white_noise(noise):
    rows = np.arange(20_000)
    values = np.sqrt(2.0) * np.sin(0.05 * rows) + noise * np.random.default_rng(1).standard_normal(rows.size)
    assert lasting(values, np.ones(rows.size)) == pytest.approx(
        1.0, abs=0.01 + 3.0 * (noise + noise**2) / math.sqrt(rows.size)
    )
