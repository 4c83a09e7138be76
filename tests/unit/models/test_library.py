"""Actuators to start from: what their files state, and what becomes of them in a new configuration."""

import json
import math
import shlex
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest
import yaml

import friction_hil as fh
from friction_hil.cli import main
from friction_hil.config import load
from friction_hil.models.files import load_model_file
from friction_hil.models.library import FOLDER

DATA = Path(__file__).parents[4] / "shared" / "data"
LIMITS = ("--bus", "can0", "--node", "1", "--torque", "1", "--velocity", "5", "--travel", "1")


@pytest.mark.parametrize("name", fh.library.names())
def test_a_file_states_origin_error_and_validity_and_holds_no_recording(name):
    path = FOLDER / f"{name}.yaml"
    assert path.stat().st_size < 12_000
    model, actuator = fh.library.load(name), fh.library.describe(name)
    content = yaml.safe_load(path.read_text())
    assert set(content["fit"]["actuator"]) == {"what", "source", "licence", "command"}
    assert actuator.command.startswith("friction-hil identify ")
    assert all(set(each) == {"path", "rows"} for each in content["fit"]["recordings"])
    assert 0.0 < actuator.relative_error <= actuator.held_out < 1.0
    assert content["fit"]["standard_errors"]
    low, high = actuator.velocity
    assert low < 0.0 < high
    speeds = np.linspace(low, high, 101)
    torque = model.friction_model.steady_state(speeds, load_torque=0.0)
    assert np.all(torque * speeds >= 0.0)  # friction is passive
    assert 0.0 < actuator.level < math.inf


@pytest.mark.deep
@pytest.mark.parametrize("name", fh.library.names())
def test_the_command_in_a_file_gives_its_parameters(name, tmp_path, monkeypatch):
    actuator = fh.library.describe(name)
    words = shlex.split(actuator.command)[1:]
    folders = [path.parent for path in DATA.rglob(words[1])]
    if not folders:
        pytest.skip("the shared recordings are not here")
    monkeypatch.chdir(folders[0])
    assert main([*words, "--output", str(tmp_path / "again.yaml")]) == 0
    again, known = load_model_file(tmp_path / "again.yaml"), fh.library.load(name)
    assert again.friction.model == known.friction.model
    speeds = np.linspace(*actuator.velocity, 50)
    torques = [each.friction_model.steady_state(speeds, load_torque=1.0) for each in (again, known)]
    np.testing.assert_allclose(*torques, rtol=1e-3)


def test_the_list_is_that_of_python(capsys):
    assert main(["models", "--library", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)["actuators"]
    assert told == json.loads(json.dumps([asdict(fh.library.describe(name)) for name in fh.library.names()]))
    assert main(["models", "--library"]) == 0
    shown = capsys.readouterr().out
    assert all(name in shown for name in fh.library.names())
    assert "BSD-3-Clause" in shown


def test_an_actuator_is_a_model_of_the_command_line(capsys):
    assert main(["models", "ak80-6", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["name"] == fh.library.load("ak80-6").friction.model
    with pytest.raises(fh.errors.UsageError, match=r"did you mean 'ak80-6'"):
        fh.library.load("ak80_6")


def test_a_new_configuration_begins_with_the_friction_of_another_axis_and_says_so(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["config", "new", "machine.yaml", "--like", "ak80-6", *LIMITS]) == 0
    (axis,) = load("machine.yaml").axes.values()
    known = fh.library.load("ak80-6").friction
    assert axis.model.friction.parameters == known.parameters
    assert axis.model.friction.modifiers == {name: each for name, each in known.modifiers.items() if name != "ripple"}
    assert axis.model.mechanics == type(axis.model.mechanics)()
    assert axis.compensation.gain == 0.5
    assert axis.model.is_of_other_axis.startswith("not identified on this axis")
    assert fh.library.load("ak80-6").is_of_other_axis == ""
    capsys.readouterr()
    assert main(["config", "check", "machine.yaml", "--json"]) == 0
    (file,) = json.loads(capsys.readouterr().out)["files"]
    assert [each["field"] for each in file["notes"] if "not identified" in each["message"]] == ["axes.x.model"]


def test_a_run_says_that_the_friction_is_that_of_another_axis(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["config", "new", "machine.yaml", "--like", "ak80-6", *LIMITS]) == 0
    text = Path("machine.yaml").read_text()
    Path("machine.yaml").write_text(text.replace("channel: can0", "channel: no_such_bus"))
    assert main(["run", "machine.yaml", "--duration", "1"]) == 1
    assert "note: x: the model is not identified on this axis: friction of ak80-6" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "text"),
    [
        (("--like", "ak80_6"), "did you mean 'ak80-6'"),
        (("--like", "emps"), "that axis is linear; give --linear"),
        (("--like", "ak80-6", "--linear"), "that axis is rotary; leave out --linear"),
        (("--like", "ak80-6", "--simulated"), "leave --like out"),
        (("--like", "ak80-6", "--example", "demo"), "leave --like out"),
    ],
)
def test_what_does_not_fit_is_refused(words, text, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["config", "new", "machine.yaml", *words]) == 2
    assert text in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []
