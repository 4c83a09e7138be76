"""Friction table: points of torque over speed per direction, as drives and machine controllers store it."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from friction_hil.friction.curves import direction, modified, sticking
from friction_hil.friction.elementary import buffer, part, whole
from friction_hil.friction.family import Family, Packed
from friction_hil.friction.parameters import Choice, InvalidParameterError, PointList
from friction_hil.numerics.dual import primal
from friction_hil.numerics.jit import Array, inlined

MAX_POINTS = 64  # per direction
_ROOM = MAX_POINTS + 2
_HEAD = 3  # values before the points: 1 if linear, number of points forward, and backward (0: same as forward)
_INTERPOLATIONS = ("monotone", "linear")

_POINTS = PointList(
    "points", "(v, F)", "rad/s, N m", "speed and torque; points of one direction serve for both", most=2 * MAX_POINTS
)
_INTERPOLATION = Choice(
    "interpolation",
    "",
    "",
    "curve between the points; monotone is smooth and does not overshoot",
    words=_INTERPOLATIONS,
    default="monotone",
)


@inlined
def _inner_slope(h0: float, h1: float, d0: float, d1: float) -> float:
    """Compute the slope at an inner point: weighted harmonic mean of the slopes d over lengths h, 0 at an extremum."""
    if d0 * d1 <= 0.0:
        return 0.0 * d0
    w0, w1 = 2.0 * h1 + h0, h1 + 2.0 * h0
    return (w0 + w1) / (w0 / d0 + w1 / d1)


@inlined
def _end_slope(h0: float, h1: float, d0: float, d1: float) -> float:
    """Compute the slope at an end: that of the parabola through three points, limited against overshoot."""
    slope = ((2.0 * h0 + h1) * d0 - h0 * d1) / (h0 + h1)
    if slope * d0 <= 0.0:
        return 0.0 * d0
    if d0 * d1 <= 0.0 and abs(slope) > 3.0 * abs(d0):
        return 3.0 * d0
    return slope


@inlined
def _interval(x: Array, n: int, at: float) -> int:
    """Return the index of the last of ``n`` ascending ``x`` that is not above ``at``; 0 if all are above."""
    low, high = 0, n
    while high - low > 1:
        middle = (low + high) // 2
        if x[middle] <= at:
            low = middle
        else:
            high = middle
    return low


@inlined
def _coefficients(x: Array, y: Array, n: int, is_linear: bool, low: int) -> tuple[float, float, float]:
    """Compute the coefficients of `_curve` for the piece that begins at point ``low``; constant beyond the last point.

    Monotone: piecewise cubic, Fritsch and Butland, SIAM Journal on Scientific and Statistical Computing 5(2), 1984.
    """
    zero = 0.0 * y[low]
    high = low + 1
    if high == n:
        return zero, zero, zero
    h = x[high] - x[low]
    d = (y[high] - y[low]) / h
    if is_linear or n == 2:
        return d, zero, zero
    if low > 0:
        h_before = x[low] - x[low - 1]
        left = _inner_slope(h_before, h, (y[low] - y[low - 1]) / h_before, d)
    else:
        left = _end_slope(h, x[2] - x[1], d, (y[2] - y[1]) / (x[2] - x[1]))
    if high < n - 1:
        h_after = x[high + 1] - x[high]
        right = _inner_slope(h, h_after, d, (y[high + 1] - y[high]) / h_after)
    else:
        right = _end_slope(h, x[n - 2] - x[n - 3], d, (y[n - 2] - y[n - 3]) / (x[n - 2] - x[n - 3]))
    return left, (3.0 * d - 2.0 * left - right) / h, (left + right - 2.0 * d) / (h * h)


@inlined
def _curve(y: float, linear: float, quadratic: float, cubic: float, u: float) -> float:
    """Evaluate a piece at the speed ``u`` above its first point."""
    return y + u * (linear + u * (quadratic + u * cubic))


@inlined
def _level(p: Array, velocity: float, sign: float) -> float:
    """Compute the absolute torque of the table for motion in the direction ``sign``."""
    forward, backward = whole(p[1]), whole(p[2])
    begin, n = _HEAD, forward
    if sign < 0.0 and backward > 0:
        begin, n = _HEAD + 2 * forward, backward
    x, y, at = part(p, begin), part(p, begin + n), abs(velocity)
    if at <= x[0]:
        return y[0]
    low = _interval(x, n, at)
    linear, quadratic, cubic = _coefficients(x, y, n, p[0] > 0.0, low)
    return _curve(y[low], linear, quadratic, cubic, at - x[low])


@inlined
def step(
    p: Array,
    s: Array,
    velocity: float,
    level_velocity: float,
    dt: float,
    extra: float,
    scale: float,
    applied_torque: float,
    epsilon: float,
) -> float:
    """Compute the torque of one sample; see `friction_hil.friction.kernel`."""
    if velocity == 0.0 and epsilon == 0.0:
        level = modified(_level(p, 0.0, direction(applied_torque, 0.0)), extra, scale)
        return sticking(applied_torque, level)
    sign = direction(velocity, 0.0)
    level = modified(_level(p, level_velocity, sign), extra, scale)
    if epsilon == 0.0:
        return level * sign
    jump = modified(_level(p, 0.0, sign), extra, scale)
    return jump * direction(velocity, epsilon) + (level - jump) * sign


@inlined
def _tabulate(p: Array, begin: int, n: int, first: int, start: Array, pieces: Array) -> None:
    """Fill in the pieces of one direction from index ``first``: a constant one below the first point, then ``n``.

    ``start`` is filled with the speeds at which they begin and infinity, ``pieces`` with the arguments of `_curve`.
    """
    x, y = part(p, begin), part(p, begin + n)
    start[first], start[first + n + 1] = 0.0, math.inf
    pieces[4 * first] = y[0]
    for j in range(1, 4):
        pieces[4 * first + j] = 0.0 * y[0]
    for i in range(n):
        linear, quadratic, cubic = _coefficients(x, y, n, p[0] > 0.0, i)
        piece = first + 1 + i
        start[piece] = primal(x[i])
        pieces[4 * piece] = y[i]
        pieces[4 * piece + 1] = linear
        pieces[4 * piece + 2] = quadratic
        pieces[4 * piece + 3] = cubic


@inlined
def run(p: Array, s: Array, velocity: Array, dt: float, applied_torque: float, torque: Array) -> bool:
    """Fill ``torque`` for every sample, with the same bits as `step`; return True if every velocity is finite.

    The coefficients are computed once, and the piece is searched only if a sample leaves that of the previous one.
    """
    stuck = sticking(applied_torque, modified(_level(p, 0.0, direction(applied_torque, 0.0)), 0.0, 1.0))
    forward, backward = whole(p[1]), whole(p[2])
    start, pieces = np.empty(2 * _ROOM), buffer(p, 8 * _ROOM)
    _tabulate(p, _HEAD, forward, 0, start, pieces)
    other = 0
    if backward > 0:
        other = _ROOM
        _tabulate(p, _HEAD + 2 * forward, backward, other, start, pieces)
    side = i = 0
    is_finite = True
    for k in range(velocity.shape[0]):
        v = velocity[k]
        is_finite &= math.isfinite(v)
        speed = abs(v)
        wanted = other if v < 0.0 else 0
        if side != wanted or speed < start[i] or speed >= start[i + 1]:
            side = wanted
            i = side + _interval(part(start, side), (backward if side > 0 else forward) + 1, speed)
        level = _curve(pieces[4 * i], pieces[4 * i + 1], pieces[4 * i + 2], pieces[4 * i + 3], speed - start[i])
        torque[k] = stuck if v == 0.0 else modified(level, 0.0, 1.0) * direction(v, 0.0)
    return is_finite


@inlined
def steady(p: Array, velocity: float, extra: float, scale: float) -> float:
    """Compute the torque at constant ``velocity``; 0 at rest."""
    sign = direction(velocity, 0.0)
    return modified(_level(p, velocity, sign), extra, scale) * sign


def _sides(parameters: Mapping[str, Any]) -> tuple[list[tuple[int, float, float]], list[tuple[int, float, float]]]:
    """Return the forward and backward points by increasing speed, as (index in the list, abs(v), abs(torque))."""
    points = list(enumerate(parameters["points"]))
    forward = sorted(((i, v, f) for i, (v, f) in points if v >= 0.0), key=lambda point: point[1])
    backward = sorted(((i, -v, -f) for i, (v, f) in points if v < 0.0), key=lambda point: point[1])
    return forward, backward


def _check(parameters: Mapping[str, Any]) -> None:
    for name, side in zip(("forward", "backward"), _sides(parameters), strict=True):
        if len(side) > MAX_POINTS:
            raise InvalidParameterError(
                f"table: {len(side)} {name} points are too many; at most {MAX_POINTS} are allowed", "points"
            )
        for number, speed, torque in side:
            if torque < 0.0:
                raise InvalidParameterError(
                    f"table: points[{number}] has torque and velocity of opposite sign; friction opposes motion, so "
                    "the two must have the same sign",
                    "points",
                )
            if sum(other == speed for _, other, _ in side) > 1:
                raise InvalidParameterError(
                    f"table: points[{number}] repeats the velocity {speed:g} of another point", "points"
                )


def _pack(parameters: Mapping[str, Any]) -> Packed:
    forward, backward = _sides(parameters)
    sides = [(forward, 1.0), (backward, -1.0)]
    if not forward:
        sides.reverse()
    values = [float(parameters["interpolation"] == "linear"), *(float(len(side)) for side, _ in sides)]
    names: list[str | None] = [None] * len(values)
    factors = [1.0] * len(values)
    for side, factor in sides:
        values += [speed for _, speed, _ in side] + [torque for _, _, torque in side]
        names += [None] * len(side) + [f"points[{number}]" for number, _, _ in side]
        factors += [factor] * (2 * len(side))
    return Packed(values, names, factors)


FAMILY = Family(
    name="table",
    summary="points of torque over speed per direction, with a curve between them",
    formula=(
        "F = T(|v|) sgn v, T interpolated between the points and constant beyond them;  "
        "at rest F balances the applied torque up to T(0)"
    ),
    source="interpolation: Fritsch, Butland, SIAM Journal on Scientific and Statistical Computing 5(2), 1984",
    parameters=(_POINTS, _INTERPOLATION),
    states=(),
    example={"points": [[0.02, 0.115], [0.1, 0.105], [0.3, 0.088], [1.0, 0.083], [3.0, 0.087], [10.0, 0.1]]},
    check=_check,
    pack=_pack,
    level=lambda p: max(side[0][2] for side in _sides(p) if side),
)
