"""Trial of a model: the motions that an axis makes, within its bounds, and what is announced of them."""

import math
import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from friction_hil.config.trajectories import ExperimentBounds, peak_speed
from friction_hil.daemon.assembly import make_path, ramp_s
from friction_hil.tuning.announcement import allowed_speeds, trial_text
from friction_hil.tuning.motions import experiment_of, trial_run, uncompensated
from friction_hil.tuning.trial_motions import MOTIONS, trial_motions
from tests.servo_drives import PERIOD_S
from tests.unit.tuning.test_tuning import COUNT, axis, machine

sizes, frequencies, phases = st.floats(0.02, 2.0), st.floats(0.1, 2.0), st.floats(0.0, 6.0)
own_motions = st.one_of(
    st.fixed_dictionaries({"kind": st.just("sine"), "amplitude": sizes, "frequency": frequencies, "phase": phases}),
    st.fixed_dictionaries({"kind": st.just("circle"), "radius": sizes, "frequency": frequencies, "phase": phases}),
    st.fixed_dictionaries(
        {"kind": st.just("triangle"), "amplitude": sizes, "frequency": frequencies, "rounding": st.floats(0.05, 0.5)}
    ),
    st.fixed_dictionaries(
        {"kind": st.just("strokes"), "stroke": sizes, "frequency": st.floats(0.1, 1.5), "rest": st.floats(0.0, 0.6)}
    ),
    st.just({"kind": "hold"}),
)
experiments = st.fixed_dictionaries(
    {"velocity": st.floats(0.5, 12.0), "travel": st.floats(0.1, 3.0), "ramp_s": st.floats(0.1, 2.0)}
    | {"acceleration": st.none() | st.floats(3.0, 300.0)}
)


def tried(*names, resolutions=None, **axes):
    """Return configuration and run of a trial of each axis's own model."""
    configuration = machine(**axes)
    models = {name: configuration.axes[name].model for name in names or axes}
    found = dict.fromkeys(models, COUNT) if resolutions is None else resolutions
    return configuration, *trial_run(configuration, models, found)


def demanded(axis_config, step):
    """Position, velocity and acceleration of the path (n, 3), relative to its start."""
    path = make_path(axis_config, COUNT, PERIOD_S)
    return np.array([path(s) for s in np.arange(0.0, axis_config.trajectory.duration_s, step).tolist()])


@settings(max_examples=40, deadline=None)
@given(own=own_motions, bounds=experiments, resolution=st.floats(1e-7, 1e-3))
def test_a_trial_stays_within_what_the_user_allowed(own, bounds, resolution) -> None:
    """No further, faster or harder than the axis's own motion or its experiment, whichever goes further."""
    _, run, _ = tried(x=axis(trajectory=own, experiment=bounds), resolutions={"x": resolution})
    sequence = run.axes["x"].trajectory
    step = min(5e-3, 0.01 / max(part.motion.frequency for part in sequence.motions))
    rows = demanded(run.axes["x"], step)
    first = rows[: math.ceil(sequence.motions[0].duration_s / step)]  # its own
    travel = bounds["travel"]
    assert min(-travel, 1.01 * first[:, 0].min()) <= rows[:, 0].min()
    assert rows[:, 0].max() <= max(travel, 1.01 * first[:, 0].max())
    own_speed = np.abs(first[:, 1]).max()
    assert np.abs(rows[:, 1]).max() <= max(bounds["velocity"], 1.01 * own_speed) * (1.0 + 1e-9)
    assert np.abs(rows[:, 1]).max() <= peak_speed(sequence) * (1.0 + 1e-9)
    if bounds["acceleration"] is not None:
        allowed = max(bounds["acceleration"], 1.01 * np.abs(first[:, 2]).max())
        assert np.abs(rows[:, 2]).max() <= allowed
    if own["kind"] == "hold":
        assert (np.abs(rows[:, 0]).max(), own_speed) <= (travel, bounds["velocity"] * (1.0 + 1e-9))


def amplitude_of(motion):
    if motion.kind == "strokes":
        return 0.5 * motion.stroke
    return motion.radius if motion.kind == "circle" else motion.amplitude


@settings(max_examples=60, deadline=None)
@given(own=own_motions, bounds=experiments, resolution=st.floats(1e-7, 1e-3))
def test_each_motion_of_a_trial_is_what_its_name_says(own, bounds, resolution) -> None:
    configuration, run, _ = tried(x=axis(trajectory=own, experiment=bounds), resolutions={"x": resolution})
    parts = {part.name: part for part in run.axes["x"].trajectory.motions}
    speeds = {name: peak_speed(part.motion) for name, part in parts.items()}
    strokes = {name: amplitude_of(part.motion) for name, part in parts.items()}
    assert list(parts) == [name for name in MOTIONS if name in parts]
    if own["kind"] != "hold":
        assert parts["own"].motion == configuration.axes["x"].trajectory
    if "slow" in parts:
        assert speeds["slow"] == pytest.approx(0.1 * speeds["own"])
    if "small" in parts:
        assert strokes["small"] == pytest.approx(0.1 * strokes["own"])
    if "tiny" in parts:
        assert strokes["tiny"] == pytest.approx(max(0.01 * strokes["own"], 25.0 * resolution))
        assert strokes["tiny"] < 0.6 * strokes["small"]
    if 0.01 * strokes["own"] > 25.0 * resolution:
        assert {"small", "tiny"} <= set(parts)
    assert min(strokes.values()) >= 12.0 * resolution or set(parts) <= {"own", "fast"}
    assert max(speeds.values()) == pytest.approx(max(speeds["own"], speeds.get("fast", 0.0)))
    for name in set(parts) - {"own"}:
        assert parts[name].duration_s < 5.0 + 6.0 / min(1.0, parts["own"].motion.frequency) + 2.0 * parts[name].ramp_s


def test_what_a_coarse_encoder_does_not_show_is_left_out_and_said() -> None:
    coarse = {"x": 2.0 * math.pi / 2**12}
    configuration, run, duration = tried(x=axis(), resolutions=coarse)
    bounds = {"x": experiment_of("x", configuration.axes["x"])}
    names = [part.name for part in run.axes["x"].trajectory.motions]
    text = trial_text(run, bounds, [{"x": "dahl"}], duration)
    assert ("tiny" in names) == (25.0 * coarse["x"] <= 0.05 * configuration.axes["x"].trajectory.amplitude)
    missing = [name for name in ("slow", "small", "tiny", "rests") if name not in names]
    assert missing, "this encoder does not show all of them"
    assert f"\n  without {', '.join(missing)}: the encoder does not show such strokes\n" in text


def test_all_axes_begin_each_motion_together_and_stay_on_their_common_circle() -> None:
    circle = {"kind": "circle", "radius": 0.3, "frequency": 0.5, "ramp_s": 0.5}
    x, y = axis(trajectory=circle), axis(trajectory={**circle, "phase": -0.5 * math.pi})
    quick = axis(trajectory={"kind": "sine", "amplitude": 0.01, "frequency": 2.0, "ramp_s": 0.2})
    _, run, duration = tried(x=x, y=y, z=quick, resolutions={"x": COUNT, "y": COUNT, "z": 1e-4})
    starts = {}
    for name, each in run.axes.items():
        begin, starts[name] = 0.0, {}
        for part in each.trajectory.motions:
            starts[name][part.name] = begin
            begin += part.duration_s
        assert begin + ramp_s(run.axes.values()) <= duration
        assert begin == pytest.approx(run.axes["x"].trajectory.duration_s)
    assert "tiny" not in starts["z"], "z makes fewer motions, and rests meanwhile"
    for name, begin in starts["z"].items():
        assert begin == pytest.approx(starts["x"][name])
    rows = {name: demanded(run.axes[name], 1e-3) for name in ("x", "y")}
    first = slice(0, round(1e3 * run.axes["x"].trajectory.motions[0].duration_s))
    radius = np.hypot(rows["x"][first, 0] + 0.3, rows["y"][first, 0])
    assert radius == pytest.approx(0.3, abs=1e-9)
    periods = {name: run.axes[name].trajectory.motions[0].periods for name in run.axes}
    assert periods["z"] == pytest.approx(4.0 * periods["x"], abs=3)


def test_the_run_without_compensation_is_the_same_motion() -> None:
    _, run, _ = tried("x", x=axis(compensation={"baseline_s": 5.0}), y=axis())
    without = uncompensated(run)
    assert run.axes["x"].compensation.enabled
    assert run.axes["x"].compensation.baseline_s == 0.0
    assert not any(each.compensation.enabled for each in without.axes.values())
    assert {name: each.trajectory for name, each in without.axes.items()} == {
        name: each.trajectory for name, each in run.axes.items()
    }


@settings(max_examples=25, deadline=None)
@given(own=own_motions, bounds=experiments)
def test_the_announcement_of_a_trial_says_how_far_and_how_fast(own, bounds) -> None:
    """The numbers in the text are those of the set-points that the daemon would send."""
    configuration, run, duration = tried("x", x=axis(trajectory=own, experiment=bounds), y=axis())
    limits = {"x": experiment_of("x", configuration.axes["x"])}
    text = trial_text(run, limits, [{"x": "dahl"}, {"x": "gms"}], duration)
    first, *lines, last = text.splitlines()
    numbers = r"-?\d+\.?\d*(?:e-?\d+)?"
    low, high, fastest, stopped = (float(each) for each in re.findall(numbers, first))
    rows = demanded(run.axes["x"], 5e-3)
    assert (low, high) == pytest.approx((rows[:, 0].min(), rows[:, 0].max()), rel=0.02, abs=2e-3)
    speed = np.abs(rows[:, 1]).max()
    assert fastest == pytest.approx(speed, rel=0.02)
    least = 0.1 * 30.0  # of limits.velocity: friction makes a slow axis jump too
    assert stopped == pytest.approx(min(max(1.5 * fastest, 1.5 * bounds["velocity"], least), 30.0), rel=0.01)
    assert allowed_speeds(run, limits)["x"] == pytest.approx(max(fastest, bounds["velocity"], least / 1.5), rel=0.01)
    parts = list(run.axes["x"].trajectory.motions)
    told = [line for line in lines if not line.startswith("  without")]
    assert [line.split(":")[0].strip() for line in told] == [part.name for part in parts]
    for line, part in zip(told, parts, strict=True):
        _, _, speed, seconds = (float(each) for each in re.findall(numbers, line.split(":", 1)[1]))
        assert speed == pytest.approx(peak_speed(part.motion), rel=0.01)
        assert seconds == pytest.approx(part.moving_s, rel=0.06)
    assert last.startswith(f"all of it in {duration:.0f} s, 3 times: ")
    assert ", compensated by dahl, compensated by gms, then at most 2 times more" in last
    assert last.endswith("; y held")
    *same, ahead = trial_text(run, limits, [], duration).splitlines()
    assert same == [first, *lines]
    assert ahead.startswith(f"all of it in {duration:.0f} s, once: without compensation, while the models are computed")
    *_, rest = trial_text(run, limits, [{"x": "dahl"}], duration, has_baseline=True).splitlines()
    assert rest.startswith(f"all of it in {duration:.0f} s, once: compensated by dahl, then at most 2 times more")


def test_the_announcement_names_the_model_of_each_axis():
    configuration, run, duration = tried(x=axis(), y=axis())
    limits = {name: experiment_of(name, configuration.axes[name]) for name in ("x", "y")}
    text = trial_text(run, limits, [{"x": "dahl", "y": "gms"}, {"x": "dahl", "y": "dahl"}], duration)
    last = text.splitlines()[-1]
    assert f"all of it in {duration:.0f} s, 3 times: " in last
    assert ", compensated by dahl (x) and gms (y), compensated by dahl, then at most 2 times more" in last


def test_a_motion_that_takes_its_time_is_made_once_and_still_shown() -> None:
    """A period of a minute: only the own motion takes minutes."""
    bounds = ExperimentBounds(velocity=0.5, travel=1.0)
    _, run, duration = tried(x=axis(trajectory={"kind": "sine", "amplitude": 0.5, "frequency": 1 / 60}))
    others = sum(part.duration_s for part in run.axes["x"].trajectory.motions[1:])
    assert others < 60.0
    assert duration < 60.0 * 4 + others
    assert "slow" in trial_motions(run.axes["x"].trajectory.motions[0].motion, bounds, COUNT)
