"""A process beside the loop that is started again when it dies; the loop does not depend on it."""

import signal
import subprocess
from collections.abc import Sequence

from friction_hil.daemon.companion.job import MOST_SHORT_LIVES, Lives, signal_text
from friction_hil.daemon.spawner.client import Spawn

_END_S = 2.0
_WRONG_USE = 2  # exit status: another start would fail in the same way


class TendedProcess:
    """A process of this package, started again when it dies.

    ``module``: what it runs, as ``python -m`` takes it. ``title``: what reports call it. ``loss``: what reports say is
    missing when it is not started any more. ``descriptors``: that it inherits. ``stdout``: where its output goes, as
    Popen takes it. ``severity``: warning or notice, of the event that reports its death. ``process`` is the one that
    was started last.
    """

    def __init__(
        self,
        spawn: Spawn,
        module: str,
        words: Sequence[str],
        *,
        title: str,
        loss: str,
        descriptors: Sequence[int],
        stdout: int,
        severity: str,
    ) -> None:
        self._spawn = spawn
        self._command = ["-m", module, *words]
        self._title, self._loss, self.severity = title, loss, severity
        self._descriptors, self._stdout = descriptors, stdout
        self._lives = Lives()
        self._is_given_up = False
        self._launch()

    def _launch(self) -> None:
        self.process = self._spawn(self._command, self._descriptors, self._stdout)
        self._lives.begin()

    @property
    def is_given_up(self) -> bool:
        """True if it has died too often, and is not started any more."""
        return self._is_given_up

    def tend(self) -> list[str]:
        """Start the process again if it has died; return what is to be reported. It never waits."""
        if self._is_given_up or (status := self.process.poll()) is None:
            return []
        died = f"{self._title} died ({signal_text(-status) if status < 0 else f'exit status {status}'})"
        if self.process.stdin is not None:
            self.process.stdin.close()
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
        if self.process.stdin is not None:
            self.process.stdin.close()  # its signal to end
        try:
            self.process.wait(_END_S)
        except subprocess.TimeoutExpired:
            self.process.send_signal(signal.SIGKILL)
            self.process.wait()
