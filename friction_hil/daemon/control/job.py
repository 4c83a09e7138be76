"""Job of the process of the control socket."""

from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True, slots=True)
class ControlJob:
    """What the process of the control socket has to know.

    Attributes
    ----------
    name : str
        Name of the daemon.
    configuration : dict
        As returned by `friction_hil.config.self_contained`.
    source : str
        Where it came from, for messages.
    facts : list of dict
        `friction_hil.drive.AxisFacts` of each axis.
    columns : list of str
        Columns of each axis's part of a row.
    state_width : int
        Values of compensator state that follow them.
    has_network : bool
        The loop has the code for models with a network.
    is_follower : bool
        Another controller enables and moves the drives.
    files : dict of str
        Model file of each axis that has one.
    started_unix_ns : int
        Wall-clock time of ``time_s`` = 0, ns since 1970; 0 in simulated time.
    ramp_s : float
        Time that the axes take to reach full speed, s.
    remedies : dict of str
        What to do about each code of a fault, of the daemon and of its driver.
    """

    name: str
    configuration: dict[str, Any]
    source: str
    facts: list[dict[str, Any]]
    columns: list[str]
    state_width: int
    has_network: bool = False
    is_follower: bool = False
    files: dict[str, str] = field(default_factory=dict)
    started_unix_ns: int = 0
    ramp_s: float = 0.0
    remedies: dict[str, str] = field(default_factory=dict)
