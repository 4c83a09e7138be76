"""Torque lag from runs with a known command, and when it replaces that of the former model."""

import math
from dataclasses import asdict, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import signal

from friction_hil.daemon.safety import LoopState
from friction_hil.drive import AxisFacts
from friction_hil.errors import RecordingError
from friction_hil.identification.torque_lag import identify_torque_lag, lag_response
from friction_hil.identification.torque_timing import TorqueTiming
from friction_hil.recordings import Recording, columns
from friction_hil.servo.config import Encoder, Motor, ServoConfig
from friction_hil.tuning.torque_lag import find_torque_lag
from tests.servo_drives import PERIOD_S, ServoDrives, axis_dict, configuration, make_loop

STEPS = 100  # of a period, in the simulation by small steps
RESOLUTION = 6.4e-4  # of the reported torque
INSTANT = TorqueTiming(1e-4, 2e-5, PERIOD_S, "instant")


def followed(command, lag, delay, *, is_mean=False):
    """Torque at each sample for commands held for a period, after a delay; lag and delay in periods."""
    fine = np.repeat(command, STEPS)
    late = round(delay * STEPS)
    fine = np.concatenate([np.full(late, command[0]), fine])[: len(fine)]
    part = -math.expm1(-1.0 / (STEPS * lag)) if lag > 0.0 else 1.0
    torque = command[0] + signal.lfilter([part], [1.0, part - 1.0], fine - command[0])
    halfway = 0.5 * (torque + np.concatenate([[command[0]], torque[:-1]])) if lag > 0.0 else torque
    ends = np.concatenate([[command[0]], torque[STEPS - 1 :: STEPS][:-1]])
    means = np.concatenate([[command[0]], halfway.reshape(-1, STEPS).mean(axis=1)[:-1]])
    return means if is_mean else ends


@given(lag=st.floats(0.05, 2.5), delay=st.floats(0.0, 1.5), is_mean=st.booleans())
@settings(max_examples=25, deadline=None)
def test_the_response_to_a_command_is_that_of_a_simulation_in_small_steps(lag, delay, is_mean) -> None:
    delay = round(delay * STEPS) / STEPS
    impulse = np.zeros(20)
    impulse[1] = 1.0
    found = lag_response(lag, delay, is_mean=is_mean)
    expected = followed(impulse, lag, delay, is_mean=is_mean)[1:18]
    np.testing.assert_allclose(found, expected, atol=1e-3)


@pytest.mark.parametrize(
    ("delay", "is_mean", "expected"),
    [(1.0, False, [0.0, 0.0, 1.0, 0.0]), (1.0, True, [0.0, 0.0, 1.0, 0.0]), (0.5, True, [0.0, 0.5, 0.5, 0.0])],
)
def test_without_a_lag_a_command_is_all_of_the_torque_for_a_period(delay, is_mean, expected):
    np.testing.assert_allclose(lag_response(0.0, delay, is_mean=is_mean)[:4], expected)


def commanded(lag_s, *, delay=1.0, told=None, is_mean=False, gain=1.0, rows=4000, seed=1):
    """A run in CST with a command that changes in each period."""
    random = np.random.default_rng(seed)
    command = np.cumsum(random.normal(0.0, 0.01, rows))
    torque = gain * followed(command, lag_s / PERIOD_S, delay, is_mean=is_mean)
    position = np.cumsum(np.cumsum(torque)) * PERIOD_S**2 / 1e-3
    facts = AxisFacts("x", "", 6e-6, RESOLUTION, 1.5 * PERIOD_S, ((delay if told is None else told) + 0.5) * PERIOD_S)
    values = {"time_s": np.arange(rows) * PERIOD_S, "cycle": np.arange(float(rows)), "is_fresh": np.ones(rows)}
    values |= {"position": position, "torque": RESOLUTION * np.round(torque / RESOLUTION), "command": command}
    values["state"] = np.full(rows, float(LoopState.RUNNING))
    return Recording("memory", "x", values, metadata={"facts": [asdict(facts)]})


@pytest.mark.parametrize("lag_s", [2e-4, 5e-4, 1.5e-3])
@pytest.mark.parametrize("is_mean", [False, True])
def test_the_lag_of_a_commanded_torque_is_found(lag_s, is_mean) -> None:
    found = identify_torque_lag([commanded(lag_s, is_mean=is_mean)], "cst", PERIOD_S, is_mean=is_mean)
    assert found.error_s < 0.05 * lag_s
    assert found.lag_s == pytest.approx(lag_s, abs=max(4.0 * found.error_s, 0.01 * lag_s))
    assert found.gain == pytest.approx(1.0, abs=0.01)


def test_what_the_rounding_of_both_torques_hides_is_added_and_counts_as_an_error() -> None:
    run = commanded(3e-4)
    command = 0.3 * run["command"]
    rounded = RESOLUTION * np.round(command / RESOLUTION)
    torque = RESOLUTION * np.round(followed(rounded, 0.3, 1.0) / RESOLUTION)
    run.columns.update(command=command, torque=torque)
    plain = identify_torque_lag([run], "cst", PERIOD_S, is_mean=False)
    found = identify_torque_lag([run], "cst", PERIOD_S, is_mean=False, resolution=RESOLUTION)
    assert abs(plain.lag_s - 3e-4) > 3.0 * plain.error_s, "rounding hides a part"
    assert abs(found.lag_s - 3e-4) < 3.0 * found.error_s
    assert abs(found.lag_s - 3e-4) < abs(plain.lag_s - 3e-4)


def recorded(mode, servo, *, is_compensated):
    """A run of the daemon's loop on a simulated servo."""

    def report_coarsely(_, feedback):
        for each in feedback:
            each.torque = RESOLUTION * round(each.torque / RESOLUTION)

    own = {"controller": {"position_gain": 30.0}} if mode == "csv" else {}
    axis = axis_dict(mode=mode, **own, compensation={"fade_s": 0.1, "enabled": is_compensated})
    config = configuration(x=axis)
    drives = ServoDrives(config, servo=servo, disturb=report_coarsely)
    loop, rows, _ = make_loop(config, drives, duration_s=8.0)
    loop.run()
    table = np.array(rows.rows)
    values = {name: table[:, k] for k, name in enumerate(columns.NAMES)}
    moves = values["state"] == LoopState.RUNNING
    facts = [asdict(each) for each in drives.connect()]
    return Recording("memory", "x", {name: each[moves] for name, each in values.items()}, metadata={"facts": facts})


@pytest.mark.deep
@pytest.mark.parametrize(("mode", "lag_s", "bits"), [("csp", 3e-4, 20), ("csp", 1e-3, 16), ("csv", 1e-3, 20)])
def test_the_loops_of_the_drive_do_not_disturb_the_lag(mode, lag_s, bits) -> None:
    servo = ServoConfig(motor=Motor(torque_lag_s=lag_s), encoder=Encoder(counts=2**bits))
    runs = [recorded(mode, servo, is_compensated=is_compensated) for is_compensated in (False, True)]
    found = identify_torque_lag(runs, mode, PERIOD_S, is_mean=False)
    assert found.error_s < 0.3 * lag_s
    assert abs(found.lag_s - lag_s) < 3.0 * found.error_s


def test_rows_that_are_missing_do_not_change_the_lag() -> None:
    whole = commanded(5e-4)
    kept = np.ones(len(whole), dtype=bool)
    kept[[700, 701, 1500, 2600]] = False
    values = {name: each[kept] for name, each in whole.columns.items()}
    values["torque"][2000], values["is_fresh"][2000] = 9.0, 0.0
    found = identify_torque_lag([replace(whole, columns=values)], "cst", PERIOD_S, is_mean=False)
    assert found.lag_s == pytest.approx(5e-4, abs=1e-5)


def test_a_command_that_does_not_change_and_too_few_rows_are_refused() -> None:
    still = commanded(5e-4)
    still.columns["command"][:] = 0.1
    with pytest.raises(RecordingError, match="the command does not change"):
        identify_torque_lag([still], "cst", PERIOD_S, is_mean=False)
    with pytest.raises(RecordingError, match="rows are too few"):
        identify_torque_lag([commanded(5e-4, rows=300)], "cst", PERIOD_S, is_mean=False)


def decided(lag_s, *, former_s=0.0, timing=None, delay_s=0.0, **changes):
    """The decision on two runs with this lag."""
    runs = [commanded(lag_s, seed=seed, **changes) for seed in (1, 2)]
    model = axis_dict()["model"]
    model = {**model, "mechanics": {"inertia": 2e-4, "torque_lag_s": former_s, "delay_s": delay_s}}
    own = {"controller": {"position_gain": 40.0, "velocity_gain": 0.04, "integral_hz": 3.0}}
    axis = configuration(x=axis_dict(mode="cst", model=model, **own)).axes["x"]
    return find_torque_lag(runs[0], runs[1:], axis, timing)


@pytest.mark.parametrize(
    ("given", "is_determined", "is_replaced", "value_s", "words"),
    [
        ({}, True, True, 4e-4, ""),
        ({"former_s": 6e-4}, True, False, 6e-4, "0.6 ms of the former model is kept"),
        ({"former_s": 6e-4}, True, False, 6e-4, "age of the reported torque is not known"),
        ({"former_s": 6e-4, "timing": INSTANT}, True, True, 4e-4, ""),
        ({"delay": 1.3, "told": 1.0, "delay_s": 1.3 * PERIOD_S}, True, True, 4e-4, ""),
        ({"lag_s": 0.0, "former_s": 3e-4, "timing": INSTANT}, False, False, 3e-4, "follows the command within 0."),
        (
            {"lag_s": 5e-5, "former_s": 3e-4, "timing": INSTANT},
            False,
            False,
            3e-4,
            "reports the torque that it demands",
        ),
        ({"gain": 0.5}, False, False, 0.0, "changes by 0.5"),
        ({"lag_s": 2e-3}, False, False, 0.0, "may be filtered"),
        ({"lag_s": 2e-3, "timing": INSTANT}, True, True, 2e-3, ""),
        ({"lag_s": 8e-3}, False, False, 0.0, "as long as 3 ms"),
    ],
)
def test_a_lag_replaces_the_stated_one_only_where_the_trial_determines_it(
    given, is_determined, is_replaced, value_s, words
):
    lag = decided(**{"lag_s": 4e-4, **given})
    assert (lag.is_determined, lag.is_replaced) == (is_determined, is_replaced)
    assert lag.value_s == (pytest.approx(value_s, rel=0.05 if "delay" in given else 0.02) if is_replaced else value_s)
    assert words in lag.text
    if is_replaced:
        assert f"torque lag {1e3 * lag.value_s:.3g} ms (standard error" in lag.text
        assert lag.figures["standard_error_s"] > 0.0


def test_a_stated_lag_that_the_trial_confirms_stays_as_it_is():
    found = decided(4e-4).estimate
    lag = decided(4e-4, former_s=found.lag_s + found.error_s, timing=INSTANT)
    assert (lag.is_replaced, lag.is_determined) == (False, True)
    assert "agrees with the stated one" in lag.text


@pytest.mark.parametrize(
    ("torque_delay_s", "timing", "reason"),
    [
        (None, None, "does not report its torque"),
        (2.5e-3, None, "read in the background"),
        (0.0, TorqueTiming(1.2e-3, 5e-5, PERIOD_S, "late"), "is 1.2 ms old"),
    ],
)
def test_what_the_reported_torque_cannot_tell_is_said(torque_delay_s, timing, reason) -> None:
    run = commanded(4e-4)
    run.metadata["facts"][0]["torque_delay_s"] = torque_delay_s
    lag = find_torque_lag(run, [run], configuration().axes["x"], timing)
    assert (lag.estimate, lag.is_determined, lag.value_s) == (None, False, 3e-4)
    assert reason in lag.text
