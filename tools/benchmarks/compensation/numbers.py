"""Means and formats of the tables."""

import math
from collections.abc import Iterable


def geometric_mean(values: Iterable[float]) -> float:
    """Return the geometric mean of numbers that are not negative; 0 if one of them is 0."""
    logarithms = [math.log(value) if value > 0.0 else -math.inf for value in values]
    if -math.inf in logarithms:
        return 0.0
    return math.exp(math.fsum(logarithms) / len(logarithms))


def brief(value: float) -> str:
    """Format a factor with two or three digits."""
    return f"{value:.2f}" if value < 3.0 else f"{value:.1f}" if value < 100.0 else f"{value:.0f}"
