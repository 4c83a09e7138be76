"""Simulated Dynamixel servos."""

from friction_hil_drivers.dynamixel.codec import DynamixelLine
from friction_hil_drivers.dynamixel.description import DESCRIPTIONS, DynamixelDescription
from friction_hil_drivers.dynamixel.responder import DynamixelResponder
from friction_hil_drivers.serial_line.simulated.drives import SimulatedSerialDrives


class SimulatedDynamixelDrives(SimulatedSerialDrives):
    """Servos that answer Dynamixel requests."""

    description_type = DynamixelDescription
    descriptions = DESCRIPTIONS
    responder = DynamixelResponder
    protocol = DynamixelLine
