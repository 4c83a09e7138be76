"""Installed drivers, found by their entry points."""

from importlib.metadata import entry_points
from typing import Any

from friction_hil.errors import UsageError, choices

DRIVERS = "friction_hil.drivers"
SIMULATED_DRIVES = "friction_hil.simulated_drives"


def driver_names(group: str = DRIVERS) -> list[str]:
    """Return the names of the installed drivers."""
    return sorted({entry.name for entry in entry_points(group=group)})


def load_driver(name: str, group: str = DRIVERS) -> Any:
    """Load the class of the entry point ``name`` in ``group``.

    Raises
    ------
    UsageError
        No driver of this name is installed; the message lists the installed ones.
    """
    for entry in entry_points(group=group):
        if entry.name == name:
            return entry.load()
    raise UsageError(f"no driver is called {name!r}; {choices(name, driver_names(group))}")
