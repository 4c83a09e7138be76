"""Modbus drives, as the loop needs them."""

from friction_hil_drivers.modbus.codec import ModbusLine
from friction_hil_drivers.modbus.description import DESCRIPTIONS, ModbusDescription
from friction_hil_drivers.modbus.options import ModbusOptions
from friction_hil_drivers.serial_line.drives import SerialDrives


class ModbusDrives(SerialDrives):
    """Drives with Modbus RTU or TCP."""

    Options = ModbusOptions
    description_type = ModbusDescription
    descriptions = DESCRIPTIONS
    protocol = ModbusLine
