"""The experiment and the refinement: a servo whose truth is known moves as planned, and is identified."""

import math
import re
from functools import cache
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from friction_hil.daemon.assembly import make_path
from friction_hil.daemon.axis import AxisLoop
from friction_hil.drive import AxisFacts
from friction_hil.errors import RecordingError, UsageError
from friction_hil.identification import Identification, IdentificationSettings, identify
from friction_hil.identification.data import prepare
from friction_hil.identification.export import as_json, as_model_file
from friction_hil.identification.fine import fine_data, is_fine, is_presliding_excited, velocity_by_bands
from friction_hil.identification.refine import _corrected
from friction_hil.identification.regression import Regression
from friction_hil.motion import experiment
from friction_hil.motion.trajectory import PathTime, extent, sweeps_path
from friction_hil.numerics import filtering
from friction_hil.recordings import Recording
from friction_hil.servo.config import ServoConfig
from friction_hil.servo.servo import Servo
from tests.servo_drives import axis_dict, configuration

Array = NDArray[np.float64]

PERIOD_S = 1e-3
LUGRE = {"sigma0": 900.0, "sigma1": 0.6, "sigma2": 4e-3, "coulomb": 0.11, "static": 0.17}
LUGRE |= {"stribeck_velocity": 0.12, "damping_velocity": 0.12}
TRUTH = {**LUGRE, "inertia": 2e-4}
PARTS = {"mechanics": {"inertia": TRUTH["inertia"], "load_torque": 0.0}, "encoder": {"counts": 2**20}}
PARTS |= {"friction": {"model": "lugre", "parameters": LUGRE}, "integration_hz": 400_000.0}
PLANT = ServoConfig.model_validate(PARTS)
SIDES = {"positive": {"coulomb": 0.13, "static": 0.21}, "negative": {"coulomb": 0.09, "static": 0.13}}
RIPPLE = {"order": 42, "cosine": 0.005, "sine": 0.008}
MODIFIERS = {"direction": SIDES, "ripple": [RIPPLE]}
MODIFIED = ServoConfig.model_validate(PARTS | {"friction": PARTS["friction"] | {"modifiers": MODIFIERS}})
CSP = 8
DURATION_S = 30.0
PARTS = 8  # samples of the drive's controller in a period
STEPS = 400 // PARTS


@cache
def moved(start: float, *, is_modified: bool) -> tuple[Array, Array, Array]:
    """The experiment on the simulated servo: counted position, mean torque and torque at each sample."""
    servo = Servo(MODIFIED if is_modified else PLANT, start)
    servo.set_period(PERIOD_S)
    time = np.arange(round(DURATION_S / PERIOD_S), dtype=np.float64) * PERIOD_S
    position, mean, instant = np.empty_like(time), np.empty_like(time), np.empty_like(time)
    sweeps = experiment.plan(2.0, 0.5, 1.0 / servo.counts_per_unit, DURATION_S)
    before = 0.0
    lag_fraction = 1.0 / (STEPS * math.expm1(1.0 / (PLANT.integration_hz * PLANT.motor.torque_lag_s)))
    for k, demand in enumerate((start + experiment.demand(time, sweeps)[0]).tolist()):
        servo.command(CSP, demand)
        total = 0.0
        for _ in range(PARTS):
            servo.advance(STEPS)
            # the demand stands between samples and the torque follows it exponentially: its exact mean
            total += servo.torque_demand - lag_fraction * (servo.torque - before)
            before = servo.torque
        position[k], mean[k], instant[k] = servo.position, total / PARTS, servo.torque
    return position, mean, instant


def recorded(seed: int, *, kind: str = "mean", is_modified: bool = False) -> Recording:
    """The experiment as it is recorded: the torque has noise of 1 % of its RMS.

    ``kind`` is mean, instant, or late: an instantaneous torque that is two samples old.
    """
    random = np.random.default_rng(seed)
    position, mean, instant = moved(random.uniform(), is_modified=is_modified)
    torque = (mean if kind == "mean" else instant).copy()
    if kind == "late":
        torque[2:] = torque[:-2].copy()
    torque += 0.01 * np.sqrt(np.mean(torque**2)) * random.standard_normal(len(torque))
    time = PERIOD_S + PERIOD_S * np.arange(len(torque))
    return Recording(f"{seed}.csv", "x", {"time_s": time, "position": position, "torque": torque})


PLAIN = {"families": ("lugre",), "has_modifiers": False, "torque": "mean"}


def found(recording: Recording, **changes: Any) -> Identification:
    return identify([recording], IdentificationSettings(**{**PLAIN, **changes}))


@pytest.fixture(scope="module")
def result() -> Identification:
    return found(recorded(0), replicas=4)


@pytest.fixture(scope="module")
def results(result: Identification) -> list[Identification]:
    return [result, *(found(recorded(seed), replicas=4) for seed in range(1, 6))]


@pytest.mark.deep
def test_each_parameter_is_found_within_its_limits(results: list[Identification]) -> None:
    for result in results:
        assert result.best.label == "lugre"
        assert result.best.is_refined
        for name, value in TRUTH.items():
            limit = 0.20 if name == "sigma1" else 0.05
            assert result.best.values[name] == pytest.approx(value, rel=limit), name


@pytest.mark.deep
def test_stated_errors_cover_the_truth_and_are_not_too_wide(results):
    """95 % intervals of LuGre's own parameters; a few seeds cannot tell 88 from 99, but 60 from 95."""
    names = [name for name in LUGRE if name != "damping_velocity"]  # tied to the Stribeck velocity
    bests = [result.best for result in results]
    errors = np.array([[fit.values[name] / TRUTH[name] - 1.0 for name in names] for fit in bests])
    stated = np.array([[fit.inference.standard_errors[name] / TRUTH[name] for name in names] for fit in bests])
    deviations = np.abs(errors) / stated
    assert np.mean(deviations < 1.96) >= 0.85
    assert deviations.max() < 4.0
    widths = np.sqrt(np.mean(stated**2, axis=0) / np.mean(errors**2, axis=0))
    assert np.median(widths) < 2.5
    assert widths.max() < 4.0  # a ratio of six values is itself known to a third only


def test_the_residual_is_the_noise_of_the_torque_and_the_result_says_that_it_was_refined(result):
    """White noise of 1 % passes the low-pass at 80 of 500 Hz in part; the rest is due to wrong states."""
    fit = result.best
    assert 0.003 < fit.train.relative_error < 0.04
    assert fit.held_out.relative_error < 0.04
    assert len(fit.curves.measured) == len(fit.curves.time_s) == len(fit.curves.velocity)
    assert "presliding" in result.reason
    assert as_model_file(result)["fit"]["refined"] is True
    assert [fit["refined"] for fit in as_json(result)["fits"]] == [True] + [False] * (len(result.fits) - 1)


def test_without_refinement_the_same_recording_does_not_determine_damping() -> None:
    """Reason for the refinement: if this test fails, the refinement is unnecessary."""
    fit = found(recorded(0), refine=False).best
    assert not fit.is_refined
    assert abs(fit.values["sigma1"] / LUGRE["sigma1"] - 1.0) > 0.2


def test_subtracting_the_shift_leaves_viscous_friction_and_inertia_at_zero_or_above(result):
    """A shift as large as the parameter: subtracting more would make friction drive the axis."""
    fit = result.best
    regression = Regression(fine_data(result.records, is_mean=True), fit.structure, ["inertia", "offset"])
    estimate = regression.estimate(fit.coordinates)
    size = np.array([{"sigma2": 1.5, "offset": 3.0}.get(name, 1e-3) * estimate.values[name] for name in estimate.names])
    shifts = size * np.array([[0.9], [1.1]])
    corrected, _, notes = _corrected(regression, estimate, fit.inference, shifts)
    assert (corrected.values["sigma2"], corrected.at_bound, notes) == (0.0, ("sigma2",), [])
    assert corrected.values["offset"] * estimate.values["offset"] < 0.0, "an offset may have any sign"
    assert corrected.values["coulomb"] == pytest.approx(0.999 * estimate.values["coulomb"], rel=1e-5)
    model = fit.structure.model({name: corrected.values[name] for name in fit.structure.names})
    assert model.parameters["sigma2"] == 0.0


@pytest.mark.deep
def test_directions_and_ripple_are_found_at_the_resolution_of_the_encoder() -> None:
    best = found(recorded(1, is_modified=True), has_modifiers=True, replicas=4).best
    assert best.is_refined
    assert set(best.structure.modifiers) >= {"direction", "ripple"}
    _, modifiers = best.friction
    for side, levels in SIDES.items():
        for name, level in levels.items():
            assert modifiers["direction"][side][name] == pytest.approx(level, rel=0.1), (side, name)
    [harmonic] = (each for each in modifiers["ripple"] if each["order"] == RIPPLE["order"])
    assert harmonic == pytest.approx(RIPPLE, abs=1e-3)
    others = [math.hypot(each["cosine"], each["sine"]) for each in modifiers["ripple"] if each is not harmonic]
    assert max(others, default=0.0) < 2e-3, "others are small beside it"


def test_a_symmetric_axis_without_ripple_gets_no_modifiers() -> None:
    result = found(recorded(1), has_modifiers=True, replicas=4)
    assert result.best.label == "lugre"


@pytest.mark.deep
@pytest.mark.parametrize(("kind", "least", "most"), [("mean", 0.4, 0.6), ("instant", -0.1, 0.3), ("late", 1.8, 2.4)])
def test_the_age_of_the_torque_is_found(kind: str, least: float, most: float) -> None:
    result = found(recorded(2, kind=kind), torque="auto", replicas=4)
    assert result.torque.meaning == kind
    assert least < result.torque.delay_s / PERIOD_S < most
    assert result.torque.error_s < 0.1 * PERIOD_S
    assert result.torque.text in result.notes
    # an error of the age appears in the damping, times the stiffness
    doubt = LUGRE["sigma0"] * (most - least) / 2.0 * PERIOD_S
    assert result.best.values["sigma1"] == pytest.approx(LUGRE["sigma1"], abs=max(doubt, 0.1))


def short(resolution: float | None, frequency: float, amplitude: float, seconds: float = 8.0) -> Recording:
    """A sine and the torque of Coulomb friction."""
    time = np.arange(round(seconds / PERIOD_S), dtype=np.float64) * PERIOD_S
    angle = 2.0 * math.pi * frequency * time
    position = amplitude * np.sin(angle)
    if resolution is not None:
        position = np.floor(position / resolution) * resolution
    return Recording("sine.csv", "x", {"time_s": time, "position": position, "torque": 0.1 * np.sign(np.cos(angle))})


COUNT = 2.0 * math.pi / 2**20


@pytest.mark.parametrize(
    ("resolution", "frequency", "amplitude", "is_excited"),
    [
        (COUNT, 20.0, 1e-3, True),
        (COUNT, 0.5, 0.3, False),  # slow: it only slides
        (COUNT, 20.0, 1.5 * COUNT, False),  # lost in the counts
        (None, 20.0, 1e-3, False),  # of an encoder that nobody knows
    ],
)
def test_the_data_decide_what_is_refined(resolution, frequency, amplitude, is_excited):
    (record,) = prepare(short(resolution, frequency, amplitude))
    assert is_presliding_excited(record) == is_excited


def test_coarse_records_are_not_refined_and_neither_is_a_static_map() -> None:
    with pytest.raises(RecordingError, match="steps of the encoder"):
        found(short(None, 20.0, 1e-3), refine=True, families=("dahl",))
    assert not found(short(COUNT, 20.0, 1e-3), refine=True, families=("coulomb",)).best.is_refined


def sines(frequencies: list[float], seconds: float = 4.0, fine: int = 12) -> tuple[Array, Array]:
    """Position at 1 kHz and, in the middle of each fine step, the mean velocity of a sampling period about it."""
    samples = round(seconds / PERIOD_S)
    middles = (np.arange((samples - 1) * fine) + 0.5) * PERIOD_S / fine

    def position(time: NDArray[np.floating[Any]]) -> Array:
        return np.asarray(np.sum([0.1 / f * np.sin(2.0 * math.pi * f * time + f) for f in frequencies], axis=0))

    velocity = (position(middles + 0.5 * PERIOD_S) - position(middles - 0.5 * PERIOD_S)) / PERIOD_S
    return position(PERIOD_S * np.arange(samples)), velocity


@settings(max_examples=25, deadline=None)
@given(st.lists(st.floats(0.5, 300.0), min_size=1, max_size=4))
def test_bands_keep_a_clean_signal(frequencies: list[float]) -> None:
    position, velocity = sines(frequencies)
    estimated = velocity_by_bands(position, 1.0 / PERIOD_S, 1e-9, 12)
    middle = slice(6000, -6000)
    assert len(estimated) == len(velocity)
    assert np.abs(estimated - velocity)[middle].max() < 2e-3 * np.abs(velocity).max()


def test_bands_remove_the_noise_of_the_counts() -> None:
    """A slow sine counted coarsely: less error than from one low-pass that is open as far as the last band."""
    position, velocity = sines([2.0])
    count = 3e-5
    counted = np.floor(position / count) * count
    estimated = velocity_by_bands(counted, 1.0 / PERIOD_S, count, 12)
    middle = slice(6000, -6000)
    error = np.sqrt(np.mean((estimated - velocity)[middle] ** 2))
    opened = np.gradient(filtering.lowpass(counted, 420.0, 1000.0), PERIOD_S)
    exact = np.gradient(position, PERIOD_S)
    assert error < 0.3 * np.sqrt(np.mean((opened - exact)[500:-500] ** 2))


plans = st.tuples(
    st.floats(0.05, 50.0),  # velocity
    st.floats(0.02, 100.0),  # travel
    st.sampled_from([2.0 * math.pi / 2**bits for bits in range(10, 25)]),
    st.floats(10.0, 600.0),  # duration
    st.sampled_from([math.inf, 500.0, 20.0]),  # acceleration
    st.sampled_from([2.5e-4, 5e-4, 1e-3, 2e-3, 4e-3, 1e-2]),  # period
)


@pytest.mark.deep
@settings(max_examples=40, deadline=None)
@given(plans)
def test_the_experiment_stays_within_its_bounds_and_ends_at_rest(wanted: tuple[float, ...]) -> None:
    velocity, travel, resolution, duration, acceleration, period = wanted
    try:
        sweeps = experiment.plan(velocity, travel, resolution, duration, acceleration=acceleration, period_s=period)
    except UsageError:  # a travel, or a speed for so short a time, of less than four counts
        assume(velocity >= 0.5 and travel >= 0.1)
        raise
    path = sweeps_path(sweeps)
    total = experiment.duration_s(sweeps)
    assert total == pytest.approx(duration, rel=0.1)
    fast = experiment.fast(sweeps)
    assert len(sweeps) == 2 + len(fast) <= 5
    assert all(sweep.largest >= 50.0 * resolution for sweep in fast)
    assert not fast or period <= 2e-3
    points = np.array([path(float(t)) for t in np.linspace(0.0, total, 5_000)])
    largest = np.abs(points).max(axis=0)
    assert largest[0] <= 0.85 * travel * (1.0 + 1e-9)
    assert largest[1] <= velocity * (1.0 + 1e-9)
    assert largest[2] <= acceleration
    assert path(0.0) == path(total + 1e-9) == path(-1.0) == (0.0, 0.0, 0.0)
    for end in np.cumsum([sweep.duration_s for sweep in sweeps]):
        position, speed = experiment.demand([end - 1e-7], sweeps)
        assert abs(position[0]) < 1e-9 * travel
        assert abs(speed[0]) < 1e-6 * velocity


@settings(max_examples=60, deadline=None)
@given(st.floats(0.0, 61.0))
@example(0.5)
@example(0.5 + 5e-6)
def test_velocity_and_acceleration_of_the_experiment_are_derivatives(t: float) -> None:
    path, h = sweeps_path(experiment.plan(2.0, 0.5, COUNT)), 1e-5
    (before, slow, a), (_, velocity, acceleration), (after, fast, b) = path(t - h), path(t), path(t + h)
    assume(abs(a - 2.0 * acceleration + b) < 0.05)  # where a sweep has faded in, the acceleration may step
    assert (after - before) / (2.0 * h) == pytest.approx(velocity, abs=1e-4)
    assert (fast - slow) / (2.0 * h) == pytest.approx(acceleration, abs=0.2)


def test_the_experiment_reaches_its_speed_and_shows_presliding_at_several_frequencies() -> None:
    sweeps = experiment.plan(2.0, 0.5, COUNT)
    assert extent(sweeps_path(sweeps), 60.0, 60_000)[2] == pytest.approx(2.0, rel=1e-3)
    fast = [sweep for sweep in sweeps if sweep.frequency >= 8.0]
    assert len({sweep.frequency for sweep in fast}) >= 3
    assert all(10 * COUNT < sweep.smallest < 0.1 * sweep.largest for sweep in fast)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"resolution": 0.2}, "finer encoder"),
        ({"acceleration": 1e-4}, "counts"),
        ({"duration_s": 3.0}, "10 s or more"),
        ({"travel": 0.0}, "travel"),
        ({"rated_velocity": math.nan}, "rated_velocity"),
        ({"resolution": math.inf}, "resolution"),
    ],
)
def test_an_impossible_experiment_is_refused(change: dict[str, float], message: str) -> None:
    with pytest.raises(UsageError, match=message):
        experiment.plan(**{"rated_velocity": 2.0, "travel": 0.5, "resolution": COUNT, **change})


@pytest.mark.parametrize(
    "change",
    [
        {"rated_velocity": 1e-5},
        {"travel": 1e-5},
        {"acceleration": 1e-5},
        {"resolution": 2.0 * math.pi / 512, "acceleration": 0.01, "travel": 0.01},
    ],
)
def test_limits_asked_for_by_a_coarse_encoder_are_enough_and_hardly_more(change: dict[str, float]) -> None:
    wanted = {"rated_velocity": 2.0, "travel": 0.5, "resolution": COUNT, **change}
    with pytest.raises(UsageError, match="too coarse") as refusal:
        experiment.plan(**wanted)
    asked = dict(re.findall(r"(velocity|acceleration|travel) to ([\d.e+-]+\d)", str(refusal.value)))
    raised = {("rated_velocity" if name == "velocity" else name): float(value) for name, value in asked.items()}
    assert experiment.plan(**{**wanted, **raised})
    assert all(value > wanted[name] for name, value in raised.items())
    for name, value in raised.items():
        with pytest.raises(UsageError, match=f"raise {name.removeprefix('rated_')} to"):
            experiment.plan(**{**wanted, **raised, name: 0.85 * value})


@pytest.mark.parametrize(
    ("bits", "velocity", "frequencies", "note"),
    [
        (20, 3.0, [10.0, 20.0, 40.0], ""),
        (17, 4.0, [10.0, 20.0, 40.0], ""),
        (16, 3.0, [5.0, 10.0], "presliding is shown at 5 and 10 Hz only"),
        (14, 8.0, [5.0, 10.0], "presliding is shown at 5 and 10 Hz only"),
        (14, 3.0, [], "presliding is not shown by an encoder with counts of 0.000383"),
        (10, 3.0, [], "presliding is not shown"),
    ],
)
def test_what_an_encoder_cannot_show_is_left_out_and_said(bits, velocity, frequencies, note):
    count = 2.0 * math.pi / 2**bits
    sweeps = experiment.plan(velocity, 1.0, count, period_s=1e-3)
    assert [sweep.frequency for sweep in experiment.fast(sweeps)] == frequencies
    said = experiment.not_shown(sweeps, count, 1e-3)
    assert said.startswith(note)
    assert bool(said) == bool(note)
    assert (count <= experiment.coarsest(velocity, 1.0)) == bool(frequencies)
    assert experiment.duration_s(sweeps) == pytest.approx(60.0, abs=2.0), "what is left out is time for the rest"


def configured(velocity: float = 2.5) -> Any:
    wanted = {"kind": "experiment", "velocity": 2.0, "travel": 0.5}
    return configuration(x=axis_dict(trajectory=wanted, limits={"torque": 0.3, "velocity": velocity})).axes["x"]


def test_a_configuration_can_ask_for_the_experiment():
    path = make_path(configured(), COUNT, PERIOD_S)
    times = np.linspace(0.0, 61.0, 500)
    demand = np.transpose(experiment.demand(times, experiment.plan(2.0, 0.5, COUNT, 60.0)))
    assert [path(float(t))[:2] for t in times] == list(map(tuple, demand.tolist()))
    with pytest.raises(UsageError, match=r"^x: the encoder is too coarse"):
        AxisLoop("x", configured(9.0), AxisFacts("x", "servo", 0.2, 1e-3, 1e-3, 1e-3), PERIOD_S, PathTime(1.0))
    with pytest.raises(UsageError, match="up to 2"):
        configured(1.5)


@pytest.mark.parametrize("first", range(0, 50, 7))
def test_at_the_least_rate_it_does_not_matter_how_time_stamps_are_rounded(first: int) -> None:
    """Of stamps every 2 ms the mean distance is 1 / 499.99999999999994 s as often as not."""
    cycle = np.arange(first, first + 10_541)
    position = COUNT * np.round(np.sin(1e-2 * cycle) / COUNT)
    for period, is_fast in ((2e-3, True), (2.1e-3, False)):
        columns = {"time_s": period * cycle, "position": position, "torque": np.sin(1e-2 * cycle)}
        [record] = prepare(Recording("stamps.csv", "x", columns))
        assert is_fine(record) is is_fast


def test_where_sampling_is_too_slow_for_presliding_the_slow_sweeps_take_all_the_time() -> None:
    fast, slow = (experiment.plan(2.0, 0.5, COUNT, 60.0, period_s=period) for period in (2e-3, 4e-3))
    assert fast == experiment.plan(2.0, 0.5, COUNT, 60.0)
    assert max(sweep.frequency for sweep in slow) < 8.0 < max(sweep.frequency for sweep in fast)
    assert experiment.duration_s(slow) == pytest.approx(60.0, abs=2.0)
    # no encoder is too coarse for an experiment without presliding
    assert len(experiment.plan(2.0, 0.5, 2.0 * math.pi / 500, 60.0, period_s=4e-3)) == len(slow)
