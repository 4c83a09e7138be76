"""What the CANopen driver does for commands other than a run; see `friction_hil.drive.Driver`.

Imports are in the functions: python-can takes 0.5 s, and reading a configuration does not need it.
"""

import contextlib
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

from friction_hil.drive import Driver
from friction_hil_drivers.canopen.options import canopen_options

if TYPE_CHECKING:
    from friction_hil.config import AxisConfig, BusConfig, Configuration
    from friction_hil.drive.inventory import StopReport
    from friction_hil.recordings import Recording
    from friction_hil_drivers.canopen.commands.inventory import CanopenInventory


class CanopenService(Driver):
    """Functions of the driver that need no cyclic phase."""

    @staticmethod
    def open_inventory(config: "BusConfig", *, may_disturb: bool = False) -> "CanopenInventory":
        """Open a bus to find, show or stop its drives; see `CanopenInventory`."""
        from friction_hil_drivers.canopen.commands.inventory import CanopenInventory
        from friction_hil_drivers.canopen.wire.bus import open_frame_bus

        return CanopenInventory(config, open_frame_bus(config), may_disturb=may_disturb)

    @staticmethod
    def inventory_node(axis: "AxisConfig") -> int:
        """Return the number of an axis's node."""
        return canopen_options(axis).node

    @classmethod
    def stop_axes(cls, configuration: "Configuration", axes: "Mapping[str, AxisConfig]") -> "StopReport":
        """Take the power of the drives of some axes, and read their states back."""
        with contextlib.closing(cls.open_inventory(_bus(configuration))) as inventory:
            return inventory.stop_axes(_places(axes))

    @classmethod
    def reset_axes(cls, configuration: "Configuration", axes: "Mapping[str, AxisConfig]") -> "StopReport":
        """Reset the faults of the drives of some axes, leave them without power, and read their states back."""
        with contextlib.closing(cls.open_inventory(_bus(configuration))) as inventory:
            return inventory.reset_axes(_places(axes))

    @staticmethod
    def read_bus_log(path: Path, axes: "Mapping[str, AxisConfig]") -> "list[Recording]":
        """Decode a log of CAN frames; see `bus_log.read_bus_log`."""
        from friction_hil_drivers.canopen.commands.bus_log import read_bus_log

        return read_bus_log(path, axes)


def _bus(configuration: "Configuration") -> "BusConfig":
    assert configuration.bus is not None  # the driver's options have checked it
    return configuration.bus


def _places(axes: "Mapping[str, AxisConfig]") -> dict[str, tuple[int, int]]:
    """Return node, and number of the axis in it, by the name of the axis."""
    options = {name: canopen_options(axis) for name, axis in axes.items()}
    return {name: (each.node, each.axis_number) for name, each in options.items()}
