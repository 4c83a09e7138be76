"""The daemon under a service manager: a notify socket takes the place of systemd."""

import os
import signal
import socket
import subprocess

import pytest

from tests.processes import start, write_configuration


@pytest.mark.deep
def test_the_daemon_reports_its_start_its_life_and_its_end(tmp_path):
    configuration = write_configuration(tmp_path)
    runtime = tmp_path / "run"
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager:
        manager.bind(str(tmp_path / "n"))
        manager.settimeout(60.0)
        environment = {
            **os.environ,
            "NOTIFY_SOCKET": str(tmp_path / "n"),
            "WATCHDOG_USEC": "400000",
            "RUNTIME_DIRECTORY": str(runtime),
        }
        words = ("run", configuration, "--simulate", "--pace", "sync", "--wait", "--name", "n")
        daemon = start(*words, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
        messages = []
        while messages.count("WATCHDOG=1") < 5 or "STATUS=waiting" not in messages:
            messages.append(manager.recv(4096).decode())
        daemon.send_signal(signal.SIGTERM)
        _, errors = daemon.communicate(timeout=60)
        manager.settimeout(0.0)
        while messages[-1] != "STOPPING=1":
            messages.append(manager.recv(4096).decode())
    assert daemon.returncode == 0, errors
    assert messages.index("READY=1") < messages.index("WATCHDOG=1")
    assert messages.count("READY=1") == 1
    assert "STATUS=running" not in messages  # nobody has enabled it
    assert "STATUS=done" in messages
