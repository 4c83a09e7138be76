"""The comment of an export: whatever the model file says about its origin, it stays a comment."""

import json
import re
import shutil
import subprocess
import xml.etree.ElementTree as ET

import pytest
import yaml

import friction_hil as fh
from friction_hil.models.files import load_model_file

BREAKS = "a\nb\r\nc\td\u2028e"
HOSTILE = ['runs/*.csv */ int x; /* (* x *) <!-- --> -- "q" \\ ??/', BREAKS, "ends with -", "ends with \\", "äöü 轴"]
LINE = {"c": " *", "st": "   ", "csv": "#", "ax8000": "#"}


@pytest.fixture
def hostile(tmp_path):
    """A model file with an origin that does harm to those who copy it as it is."""
    fit = {"software": HOSTILE[0], "recordings": [{"path": each} for each in HOSTILE], "flags": HOSTILE}
    fit |= {"standard_errors": {"coulomb": 0.01, "viscous": float("nan")}, "range": {"velocity": [-1.0, 2.0]}}
    friction = {"model": "coulomb", "parameters": {"coulomb": 0.1, "viscous": 0.01}}
    path = tmp_path / "axis.yaml"
    path.write_text(yaml.safe_dump({"version": 1, "axis": "rotary", "friction": friction, "fit": fit}))
    return path


@pytest.mark.parametrize("to", LINE)
def test_no_line_of_it_is_taken_for_something_else(hostile, to):
    text = next(iter(fh.export.files(hostile, to=to).values()))
    lines = text.splitlines()
    found = [line for line in lines if "a b c d e" in line]
    assert len(found) >= 2  # among recordings and flags
    assert all(line.startswith((LINE[to], "Recording: ", "Flag: ")) for line in found)
    assert "+- 0.01" in text
    assert "+- nan" not in text


@pytest.mark.skipif(shutil.which("gcc") is None, reason="gcc is not installed")
def test_the_compilers_read_nothing_of_it(hostile, tmp_path):
    paths = fh.export.write(hostile, "c", tmp_path, name="x")
    flags = ("-std=c99", "-Wall", "-Wextra", "-Werror", "-pedantic", "-fsyntax-only")
    assert subprocess.run(["gcc", *flags, *paths[1:]], capture_output=True, text=True).stderr == ""
    text = fh.export.files(hostile, to="st")["axis.st"]
    begin, *_ = re.split(r"\*\)", text, maxsplit=1)
    assert begin.count("(*") == 1
    assert "TYPE" not in begin


@pytest.mark.parametrize("to", ["urdf", "mjcf", "mjcf_lugre", "bam", "isaaclab"])
def test_the_readers_of_xml_and_json_read_the_rest(hostile, to):
    (text,) = fh.export.files(hostile, to=to).values()
    if text.startswith("{"):
        assert "Recording: a b c d e" in json.loads(text)["comment"]
    else:
        assert "Recording: a b c d e" in text
        assert ET.fromstring(text).tag in ("robot", "mujoco")


@pytest.mark.parametrize(
    ("fit", "said"),
    [
        ({"recordings": "one.mcap"}, "Recording: one.mcap"),
        ({"recordings": 5, "flags": "odd"}, "Flag: odd"),
        ({"standard_errors": [1.0], "train": {"rmse": "small"}}, "friction_hil"),
        ({"train": {"rmse": 0.5, "relative_error": None}}, "Error of the fit: 0.5 RMS"),
    ],
)
def test_what_somebody_wrote_by_hand_stops_no_export(hostile, fit, said):
    file = load_model_file(hostile)
    text = fh.export.files(file.model_copy(update={"fit": fit}), to="urdf")["axis.urdf"]
    assert any(line.strip() == said or said in line for line in text.splitlines())
    assert "Recording: o\n" not in text
