"""The plain C loops that ``tools/bench models`` measures against: an independent form of every model."""

import math
import shutil

import numpy as np
import pytest

import friction_hil as fh
from friction_hil.errors import FrictionHilError
from tools.benchmarks import models as bench

pytestmark = pytest.mark.deep  # of the tools, not of the product

needs_gcc = pytest.mark.skipif(shutil.which("gcc") is None, reason="there is no gcc here to compile the C loops")

# what a family can be besides its example: other branches of the same loop
VARIANTS = {
    "armstrong": ({"lag_s": 0.0054}, {"lag_s": 0.0, "rise_s": 0.01}),
    "stribeck": ({"stribeck_exponent": 1.0},),
    "karnopp": ({"stribeck_exponent": 1.0},),
    "dahl": ({"exponent": 0.5}, {"exponent": 1.5}),
    "lugre": ({"damping_velocity": math.inf}, {"damping_velocity": 0.1}),
    "elasto_plastic": ({"damping_velocity": math.inf}, {"breakaway_ratio": 0.2}),
}
CASES = [(name, changed) for name in fh.models.names() for changed in ({}, *VARIANTS.get(name, ()))]


@pytest.fixture(scope="module")
def loops():
    return bench.CLoops()


def break_away(model):
    """Level of friction that a motion from rest has to overcome, N m, from the parameters."""
    p = model.parameters
    if model.name == "bouc_wen":
        return p["stiffness"] * (p["A"] / (p["beta"] + p["gamma"])) ** (1.0 / p["exponent"])
    if model.name == "table":
        return min(abs(torque) for _, torque in p["points"])
    return max(p[level] for level in ("coulomb", "static", "static_rested") if level in p)


def jumps(samples):
    """Velocity that jumps over seven decades in both directions, with rests, creeping and reversals."""
    generator = np.random.default_rng(20)
    velocity = 10.0 ** generator.uniform(-6.0, 1.0, samples) * generator.choice([-1.0, 1.0], samples)
    velocity[generator.random(samples) < 0.2] = 0.0
    held = generator.integers(1, 30, samples)
    return np.repeat(velocity, held)[:samples]


@needs_gcc
@pytest.mark.parametrize(("name", "changed"), CASES, ids=[f"{name}-{changed}" for name, changed in CASES])
@pytest.mark.parametrize("dt", [1e-3, 2.5e-4])
@pytest.mark.parametrize("motion", [bench.recording, jumps])
def test_c_and_python_give_the_same_torque(loops, name, changed, dt, motion):
    model = bench.example(name, **changed)
    velocity = motion(20_000)
    expected = loops.of(model, dt)(velocity)
    assert np.ptp(expected) > break_away(model)
    np.testing.assert_allclose(model.simulate(velocity, dt), expected, rtol=0.0, atol=1e-9 * break_away(model))


def test_without_gcc_the_benchmark_says_what_to_install(monkeypatch, tmp_path):
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(FrictionHilError, match="install gcc"):
        bench.run()


@needs_gcc
def test_every_figure_of_the_benchmark_has_its_row(monkeypatch):
    few = dict.fromkeys(("SHORT_SAMPLES", "CANDIDATE_SAMPLES", "GRADIENT_SAMPLES", "STEPS"), 50)
    for size, value in {"ROUNDS": 1, "SAMPLES": 500, **few}.items():
        monkeypatch.setattr(bench, size, value)
    rows = bench.run()
    names = [row.name for row in rows]
    assert len(set(names)) == len(names)
    wanted = [f"{family} (C; target " for family in fh.models.names()]
    wanted += ["64 lugre candidates on one core (", "64 lugre candidates: speed-up of 2", "lugre: gradient in 6"]
    wanted += ["lugre, constant sigma1: gradient in 6", "lugre: one hot step"]
    for begin in wanted:
        assert sum(name.startswith(begin) for name in names) == 1
    assert all(row.value > 0.0 and row.ratio is not None and math.isfinite(row.ratio) for row in rows)
