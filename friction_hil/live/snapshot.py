"""Figures of a daemon at a moment, as monitor, dashboard and metrics show them."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from friction_hil.daemon.figures import ErrorFigures
from friction_hil.live.friction_map import FrictionMap
from friction_hil.live.lateness import Lateness


@dataclass(frozen=True, slots=True)
class Message:
    """Fault, warning or notice; ``code`` and ``remedy`` are empty where it has none."""

    text: str
    code: str
    remedy: str


@dataclass(frozen=True, slots=True, eq=False)
class AxisSnapshot:
    """Figures of one axis; NaN for what is not known. Positions in rad or m, torques in N m or N."""

    kind: str  # rotary or linear
    unit: str  # of the position; that of the velocity is per second
    torque_unit: str
    drive_state: str  # as read back in the last cycle: ``operation enabled``; ``unknown`` if it was not
    is_powered: bool | None  # the drive may produce torque; None if its state is unknown
    position: float  # this and all up to the command in the last row; NaN while the loop stands, and when it is over
    velocity: float
    torque: float
    position_demand: float
    velocity_demand: float
    compensation: float
    command: float
    temperature: float  # that the friction model was given, or that was measured, °C
    error: float  # following error in the last row, demanded less measured position
    # following error over the window without compensation; None where there was no steady motion; once a time without
    # compensation has ended, of all of it, as the daemon has found it
    without: ErrorFigures | None
    compensated: ErrorFigures | None  # the same with compensation
    compensation_rms: float  # root mean square of the compensation over the window
    friction: FrictionMap
    is_enabled: bool  # the compensation is switched on in the settings
    gain: float
    model: str  # name of the friction model
    model_file: str | None
    parameters: Mapping[str, Any]  # of the model
    settings: Mapping[str, Any]  # section ``compensation`` of the configuration, as it is in force
    learning: Mapping[str, Any] | None = None  # of `friction_hil.live.Reading`; None for an axis that learns nothing


@dataclass(frozen=True, slots=True, eq=False)
class Snapshot:
    """Figures of a daemon.

    Name, source and version are those of `friction_hil.live.LiveFacts`, ``stands`` and ``is_over`` those of
    `friction_hil.live.Reading`.
    """

    name: str
    source: str
    version: str
    state: str  # of the run, ``running``; ``unknown`` while the loop stands, ``ended`` when it is over
    stands: bool
    is_over: bool
    time_s: float  # of the last row, s; NaN before the first
    cycle: int  # of the last row; 0 before the first
    change: int  # number of the last change of settings; 0 before the first
    period_s: float  # of the loop
    window_s: float  # duration of the window of all rolling figures
    missed: int  # periods that were missed since this was attached
    lost: int  # rows that did not get here since then
    lateness: Lateness
    faults: tuple[Message, ...]  # that nobody has reset
    warnings: tuple[Message, ...]  # the last ones, as the notices
    notices: tuple[Message, ...]
    axes: Mapping[str, AxisSnapshot]
