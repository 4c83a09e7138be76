"""Companion process: records the cycles of the loop and shows them live, without disturbing the loop.

The *control* process runs the loop and has a `friction_hil.daemon.companion.client.Companion`. The *companion*
(``python -m friction_hil.daemon.companion``) drains the shared-memory ring, writes the recording and the files of
faults, and prints the status line. `friction_hil.daemon.supervisor` starts it, and the next one when it dies; what the
former one had not released in the ring is still there.
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
    # imported on use: the supervisor, which uses this package too, needs no numpy
    if name in __all__:
        return getattr(importlib.import_module(f"friction_hil.daemon.companion.{_MODULES[name]}"), name)
    raise AttributeError(f"module 'friction_hil.daemon.companion' has no attribute {name!r}")
