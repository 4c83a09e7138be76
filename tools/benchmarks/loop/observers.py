"""What watches a daemon while its loop is measured: its own commands, as far as this version has them."""

import contextlib
import json
import os
import pty
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from friction_hil.errors import FrictionHilError
from tools.benchmarks.loop.daemon import NAME
from tools.benchmarks.processes import PROGRAM
from tools.benchmarks.report import note

_START_S = 60.0
_ASK_S = 0.1
_FOXGLOVE: Any = "foxglove.sdk.v1"  # name of its protocol


@contextlib.contextmanager
def watching(control: Path, viewers: int) -> Iterator[None]:
    """Attach to the daemon at this control socket: monitor, page with viewers, and a client of its Foxglove WebSocket.

    Parameters
    ----------
    control : Path
    viewers : int
        Viewers of the page.

    Raises
    ------
    FrictionHilError
        One of them ended before it was to: what was measured then says nothing about it.
    """
    environment = os.environ | {"XDG_RUNTIME_DIR": str(control.parent.parent)}
    attached: dict[str, subprocess.Popen[bytes]] = {}
    with contextlib.ExitStack() as stack:
        if _has("monitor"):
            screen, terminal = pty.openpty()
            stack.callback(os.close, terminal)
            stack.callback(os.close, screen)
            _drain(screen)
            attached["monitor"] = _start(stack, [*PROGRAM, "monitor", NAME], environment, terminal)
        if _has("live"):
            page, foxglove = _free_port(), _free_port()
            words = [*PROGRAM, "live", NAME, "--port", str(page), "--foxglove", str(foxglove)]
            attached["live"] = _start(stack, words, environment)
            for kind, port, count in (("page", page, viewers), ("foxglove", foxglove, 1)):
                _await_port(port)
                for k in range(count):
                    words = [sys.executable, "-m", "tools.benchmarks.loop.observers", kind, str(port)]
                    attached[f"{kind} {k + 1}"] = _start(stack, words, environment)
        yield
        if ended := [name for name, process in attached.items() if process.poll() is not None]:
            raise FrictionHilError(f"these observers ended early: {', '.join(ended)}")


def _has(name: str) -> bool:
    """Return True if this version has the command; say so if it has not."""
    done = subprocess.run([*PROGRAM, name, "--help"], capture_output=True)
    if done.returncode:
        note(f"friction-hil {name} is not there: the loop is measured without it")
    return done.returncode == 0


def _start(
    stack: contextlib.ExitStack, words: list[str], environment: dict[str, str], terminal: int = subprocess.DEVNULL
) -> subprocess.Popen[bytes]:
    process = subprocess.Popen(words, stdin=terminal, stdout=terminal, stderr=terminal, env=environment)
    stack.callback(process.wait)
    stack.callback(process.terminate)
    return process


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


def _subscribe(port: int) -> None:
    """Read all channels of the Foxglove WebSocket, as Foxglove does where all of them are shown."""
    from websockets.sync.client import connect  # imported here: extra dev

    with connect(f"ws://127.0.0.1:{port}", subprotocols=[_FOXGLOVE], max_size=1 << 24) as client:
        for content in client:
            if isinstance(content, str) and (channels := json.loads(content).get("channels")):
                wanted = [{"id": each["id"], "channelId": each["id"]} for each in channels]
                client.send(json.dumps({"op": "subscribe", "subscriptions": wanted}))


if __name__ == "__main__":
    _, _kind, _port = sys.argv
    with contextlib.suppress(KeyboardInterrupt):
        {"page": _view, "foxglove": _subscribe}[_kind](int(_port))
