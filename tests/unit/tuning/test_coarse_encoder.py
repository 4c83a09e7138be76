"""Identification where the encoder is coarse or sampling slow: an axis that sticks and jumps, of known truth."""

import copy
import math
from functools import cache
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from friction_hil import friction as models
from friction_hil.daemon.assembly import experiment_sweeps, make_path
from friction_hil.daemon.safety import LoopState
from friction_hil.identification import Identification, identify
from friction_hil.models.model_file import ModelFile
from friction_hil.motion.trajectory import PathTime, Trajectory
from friction_hil.numerics import filtering
from friction_hil.recordings import Recording
from friction_hil.recordings.segments import between_counts
from friction_hil.servo.config import ServoConfig
from friction_hil.servo.servo import Servo
from friction_hil.tuning.candidates import ExperimentPart, _parts, sliding_settings
from friction_hil.tuning.model_files import inertia_problem, model_content
from friction_hil.tuning.motions import experiment_run
from tests.servo_drives import axis_dict, configuration
from tests.unit.identification.test_identification import plain

FRICTION = {"sigma0": 2000.0, "sigma1": 1.0, "sigma2": 2e-3, "coulomb": 0.1, "static": 0.13, "stribeck_velocity": 0.2}
INERTIA = 2e-4
CSP = 8
EXPERIMENT = {"velocity": 3.0, "travel": 1.0, "duration_s": 40.0}


def machine(period_s: float) -> Any:
    one = configuration(x=axis_dict(experiment=EXPERIMENT))
    return one.model_copy(update={"period_s": period_s})


@cache
def recorded(bits: int, period_s: float, sigma0: float = FRICTION["sigma0"]) -> Recording:
    """The experiment of `tune` on a servo with soft loops, which sticks at each reversal and jumps."""
    parameters = FRICTION | {"damping_velocity": 0.2, "sigma0": sigma0}
    friction, count = {"model": "lugre", "parameters": parameters}, 2.0 * math.pi / 2**bits
    parts = {"friction": friction, "mechanics": {"inertia": INERTIA}, "encoder": {"counts": 2**bits}}
    loops = {"position_gain": 60.0, "velocity_gain": 0.06, "integral_hz": 5.0}
    servo = Servo(ServoConfig.model_validate({**parts, "loops": loops}))
    servo.set_period(period_s)
    run, duration_s = experiment_run(machine(period_s), "x")
    clock = PathTime(1.0)
    motion = Trajectory(make_path(run.axes["x"], count, period_s), clock)
    clock.start(0.0)
    time = np.arange(1, round(duration_s / period_s) + 1) * period_s
    rows = np.empty((3, len(time)))
    for k, t in enumerate(time.tolist()):
        servo.command(CSP, motion.at(t).position)
        servo.advance(round(period_s * servo.steps_per_second))
        rows[:, k] = servo.position, servo.velocity, servo.torque
    columns = {"time_s": time, "cycle": np.arange(len(time), dtype=np.float64)}
    columns |= {"state": np.full(len(time), float(LoopState.RUNNING))}
    columns |= dict(zip(("position", "velocity", "torque"), rows, strict=True))
    return Recording("x_experiment.mcap", "x", columns, {"facts": [{"name": "x", "position_resolution": count}]})


@cache
def found(bits: int, period_s: float, sigma0: float = FRICTION["sigma0"]) -> Identification:
    """The model without presliding, from the slow sweeps."""
    recording, axes = recorded(bits, period_s, sigma0), machine(period_s)
    bounds = axes.axes["x"].experiment
    sweeps = experiment_sweeps(bounds, recording.metadata["facts"][0]["position_resolution"], period_s)
    slow = recording["time_s"] < 0.5 + sum(sweep.duration_s for sweep in sweeps[:2])
    part = Recording("slow.mcap", "x", {k: v[slow] for k, v in recording.columns.items()}, recording.metadata)
    wanted = sliding_settings(part, axes, ("stribeck",))
    return identify([part], wanted)


@pytest.mark.deep
@pytest.mark.parametrize(("bits", "period_s"), [(12, 1e-3), (14, 1e-3), (16, 4e-3), (20, 1e-3)])
def test_friction_and_inertia_are_found_whatever_the_encoder(bits: int, period_s: float) -> None:
    fit = plain(found(bits, period_s), "stribeck")
    assert fit.values["coulomb"] == pytest.approx(FRICTION["coulomb"], rel=0.03)
    # slower than the least speed nothing is seen, and a coarse encoder shakes the axis; but there is a hump
    speed = 0.15
    hump = (fit.values["static"] - fit.values["coulomb"]) * math.exp(-((speed / fit.values["stribeck_velocity"]) ** 2))
    assert 0.5 < hump / (0.03 * math.exp(-((speed / 0.2) ** 2))) < 1.5
    error = fit.inference.standard_errors["inertia"]
    assert abs(fit.values["inertia"] - INERTIA) < max(3.0 * error, 0.15 * INERTIA)
    assert not inertia_problem(fit)


def test_friction_of_soft_bristles_that_follows_the_velocity_late_does_not_widen_the_hump() -> None:
    """After the axis breaks away, friction above the steady curve looks like inertia and like a wider hump."""
    fit = plain(found(20, 2e-3, 300.0), "stribeck")
    assert fit.values["stribeck_velocity"] == pytest.approx(FRICTION["stribeck_velocity"], rel=0.05)
    assert fit.values["static"] - fit.values["coulomb"] == pytest.approx(0.03, rel=0.15)
    assert fit.values["inertia"] == pytest.approx(INERTIA, rel=0.1)


def test_each_point_of_a_table_is_a_friction_that_the_axis_showed() -> None:
    """The first one too: there are slower rows, but none in which it slides, so that nothing would determine it."""
    recording, axes = recorded(12, 1e-3), machine(1e-3)
    *_, (slow, wanted) = _parts([ExperimentPart(recording, EXPERIMENT["duration_s"])], axes, ("table",), lambda _: None)
    [fit, *_] = identify(slow, wanted).fits
    points = fit.friction[0]["points"]
    true = models.create("lugre", **FRICTION, damping_velocity=0.2)
    assert [torque for _, torque in points] == pytest.approx([true.steady_state(v).item() for v, _ in points], rel=0.15)
    assert min(speed for speed, _ in points) >= wanted.least_speed


def test_where_presliding_is_not_seen_only_static_models_are_identified_and_that_is_said() -> None:
    said: list[str] = []
    recording, axes = recorded(12, 1e-3), machine(1e-3)
    experiment = [ExperimentPart(recording, EXPERIMENT["duration_s"])]
    parts = list(_parts(experiment, axes, (), said.append))
    assert len(parts) == 1
    assert all(models.describe(family).is_static for family in parts[0][1].families)
    assert len(said) == 1
    assert "does not show presliding: its stiffness and damping (sigma0, sigma1) are not determined" in said[0]
    named = list(_parts(experiment, axes, ("lugre",), said.append))
    assert [settings.families for _, settings in named] == [("lugre",)], "what the user names is identified"
    assert len(said) == 1


def test_an_inertia_that_is_not_determined_leaves_the_former_one() -> None:
    result = found(14, 1e-3)
    fit = plain(result, "stribeck")
    axis = machine(1e-3).axes["x"]
    assert model_content(result, fit, axis)["mechanics"]["inertia"] == pytest.approx(fit.values["inertia"])
    fit = copy.deepcopy(fit)
    fit.inference.standard_errors["inertia"] *= 100.0
    content = model_content(result, fit, axis)
    assert content["mechanics"]["inertia"] == axis.model.mechanics.inertia
    assert "does not determine the inertia" in content["fit"]["flags"][-1]
    ModelFile.model_validate(content)


@settings(max_examples=25, deadline=None)
@given(speed=st.floats(5.0, 80.0), phase=st.floats(0.0, 1.0))
def test_between_the_counts_of_a_slow_motion_there_is_no_staircase(speed: float, phase: float) -> None:
    """A steady motion of some counts a second: its velocity is known from the times of the counts."""
    time = np.arange(20_000) * 1e-3
    position = np.floor(speed * time + phase)
    smooth = between_counts(position)
    first, last = np.flatnonzero(np.diff(position))[[1, -2]]
    inside = slice(first + 1, last)
    staircase, steady = (
        np.gradient(filtering.lowpass(each, 100.0, 1000.0), 1e-3)[inside] for each in (position, smooth)
    )
    assert np.max(np.abs(smooth - position)) <= 0.5 + 1e-9
    assert np.std(steady) < 0.5 * max(np.std(staircase), 0.02 * speed)
    assert np.mean(steady) == pytest.approx(speed, rel=0.05)

    fine, not_quantised = np.round(1e5 * np.sin(6.0 * time)) * 1e-5, np.sin(time)
    assert between_counts(fine) is fine
    assert between_counts(not_quantised) is not_quantised
