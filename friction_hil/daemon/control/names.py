"""Names of daemons, and where their control sockets are. Nothing heavy is imported: a command looks here first."""

import os
import re
import socket
import tempfile
from collections.abc import Iterator
from pathlib import Path

from friction_hil.errors import UsageError, choices

_FOLDER = "friction-hil"
_SYSTEM_FOLDER = Path("/run") / _FOLDER
_SUFFIX = ".sock"
_LONGEST_PATH = 107  # bytes: sun_path has 108 with the zero at its end, unix(7)
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]*")


def default_name(config: Path) -> str:
    """Return the name of the daemon of a configuration file: its stem, with ``-`` for what no name can have."""
    return re.sub(r"[^A-Za-z0-9_.-]+", "-", config.stem).lstrip("-._") or "daemon"


def is_name(name: str) -> bool:
    """Return True if a daemon may be called ``name``, which is then safe as a part of a path and of a command."""
    return _NAME.fullmatch(name) is not None


def own_folder() -> Path:
    """Return the folder for the sockets of this user's daemons.

    It is the folder that systemd has made for a service (``RUNTIME_DIRECTORY``), else ``friction-hil`` under
    ``XDG_RUNTIME_DIR``; without either, ``/run/friction-hil`` for root and a folder in that of temporary files for
    others.
    """
    if given := os.environ.get("RUNTIME_DIRECTORY", "").partition(":")[0]:
        return Path(given)
    if given := os.environ.get("XDG_RUNTIME_DIR", ""):
        return Path(given) / _FOLDER
    if os.geteuid() == 0:
        return _SYSTEM_FOLDER
    return Path(tempfile.gettempdir()) / f"{_FOLDER}-{os.geteuid()}"


def socket_path(name: str) -> Path:
    """Return the path of the socket of a daemon of this user.

    Raises `UsageError`: the name cannot be one, or the path is longer than that of a socket can be.
    """
    if not is_name(name):
        raise UsageError(
            f"--name {name!r} is no name of a daemon: use letters, digits, '.', '_' and '-', beginning with a letter "
            "or digit"
        )
    path = own_folder() / f"{name}{_SUFFIX}"
    too_long = len(os.fsencode(path)) - _LONGEST_PATH
    if too_long > 0:
        raise UsageError(
            f"the path of the control socket, {path}, is {too_long} bytes longer than the {_LONGEST_PATH} bytes that "
            "the system allows: take a shorter --name, or a shorter path in XDG_RUNTIME_DIR"
        )
    return path


def running() -> Iterator[tuple[str, Path]]:
    """Yield name and socket of each daemon that runs here: this user's, and those of the system's services."""
    for folder in dict.fromkeys((own_folder(), _SYSTEM_FOLDER)):
        try:
            paths = sorted(folder.glob(f"*{_SUFFIX}"))
        except OSError:
            continue
        for path in paths:
            if is_live(path):
                yield path.stem, path


def candidates(name: str) -> list[Path]:
    """Return where the socket of a daemon called ``name`` can be: this user's, or that of a service of the system."""
    return [folder / f"{name}{_SUFFIX}" for folder in dict.fromkeys((own_folder(), _SYSTEM_FOLDER))]


def is_live(path: Path) -> bool:
    """Return True if somebody listens on this socket; one that only others may use counts too."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as asking:
        asking.setblocking(False)
        try:
            asking.connect(os.fspath(path))
        except (PermissionError, BlockingIOError):  # not for this user; or many have asked a daemon that is starting
            return True
        except OSError:
            return False
    return True


def find(name: str) -> Path:
    """Return the socket of the daemon called ``name``.

    Raises `UsageError`: none of this name runs; the message lists those that do.
    """
    daemons = dict(running())
    if name in daemons:
        return daemons[name]
    raise UsageError(f"no daemon called {name!r} runs here; {choices(name, daemons)}")
