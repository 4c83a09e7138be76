"""Numbers and units of the figures in reports; the formats are those of the terminal."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from friction_hil.analysis.circularity import Circularity
from friction_hil.analysis.following import Figures
from friction_hil.numerics import readable as formats
from friction_hil.numerics.readable import digits as digits


def readable(unit: str, values: Any) -> tuple[float, str]:
    """Return factor and unit in which the smallest of ``values`` (SI) is at least 1: ``(1e6, "µrad")``."""
    return formats.readable(unit, np.ravel(values).tolist())


def unit_of_figures(circularity: Circularity) -> tuple[float, str]:
    """Return factor and unit in which the following errors are readable."""
    laps = circularity.uncompensated, circularity.compensated
    return readable(circularity.unit, [figures.rms for each in laps for figures in each.figures.values()])


def comparison_rows(unit: str, without: Figures | None, compensated: Figures | None) -> Iterator[tuple[str, ...]]:
    """Yield RMS and peak of the following error: name with unit, without, with compensation, times lower.

    Parameters
    ----------
    unit : str
        Unit of the position: rad or m.
    without, compensated : Figures or None
        None if there was no such phase: its cells are dashes.
    """
    if without is not None or compensated is not None:
        reduction = without.times(compensated) if without is not None and compensated is not None else None
        yield from formats.comparison(unit, without, compensated, reduction)
