"""What is told of the compensation: its uncertainty in recorded rows, and before a run what adaptation will learn."""

import json
import math

import numpy as np
import pytest
import yaml

import friction_hil as fh
from friction_hil.cli import main
from friction_hil.daemon.adaptation_check import adaptation_problem
from friction_hil.daemon.companion.job import Job
from friction_hil.daemon.companion.uncertainty import UncertaintyColumn
from friction_hil.daemon.control.journal import append, make_journal
from friction_hil.daemon.notices import adaptation_notice
from friction_hil.daemon.uncertainty import uncertainty_table
from friction_hil.friction.uncertainty import errors_of, steady_uncertainty
from friction_hil.recordings import columns
from friction_hil.servo.config import Encoder, ServoConfig
from tests.servo_drives import PERIOD_S, TRUE_FRICTION, ServoDrives, axis_dict, configuration, make_loop

VELOCITY = np.array([-3.0, -0.3, -0.02, 0.02, 0.3, 3.0])
ERRORS = {"coulomb": 2e-3, "static": 4e-3, "stribeck_velocity": 0.02, "sigma2": 1e-4, "sigma0": 50.0}
PAIRS = [("coulomb", "sigma2", -0.7), ("static", "stribeck_velocity", 0.5)]


def test_it_is_the_scatter_of_models_whose_parameters_scatter():
    names, scale = list(ERRORS), 1e-2  # small errors: the torque is linear in them
    correlation = np.eye(len(names))
    for one, other, value in PAIRS:
        i, j = names.index(one), names.index(other)
        correlation[i, j] = correlation[j, i] = value
    deviations = scale * np.array(list(ERRORS.values()))
    covariance = correlation * np.outer(deviations, deviations)
    mean = [TRUE_FRICTION[name] for name in names]
    drawn = np.random.default_rng(1).multivariate_normal(mean, covariance, 2000)
    models = [fh.models.create("lugre", **TRUE_FRICTION | dict(zip(names, row, strict=True))) for row in drawn]
    errors = dict(zip(names, deviations, strict=True))
    found = steady_uncertainty(fh.models.create("lugre", **TRUE_FRICTION), VELOCITY, errors, PAIRS)
    np.testing.assert_allclose(found, np.std([each.steady_state(VELOCITY) for each in models], axis=0), rtol=0.06)


def test_each_direction_has_its_own_and_what_is_unknown_counts_as_exact():
    directed = {"direction": {"negative": {"coulomb": 0.06}}}
    model = fh.models.create("coulomb", coulomb=0.08, viscous=0.01, modifiers=directed)
    assert "direction.negative.coulomb" in model.free
    found = steady_uncertainty(model, [-1.0, 0.0, 1.0], {"direction.negative.coulomb": 0.003, "another": 1.0})
    np.testing.assert_allclose(found, [0.003, 0.0, 0.0], atol=1e-12)


UNUSABLE = {"coulomb": "small", "viscous": math.nan, "static": -1.0}


@pytest.mark.parametrize("fit", [None, {}, {"standard_errors": None}, {"standard_errors": UNUSABLE}])
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


def job_of(table, factors, **compensation):
    metadata = {"configuration": {"axes": {"x": {"compensation": compensation}}}}
    return Job(["x"], list(columns.NAMES), 2, 1e-3, 0, metadata=metadata, uncertainty={"x": table}, factors=factors)


def test_rows_get_the_uncertainty_of_the_model_and_the_gain_in_force():
    gains = {"gain": 0.9, "gain_negative": 0.5}
    given = configuration(x=axis(compensation=gains)).axes["x"]
    table, journal = uncertainty_table(given), make_journal()
    job = job_of(table, [0, 1], **gains)
    whole = steady_uncertainty(given.model.friction_model, VELOCITY, ERRORS, PAIRS)
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
    job = job_of(uncertainty_table(configuration(x=axis()).axes["x"]), [1], gain=1.0, gain_negative=None)
    state = [[1.0, 1.0], [1.0, 0.25], [1.0, 0.0], [math.nan, math.nan], [1.0, 1.0]]
    velocity = [1.0, 1.0, 1.0, 1.0, math.nan]
    whole, part, none, *unknown = filled(job, make_journal(), state, velocity_estimate=velocity, change=0.0)
    assert (part, none) == (pytest.approx(0.25 * whole), 0.0)
    assert whole > 0.0
    assert np.isnan(unknown).all()


ADAPTING = {"fade_s": 0.1, "adaptation": {"time_s": 5.0}}
SINE = {"kind": "sine", "ramp_s": 0.25}
TRIANGLE = {"kind": "triangle"}
MOTIONS = {
    "fast": {**SINE, "amplitude": 0.5, "frequency": 0.5},
    "slow": {**SINE, "amplitude": 0.05, "frequency": 0.5},
    "short": {**SINE, "amplitude": 0.02, "frequency": 20.0},
    "steady": {**TRIANGLE, "amplitude": 0.5, "frequency": 0.5},
    "creeping": {**TRIANGLE, "amplitude": 0.1, "frequency": 0.5},
    "hold": {"kind": "hold"},
    "strokes": {"kind": "strokes", "stroke": 0.5, "frequency": 0.5, "rest": 0.2},
}


def adapting(trajectory, bits, **changes):
    changes = {"compensation": ADAPTING, "simulation": {"encoder": {"counts": 2**bits}}, **changes}
    return configuration(x=axis_dict(trajectory=trajectory, **changes))


@pytest.mark.deep
@pytest.mark.parametrize("bits", [14, 20])
@pytest.mark.parametrize("name", MOTIONS)
def test_it_is_said_before_a_run_what_the_run_says_at_its_end(name, bits) -> None:
    config = adapting(MOTIONS[name], bits)
    drives = ServoDrives(config, servo=ServoConfig(encoder=Encoder(counts=2**bits)))
    loop, _, [axis] = make_loop(config, drives, duration_s=2.5)
    loop.run()

    notice = adaptation_notice("x", "rad", axis.compensator)
    problem = adaptation_problem("x", config.axes["x"], PERIOD_S)

    assert (problem is None) == (notice is None)
    if problem is not None:
        assert problem.partition(": ")[2] == notice.partition("nothing: ")[2], "the same words"


@pytest.mark.parametrize(
    ("trajectory", "bits", "changes"),
    [
        (MOTIONS["slow"], 14, {"compensation": {"fade_s": 0.1}}),
        (MOTIONS["slow"], 14, {"simulation": None}),
        (MOTIONS["slow"], 14, {"compensation": {**ADAPTING, "enabled": False}}),
        (MOTIONS["slow"], 14, {"counts_per_unit": 1e6}),  # they come before those of a simulation
        ({"kind": "none"}, 14, {"mode": "cst", "limits": {"torque": 0.3, "velocity": 30.0}}),
        ({"kind": "experiment", "velocity": 1e-3, "travel": 1e-3, "duration_s": 10.0}, 10, {}),
    ],
)
def test_nothing_is_said_where_it_is_not_known(trajectory, bits, changes) -> None:
    assert adaptation_problem("x", adapting(trajectory, bits, **changes).axes["x"], PERIOD_S) is None
    assert adaptation_problem("x", adapting(MOTIONS["slow"], 14).axes["x"], PERIOD_S) is not None


def test_config_check_has_a_note_with_the_line_and_succeeds(tmp_path, capsys) -> None:
    simulation = {"encoder": {"counts": 16384}}
    axis = axis_dict(compensation=ADAPTING, trajectory=MOTIONS["slow"], simulation=simulation)
    bus = {"interface": "virtual", "channel": "adaptation-check"}
    file = tmp_path / "machine.yaml"
    file.write_text(yaml.safe_dump({"version": 1, "period_s": 1e-3, "bus": bus, "axes": {"x": axis}}, sort_keys=False))
    [line] = [k for k, text in enumerate(file.read_text().splitlines(), 1) if "adaptation:" in text]

    assert main(["config", "check", str(file)]) == 0
    text = " ".join(capsys.readouterr().out.split())
    assert f"note: {file}:{line}: axes.x.compensation.adaptation: " in text
    assert main(["config", "check", "--json", str(file)]) == 0
    [found] = json.loads(capsys.readouterr().out)["files"]
    assert [(each["line"], each["field"]) for each in found["notes"]] == [(line, "axes.x.compensation.adaptation")]
