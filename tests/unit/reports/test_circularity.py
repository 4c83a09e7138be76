"""The circularity test on circles that are known exactly: laps, figures, what is left out, pictures, report."""

import json
import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from matplotlib.patches import StepPatch

from friction_hil.analysis.circularity import RING_SHARE, analyse, duration_s, ring_scale
from friction_hil.analysis.following import RECOVERY_S, SETTLE_S
from friction_hil.config import from_dict, self_contained
from friction_hil.daemon.learning_board import first_report
from friction_hil.daemon.safety import LoopState
from friction_hil.errors import RecordingError
from friction_hil.recordings import Event, Recording
from friction_hil.recordings.recording import CHANGE
from friction_hil.reports.circularity_picture import draw_circle, draw_error, draw_friction, draw_lap_errors
from friction_hil.reports.circularity_report import MARK, write_report
from friction_hil.reports.figures import LEARNED, WITH, WITHOUT
from friction_hil.reports.numbers import digits, readable
from tests.pages import Page
from tests.servo_drives import PERIOD_S, axis_dict

RADIUS, FREQUENCY, BASELINE_S, FADE_S, RAMP_S = 0.5, 2.0, 2.0, 0.1, 0.25
LAP = round(1.0 / (FREQUENCY * PERIOD_S))
START = 40  # cycles before the motion


def make_configuration(*, phases=(0.0, -np.pi / 2), laps=2, **changes):
    axes = {}
    for node, (name, phase) in enumerate(zip("xy", phases, strict=True), start=1):
        circle = {"kind": "circle", "radius": RADIUS, "frequency": FREQUENCY, "phase": phase, "ramp_s": RAMP_S}
        compensation = {"fade_s": FADE_S, "gain": 0.9, "baseline_s": BASELINE_S}
        given = {"trajectory": circle, "simulation": {}, "compensation": compensation, **changes.get(name, {})}
        axes[name] = axis_dict(node=node, **given)
    bus = {"interface": "virtual", "channel": "test"}
    return from_dict({"version": 1, "period_s": PERIOD_S, "bus": bus, "axes": axes}, "test")


def make_circle(
    without=lambda angle: 2e-3 + 0.0 * angle,
    compensated=lambda angle: 5e-4 + 0.0 * angle,
    *,
    centre=(0.3, -0.2),
    phases=(0.0, -np.pi / 2),
    laps=2,
    **changes,
):
    """A run whose radius error over the angle is known in the laps, and wild where no lap may be."""
    configuration = make_configuration(phases=phases, **changes)
    running = round(duration_s(configuration, laps) / PERIOD_S)
    cycle = np.arange(START + running + 30, dtype=float)
    moving_s = (cycle - START) * PERIOD_S
    is_running = (cycle >= START) & (cycle < START + running)
    is_on = is_running & (moving_s >= BASELINE_S - 1e-9)
    turn = 2.0 * np.pi * FREQUENCY * cycle * PERIOD_S
    demand = [RADIUS * np.cos(turn + phase) for phase in phases]
    angle = np.arctan2(demand[1], demand[0])
    error = np.where(is_on, compensated(angle), without(angle))
    error[moving_s < RAMP_S + SETTLE_S - 1e-9] = 0.05
    error[is_on & (moving_s < BASELINE_S + FADE_S + SETTLE_S - 1e-9)] = 0.05
    recordings = {}
    for name, middle, wanted in zip("xy", centre, demand, strict=True):
        columns = {
            "time_s": cycle * PERIOD_S,
            "cycle": cycle,
            "position": middle + wanted * (1.0 + error / RADIUS),
            "position_demand": np.where(is_running, middle + wanted, np.nan),
            "velocity_estimate": np.gradient(wanted, PERIOD_S),
            "compensation": np.where(is_on, 0.08 * np.sign(np.gradient(wanted)), 0.0),
            "is_fresh": np.ones_like(cycle),
            "is_enabled": is_on.astype(float),
            "state": np.where(is_running, float(LoopState.RUNNING), float(LoopState.IDLE)),
        }
        metadata = {"configuration": self_contained(configuration)}
        recordings[name] = Recording("circle.mcap", name, columns, metadata)
    return recordings


def make_learned(learned=lambda angle: 2e-4 + 0.0 * angle, *, gain=0.97, late=0, is_taken_back=False, **changes):
    """A run in which learning hands over two changes, each followed by an error that may not count until it settles.

    The first is in force for three laps, the last until the motion ends. ``late``: cycles by which both come later.
    ``is_taken_back``: when the motion has ended, the first one comes back.
    """
    recordings = make_circle(laps=12, **changes)
    running = np.flatnonzero(recordings["x"]["state"] == LoopState.RUNNING)
    settling = round((FADE_S + SETTLE_S) / PERIOD_S)
    first = running[0] + round((BASELINE_S + FADE_S + SETTLE_S) / PERIOD_S) + 2 * LAP + late
    second = first + settling + 3 * LAP
    cycle = np.arange(len(recordings["x"]))
    change = np.where(cycle < first, 0.0, np.where(cycle < second, 1.0, 2.0))
    third = running[-1] + 5
    if is_taken_back:
        change[third:] = 3.0
    demand = [each["position_demand"] - middle for each, middle in zip(recordings.values(), (0.3, -0.2), strict=True)]
    error = learned(np.arctan2(demand[1], demand[0]))
    error[first : first + settling] = error[second : second + settling] = 0.05
    for each, middle, wanted in zip(recordings.values(), (0.3, -0.2), demand, strict=True):
        each.columns["change"] = change
        is_learned = (change > 0.0) & np.isfinite(wanted)
        each.columns["position"][is_learned] = (middle + wanted * (1.0 + error / RADIUS))[is_learned]
        given = each.metadata["configuration"]["axes"]["x"]["compensation"]
        for number, start, now in ((1, first, 0.93), (2, second, gain), (3, third, 0.93))[: 3 if is_taken_back else 2]:
            entry = {"compensation": {**given, "gain": now}, "is_adopted": True, "model_of": 0}
            text = json.dumps({"number": number, "text": "", "axes": {"x": entry, "y": entry}})
            each.events.append(Event(float(start), CHANGE, text))
    return recordings


def drop(recordings, rows):
    """Miss some periods."""
    for recording in recordings.values():
        recording.columns = {name: np.delete(values, rows) for name, values in recording.columns.items()}


def test_figures_are_those_of_a_constant_radius_error():
    result = analyse(make_circle())
    assert result.unit == "rad"
    for laps, size in ((result.uncompensated, 2e-3), (result.compensated, 5e-4)):
        assert (laps.count, laps.rows, laps.left_out) == (2, 2 * LAP, 0)
        np.testing.assert_allclose(laps.radius_error, size, rtol=1e-6)
        assert laps.circular_range == pytest.approx(0.0, abs=1e-9)
        for figures in laps.figures.values():  # the error of one axis is size cos(angle)
            assert figures.rms == pytest.approx(size / np.sqrt(2.0))
            assert figures.peak == pytest.approx(size)
    assert result.factor("x", "rms") == pytest.approx(4.0)
    assert result.not_helped == []
    assert analyse(make_circle(laps=1)).compensated.count == 1


@settings(deadline=None, max_examples=30)
@given(
    st.tuples(st.floats(-100.0, 100.0), st.floats(-100.0, 100.0)),
    st.floats(-3.0, 3.0),
    st.sampled_from([-0.5 * np.pi, 0.5 * np.pi]),
    st.integers(1, 6),
)
def test_radius_error_is_found_wherever_and_however_the_circle_is_drawn(centre, phase, quarter, order):
    def error(angle):
        return 1e-3 * np.cos(order * angle)

    result = analyse(make_circle(error, centre=centre, phases=(phase, phase + quarter), laps=1))
    laps = result.uncompensated
    np.testing.assert_allclose(laps.radius_error, error(laps.angle), atol=1e-9)
    assert laps.angle.size == LAP
    assert laps.circular_range == pytest.approx(2e-3, rel=1e-3)


def test_a_missed_period_leaves_out_what_it_disturbs():
    recordings = make_circle()
    at = START + round(1.2 / PERIOD_S)  # in the laps without compensation
    left_out = round(RECOVERY_S / PERIOD_S) + 5  # of one missed period
    disturbed = slice(at, at + left_out)
    recordings["x"].columns["position"][disturbed] += 0.3
    drop(recordings, [at - 1])
    result = analyse(recordings)
    assert result.uncompensated.left_out == 1 + left_out
    assert result.compensated.left_out == 0
    assert result.uncompensated.figures["x"].peak == pytest.approx(2e-3, rel=1e-2)
    x, _ = curve(draw_circle(result), WITHOUT)
    assert np.count_nonzero(np.isnan(x)) == 1, "nothing is drawn across what is left out"


def test_late_feedback_of_one_axis_counts_for_neither():
    recordings = make_circle()
    at = START + round(3.0 / PERIOD_S)
    recordings["y"].columns["is_fresh"][at] = 0.0
    recordings["y"].columns["position"][at : at + 3] += 0.3  # one old value, then answers to former cycles
    result = analyse(recordings)
    assert result.compensated.left_out == 5
    assert result.compensated.figures["y"].peak == pytest.approx(5e-4, rel=1e-2)
    assert np.isnan(result.columns["y"]["error"][at])


@pytest.mark.parametrize(
    ("compensated", "named"),
    [
        (lambda angle: 2.1e-3 * (np.abs(np.cos(angle)) > 0.95), ["x peak"]),
        (lambda angle: 2.001e-3 + 0.0 * angle, ["x rms", "x peak", "y rms", "y peak"]),
    ],
    ids=["worse", "equal"],
)
def test_what_became_no_better_is_named(compensated, named):
    assert analyse(make_circle(compensated=compensated)).not_helped == named


def test_laps_after_learning_are_the_last_ones_with_the_same_settings():
    result = analyse(make_learned())
    assert [laps.count for laps in result.laps] == [2, 2, 2]
    for laps, size in zip(result.laps, (2e-3, 5e-4, 2e-4), strict=True):
        np.testing.assert_allclose(laps.radius_error, size, rtol=1e-6)
    ends = [laps.interval_s[1] / PERIOD_S for laps in result.laps]
    assert ends[1] == np.flatnonzero(result.columns["x"]["change"])[0]  # those as given end where the settings change
    assert ends[2] == np.flatnonzero(result.columns["x"]["state"] == LoopState.RUNNING)[-1] + 1
    assert result.factor("y", "peak", result.learned) == pytest.approx(10.0)
    assert result.learned_axes["x"].compensation.gain == 0.97
    assert result.not_helped == result.learning_not_helped == result.learning_harmed == []


@pytest.mark.parametrize("given", [{"late": 4 * LAP}, {"gain": 0.9}], ids=["leaves no two laps", "was taken back"])
def test_settings_that_last_for_less_than_the_laps_are_not_those_after_learning(given):
    result = analyse(make_learned(**given))
    assert (result.learned, result.learned_axes, result.learning_not_helped) == (None, {}, [])


def test_what_is_taken_back_at_the_end_was_on_trial():
    recordings = make_learned(is_taken_back=True)
    result = analyse(recordings)
    assert result.learned.interval_s[1] / PERIOD_S == np.flatnonzero(result.columns["x"]["change"] == 2.0)[0]
    assert result.learned_axes["y"].compensation.gain == 0.93


def test_what_was_learned_is_compared_with_both():
    worse = analyse(make_learned(lambda angle: 6e-4 + 0.0 * angle))
    assert worse.learning_not_helped == ["x rms", "x peak", "y rms", "y peak"]
    assert worse.learning_harmed == []
    assert len(analyse(make_learned(lambda angle: 3e-3 + 0.0 * angle)).learning_harmed) == 4


@pytest.mark.parametrize(
    ("spoil", "message"),
    [
        (lambda r: r.pop("y"), "here are 1"),
        (lambda r: r["x"].metadata.clear(), "no configuration"),
        (lambda r: r["x"].columns.pop("is_enabled"), "column is_enabled"),
        (lambda r: drop(r, slice(2500, None)), "1.25 s without compensation, 0 s with"),
        (lambda r: r["x"].columns.update(state=0.0 * r["x"]["state"]), "only 0 s without"),
        (lambda r: r["x"]["is_fresh"].__setitem__(slice(None, None, 5), 0.0), "0 of 1000 periods"),
    ],
)
def test_what_is_no_such_run_is_refused(spoil, message):
    recordings = make_circle()
    spoil(recordings)
    with pytest.raises(RecordingError, match=message):
        analyse(recordings)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"phases": (0.0, 0.0)}, "a quarter of a turn apart"),
        ({"x": {"trajectory": {"kind": "hold"}}}, "no circle: x: hold, y: circle"),
        ({"x": {"trajectory": {"kind": "circle", "radius": 0.4, "frequency": 2.0}}}, "one radius"),
    ],
)
def test_what_is_no_circle_is_refused(changes, message):
    with pytest.raises(RecordingError, match=message):
        analyse(make_circle(**changes))


@given(st.floats(1e-12, 1e6))
def test_three_rings_reach_the_largest_error(largest):
    scale = ring_scale(2.0, -0.5 * largest, largest)
    ring = scale.ring
    assert scale.outer in (2, 3)
    assert scale.magnification * ring == pytest.approx(2.0 * RING_SHARE)
    assert largest <= 3.0 * ring * (1.0 + 1e-6)
    assert 3.0 * ring <= largest * 2.5 * (1.0 + 1e-6)
    assert float(f"{ring:.0e}") == pytest.approx(ring)
    assert f"{ring:.0e}"[0] in "125"


def test_numbers_for_people():
    texts = [digits(value) for value in (2416.4, 42.48, 6.194, 0.0123, 0.0)]
    assert texts == ["2416", "42.5", "6.19", "0.0123", "0"]
    assert digits(13.4, 1) == "13"
    assert readable("rad", [3.6e-5, 2.4e-3]) == (1e6, "µrad")
    assert readable("m", [0.02, 3.0]) == (1e3, "mm")
    assert readable("m", [1e-9]) == (1e9, "nm")


def curve(figure, color):
    (axes,) = figure.axes
    (line,) = [each for each in axes.lines if each.get_color() == color]
    return line.get_xdata(), line.get_ydata()


def test_the_circle_is_magnified_as_it_says():
    result = analyse(make_circle(lambda angle: 2.9e-3 * np.cos(angle)))
    figure = draw_circle(result)
    texts = [text.get_text() for text in (*figure.texts, *figure.axes[0].texts)]
    assert any("magnified 100 times" in text for text in texts)
    assert any("from ring to ring 1 mrad" in text for text in texts)
    for laps, color in ((result.uncompensated, WITHOUT), (result.compensated, WITH)):
        x, y = curve(figure, color)
        np.testing.assert_allclose(np.hypot(x, y), 1.0 + 100.0 * laps.radius_error / RADIUS)
        np.testing.assert_allclose(np.arctan2(y, x), laps.angle, atol=1e-9)
    assert {"+3 mrad", "−3 mrad", "x reverses", "y reverses"} <= set(texts)


def test_after_learning_the_compensated_laps_are_drawn_once_more_and_larger():
    result = analyse(make_learned())
    figure = draw_circle(result)
    left, right = figure.axes
    assert [line.get_color() for line in left.lines if line.get_color() in (WITHOUT, WITH, LEARNED)] == [WITHOUT, WITH]
    (line,) = [each for each in right.lines if each.get_color() == LEARNED]
    (text,) = [each.get_text() for each in figure.texts if each.get_text().startswith("With compensation")]
    magnification = float(text.split()[-2])
    drawn = np.hypot(line.get_xdata(), line.get_ydata())
    np.testing.assert_allclose(drawn, 1.0 + magnification * result.learned.radius_error / RADIUS)
    assert {"10", "4.0"} <= {each.get_text() for each in right.texts}  # times lower


def test_each_lap_has_its_error_over_time():
    figure = draw_lap_errors(analyse(make_learned()))
    (axes,) = figure.axes
    x, _ = [each for each in axes.patches if isinstance(each, StepPatch)]
    values, edges, _ = x.get_data()
    assert np.diff(edges) == pytest.approx(LAP * PERIOD_S)
    assert values[2] == pytest.approx(2e3 / np.sqrt(2.0), rel=1e-3)  # µrad
    assert values[-2] == pytest.approx(2e2 / np.sqrt(2.0), rel=1e-3)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("make", [make_circle, make_learned])
@pytest.mark.parametrize("draw", [draw_circle, draw_error, draw_friction, draw_lap_errors])
def test_pictures_are_drawn_without_complaint(draw, make, tmp_path):
    draw(analyse(make())).savefig(tmp_path / "picture.png")
    assert (tmp_path / "picture.png").read_bytes().startswith(b"\x89PNG")


def said_in_report(path, result, report=None, said="", **figures):
    """The text of the report of a run, and what it loads."""
    loop = {"cycles": 1, "late_p50_us": 2.0, "late_p99_us": 31.0, "missed": 7, **figures}
    loop |= {"learning": {"axes": {"x": report}}} if report else {}
    write_report(path, result, draw_circle(result), loop, said, "real")
    text = path.read_text()
    assert MARK in text[:1000]
    page = Page(text)
    return re.sub(r"\s+", " ", " ".join(page.text)), page.sources


def test_the_report_has_everything_inside(tmp_path):
    wrong = {"model": {**axis_dict()["model"], "mechanics": {"inertia": 1.7e-4, "torque_lag_s": 3.45e-4}}}
    result, warning = analyse(make_circle(x=wrong)), "x: <no> SCHED_FIFO"
    said, sources = said_in_report(tmp_path / "report.html", result, said=warning, cycles=4711, missed=3)
    assert len(sources) == 3
    assert all(source.startswith("data:image/svg+xml;base64,") for source in sources)
    wanted = ("4711 cycles of 1 ms", "31 µs at the 99th percentile; 3 missed", "4.0 times smaller on x", warning)
    rows = ("inertia kg m² 0.0002 0.00017 −15 %", "torque_lag_s s 0.0003 0.000345 +15 %", "N m/rad 2000 2000")
    assert [each for each in wanted + rows if each not in said] == []


LEARNED_REPORT = first_report("on", "rad", 0.97) | {"re_identified": 2, "error_before": 5e-4, "error_after": 2e-4}
LEARNED_REPORT["doing"] = "watching"


def test_the_report_has_what_was_learned(tmp_path):
    said, _ = said_in_report(tmp_path / "report.html", analyse(make_learned()), LEARNED_REPORT)
    assert "4.0 times smaller on x and 4.0 times smaller on y, after learning 10 times smaller on x" in said
    assert "following error of x, peak µrad 2000 500 4.0 200 10 " in said
    assert "x: re-identified 2 times, error 500 µrad -> 200 µrad" in said
    assert [each for each in ("gain 0.9.", "gain 0.97.") if each not in said] == []
    assert "The computer was late" not in said
    nothing = LEARNED_REPORT | {"re_identified": 0}
    said, _ = said_in_report(tmp_path / "report.html", analyse(make_circle()), nothing)
    assert "no laps with what was learned: " in said
    assert "The computer was late" in said
