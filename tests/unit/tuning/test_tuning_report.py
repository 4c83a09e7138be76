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

ESTIMATE = LagEstimate(3e-4, 1e-5, 3.2e-4, 3e-3, 1.0)
LAG = TorqueLag(3e-4, 0.0, ESTIMATE, is_determined=True, reason="")


def written(folder, change, **options):
    """The page on a tuning that was changed before; without the report of the trial itself."""
    pytest.importorskip("matplotlib", reason="the extra 'report' is not installed")
    tuning = tuning_of(("lugre", model_with((1.0, 2.0))))
    change(tuning)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("friction_hil.reports.tuning_report.write_report", lambda *_: None)
        return write_reports(folder, tuning, **options).read_text()


def cells(page):
    """Rows of the table on the rehearsal, as text."""
    [table] = [each for each in re.findall(r"<table>.*?</table>", page, re.S) if "in simulation" in each]
    return [re.findall(r"<t[hd][^>]*>(.*?)</t[hd]>", row) for row in re.findall(r"<tr>(.*?)</tr>", table)]


def test_the_report_has_the_kept_model_its_rehearsal_its_lag_and_its_experiment(tmp_path):
    """The page on a tuning in which everything was done."""

    def change(tuning):
        [tried] = tuning.axes["spindle"].candidates
        other = SimpleNamespace(label="stribeck <1>")
        tuning.rehearsed["spindle"] = (
            RehearsedFit(tried.identification, tried.fit, {"own": (8.0, 8.0), "slow": (2.0, 2.0)}, ()),
            RehearsedFit(tried.identification, other, {"own": (4.0, 4.0), "slow": (0.5, 0.5)}, ("slow",)),
        )
        tuning.torque_lags["spindle"] = LAG
        tuning.experiments["spindle"] = ExperimentResult((15.0, 15.0), 30.0, None, "the axis <stood>")

    page = written(tmp_path, change)
    overview, _, details = page.partition("<h2>")
    assert "<h1>Friction identified on the machine</h1>" in overview
    assert [word for word in ("spindle", "lugre", "times lower") if word not in overview] == []
    assert '<th scope="row">coulomb</th><td class="">0.1</td>' in details
    header, first, second = cells(page)
    assert header == ["in simulation", "times lower", "own", "slow", ""]
    assert first[:4] == ["lugre", "4.0", "8.0", "<strong>2.0</strong>"]
    assert second[:4] == ["stribeck &lt;1&gt;", "1.4", "4.0", "<strong>0.50</strong>"]
    assert (first[4], second[4][-6:]) == ("tried on the machine", ": slow")
    assert "<p>Torque lag 0.3 ms (standard error 0.01 ms), identified" in page
    assert "<p>The experiment took 30 s in 2 parts" in page
    assert ": the axis &lt;stood&gt;.</p>" in page


def test_the_report_of_a_simulation_says_that_it_was_one_and_what_was_not_done(tmp_path):
    def change(tuning):
        tuning.torque_lags["spindle"] = replace(LAG, value_s=0.0, is_determined=False, reason="the axis <stood>")

    page = written(tmp_path, change, is_simulated=True)
    assert "<h1>Friction identified in a simulation</h1>" in page
    assert "machine</h1>" not in page
    assert "not rehearsed" in page
    assert "in simulation</th>" not in page
    assert "<p>Torque lag not determined: the axis &lt;stood&gt;; 0 ms" in page
