"""Keys of a serial driver in a new configuration."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from friction_hil.config.annotated import FILL_IN
from friction_hil.config.new_file import DriverKeys, Wanted, as_address
from friction_hil_drivers.serial_line.axis import unit_mistakes
from friction_hil_drivers.serial_line.description import Description, load_description, ready
from friction_hil_drivers.serial_line.units import NEEDS, AxisUnits

_MODES = ("csp", "csv", "cst")
_PERIOD_S = 5e-3
_NO_WATCHDOG = "the description has no watchdog: false accepts a drive that does not notice the loss of the daemon"


def new_keys(
    wanted: Wanted,
    *,
    address_key: str,  # of the drive's address on its line
    is_address_needed: bool,  # False if a line with a single drive needs no address
    directory: Path,  # of the descriptions that come with the driver; `kind` is their class
    kind: type[Description],
    simulated: Mapping[str, Any],  # for a simulated drive: `description`, units, `baud` and `period_s`
) -> DriverKeys:
    """Return the keys that a newcomer needs; see `friction_hil.drive.Driver`.

    Raises `UsageError`: there is no such description.
    """
    chosen = simulated if wanted.is_simulated else {}
    port = wanted.bus or (f"/tmp/friction_hil_{wanted.name}" if wanted.is_simulated else FILL_IN)
    line: dict[str, Any] = {"port": port}
    if (baud := wanted.bitrate or chosen.get("baud")) is not None:
        line["baud"] = baud
    name = wanted.description or chosen.get("description")
    keys: dict[str, Any] = {"line": line, "description": FILL_IN if name is None else name}
    if wanted.node is not None or is_address_needed:
        keys[address_key] = as_address(wanted.node, is_simulated=wanted.is_simulated)
    notes = {"description": f"description of the drive: {', '.join(ready(directory))}, or the path of your own .yaml"}
    modes: tuple[str, ...] = _MODES
    if name is not None:
        description = load_description(name, wanted.path, directory, kind)
        modes = tuple(mode for mode in _MODES if mode in description.modes)
        missing = unit_mistakes("x", description, AxisUnits(), "linear" if wanted.is_linear else "rotary")
        keys |= {each.key: chosen.get(each.key, FILL_IN) for each in missing if each.key in NEEDS.values()}
        if description.watchdog is None:
            keys["is_watchdog_required"] = not wanted.is_simulated  # a simulated drive needs nobody's consent
            notes["is_watchdog_required"] = _NO_WATCHDOG
    keys["is_inverted"] = False
    return DriverKeys(keys, notes, modes, chosen.get("period_s", _PERIOD_S))
