"""``friction-hil stop`` and ``reset``, as processes: drives that a killed daemon left enabled, and that tripped."""

import json
from pathlib import Path
from typing import Any

import can
import pytest
import yaml

from friction_hil.cli import main
from friction_hil.drive import Driver
from tests.launcher import start
from tests.peers.serial_processes import wait_until, write_serial_configuration
from tests.processes import listening, run, run_daemon, simulated_drives, write_configuration

PACED = ("--pace", "sync")


def configured(folder: Path, kind: str) -> Path:
    """One axis that nothing stops but time, which passes with SYNC or requests alone."""
    return write_configuration(folder) if kind == "canopen" else write_serial_configuration(folder, kind)


def told(command: str, configuration: Path, *options: str) -> tuple[int, dict[str, Any]]:
    """Exit status, and the JSON of the only axis."""
    done = run(command, configuration, "--json", *options, check=False)
    (axis,) = json.loads(done.stdout)["axes"]
    return done.returncode, axis


def kill_in_motion(configuration: Path) -> None:
    recording = configuration.parent / "killed.mcap"
    daemon = start("run", configuration, *PACED, "--record", recording, stdout=-3, stderr=-3)
    wait_until(lambda: recording.exists() and recording.stat().st_size > 20_000, "the daemon's recording", 60.0)
    daemon.kill()
    daemon.wait(10.0)


@pytest.mark.deep
@pytest.mark.parametrize("kind", ["canopen", "modbus rtu"])
def test_stop_takes_the_power_that_a_killed_daemon_left_on(tmp_path: Path, kind: str) -> None:
    configuration = configured(tmp_path, kind)
    with simulated_drives(configuration):
        kill_in_motion(configuration)
        refused = run("run", configuration, *PACED, "--duration", 0.1, check=False)
        assert refused.returncode == 1
        assert "already" in refused.stderr
        assert "friction-hil stop CONFIG" in refused.stderr, "the command that helps"
        status, axis = told("reset", configuration)
        assert (status, axis["result"], axis["before"]) == (1, "powered", "operation enabled")
        status, axis = told("stop", configuration)
        assert (status, axis["result"], axis["before"]) == (0, "stopped", "operation enabled")
        assert axis["axis"] == "x"
        assert axis["address"].startswith({"canopen": "node 1 on", "modbus rtu": "unit 3 on"}[kind])


@pytest.mark.deep
def test_reset_says_what_the_fault_was_and_no_run_needs_more(tmp_path: Path) -> None:
    configuration = write_serial_configuration(tmp_path, "odrive")
    with simulated_drives(configuration):
        kill_in_motion(configuration)
        run_daemon(configuration, "--duration", 1.0, "--dry-run", check=False)  # time passes: the watchdog trips
        result, _ = run_daemon(configuration, "--duration", 0.1, check=False)
        assert "in fault" in result["faults"][0]
        assert told("stop", configuration)[1]["after"] == "fault", "stop resets nothing"
        text = run("reset", configuration).stdout
        assert "x (the only drive on" in text
        assert "): fault reset: 2048 (800h) watchdog timer expired; ready to switch on read back" in text
        result, _ = run_daemon(configuration, "--duration", 0.1)
        assert result["faults"] == []


def test_what_is_not_read_back_is_unknown_and_keeps_no_other_axis_from_being_stopped(tmp_path: Path) -> None:
    """Drives of two drivers and lines: one line is missing, the drives of the others are stopped all the same."""
    first, second = tmp_path / "first", tmp_path / "second"
    for folder in (first, second):
        folder.mkdir()
    there = write_serial_configuration(first, "modbus rtu")
    axes = yaml.safe_load(there.read_text())["axes"]
    gone = yaml.safe_load(write_serial_configuration(second, "modbus rtu").read_text())["axes"]["x"]
    other = yaml.safe_load(write_serial_configuration(second, "odrive").read_text())["axes"]["x"]
    other["line"]["port"] = str(second / "other")
    data = {**yaml.safe_load(there.read_text()), "axes": {"gone": gone, "other": other, **axes}}
    every = tmp_path / "every.yaml"
    every.write_text(yaml.safe_dump(data))
    with simulated_drives(there):
        done = run("stop", every, "--json", check=False)
        assert done.returncode == 1
        found = {axis["axis"]: axis for axis in json.loads(done.stdout)["axes"]}
        assert [axis["result"] for axis in found.values()] == ["unknown", "unknown", "unpowered"]
        assert list(found) == list(data["axes"])
        assert "there is no such port" in found["gone"]["detail"]
        assert run("stop", every, "--axis", "x").returncode == 0
    wrong = run("stop", every, "--axis", "y", check=False)
    assert wrong.returncode == 2
    assert "there are: gone, other, x" in wrong.stderr


def test_a_driver_that_can_stop_nothing_leaves_its_drives_unknown(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("friction_hil.cli.work.stop.load_driver", lambda name: Driver)
    status = main(["stop", str(write_configuration(tmp_path)), "--json"])
    (axis,) = json.loads(capsys.readouterr().out)["axes"]
    assert (status, axis["result"], axis["after"]) == (1, "unknown", "unknown")
    assert "its driver can only stop drives within a run" in axis["detail"]


def test_reset_leaves_the_drive_of_another_master_alone(tmp_path: Path) -> None:
    """Without its fault the drive would be enabled again at once."""
    configuration = write_configuration(tmp_path)
    with simulated_drives(configuration), listening(configuration) as bus:
        task = bus.send_periodic(can.Message(arbitration_id=0x80, is_extended_id=False), 0.02)
        status, axis = told("reset", configuration)
        task.stop()
    assert (status, axis["result"]) == (1, "unknown")
    assert "another master is at work" in axis["detail"]
    assert "SYNC" in axis["detail"]
