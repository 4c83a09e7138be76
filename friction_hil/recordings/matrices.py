"""Columns of matrices: a matrix of 5000 rows and 7 columns holds the columns ``q[:,0]`` to ``q[:,6]``. Pure.

Names count from 0 and are those of the array in its file. The longer side is time: ``q[0,:]`` is the first column of a
matrix of 7 rows and 5000 columns.
"""

import math
import re
from collections.abc import Mapping, Sequence
from typing import Any

from friction_hil.recordings.bounds import MOST_AXES

MOST_WIDE = MOST_AXES  # columns of a matrix: beyond, it is an image or a table of another kind
_INDEX = re.compile(r"\[\s*(:|\d+)\s*,\s*(:|\d+)\s*\]")
Index = tuple[Any, ...]


def column_indices(name: str, shape: Sequence[int]) -> dict[str, Index]:
    """Return the columns in an array by their names, each with the index that selects it.

    The shapes (n,), (n, 1) and (1, n) are one column of the name of the array. An array that is no column and no matrix
    of columns, or is too wide, has none.
    """
    count = math.prod(shape)
    if not len(shape) or count < 2:
        return {}
    if count == max(shape):
        return {name: tuple(slice(None) if size == count else 0 for size in shape)}
    if len(shape) != 2 or min(shape) > MOST_WIDE:
        return {}
    if shape[0] >= shape[1]:
        return {f"{name}[:,{i}]": (slice(None), i) for i in range(shape[1])}
    return {f"{name}[{i},:]": (i, slice(None)) for i in range(shape[0])}


def array_of(column: str) -> str:
    """Return the name of the array that a column belongs to: ``q`` for ``q[:,3]``, else the column itself."""
    found = _INDEX.search(column)
    return column[: found.start()] if found and found.end() == len(column) else column


def without_blanks(source: str) -> str:
    """Return a source with its indices written as columns are named: ``q[:, 3]`` becomes ``q[:,3]``."""
    return _INDEX.sub(r"[\1,\2]", source)


def kept_length(lengths: Mapping[str, int], problems: list[str]) -> list[str]:
    """Return the names of the columns that have the length of the recording; report the other arrays.

    That is the most frequent length of the columns, or where there are matrices the one that has most values: a file
    may hold more small matrices, such as transformations, than signals.
    """
    has_matrix = any(array_of(name) != name for name in lengths)
    counts: dict[int, int] = {}
    for size in lengths.values():
        counts[size] = counts.get(size, 0) + (size if has_matrix else 1)
    rows = max(counts, key=lambda size: (counts[size], size))
    problems += dict.fromkeys(
        f"{array_of(name)} has {size} values, the other columns {rows}: left out"
        for name, size in lengths.items()
        if size != rows
    )
    return [name for name, size in lengths.items() if size == rows]
