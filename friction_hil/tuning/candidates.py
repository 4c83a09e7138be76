"""Identification of an axis from its experiment, and the fits that are worth trying on the machine. Pure."""

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

from friction_hil import friction as models
from friction_hil.config import Configuration
from friction_hil.errors import RecordingError
from friction_hil.identification import Fit, Identification, IdentificationSettings, identify
from friction_hil.identification.choice import is_determined
from friction_hil.identification.progress import FitStep
from friction_hil.identification.refine import is_dynamic
from friction_hil.identification.settings import chosen_families
from friction_hil.motion.experiment import is_fast
from friction_hil.recordings import Recording
from friction_hil.tuning.motions import experiment_of, sliding_part

CandidateFit = tuple[Identification, Fit]
"""A fit that is to be tried, with the identification that it belongs to."""

_LEAST_SPEED_RATIO = 0.05  # of the highest speed: below, what holds the axis is no friction to a static model


def identified(
    recording: Recording,
    configuration: Configuration,
    families: Sequence[str],
    *,
    on_fit: Callable[[FitStep], None],
    on_problem: Callable[[str], None],
) -> list[Identification]:
    """Identify dynamic models from all of an experiment, and static ones from where the axis slides.

    Parameters
    ----------
    recording : Recording
        Recording of a run of `friction_hil.tuning.motions.experiment_run`, with a torque.
    configuration : Configuration
        From which that run was made.
    families : sequence of str
        Families to fit; empty for all.
    on_fit : callable
        Called with a `FitStep` before each fit.
    on_problem : callable
        Called with a sentence if static models cannot be identified.

    Raises
    ------
    RecordingError
        Nothing can be identified.
    """
    found: list[Identification] = []
    for part, settings in _parts(recording, configuration, tuple(families)):
        try:
            found.append(identify([part], settings, progress=on_fit))
        except RecordingError as error:  # e.g. an axis that hardly slides
            if not found:
                raise
            on_problem(f"no static model: {error}")
    return found


def candidates(found: Sequence[Identification]) -> list[CandidateFit]:
    """Return the best sound static fit and the best sound dynamic one, in the order in which they were identified.

    If no fit is sound, it is the best one of the first identification.
    """
    fits: dict[bool, CandidateFit] = {}
    for identification in found:
        for fit in identification.fits:
            if math.isfinite(fit.held_out.rmse) and _is_sound(fit):
                fits.setdefault(is_dynamic(fit.structure), (identification, fit))
    return list(fits.values()) or [(found[0], found[0].best)]


def _parts(
    recording: Recording, configuration: Configuration, wanted: tuple[str, ...]
) -> Iterator[tuple[Recording, IdentificationSettings]]:
    """Yield the parts of an experiment with the families to identify from each: dynamic ones, then static ones."""
    name = recording.axis
    axis = configuration.axes[name]
    families = chosen_families(wanted)
    static = tuple(family for family in families if models.describe(family).is_static)
    dynamic = tuple(family for family in families if family not in static)
    least_speed = _LEAST_SPEED_RATIO * experiment_of(name, axis).velocity
    sliding = IdentificationSettings(families=static, axis=axis.model.axis, least_speed=least_speed)
    if not is_fast(1.0 / configuration.period_s):  # too slow to see presliding: its experiment has no fast sweeps
        yield recording, replace(sliding, families=wanted or static)
        return
    if dynamic:
        yield recording, IdentificationSettings(families=dynamic, axis=axis.model.axis)
    if static:
        yield sliding_part(recording, configuration), sliding


def _is_sound(fit: Fit) -> bool:
    """True if the data determine a fit and, for a static one, no parameter is at a bound.

    Around a reversal, presliding looks like a level near zero at standstill. A model without presliding that was
    fitted to it would take the compensation away just where the axis reverses.
    """
    return is_determined(fit) and (is_dynamic(fit.structure) or not _at_bound(fit))


def _at_bound(fit: Fit) -> list[str]:
    return [each.name for each in fit.structure.coordinates if each.name in fit.estimate.at_bound]


def why_not_tried(fit: Fit) -> str:
    """Return the reason for which `candidates` leaves a fit out that is otherwise the best."""
    if is_determined(fit) and (names := _at_bound(fit)):
        return f"at a bound: {', '.join(names)}; no model without presliding is tried with that"
    return "the data do not determine its parameters"
