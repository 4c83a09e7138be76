"""A run whose companion is killed, and runs that are ended while they connect: real processes, real signals."""

import json
import os
import signal
import socket
from pathlib import Path

import numpy as np
import pytest
import yaml

import friction_hil as fh
from friction_hil.drive.port import DriveState
from tests.processes import listening, simulated_drives, start_daemon, wait_for_frames, write_configuration
from tests.servo_drives import axis_dict

SYNC = 0x80


def children(pid: int) -> list[int]:
    """Child processes of a process, and theirs."""
    own = [int(each) for each in Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]
    return own + [grandchild for child in own for grandchild in children(child)]


def _command(pid: int) -> bytes:
    return Path(f"/proc/{pid}/cmdline").read_bytes()


@pytest.mark.deep
def test_a_run_whose_companion_is_killed_goes_on_and_names_all_its_files(tmp_path: Path) -> None:
    configuration = write_configuration(tmp_path)
    with simulated_drives(configuration), listening(configuration) as bus:
        daemon = start_daemon(configuration, "--duration", 3, "--record", tmp_path / "run.mcap")
        wait_for_frames(bus, SYNC, 1600)  # until a chunk of 1 s is on disk
        (companion,) = [pid for pid in children(daemon.pid) if b"daemon.companion" in _command(pid)]
        os.kill(companion, signal.SIGKILL)
        output, errors = daemon.communicate(timeout=120)
    assert daemon.returncode == 0, errors
    told = "the companion process died (signal SIGKILL); the next one takes over, and the loop goes on"
    assert errors.index(f"friction-hil: {told}") < errors.index(f"recording: {told}")
    result = json.loads(output)
    assert result["faults"] == []
    assert result["recordings"] == [str(tmp_path / "run.mcap"), str(tmp_path / "run-2.mcap")]
    assert result["recording"] == result["recordings"][0]
    parts = [fh.recordings.read(path, "x") for path in result["recordings"]]
    recorded = np.unique(np.concatenate([part["cycle"] for part in parts]))
    assert len(recorded) == result["cycles"]
    assert [event.text for event in parts[1].events if event.name == "warning"] == [f"recording: {told}"]
    assert parts[1]["drive_state"][-1] != DriveState.OPERATION_ENABLED


@pytest.mark.parametrize(("number", "status"), [(signal.SIGINT, 130), (signal.SIGTERM, 143)])
def test_a_signal_ends_a_run_that_connects_at_once(tmp_path: Path, number: int, status: int) -> None:
    with socket.create_server(("127.0.0.1", 0)) as listener:  # accepts, and never answers
        line = {"port": f"tcp://127.0.0.1:{listener.getsockname()[1]}"}
        axis = axis_dict() | {
            "driver": "modbus",
            "unit": 1,
            "description": "generic_cia402",
            "mode": "csp",
            "line": line,
        }
        axis |= {"counts_per_unit": 1e5, "rated_torque": 0.64, "torque_constant": 0.1}
        del axis["node"]
        configuration = tmp_path / "axes.yaml"
        top = {"version": 1, "period_s": 4e-3, "realtime": {"priority": 0}}
        configuration.write_text(yaml.safe_dump({**top, "axes": {"x": axis}}))
        daemon = start_daemon(configuration, "--record", tmp_path / "run.mcap")
        listener.settimeout(60.0)
        connection, _ = listener.accept()
        with connection:
            assert connection.recv(1), daemon.communicate()
            daemon.send_signal(number)
            output, errors = daemon.communicate(timeout=60)
    assert (daemon.returncode, output) == (status, "")
    assert errors.strip() == f"stopped ({signal.Signals(number).name}) before anything was enabled"
    assert [path.name for path in tmp_path.iterdir()] == ["axes.yaml"]
