"""Read MATLAB 5 files: vectors of equal length are columns."""

from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np

from friction_hil.errors import RecordingError
from friction_hil.recordings.recording import Recording


def read_mat(path: Path, axis: str) -> Recording:
    """Read the real vectors of a MATLAB 5 file; scalars and everything else are passed over.

    Where vectors differ in length, those of the commonest length are the columns, and ``problems`` names the
    others.

    Raises
    ------
    RecordingError
        The file is not MATLAB 5, or has no vector.
    OSError
        It cannot be opened.
    """
    vectors = {name: value.ravel() for name, value in _load(path).items() if _is_vector(value)}
    if not vectors:
        raise RecordingError(f"{path}: there is no real vector in it, which a column would be")
    lengths = Counter(value.size for value in vectors.values())
    rows = max(lengths, key=lambda size: (lengths[size], size))
    columns = {name: value.astype(np.float64) for name, value in vectors.items() if value.size == rows}
    problems = [
        f"{name} has {value.size} values, the other columns {rows}: left out"
        for name, value in vectors.items()
        if value.size != rows
    ]
    return Recording(str(path), axis, columns, problems=problems)


def _load(path: Path) -> dict[str, Any]:
    from scipy.io import loadmat

    try:
        content: dict[str, Any] = loadmat(str(path), appendmat=False)
    except OSError:
        raise
    except NotImplementedError:
        raise RecordingError(
            f"{path} is a MATLAB 7.3 file, which is not read; in MATLAB save it with save(..., '-v7')"
        ) from None
    except Exception as error:  # noqa: BLE001 - the parser raises whatever damaged bytes lead it to
        raise RecordingError(f"{path} is not a readable MATLAB 5 file: {error}") from None
    return {name: value for name, value in content.items() if not name.startswith("__")}


def _is_vector(value: Any) -> bool:
    return (
        isinstance(value, np.ndarray)
        and value.dtype.kind in "fiub"
        and value.size > 1
        and value.size == max(value.shape)
    )
