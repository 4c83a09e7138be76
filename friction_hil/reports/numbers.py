"""Numbers and units of the figures in reports; the formats are those of the terminal."""

from typing import Any

import numpy as np

from friction_hil.analysis.circularity import Circularity
from friction_hil.numerics import readable as formats
from friction_hil.numerics.readable import digits as digits


def readable(unit: str, values: Any) -> tuple[float, str]:
    """Return factor and unit in which the smallest of ``values`` (SI) is at least 1: ``(1e6, "µrad")``."""
    return formats.readable(unit, np.ravel(values).tolist())


def unit_of_figures(circularity: Circularity) -> tuple[float, str]:
    """Return factor and unit in which the following errors are readable."""
    laps = circularity.uncompensated, circularity.compensated
    return readable(circularity.unit, [figures.rms for each in laps for figures in each.figures.values()])
