"""Control process's side of the control socket: makes it, and looks after the process that serves it."""

import os
import subprocess
from dataclasses import asdict, dataclass

from friction_hil.daemon.control.job import ControlJob
from friction_hil.daemon.control.lock import ControlSocket
from friction_hil.daemon.control.mailbox import MailboxReader
from friction_hil.daemon.control.packed import room
from friction_hil.daemon.shared_document import make_document
from friction_hil.daemon.spawner.client import Spawn
from friction_hil.daemon.tended_process import TendedProcess


@dataclass(frozen=True, slots=True)
class Memories:
    """Descriptors of the memories that the process reads."""

    ring: int  # rows and events, which it only reads
    journal: int  # changes
    learning: int | None = None  # what the process that learns says; None without one


class ControlService(TendedProcess):
    """The process that serves the control socket."""

    def __init__(
        self,
        spawn: Spawn,
        control_socket: ControlSocket,
        memories: Memories,
        job: ControlJob,
    ) -> None:
        self.mailbox = MailboxReader(room(len(job.facts)))  # brings the changes to the loop
        self._job = make_document("control", asdict(job))
        descriptors = [
            control_socket.descriptor,
            memories.ring,
            self.mailbox.descriptor,
            memories.journal,
            self._job,
            *(() if memories.learning is None else (memories.learning,)),
        ]
        super().__init__(
            spawn,
            "friction_hil.daemon.control",
            [str(each) for each in descriptors],
            title="the process of the control socket",
            loss="nothing can be changed any more",
            descriptors=descriptors,
            stdout=subprocess.DEVNULL,
            severity="warning",
        )

    def close(self) -> None:
        """End the process."""
        super().close()
        os.close(self._job)
