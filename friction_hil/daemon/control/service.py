"""Control process's side of the control socket: makes it, and looks after the process that serves it."""

import json
import os
import signal
import subprocess
import sys
from dataclasses import asdict

from friction_hil.daemon.companion.job import MOST_SHORT_LIVES, Lives, signal_text
from friction_hil.daemon.control.job import ControlJob
from friction_hil.daemon.control.lock import ControlSocket
from friction_hil.daemon.control.mailbox import MailboxReader
from friction_hil.daemon.control.packed import room
from friction_hil.daemon.realtime import prompt_children

_END_S = 2.0


class ControlService:
    """The process that serves the control socket, started again when it dies; the loop does not depend on it.

    Parameters
    ----------
    control_socket : ControlSocket
    ring_descriptor : int
        Memory of the rows, which the process only reads.
    journal_descriptor : int
    job : ControlJob

    Attributes
    ----------
    mailbox : MailboxReader
        Brings the changes to the loop.
    pid : int
    severity : str
        Of the event that reports its death.
    """

    severity = "warning"

    def __init__(
        self, control_socket: ControlSocket, ring_descriptor: int, journal_descriptor: int, job: ControlJob
    ) -> None:
        self.mailbox = MailboxReader(room(len(job.facts)))
        self._job = os.memfd_create("friction_hil-control")
        with os.fdopen(os.dup(self._job), "wb") as file:
            file.write(json.dumps(asdict(job)).encode())
        self._descriptors = [
            control_socket.descriptor,
            ring_descriptor,
            self.mailbox.descriptor,
            journal_descriptor,
            self._job,
        ]
        self._lives = Lives()
        self._is_given_up = False
        self._launch()

    def _launch(self) -> None:
        # -P: do not import modules from the current directory, which may be the user's
        command = [sys.executable, "-P", "-m", "friction_hil.daemon.control", *map(str, self._descriptors)]
        with prompt_children():
            self._process = subprocess.Popen(
                command,
                stdin=subprocess.PIPE,
                stdout=subprocess.DEVNULL,
                pass_fds=self._descriptors,
                env=os.environ | {"OPENBLAS_NUM_THREADS": "1"},
                process_group=0,  # Ctrl-C is not meant for it
            )
        self._lives.begin()
        self.pid = self._process.pid

    def tend(self) -> list[str]:
        """Start the process again if it has died; return what is to be reported. It never waits."""
        if self._is_given_up or (status := self._process.poll()) is None:
            return []
        how = signal_text(-status) if status < 0 else f"exit status {status}"
        died = f"the process of the control socket died ({how})"
        if self._process.stdin is not None:
            self._process.stdin.close()
        self._is_given_up = self._lives.end()
        if self._is_given_up:
            return [f"{died}, {MOST_SHORT_LIVES} times at once: nothing can be changed any more, the loop goes on"]
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
        os.close(self._job)
