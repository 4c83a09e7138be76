"""The study: each experiment agrees with physics and gives the same numbers each time."""

import dataclasses
import math
import subprocess
import sys

import numpy as np
import pytest

from friction_hil import models, study
from friction_hil.cli import main
from friction_hil.errors import UsageError
from friction_hil.reports.study import report as study_report
from friction_hil.reports.study.panels import groups
from friction_hil.reports.study.text import SECTIONS, look, number, summary_columns
from friction_hil.study import closed_loop, mass
from friction_hil.study.circle import reversal
from friction_hil.study.given_force import break_away_force, presliding
from friction_hil.study.given_motion import frictional_lag, static_curve, stress_strain, velocity_pulse
from friction_hil.study.run import PAIRED, SINGLE
from friction_hil.study.subjects import REFERENCE, StudySettings, break_away, matched, servo_levels
from tests.pages import Page

ALL = models.names()
STATIC = ("coulomb", "karnopp", "power_law", "stribeck", "table")
HUMPED = ("elasto_plastic", "gms", "karnopp", "lugre", "stribeck", "table")  # one hump for all
LEVEL = ("bouc_wen", "coulomb", "dahl")  # no hump
CHOSEN = ("coulomb", "dahl", "gms", "lugre")


@pytest.fixture(scope="module")
def result():
    return study.run(CHOSEN)


def test_every_model_has_a_recipe_and_the_examples_keep_their_levels():
    for name in ALL:
        assert matched(name, REFERENCE).name == name
        assert look(name)
    for name in ("dahl", "elasto_plastic", "karnopp", "lugre", "stribeck"):
        example = dict(models.describe(name).example)
        assert matched(name, servo_levels(3.0)).parameters == pytest.approx(example)


@pytest.mark.parametrize("name", ALL)
def test_static_curves_meet_the_levels_and_the_stiffness_is_the_same_for_all(name):
    velocity, force = static_curve(name).lines["force"]
    if name in HUMPED:
        expected = 1.0 + 0.5 * np.exp(-((velocity / 1e-3) ** 2)) + 0.4 * velocity
        np.testing.assert_allclose(force, expected, atol=0.01)
    elif name in LEVEL:
        np.testing.assert_allclose(force, 1.0 + 0.4 * velocity, rtol=1e-9)
    assert force[-1] == pytest.approx(1.04, abs=0.002)
    if name not in STATIC:
        assert stress_strain(name).facts["stiffness_N_per_um"] == pytest.approx(0.1, rel=0.03)


def test_a_pulse_overshoots_with_a_hump_only_and_a_state_keeps_its_force():
    facts = {name: velocity_pulse(name).facts for name in ALL}
    for name in HUMPED:
        assert facts[name]["pulse_overshoot_N"] > 0.01
    for name in LEVEL:
        assert abs(facts[name]["pulse_overshoot_N"]) < 1e-9
    for name in STATIC:
        assert facts[name]["pulse_at_rest_N"] == 0.0
    assert facts["dahl"]["pulse_at_rest_N"] == pytest.approx(1.0, abs=1e-3)
    assert 1.2 < facts["lugre"]["pulse_at_rest_N"] < 1.5


def test_presliding_is_what_the_stress_strain_curve_says():
    """At 95 % of break-away the exponential approach of Dahl and of slow LuGre is at -ln 0.05 = 3.0 of its length."""
    assert presliding("dahl").facts["presliding_um"] == pytest.approx(10.0 * -math.log(0.05), rel=0.01)
    assert presliding("lugre").facts["presliding_um"] == pytest.approx(15.0 * -math.log(0.05), rel=0.02)
    for name in ALL:
        facts = presliding(name).facts
        if name in STATIC:
            assert facts["presliding_um"] == facts["presliding_loss_uJ"] == facts["drift_um"] == 0.0
        else:
            assert facts["presliding_um"] > 10.0
            assert facts["presliding_loss_uJ"] > 0.0


@pytest.mark.parametrize(
    ("name", "drifts", "remembers"),
    [("lugre", 1, 0), ("dahl", 1, 0), ("bouc_wen", None, 0), ("elasto_plastic", 0, None), ("gms", 0, 1)],
)
def test_only_without_an_elastic_range_they_drift_and_only_gms_remembers_where_it_turned(name, drifts, remembers):
    drift, gap = presliding(name).facts["drift_um"], stress_strain(name).facts["small_loop_gap_mN"]
    if drifts is not None:
        assert drift > 10.0 if drifts else abs(drift) < 1e-6
    if remembers is not None:
        assert abs(gap) < 1e-6 if remembers else gap < -100.0


@pytest.mark.parametrize("name", ALL)
def test_friction_lags_more_the_faster_the_velocity_swings(name):
    widths = [frictional_lag(name).facts[f"lag_width_{rate}_mN"] for rate in (1, 10, 25)]
    if name in STATIC or name in LEVEL:
        assert widths == pytest.approx([0.0, 0.0, 0.0], abs=1e-6)
    else:
        assert 0.1 < widths[0] < widths[1] < widths[2]


@pytest.mark.parametrize("name", ALL)
def test_break_away_falls_with_the_rate_where_there_is_a_hump_and_a_state(name):
    _, levels = break_away_force(name).lines["force"]
    if name in STATIC or name in LEVEL:
        assert np.ptp(levels) < 0.01
        assert levels[0] == pytest.approx(break_away(name, REFERENCE), abs=0.02)
    else:
        assert np.all(np.diff(levels) < 0.005)
        assert 1.3 < levels[0] <= 1.5
        assert 1.0 < levels[-1] < levels[0] - 0.2


@pytest.mark.parametrize("name", ALL)
def test_stick_slip_needs_a_hump_and_compensation_with_one_ends_it(name):
    facts = closed_loop.stick_slip(name, None).facts
    if name in HUMPED:
        assert 40.0 < facts["stuck_percent"] < 70.0
        assert facts["swing_mm_s"] > 200.0  # twice the pull
        assert closed_loop.stick_slip(name, name).facts["stuck_percent"] == 0.0
        assert closed_loop.stick_slip(name, "coulomb").facts["stuck_percent"] > 40.0
    elif name in LEVEL:
        assert facts["stuck_percent"] == 0.0
        assert facts["swing_mm_s"] < 20.0


def test_without_a_hump_hunting_dies_down():
    time, position = closed_loop.hunting("coulomb", None).lines["position"]
    early, late = (np.ptp(position[(time > a) & (time < b)]) for a, b in ((15.0, 40.0), (70.0, 100.0)))
    assert late < 0.5 * early


@pytest.mark.parametrize("name", ["elasto_plastic", "gms", "lugre"])
def test_compensation_shrinks_hunting_where_there_is_presliding(name):
    assert closed_loop.hunting(name, None).facts["swing_mm"] > 80.0
    assert closed_loop.hunting(name, name).facts["swing_mm"] < 20.0


def test_compensation_takes_the_reversal_spikes_away_best_by_the_right_model(result):
    peaks = {pair: outcome.facts["peak_urad"] for pair, outcome in result.paired["reversal"].items()}
    for name in CHOSEN:
        assert 1000.0 < peaks[name, None] < 5000.0
        assert peaks[name, name] < peaks[name, None] / 20.0
        assert all(peaks[name, each] < peaks[name, None] / 2.0 for each in CHOSEN)
    for name in ("gms", "lugre"):
        assert peaks[name, name] == min(peaks[name, each] for each in CHOSEN)


def test_spikes_stand_behind_the_reversals_of_both_axes():
    angle, error = reversal("lugre", None).lines["radius error"]
    top = np.degrees(angle[error > 0.5 * error.max()])
    assert {round(each / 90.0) for each in top} == {0, 1, 2, 3}
    assert np.all((top % 90.0 > 1.0) & (top % 90.0 < 15.0))
    # half a lap later the same happens the other way round
    np.testing.assert_allclose(error[:1000], error[1000:], atol=0.02 * error.max())


def test_the_integration_is_fine_enough(monkeypatch):
    coarse = closed_loop.stick_slip("lugre", None).facts
    monkeypatch.setattr(mass, "_STEPS", 20)
    fine = closed_loop.stick_slip("lugre", None).facts
    assert coarse == pytest.approx(fine, rel=0.02)


def test_the_numbers_depend_neither_on_threads_nor_on_company_and_progress_grows_to_the_whole(result):
    fractions = []
    alone = study.run(["lugre"], lambda text, fraction: fractions.append(fraction), workers=1).facts["lugre"]
    assert alone == {name: value for name, value in result.facts["lugre"].items() if name in alone}
    assert len(alone) > 20
    assert fractions == sorted(fractions)
    assert fractions[-1] == 1.0


def test_facts_are_finite_and_named_with_their_units(result):
    units = ("_N", "_mN", "_um", "_uJ", "_N_per_um", "_percent", "_mm_s", "_mm", "_urad")
    for facts in result.facts.values():
        for name, value in facts.items():
            assert math.isfinite(value), name
            assert name.split("_with_")[0].endswith(units) or name.startswith("reversal_reduction_by_"), name
    lugre = result.facts["lugre"]
    reduction = lugre["reversal_peak_urad"] / lugre["reversal_peak_urad_with_dahl"]
    assert lugre["reversal_reduction_by_dahl"] == pytest.approx(reduction)


def test_the_report_and_the_table_name_only_facts_that_exist(result):
    assert [each.key for each in SECTIONS] == [*SINGLE, *PAIRED]
    facts = result.facts["lugre"]
    for section in SECTIONS:
        assert set(section.facts) <= set(facts)
    for column in summary_columns():
        assert "–" not in column.write(facts, "lugre")


def test_an_unknown_model_is_refused_with_the_choices():
    with pytest.raises(UsageError, match=r"did you mean 'lugre'.*armstrong"):
        study.run(["lugree"])
    with pytest.raises(UsageError, match="no model is named"):
        study.check_names([])
    assert study.check_names(["dahl", "lugre", "dahl"]) == ("dahl", "lugre")


def test_the_study_is_pure():
    code = "import sys, friction_hil.study; print(*sorted(sys.modules))"
    loaded = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout.split()
    assert not {"matplotlib", "rich", "click", "mcap"} & set(loaded)


@pytest.mark.deep
def test_the_report_needs_nothing_else_and_is_the_same_each_time(tmp_path):
    result = study.run(["coulomb", "lugre"])
    study_report.claim(tmp_path)
    text = study_report.write_report(tmp_path, result).read_text(encoding="utf-8")
    page = Page(text)
    images = [given for tag, given in page.tags if tag == "img"]
    assert len(images) == 14
    assert all(each["src"].startswith("data:image/svg+xml;base64,") and each["alt"] for each in images)
    links = {given["href"].removeprefix("#") for tag, given in page.tags if tag == "a"}
    assert links <= {given.get("id") for _, given in page.tags}
    assert "http" not in text.split("<style>")[1].split("</style>")[0]
    for section in SECTIONS:
        assert section.title in text
    study_report.claim(tmp_path)  # its own report may be replaced
    assert study_report.write_report(tmp_path, result).read_text(encoding="utf-8") == text
    assert [path.name for path in tmp_path.iterdir()] == ["report.html"]


def test_somebody_elses_report_stays(tmp_path):
    (tmp_path / "report.html").write_text("mine")
    with pytest.raises(UsageError, match=r"report\.html.*choose another folder"):
        study_report.claim(tmp_path)
    assert (tmp_path / "report.html").read_text() == "mine"


def test_lines_that_coincide_are_drawn_once():
    x = np.arange(3.0)
    found = groups({"a": (x, x), "b": (x, 2.0 * x), "c": (x, x + 1e-3)})
    assert [names for names, _ in found] == [["a", "c"], ["b"]]


NUMBERS = {None: "–", math.inf: "not finite", 0.0: "0", 1e-4: "0", 0.9999999: "1.00", -434.2: "−434", 12.345: "12.3"}


@pytest.mark.parametrize(("value", "text"), NUMBERS.items())
def test_numbers_are_written_with_three_digits(value, text):
    assert number(value) == text


def test_experiments_scale_with_the_levels_that_are_given():
    """Ten times the forces at ten times the stiffness: the same paths, ten times the forces."""
    strong = dataclasses.replace(REFERENCE, coulomb=10.0, static=15.0, viscous=4.0, stiffness=1e6)
    given, small = StudySettings(friction=strong, mass=10.0), StudySettings(radius=0.1, frequency=1.0)
    assert small.servo_levels.top_velocity == pytest.approx(math.tau * 0.1)
    assert reversal("coulomb", None, small).facts["peak_urad"] != reversal("coulomb", None).facts["peak_urad"]
    for experiment in (static_curve, stress_strain, break_away_force):
        for name in ("coulomb", "dahl"):
            plain, scaled = experiment(name).facts, experiment(name, given).facts
            for fact, value in plain.items():
                factor = 1.0 if fact.endswith("_um") and "per" not in fact else 10.0
                assert scaled[fact] == pytest.approx(factor * value, rel=1e-3, abs=1e-3)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--friction", "colomb=1"], "'coulomb'?"),
        (["--servo", "stiffness=0"], "stiffness is 0"),
        (["--motion", "radius=x"], "'radius=x'"),
        (["--motion", "frequency=1e6"], "20 Hz"),
        (["machine.yaml", "--motion", "radius=1"], "without MACHINE"),
        (["machine.yaml", "--models", "lugre"], "--models, --friction, --servo and --motion go without MACHINE"),
    ],
)
def test_mistakes_in_the_settings_are_reported_first(words, message, tmp_path, capsys):
    assert main(["study", "--output", str(tmp_path / "study"), *words]) == 2
    assert message in capsys.readouterr().err
    assert not (tmp_path / "study").exists()
