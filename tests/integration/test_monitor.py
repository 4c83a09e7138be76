"""The monitor as a process: on a terminal that is taken away and given back, and in a pipe."""

import contextlib
import os
import pty
import signal
import subprocess
import termios
import threading
from pathlib import Path

from friction_hil.daemon.safety import LoopState
from tests.integration.test_runtime_control import until
from tests.launcher import start
from tests.unit.live.test_live import Daemon, folder  # noqa: F401  a fixture

BEGIN, END = b"\x1b[?1049h", b"\x1b[?1049l"


@contextlib.contextmanager
def running(time_s):
    """A daemon whose loop goes on; the time of its rows stays what it is told."""
    daemon = Daemon()
    daemon.serve()
    daemon.time_s, ending = time_s, threading.Event()

    def work():
        while not ending.wait(0.02):
            daemon.push(1, state=LoopState.RUNNING, time_s=daemon.time_s)

    thread = threading.Thread(target=work)
    thread.start()
    try:
        yield daemon
    finally:
        ending.set()
        thread.join()
        daemon.end()


@contextlib.contextmanager
def watched(**streams):
    """The monitor of that daemon; it ends with the test in any case."""
    with start("monitor", "mill", **streams) as monitor:
        try:
            yield monitor
        finally:
            monitor.kill()


def test_a_pipe_gets_a_line_a_second_of_one_daemon_after_the_other(folder):  # noqa: F811
    with watched(stdout=subprocess.PIPE, stderr=subprocess.PIPE) as monitor:
        with running(7.5) as daemon:
            until(lambda: monitor.stdout.readline().startswith("mill: running; 7.500 s; missed 0; late p99 "))
            daemon.time_s = 8.5
            until(lambda: monitor.stdout.readline().startswith("mill: running; 8.500 s"))
        until(lambda: monitor.stdout.readline() == "waiting for mill\n")
        with running(1.25):
            until(lambda: monitor.stdout.readline().startswith("mill: running; 1.250 s"))
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

    with running(7.5), watched(stdin=theirs, stdout=theirs, stderr=theirs) as monitor:
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
