"""Drive port: the interface between the daemon and the drivers.

`driver` has the base classes of drivers, `port` the data of each cycle, `codes` the codes of faults, `finding` the
reports to ``friction-hil doctor``, `encoder` the unwrapping of encoder counters, `stop` the states of a stop.
"""

from friction_hil.drive.codes import FaultCode
from friction_hil.drive.driver import Driver, Drives, SimulatedDriver
from friction_hil.drive.finding import Finding
from friction_hil.drive.port import (
    AxisFacts,
    Clock,
    Command,
    DriveState,
    Feedback,
    Mode,
    Request,
)
from friction_hil.drive.unit_row import UnitRow, unit_table

__all__ = [
    "AxisFacts",
    "Clock",
    "Command",
    "DriveState",
    "Driver",
    "Drives",
    "FaultCode",
    "Feedback",
    "Finding",
    "Mode",
    "Request",
    "SimulatedDriver",
    "UnitRow",
    "unit_table",
]
