"""Conversion between the numbers on the line and SI units of the axis. Pure."""

import math
from collections.abc import Callable
from dataclasses import dataclass

_TURN = 2.0 * math.pi


@dataclass(frozen=True, slots=True)
class AxisUnits:
    """Units of an axis, from its configuration; NaN where they are not given."""

    counts_per_unit: float = math.nan  # of position, per rad (m)
    rated_torque: float = math.nan  # at 100 %, N m (N)
    torque_constant: float = math.nan  # N m (N) per ampere


# SI value of one of each unit, for an axis; NaN if the configuration does not give the factor.
UNITS: dict[str, Callable[[AxisUnits], float]] = {
    "count": lambda a: 1.0 / a.counts_per_unit,
    "count/s": lambda a: 1.0 / a.counts_per_unit,
    "rad": lambda a: 1.0,
    "rad/s": lambda a: 1.0,
    "turn": lambda a: _TURN,
    "turn/s": lambda a: _TURN,
    "deg": lambda a: _TURN / 360.0,
    "deg/s": lambda a: _TURN / 360.0,
    "rpm": lambda a: _TURN / 60.0,
    "m": lambda a: 1.0,
    "m/s": lambda a: 1.0,
    "mm": lambda a: 1e-3,
    "mm/s": lambda a: 1e-3,
    "N m": lambda a: 1.0,
    "N": lambda a: 1.0,
    "A": lambda a: a.torque_constant,
    "per_mille": lambda a: a.rated_torque / 1000.0,
    "percent": lambda a: a.rated_torque / 100.0,
    "s": lambda a: 1.0,
    "deg C": lambda a: 1.0,
    "": lambda a: 1.0,
}
NEEDS = {
    "count": "counts_per_unit",
    "count/s": "counts_per_unit",
    "A": "torque_constant",
    "per_mille": "rated_torque",
    "percent": "rated_torque",
}
POSITIONS = ("count", "rad", "turn", "deg", "m", "mm")
VELOCITIES = ("count/s", "rad/s", "turn/s", "deg/s", "rpm", "m/s", "mm/s")
TEMPERATURES = ("deg C", "")
TORQUES = ("N m", "N", "A", "per_mille", "percent")
ROTARY = ("rad", "rad/s", "turn", "turn/s", "deg", "deg/s", "rpm", "N m")
LINEAR = ("m", "m/s", "mm", "mm/s", "N")


def saturated(value: float, low: float, high: float) -> float:
    """Return the value within the bounds that is nearest to ``value``. Raises `ValueError`: the value is not finite."""
    if not math.isfinite(value):
        raise ValueError(f"{value} cannot be sent to a drive")
    return min(max(value, low), high)
