"""Configuration of the recording by ``run``."""

from collections.abc import Iterator
from pathlib import Path
from typing import Self

from pydantic import model_validator

from friction_hil.checked_yaml.messages import Mistake, refuse
from friction_hil.checked_yaml.section import Section, key

_MOST_S = 604_800.0  # a week
_MOST_MB = 1e9
_FILES_IN_BUDGET = 10  # at least, unless rotate_mb says otherwise
_FEWEST_FILES_IN_BUDGET = 2


class RecordingConfig(Section):
    """Recording by ``run``, and its files of faults."""

    path: Path | None = key(
        "MCAP file, relative to the directory in which 'run' starts; '--record' overrides it; without one only faults "
        "are recorded, each with the minute before it",
        default=None,
    )
    rotate_s: float | None = key(
        "duration of a file, after which the recording goes on in the next one, NAME-2.mcap; null: no limit",
        "s",
        default=3600.0,
        ge=1,
        le=_MOST_S,
    )
    rotate_mb: float | None = key(
        "size of a file, at which the recording goes on in the next one; null: no limit, or a tenth of budget_mb",
        "MB",
        default=None,
        ge=1,
        le=_MOST_MB,
    )
    budget_mb: float | None = key(
        "disk space of this daemon's recordings that were started with this path; beyond, the oldest files are "
        "removed, but none of a fault; null: no limit",
        "MB",
        default=None,
        ge=10,
        le=_MOST_MB,
    )
    black_box: Path | None = key(
        "folder of the files of faults; null: beside the recording, or without one $XDG_STATE_HOME/friction-hil "
        "(~/.local/state/friction-hil)",
        default=None,
    )
    ros: bool = key(
        "write each row also as sensor_msgs/msg/JointState of all axes on /joint_states, for tools of ROS 2",
        default=False,
    )

    @model_validator(mode="after")
    def _check(self) -> Self:
        refuse(self, _mistakes(self))
        return self

    @property
    def rotate_bytes(self) -> int | None:
        """Largest size of a file; None without a limit."""
        if self.rotate_mb is None:
            return None if self.budget_mb is None else round(self.budget_mb * 1e6 / _FILES_IN_BUDGET)
        return round(self.rotate_mb * 1e6)

    @property
    def budget_bytes(self) -> int | None:
        """Disk space of all files; None without a limit."""
        return None if self.budget_mb is None else round(self.budget_mb * 1e6)


def _mistakes(recording: RecordingConfig) -> Iterator[Mistake]:
    if recording.budget_mb is None:
        return
    most = recording.budget_mb / _FEWEST_FILES_IN_BUDGET
    if recording.rotate_mb is not None and recording.rotate_mb > most:
        text = f"must be at most half of budget_mb, {most:g}, so that an old file can go while the next one grows"
        yield ("rotate_mb",), f"{text}; it is {recording.rotate_mb:g}"
