"""Identification of an axis: fit every candidate model to the same recordings, then choose one."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from friction_hil.errors import UsageError
from friction_hil.identification import unknown_gain
from friction_hil.identification.candidates import CandidateFitter
from friction_hil.identification.choice import choose, is_better, to_refine
from friction_hil.identification.data import RegressionSegment
from friction_hil.identification.fine import shows_presliding
from friction_hil.identification.fits import Fit
from friction_hil.identification.inference import VAGUE
from friction_hil.identification.prediction_errors import is_grouped
from friction_hil.identification.progress import FitStep
from friction_hil.identification.settings import IdentificationSettings
from friction_hil.identification.structures import EXTENDS
from friction_hil.recordings import Recording

_EXTENDED = 2  # families that are tried with further modifiers
_ROUNDS = 3  # of adding one more modifier
_DISPENSABLE = ("sigma1", "viscous.quadratic")  # parameters that may as well be zero
_REFINED = "Fitted once more at the resolution of the encoder; the chosen one is among these"
_NOT_REFINED = "Fitted to the low-passed recordings only; these errors do not compare with those above"


@dataclass(frozen=True, slots=True, eq=False)
class Identification:
    """All fitted candidates and the reason for the choice among them.

    Attributes
    ----------
    fits : tuple of Fit
        The chosen one first, then the other refined ones, then the rest, each by their error on held-out data. Errors
        of refined and of other fits refer to different rows and do not compare.
    reason : str
        One sentence.
    records, validation : tuple of RegressionSegment
        Records used for fitting, and records used for validation only.
    settings : IdentificationSettings
    notes : tuple of str
        Remarks that concern all candidates.
    """

    fits: tuple[Fit, ...]
    reason: str
    records: tuple[RegressionSegment, ...]
    validation: tuple[RegressionSegment, ...]
    settings: IdentificationSettings
    notes: tuple[str, ...]

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
    recordings: Sequence[Recording],
    settings: IdentificationSettings | None = None,
    *,
    validation: Sequence[Recording] = (),
    progress: Callable[[FitStep], None] = lambda _: None,
) -> Identification:
    """Identify friction, inertia, offset and gravity of one axis.

    Parameters
    ----------
    recordings : sequence of Recording
        Recordings of one axis, each with ``position`` and ``torque``.
    settings : IdentificationSettings, optional
    validation : sequence of Recording
        Recordings that are not fitted to; every candidate is judged on them.
    progress : callable
        Called with a `FitStep` before each fit.

    Raises
    ------
    RecordingError
        A recording lacks a column or is too short, or the axis does not move.
    UsageError
        A setting is invalid.
    """
    if not recordings:
        raise UsageError("identify needs a recording")
    fitter = CandidateFitter(recordings, validation, settings or IdentificationSettings(), progress)
    fits = _fit_all(fitter)
    best, reason = choose(fits, "groups of recordings" if is_grouped(fitter.data) else "blocks")
    again = to_refine(best, fits) if not fitter.known else []
    if again and shows_presliding(fitter.data.records, fitter.settings.refine):
        fits, best, reason = _refine(fitter, fits, again)
    others = sorted(
        (each for each in fits if each is not best), key=lambda each: (not each.is_refined, each.held_out.rmse)
    )
    if fitter.known:  # after sorting: each fit has a gain of its own, so that torques do not compare but signals do
        best, *others = (unknown_gain.in_torque(each, fitter.data.parts) for each in (best, *others))
    kept = () if fitter.validation is None else fitter.validation.records
    return Identification((best, *others), reason, fitter.data.records, kept, fitter.settings, tuple(fitter.notes))


def _fit_all(fitter: CandidateFitter) -> list[Fit]:
    """Fit all families, the best ones with further modifiers, and these without parameters that do not show."""
    fitter.begin("families", 2 * len(fitter.families))
    fits = _fit_families(fitter)
    fitter.begin("modifiers")
    if fitter.settings.has_modifiers:
        fits += _fit_modified(fitter, fits)
    fits += _fit_pruned(fitter, fits)
    return unknown_gain.usable(fits) if fitter.known else fits


def _fit_families(fitter: CandidateFitter) -> list[Fit]:
    """Fit every family, without modifiers and with parameters of its own for each direction."""
    plain: dict[str, Fit] = {}
    directed: dict[str, Fit] = {}
    for family in fitter.families:
        related = EXTENDS.get(family, "")
        warm = plain[related].values if related in plain else None
        plain[family] = fitter.fit(fitter.build(family, is_directed=False), warm)
        warm = directed[related].values if related in directed else plain[family].values
        directed[family] = fitter.fit(fitter.build(family, is_directed=True), warm)
    return [*plain.values(), *directed.values()]


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
            found += _fit_plain_with_load(fitter, each)
    for base in bases:
        now = base
        for _ in range(_ROUNDS):
            tried = [
                fitter.fit_with_load(each, now) if "load" in each.modifiers else fitter.fit(each, now.values)
                for each in list(fitter.with_modifier(now))
            ]
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
    return list(best.values())[:_EXTENDED]


def _fit_plain_with_load(fitter: CandidateFitter, plain: Fit) -> list[Fit]:
    """Fit a structure without modifiers again with load dependence, if the load varies."""
    if not fitter.set_load(plain.mechanics):
        return []
    structures = [each for each in fitter.with_modifier(plain) if "load" in each.modifiers]
    return [fitter.fit_with_load(each, plain) for each in structures]


def _fit_pruned(fitter: CandidateFitter, fits: list[Fit]) -> list[Fit]:
    """Fit the best structures again without dispensable parameters that the data do not show."""
    found: list[Fit] = []
    for each in sorted(fits, key=lambda each: each.held_out.rmse):
        errors = each.inference.standard_errors
        vague = [name for name in _DISPENSABLE if not errors.get(name, 0.0) <= VAGUE * abs(each.values.get(name, 0.0))]
        if not vague or EXTENDS.get(each.structure.family) in fitter.families:
            continue
        structure = each.structure.drop(vague)
        if any(other.label == structure.label for other in fits):
            continue
        fitter.set_load(each.mechanics)
        found.append(fitter.fit(structure, {**each.values, **each.mechanics}))
        if len(found) == _EXTENDED:
            break
    return found


def _refine(fitter: CandidateFitter, fits: list[Fit], again: list[Fit]) -> tuple[list[Fit], Fit, str]:
    """Refine some of the fits; return all fits with these replaced, the choice among the refined, and its reason."""
    fitter.begin("refinement", len(again))
    refined = [fitter.refine(each) for each in again]
    fits = [each for each in fits if each.label not in {other.label for other in refined}] + refined
    best, further = choose(refined, kind="refined ")
    return (
        fits,
        best,
        "the recordings show presliding, so that the dynamic families were fitted once more at the resolution of the "
        f"encoder, with several model steps per sample: {further}",
    )
