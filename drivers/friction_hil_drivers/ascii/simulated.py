"""Simulated drives that speak in lines of text."""

from friction_hil_drivers.ascii import DESCRIPTIONS
from friction_hil_drivers.ascii.codec import AsciiLine
from friction_hil_drivers.ascii.description import AsciiDescription
from friction_hil_drivers.ascii.responder import AsciiResponder
from friction_hil_drivers.serial_line.simulated.drives import SimulatedSerialDrives


class SimulatedAsciiDrives(SimulatedSerialDrives):
    """Drives that answer lines of text."""

    description_type = AsciiDescription
    descriptions = DESCRIPTIONS
    responder = AsciiResponder
    protocol = AsciiLine
