"""Numbers and units of the figures in reports; the formats are those of the terminal."""

import itertools
from collections.abc import Iterator
from typing import Any

import numpy as np

from friction_hil.analysis.circularity import FIGURES, Circularity
from friction_hil.analysis.following import Figures
from friction_hil.numerics import readable as formats
from friction_hil.numerics.readable import digits as digits


def readable(unit: str, values: Any) -> tuple[float, str]:
    """Return factor and unit in which the smallest of ``values`` (SI) is at least 1: ``(1e6, "µrad")``."""
    return formats.readable(unit, np.ravel(values).tolist())


def unit_of_figures(circularity: Circularity) -> tuple[float, str]:
    """Return factor and unit in which the following errors are readable."""
    return readable(circularity.unit, [figures.rms for each in circularity.laps for figures in each.figures.values()])


def figure_rows(circularity: Circularity) -> Iterator[tuple[str, str, list[str], list[str]]]:
    """Yield axis, rms or peak, the following error in each of the laps, and how many times lower it is than without.

    The errors are in the unit of `unit_of_figures`. There is a ratio for all laps but those without compensation.
    """
    factor, _ = unit_of_figures(circularity)
    for axis, name in itertools.product(circularity.axes, FIGURES):
        errors = [digits(getattr(each.figures[axis], name) * factor) for each in circularity.laps]
        yield axis, name, errors, [digits(circularity.factor(axis, name, each), 2) for each in circularity.laps[1:]]


def comparison_rows(unit: str, without: Figures | None, compensated: Figures | None) -> Iterator[tuple[str, ...]]:
    """Yield RMS and peak of the following error: name with unit, without, with compensation, times lower.

    ``unit``: of the position, rad or m. A phase that is None did not exist: its cells are dashes.
    """
    if without is not None or compensated is not None:
        reduction = without.times(compensated) if without is not None and compensated is not None else None
        yield from formats.comparison(unit, without, compensated, reduction)
