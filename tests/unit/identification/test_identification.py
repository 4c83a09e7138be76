"""Identification against recordings whose truth is known: every family, noise, units, what the data do not show."""

from typing import Any

import numpy as np
import pytest

import friction_hil as fh
from friction_hil.errors import RecordingError, UsageError
from friction_hil.identification import FitStep, Identification, IdentificationSettings, identify
from friction_hil.identification.choice import to_refine
from friction_hil.identification.data import prepare
from friction_hil.identification.export import as_json, as_model_file, model_file
from friction_hil.recordings import Recording

MECHANICS = {"inertia": 0.02, "offset": 0.05}
LEVELS = {"coulomb": 0.3, "static": 0.45, "stribeck_velocity": 0.3}
LUGRE = LEVELS | {"sigma0": 40.0, "sigma1": 0.3, "sigma2": 0.05, "damping_velocity": 0.3}
TRUTH: dict[str, dict[str, Any]] = {
    "coulomb": {"coulomb": 0.3, "viscous": 0.05},
    "stribeck": LEVELS | {"viscous": 0.05},
    "power_law": {"coulomb": 0.3, "factor": 0.1, "exponent": 0.6},
    "dahl": {"sigma0": 40.0, "coulomb": 0.3, "viscous": 0.05},
    "lugre": LUGRE,
    "elasto_plastic": LUGRE | {"breakaway_ratio": 0.6},
    "bouc_wen": {"stiffness": 40.0, "beta": 80.0, "gamma": 50.0, "exponent": 1.2, "viscous": 0.05},
    "gms": LEVELS | {"stiffness": [60.0, 20.0, 8.0, 3.0], "weight": [0.25] * 4, "attraction": 4.0, "viscous": 0.05},
    "armstrong": {"coulomb": 0.3, "static_released": 0.4, "static_rested": 0.5, "stribeck_velocity": 0.3}
    | {"lag_s": 0.013, "rise_s": 0.2, "stiffness": 40.0, "viscous": 0.05},
}
ROUGH = {"elasto_plastic", "armstrong"}  # their torque has corners in its parameters, where a search may rest
PERIOD_S = 2e-3


def motion(seconds: float = 16.0, dwell: bool = False) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Time, position and velocity: small and large cycles at several rates, fast enough for every parameter to show."""
    time = np.arange(round(seconds / PERIOD_S)) * PERIOD_S
    swings = ((0.4, 0.37, 0.3), (0.12, 1.3, 1.1), (0.01, 7.7, 0.5), (0.004, 19.0, 2.0))
    velocity = sum(a * 2 * np.pi * f * np.cos(2 * np.pi * f * time + p) for a, f, p in swings)
    velocity = velocity * (0.1 + np.abs(np.sin(2 * np.pi * 0.11 * time)))  # from presliding to full speed
    if dwell:
        velocity = np.where(np.sin(2 * np.pi * 0.6 * time + 0.7) > 0.5, 0.0, velocity)
    return time, np.cumsum(velocity) * PERIOD_S, velocity


def made(time: np.ndarray, velocity: np.ndarray, torque: np.ndarray, **columns: np.ndarray) -> Recording:
    """A recording; its position is the sum of the velocity, if none is given."""
    columns = {"time_s": time, "position": np.cumsum(velocity) * PERIOD_S, "velocity": velocity, **columns}
    return Recording("made.csv", "x", columns | {"torque": torque})


def recorded(family: str, noise: float = 0.0, seed: int = 1, **changes: Any) -> Recording:
    """The torque that a model and MECHANICS need for `motion`, with white noise of so much N m."""
    modifiers = changes.pop("modifiers", None)
    time, position, velocity = motion(dwell=family == "armstrong")
    model = fh.models.create(family, modifiers=modifiers, **{**TRUTH[family], **changes})
    torque = model.simulate(velocity, PERIOD_S, position=position)
    torque = torque + MECHANICS["inertia"] * np.gradient(velocity, PERIOD_S) + MECHANICS["offset"]
    return made(time, velocity, torque + noise * np.random.default_rng(seed).normal(size=len(time)))


def found(*recordings: Recording, **settings: Any) -> Identification:
    return identify(recordings, IdentificationSettings(**{"gravity": "none", "has_modifiers": False, **settings}))


def plain(result: Identification, family: str) -> Any:
    (fit,) = (each for each in result.fits if each.label == family)
    return fit


def fit_of(family: str, *recordings: Recording, **settings: Any) -> Any:
    """The fit of one family without modifiers."""
    return plain(found(*recordings, families=(family,), **settings), family)


@pytest.mark.parametrize("family", sorted(set(TRUTH) - ROUGH))
def test_truth_is_found_again_without_noise(family):
    fit = fit_of(family, recorded(family))
    parameters, modifiers = fit.friction
    assert modifiers == {}
    stiffness = parameters.get("stiffness")
    if isinstance(stiffness, list):  # elements of one weight have no order
        parameters["stiffness"] = sorted(stiffness, reverse=True)
    for name, value in TRUTH[family].items():
        assert parameters[name] == pytest.approx(value, rel=1e-6), name
    assert {name: fit.mechanics[name] for name in MECHANICS} == pytest.approx(MECHANICS, rel=1e-6)
    assert fit.train.relative_error < 1e-7


@pytest.mark.parametrize(("family", "stiffness"), [("armstrong", "stiffness"), ("elasto_plastic", "sigma0")])
def test_rough_families_come_close_to_their_truth(family, stiffness):
    fit = fit_of(family, recorded(family))
    assert fit.train.relative_error < 0.03
    assert fit.mechanics["inertia"] == pytest.approx(MECHANICS["inertia"], rel=0.02)
    assert fit.values[stiffness] == pytest.approx(TRUTH[family][stiffness], rel=0.1)


@pytest.mark.deep
def test_noise_leaves_parameters_within_their_stated_errors() -> None:
    """25 recordings of LuGre: 95 % intervals hold the truth about as often, and are no wider than they must be."""
    truth = {**TRUTH["lugre"], **MECHANICS}
    names = [name for name in truth if name != "damping_velocity"]
    values, errors = [], []
    for seed in range(25):
        fit = fit_of("lugre", recorded("lugre", noise=0.02, seed=seed))
        values.append([fit.values[name] for name in names])
        errors.append([fit.inference.standard_errors[name] for name in names])
    off = np.array(values) - [truth[name] for name in names]
    held = np.mean(np.abs(off) < 1.96 * np.array(errors))
    assert 0.88 < held < 0.99
    ratio = np.median(errors, axis=0) / np.std(off, axis=0)
    assert np.all((ratio > 0.6) & (ratio < 1.6)), dict(zip(names, ratio, strict=True))


def test_directions_are_found_and_chosen():
    sides = {"positive": {"coulomb": 0.4, "viscous": 0.03}, "negative": {"coulomb": 0.25, "viscous": 0.08}}
    time, _, velocity = motion()
    model = fh.models.create("coulomb", coulomb=0.3, modifiers={"direction": sides})
    torque = model.simulate(velocity, PERIOD_S) + 0.02 * np.gradient(velocity, PERIOD_S)
    torque += 0.002 * np.random.default_rng(0).normal(size=len(time))
    best = found(made(time, velocity, torque), families=("coulomb",)).best
    assert best.label == "coulomb + direction"
    for side, wanted in sides.items():
        assert best.friction[1]["direction"][side] == pytest.approx(wanted, rel=0.01)
    assert any("offset" in flag and flag.startswith("collinear") for flag in best.flags)


@pytest.mark.parametrize(
    ("family", "noise", "others", "reason"),
    [
        ("coulomb", 0.02, ("stribeck", "dahl", "power_law", "table"), "coulomb"),
        ("stribeck", 0.01, ("coulomb",), "strokes of other speeds"),
    ],
)
def test_neither_a_simpler_nor_a_larger_family_than_the_true_one_is_chosen(family, noise, others, reason):
    result = found(recorded(family, noise), families=(family, *others))
    assert result.best.label == family
    assert reason in result.reason


def test_each_fit_is_reported_with_its_place_in_its_stage() -> None:
    steps: list[FitStep] = []
    settings = IdentificationSettings(gravity="none", families=("coulomb",))
    result = identify([recorded("coulomb", noise=0.02)], settings, progress=steps.append)
    families = [step for step in steps if step.stage == "families"]
    assert [(step.number, step.count) for step in families] == [(k, 2) for k in (1, 2)]
    assert {step.label for step in families} <= {fit.label for fit in result.fits}
    others = [step for step in steps if step.stage == "modifiers"]
    assert steps == families + others
    assert [(step.number, step.count) for step in others] == [(k, None) for k in range(1, len(others) + 1)]


def test_level_below_coulomb_is_allowed():
    assert fit_of("stribeck", recorded("stribeck", static=0.2)).values["static"] == pytest.approx(0.2, rel=1e-6)


def test_karnopp_is_stribeck_and_says_so_and_the_clock_does_not_matter():
    one = recorded("stribeck", noise=0.01)
    karnopp, stribeck = (fit_of(family, one) for family in ("karnopp", "stribeck"))
    assert karnopp.values["static"] == pytest.approx(stribeck.values["static"], rel=0.02)
    assert any("stick_velocity" in flag for flag in karnopp.flags)
    later = Recording("made.csv", "x", {**one.columns, "time_s": one["time_s"] + 1e6})
    assert fit_of("stribeck", later).values == pytest.approx(stribeck.values, rel=1e-5)


def test_units_only_scale_the_answer() -> None:
    """The same recording in other units of torque and position: parameters follow, errors do not change."""
    one = recorded("dahl", noise=0.01)
    other = Recording("made.csv", "x", dict(one.columns))
    for name, factor in {"torque": 1e3, "position": 1e-2, "velocity": 1e-2}.items():
        other.columns[name] = factor * one[name]
    a, b = (fit_of("dahl", each) for each in (one, other))
    assert b.train.relative_error == pytest.approx(a.train.relative_error, rel=1e-6)
    for name, factor in {"coulomb": 1e3, "sigma0": 1e5, "viscous": 1e5, "inertia": 1e5, "offset": 1e3}.items():
        assert b.values[name] == pytest.approx(factor * a.values[name], rel=1e-4), name
        errors = [each.inference.standard_errors[name] for each in (a, b)]
        assert errors[1] == pytest.approx(factor * errors[0], rel=1e-3), name


def test_outliers_count_less_with_the_robust_loss() -> None:
    recording = recorded("coulomb", noise=0.005)
    wrong = np.random.default_rng(5).choice(len(recording), len(recording) // 50, replace=False)
    recording.columns["torque"][wrong] += 5.0
    fits = [fit_of("coulomb", recording, is_robust=is_robust, decimation=1) for is_robust in (False, True)]
    off = [abs(fit.values["offset"] - MECHANICS["offset"]) for fit in fits]
    assert off[1] < 0.1 * off[0]


def test_pendulum_is_recognised():
    level, recording = recorded("coulomb", noise=0.01), recorded("coulomb", noise=0.01)
    recording.columns["torque"] += 0.5 * np.sin(recording["position"]) - 0.2 * np.cos(recording["position"])
    wanted = IdentificationSettings(families=("coulomb",), has_modifiers=False)
    best = identify([recording], wanted).best
    assert best.mechanics["gravity.sine"] == pytest.approx(0.5, rel=0.02)
    assert best.mechanics["gravity.cosine"] == pytest.approx(-0.2, abs=0.02)
    assert identify([level], wanted).best.mechanics["gravity.sine"] == 0.0


def test_vertical_axis_has_constant_gravity() -> None:
    recording = recorded("coulomb")
    recording.columns["torque"] += 2.0
    fit = fit_of("coulomb", recording, gravity="constant")
    assert fit.mechanics["gravity.constant"] == pytest.approx(2.0 + MECHANICS["offset"], rel=1e-6)
    assert fit.mechanics["offset"] == 0.0


def test_load_that_raises_friction_is_found():
    time, _, velocity = motion()
    load = 0.8 * np.sin(2.0 * np.pi * 0.23 * time)
    model = fh.models.create("coulomb", coulomb=0.3, viscous=0.05, modifiers={"load": {"motoring": 0.3, "driven": 0.1}})
    torque = model.simulate(velocity, PERIOD_S, load_torque=load) + 0.02 * np.gradient(velocity, PERIOD_S)
    torque += 0.005 * np.random.default_rng(2).normal(size=len(time))
    best = found(made(time, velocity, torque, load_torque=load), families=("coulomb",), has_modifiers=True).best
    assert "load" in best.structure.modifiers
    assert best.friction[1]["load"] == pytest.approx({"motoring": 0.3, "driven": 0.1}, rel=0.05)


def test_ripple_is_found_at_its_order() -> None:
    recording = recorded("coulomb", noise=0.005)
    recording.columns["torque"] += 0.05 * np.cos(30.0 * recording["position"])
    result = found(recording, families=("coulomb",), has_modifiers=True)
    _, modifiers = result.best.friction
    sizes = {each["order"]: np.hypot(each["cosine"], each["sine"]) for each in modifiers["ripple"]}
    order = max(sizes, key=lambda order: sizes[order])
    assert order == pytest.approx(30.0, rel=0.02)
    assert sizes[order] == pytest.approx(0.05, rel=0.1)


def test_held_values_stay_and_the_rest_is_found() -> None:
    held = {"inertia": 0.021, "sigma0": 42.0}
    fit = fit_of("dahl", recorded("dahl"), held=held)
    assert (fit.mechanics["inertia"], fit.friction[0]["sigma0"]) == (0.021, 42.0)
    assert set(fit.inference.names) == {"coulomb", "viscous", "offset"}


def test_constant_speed_alone_cannot_tell_level_from_viscous() -> None:
    time = np.arange(4000) * PERIOD_S
    velocity = 0.5 * np.sign(np.sin(2.0 * np.pi * 0.25 * time + 0.1))
    torque = 0.3 * np.sign(velocity) + 0.05 * velocity + 0.01 * np.random.default_rng(0).normal(size=len(time))
    flags = fit_of("coulomb", made(time, velocity, torque)).flags
    [flag, *_] = (flag for flag in flags if flag.startswith("collinear") and "coulomb" in flag and "viscous" in flag)
    assert "wider range" in flag


def test_presliding_that_never_occurs_is_reported() -> None:
    """Sliding in one direction alone shows no stiffness."""
    time = np.arange(6000) * PERIOD_S
    velocity = 1.0 + 0.6 * np.sin(2.0 * np.pi * 0.5 * time)
    model = fh.models.create("dahl", sigma0=1e4, coulomb=0.3, viscous=0.05)
    torque = model.simulate(velocity, PERIOD_S) + 0.02 * np.gradient(velocity, PERIOD_S)
    torque += 0.01 * np.random.default_rng(0).normal(size=len(time))
    flags = fit_of("dahl", made(time, velocity, torque)).flags
    [flag, *_] = (flag for flag in flags if "sigma0" in flag and not flag.startswith("collinear"))
    assert "presliding" in flag


def test_validation_recording_decides() -> None:
    true, other = recorded("stribeck", noise=0.01), recorded("stribeck", noise=0.01, seed=9)
    wanted = IdentificationSettings(families=("coulomb", "stribeck"), gravity="none")
    result = identify([true], wanted, validation=[other])
    assert result.best.structure.family == "stribeck"
    assert result.best.validation.relative_error == pytest.approx(result.best.train.relative_error, rel=0.3)
    assert "validation" in result.reason


def test_several_recordings_are_one_fit() -> None:
    parts = [recorded("stribeck", noise=0.01, seed=seed) for seed in range(2)]
    fit, alone = fit_of("stribeck", *parts), fit_of("stribeck", parts[0])
    assert len(fit.curves.measured) == 2 * len(alone.curves.measured)
    assert fit.inference.standard_errors["static"] < 0.85 * alone.inference.standard_errors["static"]


def test_model_file_predicts_the_fitted_torque() -> None:
    """What is written gives the error that was stated, through replay, which knows nothing of identification."""
    from friction_hil.replay.comparison import replay

    recording = recorded("lugre", noise=0.02)
    result = found(recording, families=("lugre",), decimation=1)
    (prediction,) = replay(recording, {"found": model_file(result)}).predictions
    assert prediction.relative_error == pytest.approx(result.best.train.relative_error, rel=1e-6)
    content = as_model_file(result)
    assert content["fit"]["recordings"] == [{"path": "made.csv", "rows": len(recording)}]
    assert content["fit"]["train"]["relative_error"] == pytest.approx(prediction.relative_error, rel=1e-6)


def test_curves_add_up_and_json_has_the_keys_of_the_contract():
    result = found(recorded("dahl", noise=0.01), families=("dahl",))
    curves = result.best.curves
    np.testing.assert_allclose(curves.residual, curves.measured - curves.predicted, atol=1e-12)
    assert len(curves.time_s) == len(curves.velocity) == len(curves.position) == len(curves.measured)
    mechanics = curves.predicted - curves.friction
    np.testing.assert_allclose(mechanics - mechanics.mean(), MECHANICS["inertia"] * curves.acceleration, atol=0.01)
    document = as_json(result)
    assert document["best"] == result.best.label
    names = {"model", "parameters", "modifiers", "standard_errors", "correlations", "mechanics", "train"}
    assert all(names | {"cross_validation", "validation", "flags"} <= set(fit) for fit in document["fits"])


@pytest.mark.parametrize(
    ("change", "settings", "error", "message"),
    [
        ({"torque": None}, {}, RecordingError, "column torque"),
        ({"position": None, "velocity": None}, {}, RecordingError, "column position"),
        ({"torque": 0.0}, {}, RecordingError, "torque is zero"),
        ({"velocity": 0.0}, {}, RecordingError, "does not move"),
        ({"rows": 40}, {}, RecordingError, "40 rows"),
        ({}, {"families": ("lugree",)}, UsageError, "did you mean 'lugre'"),
        ({}, {"held": {"coulom": 1.0}}, UsageError, "did you mean 'coulomb'"),
        ({}, {"held": {"coulomb": -1.0}}, UsageError, "coulomb"),
        ({}, {"lowpass_hz": 300.0}, UsageError, "250 Hz"),
        ({}, {"lowpass_hz": 0.5}, RecordingError, "too few"),
        ({}, {"decimation": 0}, UsageError, "from 1"),
    ],
)
def test_mistakes_are_reported(change, settings, error, message):
    recording = recorded("coulomb")
    for name, values in list(recording.columns.items()):
        if change.get(name, 0.0) is None:
            del recording.columns[name]
        else:
            recording.columns[name] = (values if name not in change else 0.0 * values)[: change.get("rows")]
    with pytest.raises(error, match=message):
        found(recording, **{"families": ("coulomb",), **settings})


def test_a_torque_that_was_read_late_is_moved_back() -> None:
    whole = recorded("lugre")
    late = Recording(whole.path, whole.axis, {**whole.columns, "torque": np.roll(whole["torque"], 3)})
    late.columns["torque"][:3] = whole["torque"][0]
    late.metadata["facts"] = [{"name": "y", "torque_delay_s": 1.0}, {"name": "x", "torque_delay_s": 3.0 * PERIOD_S}]
    before = late["torque"].copy()
    [moved], [known] = prepare(late), prepare(whole)
    np.testing.assert_allclose(moved.torque[:-3], known.torque[:-3], rtol=0.0, atol=1e-9)
    assert "the drive's torque was read 6 ms late: moved back by as much" in moved.problems
    assert np.array_equal(late["torque"], before), "the recording itself is left as it is"
    assert found(late, families=("lugre",)).best.train.relative_error < 0.02
    del late.metadata["facts"]
    assert found(late, families=("lugre",)).best.train.relative_error > 0.05


def test_every_dynamic_family_is_refined_by_its_simplest_fit() -> None:
    """Also one that ordinary records show to be much worse: what sets these families apart they do not show."""
    result = found(recorded("stribeck", noise=0.01), families=("stribeck", "dahl", "lugre"))
    [worst] = (each for each in result.fits if each.label == "dahl")
    assert worst.held_out.rmse > 2.0 * result.best.held_out.rmse
    again = to_refine(result.best, result.fits)
    assert again[0] is result.best
    assert {each.label for each in again} == {"stribeck", "dahl", "lugre"}
    static = [each for each in result.fits if each.structure.family == "stribeck"]
    assert to_refine(result.best, static) == []
