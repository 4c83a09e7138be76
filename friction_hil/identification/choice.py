"""Choice of one fit by the errors on held-out data."""

import math
from collections.abc import Sequence

import numpy as np

from friction_hil.errors import RecordingError
from friction_hil.identification.fits import Fit
from friction_hil.identification.inference import is_doubtful
from friction_hil.identification.refine import is_dynamic


def _limit(fit: Fit) -> float:
    """Return the mean square error of held-out blocks plus its standard error."""
    errors = np.array(fit.held_out.blocks)
    error = float(np.std(errors, ddof=1)) / math.sqrt(len(errors)) if len(errors) > 1 else 0.0
    return float(np.mean(errors)) + error


def is_better(fit: Fit, base: Fit) -> bool:
    """Return True if a fit predicts held-out blocks better than ``base`` by more than one standard error."""
    gain = np.array(base.held_out.blocks) - np.array(fit.held_out.blocks)
    error = float(np.std(gain, ddof=1)) / math.sqrt(len(gain)) if len(gain) > 1 else 0.0
    return float(np.mean(gain)) > error


def is_determined(fit: Fit) -> bool:
    """Return True if each nonlinear parameter is larger than its standard error."""
    errors = fit.inference.standard_errors
    return all(
        errors[each.name] <= abs(fit.values[each.name]) for each in fit.structure.coordinates if each.name in errors
    )


def choose(fits: Sequence[Fit], blocks: str = "blocks", kind: str = "") -> tuple[Fit, str]:
    """Return the simplest fit within one standard error of the best one, and the reason for the choice.

    The simplest fit has the fewest parameters. Fits whose parameters the data determine are preferred: a parameter that
    any value fits here may matter elsewhere. ``blocks`` names, in the reason, what was held out
    (`friction_hil.identification.prediction_errors.blocks`), and ``kind`` what distinguishes these candidates.

    Raises
    ------
    RecordingError
        No fit has a finite error.

    Source: L. Breiman, J. Friedman, R. Olshen, C. Stone, Classification and Regression Trees, 1984, section 3.4.3.
    """
    usable = [each for each in fits if math.isfinite(each.held_out.rmse)]
    if not usable:
        raise RecordingError("no candidate could be fitted to the recording")
    lowest = min(usable, key=lambda each: each.held_out.rmse)
    limit = _limit(lowest)
    near = [each for each in usable if np.mean(each.held_out.blocks) <= limit] or [lowest]
    sound = [each for each in near if is_determined(each)]
    chosen = min(sound or near, key=lambda each: (each.count, each.held_out.rmse))
    if lowest.validation is not None:
        where = "the validation recordings"
    elif lowest.across_speeds is not None:
        where = "strokes of other speeds than it was fitted to"
    else:
        where = f"{blocks} held out in turn"
    if len(usable) == 1:
        return (
            chosen,
            f"{chosen.label} is the only {kind}candidate; it predicts {where} with an error of {_percent(chosen)}",
        )
    if not sound:
        shown = "though the data do not determine its parameters"
    elif is_doubtful(chosen.flags):  # the flags follow the reason, and must not contradict it
        shown = "whose nonlinear parameters all exceed their standard errors"
    else:
        shown = "whose parameters the data determine"
    first = (
        f"of {len(usable)} {kind}candidates {lowest.label} predicts {where} best, with an error of {_percent(lowest)}"
    )
    if chosen is lowest:
        return chosen, f"{first}, and no simpler one within one standard error of it does as well"
    return chosen, (
        f"{first}; {chosen.label}, with {_percent(chosen)}, is the simplest within one standard error of it {shown}: "
        f"{chosen.count} parameters, not {lowest.count}"
    )


def to_refine(best: Fit, fits: Sequence[Fit]) -> list[Fit]:
    """Return the chosen fit and the simplest fit of each dynamic family; nothing if no family has a state.

    Dynamic families differ in how an axis starts to move. Ordinary records hardly show that, so that errors on them do
    not predict errors on refined records, and a modifier may seem to explain what presliding causes.
    """
    simplest: dict[str, Fit] = {}
    for each in fits:
        if is_dynamic(each.structure):
            family = each.structure.family
            simplest[family] = min(simplest.get(family, each), each, key=_simplicity)
    return [best, *(each for each in simplest.values() if each is not best)] if simplest else []


def _simplicity(fit: Fit) -> tuple[int, int]:
    return len(fit.structure.modifiers), len(fit.structure.without)


def _percent(fit: Fit) -> str:
    return f"{100.0 * fit.held_out.relative_error:.2f} %"
