"""Models in closed loop: the motion of a soft axis of known truth, with the loops of its drive, and what it shows."""

import math
from dataclasses import asdict, replace
from functools import cache

import numpy as np
import pytest

from friction_hil.daemon.safety import LoopState
from friction_hil.drive import AxisFacts
from friction_hil.errors import RecordingError, UsageError
from friction_hil.identification import IdentificationSettings, identify
from friction_hil.identification.data import Data
from friction_hil.identification.drive_loop import DriveLoops
from friction_hil.identification.scales import estimate_scales
from friction_hil.identification.structures import build
from friction_hil.models.model_file import ModelFile
from friction_hil.recordings import Recording
from friction_hil.servo.config import ServoConfig
from friction_hil.tuning.candidates import ExperimentPart, closed_loop_starts, slow_sweeps
from friction_hil.tuning.closed_loop import ClosedLoop, Start, closed_loop_fits
from tests.servo_drives import PERIOD_S, axis_dict, configuration, run

COUNT = 2.0 * math.pi / 2**17
FACTS = AxisFacts("x", "servo", COUNT, 6.4e-4, 2.5 * PERIOD_S, 1.5 * PERIOD_S)
TRUE = {"coulomb": 0.08, "static": 0.12, "stribeck_velocity": 0.15, "sigma0": 400.0, "sigma1": 0.3, "sigma2": 2e-3}
INERTIA, LAG_S = 2e-4, 3e-4
LOOPS = DriveLoops(60.0, 0.06, 4.8, 1.0, INERTIA, LAG_S, 0.99)  # soft: the axis sticks and slips
BOUNDS = {"velocity": 4.0, "travel": 0.8, "duration_s": 12.0, "ramp_s": 0.25}
NAMES = ("state", "cycle", "time_s", "position", "position_demand", "velocity_demand", "acceleration_demand_ahead")
NAMES = (*NAMES, "velocity", "torque")


def friction(**changes):
    values = {**TRUE, **changes}
    return {"model": "lugre", "parameters": {**values, "damping_velocity": values["stribeck_velocity"]}}


def model(**changes):
    mechanics = {"inertia": INERTIA, "torque_lag_s": LAG_S}
    return ModelFile.model_validate(
        {"version": 1, "axis": "rotary", "friction": friction(**changes), "mechanics": mechanics}
    )


SERVO = {"friction": friction(), "mechanics": {"inertia": INERTIA}, "encoder": {"counts": 2**17}}


@cache
def recorded(stiffer=1.0):
    """The experiment of `tune`, recorded by the daemon's loop; ``stiffer``: factor of all gains of the drive."""
    gains = {"position_gain": 60.0, "velocity_gain": 0.06, "integral_hz": 4.8}
    servo = ServoConfig.model_validate({**SERVO, "loops": {name: stiffer * each for name, each in gains.items()}})
    moving = axis_dict(trajectory={"kind": "experiment", **BOUNDS}, compensation={"enabled": False})
    _, rows, _ = run(configuration(x=moving), servo=servo, duration_s=12.5)
    columns = {name: np.array(rows.column("x", name)) for name in NAMES}
    is_moving = columns["state"] == LoopState.RUNNING
    columns = {name: each[is_moving] for name, each in columns.items()}
    return Recording("memory", "x", columns, {"facts": [{**asdict(FACTS), "units": []}]})


def closed_loop(recording=None):
    return ClosedLoop([recording or recorded()], configuration(x=axis_dict(experiment=BOUNDS)), LOOPS)


def rms(values):
    return float(np.sqrt(np.mean(values**2)))


def usual(errors):
    """Return the root mean square of errors up to five counts: where a stick ends a little later they are larger."""
    return rms(np.clip(errors, -5.0, 5.0))


def test_the_motion_of_the_true_model_is_predicted_to_a_count_and_that_of_others_is_not() -> None:
    loop = closed_loop()
    true = usual(loop.errors(model(), INERTIA))
    assert true < 1.0 < 0.01 * rms(loop.following)
    for name in ("coulomb", "static"):
        for factor in (0.95, 1.05):
            assert usual(loop.errors(model(**{name: factor * TRUE[name]}), INERTIA)) > 1.2 * true
    assert usual(loop.errors(model(), 1.2 * INERTIA)) > 1.2 * true


def test_the_drive_begins_with_the_torque_by_which_it_holds_the_axis() -> None:
    whole, held = recorded(), 0.8 * TRUE["static"]  # that is left of a motion before
    before = replace(whole, columns={**whole.columns, "torque": whole["torque"] + held})
    motion, begun = (closed_loop(each).motions[0] for each in (whole, before))
    assert begun.torque == pytest.approx(motion.torque + held)
    servo = ServoConfig.model_validate({**SERVO, "loops": {"position_gain": 0.0, "velocity_gain": 0.06}})
    rest = np.zeros((500, 7))
    stays, moves = (
        np.max(np.abs(motion.rehearsal.ahead(servo, model(), rest, rest[:, 0], factor * held, (0.0, 0.0))))
        for factor in (1.0, 1.5)
    )
    assert stays < held / TRUE["sigma0"]  # friction holds it already, as a spring
    assert moves > 10.0 * stays


def test_where_no_sample_was_recorded_nothing_is_corrected_and_nothing_counts() -> None:
    whole = recorded()
    kept = np.ones(len(whole["cycle"]), dtype=bool)
    kept[3000:3030] = False
    kept[5000::7] = False
    errors = closed_loop(whole.at(kept)).errors(model(), INERTIA)
    assert len(errors) == len(closed_loop().following)
    begin = len(kept) - len(errors)
    assert np.all(errors[~kept[begin:]] == 0.0)
    assert usual(errors) < 1.2


def test_a_simulation_that_fails_is_no_sample_that_is_missing(monkeypatch) -> None:
    loop = closed_loop()
    monkeypatch.setattr(loop.motions[0].rehearsal, "ahead", lambda *_: np.full(len(loop.motions[0].demand), math.nan))
    assert np.min(np.abs(loop.errors(model(), INERTIA))) > 100.0


@cache
def started(**changes):
    """A start far from the truth; the torque of this motion shows no hump at all."""
    result = identify([recorded()], IdentificationSettings(families=("lugre",), refine=False, has_modifiers=False))
    data = Data(list(result.records))
    scales = estimate_scales(data, ("inertia", "offset"))
    structure = build("lugre", scales, "rotary", PERIOD_S, is_directed=False)
    far = {**TRUE, "static": 0.108, "stribeck_velocity": 0.19, "sigma2": 1.4e-3, "inertia": INERTIA, **changes}
    return Start(result, result.best, structure, far)


@cache
def fitted():
    steps: list[tuple[str, int, int | None]] = []
    found = closed_loop_fits(closed_loop(), [started()], lambda text, k=0, n=None: steps.append((text, k, n)))
    assert steps == [("closed loop: lugre", 1, 1)]
    return found


def test_the_curve_that_the_torque_does_not_show_is_found_from_the_motion() -> None:
    [fit] = fitted().fits
    assert fit.label == "lugre in closed loop"
    for name in ("coulomb", "static"):
        assert fit.values[name] == pytest.approx(TRUE[name], rel=0.015)
    assert fit.values["stribeck_velocity"] == pytest.approx(TRUE["stribeck_velocity"], rel=0.05)
    assert fit.values["sigma2"] == pytest.approx(TRUE["sigma2"], rel=0.1)
    assert fit.mechanics["inertia"] == INERTIA
    assert fit.values["damping_velocity"] == fit.values["stribeck_velocity"]


def test_its_standard_errors_hold_and_its_errors_are_those_of_the_position() -> None:
    [fit] = fitted().fits
    errors = fit.inference.standard_errors
    for name in ("coulomb", "static", "stribeck_velocity", "sigma2"):
        assert abs(fit.values[name] - TRUE[name]) < 4.0 * errors[name] + 5e-3 * TRUE[name]
    assert fit.train.rmse < 2.0 * COUNT
    assert fit.train.relative_error == pytest.approx(fit.train.rmse / (COUNT * rms(closed_loop().following)), rel=0.05)
    assert fit.held_out.rmse >= fit.train.rmse
    assert not fit.flags


def test_without_presliding_searches_begin_at_all_and_at_half_of_the_hump() -> None:
    """Of the deflection no more is known than that it is of the order of a count, and it is damped."""
    axes = configuration(x=axis_dict(experiment=BOUNDS))
    parts = [ExperimentPart(recorded(stiffer=4.0), BOUNDS["duration_s"])]
    found = identify(*slow_sweeps(parts, axes, ("coulomb",)))
    whole, half = closed_loop_starts([found], parts, axes, ())
    assert whole.structure == half.structure
    hump = whole.values["static"] - whole.values["coulomb"]
    assert hump > 0.0
    assert half.values == {**whole.values, "static": pytest.approx(whole.values["static"] - 0.5 * hump)}
    assert whole.values["sigma0"] * COUNT == pytest.approx(TRUE["coulomb"], rel=0.3)
    damping = whole.values["sigma1"] / math.sqrt(whole.values["sigma0"] * whole.values["inertia"])
    assert damping == pytest.approx(1.0)


def test_a_friction_that_is_too_stiff_is_refused_and_a_search_that_begins_there_costs_no_other() -> None:
    with pytest.raises(UsageError, match="lugre"):
        closed_loop().errors(model(sigma0=1e9), INERTIA)
    found = closed_loop_fits(closed_loop(), [started(sigma0=1e9), started()], lambda *_: None)
    assert found.fits[0].values["sigma0"] < 1e5
    [failure] = found.failures
    assert "lugre in closed loop" in failure
    with pytest.raises(RecordingError, match="lugre in closed loop"):
        closed_loop_fits(closed_loop(), [started(sigma0=1e9)], lambda *_: None)
    without_position_loop = replace(LOOPS, position_gain=0.0)
    loop = ClosedLoop([recorded()], configuration(x=axis_dict(experiment=BOUNDS)), without_position_loop)
    with pytest.raises(RecordingError, match="no position loop"):
        closed_loop_fits(loop, [started()], lambda *_: None)
