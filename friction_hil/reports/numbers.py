"""Numbers with readable units and digits."""

import math
from typing import Any

import numpy as np

from friction_hil.analysis.circularity import Circularity


def readable(unit: str, values: Any) -> tuple[float, str]:
    """Return factor and unit in which the smallest of ``values`` (SI) is at least 1: ``(1e6, "µrad")``."""
    smallest = float(np.min(np.abs(values)))
    for factor, prefix in ((1.0, ""), (1e3, "m"), (1e6, "µ")):
        if smallest * factor >= 1.0:
            return factor, prefix + unit
    return 1e9, "n" + unit


def unit_of_figures(circularity: Circularity) -> tuple[float, str]:
    """Return factor and unit in which the following errors are readable."""
    laps = circularity.uncompensated, circularity.compensated
    return readable(circularity.unit, [figures.rms for each in laps for figures in each.figures.values()])


def digits(value: float, significant: int = 3) -> str:
    """Format a number with at least ``significant`` digits and no exponent."""
    decimals = max(significant - 1 - math.floor(math.log10(abs(value))), 0) if value else 0
    return f"{value:.{decimals}f}"
