"""The processes beside the loop: what each runs, what it inherits, and how its death is reported.

Functions with a ``stack`` make memory, which the stack closes when the processes have ended.
"""

import contextlib
import os
import secrets
from dataclasses import asdict
from pathlib import Path

from friction_hil.config.live import LiveConfig
from friction_hil.daemon.control.job import ControlJob
from friction_hil.daemon.learning_board import LearningBoard
from friction_hil.daemon.shared_document import make_document
from friction_hil.daemon.supervisor import Beside

LEARNING = "the process that learns"
_TOKEN_BYTES = 24
_NICENESS = 5  # behind the companion, whose rows must not be lost
# a service protects the daemon from the kernel's search for memory; the server of live data is to go first
_OOM_SCORE = 500


def control_server(job: ControlJob, descriptors: list[int], stack: contextlib.ExitStack) -> Beside:
    """Return the process that serves the control socket.

    ``descriptors``: those of the socket, the ring, the journal, and of what learning says, or -1.
    """
    memory = make_document("control", asdict(job))
    stack.callback(os.close, memory)
    given = [*descriptors[:3], memory, *descriptors[3:]]
    return Beside(
        title="the process of the control socket",
        loss="nothing can be changed any more",
        words=["-m", "friction_hil.daemon.control", *map(str, given)],
        descriptors=[each for each in given if each >= 0],
        is_heir=True,
    )


def live_server(name: str, config: LiveConfig, stack: contextlib.ExitStack) -> Beside:
    """Return the process that serves live data and attaches to the daemon called ``name``."""
    words, token = ["-m", "friction_hil", "live", name, "--exit-with-stdin"], -1
    if config.foxglove is not None:
        words += ["--foxglove", str(config.foxglove)]
    if config.dashboard is not None:
        file = config.token_file
        if file is None:
            # in memory: the next process has the same token, so that open pages go on
            token = os.memfd_create("friction_hil-token")
            stack.callback(os.close, token)
            os.fchmod(token, 0o600)
            os.write(token, secrets.token_urlsafe(_TOKEN_BYTES).encode())
            file = Path(f"/proc/self/fd/{token}")
        words += ["--port", str(config.dashboard), "--host", config.host, "--token-file", str(file)]
    return Beside(
        title="the server of live data",
        loss="there are no live data any more",
        words=[*words, *(word for each in config.allow_hosts for word in ("--allow-host", each))],
        descriptors=[] if token < 0 else [token],
        severity="notice",
        niceness=_NICENESS,
        oom_score=_OOM_SCORE,
    )


def learning_process(socket: Path, board: LearningBoard, *, is_simulated: bool) -> Beside:
    """Return the process that learns; through the control socket it attaches and hands over."""
    pace = "simulated" if is_simulated else "real"
    return Beside(
        title=LEARNING,
        loss="nothing is learned any more",
        words=["-m", "friction_hil.learning.process", str(socket), str(board.descriptor), pace],
        descriptors=[board.descriptor],
        severity="notice",
        niceness=0 if is_simulated else _NICENESS,
    )
