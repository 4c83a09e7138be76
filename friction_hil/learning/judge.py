"""Comparison of an axis's errors before and after a change, on the same work."""

import math
from dataclasses import dataclass, replace

import numpy as np

from friction_hil.learning import thresholds as th
from friction_hil.numerics.jit import Array

CHANCE = "no more than chance"


@dataclass(frozen=True, slots=True)
class Work:
    """What an axis did for a while, and how well."""

    speed: float  # root mean square of the demanded motion, SI
    acceleration: float  # the same
    travel: float  # range of the demanded positions
    top_speed: float
    rms: float  # of the following error, SI
    peak: float  # the same
    worst: tuple[float, ...]  # largest root mean square within each of the spans that harm is judged by
    effort: float  # root mean square of the compensation, N m
    scatter: float  # standard error of the mean square of the following error, from second to second

    @property
    def is_moving(self) -> bool:
        """True if there was a demanded motion."""
        return self.speed > 0.0

    def scaled(self, factor: float) -> "Work":
        """Return the same work with errors that are so many times as large."""
        return replace(
            self,
            rms=factor * self.rms,
            peak=factor * self.peak,
            worst=tuple(factor * each for each in self.worst),
            scatter=factor**2 * self.scatter,
        )

    def is_like(self, other: "Work") -> bool:
        """True if the motion was that of ``other``."""
        return all(
            abs(mine - theirs) <= th.ALIKE * max(mine, theirs)
            for mine, theirs in (
                (self.speed, other.speed),
                (self.acceleration, other.acceleration),
                (self.travel, other.travel),
                (self.top_speed, other.top_speed),
            )
        )


def work_of(error: Array, position_demand: Array, velocity_demand: Array, compensation: Array, period_s: float) -> Work:
    """Return what rows (n,) of an axis show, of whose following errors those (k,) that are given count."""
    halves = max(round(0.5 / period_s), 1)
    squares = [np.mean(error[k : k + 2 * halves] ** 2) for k in range(0, max(error.size - halves, 1), 2 * halves)]
    return Work(
        speed=rms(velocity_demand),
        acceleration=rms(np.diff(velocity_demand)) / period_s,
        travel=float(np.ptp(position_demand)),
        top_speed=float(np.max(np.abs(velocity_demand))),
        rms=rms(error),
        peak=float(np.max(np.abs(error))),
        worst=tuple(_worst(error, round(span / period_s)) for span in th.HARM_SPANS_S),
        effort=rms(compensation),
        scatter=float(np.std(squares, ddof=1) / math.sqrt(len(squares))) if len(squares) > 1 else 0.0,
    )


def no_help(error: Array, before: Work, period_s: float) -> tuple[float, float] | None:
    """Return the errors before and since a part of a change if the latest are not below those before, else None.

    With part a of a change the mean square of the error is c - 2 b a + d a^2: if a third does not lower it, the whole
    raises it.
    """
    now = rms(error[-round(th.HARM_SPANS_S[1] / period_s) :])
    return (before.worst[1], now) if now > before.worst[1] else None


def is_harmful(error: Array, before: Work, resolution: float, period_s: float) -> bool:
    """Return True if the latest errors exceed all before.

    ``error``: (n,) following error since a change, SI. ``before``: without the change. ``resolution``: step of the
    position, SI.
    """
    for span_s, factor, worst in zip(th.HARM_SPANS_S, th.HARMS, before.worst, strict=True):
        rows = round(span_s / period_s)
        if rows > error.size:
            break
        if rms(error[-rows:]) > factor * max(worst, resolution / math.sqrt(12.0)):
            return True
    return False


def objection(after: Work, before: Work, resolution: float) -> str:
    """Return why a change did not help; empty if the errors are clearly lower, not by chance, and at no expense."""
    floor = resolution / math.sqrt(12.0)
    gained = before.rms**2 - after.rms**2
    is_effort_higher = after.effort > th.EFFORT_GROWS * before.effort
    needed = th.CLEARLY_LOWER if is_effort_higher else th.HELPS
    if max(after.rms, floor) >= needed * max(before.rms, floor):
        return "more effort for no less error" if is_effort_higher else "no gain"
    allowed = min(th.PEAK_GROWS * math.sqrt(max(before.rms, floor) / max(after.rms, floor)), th.MOST_PEAK_GROWS)
    if after.peak > allowed * before.peak + 2.0 * resolution:
        return f"the peak rose to {after.peak / before.peak:.1f} times what it was" if before.peak else "the peak rose"
    if gained < math.hypot(before.scatter, after.scatter):
        return CHANCE
    return ""


def rms(values: Array) -> float:
    """Return the root mean square of values (n,); 0 if there are none."""
    return float(np.sqrt(np.mean(values**2))) if values.size else 0.0


def _worst(error: Array, rows: int) -> float:
    """Return the largest root mean square within so many rows."""
    sums = np.concatenate([[0.0], np.cumsum(error * error)])
    rows = max(min(rows, error.size), 1)
    return math.sqrt(max(float(np.max(sums[rows:] - sums[:-rows])), 0.0) / rows)
