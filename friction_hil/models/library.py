"""Friction of real actuators to start from, identified from published recordings; model files of this package.

An actuator of the same type has a friction of its own: on yours, this is a guess. ``fit`` of a model file has its
errors, its range of validity and, under ``actuator``, what was measured, by whom, under which licence, and the command
that identified it. Inertia, gravity and offset in it are those of the rig.

>>> import friction_hil as fh
>>> fh.library.names()
('ak80-6', 'emps', 'xl330')
>>> actuator = fh.library.describe("ak80-6")
>>> actuator.axis, actuator.licence
('rotary', 'BSD-3-Clause')
>>> fh.library.load("ak80-6").friction_model.steady_state([1.0]) > 0.0
array([ True])
"""

from dataclasses import dataclass
from pathlib import Path

from friction_hil.errors import UsageError, choices
from friction_hil.models.files import load_model_file
from friction_hil.models.model_file import ModelFile

__all__ = ["Actuator", "describe", "load", "names"]

FOLDER = Path(__file__).parent / "actuators"
_HELD_OUT = ("validation", "cross_validation", "across_speeds")


@dataclass(frozen=True, slots=True)
class Actuator:
    """What is known about the friction of a real actuator.

    Attributes
    ----------
    name : str
        Its name in this library.
    what : str
        The actuator and how it was measured.
    source, licence : str
        Where the recordings are from, and their licence.
    axis : str
        ``rotary`` or ``linear``.
    model : str
        Friction model, with its modifiers.
    level : float
        Coulomb level, N m (N on a linear axis).
    relative_error : float
        Error of the torque on the recordings it was fitted to, over the RMS of the torque.
    held_out : float
        The same on groups of recordings, blocks of time or speeds that it was not fitted to; the largest of these.
    velocity : tuple of float
        Lowest and highest velocity of the recordings, rad/s (m/s): beyond it nothing is known.
    command : str
        Command that identified it.
    flags : tuple of str
        What limits its use, one sentence each.
    """

    name: str
    what: str
    source: str
    licence: str
    axis: str
    model: str
    level: float
    relative_error: float
    held_out: float
    velocity: tuple[float, float]
    command: str
    flags: tuple[str, ...]


def names() -> tuple[str, ...]:
    """Return the names of the actuators.

    Returns
    -------
    tuple of str
    """
    return tuple(sorted(path.stem for path in FOLDER.glob("*.yaml")))


def load(name: str) -> ModelFile:
    """Read the model file of an actuator.

    Parameters
    ----------
    name : str
        One of `names`.

    Returns
    -------
    ModelFile

    Raises
    ------
    UsageError
        There is no such actuator; the message lists them.
    """
    if name not in names():
        raise UsageError(f"no actuator is called {name!r}; {choices(name, names())}")
    return load_model_file(FOLDER / f"{name}.yaml")


def describe(name: str) -> Actuator:
    """Describe an actuator.

    Parameters
    ----------
    name : str
        One of `names`.

    Returns
    -------
    Actuator

    Raises
    ------
    UsageError
        There is no such actuator; the message lists them.
    """
    model = load(name)
    fit = model.fit or {}
    about, held = fit["actuator"], [fit[each]["relative_error"] for each in _HELD_OUT if each in fit]
    low, high = fit["range"]["velocity"]
    return Actuator(
        name=name,
        axis=model.axis,
        model=" + ".join((model.friction.model, *model.friction.modifiers)),
        level=model.friction_model.level,
        relative_error=fit["train"]["relative_error"],
        held_out=max(held),
        velocity=(low, high),
        flags=tuple(fit["flags"]),
        **{key: about[key] for key in ("what", "source", "licence", "command")},
    )
