"""The gallery: every format of a model, each linked from the page, with what it loses or why it is not there."""

import json
import re

import pytest

from friction_hil.cli import main
from friction_hil.config.examples import example_models
from friction_hil.errors import UsageError
from friction_hil.export import LOSSY
from friction_hil.models.files import load_model_file
from friction_hil.reports import export_gallery
from friction_hil.reports.export_gallery import write_gallery

pytest.importorskip("matplotlib", reason="the extra 'report' is not installed")


def test_the_page_links_every_export_of_a_model(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(export_gallery.export, "LOSSLESS", {})
    monkeypatch.setattr(export_gallery.export, "FORMATS", dict(LOSSY))  # the others are translated by their own tests
    monkeypatch.chdir(tmp_path)
    words = ["models", str(example_models()["ball_screw"]), "--export-all", "gallery", "--json"]
    assert main(words) == 0
    answer = json.loads(capsys.readouterr().out)
    outcome = answer["models"]["ball_screw"]
    assert set(outcome) == set(LOSSY)
    assert [to for to, why in outcome.items() if why] == ["bam"]  # which knows no linear axis
    page = (tmp_path / answer["page"]).read_text()
    linked = re.findall(r'(?:href|src)="(ball_screw/[^"]+)"', page)
    assert len(linked) == len(LOSSY)  # all but bam, and the picture of the model
    for each in linked:
        assert (tmp_path / "gallery" / each).stat().st_size > 100
    assert page.count("Torque lost:") == len(LOSSY) - 1
    assert "rotary actuators; this axis is linear" in page
    assert "harmonics of up to 0.5 N" in page
    assert main(words) == 0  # a former gallery is replaced


def test_other_files_are_not_overwritten(tmp_path):
    (tmp_path / "index.html").write_text("mine")
    with pytest.raises(UsageError, match=r"index\.html exists"):
        write_gallery(tmp_path, {"x": load_model_file(example_models()["lugre_axis"])})
    assert [path.name for path in tmp_path.iterdir()] == ["index.html"]


def test_a_gallery_has_no_other_picture(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["models", "lugre", "--export-all", "gallery", "--draw", "a.png"]) == 2
    assert "--draw and --export-all" in capsys.readouterr().err


def test_a_file_whose_name_no_language_takes_is_shown_by_its_model(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(export_gallery.export, "FORMATS", {"csv": LOSSY["csv"]})
    path = tmp_path / "轴.yaml"
    path.write_bytes(example_models()["lugre_axis"].read_bytes())
    assert main(["models", str(path), "--export-all", str(tmp_path / "gallery"), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["models"] == {"lugre": {"csv": ""}}
    assert (tmp_path / "gallery" / "lugre" / "csv" / "lugre.csv").exists()
