"""Token of the page's server: random, or kept in a file that nobody else can read."""

import os
import re
import secrets
import stat
from pathlib import Path

from friction_hil.errors import UsageError

_BYTES = 24
_FORM = re.compile(r"[\x21-\x7e]{16,512}")
_MOST = 4096


def new_token() -> str:
    """Return a random token."""
    return secrets.token_urlsafe(_BYTES)


def token_of(path: Path) -> str:
    """Return the token in a file; a file that is not there is made, with a random token and mode 600.

    Raises `UsageError`: the file cannot be read or made, others can read or change it, or what it holds is no token.
    """
    try:
        return _read(path)
    except FileNotFoundError:
        pass
    except OSError as error:
        raise UsageError(f"--token-file {path}: {error.strerror}") from None
    token = new_token()
    try:
        descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600)
    except OSError as error:
        raise UsageError(f"--token-file {path}: {error.strerror}") from None
    with os.fdopen(descriptor, "w", encoding="ascii") as file:
        file.write(f"{token}\n")
    return token


def _read(path: Path) -> str:
    with open(path, "rb") as file:
        about = os.fstat(file.fileno())
        if os.name == "posix" and stat.S_IMODE(about.st_mode) & 0o077:
            mode = stat.S_IMODE(about.st_mode)
            raise UsageError(f"--token-file {path}: others may use it (mode {mode:o}); chmod 600 {path}")
        text = file.read(_MOST).decode("latin-1").strip()
    if not _FORM.fullmatch(text):
        raise UsageError(f"--token-file {path}: must hold 16 to 512 characters without spaces, in ASCII")
    return text
