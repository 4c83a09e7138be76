"""The command line as such: overview, errors, exit status, JSON; and the command ``config``."""

import json
import math
import os
import re
import subprocess
import sys
from pathlib import Path, PurePosixPath
from types import SimpleNamespace

import click
import numpy as np
import pytest

from friction_hil import __version__
from friction_hil.cli import COMMANDS, LazyGroup, main
from friction_hil.cli.options import option_json
from friction_hil.cli.output import print_json
from friction_hil.cli.work.drives import _parse
from friction_hil.cli.work.tables import console
from friction_hil.config import json_schema, load, self_contained
from friction_hil.config.new_file import Wanted, parse_bus
from friction_hil.errors import ConfigurationError, DriveError, Problem, UsageError
from friction_hil.numerics.json_values import to_json

EXAMPLES = Path(__file__).parents[3] / "config"
DEMO = str(EXAMPLES / "demo.yaml")
MISTAKE = Problem("a.yaml", 3, "b", "c")


@pytest.fixture
def add_command(monkeypatch):
    """Put a command of the test's own into the table."""

    def add(function):
        monkeypatch.setitem(COMMANDS, "probe", "A probe.")
        module = SimpleNamespace(command=click.command()(function))
        monkeypatch.setitem(sys.modules, "friction_hil.cli.probe", module)

    return add


def raising(error):
    def function():
        raise error

    return function


def test_the_overview_names_every_command(capsys):
    assert main(["--help"]) == 0
    out = capsys.readouterr().out
    for name, summary in COMMANDS.items():
        assert f"  {name} " in out
        assert summary in out


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_of_the_table_has_help(name, capsys):
    assert isinstance(LazyGroup().get_command(None, name), click.Command)
    assert main([name, "--help"]) == 0
    assert f"friction-hil {name}" in capsys.readouterr().out


@pytest.mark.deep
@pytest.mark.parametrize("redirections", [">&-", "<&- >&-", "2>&-", "<&- >&- 2>&-"])
def test_closed_standard_streams_are_no_mistake(redirections, tmp_path):
    """A file that is opened then must not take the number of one of them either."""
    (tmp_path / "a.csv").write_text("time_s,torque\n0.0,1.0\n")
    line = f'exec "$0" -m friction_hil convert a.csv b.csv {redirections}'
    words = ["sh", "-c", line, sys.executable]
    run = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True, check=False, timeout=120)
    assert (run.returncode, run.stderr) == (0, "")
    assert (tmp_path / "b.csv").read_text() == "time_s,torque\n0.0,1.0\n"


def test_the_module_is_the_command(capsys):
    words = [sys.executable, "-m", "friction_hil", "--version"]
    run = subprocess.run(words, capture_output=True, text=True, check=True)
    assert main(["--version"]) == 0
    assert run.stdout == capsys.readouterr().out == f"friction-hil {__version__}\n"


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["rnu"], "'run'"),
        (["--verison"], "--version"),
        (["config", "chekc"], "'check'"),
        (["config", "check"], "FILE"),
        (["config", "check", "--jsno", "x"], "--json"),
    ],
)
def test_wrong_use(words, message, capsys):
    assert main(words) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert message in err
    assert "Traceback" not in err


@pytest.mark.parametrize(
    ("error", "status", "message"),
    [
        (UsageError("not so"), 2, "Error: not so\n"),
        (DriveError("node 3 does not answer"), 1, "Error: node 3 does not answer\n"),
        (ConfigurationError([MISTAKE, Problem("d", None, "", "e")]), 2, "a.yaml:3: b: c\nd: e\n"),
        (PermissionError(13, "Permission denied", "out.csv"), 1, "Permission denied: 'out.csv'"),
        (KeyboardInterrupt(), 130, "\n"),
    ],
)
def test_an_error_ends_with_its_status(add_command, capsys, error, status, message):
    add_command(raising(error))
    assert main(["probe"]) == status
    out, err = capsys.readouterr()
    assert out == ""
    assert message in err
    assert "Traceback" not in err


ERRORS = (
    (UsageError("not so"), "\x1b[31m\x1b[1mError:\x1b[0m not so\n"),
    (click.UsageError("no such thing"), "\x1b[31m\x1b[1mError:\x1b[0m no such thing\n"),
    (PermissionError(13, "denied", "out.csv"), "\x1b[31m\x1b[1mError:\x1b[0m [Errno 13] denied: 'out.csv'\n"),
    (ConfigurationError([MISTAKE]), "\x1b[31m\x1b[1ma.yaml:3:\x1b[0m b: c\n"),
)


@pytest.mark.parametrize(("error", "coloured"), ERRORS)
@pytest.mark.parametrize("given", [{}, {"NO_COLOR": "1"}, {"TERM": "dumb"}, {"NO_COLOR": "", "TERM": "xterm"}])
def test_errors_are_red_on_a_terminal_and_only_there(add_command, capsys, monkeypatch, error, coloured, given):
    for name in ("NO_COLOR", "TERM"):
        monkeypatch.delenv(name, raising=False)
    for name, value in given.items():
        monkeypatch.setenv(name, value)
    plain = re.sub(r"\x1b\[\d+m", "", coloured)
    add_command(raising(error))
    main(["probe"])
    assert capsys.readouterr().err.endswith(plain)
    monkeypatch.setattr(sys.stderr, "isatty", lambda: True, raising=False)
    main(["probe"])
    wants_none = given.get("NO_COLOR") or given.get("TERM") == "dumb"
    assert capsys.readouterr().err.endswith(plain if wants_none else coloured)
    assert ("\x1b" in plain) is False


def test_a_mistake_of_ours_shows_where_and_asks_to_report_it(add_command, capsys):
    add_command(raising(ZeroDivisionError("oh")))
    assert main(["probe"]) == 1
    err = capsys.readouterr().err
    assert "Traceback" in err
    assert "ZeroDivisionError: oh" in err
    assert "error in friction-hil" in err.rstrip().splitlines()[-1]


@pytest.mark.parametrize("error", [DriveError("no answer"), OSError(28, "disk full"), ValueError("math domain error")])
def test_what_is_left_of_the_work_is_told_with_the_error(add_command, capsys, error):
    error.add_note("The recordings made so far are kept: a.mcap.")
    add_command(raising(error))
    assert main(["probe"]) == 1
    assert "The recordings made so far are kept: a.mcap." in capsys.readouterr().err.splitlines()


@pytest.mark.parametrize(("result", "status"), [(None, 0), (0, 0), (1, 1), ("text", 0), (True, 0)])
def test_a_command_returns_its_status(add_command, result, status):
    add_command(lambda: result)
    assert main(["probe"]) == status


LATE = "cli.application.main = lambda *_, **__: print('late')"  # still in the buffer when the command ends


@pytest.mark.parametrize(
    "code", ["sys.exit(main(['config', 'schema']))", f"import friction_hil.cli as cli; {LATE}; sys.exit(main([]))"]
)
def test_a_reader_that_went_away_is_met_quietly(code):
    reader, writer = os.pipe()
    os.close(reader)
    words = [sys.executable, "-c", f"import sys; from friction_hil.cli import main; {code}"]
    try:
        run = subprocess.run(words, stdout=writer, stderr=subprocess.PIPE, text=True)
    finally:
        os.close(writer)
    assert (run.returncode, run.stderr) == (1, "")


@pytest.mark.parametrize("error", [error for error, _ in ERRORS])
@pytest.mark.parametrize("has_printed", [False, True])
def test_an_error_of_a_command_with_json_is_json_too(add_command, capsys, error, has_printed):
    def fails(as_json):
        if has_printed:
            print_json({"models": []})
        raise error

    add_command(option_json(fails))
    assert main(["probe", "--json"]) != 0
    out, err = capsys.readouterr()
    document = json.loads(out)
    assert set(document) == ({"models"} if has_printed else {"error"})
    assert has_printed or document["error"].splitlines()[0] in err
    main(["probe"])
    assert bool(capsys.readouterr().out) == has_printed


@pytest.mark.parametrize("name", ["demo", "serial_modbus", "sidecar"])
def test_a_configuration_in_place_of_a_model_file_is_called_one(name, capsys):
    assert main(["export", f"config/{name}.yaml", "--to", "csv"]) == 2
    assert capsys.readouterr().err.startswith(f"config/{name}.yaml: this is a configuration")
    assert main(["export", "config/models/lugre_axis.yaml", "--to", "mujoco"]) == 2
    assert "--to mjcf" in capsys.readouterr().err


@pytest.mark.parametrize("words", ["can0", "socketcan:can0", "udp_multicast:239.74.163.2:43114"])
def test_a_bus_is_named_alike_for_a_new_file_and_for_drives(words):
    section = parse_bus(Wanted(bus=words))
    found = _parse(words, None)
    assert (found.interface, found.channel) == (section["interface"], section["channel"])
    assert found.port == section.get("port", found.port)


def test_json_output(add_command, capsys):
    numbers = {"float": np.float64(0.1), "int": np.int32(3), "bool": np.bool_(True), "nan": np.float32("nan")}
    given = {"nan": math.nan, "infinite": [math.inf, -math.inf, 1.5], "numpy": numbers}
    given |= {"array": np.array([[1.0, np.inf], [2.0, 3.0]]), "path": PurePosixPath("a/b"), 3: (None, True, "ä")}

    @option_json
    def function(as_json):
        assert as_json
        print_json(given)

    add_command(function)
    assert main(["probe", "--json"]) == 0
    assert json.loads(capsys.readouterr().out) == {
        "nan": None,
        "infinite": [None, None, 1.5],
        "numpy": {"float": 0.1, "int": 3, "bool": True, "nan": None},
        "array": [[1.0, None], [2.0, 3.0]],
        "path": "a/b",
        "3": [None, True, "ä"],
    }
    with pytest.raises(TypeError, match="complex"):
        to_json([1j])


def test_consoles(capsys):
    console().print("result")
    console(stderr=True).print("progress")
    assert capsys.readouterr() == ("result\n", "progress\n")


def test_check_reports_every_mistake_of_every_file(tmp_path, capsys):
    path = tmp_path / "bad.yaml"
    path.write_text(Path(DEMO).read_text().replace("node: 1 ", "node: 0 ").replace("radius: 1.0", "radius: -1"))
    line = 1 + next(n for n, text in enumerate(path.read_text().splitlines()) if "node: 0 " in text)
    missing = tmp_path / "missing.yaml"
    assert main(["config", "check", str(path), DEMO, str(missing)]) == 2
    out, err = capsys.readouterr()
    assert out == f"{DEMO}: ok\n"
    assert f"{path}:{line}: axes.x.node: must be at least 1 and at most 127, not 0\n" in err
    assert "axes.x.trajectory.radius" in err
    assert "axes.y.trajectory.radius" in err
    assert f"{missing}: cannot be read: No such file or directory\n" in err

    assert main(["config", "check", "--json", str(path), DEMO]) == 2
    out, err = capsys.readouterr()
    bad, good = json.loads(out)["files"]
    assert err == ""
    assert good == {"path": DEMO, "problems": [], "notes": []}
    assert len(bad["problems"]) == 3
    message = "must be at least 1 and at most 127, not 0"
    assert bad["problems"][0] == {"path": str(path), "line": line, "field": "axes.x.node", "message": message}


def test_show_prints_what_loads_again_and_of_a_bad_file_nothing(tmp_path, capsys):
    for example in sorted(EXAMPLES.glob("*.yaml")):
        assert main(["config", "show", str(example)]) == 0
        path = tmp_path / example.name
        path.write_text(capsys.readouterr().out)
        assert self_contained(load(path)) == self_contained(load(example))
    path.write_text("version: 1\n")
    assert main(["config", "show", str(path)]) == 2
    out, err = capsys.readouterr()
    assert out == ""
    assert f"{path}:1: period_s: is missing" in err


def test_schema(capsys):
    assert main(["config", "schema"]) == 0
    assert json.loads(capsys.readouterr().out) == json_schema()


def test_commands_import_can_without_asammdf_and_leave_it_to_others():
    code = (
        "import sys; from friction_hil.cli import main; main(['--help']); import can, can.io.mf4; "
        "assert 'asammdf' not in sys.modules; import asammdf; print(can.io.mf4.asammdf, can.MF4Writer.__name__)"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert run.stdout.splitlines()[-1] == "None MF4Writer"
