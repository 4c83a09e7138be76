"""What is known of a running daemon: facts that do not change, settings that do, and the rows since the last look."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from friction_hil.drive.codes import code_of
from friction_hil.numerics.jit import Array
from friction_hil.recordings.columns import AxisKind, unit


@dataclass(frozen=True, slots=True, eq=False)
class LiveFacts:
    """Facts of a daemon that hold for its whole run."""

    name: str  # of the daemon
    version: str  # of friction_hil that it runs
    source: str  # configuration file
    configuration: Mapping[str, Any]  # at the start of the run, as `friction_hil.config.self_contained` returns it
    period_s: float  # of the loop, s
    ramp_s: float  # time that the axes take to reach full speed, s
    started_unix_ns: int  # wall-clock time of ``time_s`` = 0, ns since 1970; 0 in simulated time (``--pace sync``)
    axes: tuple[str, ...]
    kinds: Mapping[str, AxisKind]
    columns: tuple[str, ...]  # of each axis, see `friction_hil.recordings.columns`; those of shadow models at the end
    # what the driver found of each drive, `friction_hil.drive.AxisFacts` as a dict
    drives: Mapping[str, Mapping[str, Any]]
    is_follower: bool  # another controller enables and moves the drives
    remedies: Mapping[str, str]  # what to do about each code of a fault

    def unit(self, axis: str, column: str) -> str:
        """Return the unit of a column of an axis; empty if it has none."""
        return unit(column, self.kinds[axis])

    def remedy(self, message: str) -> str:
        """Return what to do about a message, by the code at its end; empty if it has no code or a foreign one."""
        return self.remedies.get(code_of(message), "")


@dataclass(frozen=True, slots=True, eq=False)
class AxisSettings:
    """Settings of an axis that are in force."""

    compensation: Mapping[str, Any]  # section ``compensation`` of the configuration: enabled, gain, adaptation, ...
    model: Mapping[str, Any]  # content of the model file
    model_file: str | None  # its path; None if the model was given in the configuration


@dataclass(frozen=True, slots=True, eq=False)
class Settings:
    """Settings of all axes after a change; ``change`` is its number, 0 for those of the start."""

    change: int
    axes: Mapping[str, AxisSettings]


@dataclass(frozen=True, slots=True)
class LiveEvent:
    """Event of a run."""

    cycle: float
    time_s: float  # of the cycle, s
    # ``fault``, ``reset``, ``warning``, ``notice``, ``state``, ``change``, ``drive_state`` or ``error_without``
    name: str
    text: str  # cut off after about 180 bytes
    code: str = ""  # of a fault or warning that has one, as its remedy; else empty
    remedy: str = ""


class Rows:
    """Rows of all axes; values (n, axes, columns)."""

    __slots__ = ("_axes", "_columns", "values")

    def __init__(self, facts: LiveFacts, values: Array) -> None:
        self._axes, self._columns, self.values = facts.axes, facts.columns, values

    def __len__(self) -> int:
        return len(self.values)

    def of(self, axis: str, column: str) -> Array:
        """Return a column of an axis, (n,), SI; NaN where nothing was measured, and where there is no such column."""
        if column not in self._columns:
            return np.full(len(self.values), np.nan)
        column_values: Array = self.values[:, self._axes.index(axis), self._columns.index(column)]
        return column_values

    def columns(self, axis: str) -> dict[str, Array]:
        """Return all columns of an axis by name, each (n,)."""
        part = self.values[:, self._axes.index(axis)]
        return {name: part[:, k] for k, name in enumerate(self._columns)}


@dataclass(frozen=True, slots=True, eq=False)
class Reading:
    """What has happened since the last reading."""

    rows: Rows
    lost: int  # rows since the last reading that are not in ``rows``: it came too late for them
    events: tuple[LiveEvent, ...]
    settings: Settings  # in force in the last row
    stands: bool  # the loop has written no row for a second: what the last rows say of the drives may not hold any more
    is_over: bool  # the daemon has ended, and this is the last reading
    # what is known of `compensation.learning`, by axis, as ``friction-hil run --json`` reports it; axes that learn
    # nothing are missing
    learning: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
