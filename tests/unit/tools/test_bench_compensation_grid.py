"""Grid files of ``tools/bench compensation``: mistakes in them, and what their compensators believe."""

import numpy as np
import pytest

import friction_hil as fh
from friction_hil.errors import ConfigurationError, UsageError
from tests.compensation_grids import LUGRE, TINY, grid_of
from tools.benchmarks.compensation import REFERENCE, load
from tools.benchmarks.compensation.belief import changed, converted
from tools.benchmarks.compensation.simulation import Simulation

pytestmark = pytest.mark.deep  # of the tools, not of the product

# what the compensator believes


@pytest.mark.parametrize("name", ["coulomb", "stribeck", "dahl", "elasto_plastic", "gms", "lugre"])
def test_another_family_has_the_friction_of_the_first(name):
    own = fh.models.create("gms", **fh.models.describe("gms").example, modifiers={"viscous": {"quadratic": 1e-3}})
    given = {"breakaway_ratio": 0.5} if name == "elasto_plastic" else {}
    if given:
        with pytest.raises(UsageError, match="breakaway_ratio"):
            converted(own, name)
        return
    other = converted(own, name)
    fast = [-20.0, 5.0, 20.0]
    np.testing.assert_allclose(other.steady_state(fast), own.steady_state(fast), rtol=1e-9)
    if not other.family.is_static:
        assert other.presliding_stiffness == pytest.approx(own.presliding_stiffness, rel=1e-3)
    if name in ("stribeck", "lugre"):
        np.testing.assert_allclose(other.steady_state([0.1]), own.steady_state([0.1]), rtol=1e-9)


def test_each_direction_is_converted_by_itself():
    sides = {"positive": {"sigma2": 4e-3, "coulomb": 0.1}, "negative": {"coulomb": 0.06}}
    own = fh.models.create("lugre", **LUGRE["parameters"], modifiers={"direction": sides})
    for name in ("gms", "stribeck"):
        fast = [-9.0, 9.0]
        np.testing.assert_allclose(converted(own, name).steady_state(fast), own.steady_state(fast), rtol=1e-9)


def test_factors_reach_synonyms_lists_defaults_and_directions():
    own = fh.models.create(
        "gms", **fh.models.describe("gms").example, modifiers={"direction": {"positive": {"coulomb": 0.1}}}
    )
    other = changed(own, {"static": 0.2}, {"sigma0": 0.5, "sigma2": 3.0, "coulomb": 2.0}, None)
    assert other.parameters["stiffness"] == [800.0, 280.0, 100.0, 30.0]
    assert other.parameters["viscous"] == pytest.approx(6e-3)
    assert (other.parameters["static"], other.parameters["attraction"]) == (0.2, 10.0)
    assert other.modifiers["direction"] == {"positive": {"coulomb": 0.2}}
    assert changed(own, {}, {}, {}).modifiers == {}
    plain = fh.models.create("coulomb", coulomb=0.1)
    assert changed(plain, {}, {"coulomb": 2.0}, None).parameters["static"] == 0.2  # the default follows


# grid files


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


def test_several_mistakes_are_reported_at_once(tmp_path):
    text = TINY.replace("gain: 0.9", "gain: 9").replace("amplitude: 0.05", "amplitude: 0.0").replace("16.0", "x")
    with pytest.raises(ConfigurationError) as caught:
        grid_of(tmp_path, text)
    assert [problem.line for problem in caught.value.problems] == [8, 11, 15]


@pytest.mark.parametrize("text", ["", "[]", "plants", "plants: 1\ndrives: {a: 1, b: []}\n", "drives:\n", "drives: {}"])
def test_what_is_no_grid_is_an_error(tmp_path, text):
    with pytest.raises(ConfigurationError):
        grid_of(tmp_path, text)


def test_reference_grid_is_that_of_the_reference():
    grid = load(REFERENCE)
    assert len(Simulation(grid).cases()) == 60
    assert grid.plants["reference"].friction.model_dump()["parameters"] == LUGRE["parameters"]
    assert {name: condition.gain for name, condition in grid.conditions.items()} == {
        "exact": 1.0,
        "gain_0.9": 0.9,
        "mismatch_a": 0.9,
        "mismatch_b": 0.9,
        "encoder_14": 1.0,
        "two_cycles": 1.0,
    }


def test_other_plants_have_bandwidths_of_the_reference_where_they_say_so():
    grid = load(REFERENCE.with_name("others.yaml"))
    reference = grid.plants["reference"]
    assert {name: getattr(reference, name) for name in ("inertia", "friction")} == {
        name: getattr(load(REFERENCE).plants["reference"], name) for name in ("inertia", "friction")
    }
    for name in ("inertia_2e-5", "inertia_2e-3"):
        for own, drive in zip(grid.drives_of(name), ("soft", "stiff"), strict=True):
            bandwidth = grid.drives[own].velocity_gain / grid.plants[name].inertia
            assert bandwidth == pytest.approx(grid.drives[drive].velocity_gain / reference.inertia)
    for plant in grid.plants:
        if not plant.startswith("inertia"):
            assert grid.plants[plant].total_inertia == pytest.approx(reference.inertia)
    wrong = grid.believed("gms", "mismatch_a").parameters
    assert wrong["stiffness"][0] == pytest.approx(1.3 * 800.0)
