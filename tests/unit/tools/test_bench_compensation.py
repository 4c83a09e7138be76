"""``tools/bench compensation``: the simulated servo against independent oracles, motions, figures."""

import json
import math
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm

from friction_hil.compensator import Compensator
from friction_hil.errors import FrictionHilError
from friction_hil.motion.controller import CONTROLLER
from friction_hil.servo.assembly import controller_record, machine_record, servo_state
from tests.compensation_grids import LUGRE, TINY, grid_of
from tools.benchmarks.compensation import load, run
from tools.benchmarks.compensation.grid import Compliance, DriveLoops, Plant
from tools.benchmarks.compensation.machine import TRACE, advance
from tools.benchmarks.compensation.methods import METHODS
from tools.benchmarks.compensation.motions import GridMotion
from tools.benchmarks.compensation.report import as_json, geometric_mean, show
from tools.benchmarks.compensation.simulation import (
    Case,
    CaseResult,
    Error,
    Simulation,
    servo_config,
    simulate,
)

pytestmark = pytest.mark.deep  # of the tools, not of the product

PROJECT = Path(__file__).parents[3]
SLOW = PROJECT / "tools/benchmarks/compensation/slow.yaml"
FRICTIONLESS = {"model": "dahl", "parameters": {"sigma0": 1e-12, "coulomb": 1e-12}}
SOFT = DriveLoops(position_gain=100.0, velocity_gain=0.06, integral_hz=16.0, torque_lag_s=3e-4, rate_hz=8000.0)
LAZY = SOFT.model_copy(update={"position_gain": 0.0, "velocity_gain": 0.0})


def free_motion(plant, seconds, feedforward=0.0, drive=LAZY, demands=None, **initial):
    """Trace of a plant, (6, n), with a constant feed-forward torque; without ``demands`` they are zero."""
    n = round(seconds * drive.rate_hz)
    servo = servo_config(plant, drive)
    record = machine_record(servo)
    state = servo_state(servo, record, 0.0)
    for name, value in initial.items():
        state[0][name] = value
    controller = np.zeros(1, CONTROLLER) if demands is None else controller_record(servo)
    course = demands or (np.zeros(n),) * 3
    trace = np.empty((len(TRACE), n))
    advance(
        machine_record(servo_config(plant, drive)), controller, state, *course, 0, n, feedforward, np.zeros(2), trace
    )
    return dict(zip(TRACE, trace, strict=True))


def make_plant(friction=FRICTIONLESS, **values):
    return Plant.model_validate({"inertia": 1e-4, "friction": friction, **values})


# the plant


def test_two_masses_with_viscous_friction_move_as_the_linear_system_does():
    viscous, k, d, motor, other = 1e-3, 50.0, 2e-3, 1e-4, 3e-4
    friction = {"model": "dahl", "parameters": {"sigma0": 1e-12, "coulomb": 1e-12, "viscous": viscous}}
    coupling = {"stiffness": k, "damping": d, "load_inertia": other}
    moved = free_motion(make_plant(friction, compliance=coupling), 0.2, velocity=1.0, load_position=0.01)
    system = np.array(
        [
            [0.0, 1.0, 0.0, 0.0],
            [-k / motor, -(d + viscous) / motor, k / motor, d / motor],
            [0.0, 0.0, 0.0, 1.0],
            [k / other, d / other, -k / other, -d / other],
        ]
    )
    step = expm(system / LAZY.rate_hz)
    x = [np.array([0.0, 1.0, 0.01, 0.0])]
    while len(x) < 1600:
        x.append(step @ x[-1])
    for name, expected in zip(TRACE, np.transpose(x), strict=False):
        np.testing.assert_allclose(moved[name], expected, atol=0.01 * np.abs(expected).max())


def test_backlash_bounces_without_losing_energy_or_momentum():
    motor, other, k, gap = 1e-4, 2e-4, 50.0, 0.02
    coupling = {"stiffness": k, "damping": 0.0, "load_inertia": other}
    moved = free_motion(make_plant(compliance=coupling, backlash=gap), 0.5, velocity=1.0)
    v, load_v = moved["velocity"], moved["load_velocity"]
    twist = moved["position"] - moved["load_position"]
    open_gap = np.abs(twist) <= 0.5 * gap
    is_before = np.cumsum(~open_gap) == 0
    assert 0.009 < is_before.sum() / LAZY.rate_hz < 0.011  # half the gap at 1 rad/s
    assert np.all(load_v[is_before] == 0.0)
    assert np.count_nonzero(np.diff(np.sign(v - load_v))) > 10
    np.testing.assert_allclose(motor * v + other * load_v, motor, rtol=1e-9)
    pressed = np.maximum(np.abs(twist) - 0.5 * gap, 0.0)
    energy = 0.5 * (motor * v**2 + other * load_v**2 + k * pressed**2)
    np.testing.assert_allclose(energy, 0.5 * motor, rtol=0.02)


def test_damped_faces_of_a_coupling_push_and_never_pull():
    coupling = {"stiffness": 50.0, "damping": 0.5, "load_inertia": 2e-4}
    moved = free_motion(make_plant(compliance=coupling, backlash=0.02), 0.3, velocity=1.0)
    twist = moved["position"] - moved["load_position"]
    pushed = np.diff(moved["load_velocity"])
    assert pushed.max() > 0.0
    assert np.all(pushed * np.sign(twist[:-1]) >= -1e-12)
    energy = 1e-4 * moved["velocity"] ** 2 + 2e-4 * moved["load_velocity"] ** 2
    assert energy[-1] < energy[0]


def test_a_static_map_sticks_up_to_break_away_and_then_slides():
    plant = make_plant({"model": "coulomb", "parameters": {"coulomb": 0.08, "static": 0.1}}, inertia=2e-4)
    assert np.all(free_motion(plant, 0.1, feedforward=0.099)["position"] == 0.0)
    moving = free_motion(plant, 0.1, feedforward=0.11, drive=LAZY.model_copy(update={"torque_lag_s": 0.0}))
    np.testing.assert_allclose(moving["velocity"][-1], (0.11 - 0.08) / 2e-4 * 0.1, rtol=0.01)
    coasting = free_motion(plant, 0.1, velocity=1.0)
    np.testing.assert_allclose(coasting["position"][-1], 0.5 * 2e-4 / 0.08, rtol=0.01)
    assert np.all(coasting["velocity"][-100:] == 0.0)


def test_friction_takes_the_kinetic_energy_that_the_library_says():
    plant = make_plant(LUGRE, inertia=2e-4)
    moved = free_motion(plant, 0.05, velocity=5.0, drive=LAZY.model_copy(update={"rate_hz": 80000.0}))
    lost = 0.5 * 2e-4 * (25.0 - moved["velocity"] ** 2)
    spent = plant.friction_model.dissipated_energy(moved["velocity"][:-1], 1.0 / 80000.0)
    np.testing.assert_allclose(spent, lost[1:], atol=0.01 * lost.max())


def test_the_drive_closes_its_loop_as_a_linear_simulation_says():
    inertia, n = 1e-4, 1600
    t = np.arange(n) / SOFT.rate_hz
    demands = GridMotion(amplitude=0.1, frequency=3.0).at(t, 0)
    moved = free_motion(make_plant(inertia=inertia), 0.2, drive=SOFT, demands=demands, position=0.02)
    system = np.zeros((4, 4))  # position, velocity, torque, demanded torque
    system[0, 1], system[1, 2] = 1.0, 1.0 / inertia
    system[2, 2], system[2, 3] = -1.0 / SOFT.torque_lag_s, 1.0 / SOFT.torque_lag_s
    step = expm(system / SOFT.rate_hz)
    x, integral = np.array([0.02, 0.0, 0.0, 0.0]), 0.0
    for i in range(n):
        np.testing.assert_allclose(moved["position"][i], x[0], atol=2e-5)
        error = 100.0 * (demands[0][i] - x[0]) + demands[1][i] - x[1]
        integral += math.tau * 16.0 / SOFT.rate_hz * error
        x[3] = 0.06 * (error + integral) + inertia * demands[2][i]
        x = step @ x
    assert abs(moved["position"] - demands[0]).max() == pytest.approx(0.02)


@pytest.mark.parametrize(
    ("values", "wanted"),
    [
        ({}, 80e3),
        ({"inertia": 1e-8}, 2.0 * math.sqrt(2000.0 / 1e-8)),
        ({"compliance": {"stiffness": 1e6, "damping": 0.0, "load_inertia": 1e-6}}, 2.0 * math.sqrt(1e12)),
        ({"compliance": {"stiffness": 1.0, "damping": 9.0, "load_inertia": 1e-5}}, 80e3),
    ],
)
def test_integration_is_fine_enough_and_a_multiple_of_the_loops(values, wanted):
    friction = {"model": "lugre", "parameters": {"sigma0": 2000.0, "coulomb": 0.1, "stribeck_velocity": 0.1}}
    plant = make_plant(friction, **values)
    for rate in (8000.0, 3000.0):
        found = servo_config(plant, SOFT.model_copy(update={"rate_hz": rate})).integration_hz
        assert found / rate == pytest.approx(round(found / rate))
        assert 0.9 * wanted <= found <= 1.3 * wanted + rate


# feed-forward, delays, encoder


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
    simulation = Simulation(grid)
    plain = simulation.run(Case("servo", "soft", 0, "exact"), "none").rms
    late = [simulation.run(Case("servo", "soft", 0, name), "true_late").rms for name in ("exact", "one", "two")]
    assert late[0] < late[1] < late[2]
    ideal = Simulation(grid.model_copy(update={"period_s": 1.0 / 8000.0}))
    assert plain / ideal.run(Case("servo", "soft", 0, "exact"), "true_late").rms > 30.0


def test_encoder_and_delay_concern_the_feed_forward_alone(tmp_path):
    text = TINY.replace("exact: {}", "exact: {}\n  coarse: {encoder_bits: 10}\n  late: {delay_cycles: 3}")
    simulation = Simulation(grid_of(tmp_path, text))

    def found(condition, method):
        return simulation.run(Case("servo", "soft", 0, condition), method)

    assert found("exact", "none") == found("coarse", "none") == found("late", "none")
    assert found("exact", "true_late") == found("coarse", "true_late")
    for method in ("coulomb_measured", "lugre_measured", "ours"):
        assert found("exact", method) != found("coarse", method)
        assert found("exact", method) != found("late", method)


def test_measured_map_follows_the_filtered_encoder_difference(tmp_path):
    trace, _ = traced(grid_of(tmp_path), "coulomb_measured")
    resolution = math.tau / 2**20
    counts = np.floor(trace["position"][::8] / resolution)
    velocity = [0.0]
    for moved in np.diff(counts) * resolution / 1e-3:
        velocity.append(velocity[-1] + 0.5 * (moved - velocity[-1]))
    steps = np.array(velocity[:-1]) / (resolution / 1e-3)
    acting = trace["compensation"][8::8]
    is_fast, is_slow = np.abs(steps) > 10.0, np.abs(steps) < 0.5
    assert min(is_fast.sum(), is_slow.sum()) > 3
    np.testing.assert_allclose(acting[is_fast], 0.08 * np.sign(steps[is_fast]), rtol=1e-3)
    assert np.abs(acting[is_slow]).max() < 0.04


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


def test_torque_feedback_comes_in_steps_of_the_rated_torque(tmp_path):
    def found(velocity, rated):
        text = TINY.replace("inertia_error: 0.05", f"velocity: {velocity}")
        text = text.replace("inertia: 2e-4", f"inertia: 2e-4\n    rated_torque: {rated}")
        return traced(grid_of(tmp_path, text), "ours")[1]

    assert found("difference", 0.64) == found("difference", 1e6)
    blind, fine, finer = (found("kalman", rated) for rated in (1e6, 1e-4, 1e-6))
    assert abs(fine.rms - finer.rms) < 0.3 * abs(blind.rms - finer.rms)


def test_demand_with_a_known_model_all_but_removes_the_error_of_a_stiff_axis(tmp_path):
    grid = grid_of(tmp_path, TINY.replace("model: lugre, inert", "model: same, source: demand, inert"))
    by_drive = {
        outcome.case.drive: outcome.reduction for outcome in simulate(grid) if outcome.case.condition == "exact"
    }
    assert by_drive["stiff"]["ours"].rms > 2.0 * by_drive["stiff"]["true_late"].rms


def test_same_numbers_each_time_and_in_any_order(tmp_path):
    grid = grid_of(tmp_path)
    first = simulate(grid)
    alone = Simulation(grid)
    plain = alone.run(Case("servo", "stiff", 0, "off"), "none")
    for outcome in reversed(first):
        for method in reversed(METHODS):
            error = alone.run(outcome.case, method)
            if outcome.case.drive == "stiff":
                assert outcome.reduction[method] == Error(plain.rms / error.rms, plain.peak / error.peak)
    assert simulate(grid) == first


def test_an_axis_that_is_unstable_by_itself_is_named(tmp_path):
    text = TINY.replace("velocity_gain: 0.06", "velocity_gain: 60.0")
    with pytest.raises(FrictionHilError, match="plant servo with drive soft, motion"):
        simulate(grid_of(tmp_path, text))


# motions

MOTIONS = st.builds(
    lambda kind, amplitude, frequency, share: GridMotion.model_validate(
        {
            "kind": kind,
            "amplitude": amplitude,
            "frequency": frequency,
            **({"corner": max(share, 0.05)} if kind == "triangle" else {}),
            **({"rest": share} if kind == "dwell" else {}),
        }
    ),
    st.sampled_from(["cosine", "multisine", "triangle", "dwell"]),
    st.floats(1e-3, 10.0),
    st.floats(0.1, 10.0),
    st.floats(0.0, 0.9),
)


@given(motion=MOTIONS, seed=st.integers(0, 5))
@settings(max_examples=60, deadline=None)
def test_velocity_and_acceleration_are_derivatives_of_the_position(motion, seed):
    t = np.linspace(0.0, 2.5 / motion.frequency, 20001)
    position, velocity, acceleration = motion.at(t, seed)
    dt = t[1]
    # trapezoidal integrals, whose error is of second order; corners of the acceleration cost little
    for value, rate in ((position, velocity), (velocity, acceleration)):
        integral = np.concatenate([[0.0], np.cumsum(0.5 * (rate[1:] + rate[:-1]) * dt)])
        np.testing.assert_allclose(value - value[0], integral, atol=2e-3 * np.abs(value).max())
    assert abs(position[0]) < 1e-12
    assert abs(velocity[0]) < 1e-9
    low = -motion.amplitude if motion.kind == "multisine" else 0.0
    high = motion.amplitude * (1.0 if motion.kind == "multisine" else 2.0)
    assert low - 1e-9 <= position.min()
    assert position.max() <= high + 1e-9
    if motion.kind != "multisine":
        assert position.max() == pytest.approx(high, rel=1e-3)


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


# figures


def test_geometric_mean_by_hand():
    assert geometric_mean([2.0, 8.0]) == pytest.approx(4.0)
    assert geometric_mean([0.5, 4.0, 4.0]) == pytest.approx(2.0)
    assert geometric_mean([3.0, 0.0]) == 0.0


def outcome(grid, drive, condition, rms, peak):
    reduction = {method: Error(1.0, 1.0) for method in METHODS} | {"ours": Error(rms, peak)}
    return CaseResult(Case("servo", drive, 0, condition), reduction)


def test_json_has_every_case_and_the_summary_of_each_condition(tmp_path):
    grid = grid_of(tmp_path)
    outcomes = [
        outcome(grid, "soft", "exact", 2.0, 1.0),
        outcome(grid, "stiff", "exact", 8.0, 9.0),
        outcome(grid, "soft", "off", 5.0, 0.0),
    ]
    found = as_json(grid, "grid.yaml", outcomes)
    assert list(found) == ["grid", "cases", "summary"]
    assert found["cases"][1] == {
        "plant": "servo",
        "drive": "stiff",
        "motion": "0.05 rad 2 Hz",
        "condition": "exact",
        "reduction": {
            "coulomb_measured": {"rms": 1.0, "peak": 1.0},
            "lugre_measured": {"rms": 1.0, "peak": 1.0},
            "true_late": {"rms": 1.0, "peak": 1.0},
            "ours": {"rms": 8.0, "peak": 9.0},
        },
    }
    assert list(found["summary"]) == ["exact", "off"]
    assert list(found["summary"]["exact"]) == ["coulomb_measured", "lugre_measured", "true_late", "ours"]
    ours = found["summary"]["exact"]["ours"]
    assert ours["rms"] == {"geomean": pytest.approx(4.0), "worst": 2.0}
    assert ours["peak"] == {"geomean": pytest.approx(3.0), "worst": 1.0}
    assert found["summary"]["off"]["ours"]["peak"] == {"geomean": 0.0, "worst": 0.0}


def test_tables_have_a_row_a_group_one_for_all_and_the_worst_case_first(tmp_path, capsys):
    grid = grid_of(tmp_path)
    outcomes = [
        outcome(grid, "soft", "exact", 2.0, 1.0),
        outcome(grid, "stiff", "exact", 8.0, 9.0),
        outcome(grid, "soft", "off", 5.0, 0.5),
        outcome(grid, "stiff", "off", 31.25, 288.0),
    ]
    show(grid, "grid.yaml", outcomes)
    text = capsys.readouterr().out
    _, groups, worst = text.split("\n\n", 2)
    names, second = [], ""
    for line in groups.splitlines()[2:]:
        if not line.startswith(" "):
            names.append(tuple(line.split()[:2]) if not line.startswith("all") else ("all", ""))
        second = line
    assert names == [("exact", "soft"), ("exact", "stiff"), ("off", "soft"), ("off", "stiff"), ("all", "")]
    assert (groups.splitlines()[-2].split()[-1], second.split()[-1]) == ("7.1/6.0", "[2.00/0.50]")
    shown = text.partition("worst cases of")[2].split("\n\n")[1].splitlines()[1:]
    assert [re.split(r"  +", line)[3] for line in shown] == ["off", "exact", "exact", "off"], worst


def bench(*arguments):
    command = [sys.executable, "-m", "tools.benchmarks", *arguments]
    return subprocess.run(command, cwd=PROJECT, capture_output=True, text=True)


@pytest.mark.deep
def test_command_prints_one_json_object(tmp_path):
    path = tmp_path / "grid.yaml"
    path.write_text(TINY)
    done = bench("compensation", "--grid", str(path), "--json")
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    _, outcomes = run(path)
    assert len(found["cases"]) == 4
    assert found["cases"][3]["reduction"]["ours"]["rms"] == outcomes[3].reduction["ours"].rms


@pytest.mark.deep
def test_command_tells_mistakes_and_lists_what_there_is(tmp_path):
    path = tmp_path / "grid.yaml"
    path.write_text(TINY.replace("2e-4", "2 kg"))
    wrong = bench("compensation", "--grid", str(path))
    assert (wrong.returncode, wrong.stdout) == (2, "")
    assert wrong.stderr.startswith(f"{path}:3: plants.servo.inertia: must be a number")
    nothing = bench()
    assert nothing.returncode == 2
    for name in ("compensation", "exchange", "help", "latency", "models"):
        assert f"\n  {name} " in nothing.stdout + nothing.stderr


@pytest.mark.parametrize("drive", ["soft", "stiff"])
@pytest.mark.parametrize("motion", [0, 1, 2])
def test_slow_and_tiny_motions_gain_from_the_true_model_whichever_source_would_be_best(drive, motion):
    """On the falling part of the Stribeck curve, where a level that follows late makes the axis swing."""
    whole = load(SLOW)
    grid = whole.model_copy(update={"duration_s": 7.0, "settling_s": 2.0})
    found = {}
    for source in ("auto", "demand", "measured"):
        changed = grid.model_copy(update={"compensator": grid.compensator.model_copy(update={"source": source})})
        simulation = Simulation(changed)
        case = Case("reference", drive, motion, "encoder_20")
        found[source] = simulation.run(case, "ours").rms
    without = simulation.run(case, "none").rms
    assert without / found["auto"] > 3.0
    assert found["auto"] <= 1.05 * min(found["demand"], found["measured"])


def test_compliance_of_nothing_is_refused():
    with pytest.raises(ValueError, match="stiffness"):
        Compliance(stiffness=0.0, damping=0.0, load_inertia=1e-4)
