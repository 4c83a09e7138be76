"""``tools/bench compensation``: the simulated servo against independent oracles, motions, figures."""

import json
import math
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from friction_hil.compensator import Compensator
from friction_hil.errors import FrictionHilError
from tests.compensation_grids import TINY, grid_of
from tools.benchmarks.compensation import load, run
from tools.benchmarks.compensation.grid import DriveLoops
from tools.benchmarks.compensation.machine import TRACE
from tools.benchmarks.compensation.methods import METHODS
from tools.benchmarks.compensation.motions import GridMotion
from tools.benchmarks.compensation.report import as_json
from tools.benchmarks.compensation.simulation import Case, CaseResult, Error, Simulation, simulate

pytestmark = pytest.mark.deep  # of the tools, not of the product

PROJECT = Path(__file__).parents[3]
SLOW = PROJECT / "tools/benchmarks/compensation/slow.yaml"
SOFT = DriveLoops(position_gain=100.0, velocity_gain=0.06, integral_hz=16.0, torque_lag_s=3e-4, rate_hz=8000.0)


def traced(grid, method, condition="exact", seconds=0.6):
    trace = np.empty((len(TRACE), round(8000 * seconds)))
    error = Simulation(grid).run(Case("servo", "soft", 0, condition), method, trace)
    return dict(zip(TRACE, trace, strict=True)), error


@pytest.mark.parametrize("delay", [0, 1, 3])
def test_true_torque_acts_so_many_periods_later_for_one_period(tmp_path, delay):
    text = TINY.replace("exact: {}", f"exact: {{gain: 0.7, delay_cycles: {delay}}}")
    trace, _ = traced(grid_of(tmp_path, text), "true_late")
    sampled = trace["friction"][::8]
    held = trace["compensation"].reshape(-1, 8)
    assert np.ptp(held, axis=1).max() == 0.0
    np.testing.assert_array_equal(held[delay:, 0], 0.7 * sampled[: sampled.size - delay])
    assert np.all(held[:delay] == 0.0)


def test_score_is_of_the_following_error_after_settling(tmp_path):
    grid = grid_of(tmp_path)
    trace, error = traced(grid, "none")
    t = np.arange(trace["position"].size) / 8000.0
    following = (0.05 * (1.0 - np.cos(math.tau * 2.0 * t)) - trace["position"])[2400:]
    assert error.rms == pytest.approx(np.sqrt(np.mean(following**2)), rel=1e-9)
    assert error.peak == pytest.approx(np.abs(following).max(), rel=1e-9)
    assert np.all(trace["compensation"] == 0.0)


def test_truth_at_once_leaves_hardly_an_error_and_gets_worse_with_delay(tmp_path):
    text = TINY.replace("exact: {}", "exact: {delay_cycles: 0}\n  one: {}\n  two: {delay_cycles: 2}")
    grid = grid_of(tmp_path, text.replace("torque_lag_s: 3e-4", "torque_lag_s: 0.0"))

    def rms(condition, method, **changes):
        return Simulation(grid.model_copy(update=changes)).run(Case("servo", "soft", 0, condition), method).rms

    assert rms("exact", "true_late") < rms("one", "true_late") < rms("two", "true_late")
    assert rms("exact", "none") / rms("exact", "true_late", period_s=1.0 / 8000.0) > 30.0


def test_encoder_and_delay_concern_the_feed_forward_alone(tmp_path):
    text = TINY.replace("exact: {}", "exact: {}\n  coarse: {encoder_bits: 10}\n  late: {delay_cycles: 3}")
    simulation = Simulation(grid_of(tmp_path, text))

    def found(method):
        return [simulation.run(Case("servo", "soft", 0, name), method) for name in ("exact", "coarse", "late")]

    assert len(set(found("none"))) == 1
    exact, coarse, _ = found("true_late")
    assert exact == coarse
    for method in ("coulomb_measured", "lugre_measured", "ours"):
        assert len(set(found(method))) == 3


def test_the_compensator_has_the_settings_of_the_grid(tmp_path):
    grid = grid_of(
        tmp_path, TINY.replace("inertia_error: 0.05", "inertia_error: 0.05, smoothing: 0.25, source: demand")
    )
    assert grid.drives["stiff"] == SOFT.model_copy(update={"velocity_gain": 0.2})
    told = grid.settings("servo", "stiff", "off")
    assert (told.gain, told.smoothing, told.source, told.velocity) == (0.9, 0.25, "demand", "difference")
    assert told.lead_s == pytest.approx(1e-3 + 0.5e-3 + 0.3e-3)
    assert told.inertia == pytest.approx(2e-4 * 1.05)
    assert told.position_resolution == math.tau / 2**20
    believed = grid.believed("servo", "off").parameters
    assert believed["coulomb"] == pytest.approx(0.068)
    assert (believed["static"], believed["sigma0"]) == (0.1, 2000.0)


@pytest.mark.parametrize("velocity", ["difference", "drive"])
def test_ours_is_what_the_compensator_gives_for_the_motion_it_saw(tmp_path, velocity):
    grid = grid_of(tmp_path, TINY.replace("inertia_error: 0.05", f"velocity: {velocity}"))
    trace, _ = traced(grid, "ours", "off")
    settings = grid.settings("servo", "soft", "off")
    compensator = Compensator(grid.believed("servo", "off"), settings)
    w, torque = math.tau * 2.0, [0.0]  # what acts in the first period
    for k in range(599):
        t, i = k * 1e-3, 8 * k
        position = math.floor(trace["position"][i] / settings.position_resolution) * settings.position_resolution
        demand, velocity_demand = 0.05 * (1.0 - math.cos(w * t)), 0.05 * w * math.sin(w * t)
        ahead = 0.05 * w * math.sin(w * (t + 1.8e-3))
        inputs = (float(k), position, trace["velocity"][i], 0.0, demand, velocity_demand, ahead)
        torque.append(compensator.step(*inputs, is_fresh=True, is_enabled=True))
    np.testing.assert_allclose(trace["compensation"][::8], torque, atol=1e-6)
    assert np.abs(torque).max() > 0.05


def test_each_kind_of_motion_does_what_its_name_says():
    t = np.linspace(0.0, 4.0, 40001)
    speed = np.abs(GridMotion(kind="triangle", amplitude=0.1, frequency=0.5).at(t, 0)[1])
    assert np.mean(speed > 0.999 * speed.max()) == pytest.approx(0.9, abs=0.02)
    resting = GridMotion(kind="dwell", amplitude=0.1, frequency=0.5, rest=0.4).at(t, 0)[1] == 0.0
    assert np.mean(resting) == pytest.approx(0.4, abs=0.01)
    sines = GridMotion(kind="multisine", amplitude=0.1, frequency=0.5)
    assert not np.array_equal(sines.at(t, 1)[0], sines.at(t, 2)[0])
    a, b = sines.at(t, 1)[0][10000:20000], sines.at(t, 1)[0][30000:40000]
    np.testing.assert_allclose(a, b, atol=1e-9)  # with the period of its base


def test_json_has_every_case_and_the_summary_of_each_condition(tmp_path):
    grid = grid_of(tmp_path)
    errors = {("soft", "exact"): Error(2.0, 1.0), ("stiff", "exact"): Error(8.0, 9.0), ("soft", "off"): Error(5.0, 0.0)}
    others = {method: Error(1.0, 1.0) for method in METHODS}
    cases = [CaseResult(Case("servo", drive, 0, name), others | {"ours": own}) for (drive, name), own in errors.items()]
    found = as_json(grid, "grid.yaml", cases)
    assert list(found) == ["grid", "cases", "summary"]
    reduction = {name: {"rms": 1.0, "peak": 1.0} for name in ("coulomb_measured", "lugre_measured", "true_late")}
    assert found["cases"][1] == {
        **{"plant": "servo", "drive": "stiff", "motion": "0.05 rad 2 Hz", "condition": "exact"},
        "reduction": reduction | {"ours": {"rms": 8.0, "peak": 9.0}},
    }
    assert list(found["summary"]) == ["exact", "off"]
    assert list(found["summary"]["exact"]) == [*reduction, "ours"]
    ours = found["summary"]["exact"]["ours"]
    assert ours["rms"] == {"geomean": pytest.approx(4.0), "worst": 2.0}
    assert ours["peak"] == {"geomean": pytest.approx(3.0), "worst": 1.0}
    assert found["summary"]["off"]["ours"]["peak"] == {"geomean": 0.0, "worst": 0.0}


def bench(tmp_path, text, *words):
    (tmp_path / "grid.yaml").write_text(text)
    command = [sys.executable, "-m", "tools.benchmarks", "compensation", "--grid", tmp_path / "grid.yaml", *words]
    return subprocess.run(command, cwd=PROJECT, capture_output=True, text=True)


def test_command_prints_one_json_object_and_tells_mistakes(tmp_path):
    done = bench(tmp_path, TINY, "--json")
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    _, outcomes = run(tmp_path / "grid.yaml")
    assert len(found["cases"]) == 4
    assert found["cases"][3]["reduction"]["ours"]["rms"] == outcomes[3].reduction["ours"].rms
    with pytest.raises(FrictionHilError, match="plant servo with drive soft, motion"):  # unstable by itself
        simulate(grid_of(tmp_path, TINY.replace("velocity_gain: 0.06", "velocity_gain: 60.0")))
    wrong = bench(tmp_path, TINY.replace("2e-4", "2 kg"))
    assert (wrong.returncode, wrong.stdout) == (2, "")
    assert wrong.stderr.startswith(f"{tmp_path / 'grid.yaml'}:3: plants.servo.inertia: ")


@pytest.mark.parametrize("drive", ["soft", "stiff"])
@pytest.mark.parametrize("motion", [0, 1, 2])
def test_slow_and_tiny_motions_gain_from_the_true_model_whichever_source_would_be_best(drive, motion):
    """On the falling part of the Stribeck curve, where a level that follows late makes the axis swing."""
    grid = load(SLOW).model_copy(update={"duration_s": 7.0, "settling_s": 2.0})
    case, found = Case("reference", drive, motion, "encoder_20"), {}
    for source in ("auto", "demand", "measured"):
        changed = grid.model_copy(update={"compensator": grid.compensator.model_copy(update={"source": source})})
        found[source] = Simulation(changed).run(case, "ours").rms
    assert Simulation(changed).run(case, "none").rms / found["auto"] > 3.0
    assert found["auto"] <= 1.05 * min(found["demand"], found["measured"])
