"""Gradients of the torque over the parameters, against finite differences of the torque itself.

Differences are central, of fourth order, at two step sizes; samples where the two disagree lie at a kink (an
element that starts to slip one sample later, say), where no derivative exists, and are left out.
"""

import copy
import math
import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import solve_ivp

import friction_hil as fh
from friction_hil.errors import UsageError
from tests.friction_models import level_of, models, motions

NAMES = fh.models.names()
MODIFIERS = {
    "load": {"motoring": 0.1, "driven": 0.05},
    "temperature": {"reference": 40.0, "coefficient": -0.004},
    "viscous": {"quadratic": 1e-4, "cubic": 2e-5},
    "ripple": [{"order": 7.0, "cosine": 1e-3, "sine": 2e-3}, {"order": 1.5, "cosine": 0.0, "sine": 0.004}],
    "reversal": {"distance": [1e-4, 2e-3], "positive": [2e-3, 5e-3], "negative": [-3e-3, 4e-3]},
    "speed": {"velocity": [0.1, 1.0], "positive": [2e-3, 5e-3], "negative": [-3e-3, 4e-3]},
}
SIDES = {
    "armstrong": {"coulomb": 0.09, "static_released": 0.11},
    "bouc_wen": {"stiffness": 440.0, "viscous": 3e-3},
    "coulomb": {"coulomb": 0.09, "viscous": 3e-3},
    "dahl": {"coulomb": 0.09, "sigma0": 1500.0},
    "elasto_plastic": {"coulomb": 0.09, "sigma0": 1500.0, "sigma2": 3e-3},
    "gms": {"coulomb": 0.09, "viscous": 3e-3},
    "karnopp": {"coulomb": 0.09, "stribeck_velocity": 0.3},
    "lugre": {"coulomb": 0.09, "sigma0": 1500.0, "sigma2": 3e-3},
    "power_law": {"coulomb": 0.09, "exponent": 0.6},
    "stribeck": {"coulomb": 0.09, "stribeck_velocity": 0.3},
}
WITHOUT_GRADIENT = {"stick_velocity"}  # the torque changes with it only by jumps


def example(name, *, is_modified=False):
    """A small servo's friction, plain or with every modifier."""
    parameters = copy.deepcopy(dict(fh.models.describe(name).example))
    if name == "bouc_wen":
        parameters["exponent"] = 1.3  # 1 is a bound: see below
    modifiers = {}
    if is_modified:
        modifiers = copy.deepcopy(MODIFIERS)
        if name in SIDES:
            less = {one: 0.9 * value for one, value in SIDES[name].items()}
            modifiers["direction"] = {"positive": dict(SIDES[name]), "negative": less}
    return fh.models.create(name, **parameters, **({"modifiers": modifiers} if modifiers else {}))


def servo_motion(model, seed=2):
    """Fast and slow motion, presliding and rest, and what the modifiers need. The period fits no lag."""
    random = np.random.default_rng(seed)
    dt = 1.3e-3
    pieces = []
    for amplitude, length in ((2.0, 150), (0.05, 150), (0.0, 20), (1e-3, 60), (0.5, 150), (0.0, 10), (0.01, 100)):
        t = dt * np.arange(length)
        pieces.append(amplitude * np.sin(2.0 * math.pi * random.uniform(6.0, 12.0) * t + random.uniform(0.0, 6.0)))
    v = np.concatenate(pieces)
    t = dt * np.arange(v.size)
    inputs = {"applied_torque": np.where(t % 0.02 < 0.01, 0.5, -0.5)}  # more than any level, for maps that stick
    if "ripple" in model.modifiers:
        inputs["position"] = np.cumsum(v) * dt
    if "load" in model.modifiers:
        inputs["load_torque"] = 0.1 * np.sin(37.0 * t)
    if "temperature" in model.modifiers:
        inputs["temperature"] = 30.0 + 20.0 * t
    return v, dt, inputs


def container_of(parameters, modifiers, flat):
    """Container and key of the scalar with a flat name."""
    keys = [int(key) if key.isdigit() else key for key in re.findall(r"\w+", flat)]
    container = modifiers if "." in flat else parameters
    if keys[0] == "points":
        keys.append(1)  # a point's torque
    for key in keys[:-1]:
        container = container[key]
    return container, keys[-1]


def moved(model, changes):
    """The model with some scalars, given by their flat names, increased by ``changes``."""
    parameters, modifiers = copy.deepcopy(dict(model.parameters)), copy.deepcopy(dict(model.modifiers))
    for flat, change in changes.items():
        container, key = container_of(parameters, modifiers, flat)
        container[key] += change
    return fh.models.create(model.name, **parameters, **({"modifiers": modifiers} if modifiers else {}))


def value_of(model, flat):
    container, key = container_of(model.parameters, model.modifiers, flat)
    return container[key]


def compare_column(model, directions, derivative, run, size):
    """Compare a derivative with finite differences at all samples where the torque is smooth.

    ``directions`` has the flat names of one or two scalars and the signs with which they move together. Returns the
    fraction of smooth samples, and a description of the disagreement, empty if there is none.
    """
    step = 1e-5 * size

    def at(times):
        return run(moved(model, {flat: sign * times * step for flat, sign in directions}))

    here, near, far, farther = at(0), (at(-1), at(1)), (at(-2), at(2)), (at(-4), at(4))
    fine = (8.0 * (near[1] - near[0]) - (far[1] - far[0])) / (12.0 * step)
    coarse = (8.0 * (far[1] - far[0]) - (farther[1] - farther[0])) / (24.0 * step)
    scale = np.abs(derivative).max() + 1e-6 * level_of(model.name, model.parameters) / size
    is_straight = np.abs(near[1] - 2.0 * here + near[0]) <= 1e-2 * scale * step  # both sides have one slope
    is_smooth = is_straight & (np.abs(coarse - fine) <= 1e-6 * scale)
    rounding = 2.0 * np.finfo(float).eps * np.abs(here) / step  # of torques, which viscous parts may make large
    is_equal = np.abs(derivative - fine) <= 3e-6 * scale + rounding
    is_right = bool(np.all(is_equal[is_smooth]))
    return is_smooth.mean(), "" if is_right else f"{directions}: {derivative} instead of {fine}"


def directions_of(model):
    """Changes to try, as lists of (flat name, sign): each free scalar; weights only against each other."""
    free = [flat for flat in model.free if math.isfinite(value_of(model, flat))]
    for flat in free:
        if not flat.startswith("weight["):
            yield [(flat, 1.0)]
        elif flat != "weight[0]":  # they must sum to 1
            yield [(flat, 1.0), ("weight[0]", -1.0)]


def is_inside(value, flat, model):
    """True if a scalar can be changed in both directions; the lower bound of most is zero."""
    return abs(value) > 1e-9 and not (model.name == "bouc_wen" and flat.endswith("exponent") and value == 1.0)


@pytest.mark.parametrize("is_modified", [False, True], ids=["plain", "modified"])
@pytest.mark.parametrize("name", NAMES)
def test_every_parameter_has_a_gradient_that_agrees_with_differences(name, is_modified):
    """None is zero throughout: from that, nothing could be identified."""
    model = example(name, is_modified=is_modified)
    v, dt, inputs = servo_motion(model)
    torque, gradient = model.simulate_with_gradient(v, dt, **inputs)
    plain, level = model.simulate(v, dt, **inputs), level_of(name, model.parameters)
    np.testing.assert_allclose(torque, plain, rtol=0.0, atol=1e-12 * level)
    assert gradient.shape == (v.size, len(model.free))
    assert np.all(np.isfinite(gradient))
    column = {flat: gradient[:, i] for i, flat in enumerate(model.free)}
    for flat, values in column.items():
        if flat not in WITHOUT_GRADIENT and math.isfinite(value_of(model, flat)):
            assert np.abs(values).max() > 0.0, flat
    for directions in directions_of(model):
        derivative = sum(sign * column[flat] for flat, sign in directions)
        size = abs(value_of(model, directions[0][0])) or 1e-3
        run = lambda other: other.simulate(v, dt, **inputs)  # noqa: E731
        fraction, wrong = compare_column(model, directions, derivative, run, size)
        assert wrong == ""
        assert fraction > 0.9, directions
    scalars = {one.name for one in fh.models.describe(name).parameters if isinstance(model.parameters[one.name], float)}
    assert scalars - WITHOUT_GRADIENT <= {flat.split(".")[-1] for flat in model.free}


def test_free_names_are_flat_and_say_where_a_scalar_stands():
    names = set(example("lugre", is_modified=True).free)
    assert {"sigma1", "static", "damping_velocity", "direction.positive.coulomb", "direction.negative.sigma2"} <= names
    assert {"load.motoring", "load.driven", "temperature.coefficient", "viscous.quadratic", "viscous.cubic"} <= names
    assert {"ripple[0].cosine", "ripple[0].sine", "ripple[1].cosine", "ripple[1].sine"} <= names
    assert {"stiffness[0]", "stiffness[3]", "weight[0]", "weight[3]"} <= set(example("gms").free)
    assert "points[0]" in example("table").free


@pytest.mark.parametrize("name", ["gms", "lugre", "table"])
def test_a_choice_of_free_parameters_gives_their_columns(name):
    model = example(name, is_modified=True)
    v, dt, inputs = servo_motion(model)
    gradient = model.simulate_with_gradient(v, dt, **inputs)[1]
    chosen = [model.free[i] for i in (5, 0, 2, 3)]
    some = model.simulate_with_gradient(v, dt, free=chosen, **inputs)[1]
    np.testing.assert_allclose(some, gradient[:, [5, 0, 2, 3]], rtol=1e-12, atol=1e-15)
    none = model.simulate_with_gradient(v, dt, free=[], **inputs)
    assert none[1].shape == (v.size, 0)
    np.testing.assert_allclose(none[0], model.simulate(v, dt, **inputs), rtol=0.0, atol=1e-13)


def test_a_direction_is_the_weighted_sum_of_columns():
    model = fh.models.create("elasto_plastic", **fh.models.describe("elasto_plastic").example)
    v = 0.02 * np.sin(np.arange(300) * 0.05)
    all_of_them = model.simulate_with_gradient(v, 1e-3)[1]
    columns = dict(zip(model.free, all_of_them.T, strict=True))
    both = {"coulomb": 2.0, "static": -0.5}
    found = model.simulate_with_gradient(v, 1e-3, free=["sigma0", both, {}])[1]
    np.testing.assert_allclose(found[:, 0], columns["sigma0"], rtol=1e-12)
    np.testing.assert_allclose(found[:, 1], 2.0 * columns["coulomb"] - 0.5 * columns["static"], rtol=1e-9, atol=1e-12)
    assert not found[:, 2].any()
    for wrong in ({"coulomb": 1.0, "statik": 1.0}, "statik"):
        with pytest.raises(UsageError, match=r"'statik'.*did you mean"):
            model.simulate_with_gradient(v, 1e-3, free=[wrong])


def test_gradient_has_its_closed_form_for_lugre_and_coulomb():
    """From rest at constant v, z = g/sigma0 (1 - e^-a), a = sigma0 |v| t / g: dz/dsigma0 and dF/dFv are known."""
    v, dt, n = 0.3, 1e-4, 500
    p = {"sigma0": 2000.0, "coulomb": 0.08, "static": 0.08, "stribeck_velocity": 0.2}
    model = fh.models.create("lugre", **p)
    gradient = model.simulate_with_gradient(np.full(n, v), dt, free=["sigma0", "coulomb", "sigma2"])[1]
    travel = v * dt * np.arange(1, n + 1)
    a = 2000.0 * travel / 0.08
    np.testing.assert_allclose(gradient[:, 0], travel * np.exp(-a), rtol=1e-9, atol=1e-15)
    fraction = 1.0 - math.exp(-2.25)  # Fs is held: dg/dFc
    np.testing.assert_allclose(gradient[:, 1], fraction * (1.0 - np.exp(-a) * (1.0 + a)), rtol=1e-9, atol=1e-15)
    np.testing.assert_allclose(gradient[:, 2], v, rtol=1e-15)
    gradient = fh.models.create("coulomb", coulomb=0.1, viscous=0.01).simulate_with_gradient(
        [0.5, 0.0, -2.0], dt, free=["coulomb", "viscous"], applied_torque=[0.0, 0.05, 0.0]
    )[1]
    np.testing.assert_array_equal(gradient, [[1.0, 0.5], [0.0, 0.0], [-1.0, -2.0]])


@pytest.mark.parametrize(("step", "tolerance"), [(1e-4, 0.005), (2e-3, 0.05)])
def test_gradient_over_the_bouc_wen_exponent_is_right_at_its_bound(step, tolerance):
    """At 1, where an identification starts, finite differences are not possible; compare with an ODE solver."""
    p = dict(fh.models.describe("bouc_wen").example) | {"A": 1.0, "viscous": 0.0}
    v = np.repeat([0.05, -0.02, 0.01], 30)

    def slope(_, z, n, u):
        return u - p["beta"] * abs(u) * np.abs(z) ** (n - 1.0) * z - p["gamma"] * u * np.abs(z) ** n

    def torque(n):
        z = [0.0]
        for u in v:
            z.append(solve_ivp(slope, (0.0, step), z[-1:], "DOP853", args=(n, u), rtol=1e-11, atol=1e-17).y[0, -1])
        return p["stiffness"] * np.array(z[1:])

    expected = (4.0 * torque(1.0001) - 3.0 * torque(1.0) - torque(1.0002)) / 2e-4
    gradient = fh.models.create("bouc_wen", **p | {"exponent": 1.0}).simulate_with_gradient(v, step, free=["exponent"])
    np.testing.assert_allclose(gradient[1][:, 0], expected, rtol=0.0, atol=tolerance * np.abs(expected).max())


def test_gradient_over_points_of_either_direction():
    """A point of negative motion has a negative torque: the torque there grows with it."""
    model = fh.models.create("table", points=[[-2.0, -0.3], [-1.0, -0.1], [1.0, 0.2]], interpolation="linear")
    gradient = model.simulate_with_gradient([-1.5, 1.0], 1e-3, free=["points[0]", "points[1]", "points[2]"])[1]
    np.testing.assert_allclose(gradient, [[0.5, 0.5, 0.0], [0.0, 0.0, 1.0]], rtol=1e-12)


@given(st.data())
def test_torque_beside_a_gradient_is_that_of_simulate_for_any_model(data):
    model = data.draw(models())
    motion = data.draw(motions(model))
    torque, gradient = model.simulate_with_gradient(motion.velocity, motion.dt, **motion.inputs)
    expected = motion.simulate(model)
    scale = level_of(model.name, model.parameters) + np.abs(expected)
    assert np.all(np.abs(torque - expected) <= 1e-12 * scale)
    assert gradient.shape == (torque.size, len(model.free))
    assert np.all(np.isfinite(gradient))


@given(st.data())
def test_gradient_of_any_model_agrees_with_differences(data):
    model = data.draw(models())
    motion = data.draw(motions(model, fastest=10.0))
    inside = [one for one in directions_of(model) if is_inside(value_of(model, one[0][0]), one[0][0], model)]
    directions = data.draw(st.sampled_from(inside))
    free = [flat for flat, _ in directions]
    gradient = model.simulate_with_gradient(motion.velocity, motion.dt, free=free, **motion.inputs)[1]
    derivative = gradient @ [sign for _, sign in directions]
    size = abs(value_of(model, directions[0][0])) or level_of(model.name, model.parameters)
    _, wrong = compare_column(model, directions, derivative, motion.simulate, size)
    assert wrong == ""


def test_bouc_wen_where_the_way_back_is_almost_straight():
    """With gamma almost equal to beta, the law towards zero deflection is linear except for 1e-16."""
    example = dict(fh.models.describe("bouc_wen").example)
    beta = example["beta"]
    velocity = 0.3 * np.sin(0.02 * np.arange(2000))

    def gradient(gamma):
        model = fh.models.create("bouc_wen", **{**example, "gamma": gamma})
        return model.simulate_with_gradient(velocity, 1e-3, free=("beta", "gamma"))[1]

    apart, hair = gradient(beta * (1.0 - 1e-6)), gradient(beta * (1.0 - 3e-16))
    np.testing.assert_allclose(hair, apart, rtol=1e-4, atol=1e-6 * np.abs(apart).max())
