"""The tutorials as a reader follows them: every command of their shell blocks, in order, in one folder."""

import re
import shlex
import shutil
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from tests.processes import run

pytestmark = pytest.mark.deep

ROOT = Path(__file__).parents[2]
LEFT_OUT = re.compile(r"\bmachine\.yaml\b|\btune\b")  # needs a drive on can0; has tests of its own, and takes minutes
LONGEST_S = 10


def blocks(page, language):
    text = (ROOT / "tools" / "site" / page).read_text(encoding="utf-8")
    return re.findall(rf"^```{language}\n(.*?)^```", text, re.MULTILINE | re.DOTALL)


def follow(page):
    commands = [line for block in blocks(page, "sh") for line in block.splitlines() if not LEFT_OUT.search(line)]
    assert commands
    for command in commands:
        program, *words = shlex.split(shorter(command))
        assert program == "friction-hil"
        output = None
        if ">" in words:
            output = Path(words.pop())
            words.pop()
        done = run(*words, check=False)
        assert done.returncode == 0, f"{command}: {done.stdout}{done.stderr}"
        if output is not None:
            output.write_text(done.stdout)


def shorter(command):
    """The same command, of a run that ends when it has been compensated for some seconds."""
    return re.sub(r"(?<=--duration )\d+", lambda found: str(min(int(found[0]), LONGEST_S)), command)


def test_the_first_axis_gives_the_log_of_the_second_and_the_configuration_of_the_third(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    follow("first_axis.md")
    assert {"trial.png", "trial.yaml"} <= {each.name for each in tmp_path.iterdir()}
    follow("csv_to_model.md")
    assert {"axis.yaml", "axis.html", "compared.png"} <= {each.name for each in tmp_path.iterdir()}
    follow("in_ci.md")
    for program in blocks("in_ci.md", "python"):
        subprocess.run([sys.executable, "-c", program], cwd=tmp_path, check=True, timeout=60)


def test_the_log_of_an_arm_gives_a_model_of_each_joint(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    log, use = blocks("arm_log.md", "python")
    subprocess.run([sys.executable, "-c", log], check=True, timeout=60)
    follow("arm_log.md")
    subprocess.run([sys.executable, "-c", use], check=True, timeout=60)
    for joint, coulomb, factor in (("q1", 3.0, 0.1), ("q2", 1.5, 0.12)):
        friction = yaml.safe_load((tmp_path / f"friction_{joint}.yaml").read_text())["friction"]
        assert friction["modifiers"]["load"]["motoring"] == pytest.approx(factor, rel=0.15)
        if friction["model"] == "coulomb":
            assert friction["parameters"]["coulomb"] == pytest.approx(coulomb, rel=0.05)


def test_the_sidecar_runs_beside_its_plc(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    shutil.copytree(ROOT / "config", tmp_path / "config")
    follow("beside_a_plc.md")
