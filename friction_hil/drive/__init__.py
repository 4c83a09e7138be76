"""The drive port: all that a driver needs to know of the daemon, and the daemon of a driver.

`port` defines what they exchange each cycle and the protocol of a driver, `finding` what a driver reports to
``friction-hil doctor``, `encoder` how a counter that wraps becomes a continuous position.
"""

from friction_hil.drive.finding import Finding
from friction_hil.drive.port import (
    AxisFacts,
    Clock,
    Command,
    Driver,
    Drives,
    DriveState,
    Feedback,
    Mode,
    Request,
    SimulatedDriver,
)

__all__ = [
    "AxisFacts",
    "Clock",
    "Command",
    "DriveState",
    "Driver",
    "Drives",
    "Feedback",
    "Finding",
    "Mode",
    "Request",
    "SimulatedDriver",
]
