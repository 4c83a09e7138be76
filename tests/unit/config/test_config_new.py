"""``friction-hil config new``: the file fits what was asked for, or says what is left to fill in."""

import json
import re
from pathlib import Path

import friction_hil_drivers
import jsonschema
import pytest
import yaml

from friction_hil.checked_yaml.section import keys
from friction_hil.checked_yaml.text import read
from friction_hil.cli import main
from friction_hil.config import AxisLimits, load
from friction_hil.config.examples import examples
from tests.fake_drivers import install
from tests.processes import run

LIMITS = ("--torque", "0.1", "--velocity", "5", "--travel", "1")
DRIVERS = ("canopen", "modbus", "ascii", "dynamixel")


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def made(*words):
    """The configuration that the words make, without mistakes."""
    assert main(["config", "new", *words]) == 0
    assert main(["config", "check", "machine.yaml"]) == 0
    return load("machine.yaml", needs_models=False)


def refused(capsys, *words):
    """What stderr says about words that are refused."""
    assert main(["config", "new", *words]) == 2
    return capsys.readouterr().err


def test_what_is_asked_for_is_in_the_file(folder):
    configuration = made("--bus", "slcan:/dev/ttyACM0", "--bitrate", "500000", "--node", "5", "--mode", "csv", *LIMITS)
    bus, axis = configuration.bus, configuration.axes["x"]
    assert (bus.interface, bus.channel, bus.bitrate) == ("slcan", "/dev/ttyACM0", 500_000)
    assert (axis.driver, axis.options.node, axis.mode) == ("canopen", 5, "csv")
    assert (axis.limits.torque, axis.limits.velocity) == (0.1, 5.0)
    assert axis.experiment.travel == 1.0
    assert axis.trajectory.amplitude <= 1.0
    assert axis.simulation is None
    assert axis.model.source_path == folder / "machine_x.yaml"


def test_nothing_that_moves_the_machine_has_a_default_and_what_is_filled_in_is_accepted(folder, capsys):
    assert main(["config", "new", "--bus", "can0"]) == 0
    told = capsys.readouterr().out
    assert main(["config", "check", "machine.yaml"]) == 2
    problems = capsys.readouterr().err.splitlines()
    wanted = {"node", "limits.torque", "limits.velocity", "trajectory.amplitude", "trajectory.frequency"}
    wanted |= {"experiment.velocity", "experiment.travel"}
    lines = (folder / "machine.yaml").read_text().splitlines()
    for problem in problems:
        number, field = re.match(r"machine\.yaml:(\d+): axes\.x\.([a-z._]+): .* not empty: fill in ", problem).groups()
        assert "FILL IN" in lines[int(number) - 1]
        wanted.remove(field)
    assert not wanted
    assert set(problems) <= set(told.splitlines())
    assert sum("FILL IN" in line for line in lines) == len(problems)
    values = iter(("1", "0.1", "5", "0.5", "0.4", "3", "1"))
    text = (folder / "machine.yaml").read_text()
    filled = re.sub(r":( +# FILL IN)", lambda blank: f": {next(values)}{blank[1]}", text)
    (folder / "machine.yaml").write_text(filled)
    assert main(["config", "check", "machine.yaml"]) == 0
    assert next(values, None) is None


@pytest.mark.parametrize(
    "words",
    [*(("--driver", name) for name in DRIVERS), ("--mode", "csv"), ("--mode", "cst")],
    ids=lambda words: words[1],
)
def test_a_simulated_drive_needs_nothing_else(words, folder):
    axis = made("--simulated", *words).axes["x"]
    assert axis.simulation is not None
    assert axis.model.source_path is None
    assert axis.mode == words[1] or words[0] == "--driver"


@pytest.mark.deep
@pytest.mark.parametrize("driver", ["modbus", "ascii", "dynamixel"])
def test_a_simulated_drive_of_any_description_needs_nothing_else(driver, folder):
    folders = Path(friction_hil_drivers.__file__).parent / driver / "descriptions"
    for description in sorted(path.stem for path in folders.glob("*.yaml")):
        made("--driver", driver, "--description", description, "--simulated", "--force")


@pytest.mark.deep
@pytest.mark.parametrize(
    "words", [("--mode", "cst"), ("--driver", "dynamixel"), ("--driver", "modbus", "--description", "kinco_fd5p")]
)
def test_a_simulated_drive_runs_also_with_the_soft_loops_of_the_daemon(words, folder):
    made("--simulated", *words)
    done = run("run", "machine.yaml", "--simulate", "--pace", "sync", "--duration", "3")
    assert done.returncode == 0, done.stderr


def test_a_linear_axis_is_in_its_units(folder, capsys):
    assert main(["config", "new", "--linear", "--bus", "can0", "--node", "1", *LIMITS]) == 0
    asked = {line.split(": ")[1] for line in capsys.readouterr().out.splitlines() if "machine.yaml:" in line}
    assert asked >= {"axes.x.counts_per_unit", "axes.x.rated_torque"}
    text = (folder / "machine.yaml").read_text()
    assert "rad/s" not in text
    assert "  # N; limit of abs(compensation)" in text
    text = text.replace("counts_per_unit: ", "counts_per_unit: 1e6").replace("rated_torque: ", "rated_torque: 100 ")
    (folder / "machine.yaml").write_text(text)
    assert load("machine.yaml", needs_models=False).axes["x"].model.axis == "linear"


def test_a_serial_drive_asks_for_what_its_description_needs(folder, capsys):
    words = ("--driver", "modbus", "--bus", "/dev/ttyUSB0", "--node", "3", "--description", "nanotec_n5", *LIMITS)
    assert main(["config", "new", *words]) == 0
    told = capsys.readouterr().out
    for key in ("counts_per_unit", "rated_torque", "position_gain"):
        assert re.search(rf"^machine\.yaml:\d+: .*{key}: .*fill(ed)? in", told, re.MULTILINE), told
    values = yaml.safe_load((folder / "machine.yaml").read_text())
    assert "bus" not in values
    axis = values["axes"]["x"]
    assert (axis["line"]["port"], axis["unit"], axis["mode"]) == ("/dev/ttyUSB0", 3, "cst")
    assert axis["is_watchdog_required"] is True


def test_the_file_fits_the_schema_beside_it_and_every_key_is_explained(folder):
    made("--simulated")
    text, value = (folder / "machine.yaml").read_text(), read("machine.yaml").value
    named = re.match(r"# yaml-language-server: \$schema=(\S+)\n", text)[1]
    schema = json.loads((folder / named).read_text())
    jsonschema.Draft202012Validator.check_schema(schema)
    assert list(jsonschema.Draft202012Validator(schema).iter_errors(value)) == []
    assert set(value["axes"]["x"]["limits"]) == set(keys(AxisLimits)), "every limit is there"
    assert max(map(len, text.splitlines())) <= 120
    bare = [line for line in text.splitlines() if ": " in line and "#" not in line]
    assert [line.strip() for line in bare] == ["axis: rotary"]


def test_files_in_two_folders_have_buses_of_their_own(folder):
    ports = set()
    for name in ("a", "b"):
        assert main(["config", "new", f"{name}/trial.yaml", "--simulated"]) == 0
        ports.add(load(f"{name}/trial.yaml").bus.port)
    assert len(ports) == 2


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("--driver", "canopn"), "'canopen'"),
        (("--driver", "modbus", "--description", "nanotec_n6"), "'nanotec_n5'"),
        (("--driver", "modbus", "--description", "nanotec_n5", "--mode", "csp"), "There are: cst"),
        (("--description", "odrive"), "serial lines"),
        (("--simulated", "--linear"), "leave --linear out"),
        (("--example", "demoo"), "'demo'"),
        (("--example", "demo", "--node", "3"), "leave --node out"),
        (("machine.json",), ".yaml"),
        (("--bus", ":"), "can0"),
        (("--torque", "nan"), "--torque"),
        (("--travel", "-1"), "--travel"),
    ],
)
def test_mistakes_name_the_choices_and_write_nothing(words, message, folder, capsys):
    assert message in refused(capsys, *words)
    assert list(folder.iterdir()) == []


def test_a_file_is_overwritten_only_when_that_is_asked_for(folder, capsys):
    (folder / "machine.yaml").write_text("mine\n")
    assert "--force" in refused(capsys, "--simulated")
    assert (folder / "machine.yaml").read_text() == "mine\n"
    made("--simulated", "--force")


def test_a_driver_of_another_package_is_asked_for_its_required_keys(folder, capsys, tmp_path_factory, monkeypatch):
    monkeypatch.syspath_prepend(install(tmp_path_factory.mktemp("site")))
    assert main(["config", "new", "--driver", "fake", *LIMITS]) == 0
    assert "axes.x.node: must be a whole number, not empty" in capsys.readouterr().out


@pytest.mark.parametrize("name", sorted(examples()))
def test_an_example_is_listed_and_runs_from_where_it_is_copied_to(name, folder, capsys):
    assert main(["config", "examples"]) == 0
    assert re.search(rf"^{name} +\w+.* \w+", capsys.readouterr().out, re.MULTILINE)
    assert main(["config", "new", "sub/mine.yaml", "--example", name]) == 0
    assert main(["config", "check", "sub/mine.yaml"]) == 0
    assert load("sub/mine.yaml").axes  # with its model files
    text = (folder / "sub/mine.yaml").read_text()
    assert f"config/{name}" not in text
    schema = re.match(r"# yaml-language-server: \$schema=(\S+)\n", text)[1]
    assert (folder / "sub" / schema).is_file()
