"""Client of the control socket: one request, one answer. Nothing heavy is imported."""

import json
import os
import socket
from pathlib import Path
from typing import Any

from friction_hil.errors import FrictionHilError

_PATIENCE_S = 120.0  # a start takes as long as enable_timeout_s and a first motion allow


def ask(path: Path, request: dict[str, Any]) -> dict[str, Any]:
    """Return the answer of a daemon to a request.

    Raises
    ------
    FrictionHilError
        The socket may not be used, the daemon has gone, or it refuses the request; the message says why.
    """
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as connection:
        connection.settimeout(_PATIENCE_S)
        try:
            connection.connect(os.fspath(path))
            connection.sendall(json.dumps(request).encode() + b"\n")
            with connection.makefile("rb") as file:
                line = file.readline()
        except PermissionError:
            raise FrictionHilError(
                f"{path}: this user may not use the control socket; who runs the daemon can admit a group with "
                "run --group GROUP"
            ) from None
        except TimeoutError:
            raise FrictionHilError(f"{path}: no answer within {_PATIENCE_S:g} s") from None
        except OSError as error:
            raise FrictionHilError(f"{path}: {error.strerror}") from None
    if not line:
        raise FrictionHilError(f"{path}: the daemon has ended, or it restarts the process of its control socket")
    answer: dict[str, Any] = json.loads(line)
    if not answer["ok"]:
        raise FrictionHilError("\n".join(answer["problems"]))
    return answer
