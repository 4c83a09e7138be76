"""Properties of friction models over random parameters and motions; tests/contract has those that each family keeps."""

import hashlib
import math
import subprocess
import sys

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.integrate import solve_ivp

import friction_hil as fh
from tests.friction_models import DYNAMIC, NAMES, STATIC_MAPS, again, decades, level_of, models, motions, speeds

parts = st.floats(0.0, 1.0)


def test_the_strategies_know_every_model():
    assert list(NAMES) == fh.models.names()
    assert all(fh.models.describe(name).is_static == (name in STATIC_MAPS) for name in NAMES)


@given(st.floats(0.0, 1.0), st.sampled_from([1.0, 1.5, 2.0]), arrays(float, 30, elements=speeds()), decades(1e-9, 1e3))
def test_bouc_wen_is_bounded_whatever_its_gamma(fraction, exponent, v, dt):
    yielding = 5e3**exponent
    model = fh.models.create(
        "bouc_wen", stiffness=400.0, beta=fraction * yielding, gamma=(1.0 - fraction) * yielding, exponent=exponent
    )
    torque = model.simulate(v, dt)
    assert np.all(np.isfinite(torque))
    assert np.abs(torque).max() <= 0.08 * (1.0 + 1e-9)


@given(st.floats(0.0, 0.9), st.floats(1.1, 4.0), decades(1e-3, 1e9))
def test_bouc_wen_settles_in_one_long_step_as_in_many_short_ones(fraction, exponent, path):
    p = {"stiffness": 400.0, "beta": 5e3**exponent, "gamma": fraction * 5e3**exponent, "exponent": exponent}
    model = fh.models.create("bouc_wen", **p)
    settled = (p["beta"] + p["gamma"]) ** (-1.0 / exponent)
    after_one = model.simulate([path * settled], 1.0)[-1]
    after_many = model.simulate(np.full(300, path / 300.0 * settled), 1.0)[-1]
    tolerance = 2e-2 if path < 50.0 else 1e-12
    assert abs(after_one - after_many) <= tolerance * 400.0 * settled
    if path > 50.0:
        assert after_one == pytest.approx(400.0 * settled, rel=1e-12)


@given(st.data())
def test_viscous_parts_only_add_what_they_say(data):
    """Quadratic and cubic terms leave the rest as it is: F = F0 + Fv2 v |v| + Fv3 v^3."""
    plain = data.draw(models(allowed=()))
    level = level_of(plain.name, plain.parameters)
    model = again(plain, viscous={"quadratic": level * data.draw(parts), "cubic": level * data.draw(parts)})
    motion = data.draw(motions(model))
    v, extra = motion.velocity, model.modifiers["viscous"]
    added = extra["quadratic"] * v * np.abs(v) + extra["cubic"] * v**3
    expected = motion.simulate(plain) + added
    # inside its band karnopp balances the applied torque and nothing else; stuck, armstrong is a spring
    moving = (np.abs(v) >= model.parameters.get("stick_velocity", 0.0)) & (model.name != "armstrong")
    scale = np.abs(expected) + np.abs(added) + level
    assert np.all(np.abs(motion.simulate(model) - expected)[moving] <= 1e-12 * scale[moving])


@given(st.data(), st.booleans(), decades(1e-3, 1e3), st.sampled_from([-1.0, 1.0]))
def test_each_settles_on_its_steady_curve(data, is_loaded, speed, sign):
    """Long after, also with direction, load and temperature."""
    model = data.draw(models(allowed=("direction", "load", "temperature", "viscous")))
    p = model.parameters
    assume(speed >= p.get("stick_velocity", 0.0))
    assume(p.get("exponent", 1.0) <= 2.0 or model.name == "bouc_wen")  # Dahl's steep exponents come near only slowly
    inputs = {}
    level = level_of(model.name, p)
    if "load" in model.modifiers:
        inputs["load_torque"] = (3.0 if is_loaded else -2.0) * level
    if "temperature" in model.modifiers and is_loaded:
        inputs["temperature"] = 70.0
    stiffness = min(p.get("stiffness", [level])) if model.name == "gms" else p.get("sigma0", p.get("stiffness", level))
    travel = 1e5 * level / stiffness if model.name in DYNAMIC else 1.0
    if model.name == "armstrong":
        model = again(model, {"static_rested": p["static_released"]})  # else its curve depends on the rest before
    n = 2000
    duration = travel / speed + 10.0 * p.get("lag_s", 0.0)
    torque = model.simulate(np.full(n, sign * speed), duration / n, **inputs)
    expected = model.steady_state([sign * speed], **inputs)[0]
    tolerance = 2e-3 if p.get("exponent", 1.0) > 1.0 and model.name == "dahl" else 1e-9
    assert torque[-1] == pytest.approx(expected, rel=tolerance)


@given(st.data())
def test_many_at_once_are_the_same_bits_as_each_alone(data):
    """Of one family and of several, on one thread and on two."""
    several = data.draw(st.lists(models(allowed=("direction", "viscous")), min_size=1, max_size=4))
    motion = data.draw(motions(several[0]))
    each = [motion.simulate(model) for model in several]
    for workers in (1, 2):
        together = fh.models.simulate_many(several, motion.velocity, motion.dt, workers=workers, **motion.inputs)
        np.testing.assert_array_equal(together, each)


@given(st.data())
def test_no_motion_from_rest_gives_energy(data):
    """Without bristle damping, the energy returned never exceeds the energy supplied."""
    name = data.draw(st.sampled_from(["bouc_wen", "dahl", "elasto_plastic", "gms", "lugre"]))
    # a Bouc-Wen torque is scaled by load and temperature while its spring is loaded, which is work of the load
    allowed = ("viscous",) if name in ("bouc_wen", "gms") else ("load", "temperature", "viscous")
    model = data.draw(models((name,), allowed=allowed))
    if name in ("lugre", "elasto_plastic"):
        model = again(model, {"sigma1": 0.0})  # the rate at the end of a step is not its mean
    if name == "gms":
        model = again(model, {"static": model.parameters["coulomb"]})  # a rising curve pulls springs for nothing
    motion = data.draw(motions(model))
    energy = model.dissipated_energy(motion.velocity, motion.dt, **motion.inputs)
    work = np.cumsum(motion.simulate(model) * motion.velocity * motion.dt)
    np.testing.assert_allclose(energy, work, rtol=1e-9, atol=1e-12 * np.abs(work).max())
    assert np.all(energy >= -1e-9 * np.maximum.accumulate(np.abs(energy)))


@given(
    st.sampled_from(["lugre", "elasto_plastic"]),
    st.floats(1.0, 3.0),
    decades(1e-3, 1.0),
    arrays(float, st.integers(4, 12), elements=st.floats(-2.0, 2.0)),
)
def test_closed_cycles_dissipate_below_the_bound_of_the_damping(name, ratio, vd, v):
    """Fact 8, with sigma1 v below 4 g everywhere: sigma1(v) v peaks at sigma1 vd exp(-1/2) / sqrt 2."""
    level, dt = 0.08, 1e-4
    bound = 4.0 * level / (vd * math.exp(-0.5) / math.sqrt(2.0))
    p = {"coulomb": level, "static": ratio * level, "sigma1": min(0.9 * bound, 5.0 * level)}
    corners = np.append(v, v[0]) - v.mean()
    fine = np.interp(np.linspace(0.0, v.size, 600, endpoint=False), np.arange(v.size + 1), corners)
    example = dict(fh.models.describe(name).example) | {"damping_velocity": vd, "sigma2": 0.0}
    torque = fh.models.create(name, **example | p).simulate(np.tile(fine, 4), dt).reshape(4, -1)
    # the cycle closes where the last two agree
    assume(np.abs(torque[3] - torque[2]).max() < 1e-9 * level)
    assert np.sum(torque[3] * fine) >= 0.0


@given(st.data(), st.integers(2, 7), speeds(10.0), decades(1e-6, 10.0))
def test_a_held_velocity_is_integrated_exactly_however_the_time_is_cut(data, parts, velocity, dt):
    model = data.draw(models(("bouc_wen", "dahl", "gms", "lugre"), allowed=("direction", "viscous"), is_bounded=True))
    assume(model.name != "bouc_wen" or model.parameters["exponent"] == 1.0)  # else its step is no exact solution
    whole, cut = model.start("simulation"), model.start("simulation")
    for v, step in ((-0.3, 1e-3), (0.002, 0.3)):  # so that it does not begin at rest
        whole.step(v, step)
        cut.step(v, step)
    once = whole.step(velocity, dt)
    for _ in range(parts):
        several = cut.step(velocity, dt / parts)
    sides = model.modifiers.get("direction", {}).values()
    level = max(level_of(model.name, dict(model.parameters) | dict(side)) for side in [{}, *sides])
    assert several == pytest.approx(once, rel=1e-9, abs=1e-9 * level)


def elasto_plastic_slope(x, y, ratio):
    """dy/dx over the path, both over the settled deflection (Dupont et al., 2002)."""
    alpha = 0.5 * np.sin(np.pi * (y - 0.5 * (1.0 + ratio)) / (1.0 - ratio)) + 0.5
    return 1.0 - np.where(y <= ratio, 0.0, np.where(y >= 1.0, 1.0, alpha)) * y


def bouc_wen_slope(x, y, exponent, fraction):
    """dw/dx over the path, both over the settled deflection, with beta a ``fraction`` of beta + gamma."""
    return 1.0 - fraction * np.abs(y) ** (exponent - 1.0) * y - (1.0 - fraction) * np.abs(y) ** exponent


@pytest.mark.parametrize("ratio", [0.1, 0.5, 0.9])
def test_elasto_plastic_is_of_second_order_over_the_path(ratio):
    """In the transition; the elastic part and the settled one are exact."""
    p = {"sigma0": 100.0, "coulomb": 1.0, "stribeck_velocity": 0.1, "breakaway_ratio": ratio}
    settled, travel = 0.01, (1.0 + 0.8 * (1.0 - ratio)) * 0.01
    span = (ratio, travel / settled)
    solution = solve_ivp(elasto_plastic_slope, span, [ratio], "DOP853", args=(ratio,), rtol=1e-12, atol=1e-13)

    def error(n):
        torque = fh.models.create("elasto_plastic", **p).simulate(np.full(n, 0.2), travel / 0.2 / n)
        return abs(torque[-1] - solution.y[0, -1])

    errors = [error(n) for n in (40, 80, 160)]
    assert errors[0] < 5e-3
    assert errors[2] < 1e-4
    assert errors[1] / errors[2] > 3.0
    # however long the step, substeps keep the error of an eighth of the transition
    assert error(1) < 1e-2
    runner = fh.models.create("elasto_plastic", **p).start("simulation")
    assert runner.step(0.2, 0.8 * ratio * settled / 0.2) == pytest.approx(0.8 * ratio, rel=1e-12)
    assert runner.step(0.2, 1e6) == pytest.approx(1.0, rel=1e-12)


@pytest.mark.parametrize("exponent", [1.3, 2.0, 3.0])
@pytest.mark.parametrize("fraction", [0.5, 0.8, 1.0])
def test_bouc_wen_is_of_second_order_over_the_path(exponent, fraction):
    """From the settled deflection of the other direction, through zero."""
    p = {"stiffness": 1.0, "beta": fraction, "gamma": 1.0 - fraction, "exponent": exponent}
    exact = solve_ivp(bouc_wen_slope, (0.0, 2.0), [-1.0], "DOP853", args=(exponent, fraction), rtol=1e-12, atol=1e-13)

    def error(n):
        runner = fh.models.create("bouc_wen", **p).start("simulation")
        assert runner.step(-1.0, 1e6) == pytest.approx(-1.0, rel=1e-12)
        for _ in range(n):
            torque = runner.step(1.0, 2.0 / n)
        return abs(torque - exact.y[0, -1])

    errors = [error(n) for n in (40, 80, 160)]
    assert errors[2] < 1e-4
    assert errors[1] / errors[2] > 3.0
    assert error(1) < 1e-2


_DIGEST = """
import hashlib
import numpy as np
import friction_hil as fh

random = np.random.default_rng(5)
v = np.cumsum(random.normal(size=3000)) * 0.01
v[random.integers(0, v.size, 300)] = 0.0
digest = hashlib.sha256()
for name in fh.models.names():
    model = fh.models.create(name, **fh.models.describe(name).example, modifiers={
        "load": {"motoring": 0.1, "driven": 0.05}, "ripple": [{"order": 7, "cosine": 1e-3, "sine": 2e-3}]})
    torque = model.simulate(v, 1e-3, position=np.cumsum(v) * 1e-3, load_torque=random.normal(size=v.size),
                            applied_torque=random.normal(size=v.size))
    digest.update(torque.tobytes())
"""


def test_another_process_computes_the_same_bits():
    here: dict = {"hashlib": hashlib}
    exec(_DIGEST, here)
    command = [sys.executable, "-c", _DIGEST + "print(digest.hexdigest())"]
    other = subprocess.run(command, capture_output=True, text=True, check=True, timeout=300)
    assert other.stdout.strip() == here["digest"].hexdigest()
