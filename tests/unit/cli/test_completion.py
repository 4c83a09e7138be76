"""The Tab key: commands, options, models and axes, in the form in which the shells ask for them."""

import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from friction_hil import models
from friction_hil.cli import COMMANDS, main
from friction_hil.cli.completion import MODELS
from friction_hil.recordings import Recording, write
from tests.readme_commands import ROOT

PAGE = (ROOT / "friction_hil/cli/README.md").read_text()


@pytest.fixture
def complete(monkeypatch, capsys):
    """What fish gets for a line whose last word is incomplete: (kind, text, description) of each item."""

    def asked(*words):
        monkeypatch.setenv("_FRICTION_HIL_COMPLETE", "fish_complete")
        monkeypatch.setenv("COMP_WORDS", " ".join(["friction-hil", *words]))
        monkeypatch.setenv("COMP_CWORD", words[-1])
        with pytest.raises(SystemExit) as ended:
            main([])
        assert ended.value.code == 0
        out, err = capsys.readouterr()
        assert err == ""
        return [re.fullmatch(r"(\w+),([^\t]*)\t?(.*)", line).groups() for line in out.split("\n") if line]

    return asked


def texts(items):
    return [text for _, text, _ in items]


def test_commands_have_their_descriptions(complete):
    items = complete("")
    assert texts(items) == list(COMMANDS)
    assert [description for _, _, description in items] == list(COMMANDS.values())
    assert texts(complete("re")) == ["replay", "reset"]
    assert texts(complete("config", "ch")) == ["check"]


@pytest.mark.parametrize(
    "words", [("models", "lu"), ("replay", "a.csv", "--model", "lu"), ("train", "--from-model", "lu")]
)
def test_name_of_a_model_or_a_file_where_no_model_begins_so(complete, words):
    assert list(MODELS) == models.names()
    assert all(text and "," not in text for text in MODELS.values())
    assert complete(*words) == [("plain", "lugre", MODELS["lugre"])]
    assert complete("replay", "a.csv", "--model", "out/ax") == [("file", "out/ax", "")]


@pytest.mark.parametrize("command", ["identify", "tune", "study"])
def test_list_of_models(complete, command):
    assert texts(complete(command, "--models", "coulomb,s")) == ["coulomb,stribeck"]
    assert "lugre,coulomb" in texts(complete(command, "--models", "lugre,"))
    assert "lugre,lugre" not in texts(complete(command, "--models", "lugre,"))


def test_axes_of_the_file_on_the_line(complete, tmp_path):
    path = tmp_path / "machine.yaml"
    path.write_text("version: 1\naxes:\n  left: {}\n  lift: {}\n  right: {}\n")
    assert texts(complete("tune", str(path), "--axis", "l")) == ["left", "lift"]
    assert texts(complete("tune", str(path), "--axis", "left", "--axis", "r")) == ["right"]
    path = tmp_path / "run.mcap"
    write(path, Recording("", "left", {"time_s": np.array([0.0, 1.0]), "torque": np.zeros(2)}))
    assert texts(complete("replay", str(path), "--axis", "")) == ["left"]
    assert texts(complete("convert", str(path), "x.csv", "--axis", "l")) == ["left"]


@pytest.mark.parametrize("content", ["axes: [", "[]", "axes: 5", "\0\0", "a: " + "9" * 10])
@pytest.mark.parametrize("name", ["machine.yaml", "run.mcap", "run.csv"])
def test_a_file_that_is_wrong_completes_nothing_and_says_nothing(complete, tmp_path, name, content):
    path = tmp_path / name
    path.write_text(content)
    command = "tune" if name.endswith("yaml") else "replay"
    assert complete(command, str(path), "--axis", "") == []
    assert complete(command, "there_is_none.yaml", "--axis", "") == []


def test_completion_of_models_imports_nothing_heavy():
    code = (
        "import sys, atexit; from friction_hil.cli import main; "
        "atexit.register(lambda: print('loaded:', *sorted(name for name in sys.modules if '.' not in name))); main([])"
    )
    environment = {"_FRICTION_HIL_COMPLETE": "bash_complete", "COMP_WORDS": "friction-hil models l", "COMP_CWORD": "2"}
    done = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)
    completed, _, loaded = done.stdout.partition("loaded:")
    assert completed == "plain,lugre\n"
    assert not {"numpy", "numba", "scipy", "yaml", "rich", "pydantic", "mcap"} & set(loaded.split())


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_the_line_of_the_page_defines_the_completion(shell, tmp_path):
    if shutil.which(shell) is None:
        pytest.skip(f"there is no {shell} here")
    (line,) = re.findall(rf"`([^`]*_FRICTION_HIL_COMPLETE={shell}_source[^`]*)`", PAGE)
    shown = {"bash": "complete -p friction-hil", "fish": "complete -c friction-hil"}
    before = "autoload -Uz compinit && compinit -u -D\n" if shell == "zsh" else ""
    path = f"{Path(sys.executable).parent}:/usr/bin:/bin"
    environment = {"PATH": path, "HOME": str(tmp_path), "ZDOTDIR": str(tmp_path)}
    script = before + line.replace("\\|", "|") + "\n" + shown.get(shell, "whence -w _friction_hil_completion")
    words = [shell, "-c", script]
    done = subprocess.run(words, env=environment, capture_output=True, text=True, check=True, timeout=60)
    assert done.stderr == ""
    assert "friction_hil_completion" in done.stdout
