"""Figures and their files: one style for all pictures, which formats exist, and what can go wrong."""

from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

from friction_hil.errors import FrictionHilError, UsageError, choices

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Okabe and Ito's colours: distinguishable with any colour vision, and in grey.
BLUE, ORANGE, GREEN, GREY = "#0072b2", "#d55e00", "#009e73", "#999999"
WITHOUT, WITH, LEARNED = ORANGE, BLUE, GREEN  # compensation; learned: with what learning made of its model
MEASURED, PREDICTED, RESIDUAL = GREY, BLUE, ORANGE
INK = "#222222"
FAULT = "#b00020"
SERIES = (
    BLUE,
    ORANGE,
    GREEN,
    "#cc79a7",
    "#e69f00",
    "#56b4e9",
    INK,
    "#7f7f7f",
)  # of lines that have no colour of their own

REPRODUCIBLE: Any = {"svg.hashsalt": "friction-hil"}  # settings with which equal pictures become equal files
_WITHOUT_DATE: dict[str, Any] = {".svg": {"Date": None}, ".pdf": {"CreationDate": None}}
_HEADING, _TITLE, _TEXT, _TICKS = 13.0, 11.0, 10.0, 9.0  # points


def require_matplotlib() -> None:
    """Raise UsageError if matplotlib is not installed; does not import it."""
    if find_spec("matplotlib") is None:
        raise UsageError("the report needs matplotlib: pip install 'friction-hil[report]'")


def new_figure(width: float, height: float, layout: Any = "constrained") -> "Figure":
    """Return an empty white figure of ``width`` by ``height`` inches.

    Raises `UsageError`: matplotlib is not installed.
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

    ``width`` and ``height`` are inches; the suffix of ``path`` gives the format. Raises `UsageError`: matplotlib is not
    installed, or does not know the suffix.
    """
    figure = new_figure(width, height)
    known = figure.canvas.get_supported_filetypes()
    if path.suffix.removeprefix(".").lower() not in known:
        raise UsageError(f"{path}: no picture format has the suffix {path.suffix!r}; {choices(path.suffix, known)}")
    return figure


def apply_style(figure: "Figure") -> None:
    """Give a finished figure the style of all pictures: sizes and colour of text, faint grid, no frame.

    Axes that are switched off, and those that show an image, keep their own grid. Titles and labels are not taken for
    formulas: they may hold the name of a file.
    """
    if title := figure.get_suptitle():
        figure.suptitle(title, fontsize=_HEADING, fontweight="bold", color=INK, parse_math=False)
    for axes in figure.axes:
        if not axes.axison:
            continue
        for side in ("left", "center"):
            if title := axes.get_title(side):
                axes.set_title(title, loc=side, fontsize=_TITLE, color=INK, parse_math=False)
        for label in (axes.xaxis.label, axes.yaxis.label):
            label.set(fontsize=_TEXT, color=INK, parse_math=False)
        axes.tick_params(labelsize=_TICKS, color=INK, labelcolor=INK)
        for side in ("top", "right"):
            axes.spines[side].set_visible(False)
        if not axes.images:
            axes.grid(alpha=0.3)
    for legend in (*figure.legends, *(axes.get_legend() for axes in figure.axes)):
        if legend is not None:
            legend.set_frame_on(True)  # white, so that lines below do not cross the words
            legend.get_frame().set(facecolor="white", edgecolor="none", alpha=0.85)
            for text in legend.get_texts():
                text.set(fontsize=_TICKS, color=INK, parse_math=False)


def save(figure: "Figure", path: Path) -> None:
    """Write a figure, in the style of all pictures, to a file.

    Raises `FrictionHilError`: the file cannot be written.
    """
    from matplotlib import rc_context  # imported here: matplotlib is optional, and takes 0.3 s

    apply_style(figure)
    metadata = _WITHOUT_DATE.get(path.suffix.lower())
    try:
        with rc_context(REPRODUCIBLE):
            figure.savefig(path, dpi=120, metadata=metadata)
    except OSError as error:
        raise FrictionHilError(f"{path} cannot be written: {error.strerror}") from None
