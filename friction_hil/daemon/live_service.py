"""Control process's side of the server of live data: starts it, and looks after it."""

import os
import secrets
from collections.abc import Sequence

from friction_hil.config.live import LiveConfig
from friction_hil.daemon.spawner.client import Spawn
from friction_hil.daemon.tended_process import TendedProcess

_TOKEN_BYTES = 24
_STDERR = 2


class LiveService(TendedProcess):
    """The process that serves live data and attaches to the daemon called ``name``; nothing depends on it."""

    def __init__(self, spawn: Spawn, name: str, config: LiveConfig) -> None:
        self._token = -1
        if config.dashboard is not None and config.token_file is None:
            # in memory: the next process has the same token, so that open pages go on
            self._token = os.memfd_create("friction_hil-token")
            os.fchmod(self._token, 0o600)
            os.write(self._token, secrets.token_urlsafe(_TOKEN_BYTES).encode())
        super().__init__(
            spawn,
            "friction_hil.daemon.live_process",
            _arguments(name, config, self._token),
            title="the server of live data",
            loss="there are no live data any more",
            descriptors=() if self._token < 0 else (self._token,),
            stdout=_STDERR,  # what it prints is no output of the run
            severity="notice",
        )

    def close(self) -> None:
        """End the process."""
        super().close()
        if self._token >= 0:
            os.close(self._token)


def _arguments(name: str, config: LiveConfig, token: int) -> Sequence[str]:
    """Return the command line of ``friction-hil live``."""
    words = ["live", name, "--exit-with-stdin"]
    if config.foxglove is not None:
        words += ["--foxglove", str(config.foxglove)]
    if config.dashboard is not None:
        file = f"/proc/self/fd/{token}" if config.token_file is None else str(config.token_file)
        words += ["--port", str(config.dashboard), "--host", config.host, "--token-file", file]
    words += [word for each in config.allow_hosts for word in ("--allow-host", each)]
    return words
