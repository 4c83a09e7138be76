"""Uncertainty of the compensation: propagated from the errors of the parameters, and filled into recorded rows."""

import math

import numpy as np
import pytest

import friction_hil as fh
from friction_hil.daemon.companion.job import Job
from friction_hil.daemon.companion.uncertainty import UncertaintyColumn
from friction_hil.daemon.control.journal import append, make_journal
from friction_hil.daemon.uncertainty import uncertainty_table
from friction_hil.friction.uncertainty import errors_of, steady_uncertainty
from friction_hil.recordings import columns
from tests.servo_drives import TRUE_FRICTION, axis_dict, configuration

VELOCITY = np.array([-3.0, -0.3, -0.02, 0.02, 0.3, 3.0])
ERRORS = {"coulomb": 2e-3, "static": 4e-3, "stribeck_velocity": 0.02, "sigma2": 1e-4, "sigma0": 50.0}
PAIRS = [("coulomb", "sigma2", -0.7), ("static", "stribeck_velocity", 0.5)]


def test_it_is_the_scatter_of_models_whose_parameters_scatter():
    model = fh.models.create("lugre", **TRUE_FRICTION)
    names, scale = list(ERRORS), 1e-2  # small errors: the torque is linear in them
    correlation = np.eye(len(names))
    for one, other, value in PAIRS:
        i, j = names.index(one), names.index(other)
        correlation[i, j] = correlation[j, i] = value
    deviations = scale * np.array(list(ERRORS.values()))
    covariance = correlation * np.outer(deviations, deviations)
    drawn = np.random.default_rng(1).multivariate_normal(np.zeros(len(names)), covariance, 2000)
    torques = [
        fh.models.create(
            "lugre",
            **{
                name: value + dict(zip(names, row, strict=True)).get(name, 0.0) for name, value in TRUE_FRICTION.items()
            },
        ).steady_state(VELOCITY)
        for row in drawn
    ]
    found = steady_uncertainty(model, VELOCITY, dict(zip(names, deviations, strict=True)), PAIRS)
    np.testing.assert_allclose(found, np.std(torques, axis=0), rtol=0.06)


def test_each_direction_has_its_own_and_what_is_unknown_counts_as_exact():
    directed = {"direction": {"negative": {"coulomb": 0.06}}}
    model = fh.models.create("coulomb", coulomb=0.08, viscous=0.01, modifiers=directed)
    assert "direction.negative.coulomb" in model.free
    found = steady_uncertainty(model, [-1.0, 0.0, 1.0], {"direction.negative.coulomb": 0.003, "another": 1.0})
    np.testing.assert_allclose(found, [0.003, 0.0, 0.0], atol=1e-12)


@pytest.mark.parametrize(
    "fit",
    [
        None,
        {},
        {"standard_errors": None},
        {"standard_errors": {"coulomb": "small", "viscous": math.nan, "static": -1.0}},
    ],
)
def test_a_file_without_errors_gives_none(fit):
    assert errors_of(fit) == ({}, [])
    model = {**axis_dict()["model"], "fit": fit}
    assert uncertainty_table(configuration(x=axis_dict(model=model)).axes["x"]) is None


def axis(**given):
    model = axis_dict()["model"]
    fit = {"standard_errors": ERRORS, "correlations": [list(pair) for pair in PAIRS]}
    return axis_dict(model={**model, "fit": fit}, **given)


def filled(job, journal, state=1.0, **values):
    """The column of rows of axis x with these values and states; no other column is touched."""
    width = len(job.columns) + job.state_width
    rows = np.full((len(values["velocity_estimate"]), width), math.nan)
    rows[:, len(job.columns) :] = state  # fades and factors
    for name, value in values.items():
        rows[:, job.columns.index(name)] = value
    before = rows.copy()
    UncertaintyColumn(job, journal).fill(rows)
    at = job.columns.index(columns.UNCERTAINTY)
    np.testing.assert_array_equal(np.delete(rows, at, axis=1), np.delete(before, at, axis=1))
    return rows[:, at]


def test_rows_get_the_uncertainty_of_the_model_and_the_gain_in_force():
    given = configuration(x=axis(compensation={"gain": 0.9, "gain_negative": 0.5}))
    table = uncertainty_table(given.axes["x"])
    model = given.axes["x"].model.friction_model
    metadata = {"configuration": {"axes": {"x": {"compensation": {"gain": 0.9, "gain_negative": 0.5}}}}}
    job = Job(["x"], list(columns.NAMES), 2, 1e-3, 0, metadata=metadata, uncertainty={"x": table}, factors=[0, 1])
    journal = make_journal()
    whole = steady_uncertainty(model, VELOCITY, ERRORS, PAIRS)
    found = filled(job, journal, velocity_estimate=VELOCITY, change=0.0)
    np.testing.assert_allclose(found, np.where(VELOCITY > 0.0, 0.9, 0.5) * whole, rtol=0.05)
    wider = {**table, "forward": [10.0 * each for each in table["forward"]]}
    settings = {"compensation": {"gain": 1.0, "gain_negative": None}}
    append(journal, {"number": 3, "axes": {"x": {**settings, "model_of": 3, "uncertainty": wider}}})
    append(journal, {"number": 4, "axes": {"x": {**settings, "model_of": 4}}})  # a model without known errors
    found = filled(job, journal, velocity_estimate=VELOCITY, change=[3.0, 3.0, 4.0, 3.0, 0.0, 5.0])
    expected = whole * np.array([1.0, 1.0, math.nan, 10.0, 0.9, math.nan])
    np.testing.assert_allclose(found, expected, rtol=0.05)


def test_what_is_faded_out_is_certain_and_a_row_without_values_has_none():
    metadata = {"configuration": {"axes": {"x": {"compensation": {"gain": 1.0, "gain_negative": None}}}}}
    table = uncertainty_table(configuration(x=axis()).axes["x"])
    job = Job(["x"], list(columns.NAMES), 2, 1e-3, 0, metadata=metadata, uncertainty={"x": table}, factors=[1])
    state = [[1.0, 1.0], [1.0, 0.25], [1.0, 0.0], [math.nan, math.nan], [1.0, 1.0]]
    velocity = [1.0, 1.0, 1.0, 1.0, math.nan]
    whole, part, none, *unknown = filled(job, make_journal(), state, velocity_estimate=velocity, change=0.0)
    assert (part, none) == (pytest.approx(0.25 * whole), 0.0)
    assert whole > 0.0
    assert np.isnan(unknown).all()
