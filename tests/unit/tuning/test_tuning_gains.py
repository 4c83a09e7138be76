"""Gains that a trial tries with the best model, and whether the torque limit clipped it."""

import math
from dataclasses import asdict, replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from friction_hil.analysis.following import Figures
from friction_hil.compensator import INPUTS
from friction_hil.config import AxisConfig, Compensation
from friction_hil.daemon.assembly import make_compensator
from friction_hil.daemon.safety import LoopState
from friction_hil.drive import AxisFacts
from friction_hil.recordings import Recording
from friction_hil.tuning import thresholds as th
from friction_hil.tuning.gains import Gains, find_clipping
from friction_hil.tuning.sequential import Unknown
from friction_hil.tuning.trial import MotionTrial, Trial
from tests.compensators import columns
from tests.servo_drives import PERIOD_S, axis_dict, configuration


def trial(rms: float, *, swings: bool = False) -> Trial:
    nothing = np.zeros(1)
    figures = Figures(100.0, 200.0), Figures(rms, 2.0 * rms)
    own = MotionTrial("own", *figures, False, 1e-6, nothing, (nothing, nothing))
    return Trial((own, replace(own, name="slow", is_swinging=swings)))


def unknown(share: float, change: float = math.nan) -> Unknown:
    return Unknown("own", share, change, 0.014, {})


def tried(given: Compensation, known: Unknown | None, result, swings=lambda gain: False):
    gains = Gains(given, trial(result(given.gain), swings=swings(given.gain)), known, None)
    while (gain := gains.next()) is not None:
        gains.tried.append(replace(gains.tried[0], gain=gain, trial=trial(result(gain), swings=swings(gain))))
    return gains


@pytest.mark.parametrize(
    ("result", "known", "expected", "best"),
    [
        pytest.param(lambda gain: 1.02 - gain, unknown(0.02), [0.9, 0.96, 1.0], 1.0, id="known to 2 %"),
        pytest.param(lambda gain: 1.02 - gain, unknown(0.01, 0.03), [0.9, 0.94, 1.0], 1.0, id="the larger one counts"),
        pytest.param(lambda gain: 1.02 - gain, unknown(0.2), [0.9, 1.0], 1.0, id="none below the configured one"),
        pytest.param(lambda gain: 1.02 - gain, unknown(0.05), [0.9, 1.0], 1.0, id="none is tried twice"),
        pytest.param(lambda gain: 1.02 - gain, None, [0.9, 0.95, 1.0], 1.0, id="not known"),
        pytest.param(lambda gain: 0.01 * gain, unknown(0.02), [0.9, 0.96], 0.9, id="the higher one was worse"),
        pytest.param(lambda gain: 1.0, unknown(0.02), [0.9], 0.9, id="a model that does not help"),
    ],
)
def test_gains_rise_to_what_is_known_and_then_to_1_as_long_as_that_is_better(result, known, expected, best):
    gains = tried(Compensation(gain=0.9), known, lambda gain: 100.0 * result(gain))
    assert ([each.gain for each in gains.tried], gains.best.gain) == (expected, best)


@pytest.mark.parametrize(("limit", "expected", "best"), [(0.97, [0.9, 0.96, 1.0], 0.96), (0.75, [0.9, 0.8, 0.7], 0.7)])
def test_a_gain_that_swings_anywhere_is_not_kept(limit, expected, best):
    gains = tried(Compensation(gain=0.9), unknown(0.02), lambda gain: 1.1 - gain, lambda gain: gain > limit)
    assert ([each.gain for each in gains.tried], gains.best.gain) == (expected, best)


@pytest.mark.parametrize("limit", [0.06, 0.3])
def test_the_limit_that_clips_is_found_and_the_one_that_would_not(limit: float) -> None:
    """Of the compensator's own torque: with the limit that is named, none of it is clipped."""
    limits = {"torque": limit, "torque_slew": 300.0, "velocity": 30.0, "following_error": 0.5}
    axis = configuration(x=axis_dict(limits=limits)).axes["x"]

    def recording(config: AxisConfig) -> Recording:
        time = PERIOD_S * np.arange(2000)
        motion = {"position": 0.3 * np.sin(math.tau * time), "velocity": 0.3 * math.tau * np.cos(math.tau * time)}
        demand = {f"{name}_demand": values for name, values in motion.items()}
        inputs = columns(2000, **motion, **demand, velocity_demand_ahead=motion["velocity"])
        facts = AxisFacts("x", "", 1e-6, 1e-4, PERIOD_S, 1.5 * PERIOD_S)
        torque = make_compensator(config, config.model, facts, PERIOD_S).replay_all(inputs)["compensation"]
        found = dict(zip(INPUTS, inputs, strict=True)) | {"compensation": torque, "command": torque}
        found["state"] = np.full(2000, float(LoopState.RUNNING))
        return Recording("x.mcap", "x", {"time_s": time, **found}, metadata={"facts": [asdict(facts)]})

    found = find_clipping(recording(axis), axis, PERIOD_S)
    if limit == 0.3:
        assert found is None
        return
    assert 0.2 < found.share < 1.0
    assert found.limit == limit
    assert found.enough is not None
    enough = axis.model_copy(update={"limits": axis.limits.model_copy(update={"torque": found.enough})})
    assert find_clipping(recording(enough), enough, PERIOD_S) is None
    assert found.enough < 1.2 * float(np.max(np.abs(recording(enough)["compensation"])))


def test_a_gain_of_its_own_for_negative_torque_stays() -> None:
    assert tried(Compensation(gain=0.8, gain_negative=0.7), None, lambda gain: 1.1 - gain).best.gain == 0.8


@given(gain=st.floats(0.0, 1.5), share=st.floats(0.0, 2.0), best_gain=st.floats(0.0, 1.5), limit=st.floats(0.0, 1.6))
def test_none_is_higher_than_1_or_tried_twice_and_the_kept_one_swings_only_if_all_do(gain, share, best_gain, limit):
    gains = tried(
        Compensation(gain=gain), unknown(share), lambda each: 1.0 + abs(each - best_gain), lambda each: each > limit
    )
    further = [each.gain for each in gains.tried[1:]]
    assert len(further) == len(set(further)) <= th.MOST_GAINS
    assert all(0.0 < each <= max(1.0, gain) for each in further)
    assert all(not each.trial.swinging for each in gains.tried) or gains.best.trial.swinging == min(
        each.trial.swinging for each in gains.tried
    )
    assert gains.best.trial.rank == pytest.approx(min(each.trial.rank for each in gains.tried))
