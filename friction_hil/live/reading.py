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
    """Facts of a daemon that hold for its whole run.

    Attributes
    ----------
    name : str
        Name of the daemon.
    version : str
        Version of friction_hil that it runs.
    source : str
        Configuration file.
    configuration : dict
        At the start of the run, as `friction_hil.config.self_contained` returns it.
    period_s : float
        Period of the loop, s.
    ramp_s : float
        Time that the axes take to reach full speed, s.
    started_unix_ns : int
        Wall-clock time of ``time_s`` = 0, ns since 1970; 0 in simulated time (``--pace sync``).
    axes : tuple of str
    kinds : dict of {"rotary", "linear"}
        Kind of each axis.
    columns : tuple of str
        Columns of each axis, see `friction_hil.recordings.columns`; those of shadow models at the end.
    drives : dict of dict
        What the driver found of each drive, `friction_hil.drive.AxisFacts` as a dict.
    is_follower : bool
        Another controller enables and moves the drives.
    remedies : dict of str
        What to do about each code of a fault.
    """

    name: str
    version: str
    source: str
    configuration: Mapping[str, Any]
    period_s: float
    ramp_s: float
    started_unix_ns: int
    axes: tuple[str, ...]
    kinds: Mapping[str, AxisKind]
    columns: tuple[str, ...]
    drives: Mapping[str, Mapping[str, Any]]
    is_follower: bool
    remedies: Mapping[str, str]

    def unit(self, axis: str, column: str) -> str:
        """Return the unit of a column of an axis; empty if it has none."""
        return unit(column, self.kinds[axis])

    def remedy(self, message: str) -> str:
        """Return what to do about a message, by the code at its end; empty if it has no code or a foreign one."""
        return self.remedies.get(code_of(message), "")


@dataclass(frozen=True, slots=True, eq=False)
class AxisSettings:
    """Settings of an axis that are in force.

    Attributes
    ----------
    compensation : dict
        Section ``compensation`` of the configuration: enabled, gain, adaptation, ...
    model : dict
        Content of the model file.
    model_file : str or None
        Path of the model file; None if the model was given in the configuration.
    """

    compensation: Mapping[str, Any]
    model: Mapping[str, Any]
    model_file: str | None


@dataclass(frozen=True, slots=True, eq=False)
class Settings:
    """Settings of all axes after a change; ``change`` is its number, 0 for those of the start."""

    change: int
    axes: Mapping[str, AxisSettings]


@dataclass(frozen=True, slots=True)
class LiveEvent:
    """Event of a run.

    Attributes
    ----------
    cycle : float
    time_s : float
        Time of the cycle, s.
    name : str
        ``fault``, ``reset``, ``warning``, ``notice``, ``state``, ``change``, ``drive_state`` or ``error_without``.
    text : str
        Cut off after about 180 bytes.
    code, remedy : str
        Of a fault or warning that has a code; else empty.
    """

    cycle: float
    time_s: float
    name: str
    text: str
    code: str = ""
    remedy: str = ""


class Rows:
    """Rows of all axes.

    Parameters
    ----------
    facts : LiveFacts
    values : (n, axes, columns) array
    """

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
    """What has happened since the last reading.

    Attributes
    ----------
    rows : Rows
    lost : int
        Rows since the last reading that are not in ``rows``: it came too late for them.
    events : tuple of LiveEvent
    settings : Settings
        In force in the last row.
    stands : bool
        The loop has written no row for a second: what the last rows say of the drives may not hold any more.
    is_over : bool
        The daemon has ended, and this is the last reading.
    learning : dict of dict
        What is known of `compensation.learning`, by axis, as ``friction-hil run --json`` reports it; axes that learn
        nothing are missing.
    """

    rows: Rows
    lost: int
    events: tuple[LiveEvent, ...]
    settings: Settings
    stands: bool
    is_over: bool
    learning: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
