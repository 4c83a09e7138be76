"""The monitor as a process: on a terminal that is taken away and given back, and in a pipe."""

import contextlib
import os
import pty
import signal
import subprocess
import termios
from pathlib import Path

from friction_hil.daemon.safety import LoopState
from tests.integration.test_runtime_control import until
from tests.launcher import start
from tests.unit.test_live import Daemon, folder  # noqa: F401  a fixture

BEGIN, END = b"\x1b[?1049h", b"\x1b[?1049l"


@contextlib.contextmanager
def running(time_s):
    daemon = Daemon()
    daemon.serve()
    daemon.push(3, state=LoopState.RUNNING, time_s=time_s)
    try:
        yield daemon
    finally:
        daemon.end()


def test_a_pipe_gets_a_line_a_second_of_one_daemon_after_the_other(folder):  # noqa: F811
    with start("monitor", "mill", stdout=subprocess.PIPE, stderr=subprocess.PIPE) as monitor:
        with running(7.5) as daemon:
            assert monitor.stdout.readline().startswith("mill: running; 7.500 s; missed 0; late p99 ")
            daemon.push(1, state=LoopState.RUNNING, time_s=8.5)
            until(lambda: monitor.stdout.readline().startswith("mill: running; 8.500 s"), 20.0)
        until(lambda: monitor.stdout.readline() == "waiting for mill\n", 20.0)
        with running(1.25):
            assert monitor.stdout.readline().startswith("mill: running; 1.250 s")
            monitor.send_signal(signal.SIGINT)
            assert monitor.wait(20.0) == 0
        assert monitor.stderr.read() == ""


def test_the_terminal_is_as_before_after_ctrl_z_and_after_sigterm(folder):  # noqa: F811
    ours, theirs = pty.openpty()
    before = termios.tcgetattr(theirs)
    seen = bytearray()

    def shows(what):
        os.set_blocking(ours, False)
        with contextlib.suppress(BlockingIOError):
            seen.extend(os.read(ours, 1 << 16))
        return what in bytes(seen)

    with running(7.5), start("monitor", "mill", stdin=theirs, stdout=theirs, stderr=theirs) as monitor:
        until(lambda: shows(b"running"))
        assert termios.tcgetattr(theirs) != before
        monitor.send_signal(signal.SIGTSTP)
        state = Path(f"/proc/{monitor.pid}/stat")
        until(lambda: state.read_text().rpartition(")")[2].split()[0] == "T")
        assert shows(END)
        assert termios.tcgetattr(theirs) == before
        seen.clear()
        monitor.send_signal(signal.SIGCONT)
        until(lambda: shows(b"running"))
        assert seen.startswith(BEGIN)
        seen.clear()
        monitor.send_signal(signal.SIGTERM)
        assert monitor.wait(20.0) == 143
        assert shows(END)
        assert termios.tcgetattr(theirs) == before
    os.close(ours)
    os.close(theirs)
