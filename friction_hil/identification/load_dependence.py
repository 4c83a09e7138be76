"""Friction that grows with the torque that the transmission carries, from the axis's own motion. Pure.

    torque = inertia a + gravity(q) + ripple(q) + friction(v) + factor abs(load) sign(v)

``load`` is the weight and the inertia of the load, as the compensator computes it, and the load's own friction.
``friction`` may be any curve of the velocity, one for each direction, so that friction of the speed is not taken for
that of the load. A factor that differs where the load drives the motor looks like gravity and inertia themselves: one
factor stands for both.

Inertia and friction of the load are often not known. Each pair that they may be is tried, from none of what the axis
has to all of it. How far the factor depends on it, among the pairs that explain the torque about as well as the best,
is a part of its error. A load that its friction or weight holds against one side shows no factor: it then looks like
inertia and weight.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from friction_hil.compensator.load import transmitted_torque
from friction_hil.identification import thresholds as th
from friction_hil.identification.data import RegressionSegment
from friction_hil.identification.sliding import SlidingRows, compared, fitted, sliding_rows, top_speed
from friction_hil.numerics.jit import Array, StructuredArray, compiled

LOAD = np.dtype(
    [(name, "f8") for name in ("gravity_constant", "gravity_sine", "gravity_cosine", "load_inertia", "lead_s")]
)


@dataclass(frozen=True, slots=True)
class LoadDependence:
    """Extra friction per torque of the load."""

    factor: float  # N m per N m
    error: float  # standard error of the factor; contains what is not known of the load
    part: float  # RMS of what the load changes of the friction, over the RMS of the friction
    is_shown: bool = True  # the motion tells the factor from inertia and weight, whatever the load may be

    @property
    def is_clear(self) -> bool:
        """True if friction depends on the load."""
        return self.is_shown and self.factor > th.LOAD_CLEAR * self.error and self.part > th.FELT

    @property
    def is_excluded(self) -> bool:
        """True if the load changes enough to show that friction does not grow with it."""
        return self.is_shown and not self.is_clear and self.factor + th.SURE * self.error < th.SHOWN


def load_torque(mechanics: Mapping[str, float], load_inertia: float, position: Array, acceleration: Array) -> Array:
    """Return the torque that the transmission carries (n,), as the compensator computes it from the demand.

    ``mechanics``: identified; an offset counts as weight, as the motion does not tell them apart. ``load_inertia``:
    kg m^2 or kg. ``position`` and ``acceleration`` are (n,).
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
        found[i] = transmitted_torque(record[0], position[i], math.nan, math.nan, acceleration[i], math.nan)
    return found


def find_load_dependence(
    records: Sequence[RegressionSegment],
    mechanics: Mapping[str, float],  # identified: ``inertia``, ``offset``, ``gravity.sine`` and others
    load_inertia: float | None,  # kg m^2 or kg; None: not known: between zero and that of the axis
    orders: Sequence[float],  # of ripple of the torque, periods per rad or m times 2 pi
    *,
    load_friction: float | None = None,  # N m or N; None: not known: between zero and that of the axis
) -> LoadDependence | None:
    """Find how much friction grows with the load; None if the axis slides in too few rows."""
    parts, top = sliding_rows(records), top_speed(records)
    if not parts:
        return None
    swings = any(mechanics.get(f"gravity.{name}", 0.0) for name in ("sine", "cosine"))
    fixed = compared(parts, [_columns(each, top, orders, swings=swings) for each in parts])
    plain = fitted(parts, fixed)[0]
    ends = 1 + int(swings) * 2 + 2 * len(orders)
    # the lowest friction over the speeds, about: no load has more than that
    level = float(np.quantile(np.abs(fixed[:, ends:] @ plain[ends:]), 0.1))
    inertias = [share * plain[0] for share in th.LOAD_SHARES] if load_inertia is None else [load_inertia]
    frictions = [share * level for share in th.LOAD_SHARES] if load_friction is None else [load_friction]
    tried = [
        _with_load(parts, fixed, ends, mechanics, inertia, friction) for inertia in inertias for friction in frictions
    ]
    known = [each for each in tried if each is not None]
    if not known:
        return None
    best = min(known, key=lambda each: float(each.residual @ each.residual))
    alike = [each for each in known if best.is_hardly_better(each)]
    spread = max(abs(each.factor - best.factor) for each in alike)
    error = math.hypot(max(each.error for each in alike), spread, th.LOAD_FORM * best.factor)
    return LoadDependence(best.factor, error, best.part, all(each.is_independent for each in alike))


@dataclass(frozen=True, slots=True, eq=False)
class _Tried:
    factor: float
    error: float
    part: float
    is_independent: bool
    residual: Array
    starts: NDArray[np.intp]

    def is_hardly_better(self, other: "_Tried") -> bool:
        """True if it explains no more than another one, stretch of time by stretch, or not clearly."""
        gains = np.add.reduceat(other.residual**2 - self.residual**2, self.starts)
        return float(np.sum(gains)) <= th.WORSE * float(np.std(gains, ddof=1)) * math.sqrt(len(gains))


def _with_load(
    parts: Sequence[SlidingRows],
    fixed: Array,
    ends: int,
    mechanics: Mapping[str, float],
    inertia: float,
    friction: float,
) -> _Tried | None:
    """Fit with a load of an inertia and a friction; None if there is no load at all."""
    loads = []
    for part in parts:
        record = part.record
        # the load follows the low-passed acceleration: a faster one is the motor's
        load = load_torque(mechanics, inertia, record.position, part.low(record.acceleration))
        direction = np.sign(record.velocity)
        loads.append(np.abs(load + friction * direction) * direction)
    matrix = np.column_stack([compared(parts, loads), fixed])
    if not np.any(matrix[:, 0]):
        return None
    factors, covariance, residual, starts = fitted(parts, matrix)
    others = matrix[:, 1:] / np.maximum(np.linalg.norm(matrix[:, 1:], axis=0), 1e-300)
    left = matrix[:, 0] - others @ np.linalg.lstsq(others, matrix[:, 0], rcond=1e-9)[0]
    varies = matrix[:, 0] - np.sign(matrix[:, 0]) * np.mean(np.abs(matrix[:, 0]))
    extra = float(factors[0]) * matrix[:, 0]
    total = extra + matrix[:, 1 + ends :] @ factors[1 + ends :]
    return _Tried(
        float(factors[0]),
        math.sqrt(max(float(covariance[0, 0]), 0.0)),
        float(np.std(np.abs(extra)) / np.sqrt(np.mean(total**2))),
        float(left @ left) > th.INDEPENDENT * float(varies @ varies),
        residual,
        starts,
    )


def _columns(part: SlidingRows, top: float, orders: Sequence[float], *, swings: bool) -> Array:
    """Return acceleration, gravity, ripple, and hat functions of the speed in either direction (n, m)."""
    position = part.record.position
    waves = [1.0] if swings else []
    columns = [part.record.acceleration]
    columns += [wave(order * position) for order in (*waves, *orders) for wave in (np.cos, np.sin)]
    return np.column_stack([*columns, part.friction(top)])
