"""CANopen drives with the CiA 402 profile."""

from friction_hil_drivers.canopen.drives import CanopenDrives
from friction_hil_drivers.canopen.options import CanopenOptions

__all__ = ["CanopenDrives", "CanopenOptions"]
