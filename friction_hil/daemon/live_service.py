"""Control process's side of the server of live data: starts it, and looks after it. The loop does not depend on it."""

import os
import secrets
import signal
import subprocess
import sys
from collections.abc import Sequence

from friction_hil.config.live import LiveConfig
from friction_hil.daemon.companion.job import MOST_SHORT_LIVES, Lives, signal_text
from friction_hil.daemon.realtime import prompt_children

_END_S = 2.0
_TOKEN_BYTES = 24
_WRONG_USE = 2  # exit status: another start would fail in the same way


class LiveService:
    """The process that serves live data, started again when it dies.

    Parameters
    ----------
    name : str
        Name of this daemon, to which the process attaches.
    config : LiveConfig

    Attributes
    ----------
    pid : int
    severity : str
        Of the event that reports its death.
    """

    severity = "notice"  # nothing depends on it

    def __init__(self, name: str, config: LiveConfig) -> None:
        self._token = -1
        if config.dashboard is not None and config.token_file is None:
            # in memory: the next process has the same token, so that open pages go on
            self._token = os.memfd_create("friction_hil-token")
            os.fchmod(self._token, 0o600)
            os.write(self._token, secrets.token_urlsafe(_TOKEN_BYTES).encode())
        self._arguments = _arguments(name, config, self._token)
        self._lives = Lives()
        self._is_given_up = False
        self._launch()

    def _launch(self) -> None:
        # -P: do not import modules from the current directory, which may be the user's
        command = [sys.executable, "-P", "-m", "friction_hil.daemon.live_process", *self._arguments]
        with prompt_children():
            self._process = subprocess.Popen(
                command,
                stdin=subprocess.PIPE,
                stdout=2,  # what it prints is no output of the run
                pass_fds=() if self._token < 0 else (self._token,),
                process_group=0,  # Ctrl-C is not meant for it
            )
        self._lives.begin()
        self.pid = self._process.pid

    def tend(self) -> list[str]:
        """Start the process again if it has died; return what is to be reported. It never waits."""
        if self._is_given_up or (status := self._process.poll()) is None:
            return []
        died = f"the server of live data died ({signal_text(-status) if status < 0 else f'exit status {status}'})"
        if self._process.stdin is not None:
            self._process.stdin.close()
        self._is_given_up = self._lives.end() or status == _WRONG_USE
        if status == _WRONG_USE:
            return [f"{died}; what it printed says why, and the run goes on without it"]
        if self._is_given_up:
            return [f"{died}, {MOST_SHORT_LIVES} times at once: there are no live data any more, the loop goes on"]
        try:
            self._launch()
        except OSError as error:
            self._is_given_up = True
            return [f"{died}, and another one cannot be started ({error.strerror}): the loop goes on"]
        return [f"{died}; the next one takes over, and the loop goes on"]

    def close(self) -> None:
        """End the process."""
        if self._process.stdin is not None:
            self._process.stdin.close()  # its signal to end
        try:
            self._process.wait(_END_S)
        except subprocess.TimeoutExpired:
            self._process.send_signal(signal.SIGKILL)
            self._process.wait()
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
