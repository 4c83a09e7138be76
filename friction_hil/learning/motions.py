"""Kinds of motion, told apart by the demand alone, and what was proven for each of them.

Parameters that were judged on one motion may harm another, which passes through speeds and stretches of presliding of
its own. A kind of motion is therefore described by the range of what its demand does within spans of a quarter of a
second up to six seconds: top speed, travel, acceleration. A demand outside of these ranges is another motion; a large
difference shows in the shortest span, after a quarter of a second, whatever the period of the motion is. Rests are left
out: they say nothing, and no time without motion makes a kind another one.
"""

import math
from collections import deque
from collections.abc import Collection
from dataclasses import dataclass, replace

import numpy as np

from friction_hil.friction import FrictionModel
from friction_hil.learning import thresholds as th
from friction_hil.learning.conversion import Form, form_of
from friction_hil.learning.coordinates import Coordinates
from friction_hil.learning.estimate import MECHANICS
from friction_hil.learning.layer import Layer, between
from friction_hil.numerics.jit import Array


@dataclass(frozen=True, slots=True)
class Used:
    """What a compensator has."""

    x: Array  # (m + 3,) coordinates of its parameters, and those of the mechanics
    gain: float
    coordinates: Coordinates  # of the family of its model
    layer: Layer | None = None  # residual layer

    @property
    def own(self) -> FrictionModel:
        """The model without the layer."""
        return self.coordinates.model_at(self.x[:-MECHANICS])

    @property
    def model(self) -> FrictionModel:
        """The model with the layer."""
        return self.own if self.layer is None else self.layer.on(self.own)

    @property
    def form(self) -> Form:
        """Form of the model."""
        return form_of(self.coordinates.model)

    @property
    def parameters(self) -> dict[str, float]:
        """Parameters by name."""
        return self.coordinates.named(self.x[:-MECHANICS])

    def has_model_of(self, other: "Used") -> bool:
        """Return True if the model is that of another one."""
        is_same = self.coordinates is other.coordinates and np.array_equal(self.x, other.x)
        return is_same and self.layer == other.layer

    def towards(self, other: "Used", part: float) -> "Used":
        """Return what lies a part of the way to another one of the same family; there is nothing between families."""
        if self.coordinates is not other.coordinates:
            return other
        layer = between(self.layer, other.layer, part)
        x, gain = self.x + part * (other.x - self.x), self.gain + part * (other.gain - self.gain)
        return replace(self, x=x, gain=gain, layer=layer)


@dataclass(slots=True)
class Limit:
    """A gain above which a higher one is not tried for a while."""

    gain: float
    torque: float  # root mean square of the friction torque when it was found, N m
    left: int = th.GAIN_LIMITED  # proposals until a higher one is tried again


@dataclass(slots=True)
class Kind:
    """A kind of motion."""

    used: Used  # proven for it: the model file until something better was kept
    pause: int  # windows without a trial after the next one that is taken back
    rest: int = 0  # windows until the next trial
    # root mean square of the following error before the last trial that was taken back, SI
    refused_error: float = math.inf
    refused: Used | None = None  # what that trial tried
    limit: Limit | None = None  # gain that was kept because a higher one was no help
    # (2, spans, 3) least and most top speed, travel and mean square of the acceleration, of each span; NaN where none
    # was so long; None: the motion has just begun
    ranges: Array | None = None

    def highest_gain(self, torque: float) -> float:
        """Return the highest gain that is to be tried at a root mean square of the friction torque, N m."""
        limit = self.limit
        if limit is not None and (limit.left == 0 or abs(torque - limit.torque) > th.OTHER_FRICTION * limit.torque):
            limit = self.limit = None
        if limit is None:
            return 1.0
        limit.left -= 1
        return limit.gain


class Motions:
    """The present kind of motion, and those that were seen before.

    ``file``: for every motion that nothing was proven for. ``pause``: of a new kind.
    """

    def __init__(self, file: Used, pause: int, period_s: float) -> None:
        self._file, self._first_pause, self._rate_hz = file, pause, 1.0 / period_s
        self._parts: deque[tuple[float, ...]] = deque(maxlen=th.MOTION_PARTS * th.REMEMBERED_TICKS)
        self._velocity = math.nan  # last demanded
        self._kinds: list[Kind] = []  # the last one is that of the latest motion
        self.now = Kind(file, pause)

    def take(self, position: Array, velocity: Array) -> bool:
        """Take the demand (n,) of a tick; return True if it is of another kind: `now` is a new one."""
        before = self._velocity if math.isfinite(self._velocity) else velocity[0]
        changes = np.diff(velocity, prepend=before) * self._rate_hz
        self._velocity = float(velocity[-1])
        is_new = False
        for part in np.array_split(np.arange(position.size), min(th.MOTION_PARTS, position.size)):
            p, v = position[part], velocity[part]
            is_moving = v != 0.0
            if np.any(is_moving):
                is_new = True
                square = np.sum(changes[part][is_moving] ** 2)
                own = (np.max(np.abs(v)), np.min(p), np.max(p), square, np.count_nonzero(is_moving))
                self._parts.append(tuple(map(float, own)))
        if not is_new:
            return False
        if self.now.ranges is None:
            return self._meet()
        if _is_within(_ranges(self._parts, is_latest=True), self.now.ranges):
            return False
        self._parts.clear()
        self.now = Kind(self._file, self._first_pause)
        return True

    def keep(self, used: Used) -> None:
        """Take note that something was proven for the present motion, over all of it so far."""
        seen = _ranges(self._parts, th.SPAN_MARGIN)
        known = seen if self.now.ranges is None else self.now.ranges
        self.now.ranges = np.stack([np.fmin(known[0], seen[0]), np.fmax(known[1], seen[1])])
        self.now.used, self.now.pause = used, self._first_pause
        self._remember()

    def drop_layers(self) -> bool:
        """Take the residual layers of all motions away; return True if the present one had one."""
        is_layered = self.now.used.layer is not None
        for kind in (*self._kinds, self.now):
            if kind.used.layer is not None:
                kind.used = replace(kind.used, layer=None)
        return is_layered

    def interrupt(self) -> None:
        """Take note that rows are missing: the next ones do not continue the motion."""
        self._parts.clear()
        self._velocity = math.nan

    def _meet(self) -> bool:
        """Look whether a motion that has just begun is a known one; return True if so."""
        if len(self._parts) >= th.MOTION_PARTS * th.RECOGNISED_TICKS:
            seen = _ranges(list(self._parts)[-th.MOTION_PARTS * th.RECOGNISED_TICKS :])
            for kind in reversed(self._kinds):
                assert kind.ranges is not None
                if kind is not self.now and _is_within(seen, kind.ranges):
                    self.now = kind
                    self._remember()
                    for _ in range(len(self._parts) - th.MOTION_PARTS * th.RECOGNISED_TICKS):
                        self._parts.popleft()
                    return True
        if len(self._parts) >= th.MOTION_PARTS * th.WINDOW_TICKS:
            self.now.ranges = _ranges(self._parts, th.SPAN_MARGIN)
            self._remember()
        return False

    def _remember(self) -> None:
        self._kinds = [*(kind for kind in self._kinds if kind is not self.now), self.now][-th.MOST_KINDS :]


def _ranges(parts: Collection[tuple[float, ...]], margin: int = 0, *, is_latest: bool = False) -> Array:
    """Return least and most of each span of a motion, (2, spans, 3); or what the last span of each length is.

    ``margin``: the least is that of spans by up to so many parts shorter, the most that of longer ones: rests shift the
    parts.
    """
    rows = np.array(list(parts))
    found = np.full((2, len(th.SPANS_TICKS), 3), np.nan)
    for k, ticks in enumerate(th.SPANS_TICKS):
        if len(rows) < ticks * th.MOTION_PARTS:
            break
        own = rows[-ticks * th.MOTION_PARTS :] if is_latest else rows
        for change in range(margin + 1):  # all: a mean square is not always least for the shortest ones
            shorter, longer = (_spans(own, ticks * th.MOTION_PARTS + sign * change) for sign in (-1, 1))
            found[0, k] = np.fmin(found[0, k], shorter.min(axis=0))
            found[1, k] = np.fmax(found[1, k], longer.max(axis=0))
    return found


def _spans(rows: Array, length: int) -> Array:
    """Return top speed, travel and mean square of the acceleration of all spans of a length (of all parts if fewer)."""
    length = min(length, len(rows))
    top, low, high, square, count = np.lib.stride_tricks.sliding_window_view(rows, length, axis=0).swapaxes(0, 1)
    mean = square.sum(axis=1) / count.sum(axis=1)
    return np.column_stack([top.max(axis=1), high.max(axis=1) - low.min(axis=1), mean])


def _is_within(seen: Array, known: Array) -> bool:
    """Return True if ranges do not exceed others by more than what two motions of a kind differ by."""
    alike = np.array([1.0 - th.ALIKE, 1.0 - th.ALIKE, (1.0 - th.ALIKE) ** 2])  # the last one is a square
    is_outside = (seen[0] < alike * known[0]) | (seen[1] * alike > known[1])  # False for NaN
    return not bool(np.any(is_outside))
