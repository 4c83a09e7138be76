"""Figures of an axis in a run: its following error, its feedback, and warnings about its compensation."""

import math

from friction_hil.compensator import Compensator

_LONGEST_GAP = 10_000  # cycles; a longer one is a fault in any configuration
_MOST_REASONS = 20
_OTHERS = "other reasons"


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


class FeedbackGaps:
    """Cycles without usable feedback that were bridged by prediction, and why there was none.

    A gap counts when feedback is there again; one that ends the run, and what is missing after that, was not bridged.

    Attributes
    ----------
    bridged : int
        Number of cycles.
    reasons : dict of str to int
        Number of these cycles by the reason that the driver gave.
    is_open : bool
        True while feedback is missing.
    """

    __slots__ = ("_gap", "bridged", "is_open", "reasons")

    def __init__(self) -> None:
        self.bridged = 0
        self.reasons: dict[str, int] = {}
        self.is_open = False  # no property: it is read in every cycle
        self._gap: list[str] = []  # reasons of the cycles since the last usable feedback

    def miss(self, reason: str) -> None:
        """Take a cycle without usable feedback."""
        self.is_open = True
        if len(self._gap) < _LONGEST_GAP:
            self._gap.append(reason)

    def close(self, *, is_bridged: bool) -> None:
        """End the gap: feedback is there again, or the run is ending."""
        if is_bridged:
            self.bridged += len(self._gap)
            for reason in self._gap:
                known = reason if reason in self.reasons or len(self.reasons) < _MOST_REASONS else _OTHERS
                self.reasons[known] = self.reasons.get(known, 0) + 1
        self._gap.clear()
        self.is_open = False


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
