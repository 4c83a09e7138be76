"""Reported over commanded torque: found in the runs of a trial, written into the model, and undone where it is read."""

import re
from dataclasses import replace

import numpy as np
import pytest

from friction_hil.errors import RecordingError
from friction_hil.identification.torque_ratio import identify_torque_ratio
from friction_hil.models.model_file import ModelFile
from friction_hil.recordings import Recording
from friction_hil.replay.comparison import replay
from friction_hil.servo.config import Encoder, Motor, ServoConfig
from friction_hil.tuning.motions import TuningError
from friction_hil.tuning.torque_ratio import find_torque_ratio, refuse_turned_torque, with_torque_ratio
from tests.servo_drives import axis_dict, configuration
from tests.unit.identification.test_torque_lag import RESOLUTION, commanded, recorded


def reporting(run: Recording, gain: float, noise: float = 0.0) -> Recording:
    """The same run with a drive that reports ``gain`` times its torque."""
    torque = gain * run["torque"] + noise * np.random.default_rng(1).standard_normal(len(run))
    return replace(run, columns={**run.columns, "torque": torque})


@pytest.fixture(scope="module")
def runs() -> list[Recording]:
    """Two runs in CSP of a drive with its own loops, without and with compensation."""
    servo = ServoConfig(motor=Motor(torque_lag_s=1e-3), encoder=Encoder(counts=2**20))
    return [recorded("csp", servo, is_compensated=is_compensated) for is_compensated in (False, True)]


@pytest.mark.deep
@pytest.mark.parametrize("gain", [0.7, 0.95, 1.0, 1.3])
@pytest.mark.parametrize("noise", [0.0, 5.0 * RESOLUTION])
def test_the_ratio_is_told_from_the_loops_of_the_drive(runs, gain, noise) -> None:
    found = identify_torque_ratio([reporting(each, gain, noise) for each in runs], "csp")
    assert found.error < 0.03
    assert abs(found.ratio - gain) < 2.0 * found.error


def test_in_cst_the_command_is_all_of_the_torque() -> None:
    found = identify_torque_ratio([commanded(5e-4, gain=0.8)], "cst")
    assert found.ratio == pytest.approx(0.8, abs=min(2.0 * found.error, 0.01))


def decided(runs: list[Recording], former: float = 1.0):
    model = axis_dict()["model"]
    model = {**model, "mechanics": {"inertia": 2e-4, "torque_ratio": former}}
    return find_torque_ratio(runs[0], runs[1:], configuration(x=axis_dict(model=model)).axes["x"])


@pytest.mark.parametrize(("gain", "former", "is_other"), [(1.0, 1.0, False), (0.8, 1.0, True), (0.8, 0.8, False)])
def test_a_ratio_counts_where_it_differs_from_that_of_the_model(runs, gain, former, is_other) -> None:
    found = decided([reporting(each, gain) for each in runs], former)
    assert (found.is_determined, found.is_other) == (True, is_other)
    assert (f"{found.estimate.ratio:.3g} (standard error {found.estimate.error:.2g})") in found.text
    assert ("too small for the commands" in found.text) == is_other


def test_a_torque_that_is_another_one_or_a_turned_one_determines_nothing(runs):
    noise = np.random.default_rng(2)
    wild = [replace(run, columns=run.columns | {"torque": np.cumsum(noise.standard_normal(len(run)))}) for run in runs]
    other, turned = decided(wild), decided([reporting(each, -1.0) for each in runs])
    for found, words in ((other, "unexplained"), (turned, "set inverted_torque: command")):
        assert (found.is_determined, found.is_other) == (False, False)
        assert words in found.text
    assert other.figures["estimate"] == other.estimate.ratio


@pytest.mark.parametrize(
    ("inverted", "key"), [("none", "feedback (both"), ("feedback", "none"), ("command", "both"), ("both", "command")]
)
def test_an_experiment_whose_torque_has_the_other_sign_is_refused_with_the_key(runs, inverted, key) -> None:
    axis = configuration(x=axis_dict(inverted_torque=inverted)).axes["x"]
    refuse_turned_torque(runs[0], axis)
    with pytest.raises(TuningError, match=re.escape(f"its sign is turned; set inverted_torque: {key}")):
        refuse_turned_torque(reporting(runs[0], -1.0), axis)


def test_what_the_runs_cannot_tell_is_said(runs):
    for run, mode, words in ((runs[0], "csp", "command does not change"), (commanded(5e-4, rows=150), "cst", "short")):
        with pytest.raises(RecordingError, match=words):
            identify_torque_ratio([run], mode)
    for delay_s, reason in ((None, "does not report its torque"), (2e-3, "read in the background")):
        facts = [{**each, "torque_delay_s": delay_s} for each in runs[1].metadata["facts"]]
        hidden = replace(runs[1], metadata={**runs[1].metadata, "facts": facts})
        found = find_torque_ratio(runs[0], [hidden], configuration().axes["x"])
        assert (found.is_determined, found.estimate) == (False, None)
        assert reason in found.text


LUGRE = {"sigma0": 200.0, "sigma1": 0.2, "sigma2": 0.01, "coulomb": 0.1, "static": 0.13}
LUGRE |= {"stribeck_velocity": 0.1, "damping_velocity": 0.1}
MODIFIERS = {"load": {"motoring": 0.2, "driven": 0.1}, "ripple": [{"order": 3.0, "cosine": 0.01}]}
LOAD = {"inertia": 1e-3, "stiffness": 50.0, "damping": 0.01, "friction": 0.03}
GRAVITY = {"constant": 0.0, "sine": 0.3, "cosine": 0.1}
MODEL = {
    **{"version": 1, "axis": "rotary", "fit": {"standard_errors": {"coulomb": 1e-3}, "flags": []}},
    "friction": {"model": "lugre", "parameters": LUGRE, "modifiers": MODIFIERS},
    "mechanics": {"inertia": 2e-3, "offset": 0.02, "gravity": GRAVITY, "load": LOAD},
}


def test_a_scaled_model_explains_the_recording_as_before() -> None:
    time_s = np.arange(3000) * 1e-3
    position = 0.8 * np.sin(4.0 * time_s)
    columns = {"time_s": time_s, "position": position, "torque": 0.2 * np.sign(np.cos(4.0 * time_s))}
    recording = Recording("memory", "x", columns)
    scaled = with_torque_ratio(MODEL, 0.8, 0.01)
    models = {"plain": ModelFile.model_validate(MODEL), "scaled": ModelFile.model_validate(scaled)}
    plain, other = replay(recording, models).predictions
    np.testing.assert_allclose(0.8 * other.torque, plain.torque, rtol=1e-6, atol=1e-9)
    assert other.relative_error == pytest.approx(plain.relative_error, rel=1e-6)
    assert models["scaled"].mechanics.load.stiffness == pytest.approx(50.0 / 0.8)
    assert scaled["mechanics"]["torque_ratio"] == 0.8
    assert scaled["fit"]["standard_errors"] == {"coulomb": 1e-3, "torque_ratio": 0.01}
    assert "0.8 of the commanded torque (standard error 0.01)" in scaled["fit"]["flags"][0]
    assert MODEL["fit"]["flags"] == [], "the given model stays as it is"
    once, twice = with_torque_ratio(MODEL, 0.9), with_torque_ratio(with_torque_ratio(MODEL, 1.5), 0.9)
    assert twice["mechanics"]["inertia"] == pytest.approx(once["mechanics"]["inertia"]), "only the last ratio counts"
    assert twice["friction"]["parameters"] == pytest.approx(once["friction"]["parameters"])
