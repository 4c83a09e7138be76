"""What tests take for commands of friction-hil are such."""

import os
import signal
import subprocess
from pathlib import Path

import pytest

from tests import launcher
from tests.processes import write_configuration

PIPES = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "stderr": subprocess.PIPE}


def test_a_command_ends_with_its_status_and_its_words() -> None:
    with launcher.start("run", "there_is_none.yaml", **PIPES) as command:
        said = command.communicate(timeout=60)
    assert command.returncode == 2
    assert said == ("", "there_is_none.yaml: cannot be read: No such file or directory\n")


def test_a_command_is_a_process_of_its_own_and_a_child_of_the_test(tmp_path: Path) -> None:
    path = write_configuration(tmp_path)
    with launcher.start("simulate", path, **PIPES) as running, launcher.start("--version", **PIPES) as other:
        assert other.communicate(timeout=60)[0].startswith("friction-hil ")
        assert other.returncode == 0
        assert running.poll() is None
        os.kill(running.pid, signal.SIGKILL)
        assert running.wait(60) == -signal.SIGKILL


def test_with_an_environment_of_its_own_a_command_is_started_anew(monkeypatch: pytest.MonkeyPatch) -> None:
    with launcher.start("--version", **PIPES) as command:
        assert isinstance(command, launcher.Command)
        command.communicate(timeout=60)
    monkeypatch.setenv("FRICTION_HIL_TEST", "1")
    with launcher.start("--version", **PIPES) as command:
        assert isinstance(command, subprocess.Popen)
        assert command.communicate(timeout=60)[0].startswith("friction-hil ")


def test_a_folder_and_what_is_read_on_use_need_no_interpreter(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "here.yaml").write_text("version: 0\n")
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))
    with launcher.start("run", "here.yaml", cwd=tmp_path, **PIPES) as command:
        assert isinstance(command, launcher.Command)
        _, errors = command.communicate(timeout=60)
    assert "here.yaml" in errors
    assert "cannot be read" not in errors


def test_a_command_that_goes_on_times_out_and_can_be_asked_again(tmp_path: Path) -> None:
    path = write_configuration(tmp_path)
    with launcher.start("simulate", path, "--pace", "sync", **PIPES) as running:
        assert running.stdout.readline().startswith("ready:")
        with pytest.raises(subprocess.TimeoutExpired):
            running.wait(0.01)
        with pytest.raises(subprocess.TimeoutExpired):
            running.communicate(timeout=0.01)
        running.terminate()
        output, errors = running.communicate(timeout=60)
        assert (output, errors, running.returncode) == ("", "", 0)
        running.kill()  # of what has ended: nothing happens
        assert running.wait(60) == 0


def test_streams_may_be_files_or_one_pipe_for_both(tmp_path: Path) -> None:
    with (tmp_path / "out").open("w") as file:
        with launcher.start("--version", stdin=subprocess.DEVNULL, stdout=file, stderr=subprocess.STDOUT) as command:
            assert command.communicate(timeout=60) == ("", "")
        with launcher.start("run", "none.yaml", stdout=subprocess.PIPE, stderr=subprocess.STDOUT) as command:
            assert "none.yaml: cannot be read" in command.communicate(timeout=60)[0]
    assert (tmp_path / "out").read_text().startswith("friction-hil ")
    assert command.poll() == 2
