"""Candidate models of one identification: their structures, the mechanics fitted with them, and their fits. Pure."""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import TypeVar

from friction_hil import friction as models
from friction_hil.compensator.load import gravity_torque
from friction_hil.errors import FrictionHilError, RecordingError, UsageError, choices, internal_error
from friction_hil.friction.modifiers import SIDES
from friction_hil.identification import humps, modifiers, structures, unknown_gain
from friction_hil.identification import thresholds as th
from friction_hil.identification.choice import is_better, is_significant
from friction_hil.identification.data import LEAST_ROWS, Data, RegressionSegment, prepare
from friction_hil.identification.fine import fine_data, is_fine
from friction_hil.identification.fits import MECHANICS, Fit, ended, fit, refined
from friction_hil.identification.least_squares import NUMERICAL
from friction_hil.identification.regression import BACK_EMF, INVERSE_GAIN, Estimate, Regression
from friction_hil.identification.scales import estimate_scales
from friction_hil.identification.screening import Search, screened
from friction_hil.identification.settings import FitStep, IdentificationSettings, chosen_families
from friction_hil.identification.sliding import LOW_HZ, WIDE_HZ, sliding_mechanics
from friction_hil.identification.structures import EQUAL_IN_FEEDFORWARD, ModelStructure
from friction_hil.identification.thresholds import COARSE_STEPS_HZ, STEPS_HZ
from friction_hil.numerics.jit import Array
from friction_hil.parallel import in_parallel
from friction_hil.recordings import Recording

Result = TypeVar("Result")


class CandidateFitter:
    """Fits candidate models to the recordings of one axis on equal terms.

    Raises `RecordingError`: a recording lacks a column or is too short, or the axis does not move; `UsageError`: a
    setting is invalid.
    """

    def __init__(
        self,
        recordings: Sequence[Recording],  # that are fitted to
        validation: Sequence[Recording],  # that every candidate is judged on
        settings: IdentificationSettings,
        progress: Callable[[FitStep], None],  # called before each fit
    ) -> None:
        self.settings = settings
        self._progress = progress
        self._stage, self._number = "", 0
        self._count: int | None = None
        self.families = chosen_families(settings.families)
        # torques per unit of their column, if the gain of the drive is unknown; else empty
        self.known = unknown_gain.known_torque(settings.held) if settings.has_unknown_gain else {}
        self.data = Data(self._prepared(recordings), self.known)  # to fit to
        if len(self.data) < LEAST_ROWS:
            name = recordings[0].axis
            raise RecordingError(f"axis {name} moves in {len(self.data)} rows only; {LEAST_ROWS} are the least")
        kept = self._prepared(validation)
        self.validation = Data(kept, self.known) if kept else None
        self._held = {} if self.known else {name: x for name, x in settings.held.items() if name in MECHANICS}
        self.notes: list[str] = []  # remarks that concern all candidates
        # what was left out because of an internal error, with the error; among the notes, too
        self.failures: list[str] = []
        self._offset: float | None = None
        if not settings.families:
            self.notes += [
                f"{a} equals {b} in a recording: fitted only if named" for a, b in EQUAL_IN_FEEDFORWARD.items()
            ]
        self._loads: list[Array] | None = None
        self._fine: Data | None = None
        self._coarse: Data | None = None
        # meaning of the measured torque in `fine` records: see `friction_hil.identification.fine.FineSegment`
        self.is_mean, self.delay_s = settings.torque != "instant", 0.0
        self.scales = estimate_scales(self.data, ("inertia", "offset"))
        self._gravity = self._fitted_gravity()
        if self._gravity:
            self.scales = estimate_scales(self.data, ("inertia", "offset", *self._gravity))
        self._hold_slow_mechanics()
        self._check_held()

    def _prepared(self, recordings: Sequence[Recording]) -> list[RegressionSegment]:
        settings = self.settings
        return [
            part
            for each in recordings
            for part in prepare(
                each,
                lowpass_hz=settings.lowpass_hz,
                decimation=settings.decimation,
                least_speed=settings.least_speed,
                sliding_s=settings.sliding_s,
                sliding_distance=settings.sliding_distance,
                group_by=settings.group_by,
            )
        ]

    # --- structures

    def build(self, family: str, *, is_directed: bool) -> ModelStructure:
        """Return the structure of a family, with the parameters that the user holds."""
        structure = self._plain_structure(family, is_directed=is_directed)
        for name, value in self.settings.held.items():
            if name in (*MECHANICS, BACK_EMF):
                continue
            sides = [f"direction.{side}.{name}" for side in SIDES]
            if all(side in structure.names for side in sides):
                for side in sides:
                    structure = structure.hold(side, value)
            elif name in _names(structure):
                structure = structure.hold(name, value)
        if self.known and BACK_EMF not in self.known:
            structure = unknown_gain.without_viscous(structure)
        return modifiers.with_ripple(structure, self.settings.orders) if self.settings.orders else structure

    def _plain_structure(self, family: str, *, is_directed: bool) -> ModelStructure:
        return structures.build(
            family, self.scales, self.settings.axis, self.data.records[0].dt, is_directed=is_directed
        )

    def with_modifier(self, base: Fit) -> Iterator[ModelStructure]:
        """Yield the structure of a fit with one modifier more, for each modifier that the data could show."""
        self.set_load(base.mechanics)
        yield from modifiers.excited(
            base.structure,
            self.data,
            self.scales,
            base.estimate,
            self._loads,
            is_load_fitted=self._is_load_fitted,
        )

    # --- fits

    def begin(self, stage: str, count: int | None = None) -> None:
        """Begin a stage of the identification, with ``count`` fits if that is known; see `FitStep`."""
        self._stage, self._number, self._count = stage, 0, count

    def report(self, label: str) -> None:
        """Report that the next fit of the stage begins."""
        self._number += 1
        self._progress(FitStep(self._stage, self._number, self._count, label))

    def attempt(self, label: str, job: Callable[[], Result]) -> Result | None:
        """Return the result of a fit; None, with a note, if it fails: one candidate does not end a search."""
        found, failure = _attempted(job)
        self._drop(label, failure)
        return found

    def _attempt_all(self, labels: Sequence[str], jobs: Sequence[Callable[[], Result]]) -> list[Result | None]:
        """Return the results of independent fits, None for each that fails."""
        given = [partial(_attempted, job) for job in jobs]
        found = in_parallel(given, lambda number: self.report(labels[number]))
        for label, (_, failure) in zip(labels, found, strict=True):
            self._drop(label, failure)
        return [result for result, _ in found]

    def _drop(self, label: str, failure: Exception | None) -> None:
        if isinstance(failure, NUMERICAL):
            reason = str(failure) or type(failure).__name__
            self.notes.append(f"{label} was left out, because its numbers failed: {reason}")
        elif failure is not None:
            self.failures.append(f"{label} was left out, because of {internal_error(failure)}")
            self.notes.append(self.failures[-1])

    def fit_all(self, tasks: Sequence[tuple[ModelStructure, Mapping[str, float] | None]]) -> list[Fit | None]:
        """Fit structures, each starting from given values or None, at the same time; None for each that failed."""
        prepared = [self.attempt(structure.label, partial(self._job, structure, warm)) for structure, warm in tasks]
        jobs = [job for job in prepared if job is not None]
        labels = [structure.label for (structure, _), job in zip(tasks, prepared, strict=True) if job is not None]
        found = iter(self._attempt_all(labels, jobs))
        return [None if job is None else next(found) for job in prepared]

    def fit(self, structure: ModelStructure, warm: Mapping[str, float] | None = None) -> Fit | None:
        """Fit one candidate, starting from the values ``warm`` of a related one if given; None if it failed."""
        self.report(structure.label)
        return self.attempt(structure.label, lambda: self._job(structure, warm)())

    def _job(self, structure: ModelStructure, warm: Mapping[str, float] | None) -> Callable[[], Fit]:
        """Return the fit of a structure, to be run; what it needs of this object is taken now."""
        mechanics, held, notes = self._mechanics(structure)
        if structure.family in EQUAL_IN_FEEDFORWARD:
            notes.append(
                f"not excited: stick_velocity; while it slides {structure.family} is "
                f"{EQUAL_IN_FEEDFORWARD[structure.family]}, and a recording does not show how it sticks"
            )
        loads = self._loads if "load" in structure.modifiers else None
        regression = Regression(self.data, structure, mechanics, held, loads)
        check = None
        if self.validation is not None:
            own = self._loads_of(self.validation, warm) if loads else None
            check = Regression(self.validation, structure, mechanics, held, own)
        return partial(
            fit,
            regression,
            self.scales,
            seed=self.settings.seed,
            warm=warm,
            is_robust=self.settings.is_robust,
            validation=check,
            notes=notes,
        )

    def fit_with_load(self, structure: ModelStructure, base: Fit) -> Fit | None:
        """Fit a structure whose load is gravity: alternately, if gravity is identified by the same fit."""
        fitted = base
        for _ in range(th.LOAD_ROUNDS):
            self.set_load(fitted.mechanics)
            found = self.fit(structure, {**fitted.values, **fitted.mechanics})
            if found is None or not self._is_load_fitted:
                return found
            fitted = found
        return fitted

    @property
    def fine(self) -> Data:
        """Records at the full resolution of the encoder."""
        if self._fine is None:
            self._fine = self._fine_data(self.data.records)
        return self._fine

    @property
    def coarse(self) -> Data:
        """Records at the full resolution of the encoder, with few steps of the model per sample."""
        if self._coarse is None:
            self._coarse = self._fine_data(self.data.records, COARSE_STEPS_HZ)
        return self._coarse

    def _fine_data(self, records: Sequence[RegressionSegment], steps_hz: float = STEPS_HZ) -> Data:
        return fine_data(records, is_mean=self.is_mean, delay_s=self.delay_s, steps_hz=steps_hz)

    def set_torque_timing(self, *, is_mean: bool, delay_s: float) -> None:
        """Take the measured torque of `fine` records for a mean or instantaneous one that is late by ``delay_s``."""
        self.is_mean, self.delay_s, self._fine, self._coarse = is_mean, delay_s, None, None

    def fine_regression(
        self,
        structure: ModelStructure,
        mechanics: Mapping[str, float],
        data: Data | None = None,
        like: ModelStructure | None = None,
    ) -> Regression:
        """Return the regression of a structure on `fine`, or on other data.

        ``mechanics`` define the load. Which of them are fitted depends on the structure, or on that of ``like``.
        """
        names, held, _ = self._mechanics(like or structure)
        data = self.fine if data is None else data
        loads = self._loads_of(data, mechanics) if "load" in structure.modifiers else None
        return Regression(data, structure, names, held, loads)

    def with_fine_modifier(self, base: Fit, estimate: Estimate) -> Iterator[ModelStructure]:
        """Yield the structure of a refined fit with one modifier more; ``estimate`` is that of the fit, on `fine`."""
        loads = self._loads_of(self.fine, base.mechanics)
        yield from modifiers.excited(
            base.structure, self.fine, self.scales, estimate, loads, is_load_fitted=self._is_load_fitted
        )

    def refine_all(self, bases: Sequence[Fit]) -> list[Fit]:
        """Fit structures once more on records at the full resolution of the encoder; those that fail are left out.

        The searches begin with few steps of the model per sample. Candidates that fit far worse than others go no
        further (sequential halving).
        """
        made = {
            id(each): self.attempt(each.label, partial(self._coarse_regression, each.structure, each.mechanics))
            for each in bases
        }
        bases = [each for each in bases if made[id(each)] is not None]
        regressions = [regression for regression in made.values() if regression is not None]
        labels = [each.label for each in bases]
        searches = screened(regressions, [each.coordinates for each in bases], self.scales)
        _ = self.fine  # computed here, not by each of the threads
        jobs = [
            partial(self._refined, base, regression, search)
            for base, regression, search in zip(bases, regressions, searches, strict=True)
        ]
        return [each for each in self._attempt_all(labels, jobs) if each is not None]

    def refine(self, base: Fit) -> Fit | None:
        """Fit one structure once more, from the coordinates of ``base``; None if its numbers fail."""
        self.report(base.label)
        return self.attempt(
            base.label, lambda: self._refined(base, self._coarse_regression(base.structure, base.mechanics))
        )

    def _coarse_regression(self, structure: ModelStructure, mechanics: Mapping[str, float]) -> Regression:
        return self.fine_regression(structure, mechanics, self.coarse)

    def _refined(self, base: Fit, coarse: Regression, search: Search | None = None) -> Fit:
        """Return the refined fit of a candidate, from where the search on fewer steps of the model ended, if any."""
        if search is not None and search.failure is not None:
            raise search.failure
        _, _, notes = self._mechanics(base.structure)
        check = None
        if self.validation is not None:
            records = self.validation.records
            data = self._fine_data(records) if all(map(is_fine, records)) else self.validation
            check = self.fine_regression(base.structure, base.mechanics, data)
        if search is not None and search.is_ended:
            return ended(coarse, search.estimate(coarse), validation=check, notes=notes)
        return refined(
            base,
            self.fine_regression(base.structure, base.mechanics),
            coarse,
            self.data,
            self.scales,
            start=base.coordinates if search is None else search.at,
            replicas=self.settings.replicas,
            seed=self.settings.seed,
            validation=check,
            notes=notes,
        )

    def supported(self, fits: Sequence[Fit]) -> list[Fit]:
        """Replace fits whose Stribeck hump the data do not show by fits whose static level is the Coulomb level.

        A hump that is narrower than the slowest sliding is free to take any height, which the motion to be compensated
        may well visit. One that stands above the Coulomb level stays if held-out data are clearly worse without it.
        """
        given = {(each.label, each.is_refined): each for each in fits}
        coulomb = {each.structure.modifiers for each in fits if each.structure.family == "coulomb"}
        flats = {id(each): humps.flattened(each, self.scales) for each in fits}
        wanted = [
            found for found in flats.values() if found is not None and not humps.is_coulomb(found.structure, coulomb)
        ]
        plain = [each for each in wanted if not each.is_refined]
        fitted = given | {
            (each.label, False): each
            for each in self.fit_all([(each.structure, each.values) for each in plain])
            if each is not None
        }
        refined_ones = [each for each in wanted if each.is_refined and (each.label, True) not in given]
        if refined_ones:
            self.begin("refinement", len(refined_ones))
            fitted |= {(each.label, True): each for each in self.refine_all(refined_ones)}
        humped = self._upright(
            [
                (each, fitted.get((base.label, True)))
                for each, base in zip(fits, flats.values(), strict=True)
                if base is not None and each.is_refined
            ]
        )
        found = []
        for each in fits:
            base = flats[id(each)]
            if id(each) in humped:
                found.append(humped[id(each)])
                continue
            if base is None:
                found.append(each)
            elif (flat := fitted.get((base.label, base.is_refined))) is None:
                continue
            elif humps.is_upright(each) and is_significant(each, flat):
                found.append(each)
            elif (base.label, base.is_refined) not in given:  # else it is in the list already
                found.append(replace(flat, flags=(*flat.flags, humps.why_flat(each, self.scales))))
        return found

    def _upright(self, pairs: Sequence[tuple[Fit, Fit | None]]) -> dict[int, Fit]:
        """Return fits with a hump by the identity of a free fit with a dip, where the flat one is clearly worse."""
        wanted = [(each, flat) for each, flat in pairs if flat is not None and not humps.is_upright(each)]
        if not wanted:
            return {}
        seeds = [humps.upright(each, flat.values, self.scales) for each, flat in wanted]
        refined = {each.label: each for each in self.refine_all(seeds)}
        return {
            id(each): refined[each.label]
            for each, flat in wanted
            if each.label in refined and is_significant(refined[each.label], flat)
        }

    # --- mechanics and load

    def _mechanics(self, structure: ModelStructure) -> tuple[list[str], dict[str, float], list[str]]:
        """Return the mechanical parameters fitted with a structure, those held, and notes on both."""
        level = "gravity.constant" if "gravity.constant" in self._gravity else "offset"
        names = self._linear("inertia", level, *self._gravity)
        held = dict(self._held)
        notes: list[str] = []
        if self.known:
            notes += unknown_gain.notes(structure, self.known)
        if "load" in structure.modifiers and self._is_load_fitted:
            notes.append(
                "collinear: load.motoring and load.driven with gravity, which is fitted too; one value is used for both"
            )
        if "direction" in structure.modifiers and level in names:
            names.remove(level)
            held[level] = (
                self._constant_torque if abs(self._constant_torque) > th.LARGE_OFFSET * self.scales.level else 0.0
            )
            notes.append(
                f"collinear: {level} with the difference between the levels of the two directions; {level} is held at "
                f"{held[level]:.4g}: only a torque at rest that is free of friction could tell them apart"
            )
        return names, held, notes

    @property
    def _constant_torque(self) -> float:
        """Offset of a Coulomb fit without modifiers."""
        if self._offset is None:
            swinging = [name for name in self._gravity if name != "gravity.constant"]
            self._offset = self._coulomb_fit("inertia", "offset", *swinging).mechanics["offset"]
        return self._offset

    def _coulomb_fit(self, *mechanics: str) -> Fit:
        structure = self._plain_structure("coulomb", is_directed=False)
        regression = Regression(self.data, structure, self._linear(*mechanics), self._held)
        try:
            return fit(regression, self.scales)
        except NUMERICAL as error:
            reason = str(error) or type(error).__name__
            path = self.data.records[0].path
            raise RecordingError(f"{path}: not even Coulomb friction can be fitted: {reason}") from None

    def _fitted_gravity(self) -> tuple[str, ...]:
        """Return the names of the gravity parameters to identify."""
        kind = self.settings.gravity
        pendulum = ("gravity.sine", "gravity.cosine")
        if kind == "constant":
            return ("gravity.constant",)
        if kind == "pendulum":
            return pendulum
        if kind == "none" or self.settings.axis == "linear" or self.scales.travel < th.PENDULUM_TRAVEL:
            return ()
        without, swinging = (self._coulomb_fit("inertia", "offset", *gravity) for gravity in ((), pendulum))
        if is_better(swinging, without):
            self.notes.append("gravity: sine and cosine of the position predict held-out blocks better than none")
            return pendulum
        # presliding, whose torque is that of a spring, hides gravity from a Coulomb fit to all rows
        slow = None if self.known else sliding_mechanics(self.data.records, can_swing=True)
        if slow is None or not slow.has_swing:
            return ()
        self.notes.append("gravity: sine and cosine of the position are clear where the axis slides")
        return pendulum

    def _hold_slow_mechanics(self) -> None:
        """Hold inertia and gravity at those of slow motion where faster motion shows another inertia.

        Then the load swings on a coupling, and a model of one mass would take the axis for too light.
        """
        if self.known or "inertia" in self._held:
            return
        pendulum = ("gravity.sine", "gravity.cosine")
        can_swing = all(name in self._gravity and name not in self._held for name in pendulum)
        found = [
            sliding_mechanics(self.data.records, can_swing=can_swing, low_hz=low_hz) for low_hz in (LOW_HZ, WIDE_HZ)
        ]
        slow, fast = found
        if slow is None or fast is None or not slow.differs(fast):
            return
        self._held["inertia"] = slow.inertia
        if can_swing:
            self._held |= dict(zip(pendulum, (slow.sine, slow.cosine), strict=True))
        named = "inertia and gravity are held at those" if can_swing else "inertia is held at that"
        self.notes.append(
            f"{named} of motion below {LOW_HZ:g} Hz: inertia {slow.inertia:.4g} (standard error "
            f"{slow.inertia_error:.2g}); up to {WIDE_HZ:g} Hz it would be {fast.inertia:.4g}, because the load swings "
            "on its coupling"
        )

    def _linear(self, *mechanics: str) -> list[str]:
        """Return the linear parameters to identify; with an unknown gain, its inverse replaces known ones."""
        names = [name for name in dict.fromkeys(mechanics) if name not in self._held]
        if self.known:
            names = [INVERSE_GAIN, *(name for name in (*names, BACK_EMF) if name not in self.known)]
        return names

    @property
    def _is_load_fitted(self) -> bool:
        """True if the load is a gravity that is identified, or known in another unit than the signal."""
        if self.known:
            return True
        if all(record.load_torque is not None for record in self.data.records):
            return False
        return any(name not in self._held for name in self._gravity)

    def set_load(self, mechanics: Mapping[str, float]) -> bool:
        """Take gravity for the load of fits to come, unless a load was recorded; return True if there is a load."""
        self._loads = self._loads_of(self.data, mechanics)
        return self._loads is not None

    def _loads_of(self, data: Data, mechanics: Mapping[str, float] | None) -> list[Array] | None:
        """Return the load torque of each record, recorded or due to gravity; None if there is neither."""
        recorded = [record.load_torque for record in data.records if record.load_torque is not None]
        if len(recorded) == len(data.records) and not self.known:
            return recorded
        names = [name for name in MECHANICS if name.startswith("gravity.")]
        factors = [0.0 if mechanics is None else mechanics.get(name, 0.0) for name in names]
        if not any(factors):
            return None
        constant, sine, cosine = factors
        return [gravity_torque(constant, sine, cosine, record.position) for record in data.records]

    def _check_held(self) -> None:
        """Raise `UsageError` if a held parameter belongs to no candidate or its value is not a number."""
        known = {*MECHANICS, BACK_EMF} if self.known else set(MECHANICS)
        for family in self.families if self.settings.held else ():
            for is_directed in (False, True):
                structure = self._plain_structure(family, is_directed=is_directed)
                known |= _names(structure)
                if self.known:
                    unknown_gain.check_held(structure, self.settings.held)
        for name, value in self.settings.held.items():
            if name not in known:
                raise UsageError(f"no candidate has a parameter {name!r} to hold; {choices(name, known)}")
            if math.isnan(value):
                raise UsageError(f"a value to hold is a number; {name} is {value}")


def _attempted(job: Callable[[], Result]) -> tuple[Result | None, Exception | None]:
    """Return the result of a fit, or None and what it has raised: an error of the program costs this fit alone."""
    try:
        return job(), None
    except NUMERICAL as error:
        return None, error
    except FrictionHilError:  # a mistake in the data or the settings, which concerns all
        raise
    except Exception as error:  # noqa: BLE001  told by `_drop`
        return None, error


def _names(structure: ModelStructure) -> set[str]:
    """Return all parameter names of a structure that can be held."""
    own = {parameter.name for parameter in models.describe(structure.family).parameters}
    tied = {name for each in structure.coordinates for name in each.names}
    return own | tied | set(structure.linear)
