"""A figure and its file: which formats there are, and what can go wrong."""

from pathlib import Path
from typing import TYPE_CHECKING

from friction_hil.errors import FrictionHilError, UsageError, choices

if TYPE_CHECKING:
    from matplotlib.figure import Figure


def require_matplotlib() -> None:
    """Raise UsageError where there is no matplotlib; does not import it."""
    from importlib.util import find_spec

    if find_spec("matplotlib") is None:
        raise UsageError("the report needs matplotlib: pip install 'friction-hil[report]'")


def new_figure(path: Path, width: float, height: float) -> "Figure":
    """Make an empty figure for a file, before any work is done for it.

    Parameters
    ----------
    path : Path
        Where it will be saved; the suffix says in which format.
    width, height : float
        Inches.

    Raises
    ------
    UsageError
        matplotlib is not installed, or does not know the suffix.
    """
    try:
        from matplotlib.figure import Figure
    except ImportError:
        raise UsageError("pictures need matplotlib: pip install 'friction-hil[report]'") from None

    figure = Figure(figsize=(width, height), facecolor="white", layout="constrained")
    known = figure.canvas.get_supported_filetypes()
    if path.suffix.removeprefix(".").lower() not in known:
        raise UsageError(f"{path}: no picture format has the suffix {path.suffix!r}; {choices(path.suffix, known)}")
    return figure


def save(figure: "Figure", path: Path) -> None:
    """Write a figure into a file.

    Raises
    ------
    FrictionHilError
        The file cannot be written.
    """
    try:
        figure.savefig(path, dpi=120)
    except OSError as error:
        raise FrictionHilError(f"{path} cannot be written: {error.strerror}") from None
