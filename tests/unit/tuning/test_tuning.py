"""Tuning without a machine: the runs that it makes of a configuration, and what it reads from their recordings."""

import math
import re
import sys
from dataclasses import replace
from types import SimpleNamespace
from unittest.mock import Mock

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from friction_hil import models
from friction_hil.analysis.following import Figures
from friction_hil.cli.work.tune import _report
from friction_hil.config import from_dict
from friction_hil.daemon.assembly import make_path, ramp_s
from friction_hil.daemon.safety import LoopState
from friction_hil.errors import OptionError
from friction_hil.identification import IdentificationSettings, identify
from friction_hil.motion.trajectory import PathTime, Trajectory, extent
from friction_hil.recordings import Recording
from friction_hil.tuning import AxisTuning, TriedModel, TuneSettings, Tuning, tune
from friction_hil.tuning.announcement import experiment_text, shaken_text
from friction_hil.tuning.candidates import candidates
from friction_hil.tuning.experiment import refuse_limit_cycle
from friction_hil.tuning.motions import TuningError, experiment_of, experiment_run, shaken_run, sliding_part, trial_run
from friction_hil.tuning.trial import MotionTrial, Trial
from tests.servo_drives import PERIOD_S, axis_dict

EXPERIMENT = {"velocity": 5.0, "travel": 0.8, "acceleration": 400.0, "duration_s": 20.0, "ramp_s": 0.5}
BY_HAND = {"mode": "cst", "trajectory": {"kind": "none"}, "limits": {"torque": 0.3, "velocity": 30.0}}
COUNT = 2.0 * math.pi / 2**20


def machine(**axes):
    bus = {"interface": "virtual", "channel": "test"}
    nodes = {name: {**axis, "node": node} for node, (name, axis) in enumerate(axes.items(), start=1)}
    return from_dict({"version": 1, "period_s": PERIOD_S, "bus": bus, "axes": nodes}, "test")


def axis(**changes):
    return {**axis_dict(experiment=EXPERIMENT), **changes}


def test_in_an_experiment_one_axis_moves_and_nothing_is_compensated() -> None:
    shadows = [{"name": "other", "model": axis()["model"]}]
    configuration = machine(x=axis(), y=axis(shadows=shadows), z=axis(**BY_HAND))
    run, duration = experiment_run(configuration, "x")
    assert [each.trajectory.kind for each in run.axes.values()] == ["experiment", "hold", "none"]
    assert not any(each.compensation.enabled or each.shadows for each in run.axes.values())
    assert all(run.axes[name].limits == configuration.axes[name].limits for name in run.axes)
    assert duration >= EXPERIMENT["duration_s"] + 0.5 * ramp_s(run.axes.values())


@settings(max_examples=30, deadline=None)
@given(velocity=st.floats(0.5, 20.0), travel=st.floats(0.1, 5.0), kind=st.sampled_from(["hold", "experiment", "sine"]))
def test_no_experiment_goes_further_or_faster_than_it_may(velocity, travel, kind) -> None:
    bounds = {"velocity": velocity, "travel": travel}
    sine = {"amplitude": travel, "frequency": velocity / (2.0 * math.pi * travel)}
    motion = {"kind": kind, **{"hold": {}, "experiment": bounds, "sine": sine}[kind]}
    configuration = machine(x=axis(trajectory=motion, experiment=bounds))
    run, duration = experiment_run(configuration, "x")
    low, high, speed = extent(make_path(run.axes["x"], COUNT, PERIOD_S), duration, 4000)
    assert -travel <= low <= high <= travel
    assert 0.0 < speed <= velocity * (1.0 + 1e-9)


def test_a_trial_holds_what_has_nothing_to_try_and_believes_the_new_model() -> None:
    configuration = machine(x=axis(), y=axis())
    model = configuration.axes["x"].model.model_copy(update={"fit": {"chosen": "new"}})
    run, _ = trial_run(configuration, {"x": model}, {"x": COUNT})
    assert run.axes["x"].model.fit == {"chosen": "new"}
    assert run.axes["x"].compensation.enabled
    assert (run.axes["y"].trajectory.kind, run.axes["y"].compensation.enabled) == ("hold", False)


@pytest.mark.parametrize("needy", [{"velocity": "kalman"}, {"adaptation": {}}])
def test_a_compensation_that_needs_the_inertia_is_not_tried_without_it(needy) -> None:
    """Otherwise the run ends as a mistake in the configuration, which it is not."""
    configuration = machine(x=axis(compensation=needy))
    model = configuration.axes["x"].model
    unknown = model.model_copy(update={"mechanics": model.mechanics.model_copy(update={"inertia": 0.0})})
    assert trial_run(configuration, {"x": model}, {"x": COUNT})
    with pytest.raises(TuningError, match="x: the experiment does not show the inertia"):
        trial_run(configuration, {"x": unknown}, {"x": COUNT})


def test_static_models_are_shown_where_an_axis_slides_and_none_of_its_presliding() -> None:
    """Of an experiment whose path begins amid the recording: the slow sweeps, up to where the fast ones begin."""
    configuration = machine(x=axis(), y=axis())
    run, duration = experiment_run(configuration, "x")
    path_time = PathTime(ramp_s(run.axes.values()))
    motion = Trajectory(make_path(run.axes["x"], COUNT, PERIOD_S), path_time)
    motion.begin_at(0.0)
    path_time.start(0.7)
    time = np.arange(0.0, duration + 0.7, PERIOD_S)
    demand = np.array([motion.at(t).position for t in time.tolist()])
    columns = {
        "cycle": 30.0 + np.arange(len(time)),
        "state": np.where(time < 0.7, float(LoopState.ENABLING), float(LoopState.RUNNING)),
        "position_demand": demand,
    }
    facts = [{"name": name, "position_resolution": resolution} for name, resolution in (("y", 1.0), ("x", COUNT))]
    whole = Recording("x_experiment.mcap", "x", columns, {"facts": facts})
    part = sliding_part(whole, configuration)
    kept, rest = np.split(demand, [len(part)])
    assert np.array_equal(part["position_demand"], kept)
    assert np.array_equal(part["cycle"], columns["cycle"][: len(part)])
    for positions, shortest, longest in ((kept, 1.0 / 9.0, math.inf), (rest, 0.0, 1.0 / 9.0)):
        reversals = np.flatnonzero(np.diff(np.sign(np.diff(positions[positions != 0.0]))))
        period = 2.0 * PERIOD_S * float(np.median(np.diff(reversals)))
        assert shortest < period < longest
    assert abs(kept[-1]) < 1e-3 * np.max(np.abs(kept)), "a sweep ends where it began"


@pytest.mark.parametrize(
    ("changes", "key"),
    [
        ({"experiment": None}, "experiment"),
        ({"compensation": {"enabled": False}}, "compensation.enabled"),
        (BY_HAND, "trajectory.kind"),
    ],
)
def test_what_tuning_needs_to_know_is_asked_for_by_its_key(changes, key) -> None:
    with pytest.raises(OptionError) as caught:
        experiment_of("x", machine(x=axis(**changes)).axes["x"])
    assert (caught.value.axis, caught.value.key) == ("x", key)


def test_an_axis_that_is_moved_by_hand_is_not_said_to_be_held():
    configuration = machine(x=axis(), y=axis(**BY_HAND))
    run, duration = experiment_run(configuration, "x")
    bounds = experiment_of("x", configuration.axes["x"])
    text = experiment_text(run, "x", bounds, duration)
    wanted = ("0.8 rad", "5 rad/s (stopped above 7.5 rad/s)", "for 21 s", "without compensation", "y free", "0.00064")
    assert [each for each in wanted if each not in text] == []
    text = experiment_text(run, "x", bounds, 66.0, (15.0, 15.0, 30.0))
    assert [each for each in ("at most 66 s", "in parts of 15, 15, 30 s") if each not in text] == []


def test_an_axis_is_shaken_alone_within_the_bounds_of_its_experiment_and_that_is_announced() -> None:
    configuration = machine(x=axis(), y=axis(**BY_HAND))
    run, duration = shaken_run(configuration, "x")
    text = shaken_text(run, "x", experiment_of("x", configuration.axes["x"]), duration)
    wanted = ("0.8 rad", "5 rad/s (stopped above 7.5 rad/s)", "for 18 s", "without compensation", "y free")
    wanted = (*wanted, "shaken by up to 44 rad/s^2 from 2 to 250 Hz")
    assert [each for each in wanted if each not in text] == []
    assert [each.trajectory.kind for each in run.axes.values()] == ["multisine", "none"]
    assert not any(each.compensation.enabled for each in run.axes.values())
    path = make_path(run.axes["x"], COUNT, PERIOD_S)
    low, high, speed = extent(path, duration, 20_000)
    assert max(-low, high) <= EXPERIMENT["travel"]
    assert speed <= EXPERIMENT["velocity"]
    assert path(duration - 0.5 * EXPERIMENT["ramp_s"]) == (0.0, 0.0, 0.0)  # path time lags by half of its ramp


def test_a_static_model_that_takes_presliding_for_no_friction_at_standstill_is_not_tried() -> None:
    """Dahl's friction turns over a distance; a Stribeck curve that falls to zero at rest predicts that best."""
    time = np.arange(0.0, 30.0, 4e-3)
    swell = 0.2 + 0.8 * np.sin(np.pi * time / 30.0) ** 2
    position = 0.2 * swell * np.sin(2.0 * np.pi * 0.4 * time) + 0.05 * np.sin(2.0 * np.pi * 1.1 * time)
    velocity = np.gradient(position, 4e-3)
    torque = models.create("dahl", sigma0=100.0, coulomb=0.1).simulate(velocity, 4e-3) + 2e-3 * velocity
    noise = 1e-3 * np.random.default_rng(0).standard_normal(len(time))
    recording = Recording("dahl.csv", "x", {"time_s": time, "position": position, "torque": torque + noise})
    sought = IdentificationSettings(
        families=("coulomb", "stribeck"), axis="linear", has_modifiers=False, least_speed=0.03
    )
    found = identify([recording], sought)
    alone = identify([recording], replace(sought, families=("stribeck",)))
    assert found.best.structure.family == "stribeck"
    assert found.best.values["static"] < 0.01 * found.best.values["coulomb"]
    [(_, tried)] = candidates([found])
    assert (tried.label, tried.values["coulomb"]) == ("coulomb", pytest.approx(0.1, rel=0.2))
    [(_, tried)] = candidates([alone])
    assert tried is alone.best, "if there is nothing else"


SLOW_HZ = 0.75


def moved(velocity):
    """An experiment with a slow sine of 2 rad/s, in which the axis has this velocity over the time."""
    time = np.arange(0.0, 8.0, PERIOD_S)
    columns = {
        "time_s": time,
        "state": np.where(time < 0.5, float(LoopState.ENABLING), float(LoopState.RUNNING)),
        "position": np.cumsum(velocity(time)) * PERIOD_S,
        "velocity_demand": np.where(time < 0.5, np.nan, 2.0 * np.sin(2.0 * np.pi * SLOW_HZ * time)),
    }
    return Recording("x_experiment.mcap", "x", columns)


def jumps(time, speed, lag):
    """Still in each stroke but for a tenth of it."""
    phase = (2.0 * SLOW_HZ * time - lag) % 1.0
    way = np.sign(np.sin(np.pi * (2.0 * SLOW_HZ * time - lag)))
    return way * np.where((phase > 0.4) & (phase < 0.5), speed, 0.0)


@settings(max_examples=30, deadline=None)
@given(speed=st.floats(4.5, 50.0), lag=st.floats(0.0, 1.0), frequency=st.floats(4.0, 25.0))
def test_a_jump_at_break_away_is_reported_and_a_loop_that_swings_is_refused(speed, lag, frequency) -> None:
    """At whatever speed, and however late the axis is."""
    shown = refuse_limit_cycle(moved(lambda time: jumps(time, speed, lag)), 2.0, "rad")
    assert re.match(r"x has moved at .* rad/s, where its experiment asks for 2 at most: .* the axis jumps", shown)
    swing = moved(lambda time: 2.0 * speed * np.sin(2.0 * np.pi * frequency * time + lag))
    with pytest.raises(TuningError, match="the loop that controls it swings"):
        refuse_limit_cycle(swing, 2.0, "rad")
    overshoot = moved(lambda time: 2.8 * np.sin(2.0 * np.pi * SLOW_HZ * time - 1.0))
    assert refuse_limit_cycle(overshoot, 2.0, "rad") == ""


@pytest.mark.parametrize("mistake", ["ImportError('a library is missing')", "RuntimeError('no display')"])
def test_a_broken_matplotlib_costs_no_result(mistake, tmp_path, capsys, monkeypatch) -> None:
    (tmp_path / "matplotlib").mkdir()
    (tmp_path / "matplotlib" / "__init__.py").write_text(f"raise {mistake}\n")
    for name in [name for name in sys.modules if name.partition(".")[0] == "matplotlib"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.syspath_prepend(tmp_path)
    figures = Figures(4e-3, 8e-3), Figures(1e-3, 2e-3)
    times = np.arange(3.0)
    trial = Trial((MotionTrial("own", *figures, False, COUNT, times, (4e-3 * times, 1e-3 * times)),))
    found = SimpleNamespace(settings=SimpleNamespace(axis="rotary", held={}))
    model = {"friction": {"parameters": {}}, "mechanics": {"inertia": 1e-3}}
    tried = TriedModel(found, SimpleNamespace(label="coulomb"), model, trial)
    monkeypatch.setattr("friction_hil.reports.tuning_report.write_report", lambda *_, **__: None)
    learned = AxisTuning((tried,), tmp_path / "x.yaml", True)
    assert _report(tmp_path, Tuning(axes={"x": learned}), is_simulated=False) is None
    kind, _, text = mistake.partition("(")
    assert capsys.readouterr().err == f"no report: {kind}: {text[1:-2]}\n"


def test_a_report_that_cannot_be_written_costs_no_result(tmp_path, capsys):
    pytest.importorskip("matplotlib", reason="the extra 'report' is not installed")
    assert _report(tmp_path / "gone", Tuning(), is_simulated=False) is None
    assert "no report: " in capsys.readouterr().err


@pytest.mark.parametrize("error", [KeyError("facts"), TuningError("x: the drive does not answer")])
def test_whatever_ends_a_tune_after_motion_names_the_recordings_and_how_to_go_on(error, tmp_path, monkeypatch):
    folder = tmp_path / "tuned"
    path = folder / "x_experiment.mcap"

    class Runs:
        """The motion is made and recorded; what follows fails."""

        def __init__(self, *_) -> None:
            self.recordings, self.warnings = [], []

        def run(self, *_):
            path.write_bytes(b"rows")
            self.recordings.append(path)
            return path

    module = sys.modules[tune.__module__]
    monkeypatch.setattr(module, "TuningRuns", Runs)
    monkeypatch.setattr(module, "read", Mock(side_effect=error))
    agreeing = SimpleNamespace(report=lambda line: None, confirm=lambda motion: None)
    with pytest.raises(type(error)) as raised:
        tune(machine(x=axis()), TuneSettings(folder=folder, is_simulated=True), agreeing)
    [note] = raised.value.__notes__
    assert f"kept: {path}." in note
    assert f"friction-hil identify {path} --axis x --output {folder / 'x_identified.yaml'}" in note
    assert path.exists()
