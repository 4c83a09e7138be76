"""Grid files of ``tools/bench compensation``: mistakes in them, and what their compensators believe."""

import numpy as np
import pytest

import friction_hil as fh
from friction_hil.errors import ConfigurationError, UsageError
from tests.compensation_grids import LUGRE, TINY, grid_of
from tools.benchmarks.compensation import REFERENCE, load
from tools.benchmarks.compensation.belief import converted
from tools.benchmarks.compensation.simulation import Simulation

pytestmark = pytest.mark.deep  # of the tools, not of the product


@pytest.mark.parametrize("name", ["coulomb", "stribeck", "dahl", "gms", "lugre"])
def test_another_family_has_the_friction_of_the_first(name):
    own = fh.models.create("gms", **fh.models.describe("gms").example, modifiers={"viscous": {"quadratic": 1e-3}})
    other = converted(own, name)
    speeds = [-20.0, 5.0, 20.0, *([0.1] if name in ("stribeck", "lugre") else [])]
    np.testing.assert_allclose(other.steady_state(speeds), own.steady_state(speeds), rtol=1e-9)
    if not other.family.is_static:
        assert other.presliding_stiffness == pytest.approx(own.presliding_stiffness, rel=1e-3)
    with pytest.raises(UsageError, match="breakaway_ratio"):
        converted(own, "elasto_plastic")


@pytest.mark.parametrize(
    ("old", "new", "line", "message"),
    [
        ("inertia: 2e-4", "inertia: -2e-4", 3, "plants.servo.inertia: must be above 0 kg m^2"),
        ("inertia: 2e-4", "inertia: 2e-4\n    bits: 3", 4, "plants.servo.bits: is not a key here; there are: backlash"),
        ("model: lugre\n", "model: lugrr\n", 5, "did you mean 'lugre'"),
        ("sigma0: 2000.0", "sigma0: 0.0", 6, "parameters.sigma0"),
        ("inertia: 2e-4", "backlash: 0.1\n    inertia: 2e-4", 3, "backlash: needs compliance"),
        ("inertia: 2e-4", "drives: [soft, stif]\n    inertia: 2e-4", 3, "drives[1]: no drive is called 'stif'; did"),
        ("velocity_gain: 0.2", "velocity_gain: [1]", 9, "drives.stiff.velocity_gain: must be a number"),
        ("integral_hz: 16.0, ", "", 8, "drives.soft.integral_hz: is missing"),
        ("rate_hz: 8000", "rate_hz: 8300", 8, "rate_hz: must be a multiple of 1 / period_s = 1000 Hz"),
        ("frequency: 2.0", "frequency: 2.0, corner: 0.2", 11, "motions[0].corner: belongs to kind: triangle"),
        ("frequency: 2.0}", "frequency: 2.0}\n  - {amplitude: 0.05, frequency: 2.0}", 12, "is there already"),
        ("frequency: 2.0", "frequency: 2.0, kind: zigzag", 11, "motions[0].kind: must be 'cosine', 'multisine'"),
        ("exact: {}", "exact: {encoder_bits: 14.5}", 13, "encoder_bits: must be a whole number"),
        ("gain: 0.9", "gain: 1:30", 15, "conditions.off.gain: must be a number"),
        ("static: 0.1}", "viscous: 0.1}", 16, "friction.parameters.viscous: plant servo: lugre has no parameter"),
        ("coulomb: 0.85", "attraction: 0.85", 16, "factors.attraction: is no parameter of any of the models"),
        ("compensator: {model: lugre", "compensator: {model: lugr", 17, "compensator.model: no friction model is"),
        ("compensator: {model: lugre", "compensator: {model: karnopp", 17, "needs stick_velocity"),
        ("inertia_error: 0.05", "smoothing: 0.01", 17, "compensator: smoothing = 0.01 delays"),
        ("settling_s: 0.3", "settling_s: 0.6", 19, "settling_s: leaves nothing to score"),
    ],
)
def test_mistake_in_a_grid_file_is_reported_with_its_place(tmp_path, old, new, line, message):
    assert TINY.count(old) == 1
    with pytest.raises(ConfigurationError) as caught:
        grid_of(tmp_path, TINY.replace(old, new))
    (problem,) = caught.value.problems
    assert problem.line == line
    assert message in str(problem)


def test_reference_grid_is_that_of_the_reference():
    grid = load(REFERENCE)
    assert len(Simulation(grid).cases()) == 60
    assert grid.plants["reference"].friction.model_dump()["parameters"] == LUGRE["parameters"]
    gains = {"exact": 1.0, "gain_0.9": 0.9, "mismatch_a": 0.9, "mismatch_b": 0.9, "encoder_14": 1.0, "two_cycles": 1.0}
    assert {name: condition.gain for name, condition in grid.conditions.items()} == gains
