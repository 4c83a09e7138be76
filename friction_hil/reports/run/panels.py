"""Panels of a run over time: which columns they show, in which unit, and how.

Each function returns one or two panels, or none; then it adds to ``notes`` what is missing.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from friction_hil.analysis import following
from friction_hil.analysis.baseline import Phase
from friction_hil.numerics.jit import Array
from friction_hil.recordings import Recording
from friction_hil.recordings.columns import CYCLE, SHADOW_PREFIX
from friction_hil.reports.figures import BLUE, GREEN, GREY, INK, ORANGE, SERIES, WITH, WITHOUT
from friction_hil.reports.numbers import readable


@dataclass(frozen=True, slots=True, eq=False)
class Line:
    """One signal over time: name, colour, values (n,) in the unit of its panel, and how it is drawn."""

    name: str
    color: str
    values: Array
    width: float = 1.0
    is_dashed: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class Panel:
    """Signals of one quantity over time; ``label`` ends with the unit."""

    name: str
    label: str
    lines: tuple[Line, ...]


def per_second(unit: str) -> str:
    """Return the unit of a velocity from that of the position: ``rad/s``, ``rad/s or m/s``."""
    return " or ".join(f"{each}/s" for each in unit.split(" or "))


def largest(values: Array) -> float:
    """Return the largest magnitude among the finite values; 0 if there is none."""
    return float(np.max(np.abs(values[np.isfinite(values)]), initial=0.0))


def motion(recording: Recording, unit: str, notes: list[str]) -> list[Panel]:
    """Return the panels of position and velocity, with their demands; ``unit`` is that of the position."""
    position = _panel(
        recording,
        ("position", "position", unit),
        (("position_demand", "demand", INK, 1.4, True), ("position", "measured", BLUE, 1.0, False)),
    )
    velocity = _panel(
        recording,
        ("velocity", "velocity", per_second(unit)),
        (
            ("velocity", "of the drive", GREY, 0.8, False),
            ("velocity_estimate", "estimate", BLUE, 1.0, False),
            ("velocity_demand", "demand", INK, 1.4, True),
        ),
    )
    for name, found in (("position", position), ("velocity", velocity)):
        if not found:
            notes.append(f"no {name}: there is no such column, nor its demand")
    return position + velocity


def following_error(
    recording: Recording,
    unit: str,
    period_s: float | None,
    phases: Sequence[Phase | None],
    notes: list[str],
) -> list[Panel]:
    """Return the panel of the following error; with the period of the loop, without and with compensation apart."""
    missing = [name for name in ("position_demand", "position") if name not in recording]
    if missing:
        notes.append(f"no following error: no column {', '.join(missing)}")
        return []
    columns = following.columns_of(recording, slice(None), ("position_demand", "position"))
    is_fresh = recording["is_fresh"] if "is_fresh" in recording else np.ones(len(recording))
    error = following.error({**columns, "is_fresh": is_fresh})
    known = [each.figures.peak for each in phases if each] or [largest(error)]
    factor, shown = readable(unit, known)
    error = error * factor
    if period_s is None or "is_enabled" not in recording or CYCLE not in recording:
        lines = [Line("demand minus measured position", INK, error)]
    else:
        late = following.is_recovering(recording[CYCLE], [{"is_fresh": is_fresh}], period_s)
        is_on = recording["is_enabled"] == 1.0
        choice = (
            ("without compensation", WITHOUT, ~is_on & ~late),
            ("with compensation", WITH, is_on & ~late),
            ("after a missed period", GREY, late),
        )
        lines = [Line(name, color, np.where(rows, error, np.nan)) for name, color, rows in choice if rows.any()]
    return [Panel("error", f"following error\n[{shown}]", tuple(lines))]


def torques(recording: Recording, unit: str, notes: list[str]) -> list[Panel]:
    """Return the panel of actual torque, command, compensation and shadow models."""
    shadows = [name for name in recording.columns if name.startswith(SHADOW_PREFIX)]
    known = (
        ("torque", "actual", GREY, 0.8, False),
        ("torque_demand", "demand of the drive", INK, 0.8, False),
        ("command", "command", GREEN, 1.4, False),
        ("compensation", "compensation", BLUE, 1.0, True),
        *(
            (name, f"shadow {name.removeprefix(SHADOW_PREFIX)}", SERIES[3 + k % 3], 0.8, False)
            for k, name in enumerate(shadows)
        ),
    )
    what = "force" if unit == "N" else "torque"
    found = _panel(recording, ("torque", what, unit), known)
    if not found:
        notes.append("no torques: no column torque, command or compensation")
    return found


def timing(recording: Recording, notes: list[str]) -> list[Panel]:
    """Return the panel of lateness and exchange, and by how much missed periods have put the motion behind."""
    known = (
        ("exchange_us", "exchange with the drives", GREY, 1.0),
        ("late_us", "late", INK, 1.0),
        ("path_lag_s", "motion behind", ORANGE, 1e6),
    )
    lines = [Line(label, color, recording[name] * factor) for name, label, color, factor in known if name in recording]
    if not any(largest(line.values) for line in lines):
        reason = "nothing is late in simulated time" if "late_us" in recording else "no column late_us"
        notes.append(f"no timing of the loop: {reason}")
        return []
    return [Panel("timing", "time\n[µs]", tuple(line for line in lines if line.name == "late" or largest(line.values)))]


def _panel(
    recording: Recording, naming: tuple[str, str, str], known: Sequence[tuple[str, str, str, float, bool]]
) -> list[Panel]:
    """Return a panel of those of the ``known`` columns that have values; none if there is no such column."""
    present = [each for each in known if each[0] in recording]
    if not present:
        return []
    name, words, unit = naming
    factor, shown = readable(unit, [max(largest(recording[each[0]]) for each in present)])
    lines = tuple(
        Line(label, color, recording[column] * factor, width, is_dashed)
        for column, label, color, width, is_dashed in present
    )
    return [Panel(name, f"{words}\n[{shown}]", lines)]
