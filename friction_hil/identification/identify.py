"""Identification of an axis: fit every candidate model to the same recordings, then choose one."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

from friction_hil.errors import RecordingError, UsageError
from friction_hil.identification import thresholds as th
from friction_hil.identification import unknown_gain
from friction_hil.identification.candidates import CandidateFitter
from friction_hil.identification.choice import choose, is_better, plausible, to_refine
from friction_hil.identification.data import RegressionSegment
from friction_hil.identification.fine import rounding_notes, shows_presliding, why_not_refined
from friction_hil.identification.fits import ENDED_EARLY, Fit
from friction_hil.identification.prediction_errors import is_grouped, speeds_alike
from friction_hil.identification.refine import is_dynamic
from friction_hil.identification.refined_modifiers import refine_modifiers
from friction_hil.identification.settings import FitStep, IdentificationSettings
from friction_hil.identification.structures import EXTENDS
from friction_hil.identification.torque_timing import TorqueTiming, torque_timing
from friction_hil.recordings import Recording
from friction_hil.recordings.segments import is_position_integrated, with_position

_DISPENSABLE = ("sigma1", "viscous.quadratic")  # parameters that may as well be zero
_REFINED = "Fitted once more at the resolution of the encoder; the chosen one is among these"
_NOT_REFINED = "Fitted to the low-passed recordings only; these errors do not compare with those above"


@dataclass(frozen=True, slots=True, eq=False)
class Identification:
    """All fitted candidates and the reason for the choice among them."""

    # The chosen one first, then the other refined ones, then the rest, each by their error on held-out data. Errors of
    # refined and of other fits refer to different rows and do not compare.
    fits: tuple[Fit, ...]
    reason: str  # one sentence
    records: tuple[RegressionSegment, ...]  # used for fitting
    validation: tuple[RegressionSegment, ...]  # used for validation only
    settings: IdentificationSettings
    notes: tuple[str, ...]  # remarks that concern all candidates
    torque: TorqueTiming | None = None  # age of the measured torque, if it was looked for
    failures: tuple[str, ...] = ()  # notes on what was left out because of an internal error

    @property
    def best(self) -> Fit:
        """Chosen candidate."""
        return self.fits[0]

    @property
    def groups(self) -> tuple[tuple[str, tuple[Fit, ...]], ...]:
        """Fits whose errors compare with each other, that of the chosen one first, each group with its heading."""
        refined = tuple(each for each in self.fits if each.is_refined)
        others = tuple(each for each in self.fits if not each.is_refined)
        known = ((_REFINED if others else "", refined), (_NOT_REFINED if refined else "", others))
        return tuple((heading, fits) for heading, fits in known if fits)


def identify(
    recordings: Sequence[Recording],  # of one axis, each with ``position`` and ``torque``
    settings: IdentificationSettings | None = None,
    *,
    validation: Sequence[Recording] = (),  # not fitted to; every candidate is judged on them
    progress: Callable[[FitStep], None] = lambda _: None,  # called before each fit
) -> Identification:
    """Identify friction, inertia, offset and gravity of one axis.

    Raises `RecordingError`: a recording lacks a column or is too short, or the axis does not move; `UsageError`: a
    setting is invalid.
    """
    if not recordings:
        raise UsageError("identify needs a recording")
    recordings, validation = [with_position(each) for each in recordings], [with_position(each) for each in validation]
    settings = settings or IdentificationSettings()
    if any(map(is_position_integrated, (*recordings, *validation))):
        settings = _without_position(settings)
    fitter = CandidateFitter(recordings, validation, settings, progress)
    is_refined_later = not fitter.known and shows_presliding(fitter.data.records, fitter.settings.refine)
    if fitter.settings.axis == "rotary":  # the counts of linear encoders are round numbers
        fitter.notes += rounding_notes(fitter.data.records)
    if not is_refined_later and not fitter.known and fitter.settings.refine is None:
        fitter.notes += why_not_refined(fitter.data.records)
    fits, free = _fit_all(fitter, is_refined_later=is_refined_later and fitter.settings.has_modifiers)
    if not any(math.isfinite(each.held_out.rmse) for each in fits):
        raise RecordingError(f"no candidate could be fitted to the recording: {'; '.join(fitter.notes)}")
    kind = "groups of recordings" if is_grouped(fitter.data) else "blocks"
    if fitter.validation is None and (speeds := speeds_alike(fitter.data)) is not None:
        fitter.notes.append(_one_kind(*speeds, fitter.settings))
    best, reason = choose(fits, kind)
    torque = None
    again = to_refine(best, [*fits, *free]) if not fitter.known else []
    if again and is_refined_later:
        torque = fitter.attempt("the age of the torque", lambda: _settle_torque(fitter, again))
        refined = fitter.attempt("the refinement", lambda: _refine(fitter, fits, again))
        fits, best, reason = refined or (fits, best, reason)
    others = sorted(
        (each for each in fits if each is not best), key=lambda each: (not each.is_refined, each.held_out.rmse)
    )
    if fitter.known:  # after sorting: each fit has a gain of its own, so that torques do not compare but signals do
        best, *others = (unknown_gain.in_torque(each, fitter.data.parts) for each in (best, *others))
    kept = () if fitter.validation is None else fitter.validation.records
    return Identification(
        (best, *others),
        reason,
        fitter.data.records,
        kept,
        fitter.settings,
        tuple(dict.fromkeys(fitter.notes)),
        torque,
        tuple(dict.fromkeys(fitter.failures)),
    )


def _one_kind(low: float, high: float, settings: IdentificationSettings) -> str:
    """Return the note on recordings whose strokes reach speeds from ``low`` to ``high``, which are alike."""
    unit = "m/s" if settings.axis == "linear" else "rad/s"
    return (
        f"the choice rests on one kind of motion: all strokes reach {low:.3g} to {high:.3g} {unit}, so that what is "
        "held out is like what is fitted; to compare the models on other motions, record strokes of a third and of "
        "three times the speed, or give such a recording to --validate"
    )


def _without_position(settings: IdentificationSettings) -> IdentificationSettings:
    """Return settings for recordings without a position: neither gravity nor presliding is looked for.

    Raises `UsageError`: they ask for what depends on the position.
    """
    if settings.gravity == "pendulum" or settings.refine:
        what = "a pendulum" if settings.gravity == "pendulum" else "the refinement"
        raise UsageError(f"{what} needs a measured position, and a recording has only its velocity")
    return replace(settings, gravity="none" if settings.gravity == "auto" else settings.gravity, refine=False)


def plausible_fits(identification: Identification) -> tuple[Fit, ...]:
    """Return the fits that may describe the axis, e.g. to try each of them in a simulation.

    The chosen one comes first, then those that are not worse than the best on held-out data by more than two standard
    errors of the difference, those without parameters at a bound first, then the best one of each other family, static
    and dynamic. Refined fits come before fits whose errors do not compare with theirs, which are there only if no
    refined fit has their family.
    """
    found: list[Fit] = []
    for _, fits in identification.groups:
        families = {each.structure.family for each in found}
        found += [each for each in plausible(fits, identification.best) if each.structure.family not in families]
    return tuple(found)


def _fit_all(fitter: CandidateFitter, *, is_refined_later: bool) -> tuple[list[Fit], list[Fit]]:
    """Fit all families, the best ones with further modifiers, and these without parameters that do not show.

    Dynamic families that are refined later get their modifiers there: ordinary records hardly show these models. Second
    come the fits of families whose hump the data do not show, and which others replace among the first.
    """
    fitter.begin("families", 2 * len(fitter.families))
    families = _fit_families(fitter, is_refined_later=is_refined_later)
    fitter.begin("modifiers")
    fits = _supported(fitter, families)
    bases = [each for each in fits if not (is_refined_later and is_dynamic(each.structure))]
    if fitter.settings.has_modifiers:
        fits = _supported(fitter, [*fits, *_fit_modified(fitter, bases)])
    bases = [each for each in fits if not (is_refined_later and is_dynamic(each.structure))]
    pruned = fitter.attempt("what the data do not show", lambda: _fit_pruned(fitter, bases)) or []
    fits = _supported(fitter, [*fits, *pruned])
    return (unknown_gain.usable(fits) if fitter.known else fits), [each for each in families if each not in fits]


def _supported(fitter: CandidateFitter, fits: Sequence[Fit]) -> list[Fit]:
    return fitter.attempt("the test of Stribeck humps", lambda: fitter.supported(fits)) or list(fits)


def _fit_families(fitter: CandidateFitter, *, is_refined_later: bool) -> list[Fit]:
    """Fit every family, and those that are not far worse than the best with parameters for each direction."""
    plain: dict[str, Fit] = {}
    directed: dict[str, Fit] = {}
    own = [family for family in fitter.families if EXTENDS.get(family) not in fitter.families]
    extensions = [family for family in fitter.families if family not in own]
    for families in (own, extensions):
        _fit_families_as(fitter, families, plain, {})
    wanted = [
        family for family in _not_far(fitter, plain) if not (is_refined_later and is_dynamic(plain[family].structure))
    ]
    for families in (own, extensions):
        _fit_families_as(fitter, [family for family in families if family in wanted], directed, plain)
    return [*plain.values(), *directed.values()]


def _fit_families_as(
    fitter: CandidateFitter, families: Sequence[str], found: dict[str, Fit], plain: Mapping[str, Fit]
) -> None:
    """Fit families and add them to ``found``; with ``plain`` fits to start from, each direction has parameters."""
    tasks = []
    for family in families:
        base = found.get(EXTENDS.get(family, "")) or plain.get(family)
        structure = fitter.attempt(family, partial(fitter.build, family, is_directed=bool(plain)))
        if structure is not None:
            tasks.append((structure, None if base is None else base.values))
    fits = zip(tasks, fitter.fit_all(tasks), strict=True)
    found.update({structure.family: each for (structure, _), each in fits if each is not None})


def _not_far(fitter: CandidateFitter, fits: Mapping[str, Fit]) -> list[str]:
    """Return the families whose errors are not many times that of the best one, and note the others."""
    lowest = min((each.train.rmse for each in fits.values()), default=0.0)
    kept = [
        family
        for family, each in fits.items()
        if each.train.rmse <= max(th.FAMILIES_FAR * lowest, th.EXACT * _scale(each))
    ]
    left = [family for family in fits if family not in kept]
    if left:
        fitter.notes.append(
            f"{', '.join(left)}: not fitted for each direction, because the error is more than {th.FAMILIES_FAR:g} "
            "times that of the best family"
        )
    return kept


def _scale(fit: Fit) -> float:
    """Return the root mean square of the measured torque."""
    return fit.train.rmse / fit.train.relative_error if fit.train.relative_error > 0.0 else 0.0


def _fit_modified(fitter: CandidateFitter, fits: list[Fit]) -> list[Fit]:
    """Fit the best families with further modifiers, adding one at a time while held-out errors fall."""
    found = []
    bases = _best_of_families(fitter, fits)
    is_plain = {each.structure.family for each in bases if not each.structure.modifiers}
    # without the load, a dependence on it looks like a difference of directions or like a larger family
    for each in fits:
        family = each.structure.family
        if each.structure.modifiers or family in is_plain:
            continue
        if family == "coulomb" or any(family == base.structure.family for base in bases):
            found += fitter.attempt(f"{each.label} + load", partial(_fit_plain_with_load, fitter, each)) or []
    for base in bases:
        found += fitter.attempt(f"{base.label} with modifiers", partial(_fit_rounds, fitter, base)) or []
    return found


def _fit_rounds(fitter: CandidateFitter, base: Fit) -> list[Fit]:
    """Fit one family with further modifiers, adding one at a time while held-out errors fall."""
    found, now = [], base
    for _ in range(th.FAMILIES_ROUNDS):
        fitted = [
            fitter.fit_with_load(each, now) if "load" in each.modifiers else fitter.fit(each, now.values)
            for each in list(fitter.with_modifier(now))
        ]
        tried = [each for each in fitted if each is not None]
        better = [each for each in tried if is_better(each, now)]
        found += tried
        if not better:
            break
        now = min(better, key=lambda each: each.held_out.rmse)
    return found


def _best_of_families(fitter: CandidateFitter, fits: list[Fit]) -> list[Fit]:
    """Return the best fit of each of the best families; one that extends another fitted family does not count."""
    best: dict[str, Fit] = {}
    for each in sorted(fits, key=lambda each: each.held_out.rmse):
        if EXTENDS.get(each.structure.family) not in fitter.families:
            best.setdefault(each.structure.family, each)
    return list(best.values())[: th.EXTENDED]


def _fit_plain_with_load(fitter: CandidateFitter, plain: Fit) -> list[Fit]:
    """Fit a structure without modifiers again with load dependence, if the load varies."""
    if not fitter.set_load(plain.mechanics):
        return []
    structures = [each for each in fitter.with_modifier(plain) if "load" in each.modifiers]
    return [each for each in (fitter.fit_with_load(one, plain) for one in structures) if each is not None]


def _fit_pruned(fitter: CandidateFitter, fits: list[Fit]) -> list[Fit]:
    """Fit the best structures again without dispensable parameters that the data do not show."""
    found: list[Fit] = []
    for each in sorted(fits, key=lambda each: each.held_out.rmse):
        errors = each.inference.standard_errors
        vague = [
            name for name in _DISPENSABLE if not errors.get(name, 0.0) <= th.VAGUE * abs(each.values.get(name, 0.0))
        ]
        if not vague or EXTENDS.get(each.structure.family) in fitter.families:
            continue
        structure = each.structure.drop(vague)
        if any(other.label == structure.label for other in fits):
            continue
        fitter.set_load(each.mechanics)
        if (fitted := fitter.fit(structure, {**each.values, **each.mechanics})) is not None:
            found.append(fitted)
        if len(found) == th.EXTENDED:
            break
    return found


def _refine(fitter: CandidateFitter, fits: list[Fit], again: list[Fit]) -> tuple[list[Fit], Fit, str]:
    """Refine some of the fits; return all fits with these replaced, the choice among the refined, and its reason."""
    fitter.begin("refinement", len(again))
    refined = fitter.refine_all(again)
    fits = [each for each in fits if each.label not in {other.label for other in refined}]
    if not refined:  # the fits to ordinary records are left
        best, reason = choose(fits)
        return fits, best, f"no candidate could be fitted at the resolution of the encoder: {reason}"
    refined = fitter.supported(refined)
    outdone: tuple[Fit, ...] = ()
    if fitter.settings.has_modifiers:
        fitter.begin("refined modifiers")
        modified = refine_modifiers(fitter, refined)
        refined, outdone = [*refined, *modified.tried], modified.outdone
    fits = [each for each in fits if each.label not in {other.label for other in refined}] + refined
    left = [each for each in refined if each not in outdone]
    # rough parameters are no candidates, unless all others were held flat or left out
    best, further = choose([each for each in left if ENDED_EARLY not in each.flags] or left, kind="refined ")
    if outdone:
        lost = ", ".join(dict.fromkeys(each.label for each in outdone))
        further += f" (less well than the same with more or fewer modifiers: {lost})"
    return (
        fits,
        best,
        f"the recordings show presliding, so the dynamic families were fitted again at full resolution: {further}",
    )


def _settle_torque(fitter: CandidateFitter, fits: list[Fit]) -> TorqueTiming | None:
    """Find out what the measured torque is, unless the user has said it, and note what it is taken for."""
    if fitter.settings.torque != "auto":
        taken = {"mean": "the mean over the period before the sample", "instant": "that of the instant"}
        fitter.notes.append(
            f"torque is taken to be {taken[fitter.settings.torque]}; if it is not (--torque-is), damping of presliding "
            f"is wrong by its stiffness times half a period, {0.5 / fitter.data.records[0].rate_hz:.3g} s"
        )
        return None
    fitter.begin("age of the torque")
    timing = torque_timing(fitter, fits)
    is_mean = (timing.meaning or timing.assumed) == "mean"
    fitter.set_torque_timing(is_mean=is_mean, delay_s=timing.delay_s if timing.meaning == "late" else 0.0)
    fitter.notes.append(timing.text)
    return timing
