"""Simulated Modbus drives."""

from friction_hil_drivers.modbus.codec import ModbusLine
from friction_hil_drivers.modbus.description import DESCRIPTIONS, ModbusDescription
from friction_hil_drivers.modbus.responder import ModbusResponder
from friction_hil_drivers.serial_line.simulated.drives import SimulatedSerialDrives


class SimulatedModbusDrives(SimulatedSerialDrives):
    """Drives that answer Modbus requests."""

    description_type = ModbusDescription
    descriptions = DESCRIPTIONS
    responder = ModbusResponder
    protocol = ModbusLine
