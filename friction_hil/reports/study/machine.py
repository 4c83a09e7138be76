"""The report of the study of a machine: the following errors of motor and load on each motion, as one HTML file."""

import html
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from friction_hil import __version__
from friction_hil.numerics.jit import Array
from friction_hil.numerics.readable import comparison, quantity, readable
from friction_hil.reports.figures import WITH, WITHOUT, new_figure
from friction_hil.reports.page import page, picture, table, unordered_list, write_page
from friction_hil.reports.study.report import MARK, REPORT
from friction_hil.study.machine import SIDES, MachineStudy, MotionResult
from friction_hil.study.result import thin

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_UNSEEN = 0.5  # of the error of the load with compensation: more is named
_MOST_POINTS = 2000

MEANING = (
    "Motor: demanded position less that of the encoder of the position loop; load: less the true position of the load. "
    "Each without its mean. own: the motion of the axis; slow: a tenth of its speed; fast: as fast as its experiment; "
    "small: a tenth of its stroke."
)


def write_machine_report(folder: Path, name: str, study: MachineStudy) -> Path:
    """Write the report on a machine into a folder that was prepared by `claim`, and return its path."""
    title = f"What compensation does on {name}"
    parts = [
        f"<h2>{html.escape(axis)}: {html.escape(motion)}</h2>"
        + picture(_draw(result, study.units[axis]), "Demand, and following error of motor and load.", "wide")
        for axis, motions in study.motions.items()
        for motion, result in motions.items()
    ]
    body = f"""
<h1>{html.escape(title)}</h1>
<p>{html.escape(MEANING)}</p>
{_table(study)}
{unordered_list(notes(study))}
{"".join(parts)}
<p class="note">friction-hil {__version__}.</p>
"""
    path = folder / REPORT
    write_page(path, page(f"friction-hil: {title}", f'{MARK} {__version__}">', body))
    return path


def notes(study: MachineStudy) -> Iterator[str]:
    """Yield what limits the compensation: the deviation of the load from the encoder, and limit cycles."""
    for axis, motions in study.motions.items():
        for motion, result in motions.items():
            unseen, error = result.compensated.unseen, result.compensated.errors("load").rms
            if unseen > _UNSEEN * error:
                amount = quantity(unseen, study.units[axis])
                yield (
                    f"{axis}, {motion}: the load deviates from the encoder by {amount} RMS (twist, play, errors of "
                    "gear and encoder); no torque of the motor can reduce this part of its error"
                )
            if result.compensated.gain_factor < 1.0:
                yield (
                    f"{axis}, {motion}: the compensation made the axis oscillate, and its gain was reduced to "
                    f"{result.compensated.gain_factor:.0%}"
                )


def _table(study: MachineStudy) -> str:
    rows = []
    for axis, motion, side, result in study.rows():
        figures = result.without.errors(side), result.compensated.errors(side), result.reduction(side)
        for what, *cells in comparison(study.units[axis], *figures):
            rows.append((html.escape(axis), html.escape(motion), side, what, *cells))
    header = ("axis", "motion", "at", "following error", "without", "with compensation", "times lower")
    return table(header, rows, ("text", "text", "text"))


def _draw(result: MotionResult, unit: str) -> "Figure":
    """Draw the demand and, below it, the following errors of motor and load."""
    figure = new_figure(10.0, 6.4)
    top, *panels = figure.subplots(1 + len(SIDES), sharex=True)
    time_s = result.without.time_s
    top.plot(*thin(time_s, result.without.demand, _MOST_POINTS), color="black", linewidth=1.2)
    top.set_ylabel(f"demand [{unit}]")
    for axes, side in zip(panels, SIDES, strict=True):
        factor, shown = readable(unit, [result.compensated.errors(side).rms])
        for label, course, color in (
            ("without compensation", result.without, WITHOUT),
            ("with compensation", result.compensated, WITH),
        ):
            error: Array = factor * course.error(side)
            axes.plot(*thin(time_s, error, _MOST_POINTS), color=color, linewidth=1.1, label=label)
        axes.set_ylabel(f"error at the {side} [{shown}]")
    panels[0].legend(loc="upper right")
    panels[-1].set_xlabel("time [s]")
    return figure
