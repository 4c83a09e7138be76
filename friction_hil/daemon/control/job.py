"""Job of the process of the control socket."""

from dataclasses import dataclass, field
from typing import Any


@dataclass(frozen=True, slots=True)
class ControlJob:
    """What the process of the control socket has to know."""

    name: str  # of the daemon
    configuration: dict[str, Any]  # as returned by `friction_hil.config.self_contained`
    source: str  # where it came from, for messages
    facts: list[dict[str, Any]]  # `friction_hil.drive.AxisFacts` of each axis
    columns: list[str]  # of each axis's part of a row
    state_width: int  # values of compensator state that follow them
    has_network: bool = False  # the loop has the code for models with a network
    is_follower: bool = False  # another controller enables and moves the drives
    files: dict[str, str] = field(default_factory=dict)  # model file of each axis that has one
    started_unix_ns: int = 0  # wall-clock time of ``time_s`` = 0, ns since 1970; 0 in simulated time
    ramp_s: float = 0.0  # time that the axes take to reach full speed, s
    # what to do about each code of a fault, of the daemon and of its driver
    remedies: dict[str, str] = field(default_factory=dict)
