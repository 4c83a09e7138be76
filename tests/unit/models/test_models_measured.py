"""Static maps against a measured speed-current curve of a harmonic drive joint."""

from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import least_squares

import friction_hil as fh

CURVE = Path(__file__).parents[4] / "shared/data/erob/erob_friction.csv"
pytestmark = pytest.mark.skipif(not CURVE.is_file(), reason=f"the measured curve is not here: {CURVE}")


@pytest.fixture(scope="module")
def curve():
    """Speed in rpm and current in mA: a model does not mind its units."""
    return np.loadtxt(CURVE, delimiter=",", skiprows=1).T


@pytest.mark.parametrize("interpolation", ["monotone", "linear"])
def test_a_table_has_all_points_and_nothing_outside_their_range(curve, interpolation):
    speed, current = curve
    table = fh.models.create("table", points=curve.T.tolist(), interpolation=interpolation)
    np.testing.assert_allclose(table.steady_state(speed), current, rtol=1e-12)
    np.testing.assert_allclose(table.steady_state(-speed), -current, rtol=1e-12)
    between = table.steady_state(np.linspace(0.5 * speed[0], 2.0 * speed[-1], 2000))
    assert current.min() - 1e-9 <= between.min() <= between.max() <= current.max() + 1e-9


def test_a_power_law_fits_it_and_viscous_friction_does_not(curve):
    speed, current = curve

    def fit(name, free, start):
        def torque(x):
            model = fh.models.create(name, **dict(zip(free, x, strict=True)))
            return model.simulate_with_gradient(speed, 1.0, free=free)

        bounds = {"bounds": (1e-6, np.inf), "x_scale": "jac"}
        found = least_squares(lambda x: torque(x)[0] - current, start, lambda x: torque(x)[1], **bounds)
        return found.x, np.sqrt(np.mean(found.fun**2))

    (_, _, exponent), rms = fit("power_law", ("coulomb", "factor", "exponent"), (100.0, 10.0, 1.0))
    assert exponent == pytest.approx(0.474, abs=0.002)
    assert rms == pytest.approx(1.6, abs=0.1)
    _, rms = fit("coulomb", ("coulomb", "viscous"), (100.0, 10.0))
    assert rms == pytest.approx(12.5, abs=0.2)
