"""Objects of CiA 402, and those of CiA 301 that describe a device on whatever bus.

Every index, name and type is defined here and nowhere else; what belongs to CAN is in `canopen.cia301`. Types are
those of the standard; a real drive may differ (60B2h is INTEGER32 in some), so objects are mapped with the widths
that the drive itself gives them.
"""

from dataclasses import dataclass, replace
from enum import IntEnum

Address = tuple[int, int]  # index and sub-index


class DataType(IntEnum):
    """Data types by their index in the object dictionary (CiA 301)."""

    BOOLEAN = 0x01
    INTEGER8 = 0x02
    INTEGER16 = 0x03
    INTEGER32 = 0x04
    UNSIGNED8 = 0x05
    UNSIGNED16 = 0x06
    UNSIGNED32 = 0x07
    VISIBLE_STRING = 0x09

    @property
    def bits(self) -> int:
        """Width on the wire; 0 for a string."""
        return _BITS[self]

    @property
    def is_signed(self) -> bool:
        """True for signed integers."""
        return self in (DataType.INTEGER8, DataType.INTEGER16, DataType.INTEGER32)

    @property
    def bounds(self) -> tuple[int, int]:
        """Smallest and largest value of an integer type."""
        if self.is_signed:
            return -(1 << (self.bits - 1)), (1 << (self.bits - 1)) - 1
        return 0, (1 << self.bits) - 1


_BITS = {
    DataType.BOOLEAN: 8,
    DataType.INTEGER8: 8,
    DataType.INTEGER16: 16,
    DataType.INTEGER32: 32,
    DataType.UNSIGNED8: 8,
    DataType.UNSIGNED16: 16,
    DataType.UNSIGNED32: 32,
    DataType.VISIBLE_STRING: 0,
}

_I8, _I16, _I32 = DataType.INTEGER8, DataType.INTEGER16, DataType.INTEGER32
_U8, _U16, _U32 = DataType.UNSIGNED8, DataType.UNSIGNED16, DataType.UNSIGNED32
_TEXT = DataType.VISIBLE_STRING


@dataclass(frozen=True, slots=True)
class Object:
    """One variable of an object dictionary. Prints as ``60B2h torque offset``."""

    index: int
    name: str
    type: DataType
    subindex: int = 0

    @property
    def address(self) -> tuple[int, int]:
        """Index and sub-index, as the key of `TABLE`."""
        return self.index, self.subindex

    @property
    def mapping(self) -> int:
        """Entry of a PDO mapping object: index, sub-index and width in bits."""
        return self.index << 16 | self.subindex << 8 | self.type.bits

    def of_axis(self, axis: int) -> "Object":
        """Return the same object of axis ``axis`` of a node with several."""
        return replace(self, index=axis_index(self.index, axis)) if axis else self

    @property
    def place(self) -> str:
        """Index and sub-index in messages: ``60B2h``, ``1018h:01``."""
        return f"{self.index:04X}h:{self.subindex:02X}" if self.subindex else f"{self.index:04X}h"

    def __str__(self) -> str:
        return f"{self.place} {self.name}"


# The device, CiA 301
DEVICE_TYPE = Object(0x1000, "device type", _U32)
ERROR_REGISTER = Object(0x1001, "error register", _U8)
ERROR_HISTORY_COUNT = Object(0x1003, "number of errors", _U8)
DEVICE_NAME = Object(0x1008, "device name", _TEXT)
HARDWARE_VERSION = Object(0x1009, "hardware version", _TEXT)
SOFTWARE_VERSION = Object(0x100A, "software version", _TEXT)
VENDOR_ID = Object(0x1018, "vendor ID", _U32, 1)
PRODUCT_CODE = Object(0x1018, "product code", _U32, 2)
REVISION_NUMBER = Object(0x1018, "revision number", _U32, 3)
SERIAL_NUMBER = Object(0x1018, "serial number", _U32, 4)

# Of the simulated drive alone: each manufacturer has another object for a temperature, or none
SIMULATED_MOTOR_TEMPERATURE = Object(0x5FF0, "motor temperature", _I16)  # 0.1 deg C
SIMULATED_GEAR_TEMPERATURE = Object(0x5FF1, "gear temperature", _I16)

# Drive profile, CiA 402
ABORT_CONNECTION_OPTION = Object(0x6007, "abort connection option code", _I16)
ERROR_CODE = Object(0x603F, "error code", _U16)
CONTROLWORD = Object(0x6040, "controlword", _U16)
STATUSWORD = Object(0x6041, "statusword", _U16)
QUICK_STOP_OPTION = Object(0x605A, "quick stop option code", _I16)
SHUTDOWN_OPTION = Object(0x605B, "shutdown option code", _I16)
DISABLE_OPERATION_OPTION = Object(0x605C, "disable operation option code", _I16)
FAULT_REACTION_OPTION = Object(0x605E, "fault reaction option code", _I16)
MODE = Object(0x6060, "modes of operation", _I8)
MODE_DISPLAY = Object(0x6061, "modes of operation display", _I8)
POSITION_DEMAND = Object(0x6062, "position demand value", _I32)
POSITION_ACTUAL = Object(0x6064, "position actual value", _I32)
FOLLOWING_ERROR_WINDOW = Object(0x6065, "following error window", _U32)
FOLLOWING_ERROR_TIMEOUT = Object(0x6066, "following error time out", _U16)  # ms
VELOCITY_DEMAND = Object(0x606B, "velocity demand value", _I32)
VELOCITY_ACTUAL = Object(0x606C, "velocity actual value", _I32)
TARGET_TORQUE = Object(0x6071, "target torque", _I16)  # per mille of rated torque, as all torques
MAX_TORQUE = Object(0x6072, "max torque", _U16)
TORQUE_DEMAND = Object(0x6074, "torque demand", _I16)
RATED_TORQUE = Object(0x6076, "motor rated torque", _U32)  # mN m (mN on a linear axis)
TORQUE_ACTUAL = Object(0x6077, "torque actual value", _I16)
TARGET_POSITION = Object(0x607A, "target position", _I32)
MIN_POSITION_LIMIT = Object(0x607D, "min position limit", _I32, 1)
MAX_POSITION_LIMIT = Object(0x607D, "max position limit", _I32, 2)
PROFILE_VELOCITY = Object(0x6081, "profile velocity", _U32)
PROFILE_ACCELERATION = Object(0x6083, "profile acceleration", _U32)
TORQUE_SLOPE = Object(0x6087, "torque slope", _U32)
PHYSICAL_OUTPUTS = Object(0x60FE, "physical outputs", _U32, 1)
MAX_MOTOR_SPEED = Object(0x6080, "max motor speed", _U32)  # 1/min
POLARITY = Object(0x607E, "polarity", _U8)
PROFILE_DECELERATION = Object(0x6084, "profile deceleration", _U32)
QUICK_STOP_DECELERATION = Object(0x6085, "quick stop deceleration", _U32)
ENCODER_INCREMENTS = Object(0x608F, "encoder increments", _U32, 1)
MOTOR_REVOLUTIONS = Object(0x608F, "motor revolutions", _U32, 2)
VELOCITY_ENCODER_INCREMENTS = Object(0x6090, "velocity encoder increments per second", _U32, 1)
VELOCITY_MOTOR_REVOLUTIONS = Object(0x6090, "motor revolutions per second", _U32, 2)
GEAR_MOTOR_REVOLUTIONS = Object(0x6091, "gear motor revolutions", _U32, 1)
GEAR_SHAFT_REVOLUTIONS = Object(0x6091, "gear shaft revolutions", _U32, 2)
FEED = Object(0x6092, "feed", _U32, 1)
FEED_SHAFT_REVOLUTIONS = Object(0x6092, "feed shaft revolutions", _U32, 2)
VELOCITY_FACTOR_NUMERATOR = Object(0x6096, "velocity factor numerator", _U32, 1)
VELOCITY_FACTOR_DIVISOR = Object(0x6096, "velocity factor divisor", _U32, 2)
POSITION_UNIT = Object(0x60A8, "SI unit position", _U32)
VELOCITY_UNIT = Object(0x60A9, "SI unit velocity", _U32)
POSITION_OFFSET = Object(0x60B0, "position offset", _I32)
VELOCITY_OFFSET = Object(0x60B1, "velocity offset", _I32)
TORQUE_OFFSET = Object(0x60B2, "torque offset", _I16)
INTERPOLATION_PERIOD = Object(0x60C2, "interpolation time period value", _U8, 1)
INTERPOLATION_EXPONENT = Object(0x60C2, "interpolation time index", _I8, 2)
ADDITIONAL_POSITION = Object(0x60E4, "additional position actual value", _I32, 1)
ADDITIONAL_INCREMENTS = Object(0x60E6, "additional encoder increments", _U32, 1)
ADDITIONAL_GEAR_MOTOR = Object(0x60E8, "additional gear motor revolutions", _U32, 1)
ADDITIONAL_REVOLUTIONS = Object(0x60EB, "additional encoder revolutions", _U32, 1)
ADDITIONAL_GEAR_SHAFT = Object(0x60ED, "additional gear shaft revolutions", _U32, 1)
FOLLOWING_ERROR = Object(0x60F4, "following error actual value", _I32)
TARGET_VELOCITY = Object(0x60FF, "target velocity", _I32)
SUPPORTED_MODES = Object(0x6502, "supported drive modes", _U32)

# Torque and velocity that act as soon as somebody enables the drive in a mode that takes them
ACTING_SETPOINTS = (TORQUE_OFFSET, VELOCITY_OFFSET, TARGET_TORQUE, TARGET_VELOCITY)

TABLE: dict[tuple[int, int], Object] = {
    entry.address: entry for entry in list(globals().values()) if isinstance(entry, Object)
}

# Nodes with several axes (CiA 402-2): the objects of the profile of each are this far from those of the one before
AXIS_OFFSET = 0x800
_FIRST_AXIS = range(0x6000, 0x6000 + AXIS_OFFSET)


def axis_index(index: int, axis: int) -> int:
    """Return the index on axis ``axis`` of an object that has ``index`` on axis 0; others stay as they are."""
    return index + AXIS_OFFSET * axis if index in _FIRST_AXIS else index


def first_axis_index(index: int, axis: int) -> int:
    """Return the index on axis 0 of an object of axis ``axis``; others stay as they are."""
    first = index - AXIS_OFFSET * axis
    return first if first in _FIRST_AXIS else index


# Velocity units by object 60A9h: prefix, numerator, denominator, reserved (CiA 402-2, CiA 303-2)
COUNTS_PER_SECOND = 0x00B50300
REVOLUTIONS_PER_MINUTE = 0x00B44700
