"""Dynamixel servos, as the loop needs them."""

from friction_hil_drivers.dynamixel.codec import DynamixelLine
from friction_hil_drivers.dynamixel.description import DESCRIPTIONS, DynamixelDescription
from friction_hil_drivers.dynamixel.options import DynamixelOptions
from friction_hil_drivers.serial_line.drives import SerialDrives


class DynamixelDrives(SerialDrives):
    """Servos with Dynamixel Protocol 2.0."""

    Options = DynamixelOptions
    description_type = DynamixelDescription
    descriptions = DESCRIPTIONS
    protocol = DynamixelLine
