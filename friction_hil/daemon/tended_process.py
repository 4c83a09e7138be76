"""A process beside the loop that is started again when it dies; the loop does not depend on it."""

import os
import signal
import subprocess
import sys
from collections.abc import Sequence

from friction_hil.daemon.companion.job import MOST_SHORT_LIVES, Lives, signal_text
from friction_hil.daemon.realtime import prompt_children

_END_S = 2.0
_WRONG_USE = 2  # exit status: another start would fail in the same way


class TendedProcess:
    """A process of this package, started again when it dies.

    Parameters
    ----------
    module : str
        What it runs, as ``python -m`` takes it.
    words : sequence of str
        Its command line.
    title : str
        What reports call it.
    loss : str
        What reports say is missing when it is not started any more.
    descriptors : sequence of int
        Descriptors that it inherits.
    stdout : int
        Where its output goes, as Popen takes it.
    severity : {"warning", "notice"}
        Of the event that reports its death.

    Attributes
    ----------
    pid : int
    severity : str
    """

    def __init__(
        self,
        module: str,
        words: Sequence[str],
        *,
        title: str,
        loss: str,
        descriptors: Sequence[int],
        stdout: int,
        severity: str,
    ) -> None:
        # -P: do not import modules from the current directory, which may be the user's
        self._command = [sys.executable, "-P", "-m", module, *words]
        self._title, self._loss, self.severity = title, loss, severity
        self._descriptors, self._stdout = descriptors, stdout
        self._lives = Lives()
        self._is_given_up = False
        self._launch()

    def _launch(self) -> None:
        with prompt_children():
            self._process = subprocess.Popen(
                self._command,
                stdin=subprocess.PIPE,
                stdout=self._stdout,
                pass_fds=self._descriptors,
                env=os.environ | {"OPENBLAS_NUM_THREADS": "1"},
                process_group=0,  # Ctrl-C is not meant for it
            )
        self._lives.begin()
        self.pid = self._process.pid

    @property
    def is_given_up(self) -> bool:
        """True if it has died too often, and is not started any more."""
        return self._is_given_up

    def tend(self) -> list[str]:
        """Start the process again if it has died; return what is to be reported. It never waits."""
        if self._is_given_up or (status := self._process.poll()) is None:
            return []
        died = f"{self._title} died ({signal_text(-status) if status < 0 else f'exit status {status}'})"
        if self._process.stdin is not None:
            self._process.stdin.close()
        self._is_given_up = self._lives.end() or status == _WRONG_USE
        if status == _WRONG_USE:
            return [f"{died}; what it printed says why: {self._loss}, the loop goes on"]
        if self._is_given_up:
            return [f"{died}, {MOST_SHORT_LIVES} times at once: {self._loss}, the loop goes on"]
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
