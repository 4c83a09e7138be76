"""Interface of friction models: copies, inputs, modifiers, gradients of defaults, and refused input."""

import copy
import math
import pickle

import numpy as np
import pytest
from scipy.interpolate import PchipInterpolator

import friction_hil as fh
from friction_hil.errors import UsageError
from friction_hil.friction import curves, kernel, modifiers, sensitivity
from friction_hil.friction.model import as_dict
from tests.compensators import PERIOD_S, columns, compensator

LUGRE = fh.models.describe("lugre").example


@pytest.mark.parametrize("make", [copy.copy, copy.deepcopy, lambda runner: pickle.loads(pickle.dumps(runner))])
def test_a_copied_runner_goes_its_own_way(make):
    """It must not share the memory of the one that it was copied from, which may be gone."""
    runner = fh.models.create("lugre", **LUGRE).start("simulation")
    runner.step(0.3, 1e-3)
    other, state = make(runner), runner.state.copy()
    expected = [other.step(0.1, 1e-3) for _ in range(5)]
    np.testing.assert_array_equal(runner.state, state)
    del other
    assert [runner.step(0.1, 1e-3) for _ in range(5)] == expected


def test_a_default_follows_what_a_direction_changes_also_after_the_model_was_written_and_read():
    model = fh.models.create("coulomb", coulomb=0.08, modifiers={"direction": {"positive": {"coulomb": 0.1}}})
    content = as_dict(model)
    again = fh.models.create(content["model"], modifiers=content["modifiers"], **content["parameters"])
    for each in (model, again):
        assert each.simulate([0.0, 0.0], 1e-3, applied_torque=[1.0, -1.0]) == pytest.approx([0.1, -0.08])
        assert each.notes == ()


def test_the_largest_model_of_all_has_room_in_a_compensator():
    speeds = np.arange(64.0)
    points = [[sign * v, sign * (1.0 + v)] for sign in (1.0, -1.0) for v in speeds + 0.5]
    faster = [[v, 2.0 * torque] for v, torque in points]
    modifiers = {"direction": {"positive": {"points": faster}, "negative": {"points": points}}}
    modifiers |= {"load": {"motoring": 0.1}, "temperature": {"reference": 20.0, "coefficient": 0.0}}
    modifiers |= {"viscous": {"quadratic": 1e-3}, "speed": {"velocity": speeds[1:17], "positive": np.zeros(16)}}
    modifiers["ripple"] = [{"order": order, "cosine": 0.01 * order} for order in range(1, 17)]
    modifiers["reversal"] = {"distance": speeds[1:17] * 1e-6, "positive": 0.01 * speeds[1:17]}
    model = fh.models.create("table", points=points, modifiers=modifiers)
    one, runner = compensator(model, source="demand", torque_limit=100.0), model.start()
    torque, _ = one.replay(columns(100, velocity_demand=2.5, velocity_demand_ahead=2.5))
    assert torque[-1] == pytest.approx(runner.step(2.5, PERIOD_S))
    assert torque[-1] == pytest.approx(2.0 * 3.5 + 0.01 * sum(range(1, 17)), abs=0.5)


def test_out_is_filled_and_what_does_not_fit_is_refused():
    model, v = fh.models.create("lugre", **LUGRE), np.linspace(-1.0, 1.0, 50)
    out = np.empty(50)
    assert model.simulate(v, 1e-3, out=out) is out
    np.testing.assert_array_equal(out, model.simulate(v, 1e-3))
    for wrong in (np.empty(49), np.empty(50, dtype=np.float32), np.empty(100)[::2], [0.0] * 50):
        with pytest.raises(UsageError, match="out must be"):
            model.simulate(v, 1e-3, out=wrong)


@pytest.mark.parametrize("index", [0, 40_000, 99_999])
def test_a_number_that_is_not_finite_is_found_anywhere_in_a_long_record(index):
    v = np.zeros(100_000)
    for name in fh.models.names():
        model = fh.models.create(name, **fh.models.describe(name).example)
        for wrong, dt in ((-math.inf, 1e-3), (math.nan, 1e-3), (math.nan, np.full(v.size, 1e-3))):
            v[index] = wrong  # one dt per sample selects another kernel
            with pytest.raises(UsageError, match=f"velocity .* element {index} is {wrong}"):
                model.simulate(v, dt)


def test_read_only_input_uses_the_kernels_that_are_compiled_already():
    """As columns of pandas and Arrow are."""
    model, velocity = fh.models.create("lugre", **LUGRE), np.sin(np.arange(100.0))
    frozen = velocity.copy()
    frozen.flags.writeable = False
    expected = model.simulate_with_gradient(velocity, 1e-3, position=velocity)
    kernels = (kernel.run, kernel.run_plain, sensitivity.run, sensitivity.run_plain)
    before = [len(each.signatures) for each in kernels]
    torque, gradient = model.simulate_with_gradient(frozen, 1e-3, position=frozen)
    np.testing.assert_array_equal(torque, expected[0])
    np.testing.assert_array_equal(gradient, expected[1])
    assert [len(each.signatures) for each in kernels] == before


def test_what_only_other_kernels_call_may_be_called_from_python():
    """It is compiled without a wrapper for Python, and would end the process."""
    assert [curves.direction(velocity, 0.0) for velocity in (-2.0, 0.0, 3.0)] == [-1.0, 0.0, 1.0]
    assert modifiers.level_extra(np.array([0.5, 0.25]), -2.0, 1.0) == 0.5


def test_what_a_modifier_depends_on_must_be_given():
    rippled = fh.models.create("coulomb", coulomb=1.0, modifiers={"ripple": [{"order": 7, "sine": 0.1}]})
    with pytest.raises(UsageError, match="needs the position"):
        rippled.simulate([1.0], 1e-3)
    loaded = fh.models.create("coulomb", coulomb=1.0, modifiers={"load": {"motoring": 0.1, "driven": 0.05}})
    with pytest.raises(UsageError, match="needs the load_torque"):
        loaded.simulate([1.0], 1e-3)
    assert loaded.simulate([1.0, 1.0, -1.0], 1e-3, load_torque=[2.0, -2.0, -2.0]) == pytest.approx([1.2, 1.1, -1.2])


def test_temperature_scales_the_levels_and_never_to_nothing():
    modifiers = {"temperature": {"reference": 40.0, "coefficient": -0.01}}
    model = fh.models.create("coulomb", coulomb=1.0, viscous=0.5, modifiers=modifiers)
    v = np.ones(4)
    torque = model.simulate(v, 1e-3, temperature=[40.0, 30.0, 60.0, 1000.0])
    assert torque == pytest.approx([1.5, 1.6, 1.3, 0.55])
    assert model.simulate(v[:1], 1e-3) == pytest.approx([1.5])
    assert model.steady_state([-1.0], temperature=30.0) == pytest.approx([-1.6])


def test_a_ripple_counts_revolutions_or_metres():
    modifiers = {"ripple": [{"order": 2, "cosine": 0.1}]}
    position = np.linspace(0.0, 1.0, 7)
    for axis, angle in (("rotary", 2.0), ("linear", 4.0 * np.pi)):
        model = fh.models.create("coulomb", coulomb=1.0, modifiers=modifiers, axis=axis)
        torque = model.simulate(np.ones(7), 1e-3, position=position)
        np.testing.assert_allclose(torque, 1.0 + 0.1 * np.cos(angle * position))


def test_a_table_interpolates_without_overshoot_as_scipy_does():
    points = [[0.01, 0.2], [0.1, 0.1], [0.5, 0.09], [2.0, 0.15], [3.0, 0.15]]
    table = fh.models.create("table", points=points)
    x, y = np.array(points).T
    v = np.linspace(0.01, 3.0, 500)
    np.testing.assert_allclose(table.steady_state(v), PchipInterpolator(x, y)(v), rtol=1e-12)
    np.testing.assert_allclose(table.steady_state([-0.001, -50.0]), [-0.2, -0.15])


def test_without_a_jump_the_purposes_agree():
    v, table = np.array([-0.5, -1e-4, 1e-5, 0.3]), {"points": [[0.0, 0.0], [1.0, 0.1]]}
    for model in (fh.models.create("coulomb", coulomb=0.0, viscous=0.1), fh.models.create("table", **table)):
        runner = model.start("feedforward", velocity_epsilon=1e-2)
        assert [runner.step(one, 1e-3) for one in v] == pytest.approx(model.simulate(v, 1e-3), rel=1e-12)


def test_stuck_friction_balances_what_is_applied_whatever_the_modifiers():
    modifiers = {"viscous": {"quadratic": 1e-3, "cubic": 1e-2}, "ripple": [{"order": 3, "cosine": 0.01}]}
    karnopp = {**fh.models.describe("karnopp").example, "stick_velocity": 1e-3}
    runner = fh.models.create("karnopp", **karnopp, modifiers=modifiers).start("simulation")
    assert runner.step(9e-4, 1e-3, applied_torque=0.03, position=0.2) == pytest.approx(0.03, rel=1e-12)


def test_a_default_that_follows_a_parameter_counts_for_its_gradient():
    given = {"sigma0": 100.0, "stribeck_velocity": 0.1}
    v = np.full(50, 0.2)

    def torque(level):
        return fh.models.create("lugre", coulomb=level, **given).simulate(v, 1e-2)

    model = fh.models.create("lugre", coulomb=1.0, **given)
    assert "static" not in model.free
    _, gradient = model.simulate_with_gradient(v, 1e-2, free=["coulomb"])
    np.testing.assert_allclose(gradient[:, 0], (torque(1.0 + 1e-6) - torque(1.0 - 1e-6)) / 2e-6, rtol=1e-6)


def test_a_state_that_makes_no_sense_harms_nothing():
    runner = fh.models.create("armstrong", **fh.models.describe("armstrong").example).start()
    runner.state[:] = 1e9
    for velocity in (1.0, -1.0, 0.0):
        assert isinstance(runner.step(velocity, 1e-3), float)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"axis": "linaer"}, "axis is 'rotary' or 'linear'"),
        ({"modifiers": [1]}, "not a mapping of direction"),
        ({"modifiers": {1: {}}}, "there is no modifier 1"),
    ],
)
def test_wrong_modifiers_and_axes_are_refused(change, words):
    with pytest.raises(UsageError, match=words):
        fh.models.create("coulomb", coulomb=1.0, **change)
