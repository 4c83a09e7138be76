"""Models in two steps: which parameters the slow sweeps give, and what a wrong steady curve counts."""

from dataclasses import dataclass, replace
from types import SimpleNamespace

import numpy as np
import pytest

from friction_hil.friction import create, names
from friction_hil.identification import Identification, humps
from friction_hil.identification.choice import choose
from friction_hil.identification.structures import InitialScales, ModelStructure, build
from friction_hil.tuning.two_steps import steady_curve, steady_weights, with_steady_curve
from tests.unit.identification.test_identification import found, plain, recorded


@dataclass(frozen=True)
class SimpleFit:
    """What `friction_hil.identification.humps.upright` needs of a fit."""

    structure: ModelStructure
    values: dict
    coordinates: np.ndarray


MECHANICS = {"inertia": 2e-4, "offset": 0.0}
LUGRE = {
    **{"sigma0": 2000.0, "sigma1": 1.0, "sigma2": 0.002, "coulomb": 0.08, "static": 0.12},
    **{"stribeck_velocity": 0.2, "damping_velocity": 0.2},
}


def fit(family, values, curves=None):
    structure = SimpleNamespace(family=family, modifiers=(), axis="rotary")
    given = {"mechanics": MECHANICS, "held_out": SimpleNamespace(rmse=1.0), "friction": (values, {}), "curves": curves}
    return SimpleNamespace(structure=structure, values=values, **given)


@pytest.fixture(scope="module")
def sliding() -> Identification:
    return found(recorded("stribeck", noise=0.01), families=("coulomb", "stribeck", "table"))


@pytest.mark.parametrize(("family", "viscous"), [("lugre", "sigma2"), ("gms", "viscous")])
def test_the_curve_is_that_of_the_chosen_stribeck_fit(sliding, family, viscous):
    best = plain(sliding, "stribeck")
    levels = {name: best.values[name] for name in ("coulomb", "static", "stribeck_velocity")}
    expected = {"inertia": best.mechanics["inertia"], **levels, viscous: best.values["viscous"]}
    assert steady_curve([sliding], family) == expected
    assert set(with_steady_curve(names())) == {"lugre", "elasto_plastic", "gms"}


def test_a_modifier_that_predicts_slightly_better_does_not_take_the_curve_away(sliding) -> None:
    """A quadratic viscous part that lowers the held-out error by chance must leave the levels as they are."""
    best = plain(sliding, "stribeck")
    error = replace(best.held_out, rmse=0.99 * best.held_out.rmse)
    modified = replace(
        best, structure=replace(best.structure, modifiers=("viscous",)), across_speeds=error, cross_validation=error
    )
    fits = (modified, *sliding.fits)
    assert steady_curve([replace(sliding, fits=fits)], "lugre") == steady_curve([sliding], "lugre")


def test_a_hump_that_the_rows_determine_stays_though_coulomb_predicts_them_as_well(sliding) -> None:
    """The hump is highest where the axis breaks away, in rows that do not count."""
    humped, level = plain(sliding, "stribeck"), plain(sliding, "coulomb")
    error = humped.held_out
    level = replace(level, across_speeds=error, cross_validation=error, validation=None)
    assert choose((humped, level))[0] is level
    assert steady_curve([replace(sliding, fits=(humped, level))], "lugre") == steady_curve([sliding], "lugre")


def test_levels_of_each_direction_keep_their_sides_and_a_missing_hump_is_flat(sliding) -> None:
    best = plain(sliding, "coulomb")
    sides = {"direction.positive.coulomb": 0.1, "direction.negative.coulomb": 0.06, "direction.positive.viscous": 0.001}
    directed = replace(best, values=sides, structure=replace(best.structure, coordinates=(), modifiers=("direction",)))
    held = steady_curve([replace(sliding, fits=(directed,))], "lugre")
    assert held["direction.positive.static"] == held["direction.positive.coulomb"] == 0.1
    assert held["direction.negative.static"] == 0.06
    assert held["direction.positive.sigma2"] == 0.001


def test_without_a_plain_fit_there_is_no_curve(sliding) -> None:
    best = sliding.best
    rippled = replace(best, structure=replace(best.structure, modifiers=("ripple",)))
    assert steady_curve([replace(sliding, fits=())], "lugre") == {}
    assert steady_curve([replace(sliding, fits=(rippled,))], "lugre") == {}


def test_a_fit_that_is_wrong_where_the_axis_slides_is_less_likely() -> None:
    velocity = np.concatenate([np.linspace(-3.0, -0.02, 200), np.linspace(0.02, 3.0, 200)])
    true = create("lugre", **LUGRE).steady_state(velocity)
    noise = 1e-3 * np.random.default_rng(1).normal(size=true.size)
    curves = SimpleNamespace(velocity=velocity, friction=true, residual=noise)
    static = fit("stribeck", {}, curves=curves)
    right, flat = fit("lugre", LUGRE), fit("lugre", LUGRE | {"static": 0.08})
    weights = steady_weights({0: right, 1: flat}, [SimpleNamespace(fits=(static,), best=static)])
    assert weights[0] == 1.0
    assert weights[1] < 0.1


def test_a_search_for_a_hump_begins_above_the_coulomb_level_and_stays_there() -> None:
    scales = InitialScales(0.1, 0.15, 2.0, 1.0, (1e-4,), (0.1,), (0.1, 0.5, 2.0), 0.01, 0.3)
    structure = build("lugre", scales, "rotary", 1e-3, is_directed=False)
    dip = {"coulomb": 0.08, "static": 0.004, "stribeck_velocity": 0.003, "sigma0": 1e3, "sigma1": 1.0}
    narrow = SimpleFit(structure, dip, np.array([each.inner(dip[each.name]) for each in structure.coordinates]))
    begun = humps.upright(narrow, dip | {"static": 0.08}, scales)
    bounds = {each.name: each.lower for each in begun.structure.coordinates}
    values = begun.structure.values(begun.coordinates)
    assert bounds["static"] == dip["coulomb"]
    assert values["static"] > dip["coulomb"]
    assert bounds["stribeck_velocity"] > dip["stribeck_velocity"]
    assert values["sigma0"] == pytest.approx(1e3)
