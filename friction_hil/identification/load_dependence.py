"""Friction that grows with the torque that the transmission carries, from the axis's own motion. Pure.

    torque = inertia a + gravity(q) + ripple(q) + friction(v) + factor abs(load) sign(v)

``load`` is the weight and the inertia of the load, as the compensator computes it. ``friction`` may be any curve of the
velocity, one for each direction, so that friction of the speed is not taken for that of the load. A factor that differs
where the load drives the motor looks like gravity and inertia themselves: one factor stands for both.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from friction_hil.compensator.load import transmitted_torque
from friction_hil.identification.compliance import sandwich
from friction_hil.identification.data import RegressionSegment
from friction_hil.numerics.jit import Array, StructuredArray, compiled

LOAD = np.dtype(
    [(name, "f8") for name in ("gravity_constant", "gravity_sine", "gravity_cosine", "load_inertia", "lead_s")]
)
_KNOTS = 7  # of the curve, over the speeds
_SLOW = 0.05  # of the highest speed: slower, bristles may not have turned
_TURNED_S = 0.02  # after such a row
_STRETCH_S = 0.25  # over which residuals are taken to be correlated
_CLEAR = 4.0  # standard errors
_FELT = 0.03  # of the friction: a smaller part is no dependence
_SHOWN = 0.1  # a factor that is below this for sure is none
_LEAST_ROWS = 200


@dataclass(frozen=True, slots=True)
class LoadDependence:
    """Extra friction per torque of the load.

    Attributes
    ----------
    factor, error : float
        And its standard error; N m per N m.
    part : float
        RMS of what the load changes of the friction, over the RMS of the friction.
    """

    factor: float
    error: float
    part: float

    @property
    def is_clear(self) -> bool:
        """True if friction depends on the load."""
        return self.factor > _CLEAR * self.error and self.part > _FELT

    @property
    def is_excluded(self) -> bool:
        """True if the load changes enough to show that friction does not grow with it."""
        return not self.is_clear and self.factor + self.error < _SHOWN


def load_torque(mechanics: Mapping[str, float], load_inertia: float, position: Array, acceleration: Array) -> Array:
    """Return the torque that the transmission carries (n,), as the compensator computes it from the demand.

    Parameters
    ----------
    mechanics : dict
        Identified; an offset counts as weight, as the motion does not tell them apart.
    load_inertia : float
        kg m^2 or kg.
    position, acceleration : (n,) array
    """
    record: StructuredArray = np.zeros(1, LOAD)
    for name in ("sine", "cosine"):
        record[0][f"gravity_{name}"] = mechanics.get(f"gravity.{name}", 0.0)
    record[0]["gravity_constant"] = mechanics.get("gravity.constant", 0.0) + mechanics.get("offset", 0.0)
    record[0]["load_inertia"] = load_inertia
    return _over_time(record, np.ascontiguousarray(position), np.ascontiguousarray(acceleration))


@compiled
def _over_time(record: StructuredArray, position: Array, acceleration: Array) -> Array:
    found = np.empty_like(position)
    for i in range(len(position)):
        found[i] = transmitted_torque(record[0], position[i], math.nan, math.nan, acceleration[i])
    return found


def find_load_dependence(
    records: Sequence[RegressionSegment],
    mechanics: Mapping[str, float],
    load_inertia: float,
    orders: Sequence[float],
) -> LoadDependence | None:
    """Find how much friction grows with the load; None if the axis slides in too few rows.

    Parameters
    ----------
    records : sequence of RegressionSegment
    mechanics : dict
        Identified mechanics: ``offset``, ``gravity.sine`` and others.
    load_inertia : float
        Inertia of the load, kg m^2 or kg; 0 if it is not known: then the weight has to change with the position.
    orders : sequence of float
        Of ripple of the torque, periods per rad or m times 2 pi.
    """
    top = max(float(np.max(np.abs(each.velocity), initial=0.0)) for each in records)
    swings = any(mechanics.get(f"gravity.{name}", 0.0) for name in ("sine", "cosine"))
    parts = []
    for each in records:
        rows = _sliding(each, _SLOW * top)
        if np.any(rows):
            columns = _columns(each, top, orders, swings=swings)
            load = load_torque(mechanics, load_inertia, each.position, each.acceleration)
            columns = np.column_stack([np.abs(load) * np.sign(each.velocity), columns])
            times = np.floor(each.reduced_time()[rows] / _STRETCH_S)
            parts.append((each.reduce(columns)[rows], each.reduced_torque()[rows], times))
    if sum(len(each[1]) for each in parts) < _LEAST_ROWS:
        return None
    columns, torque = (np.concatenate([each[k] for each in parts]) for k in (0, 1))
    norms = np.linalg.norm(columns, axis=0)
    columns, norms = columns[:, norms > 0.0], norms[norms > 0.0]
    if norms[0] == 0.0:
        return None
    factors = np.linalg.lstsq(columns / norms, torque, rcond=1e-9)[0] / norms
    starts, begin = [], 0
    for _, _, times in parts:
        starts.append(begin + np.flatnonzero(np.diff(times, prepend=np.nan)))
        begin += len(times)
    covariance = sandwich(columns, torque - columns @ factors, np.concatenate(starts))
    extra = float(factors[0]) * columns[:, 0]
    ends = 1 + int(swings) * 2 + 2 * len(orders)
    friction = extra + columns[:, 1 + ends :] @ factors[1 + ends :]
    part = float(np.std(np.abs(extra)) / np.sqrt(np.mean(friction**2)))
    return LoadDependence(float(factors[0]), math.sqrt(max(float(covariance[0, 0]), 0.0)), part)


def _sliding(record: RegressionSegment, least: float) -> NDArray[np.bool_]:
    """Return the rows of the regression in which the axis slides, and has slid for a while."""
    from scipy.ndimage import maximum_filter1d  # imported here: commands start faster without it

    reach = max(1, round(_TURNED_S * record.rate_hz))
    velocity = record.velocity
    is_slow = (np.abs(velocity) < least) | (velocity * np.roll(velocity, 1) < 0.0)
    rests = maximum_filter1d(is_slow.astype(np.uint8), 2 * reach + 1) > 0
    rows = ~np.asarray(record.kept_rows(rests))
    return rows if record.is_moving is None else rows[record.is_moving]


def _columns(record: RegressionSegment, top: float, orders: Sequence[float], *, swings: bool) -> Array:
    """Return acceleration, gravity, ripple, and hat functions of the speed in either direction (n, m)."""
    q, v = record.position, record.velocity
    waves = [1.0] if swings else []
    columns = [record.acceleration]
    columns += [wave(order * q) for order in (*waves, *orders) for wave in (np.cos, np.sin)]
    speeds = np.geomspace(_SLOW * top, top, _KNOTS)
    for k in range(_KNOTS):
        hat = np.interp(np.abs(v), speeds, np.eye(_KNOTS)[k])
        columns += [hat * (v > 0.0), -hat * (v < 0.0)]
    return np.column_stack(columns)
