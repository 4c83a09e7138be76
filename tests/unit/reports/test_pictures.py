"""All pictures have one style, hysteresis loops can be recognised as loops, and no peak of a long signal is lost."""

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from friction_hil import models
from friction_hil.analysis.circularity import analyse
from friction_hil.identification.fits import Curves
from friction_hil.models.files import model_from_argument
from friction_hil.replay.comparison import replay
from friction_hil.reports import figures, model_picture, replay_picture
from friction_hil.reports.circularity_picture import draw_error
from friction_hil.reports.decimation import bucket_size, decimated, decimated_time
from friction_hil.reports.identification_pictures import draw_loops, draw_time, turning_points
from friction_hil.reports.numbers import comparison_rows, digits, readable
from friction_hil.reports.page import picture
from friction_hil.reports.run.picture import draw_run
from friction_hil.reports.run.view import make_view
from tests.unit.identification.test_identification import recorded
from tests.unit.reports.test_circularity import make_circle

pytest.importorskip("matplotlib", reason="the extra 'report' is not installed")


def curves(*amplitudes: float, rows: int = 400) -> Curves:
    """A motion of one sine after the other, with friction that lags behind the reversals."""
    turn = np.linspace(0.0, 2.5 * 2.0 * np.pi, rows)
    position = np.concatenate([amplitude * np.sin(turn) for amplitude in amplitudes])
    velocity = np.gradient(position)
    friction = np.tanh(velocity / (np.abs(velocity).max() + 1e-300) * 50.0)
    time = np.arange(len(position)) * 1e-3
    zero = np.zeros_like(time)
    return Curves(time, position, velocity, zero, friction, friction, zero, friction, np.zeros(len(time), int))


@pytest.fixture
def styles(monkeypatch, tmp_path):
    """Everything that makes up the style of each picture that is drawn, by the name of the picture."""
    kept = {}

    def of(figure):
        shown = [axes for axes in figure.axes if axes.axison]
        legends = [*figure.legends, *(axes.get_legend() for axes in shown if axes.get_legend())]
        return {
            *(("frame", axes.spines[side].get_visible()) for axes in shown for side in ("top", "right")),
            *(("grid", axes.xaxis.get_gridlines()[0].get_alpha()) for axes in shown),
            *(("label", axes.yaxis.label.get_fontsize()) for axes in shown),
            *(("ticks", label.get_fontsize()) for axes in shown for label in axes.get_yticklabels()),
            *(("title", axes.title.get_fontsize()) for axes in shown if axes.get_title()),
            *(
                ("legend", legend.get_frame().get_edgecolor()[3], legend.get_texts()[0].get_fontsize())
                for legend in legends
            ),
        }

    apply = figures.apply_style

    def watch(figure):
        apply(figure)
        kept[len(kept)] = of(figure)

    monkeypatch.setattr(figures, "apply_style", watch)
    monkeypatch.setattr("friction_hil.reports.page.apply_style", watch)
    return kept


@pytest.mark.deep
def test_all_pictures_have_one_style(styles, tmp_path):
    circle = make_circle()
    configuration = analyse(circle).configuration
    recording = recorded("coulomb")
    lugre = models.create("lugre", **models.describe("lugre").example)
    coulomb = model_from_argument("coulomb:coulomb=0.3")
    model_picture.draw(lugre, tmp_path / "model.png", "lugre")
    replay_picture.draw(replay(recording, {"coulomb": coulomb}), tmp_path / "replay.png")
    draw_run(make_view(recording, None), tmp_path / "bench.png")
    draw_run(make_view(circle["x"], configuration), tmp_path / "run.png")
    for figure in (draw_loops(curves(1.0, 0.1), "N m", "rad"), draw_time(curves(1.0), "N m")):
        picture(figure, "identification")
    picture(draw_error(analyse(circle)), "error")
    assert len(styles) == 7
    sizes = {("label", 10.0), ("ticks", 9.0), ("title", 11.0), ("legend", 0.0, 9.0)}
    assert set().union(*styles.values()) == {("frame", False), ("grid", 0.3), *sizes}


@example(-0.0, 3)
@given(st.floats(-1e6, 1e6), st.integers(1, 6))
def test_digits_have_no_sign_of_zero_and_no_exponent(value, significant):
    text = digits(value, significant)
    assert float(text) != 0.0 or not text.startswith("-")
    assert "e" not in text
    assert float(text) == pytest.approx(value, rel=0.51 * 10.0 ** (1 - significant))


def test_units_ignore_what_is_zero_or_unknown():
    assert readable("rad", [0.0, 2e-4, np.nan]) == (1e6, "µrad")
    assert readable("rad", [0.0]) == (1.0, "rad")
    assert readable("rad or m", [0.02]) == (1e3, "mrad or mm")
    assert list(comparison_rows("rad", None, None)) == []


@given(st.lists(st.floats(-100.0, 100.0), min_size=2, max_size=200), st.floats(0.1, 50.0))
def test_between_turning_points_the_position_moves_by_at_least_the_threshold(values, least):
    position = np.array(values)
    turns = turning_points(position, least)
    assert turns == sorted(set(turns))
    strokes = np.diff(position[turns])
    assert np.all(np.abs(strokes) >= least)
    assert np.all(strokes[1:] * strokes[:-1] < 0.0)


def test_turning_points_of_a_sine_are_its_extremes():
    position = np.sin(np.linspace(0.0, 6.0 * np.pi, 601))
    assert turning_points(position, 0.5) == [50, 150, 250, 350, 450, 550]


def test_each_loop_has_rows_enough_a_scale_of_its_own_and_its_travel_in_words():
    figure = draw_loops(curves(1.0, 0.1, 0.01, 1e-4), "N m", "rad")
    panels = [axes for axes in figure.axes if axes.axison]
    travels = ("200 µrad", "20.0 mrad", "200 mrad", "2.00 rad")
    assert [axes.get_title() for axes in panels] == [f"travel {each}" for each in travels]
    for axes in panels:
        (measured, _) = axes.lines
        position = measured.get_xdata()
        assert len(position) >= 100
        assert position.max() == pytest.approx(-position.min())
        low, high = axes.get_xlim()
        assert np.ptp(position) > 0.8 * (high - low)
        assert len([each for each in axes.get_xticks() if low <= each <= high]) <= 6
    still = draw_loops(curves(0.0), "N m", "rad")
    assert [text.get_text() for text in still.texts] == ["no motion back and forth"]


VALUES = arrays(np.float64, st.integers(1, 300), elements=st.floats(-1e9, 1e9) | st.just(np.nan))


@given(VALUES, st.integers(2, 50))
def test_each_bucket_keeps_its_extremes_in_their_order(values, size):
    kept = decimated(values, size)
    assert len(kept) == 2 * -(-len(values) // size) == len(decimated_time(np.arange(len(values), dtype=float), size))
    for k, pair in enumerate(kept.reshape(-1, 2)):
        bucket = values[k * size : (k + 1) * size]
        known = bucket[~np.isnan(bucket)]
        if not known.size:
            assert np.isnan(pair).all()
            continue
        assert sorted(pair) == [known.min(), known.max()]
        first, second = (int(np.flatnonzero(bucket == each)[0]) for each in (known.min(), known.max()))
        assert pair[0] == (known.min() if first <= second else known.max())


@given(st.integers(1, 10**7), st.integers(2, 10**5))
def test_no_more_points_than_asked_for_are_left(rows, most):
    size = bucket_size(rows, most)
    assert size == 1 if rows <= most else 2 * -(-rows // size) <= most + 2


@given(st.integers(2, 500), st.integers(2, 40))
def test_times_do_not_decrease_and_stay_within_their_bucket(rows, size):
    time = np.cumsum(np.linspace(0.5, 2.0, rows))
    kept = decimated_time(time, size)
    assert np.all(np.diff(kept) >= 0.0)
    assert kept[0] == time[0]
    starts = np.repeat(time[::size], 2)
    assert np.all(kept >= starts)
