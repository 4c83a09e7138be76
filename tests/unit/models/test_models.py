"""Properties of friction models, compared with oracles that are independent of the implementation."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.integrate import solve_ivp

import friction_hil as fh
from friction_hil.errors import ConfigurationError, UsageError
from friction_hil.friction.parameters import Choice
from friction_hil.models import InvalidParameterError
from tests.friction_models import models

LUGRE = dict(fh.models.describe("lugre").example)
velocities = st.floats(-1e3, 1e3, allow_subnormal=False)
histories = arrays(float, st.integers(1, 40), elements=velocities)


def curve(parameters, v):
    """Stribeck curve, implemented independently."""
    fall = np.exp(-((np.abs(v) / parameters["stribeck_velocity"]) ** parameters.get("stribeck_exponent", 2.0)))
    return parameters["coulomb"] + (parameters["static"] - parameters["coulomb"]) * fall


@given(models(("coulomb", "stribeck"), allowed=()), st.floats(-1e4, 1e4))
def test_a_static_map_at_rest_balances_the_applied_torque_up_to_break_away(model, applied):
    held = model.simulate([0.0], 1e-3, applied_torque=applied)[0]
    static = model.parameters["static"]
    assert held == (applied if abs(applied) <= static else math.copysign(static, applied))


@given(models(("coulomb", "stribeck"), allowed=()), histories.map(lambda v: v[v != 0.0]))
def test_a_static_map_in_motion_has_its_textbook_formula(model, v):
    p = model.parameters
    level = p["coulomb"] if model.name == "coulomb" else curve(p, v)
    expected = level * np.sign(v) + p["viscous"] * v
    np.testing.assert_allclose(model.simulate(v, 1e-3), expected, rtol=1e-12)
    np.testing.assert_array_equal(model.simulate(v, 1e-3), model.steady_state(v))


@given(models(("coulomb", "stribeck"), allowed=()), st.floats(1e-4, 1.0))
def test_feedforward_smooths_the_jump_and_nothing_else(model, epsilon):
    runner = model.start("feedforward", velocity_epsilon=epsilon)
    assert runner.step(0.0, 1e-3, applied_torque=1e3) == 0.0
    for v in (20.0 * epsilon, -50.0 * epsilon):
        assert runner.step(v, 1e-3) == pytest.approx(model.steady_state([v])[0], rel=1e-12)
    most = sum(model.parameters[name] for name in ("static", "coulomb", "viscous"))
    assert 0.0 < runner.step(0.1 * epsilon, 1e-3) < 0.11 * most
    inner = np.linspace(0.0, epsilon, 50)
    smooth = np.array([runner.step(v, 1e-3) for v in inner]) - model.parameters["viscous"] * inner
    level = model.parameters["coulomb"] if model.name == "coulomb" else curve(model.parameters, inner)
    np.testing.assert_allclose(smooth / level, np.tanh(inner / epsilon), rtol=1e-9, atol=1e-12)


def bristle(t, z, p, v):
    g = curve(p, v(t))
    return v(t) - p["sigma0"] * abs(v(t)) / g * z


def lugre_by_ivp(p, v, times):
    solution = solve_ivp(bristle, (0.0, times[-1]), [0.0], "LSODA", times, args=(p, v), rtol=1e-10, atol=1e-16)
    z = solution.y[0]
    rate = np.array([bristle(t, one, p, v) for t, one in zip(times, z, strict=True)])
    speed = v(times)
    return p["sigma0"] * z + p["sigma1"] * np.exp(-((speed / p["damping_velocity"]) ** 2)) * rate + p["sigma2"] * speed


@pytest.mark.parametrize(("amplitude", "frequency"), [(0.5, 1.0), (0.01, 2.0)])
def test_lugre_agrees_with_an_ode_solver_on_its_continuous_equations(amplitude, frequency):
    def v(t):
        return amplitude * np.sin(2.0 * np.pi * frequency * t)

    dt = 5e-6
    t = dt * np.arange(1, 200_001)
    torque = fh.models.create("lugre", **LUGRE).simulate(v(t - 0.5 * dt), dt)[399::400]
    expected = lugre_by_ivp(LUGRE, v, t[399::400])
    np.testing.assert_allclose(torque, expected, atol=1e-4 * LUGRE["static"])


@pytest.mark.parametrize(("sampled", "order"), [("at the end", 1), ("in the middle", 2)])
def test_halving_the_step_shows_the_order_of_a_held_velocity(sampled, order):
    """Fact 11. Exact for what is held; to hold the end of a smooth velocity is first order, its middle second."""
    p = LUGRE | {"sigma1": 0.0, "sigma2": 0.0}

    def v(t):
        return 0.2 + 0.15 * np.sin(20.0 * t)

    def error(n):
        dt = 0.2 / n
        t = dt * np.arange(1, n + 1)
        return fh.models.create("lugre", **p).simulate(v(t - (0.5 * dt if order == 2 else 0.0)), dt)[-1] - expected

    expected = lugre_by_ivp(p, v, np.array([0.1, 0.2]))[-1]
    ratios = [error(n) / error(2 * n) for n in (4000, 8000)]
    np.testing.assert_allclose(ratios, 2.0**order, rtol=0.05)


@pytest.mark.parametrize("exponent", [0.5, 1.0, 1.0 + 1e-13, 1.0 - 1e-9, 1.7, 2.0, 3.0])
def test_dahl_agrees_with_an_ode_solver_over_the_path(exponent):
    """Torque over travelled path, forth and back, for any exponent; rate and time do not matter."""
    sigma0, level = 100.0, 2.0

    def slope(x, force, sign):
        w = 1.0 - force / level * sign
        return sign * sigma0 * np.abs(w) ** exponent * np.sign(w)

    runner = fh.models.create("dahl", sigma0=sigma0, coulomb=level, exponent=exponent).start("simulation")
    force = 0.0
    for sign, travel in ((1.0, 0.015), (-1.0, 0.04), (1.0, 0.005)):
        expected = solve_ivp(slope, (0.0, travel), [force], "DOP853", args=(sign,), rtol=1e-11, atol=1e-12).y[0, -1]
        for v, fraction in ((0.3, 0.2), (2.0, 0.5), (0.01, 0.3)):
            force = runner.step(sign * v, fraction * travel / v)
        assert force == pytest.approx(expected, abs=1e-8)


def test_registry_lists_what_it_describes():
    assert fh.models.names() == sorted(fh.models.names())
    for name in fh.models.names():
        family = fh.models.describe(name)
        assert family.name == name
        assert len({p.name for p in family.parameters}) == len(family.parameters)
        assert all(p.meaning and (p.unit or isinstance(p, Choice)) for p in family.parameters)
        assert fh.models.create(name, **family.example).level > 0.0
    with pytest.raises(UsageError, match=r"'lugre'.*armstrong, bouc_wen, coulomb"):
        fh.models.create("lugree")


@pytest.mark.parametrize(
    ("name", "changes", "words"),
    [
        ("lugre", {"sigma0": 0.0}, ("sigma0 = 0", "N m/rad", "> 0")),
        ("lugre", {"sigma0": math.inf}, ("sigma0 = inf", "N m/rad", "> 0")),
        ("lugre", {"sigma1": -1e-9}, ("sigma1 = -1e-09", "N m s/rad", ">= 0")),
        ("lugre", {"coulomb": math.nan}, ("coulomb = nan", "N m,", "> 0")),
        ("lugre", {"static": 0.0}, ("static = 0", "N m,", "> 0")),
        ("lugre", {"damping_velocity": -math.inf}, ("damping_velocity = -inf", "rad/s", "> 0, .inf allowed")),
        ("lugre", {"stribeck_velocity": "0.2"}, ("stribeck_velocity is '0.2', not a number", "rad/s", "> 0")),
        ("lugre", {"static": "coulomb"}, ("static is 'coulomb', not a number", "N m,", "> 0")),
        ("lugre", {"sigma2": True}, ("sigma2 is True, not a number", "N m s/rad", ">= 0")),
        ("lugre", {"sigma2": 10**400}, ("sigma2 is 1000", "not a number", "N m s/rad")),
        ("lugre", {"sigma2": np.ones(2)}, ("sigma2 is array", "not a number", "N m s/rad")),
        ("lugre", {"sigma3": 1.0}, ("no parameter 'sigma3'", "did you mean 'sigma2'", "stribeck_velocity")),
        ("lugre", {"coulomb": None}, ("lugre needs coulomb", "N m", "> 0", "static (=coulomb)")),
        ("dahl", {"exponent": 0.0}, ("exponent = 0", "in 1", "> 0")),
    ],
)
def test_a_wrong_parameter_is_named_with_its_unit_and_bounds(name, changes, words):
    given = LUGRE if name == "lugre" else {"sigma0": 100.0, "coulomb": 1.0}
    with pytest.raises(InvalidParameterError) as caught:
        fh.models.create(name, **given | changes)
    assert caught.value.parameter == next(iter(changes))
    for word in words:
        assert word in str(caught.value)


def test_defaults_follow_other_parameters():
    model = fh.models.create("lugre", sigma0=1.0, coulomb=2.0, stribeck_velocity=1.0)
    assert (model.parameters["static"], model.parameters["sigma1"]) == (2.0, 0.0)
    assert model.parameters["damping_velocity"] == math.inf
    assert model.notes == ()
    odd = fh.models.create("lugre", sigma0=1.0, coulomb=2.0, static=1.0, stribeck_velocity=1.0)
    assert "no Stribeck hump" in odd.notes[0]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (([0.0, math.nan], 1e-3), "velocity .* element 1 is nan"),
        (([0.0, 1.0], -1e-3), "dt .* -0.001"),
        (([0.0, 1.0], [1e-3, 1e-3, 1e-3]), "dt .* shape"),
        (([0.0, 1.0], math.inf), "dt must be finite"),
        (([[0.0, 1.0]], 1e-3), "one dimension"),
        ((["a"], 1e-3), "velocity .* numbers"),
        (([0.0], "a"), "dt .* numbers"),
    ],
)
def test_what_is_no_velocity_record_is_refused(arguments, words):
    model = fh.models.create("coulomb", coulomb=1.0)
    with pytest.raises(UsageError, match=words):
        model.simulate(*arguments)
    assert (model.simulate([0.0, 1.0], [1e-3]).size, model.simulate([], 1e-3).size) == (2, 0)


@pytest.mark.parametrize("words", [("fit",), ("simulation", 1e-3), ("feedforward", 0.0), ("feedforward", math.nan)])
def test_a_start_without_sense_is_refused(words):
    with pytest.raises(UsageError, match="'fit'" if len(words) == 1 else "'feedforward'|rad/s"):
        fh.models.create("coulomb", coulomb=1.0).start(*words)


def test_a_model_is_read_from_its_file(tmp_path):
    path = tmp_path / "axis.yaml"
    path.write_text(
        "version: 1\naxis: rotary\nfriction:\n  model: lugre\n  parameters: {sigma0: 2e3, coulomb: 0.08, "
        "static: 0.12, stribeck_velocity: 0.2, damping_velocity: .inf}\n"
    )
    expected = fh.models.create("lugre", sigma0=2000.0, coulomb=0.08, static=0.12, stribeck_velocity=0.2)
    assert fh.models.load(path).parameters == expected.parameters
    path.write_text(path.read_text().replace("coulomb: 0.08", "coulomb: -1"))
    with pytest.raises(ConfigurationError, match=r"axis.yaml:5: .*coulomb = -1 is not allowed"):
        fh.models.load(path)
