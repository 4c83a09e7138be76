"""Friction level, speeds and deflections estimated from the data before any model is fitted; searches start there."""

import math

import numpy as np

from friction_hil import friction as models
from friction_hil.errors import RecordingError
from friction_hil.identification import thresholds as th
from friction_hil.identification.data import Data, moved_since_reversal
from friction_hil.identification.least_squares import scaled_solution
from friction_hil.identification.structures import TABLE_POINTS, InitialScales
from friction_hil.numerics.jit import Array

_COLLINEAR = 1e-6  # of a regressor's norm: a smaller remainder outside the span of the base is rounding


def estimate_scales(data: Data, mechanics: tuple[str, ...]) -> InitialScales:
    """Estimate the scales of friction by linear regressions, with one nonlinear number tried over its range.

    The presliding deflection comes from Dahl's curve, whose only other parameter is its level, and the Stribeck
    velocity from the hump of the static curve. Raises `RecordingError`: the axis does not move, or no torque was
    measured.
    """
    speed = max(float(np.max(np.abs(record.velocity))) for record in data.records)
    travel = max(float(np.ptp(record.position)) for record in data.records)
    torque = float(np.sqrt(np.mean(data.torque**2)))
    path = data.records[0].path
    if not (speed > 0.0 and travel > 0.0):
        raise RecordingError(f"{path}: the axis does not move: there is nothing to identify from")
    if torque == 0.0:
        raise RecordingError(f"{path}: the measured torque is zero in every row")
    base = _Base(data, mechanics)
    sign = data.stack([np.sign(record.velocity) for record in data.records])
    level = max(float(base.regress(sign)[1][0]), th.LEAST_LEVEL * torque)
    deflections = np.geomspace(*th.SPREAD, th.DEFLECTIONS) * travel
    left = [base.regress(_dahl(data, deflection))[0] for deflection in deflections]
    static, stribeck_velocities = _stribeck(data, base, sign, level, speed)
    return InitialScales(
        level=level,
        static_level=min(max(static, 0.2 * level), 5.0 * level),
        speed=speed,
        travel=travel,
        deflections=_best(deflections, left, 2),
        stribeck_velocities=stribeck_velocities,
        speeds=_table_speeds(data, speed),
        least_sliding_speed=_least_sliding_speed(data, th.SLIDING * _best(deflections, left, 1)[0], speed),
        largest=max(_largest(data, mechanics, sign), level),
    )


class _Base:
    """Linear regression with mechanics and viscous friction projected out."""

    def __init__(self, data: Data, mechanics: tuple[str, ...]) -> None:
        self._torque = data.torque
        columns = np.column_stack([data.column(name) for name in (*mechanics, "viscous")])
        self._basis = np.linalg.qr(columns / np.maximum(np.linalg.norm(columns, axis=0), 1e-300))[0]

    def regress(self, *regressors: Array) -> tuple[float, Array]:
        """Return the sum of squares left by the base and these regressors, and the regressors' coefficients."""
        both = np.column_stack([*regressors, self._torque])
        before = np.linalg.norm(both, axis=0)
        both = both - self._basis @ (self._basis.T @ both)
        both[:, np.linalg.norm(both, axis=0) < _COLLINEAR * before] = 0.0
        found, *_ = np.linalg.lstsq(both[:, :-1], both[:, -1], rcond=None)
        return float(np.sum((both[:, -1] - both[:, :-1] @ found) ** 2)), found


def _stribeck(data: Data, base: _Base, sign: Array, level: float, speed: float) -> tuple[float, tuple[float, ...]]:
    """Return the level at standstill and the best Stribeck velocities."""
    velocities = np.geomspace(3e-3, 0.7, th.SCALES_VELOCITIES) * speed
    fits = [base.regress(sign, _hump(data, velocity)) for velocity in velocities]
    # start only from velocities whose fitted levels are positive
    left = [fit[0] if fit[1][0] > 0.0 and fit[1].sum() > 0.0 else math.inf for fit in fits]
    hump = fits[int(np.argmin(left))][1]
    static = float(hump.sum()) if math.isfinite(min(left)) else level
    return static, _best(velocities, left, 2)


def _table_speeds(data: Data, speed: float) -> tuple[float, ...]:
    """Return increasing speeds for the points of a table: quantiles of the speed in motion.

    Only rows that count are asked: nothing would determine the torque of a point that is slower than all of them.
    """
    moving = np.concatenate(
        [
            np.abs(record.velocity if record.is_moving is None else record.reduce_smooth(record.velocity))
            for record in data.records
        ]
    )
    moving = moving[moving > th.SCALES_MOVING * np.max(moving)]
    if not len(moving):
        raise RecordingError(f"{data.records[0].path}: the axis does not move in any row that counts")
    quantiles = np.quantile(moving, np.linspace(0.02, 0.98, TABLE_POINTS))
    return tuple(np.maximum.accumulate(quantiles + 1e-6 * speed * np.arange(TABLE_POINTS)).tolist())


def _least_sliding_speed(data: Data, distance: float, top: float) -> float:
    """Return the speed that the axis exceeds, except for a small part of the time, where it slides.

    It slides where it has moved by ``distance`` since the last reversal; before that the torque shows presliding, not
    the level at that speed. A parameter of the Stribeck curve is known only from rows in which the axis slides. A
    coarse encoder shows no speed in many of these rows: slower than `th.SCALES_MOVING` the axis does not move.
    """
    found, total = [], 0
    for record in data.records:
        rows = slice(record.begin, record.end)
        velocity, position = record.velocity[rows], record.position[rows]
        speeds = np.abs(velocity[moved_since_reversal(velocity, position) > distance])
        if record.is_moving is not None:  # only faster rows count
            speeds = speeds[speeds >= np.min(np.abs(record.reduce_smooth(record.velocity)))]
        found.append(speeds)
        total += len(velocity)
    slid = np.sort(np.concatenate(found))
    least = float(slid[min(int(th.SCALES_LEAST_SHARE * total), len(slid) - 1)]) if len(slid) else top
    return max(least, th.SCALES_MOVING * top)


def _largest(data: Data, mechanics: tuple[str, ...], sign: Array) -> float:
    """Return the largest torque that is left without mechanics, apart from outliers."""
    columns = np.column_stack([*(data.column(name) for name in mechanics), data.column("viscous"), sign])
    factors = scaled_solution(columns, data.torque)
    friction = data.torque - columns[:, : len(mechanics)] @ factors[: len(mechanics)]
    return float(np.quantile(np.abs(friction), th.LARGEST))


def _dahl(data: Data, deflection: float) -> Array:
    """Return the reduced torque of Dahl's model of level 1 with a presliding deflection."""
    model = models.create("dahl", sigma0=1.0 / deflection, coulomb=1.0)
    return data.stack([model.simulate(record.velocity, record.dt) for record in data.records])


def _hump(data: Data, velocity: float) -> Array:
    return data.stack(
        [np.sign(record.velocity) * np.exp(-((record.velocity / velocity) ** 2)) for record in data.records]
    )


def _best(candidates: Array, left: list[float], count: int) -> tuple[float, ...]:
    """Return the best local minima among the candidates, best first; at least one."""
    order = np.argsort(left, kind="stable")
    chosen: list[int] = []
    for i in order:
        is_lowest = all(left[i] <= left[j] for j in (i - 1, i + 1) if 0 <= j < len(left))
        if is_lowest or not chosen:
            chosen.append(int(i))
    return tuple(float(candidates[i]) for i in chosen[:count])
