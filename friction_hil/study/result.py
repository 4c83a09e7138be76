"""Result of an experiment: facts, and lines to draw."""

from dataclasses import dataclass

import numpy as np

from friction_hil.numerics.jit import Array


@dataclass(frozen=True, slots=True)
class ExperimentResult:
    """Result of one experiment with one model."""

    facts: dict[str, float]  # numbers by name, which ends with the unit
    lines: dict[str, tuple[Array, Array]]  # (n,) each, to draw, x and y, SI


def thin(x: Array, y: Array, most: int = 600) -> tuple[Array, Array]:
    """Keep ``most`` equally spaced points including the first and the last, for drawing."""
    if x.size <= most:
        return x, y
    kept = np.linspace(0, x.size - 1, most).round().astype(np.intp)
    return x[kept], y[kept]
