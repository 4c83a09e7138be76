"""The installed drivers, by the entry points that they register."""

from importlib.metadata import entry_points
from typing import Any

from friction_hil.errors import UsageError, choices

DRIVERS = "friction_hil.drivers"
SIMULATED_DRIVES = "friction_hil.simulated_drives"


def driver_names(group: str = DRIVERS) -> list[str]:
    """Names of the installed drivers."""
    return sorted({entry.name for entry in entry_points(group=group)})


def load_driver(name: str, group: str = DRIVERS) -> Any:
    """Load the class that the entry point ``name`` of ``group`` stands for.

    Raises
    ------
    UsageError
        No driver of that name is installed; the message lists those that are.
    """
    for entry in entry_points(group=group):
        if entry.name == name:
            return entry.load()
    raise UsageError(f"no driver is called {name!r}; {choices(name, driver_names(group))}")
