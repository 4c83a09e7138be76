"""Simulated drives on serial lines: servos with the signals of a description, and lines with delays and faults."""

from friction_hil_drivers.serial_line.simulated.drive import RefusedError, SimulatedDrive
from friction_hil_drivers.serial_line.simulated.drives import SimulatedSerialDrives
from friction_hil_drivers.serial_line.simulated.options import LineFaults, SerialSimulation
from friction_hil_drivers.serial_line.simulated.server import Responder

__all__ = [
    "LineFaults",
    "RefusedError",
    "Responder",
    "SerialSimulation",
    "SimulatedDrive",
    "SimulatedSerialDrives",
]
