"""Following error of a recorded run: the rows of steady motion that are used, and its figures. Pure."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from friction_hil.daemon.figures import RECOVERY_OF_LATE, RECOVERY_OF_MISSED, Condition
from friction_hil.daemon.figures import RECOVERY_S as RECOVERY_S
from friction_hil.daemon.figures import SETTLE_S as SETTLE_S
from friction_hil.daemon.figures import Figures as Figures
from friction_hil.daemon.figures import figures_of as figures_of
from friction_hil.errors import RecordingError
from friction_hil.recordings.recording import Array, Recording

COLUMNS = ("position", "position_demand", "is_fresh", "is_enabled", "state")  # required besides the cycle

_LEAST_FRACTION = 0.5
_OFFSET = "motor_offset"


def columns_of(recording: Recording, rows: Any, names: Sequence[str] = COLUMNS) -> dict[str, Array]:
    """Return ``rows`` of some columns, by name; the position without the offset of the motor, if one was recorded.

    By this offset the motor is to deviate from the demand (`friction_hil.compensator.transmission`): it is no error.
    """
    columns = {name: recording[name][rows] for name in names}
    if _OFFSET in recording:
        columns["position"] = columns["position"] - recording[_OFFSET][rows]
    return columns


def error(columns: Mapping[str, Array]) -> Array:
    """Compute demanded minus measured position (n,), rad or m; NaN in rows without fresh feedback."""
    return np.where(columns["is_fresh"] == 1.0, columns["position_demand"] - columns["position"], np.nan)


Fade = tuple[bool, float]  # was the compensation on in the last row, and the cycle up to which it fades


def conditions(
    cycle: Array, columns: Mapping[str, Array], fade_cycles: float, before: Fade = (False, -np.inf)
) -> tuple[Any, Fade]:
    """Return the `Condition` of each row (n,), and what further rows need to know of these.

    The compensation fades after each change of ``is_enabled``. A row without a demand belongs to no condition.
    """
    is_on = columns["is_enabled"] == 1.0
    is_changed = np.diff(is_on, prepend=before[0])
    until = np.maximum.accumulate(np.where(is_changed, cycle + fade_cycles, before[1]))
    is_fading = (cycle < until - 1e-6) | ~np.isfinite(columns["position_demand"])
    found = np.select([is_fading, is_on], [Condition.FADING, Condition.WITH], Condition.WITHOUT)
    return found, (bool(is_on[-1]), float(until[-1])) if cycle.size else before


def settled(cycle: Array, mask: Any, settle_cycles: float) -> tuple[float, float]:
    """Return the first cycle and the end of ``mask`` after ``settle_cycles``; zeros if it is empty.

    ``mask``, (n,), is true in one contiguous range.
    """
    inside = cycle[mask]
    return (float(inside[0]) + settle_cycles, float(inside[-1]) + 1.0) if inside.size else (0.0, 0.0)


def is_recovering(cycle: Array, axes: Sequence[Mapping[str, Array]], period_s: float) -> Any:
    """Return for each row if a period was missed, or feedback of an axis was late, in it or shortly before."""
    missed = np.diff(cycle, prepend=cycle[:1] - 1.0) - 1.0
    is_fresh = np.all([each["is_fresh"] == 1.0 for each in axes], axis=0)
    return cycle < np.maximum.accumulate(cycle + recovery(missed, is_fresh, period_s))


def recovery(missed: Array, is_fresh: Any, period_s: float) -> Array:
    """Return for how many cycles from each row on (n,) errors do not count.

    ``missed``: periods of the loop that were missed before each row.
    """
    after_missed = np.where(missed > 0.0, RECOVERY_S / period_s + RECOVERY_OF_MISSED * missed, 0.0)
    return np.maximum(after_missed, np.where(is_fresh, 0.0, RECOVERY_OF_LATE))


def refuse_too_few(path: str, used: int, wanted: int) -> None:
    """Raise RecordingError if fewer than half of the ``wanted`` rows can be used."""
    if used < _LEAST_FRACTION * wanted:
        raise RecordingError(
            f"{path}: only {used} of {wanted} periods of the laps can be used; in the others the loop or the drives "
            "were late: the computer was too busy"
        )
