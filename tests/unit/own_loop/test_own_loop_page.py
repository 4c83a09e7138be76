"""The tutorial "In your own loop" as a reader follows it: its configuration, and its program."""

import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from friction_hil import recordings
from friction_hil.cli import main
from friction_hil.config import file_problems, load
from friction_hil.config.examples import examples
from friction_hil.errors import ConfigurationError
from friction_hil.replay.verify import verify
from tools.benchmarks import own_loop

ROOT = Path(__file__).parents[3]
PAGE = (ROOT / "friction_hil/own_loop/README.md").read_text(encoding="utf-8")

WITH_DRIVER = """
  wrist:
    driver: dynamixel
    description: XL330
    id: 1
    line: {port: /dev/ttyUSB0}
    mode: cst
    limits: {torque: 0.1, velocity: 3.0}
    model: {axis: rotary, friction: {model: coulomb, parameters: {coulomb: 0.1}}}
    trajectory: {kind: none}
"""


@pytest.mark.deep  # of the tools, not of the product
def test_the_benchmark_of_the_call_has_every_figure(monkeypatch):
    monkeypatch.setattr(own_loop, "CALLS", 50)
    monkeypatch.setattr(own_loop, "ROUNDS", 1)
    rows = own_loop.run()
    assert len(rows) == 6
    assert all(0.0 < row.value < 1e4 and row.ratio > 0.0 for row in rows)


def blocks(language):
    return re.findall(rf"^```{language}\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL)


def test_the_configuration_of_the_page_is_one(tmp_path, capsys):
    (text,) = blocks("yaml")
    (tmp_path / "arm.yaml").write_text(text)
    for joint in ("shoulder", "elbow"):
        shutil.copy(ROOT / "config/models/lugre_axis.yaml", tmp_path / f"{joint}.yaml")
    assert main(["config", "check", str(tmp_path / "arm.yaml")]) == 0
    assert "friction_hil.Compensator" in capsys.readouterr().out
    assert list(load(tmp_path / "arm.yaml").axes) == ["shoulder", "elbow"]
    for words in (["run", "--duration", "1"], ["run", "--simulate"], ["simulate"], ["tune", "--yes"]):
        assert main([*words, str(tmp_path / "arm.yaml")]) == 2
        assert "loop of your own" in capsys.readouterr().err


def test_an_axis_that_lacks_its_driver_is_told_so(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["config", "new", "--example", "own_loop"]) == 0
    assert main(["config", "new", "arm.yaml", "--driver", "own_loop"]) == 2
    assert "--example own_loop" in capsys.readouterr().err
    path = tmp_path / "own_loop.yaml"
    text = path.read_text()
    path.write_text(text.replace("\naxes:", "\nperiod_s: 0.001\nbus: {interface: socketcan, channel: can0}\naxes:"))
    with pytest.raises(ConfigurationError) as error:
        load(path)
    assert [each.field for each in error.value.problems] == ["axes.shoulder.driver", "axes.elbow.driver"]
    path.write_text(text.replace("\naxes:", "\nperiod_s: 0.001\naxes:") + WITH_DRIVER)
    problem, *_ = file_problems(path, load(path))
    assert (problem.field, "other axes have one" in problem.message) == ("axes.shoulder.driver", True)
    assert main(["run", str(path), "--dry-run", "--duration", "1"]) == 2


def test_the_program_of_the_page_lowers_the_following_error_and_its_recording_verifies(tmp_path):
    shutil.copy(examples()["own_loop"], tmp_path / "own_loop.yaml")
    done = subprocess.run(
        [sys.executable, "-c", blocks("python")[-1]],
        cwd=tmp_path,
        check=True,
        capture_output=True,
        text=True,
        timeout=120,
    )
    without, compensated = (np.array(each.split(), float) for each in re.findall(r"\[([^]]*)\]", done.stdout))
    assert (compensated < 0.5 * without).all()
    found = recordings.read_all(tmp_path / "run.mcap")
    assert all(verify(recording).is_verified for recording in found.values())
    assert np.abs(found["elbow"]["compensation"]).max() > 0.2
