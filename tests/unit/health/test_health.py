"""Friction health: what recordings show, charts with a stated rate of false alarms, and the history."""

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import friction_hil as fh
from friction_hil.errors import FrictionHilError, RecordingError, UsageError
from friction_hil.health import Layout, Motion, Observation, Quantity
from friction_hil.health.chart import average_run_length, draw_chart, fit_baseline, threshold_for
from friction_hil.health.history import History, load
from friction_hil.health.metrics import metrics_text
from friction_hil.health.observation import label
from friction_hil.recordings import Recording
from friction_hil.recordings.json_lines import append

DAY_S = 86400.0
MOTION = Motion(1.0, 2.0)  # median speed, travel
LAYOUT = Layout("rotary", (-1.0, 0.0, 1.0), (1.0,))


def observed(values, temperatures=None, *, name="coulomb.positive", error=0.002, motion=MOTION):
    known = [None] * len(values) if temperatures is None else list(map(float, temperatures))
    return [
        Observation("x.mcap", DAY_S * k, 60.0, warm, motion, {name: Quantity(float(value), error)})
        for k, (value, warm) in enumerate(zip(values, known, strict=True))
    ]


def only(observations, **options):
    (verdict,) = fh.health.judge("x", observations, LAYOUT, **options).verdicts
    return verdict


@given(st.floats(10.0, 1e9))
def test_the_threshold_gives_the_run_length_that_is_asked_for(run_length):
    assert average_run_length(threshold_for(run_length)) == pytest.approx(run_length, rel=1e-6)


def test_the_run_length_is_that_of_simulated_sums():
    threshold, paths, length = 3.0, 4000, 1200
    steps = np.random.default_rng(1).normal(size=(length, paths)) - 0.5
    total, first = np.zeros(paths), np.full(paths, np.nan)
    for k, step in enumerate(steps):
        total = np.maximum(0.0, total + step)
        first[np.isnan(first) & (total > threshold)] = k + 1
    ended = np.isfinite(first)
    # paths without an alarm count with their whole length: the estimate of an exponential time that is cut off
    mean = (first[ended].sum() + length * np.sum(~ended)) / ended.sum()
    assert average_run_length(threshold) == pytest.approx(mean, rel=0.08)


@pytest.mark.parametrize(("memory", "per_kelvin"), [(0.0, 0.0), (0.5, 0.0), (0.0, 0.002)])
def test_false_alarms_are_not_more_than_stated(memory, per_kelvin):
    rng = np.random.default_rng(2)
    axes, days, first, alarms = 150, 395, 30, 0
    threshold = threshold_for(2.0 * 365.25)  # one false alarm a year of both sums
    for _ in range(axes):
        noise = rng.normal(size=days)
        for k in range(1, days):
            noise[k] = memory * noise[k - 1] + math.sqrt(1.0 - memory**2) * noise[k]
        warm = 30.0 + 5.0 * rng.normal(size=days)
        values = 0.2 + 0.004 * noise + per_kelvin * (warm - 30.0)
        errors = np.full(days, 1e-4)
        baseline = fit_baseline(values[:first], errors[:first], warm[:first])
        chart = draw_chart(baseline, values[first:], errors[first:], warm[first:], threshold)
        alarms += np.count_nonzero(np.diff((np.maximum(chart.upper, chart.lower) > threshold).astype(int)) > 0)
    assert alarms <= axes * (days - first) / 365.25


@settings(max_examples=25, deadline=None)
@given(st.sampled_from([-1.0, 1.0]), st.floats(0.01, 0.1), st.integers(35, 60), st.integers(0, 1000))
def test_a_step_is_found_with_its_day_and_size(sign, size, day, seed):
    values = 0.2 + 0.002 * np.random.default_rng(seed).normal(size=90) + sign * size * (np.arange(90) >= day)
    verdict = only(observed(values))
    assert verdict.state == "changed"
    assert verdict.since_s == pytest.approx(DAY_S * day, abs=5.0 * DAY_S)
    assert DAY_S * day <= verdict.alarm_s <= DAY_S * (day + 20)
    assert verdict.change == pytest.approx(sign * size, abs=5.0 * verdict.change_error)
    assert verdict.share == pytest.approx(sign * size / 0.2, rel=0.3)


def test_a_warm_summer_is_no_change_and_a_change_in_summer_is_one():
    rng = np.random.default_rng(3)
    warm = 20.0 + 10.0 * (np.arange(200) >= 80) + 3.0 * rng.normal(size=200)
    values = 0.3 - 0.004 * (warm - 20.0) + 0.003 * rng.normal(size=200)
    quiet = only(observed(values, warm))
    assert quiet.state == "unchanged"
    assert quiet.slope == pytest.approx(-0.004, abs=4.0 * quiet.slope_error)
    assert only(observed(values)).state == "changed"  # without the temperature it looks like one
    later = only(observed(values + 0.04 * (np.arange(200) >= 120), warm))
    assert later.state == "changed"
    assert later.change == pytest.approx(0.04, abs=5.0 * later.change_error)


def test_a_recording_that_went_wrong_or_a_change_that_has_ended_is_no_change():
    values = 0.2 + 0.002 * np.random.default_rng(5).normal(size=150)
    for at in (45, 59):  # the last one too
        wrong = 0.2 + 0.002 * np.random.default_rng(4).normal(size=60)
        wrong[at] = 5.0
        assert only(observed(wrong)).state == "unchanged", at
    values[60:80] += 0.05
    assert only(observed(values[:80])).state == "changed"
    assert only(observed(values)).state == "unchanged"


def test_observations_with_large_errors_count_less():
    values = 0.2 + 0.002 * np.random.default_rng(6).normal(size=45)
    values[35:] += 0.02
    exact = observed(values)
    vague = exact[:35] + observed(values, error=0.2)[35:]
    assert only(exact).state == "changed"
    assert only(vague).state == "unchanged"


@pytest.mark.parametrize("spread", [1e-3, 1e-5])
def test_ripple_that_grows_is_an_amplitude_again_in_the_result(spread):
    rng = np.random.default_rng(7)
    truth = np.where(np.arange(80) < 50, 0.0, 0.01)
    values = np.hypot(truth + spread * rng.normal(size=80), spread * rng.normal(size=80))
    verdict = only(observed(values, name="ripple.3", error=1.5 * spread))
    assert verdict.state == "changed"
    assert verdict.change == pytest.approx(0.01, rel=0.2)
    assert verdict.label == "ripple at order 3 per revolution"


def test_what_limits_the_judgement_is_said():
    values = 0.2 + 0.002 * np.random.default_rng(8).normal(size=40)
    assert only(observed(values[:30])).state == "learning"
    assert only(observed(values[:30])).reason == "30 of 31 observations"
    health = fh.health.judge("x", observed(values), LAYOUT)
    assert health.is_judged
    assert any("temperature is not recorded" in note for note in health.notes)
    some = observed(values, [30.0 + k % 7 for k in range(40)])
    assert not fh.health.judge("x", some, LAYOUT).notes
    some[3] = dataclasses.replace(some[3], temperature=None)
    assert any("in 29 of the first 30" in note for note in fh.health.judge("x", some, LAYOUT).notes)
    fast = observed(values[35:] + 1.0, motion=Motion(3.0, 2.0))
    mixed = observed(values[:35]) + [dataclasses.replace(each, time_s=each.time_s + 100 * DAY_S) for each in fast]
    health = fh.health.judge("x", mixed, LAYOUT)
    assert (health.count, health.changed) == (35, ())
    assert any("5 of 40 observations have another motion" in note for note in health.notes)
    assert not fh.health.judge("x", [], LAYOUT).is_judged
    with pytest.raises(UsageError, match="not 3"):
        fh.health.judge("x", some, LAYOUT, baseline=3)
    with pytest.raises(UsageError, match="nan"):
        fh.health.judge("x", some, LAYOUT, false_alarms=math.nan)


def swing(speeds=(1.2, 0.5), *, coulomb=(0.2, 0.16), viscous=0.03, ripple=0.0, play=0.0, seconds=30.0):
    """A recording at 200 Hz of an axis with Coulomb and viscous friction, in sines, and of its load behind a gap."""
    time = np.arange(0.0, seconds, 0.005)
    position = sum(2.5 / k * np.sin(speed * time) for k, speed in enumerate(speeds, 1))
    velocity = np.gradient(position, 0.005)
    level = np.where(velocity > 0.0, coulomb[0], -coulomb[1])
    torque = 0.01 * np.gradient(velocity, 0.005) + level + viscous * velocity + ripple * np.cos(3.0 * position)
    torque = torque + 0.003 * np.random.default_rng(9).normal(size=len(time))
    load = position - 0.5 * play * np.sign(velocity)
    columns = {"time_s": time, "position": position, "velocity": velocity, "torque": torque}
    return Recording("swing.csv", "x", columns | ({"load_position": load} if play else {}))


def test_an_observation_has_the_friction_of_each_direction():
    (found,), layout, problems = fh.health.observe(swing(ripple=0.02, play=0.004), started_s=1e9)
    assert not problems
    assert found.time_s == pytest.approx(1e9 + 15.0, abs=0.1)
    truth = {"coulomb.positive": 0.2, "coulomb.negative": 0.16, "viscous.positive": 0.03, "viscous.negative": 0.03}
    truth |= {"asymmetry": 0.02, "ripple.3": 0.02, "lost_motion": 0.004}
    truth |= {"zone.1.positive": 0.0, "zone.2.negative": 0.0}
    for name, value in truth.items():
        quantity = found.quantities[name]
        assert quantity.value == pytest.approx(value, abs=5.0 * quantity.error + 0.01 * value), name
        assert 0.0 < quantity.error < 0.05 * value + 3e-4, name
    assert found.quantities["ripple.2"].value < 0.002
    assert found.quantities["breakaway.positive"].value > found.quantities["breakaway.negative"].value
    assert layout.orders[:3] == (1.0, 2.0, 3.0)
    assert found.temperature is None


def test_friction_that_is_higher_in_a_part_of_the_travel_is_seen_there():
    tight = swing()
    inside = (tight["position"] > 0.0) & (tight["position"] < 1.5)
    tight.columns["torque"] = tight["torque"] + 0.04 * inside * np.sign(tight["velocity"])
    layout = Layout("rotary", (-3.0, -1.5, 0.0, 1.5, 3.0), ())
    (found,), _, _ = fh.health.observe(tight, started_s=0.0, layout=layout)
    extra = [found.quantities[f"zone.{k}.positive"].value for k in range(4)]
    assert extra[2] - np.mean(np.delete(extra, 2)) == pytest.approx(0.04, rel=0.25)


def test_motion_in_one_direction_at_one_speed_shows_neither_viscous_friction_nor_asymmetry():
    layout = fh.health.layout_of(np.linspace(-2.0, 2.0, 100), "rotary")
    time = np.arange(0.0, 30.0, 0.005)
    noise = np.random.default_rng(1).normal(size=len(time))
    columns = {"time_s": time, "position": 0.5 * time, "velocity": 0.5 + 0.0 * time, "torque": 0.2 + 0.003 * noise}
    (found,), _, _ = fh.health.observe(Recording("a.csv", "x", columns), started_s=0.0, layout=layout)
    assert {"viscous.positive", "coulomb.negative", "asymmetry", "breakaway.positive"} <= set(found.not_shown)
    assert "several constant speeds" in found.not_shown["viscous.positive"]
    health = fh.health.judge("x", [found] * 3, layout)
    assert {each.state for each in health.verdicts if each.name.startswith("viscous")} == {"not shown"}


def test_a_long_recording_gives_several_observations_and_one_at_rest_none():
    found, layout, _ = fh.health.observe(swing(seconds=60.0), started_s=0.0, window_s=20.0)
    assert [round(each.time_s) for each in found] == [10, 30, 50]
    rest = swing()
    rest.columns |= {"position": 0.0 * rest["position"], "velocity": 0.0 * rest["velocity"]}
    found, _, problems = fh.health.observe(rest, started_s=0.0, layout=layout)
    assert not found
    assert "slides for too short a time" in problems[0]
    with pytest.raises(RecordingError, match="no column torque"):
        fh.health.observe(Recording("a.csv", "x", {"time_s": np.arange(9.0), "position": np.zeros(9)}), started_s=0.0)


def test_a_history_is_read_as_it_was_written_also_after_a_power_cut(tmp_path):
    path, own = tmp_path / "state/x.jsonl", History()
    kept = observed([0.2, 0.21], [30.0, 31.0])
    append(path, [own.add_layout("x", LAYOUT), own.add("a.mcap 1.0", "9 1", "x", kept[:1])])
    assert load(path) == own
    with path.open("a") as file:
        file.write('{"version": 1, "file": "b.mca')  # the power went here
    assert load(path) == own
    append(path, [own.add("b.mcap 2.0", "9 1", "x", kept[1:])])
    assert load(path) == own
    assert own.observations("x") == kept
    append(path, [own.add("b.mcap 2.0", "12 3", "x", kept)])  # the file has grown
    assert load(path).observations("x") == [kept[0], *kept]


@pytest.mark.parametrize(
    "line",
    ["no JSON", '{"version": 2}', '{"version": 1, "axis": "x", "layout": {"kind": "round"}}', "[]", '{"version": NaN}'],
)
def test_a_file_that_is_no_history_is_refused_with_its_line(tmp_path, line):
    path = tmp_path / "x.jsonl"
    append(path, [History().add_layout("x", LAYOUT)])
    path.write_text(path.read_text() + line + "\n")
    with pytest.raises(FrictionHilError, match=r"x.jsonl, line 2: is no line of a history"):
        load(path)


def test_metrics_are_what_prometheus_reads():
    parser = pytest.importorskip("prometheus_client.parser", reason="the extra 'dashboard' is not installed")
    values = 0.2 + 0.002 * np.random.default_rng(5).normal(size=60) + 0.05 * (np.arange(60) >= 40)
    health = fh.health.judge('a"b\\', observed(values), LAYOUT)
    families = {each.name: each.samples for each in parser.text_string_to_metric_families(metrics_text([health]))}
    (alarm,) = families["friction_hil_health_alarm"]
    assert alarm.labels == {"axis": 'a"b\\', "quantity": "coulomb.positive", "unit": "N m"}
    assert alarm.value == 1.0
    (change,) = families["friction_hil_health_change"]
    assert change.value == pytest.approx(0.05, abs=0.005)


@pytest.mark.parametrize(
    ("edges", "words"),
    [
        ((-0.4812397, -0.2405879, 6.3816e-05, 0.2407156, 0.4813674), "from -0.241 to 0 rad"),
        ((1000.0, 1000.0021, 1000.0042, 1000.0063, 1000.0084), "from 1000.0021 to 1000.0042 rad"),
        ((-1.2e-3, -0.6e-3, -1e-7, 0.6e-3, 1.2e-3), "from -0.0006 to 0 rad"),
    ],
)
def test_a_part_of_the_travel_is_named_as_exactly_as_the_travel_is_long(edges, words):
    assert label("zone.1.positive", Layout("rotary", edges, ())) == f"extra friction {words}, positive direction"
