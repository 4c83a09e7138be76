"""Modifiers to try on a structure: load, temperature, nonlinear viscous friction, ripple, if the data excite them."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from friction_hil.identification import thresholds as th
from friction_hil.identification.data import Data
from friction_hil.identification.regression import Estimate
from friction_hil.identification.ripple import MOST_HARMONICS, RippleSearch
from friction_hil.identification.structures import Coordinate, InitialScales, ModelStructure
from friction_hil.numerics.jit import Array

_STATIC_CURVES = ("table", "power_law")  # these are nonlinear in the velocity themselves


def excited(
    structure: ModelStructure,
    data: Data,
    scales: InitialScales,
    estimate: Estimate,
    loads: Sequence[Array] | None,
    *,
    is_load_fitted: bool = False,
) -> Iterator[ModelStructure]:
    """Yield the structure with one modifier more, for each modifier that the data could show.

    ``estimate`` is that of the structure itself on ``data``: ripple is looked for in its residual.

    If the load is gravity and identified by the same fit, load-dependent friction of motoring and of driven motion
    cannot be told apart: half their difference times the load is proportional to the load itself and is taken for
    gravity. One coefficient is then used for both (``is_load_fitted``).
    """
    has = set(structure.modifiers)
    if "viscous" not in has and structure.family not in _STATIC_CURVES:
        yield _with(structure, "viscous", linear={"viscous.quadratic": "viscous.quadratic"})
    if "load" not in has and loads is not None and _load_spread(loads) > th.MODIFIED_LEAST_LOAD * scales.level:
        names = ("load.motoring", "load.driven")
        owners = [names] if is_load_fitted else [(name,) for name in names]
        coordinates = [Coordinate(owner, 0.0, 10.0, False) for owner in owners]
        yield _with(structure, "load", coordinates=coordinates)
    warmth = [record.temperature for record in data.records if record.temperature is not None]
    if "temperature" not in has and len(warmth) == len(data.records):
        every = np.concatenate(warmth)
        if np.ptp(every) >= th.LEAST_WARMING:
            coefficient = Coordinate(("temperature.coefficient",), -0.1, 0.1, False)
            reference = {"temperature.reference": float(np.median(every))}
            yield _with(structure, "temperature", coordinates=[coefficient], constants=reference)
    orders = ripple_orders(data, estimate, structure)
    if orders:
        yield with_ripple(structure, orders)


def ripple_orders(data: Data, estimate: Estimate, structure: ModelStructure) -> list[float]:
    """Return the orders of position harmonics that stand out in the residual of a fit, largest first."""
    if not all(record.has_position for record in data.records):
        return []
    # the decimator of ordinary records has a gain of 0.99 even at rest; in an angle times 200 that is a period or more
    gain = data.column("offset")
    search = RippleSearch(
        data.motion("position") / gain,
        estimate.residual,
        estimate.jacobian,
        estimate.weights,
        data.parts,
        is_linear=structure.axis == "linear",
    )
    return search.orders(MOST_HARMONICS - len(_orders(structure)))


def _orders(structure: ModelStructure) -> list[str]:
    return [name for name in structure.constants if name.startswith("ripple[")]


def with_ripple(structure: ModelStructure, orders: Sequence[float]) -> ModelStructure:
    """Return a structure with harmonics of these orders, besides those that it has."""
    factor = 2.0 * math.pi if structure.axis == "linear" else 1.0
    numbered = list(enumerate(orders, start=len(_orders(structure))))
    linear = {
        f"ripple[{i}].{part}": f"ripple.{part}@{order * factor!r}"
        for i, order in numbered
        for part in ("cosine", "sine")
    }
    constants = {f"ripple[{i}].order": order for i, order in numbered}
    return _with(structure, "ripple", linear=linear, constants=constants)


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
        modifiers=tuple(dict.fromkeys((*structure.modifiers, name))),
    )


def _load_spread(loads: Sequence[Array]) -> float:
    """Return the standard deviation of the absolute load, N m or N."""
    return float(np.std(np.abs(np.concatenate(list(loads)))))
