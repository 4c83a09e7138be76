"""Installed drivers, found by their entry points."""

from functools import cache
from importlib.metadata import entry_points
from typing import Any, Final, Literal, overload

from pydantic import BaseModel

from friction_hil.config.own_loop import OWN_LOOP, OwnLoop
from friction_hil.drive.driver import Driver, OptionChecks, SimulatedDriver, with_defaults
from friction_hil.errors import UsageError, choices

DRIVERS: Final = "friction_hil.drivers"
SIMULATED_DRIVES: Final = "friction_hil.simulated_drives"


def driver_names(group: str = DRIVERS) -> list[str]:
    """Return the names of the installed drivers."""
    return sorted({entry.name for entry in entry_points(group=group)})


@overload
def load_driver(name: str, group: Literal["friction_hil.drivers"] = DRIVERS) -> type[Driver]: ...
@overload
def load_driver(name: str, group: Literal["friction_hil.simulated_drives"]) -> type[SimulatedDriver]: ...
@cache
def load_driver(name: str, group: str = DRIVERS) -> Any:
    """Load the class of the entry point ``name`` in ``group``, with the defaults of what it does not offer.

    Raises `UsageError`: no driver of this name is installed (the message lists the installed ones), or its `Options` is
    no pydantic model.
    """
    if (name, group) == (OWN_LOOP, DRIVERS):
        return OwnLoop
    for entry in entry_points(group=group):
        if entry.name == name:
            return _complete(name, entry.load(), group)
    raise UsageError(f"no driver is called {name!r}; {choices(name, driver_names(group))}")


def _complete(name: str, given: type, group: str) -> type:
    driver: Any = with_defaults(given, Driver if group == DRIVERS else SimulatedDriver)
    options = driver.Options
    if not (isinstance(options, type) and issubclass(options, BaseModel)):
        raise UsageError(f"the driver {name!r} is broken: its Options is not a pydantic model")
    if group == DRIVERS and not issubclass(options, OptionChecks):
        driver.Options = with_defaults(options, OptionChecks)
    complete: type = driver
    return complete
