"""What learning has on trial: in force, but not proven, and taken back by whoever outlives the one who judges it.

The journal says it, in the entry of the change that is in force: whoever opens it knows what to go back to.
"""

from collections.abc import Collection
from dataclasses import dataclass
from typing import Any

from friction_hil.daemon.control import journal
from friction_hil.daemon.control.journal import PROVEN, Present
from friction_hil.errors import FrictionHilError, choices

_KEYS = ("process", "upon", "axes")


class RefusedError(FrictionHilError):
    """A request that is not carried out."""


@dataclass(frozen=True, slots=True)
class OnTrial:
    """What the process that learns says of itself in a request."""

    process: int  # its number: its death ends the trial
    upon: int  # number of the change that it knows as the last one
    axes: list[str]  # with something on trial from this request on

    @classmethod
    def of(cls, given: Any, names: Collection[str]) -> "OnTrial | None":
        """Return what a request says; None if it is not from the process that learns.

        Raises `RefusedError`: it is not as described above.
        """
        if given is None:
            return None
        if not isinstance(given, dict) or given.keys() != set(_KEYS):
            raise RefusedError(f"learning must be a group of {', '.join(_KEYS)}")
        process, upon, axes = (given[key] for key in _KEYS)
        if not (type(process) is int and 0 < process < 1 << 31 and type(upon) is int and isinstance(axes, list)):
            raise RefusedError("learning: process and upon must be whole numbers, axes a list")
        for name in axes:
            if name not in names:
                raise RefusedError(f"learning: there is no axis {name!r}; {choices(str(name), names)}")
        return cls(process, upon, axes)

    def mark(self, entry: dict[str, Any], before: Present) -> None:
        """Note in the entry of a change what to go back to; ``before``: what was in force before it."""
        for name in self.axes:
            axis = before.configuration["axes"][name]
            now = {"gain": axis["compensation"]["gain"], "model_of": before.models_of[name], "model": axis["model"]}
            entry.setdefault(PROVEN, {})[name] = before.on_trial.get(name, now)


def settle(descriptor: int, number: int, still: Collection[str]) -> None:
    """Note that what was on trial by the change in force is proven, but for the axes in ``still``."""
    for entry in reversed(journal.entries(descriptor)):
        if entry["number"] == number:
            proven = entry.get(PROVEN, {})
            if proven.keys() - set(still):
                left = {name: axis for name, axis in proven.items() if name in still}
                journal.append(descriptor, {**entry, PROVEN: left})
            return


def values_before(now: Present, values: Collection[str]) -> dict[str, Any]:
    """Return the values that take back what is on trial; a model that stayed is not changed again.

    ``now``: what is in force. ``values``: keys of what somebody gives anew, which is left out.
    """
    given = {key.replace(".compensation.", ".", 1) for key in values}
    return {
        f"{name}.{key}": axis[key]
        for name, axis in now.on_trial.items()
        for key in ("gain", "model")
        if f"{name}.{key}" not in given and not (key == "model" and axis["model_of"] == now.models_of[name])
    }
