"""The report of a tuning: what it says about the rehearsal and the torque lag."""

import re
from dataclasses import replace
from types import SimpleNamespace

import pytest

from friction_hil.identification.torque_lag import LagEstimate
from friction_hil.reports.tuning_report import write_reports
from friction_hil.tuning.rehearsed import RehearsedFit
from friction_hil.tuning.sequential import ExperimentResult
from friction_hil.tuning.torque_lag import TorqueLag
from tests.unit.tuning.test_tuning_judge import model_with, tuning_of


@pytest.fixture
def tuning(monkeypatch):
    pytest.importorskip("matplotlib", reason="the extra 'report' is not installed")
    monkeypatch.setattr("friction_hil.reports.tuning_report.write_report", lambda *_: None)
    return tuning_of(("lugre", model_with((1.0, 2.0))))


def cells(page):
    """Rows of the table on the rehearsal, as text."""
    [table] = [each for each in re.findall(r"<table>.*?</table>", page, re.S) if "in simulation" in each]
    return [re.findall(r"<t[hd][^>]*>(.*?)</t[hd]>", row) for row in re.findall(r"<tr>(.*?)</tr>", table)]


def test_the_report_shows_what_each_model_did_in_simulation(tuning, tmp_path) -> None:
    [tried] = tuning.axes["spindle"].candidates
    other = SimpleNamespace(label="stribeck <1>")
    tuning.rehearsed["spindle"] = (
        RehearsedFit(tried.identification, tried.fit, {"own": (8.0, 8.0), "slow": (2.0, 2.0)}, ()),
        RehearsedFit(tried.identification, other, {"own": (4.0, 4.0), "slow": (0.5, 0.5)}, ("slow",)),
    )

    header, first, second = cells(write_reports(tmp_path, tuning).read_text())

    assert header == ["in simulation", "times lower", "own", "slow", ""]
    assert first == ["lugre", "4.0", "8.0", "<strong>2.0</strong>", "tried on the machine"]
    assert second == [
        "stribeck &lt;1&gt;",
        "1.4",
        "4.0",
        "<strong>0.50</strong>",
        "oscillates, or follows worse: slow",
    ]


def test_the_report_says_that_there_was_no_rehearsal(tuning, tmp_path) -> None:
    page = write_reports(tmp_path, tuning).read_text()

    assert "The models were not rehearsed in simulation." in page
    assert "in simulation</th>" not in page


def test_the_report_has_the_torque_lag_with_its_error(tuning, tmp_path) -> None:
    estimate = LagEstimate(3e-4, 1e-5, 3.2e-4, 3e-3, 1.0)
    lag = TorqueLag(3e-4, 0.0, estimate, is_determined=True, reason="")
    tuning.torque_lags["spindle"] = lag
    page = write_reports(tmp_path, tuning).read_text()
    assert "<p>Torque lag 0.3 ms (standard error 0.01 ms), identified from the trial" in page

    tuning.torque_lags["spindle"] = replace(lag, value_s=0.0, is_determined=False, reason="the axis <stood>")
    page = write_reports(tmp_path, tuning).read_text()
    assert "<p>Torque lag not determined: the axis &lt;stood&gt;; 0 ms of the former model is kept.</p>" in page


def test_the_report_says_how_long_the_experiment_took_and_why(tuning, tmp_path) -> None:
    tuning.experiments["spindle"] = ExperimentResult((15.0, 15.0), 30.0, None, "the axis <stood>")
    page = write_reports(tmp_path, tuning).read_text()
    assert "<p>The experiment took 30 s in 2 parts: the configured duration is over; what is unknown" in page
    assert "is not estimated: the axis &lt;stood&gt;.</p>" in page


def test_the_report_begins_with_an_overview_and_has_the_parameters_of_the_kept_model(tuning, tmp_path) -> None:
    page = write_reports(tmp_path, tuning).read_text()
    overview, _, details = page.partition("<h2>")
    assert "<h1>Friction identified on the machine</h1>" in overview
    assert [word for word in ("spindle", "lugre", "times lower") if word not in overview] == []
    assert '<th scope="row">coulomb</th><td class="">0.1</td>' in details


def test_the_report_of_a_simulation_says_that_it_was_one(tuning, tmp_path) -> None:
    page = write_reports(tmp_path, tuning, is_simulated=True).read_text()
    assert "<h1>Friction identified in a simulation</h1>" in page
    assert "machine</h1>" not in page
