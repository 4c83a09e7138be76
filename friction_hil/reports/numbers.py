"""Numbers and units of the figures in reports; the formats are those of the terminal."""

import math
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


def prefix_of(unit: str, values: Any) -> tuple[float, str]:
    """Return `readable` of a unit that may not be known exactly: ``(1e3, "mrad or mm")``."""
    factor, prefix = readable("", values)
    return factor, " or ".join(prefix + each for each in unit.split(" or "))


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
    known = [each for each in (without, compensated) if each is not None]
    if not known:
        return
    factor, shown = prefix_of(unit, [each.rms for each in known])
    times = without.times(compensated) if without is not None and compensated is not None else None
    for name in ("rms", "peak"):
        cells = ["-" if each is None else digits(getattr(each, name) * factor) for each in (without, compensated)]
        ratio = math.inf if times is None else getattr(times, name)
        yield f"{name} [{shown}]", *cells, digits(ratio, 2) if math.isfinite(ratio) else "-"
