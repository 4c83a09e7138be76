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
    """Figures of one axis; NaN for what is not known. Positions in rad or m, torques in N m or N.

    Attributes
    ----------
    kind : {"rotary", "linear"}
    unit, torque_unit : str
        Unit of the position (that of the velocity is per second), and of torques.
    drive_state : str
        As read back in the last cycle: ``operation enabled``; ``unknown`` if it was not.
    is_powered : bool or None
        The drive may produce torque; None if its state is unknown.
    position, velocity, torque, position_demand, velocity_demand, compensation, command : float
        In the last row; NaN while the loop stands, and when it is over.
    temperature : float
        Temperature that the friction model was given, or that was measured, deg C.
    error : float
        Following error in the last row, demanded less measured position.
    without, compensated : ErrorFigures or None
        Following error over the window, without and with compensation; None where there was no steady motion. Once a
        time without compensation has ended, of all of it, as the daemon has found it.
    compensation_rms : float
        Root mean square of the compensation over the window.
    friction : FrictionMap
    is_enabled : bool
        The compensation is switched on in the settings.
    gain : float
    model : str
        Name of the friction model.
    model_file : str or None
    parameters : dict
        Parameters of the model.
    settings : dict
        The section ``compensation`` of the configuration, as it is in force.
    learning : dict or None
        Of `friction_hil.live.Reading`; None for an axis that learns nothing.
    """

    kind: str
    unit: str
    torque_unit: str
    drive_state: str
    is_powered: bool | None
    position: float
    velocity: float
    torque: float
    position_demand: float
    velocity_demand: float
    compensation: float
    command: float
    temperature: float
    error: float
    without: ErrorFigures | None
    compensated: ErrorFigures | None
    compensation_rms: float
    friction: FrictionMap
    is_enabled: bool
    gain: float
    model: str
    model_file: str | None
    parameters: Mapping[str, Any]
    settings: Mapping[str, Any]
    learning: Mapping[str, Any] | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Snapshot:
    """Figures of a daemon.

    Attributes
    ----------
    name, source, version : str
        Of `friction_hil.live.LiveFacts`.
    state : str
        State of the run, ``running``; ``unknown`` while the loop stands, ``ended`` when it is over.
    stands, is_over : bool
        Of `friction_hil.live.Reading`.
    time_s : float
        Time of the last row, s; NaN before the first.
    cycle, change : int
        Its number, and that of the last change of settings; 0 before the first.
    period_s, window_s : float
        Period of the loop; duration of the window of all rolling figures.
    missed, lost : int
        Periods that were missed, and rows that did not get here, since this was attached.
    lateness : Lateness
    faults, warnings, notices : tuple of Message
        Faults that nobody has reset; the last warnings and notices.
    axes : dict of AxisSnapshot
    """

    name: str
    source: str
    version: str
    state: str
    stands: bool
    is_over: bool
    time_s: float
    cycle: int
    change: int
    period_s: float
    window_s: float
    missed: int
    lost: int
    lateness: Lateness
    faults: tuple[Message, ...]
    warnings: tuple[Message, ...]
    notices: tuple[Message, ...]
    axes: Mapping[str, AxisSnapshot]
