"""The command ``study``: its report, its JSON, its errors."""

import json
import math
import subprocess
import sys
from pathlib import Path

import pytest

from friction_hil import study
from friction_hil.cli import main
from friction_hil.reports.study.report import MARK

COMMAND = [sys.executable, "-m", "friction_hil", "study"]


@pytest.fixture(scope="module")
def outcome(tmp_path_factory):
    folder = tmp_path_factory.mktemp("study") / "deeper" / "folder"
    run = subprocess.run(
        [*COMMAND, "--models", "coulomb,lugre", "--json", "--output", str(folder)],
        capture_output=True,
        text=True,
        timeout=300,
        check=False,
    )
    return folder, run


@pytest.mark.deep
def test_json_is_the_facts_by_model_and_nothing_else(outcome):
    _, run = outcome
    assert run.returncode == 0, run.stderr
    facts = json.loads(run.stdout)
    assert list(facts) == ["coulomb", "lugre"]
    for each in facts.values():
        assert all(isinstance(value, float) and math.isfinite(value) for value in each.values())
    assert 40.0 < facts["lugre"]["presliding_um"] < 50.0
    assert facts["lugre"]["reversal_reduction_by_lugre"] > facts["lugre"]["reversal_reduction_by_coulomb"] > 1.0


@pytest.mark.deep
def test_it_is_silent_where_there_is_no_terminal(outcome):
    assert outcome[1].stderr == ""


@pytest.mark.deep
def test_the_report_is_there_and_nothing_else(outcome):
    folder, _ = outcome
    assert [path.name for path in folder.iterdir()] == ["report.html"]
    text = (folder / "report.html").read_text(encoding="utf-8")
    assert MARK in text[:1000]
    assert text.endswith("</html>\n")


def test_the_table_has_a_row_for_each_model_and_says_where_the_report_is(tmp_path, capsys):
    assert main(["study", "--models", "dahl", "--output", str(tmp_path)]) == 0
    said = capsys.readouterr()
    assert "break-away" in said.out
    assert sum(line.startswith("dahl ") for line in said.out.splitlines()) == 1
    assert f"report: {tmp_path / 'report.html'}" in said.out
    assert max(map(len, said.out.splitlines()[:6])) <= 80
    assert said.err == ""


def test_an_unknown_model_is_wrong_use(tmp_path, capsys):
    folder = tmp_path / "out"
    assert main(["study", "--models", "lugre,gsm", "--output", str(folder)]) == 2
    said = capsys.readouterr()
    assert said.out == ""
    assert "no friction model is called 'gsm'" in said.err
    assert "stribeck" in said.err
    assert not folder.exists()


def test_somebody_elses_report_is_refused_before_anything_is_computed(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(study, "run", lambda *_: pytest.fail("it computed"))
    (tmp_path / "report.html").write_text("mine")
    assert main(["study", "--output", str(tmp_path)]) == 2
    assert "no former study made it" in capsys.readouterr().err
    assert (tmp_path / "report.html").read_text() == "mine"


def test_a_number_that_is_not_finite_is_a_failure(tmp_path, capsys, monkeypatch):
    real = study.run

    def run(*arguments, **options):
        result = real(*arguments, **options)
        result.single["presliding"]["coulomb"].facts["presliding_um"] = math.nan
        return result

    monkeypatch.setattr(study, "run", run)
    assert main(["study", "--models", "coulomb", "--json", "--output", str(tmp_path)]) == 1
    said = capsys.readouterr()
    assert json.loads(said.out)["coulomb"]["presliding_um"] is None
    assert said.err == "not finite: coulomb: presliding_um\n"
    assert Path(tmp_path / "report.html").exists()
