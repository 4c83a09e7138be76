"""Figures of an axis in a run: its following error, and warnings about its compensation."""

import math

from friction_hil.compensator import Compensator


class FollowingError:
    """RMS and peak of the following error, accumulated cycle by cycle."""

    __slots__ = ("_count", "_sum", "peak")

    def __init__(self) -> None:
        self._count = 0
        self._sum = 0.0
        self.peak = 0.0

    def add(self, error: float) -> None:
        """Add one cycle's error."""
        self._count += 1
        self._sum += error * error
        self.peak = max(self.peak, abs(error))

    @property
    def rms(self) -> float:
        """Root mean square; NaN without any cycle."""
        return math.sqrt(self._sum / self._count) if self._count else math.nan


class CompensationNotices:
    """Warnings about the compensation of one axis: lowered gain, and a network beyond its trained speed.

    Parameters
    ----------
    name, unit : str
        Name of the axis; unit of its position, ``rad`` or ``m``.
    compensator : Compensator
    """

    __slots__ = (
        "_gain_factor",
        "_name",
        "_network",
        "_trained_speed",
        "_unit",
    )

    def __init__(self, name: str, unit: str, compensator: Compensator) -> None:
        self._name, self._unit = name, unit
        self._network = compensator.model.network
        self._trained_speed = math.inf if self._network is None else self._network.speed_limit
        self._gain_factor = 1.0

    def next(self, compensator: Compensator, velocity: float) -> str | None:
        """Return the warning of this cycle, given the estimated velocity; each once, and None in most cycles."""
        if compensator.gain_factor != self._gain_factor:
            self._gain_factor = compensator.gain_factor
            return (
                f"{self._name}: the axis oscillates by its own compensation (limit cycle, over-compensation): the "
                f"gain is now {self._gain_factor:.0%} of the configured one"
            )
        if self._network is not None and abs(velocity) > self._trained_speed:
            limit, self._trained_speed = self._trained_speed, math.inf
            return (
                f"{self._name}: faster than the {limit:g} {self._unit}/s that the network was trained for; beyond, "
                f"{self._network.beyond}"
            )
        return None
