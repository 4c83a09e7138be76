"""What the data show before any model is fitted: levels, speeds and deflections from which to search."""

import math

import numpy as np

from friction_hil import friction as models
from friction_hil.errors import RecordingError
from friction_hil.identification.data import Data
from friction_hil.identification.structures import TABLE_POINTS, Scales
from friction_hil.numerics.jit import Array

_DEFLECTIONS = 12  # sizes that are tried
_VELOCITIES = 10
_LEAST_LEVEL = 1e-3  # of the measured torque: friction below it still gives starts a size
_SPREAD = (1e-6, 0.1)  # of the travel: deflections that are tried
_COLLINEAR = 1e-6  # of a shape's size: what is left of one that the base makes up
_MOVING = 1e-3  # of the top speed
_BASE = ("inertia", "offset", "gravity.sine", "gravity.cosine", "viscous")


def scales(data: Data, mechanics: tuple[str, ...]) -> Scales:
    """Size up friction by regressions on shapes: linear in all but one number, which is tried over its range.

    A presliding deflection comes from Dahl's curve, which depends on nothing else but its level; a Stribeck
    velocity from the hump of the static map.

    Raises
    ------
    RecordingError
        The axis does not move, or no torque was measured.
    """
    speed = max(float(np.max(np.abs(record.velocity))) for record in data.records)
    travel = max(float(np.ptp(record.position)) for record in data.records)
    torque = float(np.sqrt(np.mean(data.torque**2)))
    path = data.records[0].path
    if not (speed > 0.0 and travel > 0.0):
        raise RecordingError(f"{path}: the axis does not move: there is nothing to identify from")
    if torque == 0.0:
        raise RecordingError(f"{path}: the measured torque is zero in every row")
    base = np.column_stack([data.column(name) for name in (*mechanics, "viscous")])
    basis = np.linalg.qr(base / np.maximum(np.linalg.norm(base, axis=0), 1e-300))[0]

    def regress(*shapes: Array) -> tuple[float, Array]:
        """Sum of squares left by the base and these shapes, and the factors of the shapes."""
        both = np.column_stack([*shapes, data.torque])
        before = np.linalg.norm(both, axis=0)
        both = both - basis @ (basis.T @ both)
        both[:, np.linalg.norm(both, axis=0) < _COLLINEAR * before] = 0.0
        found, *_ = np.linalg.lstsq(both[:, :-1], both[:, -1], rcond=None)
        return float(np.sum((both[:, -1] - both[:, :-1] @ found) ** 2)), found

    signs = [np.sign(record.velocity) for record in data.records]
    level = float(regress(data.stack(signs))[1][0])
    level = max(level, _LEAST_LEVEL * torque)

    deflections = np.geomspace(*_SPREAD, _DEFLECTIONS) * travel
    left = [regress(_dahl(data, deflection))[0] for deflection in deflections]
    best_deflections = _best(deflections, left, 2)

    velocities = np.geomspace(3e-3, 0.7, _VELOCITIES) * speed
    fits = [regress(data.stack(signs), _hump(data, velocity)) for velocity in velocities]
    # a velocity is worth a start only where its hump can be one: levels stay positive
    sane = [fit[0] if fit[1][0] > 0.0 and fit[1].sum() > 0.0 else math.inf for fit in fits]
    best_velocities = _best(velocities, sane, 2)
    hump = fits[int(np.argmin(sane))][1]
    static = float(hump.sum()) if math.isfinite(min(sane)) else level

    moving = np.concatenate([np.abs(record.velocity) for record in data.records])
    moving = moving[moving > _MOVING * speed]
    quantiles = np.quantile(moving, np.linspace(0.02, 0.98, TABLE_POINTS))
    speeds = tuple(np.maximum.accumulate(quantiles + 1e-6 * speed * np.arange(TABLE_POINTS)).tolist())
    return Scales(
        level=level,
        static_level=min(max(static, 0.2 * level), 5.0 * level),
        speed=speed,
        travel=travel,
        deflections=best_deflections,
        stribeck_velocities=best_velocities,
        speeds=speeds,
    )


def _dahl(data: Data, deflection: float) -> Array:
    """Friction of level one with a presliding deflection, reduced."""
    model = models.create("dahl", sigma0=1.0 / deflection, coulomb=1.0)
    return data.stack([model.simulate(record.velocity, record.dt) for record in data.records])


def _hump(data: Data, velocity: float) -> Array:
    return data.stack(
        [np.sign(record.velocity) * np.exp(-((record.velocity / velocity) ** 2)) for record in data.records]
    )


def _best(candidates: Array, left: list[float], count: int) -> tuple[float, ...]:
    """The best candidates that are local minima, best first; at least one."""
    order = np.argsort(left, kind="stable")
    chosen: list[int] = []
    for i in order:
        is_lowest = all(left[i] <= left[j] for j in (i - 1, i + 1) if 0 <= j < len(left))
        if is_lowest or not chosen:
            chosen.append(int(i))
    return tuple(float(candidates[i]) for i in chosen[:count])
