"""Companion process: records the cycles of the loop and shows them live, without disturbing the loop.

There are three processes. The *control* process runs the loop and has a
`friction_hil.daemon.companion.client.Companion`. It starts the *supervisor*
(``python -m friction_hil.daemon.companion``), which forks a *worker*, and another one when it dies. The worker
drains the shared-memory ring, writes the recording and the files of faults, and prints the status line.

The supervisor inherits the job in memory without a name. Its standard input is a pipe that stays open: its end means
that the control process is gone. Its standard output carries lines of JSON back (`friction_hil.daemon.companion.job`).
Supervisor and worker ignore the signals of a terminal: the control process decides when a run is over. If both die, the
control process starts another pair; what they had not released in the ring is still there.
"""

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from friction_hil.daemon.companion.client import Companion, CompanionReport
    from friction_hil.daemon.companion.job import Job
    from friction_hil.daemon.companion.paths import free_path, prepare, state_folder

_MODULES = {"Companion": "client", "CompanionReport": "client", "Job": "job"} | dict.fromkeys(
    ("free_path", "prepare", "state_folder"), "paths"
)
__all__ = ["Companion", "CompanionReport", "Job", "free_path", "prepare", "state_folder"]


def __getattr__(name: str) -> Any:
    # imported on use: the supervisor, which is in this package too, needs no numpy
    if name in __all__:
        return getattr(importlib.import_module(f"friction_hil.daemon.companion.{_MODULES[name]}"), name)
    raise AttributeError(f"module 'friction_hil.daemon.companion' has no attribute {name!r}")
