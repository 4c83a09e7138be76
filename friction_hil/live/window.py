"""The last values of a signal, in memory of a fixed size. Pure."""

import numpy as np

from friction_hil.numerics.jit import Array


class Window:
    """The last ``size`` values, of ``width`` numbers each; 1 for plain ones."""

    __slots__ = ("_count", "_values")

    def __init__(self, size: int, width: int = 1) -> None:
        self._values = np.empty((max(1, size), width) if width > 1 else max(1, size))
        self._count = 0

    def extend(self, values: Array) -> None:
        """Append values (n,) or (n, width)."""
        size = len(self._values)
        values = values[-size:]
        self._values[(self._count + np.arange(len(values))) % size] = values
        self._count += len(values)

    def values(self) -> Array:
        """Return the values that are kept as a view, in no certain order."""
        return self._values[: min(self._count, len(self._values))]

    def rms(self) -> float:
        """Return the root mean square; NaN without any value."""
        return float(np.sqrt(np.mean(self.values() ** 2))) if self._count else np.nan

    def clear(self) -> None:
        """Forget all values."""
        self._count = 0
