"""What an experiment gives: lines to draw, and facts."""

from dataclasses import dataclass

import numpy as np

from friction_hil.numerics.jit import Array


@dataclass(frozen=True, slots=True)
class Outcome:
    """One experiment with one model.

    Attributes
    ----------
    facts : dict of float
        By name; the name ends in the unit.
    lines : dict of ((n,), (n,)) arrays
        What to draw, x and y, SI.
    """

    facts: dict[str, float]
    lines: dict[str, tuple[Array, Array]]


def thin(x: Array, y: Array, most: int = 600) -> tuple[Array, Array]:
    """Keep ``most`` points at equal distances, with the first and the last: enough for a picture."""
    if x.size <= most:
        return x, y
    kept = np.linspace(0, x.size - 1, most).round().astype(np.intp)
    return x[kept], y[kept]
