"""Choice of one fit by the errors on held-out data.

Two fits are compared stretch by stretch, by the likelihood of the held-out torque. The error is large where the motion
is hard to resolve, and the same for all fits there; differences over stretches in pairs are not affected by that, while
a mean square error over all of them is hardly anything else.
"""

import math
from collections.abc import Sequence

import numpy as np

from friction_hil.errors import RecordingError
from friction_hil.identification import thresholds as th
from friction_hil.identification.fits import Fit
from friction_hil.identification.inference import correlated_square, is_doubtful
from friction_hil.identification.prediction_errors import PredictionError
from friction_hil.identification.refine import is_dynamic
from friction_hil.numerics.jit import Array


def log_likelihood_gain(error: PredictionError, base: PredictionError) -> tuple[float, float]:
    """Return by how much one prediction is better than another, and the standard error of that.

    The gain is the mean over the stretches of half the logarithm of the ratio of mean square errors, i.e. the
    difference in the logarithm of the likelihood for each row, where each stretch has a variance of its own; 0.01 is a
    smaller error by 1 %. Its standard error is for differences that are correlated from stretch to stretch (Newey and
    West 1987).

    Source: held-out log-likelihood as the score, with the variance of each stretch profiled out: T. Gneiting,
    A. Raftery, Journal of the American Statistical Association 102, 2007, section 4.
    """
    own, other = np.array(error.stretches), np.array(base.stretches)
    floor = _floor(base)
    differences = 0.5 * np.log((other + floor) / (own + floor))
    return float(np.mean(differences)), _error_of_mean(differences)


def _floor(error: PredictionError) -> float:
    """Return the mean square error below which a difference does not matter."""
    if not error.relative_error > 0.0:
        return 1e-300
    return max((th.EXACT * error.rmse / error.relative_error) ** 2, 1e-300)


def _error_of_mean(values: Array) -> float:
    """Return the standard error of the mean of correlated values, (k,)."""
    count = len(values)
    if count < 2:
        return 0.0
    left = values - np.mean(values)
    lags = int(4.0 * (count / 100.0) ** (2.0 / 9.0))  # Newey and West, Review of Economic Studies, 1994
    power = correlated_square(left, lags if count >= th.SERIES else 0)
    return math.sqrt(max(power, 0.0) / (count * (count - 1)))


def is_better(fit: Fit, base: Fit) -> bool:
    """Return True if a fit predicts held-out blocks better than ``base`` by more than one standard error."""
    gain = np.array(base.held_out.blocks) - np.array(fit.held_out.blocks)
    error = float(np.std(gain, ddof=1)) / math.sqrt(len(gain)) if len(gain) > 1 else 0.0
    return float(np.mean(gain)) > error


def is_significant(fit: Fit, base: Fit) -> bool:
    """Return True if held-out data are more likely with a fit than with ``base`` by two standard errors."""
    gain, doubt = log_likelihood_gain(fit.held_out, base.held_out)
    return gain > th.CHOICE_FAR * doubt


def is_determined(fit: Fit) -> bool:
    """Return True if each nonlinear parameter is larger than its standard error."""
    errors = fit.inference.standard_errors
    return all(
        errors[each.name] <= abs(fit.values[each.name]) for each in fit.structure.coordinates if each.name in errors
    )


def at_bound(fit: Fit) -> tuple[str, ...]:
    """Return the nonlinear parameters that ended at a bound, apart from a Coulomb level of zero: it is just absent."""
    return tuple(
        each.name
        for each in fit.structure.coordinates
        if each.name in fit.estimate.at_bound
        and (each.name.rpartition(".")[2] != "coulomb" or fit.values[each.name] > th.ABSENT * each.upper)
    )


def is_sound(fit: Fit) -> bool:
    """Return True if the data determine each nonlinear parameter, and none is at a bound."""
    return is_determined(fit) and not at_bound(fit)


def _searched(fit: Fit) -> int:
    """Return the number of parameters that were fitted, those at a bound included."""
    return fit.count + len(at_bound(fit))


def by_likelihood(fits: Sequence[Fit]) -> list[Fit]:
    """Return the fits with finite errors, the likeliest on held-out data first."""
    usable = [each for each in fits if math.isfinite(each.held_out.rmse)]
    if not usable:
        return []
    base = min(usable, key=lambda each: each.held_out.rmse).held_out
    return sorted(usable, key=lambda each: (-log_likelihood_gain(each.held_out, base)[0], each.held_out.rmse))


def near(fits: Sequence[Fit], errors: float) -> list[Fit]:
    """Return the fits that are as good as the likeliest one, that one first.

    They are worse by no more than so many standard errors of the difference, or by a negligible part of the friction.
    """
    ordered = by_likelihood(fits)
    found = []
    for each in ordered:
        gain, error = log_likelihood_gain(ordered[0].held_out, each.held_out)
        if gain <= _quantile(errors, len(each.held_out.stretches) - 1) * error or _is_negligible(each, ordered[0]):
            found.append(each)
    return found


def _quantile(normal: float, freedom: int) -> float:
    """Return the quantile of Student's t for that of a normal distribution: few groups know little of their spread.

    Source: M. Abramowitz, I. Stegun, Handbook of Mathematical Functions, 1964, 26.7.5, the first three terms.
    """
    freedom = max(freedom, 1)
    second = (5.0 * normal**5 + 16.0 * normal**3 + 3.0 * normal) / (96.0 * freedom**2)
    return normal + (normal**3 + normal) / (4.0 * freedom) + second


def _is_negligible(fit: Fit, best: Fit) -> bool:
    """Return True if the additional error of a fit is far below what friction there is to be compensated."""
    additional = fit.held_out.rmse**2 - best.held_out.rmse**2
    return additional <= th.NEGLIGIBLE**2 * float(np.mean(best.curves.friction**2))


def choose(fits: Sequence[Fit], blocks: str = "blocks", kind: str = "") -> tuple[Fit, str]:
    """Return the simplest fit that is as good as the best one within one standard error, and the reason.

    The best fit is the likeliest one on held-out data (`log_likelihood_gain`), and the standard error is that of the
    difference from it. The simplest fit has the fewest parameters. Fits whose parameters the data determine and that
    have none at a bound are preferred, also within two standard errors: a parameter that any value fits here may matter
    elsewhere. ``blocks`` names, in the reason, what was held out
    (`friction_hil.identification.prediction_errors.blocks`), and ``kind`` what distinguishes these candidates. Raises
    `RecordingError`: no fit has a finite error.

    Source: L. Breiman, J. Friedman, R. Olshen, C. Stone, Classification and Regression Trees, 1984, section 3.4.3.
    """
    ordered = by_likelihood(fits)
    if not ordered:
        raise RecordingError("no candidate could be fitted to the recording")
    best = ordered[0]
    close = near(fits, 1.0)
    sound = [each for each in close if is_sound(each)] or [
        each for each in near(fits, th.CHOICE_FAR) if is_sound(each)
    ][:1]
    chosen = min(sound or close, key=lambda each: (_searched(each), ordered.index(each)))
    if best.validation is not None:
        where = "the validation recordings"
    elif best.across_speeds is not None:
        where = "strokes of other speeds than it was fitted to"
    else:
        where = f"{blocks} held out in turn"
    if len(ordered) == 1:
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
    first = f"of {len(ordered)} {kind}candidates {best.label} predicts {where} best, with an error of {_percent(best)}"
    least = min(ordered, key=lambda each: each.held_out.rmse)
    if _percent(least) != _percent(best):
        first += f" (the smallest, {_percent(least)} of {least.label}, comes from a few stretches of time)"
    if chosen is best:
        return chosen, f"{first}, and no simpler one within one standard error of it does as well"
    if chosen in close:
        return chosen, (
            f"{first}; {chosen.label} has {_percent(chosen)} with {_searched(chosen)} parameters instead of "
            f"{_searched(best)}: the simplest one within the standard error, {shown}"
        )
    doubt = f"{', '.join(at_bound(best))} at a bound" if at_bound(best) else "parameters that the data do not determine"
    return chosen, (
        f"{first}, but with {doubt}; {chosen.label}, with {_percent(chosen)}, is within two standard errors of it, and "
        "the data determine its parameters"
    )


def plausible(fits: Sequence[Fit], chosen: Fit) -> list[Fit]:
    """Return the fits that may describe the axis: the chosen one, the others near the best, the best of each family.

    The fits are to the same rows, so that their errors compare. ``chosen`` comes first if it is among them, then those
    that are not worse than the best by more than two standard errors of the difference, without parameters at a bound
    first, then the best of each family that is left. Each once.
    """
    ordered = by_likelihood(fits)
    close = sorted(near(fits, th.CHOICE_FAR), key=lambda each: not is_sound(each))  # keeps the order within both parts
    found = [each for each in (chosen,) if each in ordered]
    found += [each for each in close if each not in found]
    seen = {each.structure.family for each in found}
    for each in (*(one for one in ordered if is_sound(one)), *ordered):
        if each.structure.family not in seen:
            seen.add(each.structure.family)
            found.append(each)
    return found


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
    chosen = [] if best.structure.is_flat else [best]  # refined records may show what ordinary ones do not
    return [*chosen, *(each for each in simplest.values() if each is not best)] if simplest else []


def _simplicity(fit: Fit) -> tuple[int, int, int]:
    return fit.structure.is_flat, len(fit.structure.modifiers), len(fit.structure.without)


def _percent(fit: Fit) -> str:
    return f"{100.0 * fit.held_out.relative_error:.2f} %"
