"""Modifiers to try on a structure: load, temperature, nonlinear viscous friction, ripple, if the data excite them."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from friction_hil.identification.data import Data
from friction_hil.identification.structures import Coordinate, InitialScales, ModelStructure
from friction_hil.numerics.jit import Array

_LEAST_LOAD = 0.1  # of the friction level: a smaller variation of the load does not show
_LEAST_WARMING = 3.0  # K: smallest range of temperatures
_LEAST_PERIODS = 2.0  # of a ripple over the travel
_MOST_PERIODS = 300.0
_ORDERS = 400  # number of orders tried
_LEAST_RIPPLE = 0.05  # smallest fraction of the residual's energy that a harmonic must explain
_HARMONICS = 2
_STATIC_CURVES = ("table", "power_law")  # these are nonlinear in the velocity themselves


def excited(
    structure: ModelStructure,
    data: Data,
    scales: InitialScales,
    residual: Array,
    loads: Sequence[Array] | None,
    *,
    is_load_fitted: bool = False,
) -> Iterator[ModelStructure]:
    """Yield the structure with one modifier more, for each modifier that the data could show.

    If the load is gravity and identified by the same fit, load-dependent friction of motoring and of driven motion
    cannot be told apart: half their difference times the load is proportional to the load itself and is taken for
    gravity. One coefficient is then used for both (``is_load_fitted``).
    """
    has = set(structure.modifiers)
    if "viscous" not in has and structure.family not in _STATIC_CURVES:
        yield _with(structure, "viscous", linear={"viscous.quadratic": "viscous.quadratic"})
    if "load" not in has and loads is not None and _load_spread(loads) > _LEAST_LOAD * scales.level:
        names = ("load.motoring", "load.driven")
        owners = [names] if is_load_fitted else [(name,) for name in names]
        coordinates = [Coordinate(owner, 0.0, 10.0, False) for owner in owners]
        yield _with(structure, "load", coordinates=coordinates)
    warmth = [record.temperature for record in data.records if record.temperature is not None]
    if "temperature" not in has and len(warmth) == len(data.records):
        every = np.concatenate(warmth)
        if np.ptp(every) >= _LEAST_WARMING:
            coefficient = Coordinate(("temperature.coefficient",), -0.1, 0.1, False)
            reference = {"temperature.reference": float(np.median(every))}
            yield _with(structure, "temperature", coordinates=[coefficient], constants=reference)
    orders = ripple_orders(data, residual, structure.axis == "linear") if "ripple" not in has else []
    if orders:
        factor = 2.0 * math.pi if structure.axis == "linear" else 1.0
        linear = {
            f"ripple[{i}].{part}": f"ripple.{part}@{order * factor!r}"
            for i, order in enumerate(orders)
            for part in ("cosine", "sine")
        }
        constants = {f"ripple[{i}].order": order for i, order in enumerate(orders)}
        yield _with(structure, "ripple", linear=linear, constants=constants)


def _with(
    structure: ModelStructure,
    name: str,
    *,
    coordinates: Sequence[Coordinate] = (),
    linear: dict[str, str] | None = None,
    constants: dict[str, float] | None = None,
) -> ModelStructure:
    return replace(
        structure,
        coordinates=(*structure.coordinates, *coordinates),
        linear={**structure.linear, **(linear or {})},
        constants={**structure.constants, **(constants or {})},
        modifiers=(*structure.modifiers, name),
    )


def _load_spread(loads: Sequence[Array]) -> float:
    """Return the standard deviation of the absolute load, N m or N."""
    return float(np.std(np.abs(np.concatenate(list(loads)))))


def ripple_orders(data: Data, residual: Array, is_linear: bool) -> list[float]:
    """Return the orders of position harmonics that stand out in a residual (k,), largest first.

    On a rotary axis that turns by more than one revolution only whole orders are tried: ripple repeats with the shaft.
    """
    position = data.motion("position")
    turn = 1.0 if is_linear else 2.0 * math.pi
    travel = float(np.ptp(position)) / turn
    if not is_linear and travel >= 1.0:
        orders = np.arange(1.0, 65.0)
    else:
        orders = np.geomspace(_LEAST_PERIODS, _MOST_PERIODS, _ORDERS) / travel
    # aliasing: a ripple of which a row-to-row movement spans half a period cannot be seen
    fastest = float(np.quantile(np.abs(np.diff(position)), 0.9)) / turn
    orders = orders[orders * fastest < 0.25] if fastest > 0.0 else orders
    found: list[float] = []
    left = residual - np.mean(residual)
    energy = float(left @ left)
    for _ in range(_HARMONICS):
        best, gain, after = 0.0, 0.0, left
        for order in orders:
            angle = order * 2.0 * math.pi / turn * position
            shapes = np.column_stack([np.cos(angle), np.sin(angle)])
            factors = np.linalg.solve(shapes.T @ shapes + 1e-9 * np.eye(2), shapes.T @ left)
            trial = left - shapes @ factors
            explained = float(left @ left - trial @ trial)
            if explained > gain:
                best, gain, after = float(order), explained, trial
        if gain < _LEAST_RIPPLE * energy:
            break
        found.append(best)
        left = after
    return found
