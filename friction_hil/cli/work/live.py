"""The work of ``friction-hil live``."""

import os
import threading
from collections.abc import Sequence
from importlib.util import find_spec
from pathlib import Path

from friction_hil.cli.work.tables import say
from friction_hil.config.live import HOST
from friction_hil.daemon.control.names import socket_path
from friction_hil.errors import UsageError

_DESCRIPTORS = Path("/proc/self/fd")  # a token that 'run' made: there is no file in which its user could find it
_NEEDED = {
    "the page": ("dashboard", ("starlette", "uvicorn", "prometheus_client")),
    "the Foxglove WebSocket": ("live", ("foxglove",)),
}


def live(
    *,
    name: str,
    port: int | None,
    foxglove: int | None,
    host: str,
    allow_hosts: Sequence[str],
    token_file: Path | None,
    exit_with_stdin: bool,
) -> int:
    """Serve until a signal comes, or standard input is closed."""
    socket_path(name)  # a wrong name is reported at once
    if port is not None:
        _require("the page")
    elif host != HOST or token_file is not None:
        raise UsageError("--host and --token-file are for the page: give --port too")
    if foxglove is not None:
        _require("the Foxglove WebSocket")
    from friction_hil.live.web.serve import Serving, serve  # imported here: the extras may be missing
    from friction_hil.live.web.token import new_token, token_of

    token = new_token() if token_file is None else token_of(token_file)
    is_named = token_file is not None and token_file.parent != _DESCRIPTORS
    serving = Serving(name, port, foxglove, host, tuple(allow_hosts), token, token_file if is_named else None)
    ending = threading.Event()
    if exit_with_stdin:
        threading.Thread(target=_await_end, args=(ending,), daemon=True).start()
    serve(serving, ending, lambda line: say(line, stderr=False))
    return 0


def _require(what: str) -> None:
    extra, modules = _NEEDED[what]
    missing = [each for each in modules if find_spec(each) is None]
    if missing:
        raise UsageError(f"{what} needs {' and '.join(missing)}: pip install 'friction-hil[{extra}]'")


def _await_end(ending: threading.Event) -> None:
    """Read standard input to its end."""
    while os.read(0, 4096):
        pass
    ending.set()
