"""Experiments in parts: when they end, and whether what they call unknown is."""

import math
from functools import cache
from itertools import pairwise
from unittest.mock import Mock

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from friction_hil.config import from_dict
from friction_hil.daemon.assembly import make_path, ramp_s
from friction_hil.daemon.safety import LoopState
from friction_hil.errors import FrictionHilError
from friction_hil.motion.trajectory import PathTime, Trajectory
from friction_hil.recordings import Recording
from friction_hil.tuning.candidates import ExperimentPart
from friction_hil.tuning.motions import experiment_run
from friction_hil.tuning.sequential import ExperimentResult, Observer, Unknown, part_durations
from tests.compensators import INERTIA, LUGRE, PERIOD_S, quantised
from tests.servo_drives import axis_dict

COUNT = 2.0 * math.pi / 2**20
OWN = {"kind": "sine", "amplitude": 0.25, "frequency": 0.5}
PART_S = 15.0


@given(duration_s=st.floats(10.0, 1000.0))
def test_parts_fill_the_configured_duration_and_each_is_an_experiment(duration_s) -> None:
    parts = part_durations(duration_s)
    assert math.fsum(parts) == pytest.approx(duration_s, rel=1e-12)
    assert min(parts) >= 10.0
    if duration_s < 40.0:
        assert len(parts) == 1
    else:
        assert parts[:2] == (15.0, 15.0)
        done = np.cumsum(parts)
        # at most twice what was needed, but for a remainder that makes no part
        assert all(later <= 2.0 * before for before, later in pairwise(done[:-1]))
        assert done[-1] < 2.0 * done[-2] + 10.0


def machine(**changes):
    axis = axis_dict(experiment={"velocity": 3.0, "travel": 1.0, "duration_s": 60.0, "ramp_s": 0.5}, trajectory=OWN)
    bus = {"interface": "virtual", "channel": "test"}
    return from_dict({"version": 1, "period_s": PERIOD_S, "bus": bus, "axes": {"x": {**axis, **changes}}}, "test")


@cache
def part(seed=0, drift=0.0):
    """A part of the experiment of an axis that follows its set-point but for a small error."""
    run, duration_s = experiment_run(machine(), "x", PART_S)
    clock = PathTime(ramp_s(run.axes.values()))
    motion = Trajectory(make_path(run.axes["x"], COUNT, PERIOD_S), clock)
    motion.begin_at(0.0)
    clock.start(0.0)
    time = np.arange(1, round(duration_s / PERIOD_S)) * PERIOD_S
    demand, velocity = np.array([motion.at(t)[:2] for t in time.tolist()]).T
    position = demand - 2e-4 * np.tanh(velocity / 0.1)
    moved = np.diff(position, prepend=0.0) / PERIOD_S
    torque = LUGRE.simulate(moved, PERIOD_S) * (1.0 + drift) + INERTIA * np.gradient(moved, PERIOD_S)
    columns = {"time_s": time, "cycle": np.arange(len(time), dtype=float), "position": quantised(position, COUNT)}
    columns |= {"position_demand": demand, "velocity_demand": velocity}
    columns["torque"] = torque + 0.002 * np.random.default_rng(seed).standard_normal(len(time))
    columns["state"] = np.full(len(time), float(LoopState.RUNNING))
    facts = {"name": "x", "position_resolution": COUNT, "torque_delay_s": 0.0}
    return ExperimentPart(Recording("x_experiment.mcap", "x", columns, {"facts": [facts]}), PART_S)


def own_torque(model):
    time = np.arange(round(2.0 / OWN["frequency"] / PERIOD_S)) * PERIOD_S
    velocity = OWN["amplitude"] * math.tau * OWN["frequency"] * np.cos(math.tau * OWN["frequency"] * time)
    return model.simulate(velocity, PERIOD_S)[len(time) // 2 :]


def test_what_is_unknown_is_the_error_of_the_torque_and_falls_from_part_to_part() -> None:
    """The error is that of the own motion: measured against the true friction, which only the test knows."""
    observer = Observer(machine(), "x")
    first = observer.take(part())
    second = observer.take(part(seed=1))
    assert math.isnan(first.change)
    assert not first.is_negligible, "nothing confirms a single part"
    assert second.deviation < first.deviation
    assert second.is_negligible
    assert second.motion == "tiny", "presliding is what least of the experiment shows"
    off = own_torque(observer.model) - own_torque(LUGRE)
    assert float(np.sqrt(np.mean(off**2))) / LUGRE.level < max(3.0 * second.deviation, 0.01)


def test_an_axis_that_changes_between_the_parts_is_not_known() -> None:
    observer = Observer(machine(), "x")
    observer.take(part())
    warmer = observer.take(part(drift=-0.1))
    assert 0.05 < warmer.change < 0.12
    assert not warmer.is_negligible


def test_what_the_following_error_has_left_decides_what_matters() -> None:
    """A lower gain leaves more: less has to be known."""
    machines = [machine(compensation={"fade_s": 0.1, "gain": gain}) for gain in (1.0, 0.5)]
    shares = [Observer(each, "x").take(part()).negligible for each in machines]
    assert shares[0] < shares[1]
    # errors add up as squares: sqrt(left^2 + share^2) = 1.01 left
    assert shares[1] == pytest.approx(math.sqrt(1.01**2 - 1.0) * 0.5, rel=0.1)


def test_an_experiment_says_why_it_ended_and_what_is_uncertain():
    uncertain = Unknown("own", 0.03, 0.01, 0.014, {"sigma1": 0.8, "static": 0.2})
    whole = ExperimentResult((15.0, 15.0, 30.0), 60.0, uncertain)
    wanted = ("60 s in 3 parts: ", "known to 3 %", "1.4 % would suffice", "(standard deviation 3 %", "differs by 1 %")
    assert [each for each in (*wanted, "sigma1: ", "static: ") if each not in whole.text] == []
    assert [each["parameter"] for each in whole.figures["uncertain"]] == ["sigma1", "static"]
    enough = ExperimentResult((15.0, 15.0), 60.0, Unknown("own", 0.002, 0.003, 0.014, {"coulomb": 1.0}))
    assert enough.is_ended_early
    wanted = ("30 s of 60 s in 2 parts: stopped early: ", "to 0.3 %", "1.4 %", "deviation 0.2 %", "differs by 0.3 %")
    assert [each for each in wanted if each not in enough.text] == []
    none = ExperimentResult((10.0,), 10.0, None, "the axis stood")
    assert "10 s: " in none.text
    assert none.text.endswith(": the axis stood")
    assert none.figures["deviation"] is None


def test_an_error_of_the_program_costs_the_estimate_and_is_named(monkeypatch):
    for name in ("estimate", "plain_fit"):
        broken = Mock(side_effect=ValueError("math domain error"))
        monkeypatch.setattr(f"friction_hil.tuning.sequential.{name}", broken)
    with pytest.raises(FrictionHilError, match=r"\(ValueError: math domain error"):
        Observer(machine(), "x").take(part())
