"""Hysteresis loops in a recorded motion: parts that move back and forth, on scales from presliding to full travel."""

import itertools
from collections.abc import Iterator
from typing import Any

import numpy as np

from friction_hil.numerics.jit import Array

_SCALES = 16  # of travel at which a loop is looked for
_SMALLEST = 1e-5  # of the whole travel
_LEAST_ROWS = 12  # fewer are a polygon
_UNEQUAL = 1.5  # ratio of the two strokes from which on they are no loop
_WIDEST = 3.0  # stroke in units of the scale
_DETOUR = 1.2  # path over the two strokes: more has smaller loops within
_ALIKE = 1.2  # ratio of the travel of two loops below which only one of them is kept


def find_loops(position: Array, recording: Any, most: int) -> list[slice]:
    """Return up to ``most`` loops of different travel, from small to large.

    A loop is the rows from one turning point to the next but one. ``recording``, (n,): number of the recording of each
    row; no loop extends over two of them.
    """
    ends = np.flatnonzero(np.diff(recording)) + 1
    parts = [slice(a, b) for a, b in itertools.pairwise([0, *ends.tolist(), len(position)])]
    span = max(float(np.ptp(position[part])) for part in parts)
    if span == 0.0:
        return []
    different: list[slice] = []
    longest = 0.0
    for scale in np.geomspace(_SMALLEST * span, 0.9 * span, _SCALES):
        best = max(_loops(position, parts, float(scale)), key=lambda loop: loop.stop - loop.start, default=None)
        if best is not None and (travel := float(np.ptp(position[best]))) > _ALIKE * longest:
            different.append(best)
            longest = travel
    chosen = sorted({round(k) for k in np.linspace(0, len(different) - 1, most)}) if different else []
    return [different[k] for k in chosen]


def _loops(position: Array, parts: list[slice], scale: float) -> Iterator[slice]:
    """Yield well resolved loops whose two strokes are both about as long as the scale, without smaller ones inside."""
    for part in parts:
        turns = [part.start + turn for turn in turning_points(position[part], scale)]
        for first, middle, last in zip(turns, turns[1:], turns[2:], strict=False):
            there, back = (abs(float(position[middle] - position[each])) for each in (first, last))
            if last - first < _LEAST_ROWS or max(there, back) > min(_UNEQUAL * min(there, back), _WIDEST * scale):
                continue
            if np.sum(np.abs(np.diff(position[first : last + 1]))) < _DETOUR * (there + back):
                yield slice(first, last + 1)


def turning_points(position: Array, least: float) -> list[int]:
    """Return the rows at which a position (n,) turns round, where it then comes back by ``least`` or more."""
    turns: list[int] = []
    direction, extreme, at = 0, float(position[0]), 0
    low = high = extreme
    for row, here in enumerate(position.tolist()):
        low, high = min(low, here), max(high, here)
        if direction == 0:
            if high - low >= least:
                direction, extreme, at = (1 if here == high else -1), here, row
        elif direction * (here - extreme) > 0.0:
            extreme, at = here, row
        elif direction * (extreme - here) >= least:
            turns.append(at)
            direction, extreme, at = -direction, here, row
    return turns
