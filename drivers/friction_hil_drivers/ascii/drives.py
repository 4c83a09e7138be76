"""Drives that speak in lines of text, as the loop needs them."""

from friction_hil_drivers.ascii import DESCRIPTIONS
from friction_hil_drivers.ascii.codec import AsciiLine
from friction_hil_drivers.ascii.description import AsciiDescription
from friction_hil_drivers.ascii.options import AsciiOptions
from friction_hil_drivers.serial_line.drives import SerialDrives


class AsciiDrives(SerialDrives):
    """Drives that speak in lines of text."""

    Options = AsciiOptions
    description_type = AsciiDescription
    descriptions = DESCRIPTIONS
    protocol = AsciiLine
