"""Friction where the axis slides: Coulomb and viscous for each direction, ripple, and friction over the position. Pure.

    torque = inertia a + coulomb sgn(v) + viscous v + ripple(q)

with parameters of their own for each direction is linear. Both sides pass the low-pass of
`friction_hil.identification.sliding`, which leaves out presliding. Standard errors allow for correlated residuals
(Newey and West 1987, `friction_hil.identification.inference`).
"""

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from friction_hil.health import thresholds as th
from friction_hil.health.observation import ASYMMETRY, COULOMB, DIRECTIONS, RIPPLE, VISCOUS, ZONE, Layout, Quantity
from friction_hil.identification.inference import infer
from friction_hil.identification.least_squares import scaled_solution
from friction_hil.identification.regression import Estimate
from friction_hil.identification.sliding import SlidingRows, compared
from friction_hil.numerics.jit import Array

_INERTIA = "inertia"
_RANK = 1e-9
_SEVERAL = "hold several constant speeds up to the top speed, in this direction"


@dataclass(frozen=True, slots=True)
class SlidingFit:
    """Result of a fit."""

    quantities: dict[str, Quantity]
    not_shown: dict[str, str]  # motion that would show the quantity, by its name
    inertia: float
    # friction of slow sliding in each direction, N m or N, which is above zero unless gravity is greater; empty if not
    # known
    levels: dict[str, float]


def fit_sliding(parts: Sequence[SlidingRows], layout: Layout) -> SlidingFit:
    """Fit friction to the rows in which the axis slides."""
    names, columns = _columns(parts, layout)
    matrix = compared(parts, columns)
    torque = np.concatenate([part.torque for part in parts])
    values, errors, residual = _fitted(matrix, torque, names, [len(part.rows) for part in parts])
    position = np.concatenate([part.compared(part.record.position) for part in parts])
    velocity = np.concatenate([part.compared(part.record.velocity) for part in parts])
    friction = float(np.mean(np.abs(torque - values[_INERTIA] * matrix[:, 0])))
    speed = float(np.max(np.abs(velocity)))
    quantities: dict[str, Quantity] = {}
    not_shown: dict[str, str] = {}
    for direction, sign in zip(DIRECTIONS, (1.0, -1.0), strict=True):
        pair = {f"{COULOMB}.{direction}": 1.0, f"{VISCOUS}.{direction}": speed}
        is_seen = np.count_nonzero(sign * velocity > 0.0) >= th.LEAST_ROWS
        for name, arm in pair.items():
            if is_seen and arm * errors[name] <= th.VAGUE * friction:
                quantities[name] = Quantity(values[name], errors[name])
            else:
                not_shown[name] = _SEVERAL
    _add_ripple(values, errors, friction, position, layout, quantities, not_shown)
    levels = {d: quantities[f"{COULOMB}.{d}"].value for d in DIRECTIONS if f"{COULOMB}.{d}" in quantities}
    if len(levels) == len(DIRECTIONS):
        doubts = [quantities[f"{COULOMB}.{d}"].error for d in DIRECTIONS]
        half = 0.5 * (levels["positive"] - levels["negative"])
        quantities[ASYMMETRY] = Quantity(half, 0.5 * math.hypot(*doubts))
    else:
        not_shown[ASYMMETRY] = "slide at several constant speeds in both directions"
    _add_zones(parts, position, velocity, residual, levels, quantities, not_shown, layout)
    return SlidingFit(quantities, not_shown, values[_INERTIA], levels)


def _columns(parts: Sequence[SlidingRows], layout: Layout) -> tuple[list[str], list[Array]]:
    names = [_INERTIA]
    for direction in DIRECTIONS:
        names += [f"{COULOMB}.{direction}", f"{VISCOUS}.{direction}"]
    for order in layout.orders:
        names += [f"{RIPPLE}.{order:g}.cosine", f"{RIPPLE}.{order:g}.sine"]
    columns = []
    for part in parts:
        velocity, position = part.record.velocity, part.record.position
        own: list[Any] = [part.record.acceleration]
        for sign in (1.0, -1.0):
            towards = sign * velocity > 0.0
            own += [sign * towards, velocity * towards]
        for wave in layout.wave_numbers:
            own += [np.cos(wave * position), np.sin(wave * position)]
        columns.append(np.column_stack(own))
    return names, columns


def _fitted(
    matrix: Array, torque: Array, names: Sequence[str], counts: Sequence[int]
) -> tuple[dict[str, float], dict[str, float], Array]:
    """Return values and standard errors by name, and the residual; errors are infinite for what is not determined."""
    factors = scaled_solution(matrix, torque, _RANK)
    residual = torque - matrix @ factors
    values = dict(zip(names, map(float, factors), strict=True))
    estimate = Estimate(
        values=values,
        coordinates=np.empty(0),
        at_bound=(),
        dependent=(),
        residual=residual,
        jacobian=matrix,
        names=tuple(names),
        weights=np.ones(len(torque)),
        is_converged=True,
    )
    ends = itertools.pairwise(itertools.accumulate(counts, initial=0))
    return values, infer(estimate, [slice(*each) for each in ends]).standard_errors, residual


def _add_ripple(
    values: Mapping[str, float],
    errors: Mapping[str, float],
    friction: float,
    position: Array,
    layout: Layout,
    quantities: dict[str, Quantity],
    not_shown: dict[str, str],
) -> None:
    travel = float(np.ptp(position))
    for order, wave in zip(layout.orders, layout.wave_numbers, strict=True):
        name = f"{RIPPLE}.{order:g}"
        pair = [f"{name}.{each}" for each in ("cosine", "sine")]
        error = math.hypot(*(errors[each] for each in pair)) / math.sqrt(2.0)
        if wave * travel >= math.tau and error <= th.VAGUE * friction:
            quantities[name] = Quantity(math.hypot(*(values[each] for each in pair)), error)
        else:
            not_shown[name] = "slide slowly over whole periods of this order"


def _add_zones(
    parts: Sequence[SlidingRows],
    position: Array,
    velocity: Array,
    residual: Array,
    levels: Mapping[str, float],
    quantities: dict[str, Quantity],
    not_shown: dict[str, str],
    layout: Layout,
) -> None:
    """Add by how much friction in each zone of the travel is above that of its direction: the mean residual there."""
    zone = np.clip(np.searchsorted(layout.edges, position) - 1, 0, len(layout.edges) - 2)
    inside = (position >= layout.edges[0]) & (position <= layout.edges[-1])
    counts = [len(part.rows) for part in parts]
    names: list[str] = []
    columns: list[Array] = []
    for k in range(len(layout.edges) - 1):
        for direction, sign in zip(DIRECTIONS, (1.0, -1.0), strict=True):
            rows = inside & (zone == k) & (sign * velocity > 0.0)
            name = f"{ZONE}.{k}.{direction}"
            if direction in levels and np.count_nonzero(rows) >= th.LEAST_ROWS:
                names.append(name)
                columns.append(sign * rows)
            else:
                not_shown[name] = "slide over this part of the travel, at several speeds"
    if not names:
        return
    values, errors, _ = _fitted(np.column_stack(columns), residual, names, counts)
    for name in names:
        quantities[name] = Quantity(values[name], errors[name])
