"""Parts of the identification: filters, search, projection, uncertainty, free simulation."""

import math

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import optimize, signal

import friction_hil as fh
from friction_hil.errors import UsageError
from friction_hil.identification import structures
from friction_hil.identification.data import Data, prepare
from friction_hil.identification.free_run import cascade, simulate_axis
from friction_hil.identification.inference import infer
from friction_hil.identification.least_squares import minimise_bounded
from friction_hil.identification.regression import Estimate, Regression
from friction_hil.identification.scales import estimate_scales
from friction_hil.models.model_file import ModelFile
from friction_hil.numerics import filtering
from friction_hil.recordings import Recording

Array = NDArray[np.float64]
RATE_HZ = 500.0


def data(lowpass_hz: float | None = None) -> Data:
    """Torque of LuGre along swings that reverse, with noise."""
    time = np.arange(5000) / RATE_HZ
    velocity = 2.0 * np.cos(5.0 * time) * (0.1 + np.abs(np.sin(0.7 * time))) + 0.3 * np.cos(40.0 * time)
    position = np.cumsum(velocity) / RATE_HZ
    levels = {"coulomb": 0.3, "static": 0.45, "stribeck_velocity": 0.3}
    model = fh.models.create("lugre", sigma0=40.0, sigma1=0.3, sigma2=0.05, **levels)
    torque = model.simulate(velocity, 1.0 / RATE_HZ) + 0.02 * np.gradient(velocity, 1.0 / RATE_HZ)
    torque += 0.02 * np.random.default_rng(0).normal(size=len(time))
    columns = {"time_s": time, "position": position, "velocity": velocity, "torque": torque}
    return Data(prepare(Recording("made.csv", "x", columns), lowpass_hz=lowpass_hz, decimation=5))


@pytest.mark.parametrize("columns", [1, 3, 8])
@pytest.mark.parametrize("cutoff_hz", [0.5, 40.0, 499.0])
def test_lowpass_is_that_of_scipy(columns: int, cutoff_hz: float) -> None:
    values = np.cumsum(np.random.default_rng(0).normal(size=(3000, columns)), axis=0)
    sections = signal.butter(4, cutoff_hz / 500.0, output="sos")
    expected = signal.sosfiltfilt(sections, values, axis=0, padlen=12)
    filtered = filtering.lowpass(values, cutoff_hz, 1000.0)
    np.testing.assert_allclose(filtered, expected, rtol=0.0, atol=1e-10 * np.ptp(values))
    np.testing.assert_array_equal(filtering.lowpass(values[:, 0], cutoff_hz, 1000.0), filtered[:, 0])


@pytest.mark.parametrize("factor", [2, 7, 100])
def test_decimation_is_that_of_scipy(factor: int) -> None:
    values = np.cumsum(np.random.default_rng(0).normal(size=(3000, 2)), axis=0)
    sections = signal.cheby1(8, 0.05, 0.8 / factor, output="sos")
    expected = signal.sosfiltfilt(sections, values, axis=0, padlen=24)[(3000 - 1) % factor :: factor]
    np.testing.assert_allclose(filtering.decimate(values, factor), expected, rtol=0.0, atol=1e-10 * np.ptp(values))
    np.testing.assert_array_equal(filtering.decimate(values, 1), values)


def test_a_record_shorter_than_the_filter_is_refused() -> None:
    with pytest.raises(ValueError, match="12 samples"):
        filtering.lowpass(np.zeros(12), 40.0, 1000.0)


def rosenbrock(at: Array) -> tuple[Array, Array]:
    x, y = at
    return np.array([10.0 * (y - x * x), 1.0 - x]), np.array([[-20.0 * x, 10.0], [-1.0, 0.0]])


@pytest.mark.parametrize(
    ("lower", "upper"),
    [((-5.0, -5.0), (5.0, 5.0)), ((-5.0, -5.0), (0.5, 5.0)), ((-5.0, 1.5), (5.0, 5.0)), ((-2.0, -5.0), (5.0, 0.2))],
)
def test_search_agrees_with_scipy_inside_and_at_bounds(lower: tuple[float, ...], upper: tuple[float, ...]) -> None:
    start = np.clip([0.4, 1.6], lower, upper)  # in the valley of the lowest minimum
    found = minimise_bounded(rosenbrock, start, np.array(lower), np.array(upper), evaluations=300, tolerance=1e-14)
    inside = np.clip(start, np.array(lower) + 1e-3, np.array(upper) - 1e-3)
    wanted = optimize.least_squares(lambda at: rosenbrock(at)[0], inside, bounds=(lower, upper), xtol=1e-14)
    np.testing.assert_allclose(found.at, wanted.x, atol=1e-5)
    assert found.is_converged


def test_search_survives_where_there_is_no_model() -> None:
    """A residual that is not finite beyond 2 is stepped back from."""

    def residual(at: Array) -> tuple[Array, Array]:
        if at[0] > 2.0:
            return np.array([math.nan]), np.array([[0.0]])
        return np.array([np.log(3.0 - at[0]) - 0.5]), np.array([[-1.0 / (3.0 - at[0])]])

    found = minimise_bounded(residual, np.array([-40.0]), np.array([-50.0]), np.array([50.0]))
    assert found.at[0] == pytest.approx(3.0 - math.exp(0.5), rel=1e-6)


@pytest.mark.parametrize("lowpass_hz", [None, 60.0])
@pytest.mark.parametrize("is_directed", [False, True])
@pytest.mark.parametrize("family", ["lugre", "gms", "bouc_wen", "table", "power_law"])
def test_gradient_is_that_of_the_filtered_torque(family: str, is_directed: bool, lowpass_hz: float | None) -> None:
    """Against central differences, through models, logarithms, ties, low-pass and decimator."""
    measured = data(lowpass_hz)
    sizes = estimate_scales(measured, ("inertia", "offset"))
    structure = structures.build(family, sizes, "rotary", 1.0 / RATE_HZ, is_directed=is_directed)
    regression = Regression(measured, structure, ["inertia"])
    start = next(structures.starts(structure, sizes, 0, 0))
    at = np.array([each.inner(start[each.name]) for each in structure.coordinates])
    at = np.where(at == 0.0, 0.01, at)
    _, gradient = regression.friction(at)
    for i in range(len(at)):
        step = 1e-6 * max(abs(at[i]), 0.1)
        high, low = at.copy(), at.copy()
        high[i] += step
        low[i] -= step
        difference = (regression.friction_torque(high) - regression.friction_torque(low)) / (2.0 * step)
        error = np.linalg.norm(gradient[:, i] - difference)
        assert error <= 2e-3 * np.linalg.norm(difference) + 1e-7, structure.coordinates[i].name


def test_projected_search_ends_where_the_joint_one_does() -> None:
    measured = data()
    sizes = estimate_scales(measured, ("inertia", "offset"))
    structure = structures.build("dahl", sizes, "rotary", 1.0 / RATE_HZ, is_directed=False)
    regression = Regression(measured, structure, ["inertia", "offset"])
    start = next(structures.starts(structure, sizes, 0, 0))
    estimate = regression.estimate(np.array([each.inner(start[each.name]) for each in structure.coordinates]))
    columns = np.column_stack([measured.column(key) for key in regression.keys.values()])

    def residual(at: Array) -> Array:
        return regression.friction_torque(at[:2]) + columns @ at[2:] - measured.torque

    joint = optimize.least_squares(residual, [*estimate.coordinates + 0.05, *np.zeros(columns.shape[1])], xtol=1e-12)
    for coordinate, value in zip(structure.coordinates, joint.x[:2], strict=True):
        assert estimate.values[coordinate.name] == pytest.approx(coordinate.outer(value), rel=1e-3)
    assert list(regression.keys) == ["inertia", "offset", "viscous"]
    for name, value in zip(regression.keys, joint.x[2:], strict=True):
        assert estimate.values[name] == pytest.approx(value, rel=1e-3, abs=1e-5)


def estimate_of(residual: Array, jacobian: Array, *names: str) -> Estimate:
    """An estimate that ended with this residual."""
    values, none = dict.fromkeys(names, 1.0), np.empty(0)
    return Estimate(values, none, (), (), residual, jacobian, names, np.ones(len(residual)), True)


def test_errors_of_correlated_residuals_are_honest():
    """A mean of first-order noise: the ordinary standard error is too small by a factor of three."""
    random, stated, means = np.random.default_rng(0), [], []
    rows, rho = 4000, 0.8
    for _ in range(60):
        noise = signal.lfilter([1.0], [1.0, -rho], random.normal(size=rows))
        estimate = estimate_of(noise - noise.mean(), np.ones((rows, 1)), "offset")
        stated.append(infer(estimate, [slice(0, rows)]).standard_errors["offset"])
        means.append(noise.mean())
    assert np.mean(stated) == pytest.approx(np.std(means), rel=0.3)


def test_exact_collinearity_has_no_error():
    x = np.random.default_rng(0).normal(size=500)
    jacobian = np.column_stack([x, -2.0 * x, np.ones(500)])
    estimate = estimate_of(np.random.default_rng(1).normal(size=500), jacobian, "a", "b", "c")
    errors = infer(estimate, [slice(0, 500)]).standard_errors
    assert errors["a"] == errors["b"] == math.inf
    assert errors["c"] == pytest.approx(1.0 / math.sqrt(500), rel=0.3)


def axis(**content: object) -> ModelFile:
    friction = {"model": "coulomb", "parameters": {"coulomb": 0.0, **content}}
    return ModelFile.model_validate({"axis": "rotary", "friction": friction, "mechanics": {"inertia": 2.0}})


def test_free_run_follows_the_closed_form() -> None:
    """Inertia and damper under a constant torque: v = T/c (1 - exp(-c t / J))."""
    run = simulate_axis(axis(viscous=0.5), lambda *_: 1.0, 4000, 1e-3)
    time = np.arange(4000) * 1e-3
    np.testing.assert_allclose(run.velocity, 2.0 * (1.0 - np.exp(-0.25 * time)), atol=1e-3)


def test_free_run_sticks_below_break_away_and_comes_to_rest_for_good():
    """Without torque it stops after J v^2 / (2 Fc), and exactly."""
    run = simulate_axis(axis(coulomb=1.0), lambda sample, *_: 0.9 if sample < 500 else 1.5, 1000, 1e-3)
    assert np.all(run.velocity[:500] == 0.0)
    assert run.velocity[-1] == pytest.approx(0.25 * 0.499, rel=0.02)
    run = simulate_axis(axis(coulomb=1.0), lambda *_: 0.0, 2000, 1e-3, velocity=0.5)
    assert np.all(run.velocity[1100:] == 0.0)
    assert run.position[-1] == pytest.approx(0.25, rel=0.01)


def test_free_run_in_its_loop_reaches_the_demand_and_reports_its_error() -> None:
    demand = np.full(4000, 0.5)
    run = simulate_axis(axis(viscous=0.1), cascade(demand, 5.0, 40.0), 4000, 1e-3)
    assert run.position[-1] == pytest.approx(0.5, abs=1e-3)
    assert run.relative_error(run.torque) == 0.0
    assert run.relative_error(2.0 * run.torque) == pytest.approx(0.5)


def test_free_run_needs_an_inertia_and_a_loop_that_holds() -> None:
    massless = axis().model_copy(update={"mechanics": type(axis().mechanics)()})
    with pytest.raises(UsageError, match="inertia above zero"):
        simulate_axis(massless, lambda *_: 0.0, 10, 1e-3)
    with pytest.raises(UsageError, match="without bound"):
        simulate_axis(axis(), lambda _, q, v: 1e9 * (q + v) + 1.0, 4000, 1e-3)
