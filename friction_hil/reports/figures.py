"""Figures and their files: how they are made, which formats exist, and what can go wrong."""

from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

from friction_hil.errors import FrictionHilError, UsageError, choices

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

# Okabe and Ito's colours: distinguishable with any colour vision, and in grey.
BLUE, ORANGE, GREEN, GREY = "#0072b2", "#d55e00", "#009e73", "#999999"
WITHOUT, WITH = ORANGE, BLUE  # compensation
MEASURED, PREDICTED, RESIDUAL = GREY, BLUE, ORANGE
INK = "#222222"


def require_matplotlib() -> None:
    """Raise UsageError if matplotlib is not installed; does not import it."""
    if find_spec("matplotlib") is None:
        raise UsageError("the report needs matplotlib: pip install 'friction-hil[report]'")


def new_figure(width: float, height: float, layout: Any = "constrained") -> "Figure":
    """Return an empty white figure of ``width`` by ``height`` inches.

    Raises
    ------
    UsageError
        matplotlib is not installed.
    """
    try:
        from matplotlib.figure import Figure  # imported here: matplotlib is optional, and takes 0.3 s
    except ImportError:
        if find_spec("matplotlib") is not None:
            raise
        raise UsageError("pictures need matplotlib: pip install 'friction-hil[report]'") from None
    return Figure(figsize=(width, height), facecolor="white", layout=layout)


def new_figure_for(path: Path, width: float, height: float) -> "Figure":
    """Return an empty figure for a file, before any work is done for it.

    Parameters
    ----------
    path : Path
        File in which it will be saved; the suffix gives the format.
    width, height : float
        Inches.

    Raises
    ------
    UsageError
        matplotlib is not installed, or does not know the suffix.
    """
    figure = new_figure(width, height)
    known = figure.canvas.get_supported_filetypes()
    if path.suffix.removeprefix(".").lower() not in known:
        raise UsageError(f"{path}: no picture format has the suffix {path.suffix!r}; {choices(path.suffix, known)}")
    return figure


def add_grid(figure: "Figure") -> "Figure":
    """Give all axes of a figure a faint grid, and return the figure."""
    for axes in figure.axes:
        axes.grid(alpha=0.3)
    return figure


def remove_frame(axes: "Axes") -> None:
    """Give axes a faint grid, and remove the upper and the right edge of their frame."""
    axes.grid(alpha=0.3)
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)


def save(figure: "Figure", path: Path) -> None:
    """Write a figure to a file.

    Raises
    ------
    FrictionHilError
        The file cannot be written.
    """
    try:
        figure.savefig(path, dpi=120)
    except OSError as error:
        raise FrictionHilError(f"{path} cannot be written: {error.strerror}") from None
