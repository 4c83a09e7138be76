"""The beginning of every file that the companion writes."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from friction_hil.daemon.companion.job import Job
from friction_hil.recordings.mcap_format import SERIES
from friction_hil.recordings.mcap_writer import McapWriter


def begin_file(
    path: Path,
    job: Job,
    *,
    about: Mapping[str, Any],
    overwrite: bool = False,
    on_flush: Callable[[], None] = lambda: None,
) -> McapWriter:
    """Create a file for the rows of ``job``, safe on the disk chunk by chunk.

    Raises `OSError` or `RecordingError`: it cannot be written.
    """
    return McapWriter(
        path,
        job.axes,
        job.columns,
        state_width=job.state_width,
        started_unix_ns=job.started_unix_ns,
        metadata=job.metadata,
        about=about if job.series is None else {**about, SERIES: job.series},
        overwrite=overwrite,
        is_durable=True,
        has_joint_states=job.has_joint_states,
        on_flush=on_flush,
    )
