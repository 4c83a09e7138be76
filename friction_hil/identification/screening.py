"""Search of several candidates at once, of which those that fit far worse than others end early.

Sequential halving: every candidate gets few evaluations, those that are left get more. Source: Z. Karnin, T. Koren,
O. Somekh, Almost optimal exploration in multi-armed bandits, International Conference on Machine Learning, 2013.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np

from friction_hil.identification import structures
from friction_hil.identification import thresholds as th
from friction_hil.identification.choice import log_likelihood_gain
from friction_hil.identification.humps import hump
from friction_hil.identification.least_squares import FitError
from friction_hil.identification.prediction_errors import PredictionError, prediction_error
from friction_hil.identification.refine import inside
from friction_hil.identification.regression import Estimate, Regression
from friction_hil.identification.structures import InitialScales
from friction_hil.numerics.jit import Array
from friction_hil.parallel import in_parallel


@dataclass(slots=True)
class Search:
    """State of the search of one candidate."""

    at: Array  # (m,), coordinates of the best parameters so far
    error: PredictionError | None = None  # with them, on the data that it is fitted to
    is_ended: bool = False  # other candidates fit far better
    failure: Exception | None = None  # why the candidate has no finite error

    def estimate(self, regression: Regression) -> Estimate:
        """Return the estimate at the coordinates that were found."""
        return regression.estimate(self.at, evaluations=1)


def screened(regressions: Sequence[Regression], bases: Sequence[Array], scales: InitialScales) -> list[Search]:
    """Search for the parameters of each candidate, as long as it may be among the best ones.

    The regressions are on the same data. ``bases``: coordinates (m,) to start from; the scales suggest others.
    """
    found = in_parallel([partial(_begun, *given, scales) for given in zip(regressions, bases, strict=True)])
    for evaluations, ratio in th.SCREENING_ROUNDS:
        left = [i for i, each in enumerate(found) if each.failure is None and not each.is_ended]
        if len(left) < 2:  # what is left is searched for with all steps anyway
            break
        again = in_parallel([partial(_continued, regressions[i], found[i], evaluations) for i in left])
        for i, search in zip(left, again, strict=True):
            found[i] = search
        errors = {i: found[i].error for i in left}
        known = {i: error for i, error in errors.items() if error is not None}
        if not known:
            break
        best = _best(list(known.values()))
        for i, error in known.items():
            gain, doubt = log_likelihood_gain(best, error)
            found[i].is_ended = gain > max(math.log(ratio), th.SIGNIFICANT * doubt)
    return found


def _best(errors: Sequence[PredictionError]) -> PredictionError:
    base = errors[0]
    return max(errors, key=lambda each: log_likelihood_gain(each, base)[0])


def _begun(regression: Regression, base: Array, scales: InitialScales) -> Search:
    """Return the best of short searches from several starts."""
    starts = [inside(regression, base, scales)]
    coordinates = regression.structure.coordinates
    for values in structures.starts(regression.structure, scales, 0, 0):
        if len(starts) <= th.SCREENING_STARTS:
            starts.append(np.array([each.inner(values[each.name]) for each in coordinates]))
    starts += [
        np.array([each.inner(values[each.name]) for each in coordinates]) for values in _humps(regression, scales)
    ]
    try:
        tried = [regression.search(each, evaluations=th.FIRST_EVALUATIONS, tolerance=1e-5) for each in starts]
    except Exception as error:  # noqa: BLE001  raised again where this candidate is refined, and costs it alone
        return Search(starts[0], failure=error)
    best = min(tried, key=lambda each: each.cost)
    if not math.isfinite(best.cost):
        return Search(starts[0], failure=FitError("its torque is not defined at any start of the search"))
    return Search(best.at)


def _humps(regression: Regression, scales: InitialScales) -> list[dict[str, float]]:
    """Return starts with a hump; ordinary records take presliding for a level near zero at standstill."""
    names = hump(regression.structure)
    values = next(structures.starts(regression.structure, scales, 0, 0))
    slowest = min(scales.least_sliding_speed, scales.speed)
    found = []
    for share in th.HUMP_WIDTHS if names else ():
        width = slowest ** (1.0 - share) * scales.speed**share
        levels = {name: width if name == "stribeck_velocity" else th.HUMP_HEIGHT * scales.level for name in names}
        found.append({**values, **levels})
    return found


def _continued(regression: Regression, search: Search, evaluations: int) -> Search:
    try:
        solution = regression.search(search.at, evaluations=evaluations, tolerance=1e-4)
    except Exception as error:  # noqa: BLE001  raised again where this candidate is refined, and costs it alone
        return Search(search.at, failure=error)
    return Search(solution.at, prediction_error(regression.data.torque, regression.data.torque - solution.residual))
