"""Keys of the CANopen driver in a new configuration."""

from friction_hil.config.annotated import FILL_IN
from friction_hil.config.new_file import DriverKeys, Wanted, as_address, parse_bus
from friction_hil.errors import UsageError


def new_keys(wanted: Wanted) -> DriverKeys:
    """Return the keys that a newcomer needs; see `friction_hil.drive.Driver`."""
    if wanted.description is not None:
        raise UsageError("--description is for drives on serial lines; a CANopen drive describes itself")
    units = FILL_IN if wanted.is_linear else None  # drives report neither per metre
    keys = {
        "node": as_address(wanted.node, is_simulated=wanted.is_simulated),
        "counts_per_unit": units,
        "rated_torque": units,
        "is_inverted": False,
    }
    return DriverKeys(keys, bus=parse_bus(wanted))
