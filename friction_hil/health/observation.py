"""What is measured of an axis in one stretch of a recording, and the layout that makes stretches comparable. Pure."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from friction_hil.health import thresholds as th
from friction_hil.numerics.jit import Array
from friction_hil.numerics.readable import POSITION_UNITS

AxisKind = Literal["rotary", "linear"]

COULOMB, VISCOUS, BREAKAWAY = "coulomb", "viscous", "breakaway"
ASYMMETRY, LOST_MOTION, RIPPLE, ZONE = "asymmetry", "lost_motion", "ripple", "zone"
DIRECTIONS = ("positive", "negative")


@dataclass(frozen=True, slots=True)
class Quantity:
    """Value with its standard error, SI."""

    value: float
    error: float


@dataclass(frozen=True, slots=True)
class Layout:
    """What all observations of an axis have in common, so that they can be compared.

    Attributes
    ----------
    kind : str
        ``rotary`` or ``linear``.
    edges : tuple of float
        Limits of the zones of the travel, rad or m.
    orders : tuple of float
        Orders of ripple: periods per revolution, or per metre.
    """

    kind: AxisKind
    edges: tuple[float, ...]
    orders: tuple[float, ...]

    @property
    def wave_numbers(self) -> tuple[float, ...]:
        """Angular orders: phase of the ripple over the position, rad per rad or m."""
        scale = 1.0 if self.kind == "rotary" else math.tau
        return tuple(scale * order for order in self.orders)


@dataclass(frozen=True, slots=True)
class Motion:
    """What a stretch of a recording moved, by which it is compared with others.

    Attributes
    ----------
    speed : float
        Median of the absolute velocity where the axis slides, rad/s or m/s.
    travel : float
        Range of the position, rad or m.
    """

    speed: float
    travel: float


@dataclass(frozen=True, slots=True)
class Observation:
    """Friction of an axis in one stretch of a recording.

    Attributes
    ----------
    source : str
        Name of the file.
    time_s : float
        Middle of the stretch, s since 1970.
    duration_s : float
    temperature : float or None
        Mean, °C; None if it was not recorded.
    motion : Motion
    quantities : dict of Quantity
        What the motion shows, by name.
    not_shown : dict of str
        What it does not show, by name, with the motion that would show it.
    """

    source: str
    time_s: float
    duration_s: float
    temperature: float | None
    motion: Motion
    quantities: Mapping[str, Quantity]
    not_shown: Mapping[str, str] = field(default_factory=dict)


def layout_of(position: Array, kind: AxisKind, orders: tuple[float, ...] = ()) -> Layout:
    """Return the layout for an axis that moves over these positions.

    Parameters
    ----------
    position : (n,) array
        rad or m.
    kind : str
    orders : tuple of float
        Orders of ripple to watch besides those that the travel resolves: of a rotary axis these are the lowest whole
        orders, each with a period of its own in the travel. Periods per revolution, or per metre.
    """
    low, high = np.quantile(position, (th.OVERSHOOT, 1.0 - th.OVERSHOOT))
    own: tuple[float, ...] = ()
    travel = float(np.ptp(position))
    if kind == "rotary" and travel > 0.0:
        step = max(1, math.ceil(math.tau / travel))
        own = tuple(float(step * k) for k in range(1, th.MOST_ORDERS + 1))
    together = tuple(sorted({*own, *map(float, orders)}))
    return Layout(kind, tuple(map(float, np.linspace(low, high, th.ZONES + 1))), together)


def family(name: str) -> str:
    """Return which kind of quantity a name is of: ``coulomb`` for ``coulomb.positive``."""
    return name.partition(".")[0]


def unit(name: str, kind: AxisKind) -> str:
    """Return the unit of a quantity."""
    torque, length = ("N m", "rad") if kind == "rotary" else ("N", "m")
    return {VISCOUS: f"{torque} s/{length}", LOST_MOTION: length}.get(family(name), torque)


def _rounded(edge: float, edges: Sequence[float]) -> str:
    """Return an edge to about a thousandth of the travel."""
    travel = max(edges) - min(edges)
    digits = max(2 - math.floor(math.log10(travel)), 0) if travel > 0.0 else 3
    text = f"{round(edge, digits) + 0.0:.{digits}f}"  # -0.0 becomes 0.0
    return text.rstrip("0").rstrip(".") if digits else text


def label(name: str, layout: Layout) -> str:
    """Return a quantity in words: ``Coulomb friction, positive direction``."""
    first, _, rest = name.partition(".")
    place, _, direction = rest.rpartition(".")
    towards = f", {direction} direction" if direction in DIRECTIONS else ""
    if first == ZONE:
        k, length = int(place), POSITION_UNITS[layout.kind]
        begin, end = (_rounded(edge, layout.edges) for edge in layout.edges[k : k + 2])
        return f"extra friction from {begin} to {end} {length}{towards}"
    if first == RIPPLE:
        return f"ripple at order {rest} per {'revolution' if layout.kind == 'rotary' else 'metre'}"
    words = {
        COULOMB: "Coulomb friction",
        VISCOUS: "viscous friction",
        BREAKAWAY: "break-away friction",
        ASYMMETRY: "asymmetry of the directions",
        LOST_MOTION: "lost motion at reversals (backlash and presliding)",
    }
    return words[first] + towards
