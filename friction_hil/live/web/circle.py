"""Radius error of the circle that two axes draw, over the last lap. Pure."""

import itertools
from dataclasses import dataclass

import numpy as np

from friction_hil.analysis.circularity import RingScale, deviation, is_circle, ring_scale
from friction_hil.analysis.following import SETTLE_S, recovery
from friction_hil.config import Circle
from friction_hil.daemon.safety import LoopState
from friction_hil.live import LiveFacts, Rows
from friction_hil.live.following_error import missed_before, motion_columns
from friction_hil.numerics.jit import Array

_MOST_POINTS = 2000  # of a lap
_LEAST_SHARE = 0.5  # of its points that must be usable


@dataclass(frozen=True, slots=True, eq=False)
class LiveCircle:
    """The last lap."""

    axes: tuple[str, str]  # the first is drawn to the right, the second upwards
    circle: Circle
    # (n,) rad, from the first axis towards the second; in the order of the motion; empty as long as there is no whole
    # lap in steady motion
    angle: Array
    error: Array  # (n,) measured minus nominal radius, rad or m
    scale: RingScale
    compensated: float  # share of the lap in which the compensation of both axes was in force


class CircleTracer:
    """Follows the circle of two axes."""

    def __init__(self, facts: LiveFacts, axes: tuple[str, str], circle: Circle) -> None:
        self._axes, self._circle = axes, circle
        self._lap = 1.0 / (circle.frequency * facts.period_s)  # cycles
        self._step = max(1, int(self._lap / _MOST_POINTS))
        self._steady_after = (facts.ramp_s + SETTLE_S) / facts.period_s
        self._period_s = facts.period_s
        self._counts_from = -np.inf  # cycle
        self._cycle = np.nan  # the last one
        self._begun = np.nan  # cycle in which steady motion began
        self._was_running = False
        self._kept = np.empty((0, 6))  # cycle, position and demand of both axes, 1 where both are compensated

    def take(self, rows: Rows, lost: int) -> None:
        """Take further rows, before which ``lost`` rows did not get here."""
        if not len(rows):
            return
        cycle = rows.of(self._axes[0], "cycle")
        motion = [motion_columns(rows, axis) for axis in self._axes]
        is_running = motion[0]["state"] == LoopState.RUNNING
        is_fresh, is_on = (
            np.all([each[name] == 1.0 for each in motion], axis=0) for name in ("is_fresh", "is_enabled")
        )
        waits = recovery(missed_before(cycle, self._cycle, lost), is_fresh, self._period_s)
        waits = np.where(np.diff(is_running, prepend=self._was_running), self._steady_after, waits)
        counts_from = np.maximum.accumulate(np.maximum(cycle + waits, self._counts_from))
        is_used = is_running & is_fresh & (cycle >= counts_from) & (cycle % self._step == 0.0)
        positions = [each[name] for each in motion for name in ("position", "position_demand")]
        table = np.stack([cycle, *positions, is_on], axis=1)
        kept = np.concatenate([self._kept, table[is_used & np.isfinite(table).all(axis=1)]])
        self._counts_from, self._cycle, self._was_running = (
            float(counts_from[-1]),
            float(cycle[-1]),
            bool(is_running[-1]),
        )
        self._kept = kept[kept[:, 0] > cycle[-1] - self._lap] if self._was_running else kept[:0]
        if not len(self._kept):
            self._begun = np.nan
        elif np.isnan(self._begun):
            self._begun = float(self._kept[0, 0])

    def figures(self) -> LiveCircle:
        """Return the last lap."""
        kept, radius = self._kept, self._circle.radius
        nothing = LiveCircle(self._axes, self._circle, np.empty(0), np.empty(0), ring_scale(radius, 0.0, radius), 0.0)
        is_whole = len(kept) > 0 and kept[-1, 0] - self._begun + self._step >= self._lap
        if not is_whole or len(kept) < _LEAST_SHARE * self._lap / self._step:
            return nothing
        turn, is_steady = 2.0 * np.pi * kept[:, 0] / self._lap, np.ones(len(kept), dtype=bool)
        across, up = (
            deviation({"position": kept[:, k], "position_demand": kept[:, k + 1]}, turn, is_steady) for k in (1, 3)
        )
        error = np.hypot(across, up) - radius
        scale = ring_scale(radius, float(error.min()), float(error.max()))
        return LiveCircle(self._axes, self._circle, np.arctan2(up, across), error, scale, float(kept[:, 5].mean()))


def circle_tracer(facts: LiveFacts) -> CircleTracer | None:
    """Return what follows the circle of a daemon; None if no two axes draw one."""
    given = {name: axis["trajectory"] for name, axis in facts.configuration["axes"].items()}
    circles = {name: Circle.model_validate(each) for name, each in given.items() if each["kind"] == "circle"}
    for first, second in itertools.combinations(circles, 2):
        if is_circle(circles[first], circles[second]):
            return CircleTracer(facts, (first, second), circles[first])
    return None
