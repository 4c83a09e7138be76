"""On Windows and macOS: the commands that need no drive do their work, and the others say that they need Linux."""

import io
import json
import re
import shlex
import subprocess
import sys

import pytest

from friction_hil.cli import COMMANDS, NEED_LINUX, main
from friction_hil.parallel import pool
from tests.integration.test_readme_commands import ON_THE_RECORDING, WITHOUT_DRIVES
from tests.processes import run, simulated_drives, write_configuration
from tests.readme_commands import ROOT

DOCTOR = 1  # its exit status where the daemon does not run


@pytest.fixture
def folder(tmp_path, monkeypatch):
    """A folder with a configuration and a recording that a machine with Linux has made."""
    configuration = write_configuration(tmp_path).rename(tmp_path / "machine.yaml")
    monkeypatch.chdir(tmp_path)
    with simulated_drives(configuration):
        run("run", configuration, "--pace", "sync", "--duration", "3", "--record", "run.mcap")
    return tmp_path


def on_another_system(platform, commands, folder):
    """Run commands without what that system lacks; return exit status, output and errors of each."""
    (folder / "commands.json").write_text(json.dumps(commands))
    words = [sys.executable, "-P", ROOT / "tests/other_system.py", platform, "commands.json"]
    done = subprocess.run(words, cwd=folder, capture_output=True, text=True, check=False, timeout=240)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


@pytest.mark.deep
def test_every_command_that_needs_no_drive_works_without_linux(folder):
    commands = [*WITHOUT_DRIVES, *ON_THE_RECORDING]
    used = {shlex.split(text)[1] for text, _ in commands} - {"--help", "--version"}
    assert used == set(COMMANDS) - set(NEED_LINUX)
    results = on_another_system("win32", [text for text, _ in commands], folder)
    for (text, status), (found, out, errors) in zip(commands, results, strict=True):
        assert found == (DOCTOR if " doctor" in text else status), f"{text}:\n{errors}{out}"
        assert "Traceback" not in errors


@pytest.mark.parametrize("platform", ["win32", "darwin"])
@pytest.mark.parametrize("name", NEED_LINUX)
def test_a_command_that_needs_linux_says_so_before_it_does_anything(platform, name, monkeypatch, capsys):
    monkeypatch.setattr(sys, "platform", platform)
    assert main([name, "there_is_none.yaml"]) == 2
    assert f"Error: '{name}' needs Linux; on this system there are: plot, replay, " in capsys.readouterr().err
    assert main([name, "--help"]) == 0


def test_pages_name_the_commands_that_need_linux():
    for page in ("README.md", "friction_hil/cli/README.md"):
        (named,) = re.findall(r"((?:`\w+`(?:, | and )?)+) need Linux", " ".join((ROOT / page).read_text().split()))
        assert set(re.findall(r"\w+", named.replace(" and ", " "))) == set(NEED_LINUX)


def test_the_page_of_the_command_line_lists_what_runs_elsewhere():
    (row,) = re.findall(
        r"^\| Windows, macOS \| (.+) \|$", (ROOT / "friction_hil/cli/README.md").read_text(), re.MULTILINE
    )
    assert set(re.findall(r"`(\w+)`", row)) == set(COMMANDS) - set(NEED_LINUX)


@pytest.mark.parametrize(("platform", "encoding"), [("win32", "utf-8"), ("linux", "cp1252")])
def test_windows_writes_utf8_into_pipes(platform, encoding, monkeypatch):
    """Its own encodings lack letters of units and formulas; other systems have the one that their user has chosen."""
    monkeypatch.setattr(sys, "platform", platform)
    for name in ("stdout", "stderr"):
        monkeypatch.setattr(sys, name, io.TextIOWrapper(io.BytesIO(), encoding="cp1252"))
    assert main(["--version"]) == 0
    assert (sys.stdout.encoding, sys.stderr.encoding) == (encoding, encoding)


def test_doctor_elsewhere_checks_the_configuration_and_no_hardware(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(sys, "platform", "darwin")
    path = write_configuration(tmp_path)
    assert main(["doctor", str(path), "--json"]) == 1
    results = {one["check"]: one["result"] for one in json.loads(capsys.readouterr().out)}
    assert results == {
        "operating system": "fail",
        "compiled kernels": results["compiled kernels"],
        "configuration": "pass",
    }
    path.write_text(path.read_text().replace("node:", "nod:"))
    assert main(["doctor", str(path), "--json"]) == 2


def test_processors_are_counted_where_the_system_does_not_say_which_are_ours(monkeypatch):
    monkeypatch.delattr(pool.os, "sched_getaffinity")
    monkeypatch.setattr(pool.os, "cpu_count", lambda: 3)
    assert pool.processors() == 3
    monkeypatch.setattr(pool.os, "cpu_count", lambda: None)
    assert pool.processors() == 1
