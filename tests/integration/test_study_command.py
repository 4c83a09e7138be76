"""The command ``study``: its report, its JSON, its errors."""

import json
import math
from pathlib import Path

import pytest

from friction_hil import study
from friction_hil.cli import main


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
