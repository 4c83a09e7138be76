"""What watches a daemon while its loop is measured: its own commands, as far as this version has them."""

import contextlib
import os
import pty
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path

from friction_hil.daemon.control.ask import ask
from friction_hil.errors import FrictionHilError
from tools.benchmarks.loop.daemon import NAME
from tools.benchmarks.processes import PROGRAM
from tools.benchmarks.report import note

VIEWERS = 5
_START_S = 20.0
_ASK_S = 0.1


@contextlib.contextmanager
def watching(control: Path, pollers: int) -> Iterator[None]:
    """Attach to the daemon at this control socket: monitor, page with viewers, Foxglove, and processes that ask.

    Parameters
    ----------
    control : Path
    pollers : int
        Processes that ask for the status ten times a second.
    """
    environment = os.environ | {"XDG_RUNTIME_DIR": str(control.parent.parent)}
    with contextlib.ExitStack() as stack:
        for _ in range(pollers):
            words = [sys.executable, "-m", "tools.benchmarks.loop.observers", str(control)]
            _start(stack, words, environment)
        if _has("monitor"):
            screen, terminal = pty.openpty()
            stack.callback(os.close, terminal)
            stack.callback(os.close, screen)
            _drain(screen)
            _start(stack, [*PROGRAM, "monitor", NAME], environment, terminal)
        if _has("live"):
            page, foxglove = _free_port(), _free_port()
            _start(stack, [*PROGRAM, "live", NAME, "--port", str(page), "--foxglove", str(foxglove)], environment)
            _await_port(page)
            for _ in range(VIEWERS):
                _start(stack, [sys.executable, "-m", "tools.benchmarks.loop.observers", str(page)], environment)
        yield


def _has(name: str) -> bool:
    """Return True if this version has the command; say so if it has not."""
    done = subprocess.run([*PROGRAM, name, "--help"], capture_output=True)
    if done.returncode:
        note(f"friction-hil {name} is not there: the loop is measured without it")
    return done.returncode == 0


def _start(stack: contextlib.ExitStack, words: list[str], environment: dict[str, str], terminal: int = -3) -> None:
    process = subprocess.Popen(words, stdin=terminal, stdout=terminal, stderr=terminal, env=environment)
    stack.callback(process.wait)
    stack.callback(process.terminate)


def _drain(screen: int) -> None:
    """Read what a terminal shows, so that nobody waits for it."""

    def read() -> None:
        with contextlib.suppress(OSError):
            while os.read(screen, 65536):
                pass

    threading.Thread(target=read, daemon=True).start()


def _free_port() -> int:
    with socket.socket() as one:
        one.bind(("127.0.0.1", 0))
        port: int = one.getsockname()[1]
    return port


def _await_port(port: int) -> None:
    end_s = time.monotonic() + _START_S
    while time.monotonic() < end_s:
        with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", port), 1.0):
            return
        time.sleep(_ASK_S)
    raise FrictionHilError(f"friction-hil live does not listen at port {port}")


def _view(port: int) -> None:
    """Read the stream of the page as a browser does."""
    with socket.create_connection(("127.0.0.1", port)) as connection:
        request = f"GET /api/stream HTTP/1.1\r\nHost: 127.0.0.1:{port}\r\nAccept: text/event-stream\r\n\r\n"
        connection.sendall(request.encode())
        while connection.recv(65536):
            pass


def _poll(path: Path) -> None:
    """Ask for the status, over and over."""
    with contextlib.suppress(FrictionHilError):
        while ask(path, {"do": "status"}):
            time.sleep(_ASK_S)


if __name__ == "__main__":
    (_, given) = sys.argv
    with contextlib.suppress(KeyboardInterrupt):
        if given.isdigit():
            _view(int(given))
        else:
            _poll(Path(given))
