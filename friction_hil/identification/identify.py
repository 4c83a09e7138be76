"""From recordings to a model: every candidate on equal terms, and the choice among them."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from friction_hil import friction as models
from friction_hil.errors import RecordingError, UsageError, choices
from friction_hil.friction.modifiers import SIDES
from friction_hil.identification import drive, modifiers, structures
from friction_hil.identification.choice import choose, is_better, to_refine
from friction_hil.identification.data import LEAST_ROWS, Data, RegressionSegment, prepare
from friction_hil.identification.errors import is_grouped
from friction_hil.identification.fine import fine_data, is_fine, shows_presliding
from friction_hil.identification.fits import MECHANICS, Fit, fit, refined
from friction_hil.identification.inference import VAGUE
from friction_hil.identification.problem import BACK_EMF, INVERSE_GAIN, Problem
from friction_hil.identification.refine import REPLICAS
from friction_hil.identification.scales import scales as size_up
from friction_hil.identification.structures import EQUAL_IN_FEEDFORWARD, EXTENDS, Structure
from friction_hil.numerics.jit import Array
from friction_hil.recordings import Recording

GravityKind = Literal["auto", "none", "constant", "pendulum"]
_PENDULUM_TRAVEL = 0.3  # rad: over less, sine and cosine are but a slope
_LARGE_OFFSET = 0.5  # of the level: beyond, an offset is no difference between directions
_EXTENDED = 2  # families that are tried with further modifiers
_ROUNDS = 3  # of adding one modifier more
_DISPENSABLE = ("sigma1", "viscous.quadratic")  # zero is a fair value of these
_LOAD_ROUNDS = 3  # of learning gravity, which is the load, and friction that grows with it


@dataclass(frozen=True, slots=True)
class Settings:
    """What to look for.

    Attributes
    ----------
    families : tuple of str
        Names of families; empty for all.
    axis : str
        ``rotary`` or ``linear``.
    gravity : str
        ``none``, ``constant`` (vertical axis), ``pendulum`` (sine and cosine), or ``auto``: a pendulum where that
        predicts held-out blocks better.
    held : dict
        Values of parameters that are not looked for.
    is_robust : bool
        Huber's loss in place of squares.
    has_modifiers : bool
        Whether further modifiers than direction are tried.
    has_unknown_gain : bool
        The column ``torque`` is a signal in a unit of its own (V, A), and torque = gain signal - back_emf velocity:
        both are looked for, and what is held of inertia and gravity sets the scale
        (`friction_hil.identification.drive`).
    least_speed, group_by
        See `friction_hil.identification.data.prepare`; groups are held out in turn.
    seed : int
        Of the random starts.
    lowpass_hz, decimation
        See `friction_hil.identification.data.prepare`.
    refine : bool, optional
        Whether the chosen model, if it is dynamic, is fitted once more with all that the encoder tells
        (`friction_hil.identification.refine`). By default where all recordings show presliding: position in known
        steps, sampled at 500 Hz or more, and swings faster than 8 Hz.
    torque : str
        What a measured torque is, which the refinement needs to know: ``mean`` over the period that ends at the
        sample, or that of the ``instant``.
    replicas : int
        Experiments that the refinement repeats on the computer.
    """

    families: tuple[str, ...] = ()
    axis: Literal["rotary", "linear"] = "rotary"
    gravity: GravityKind = "auto"
    held: Mapping[str, float] = field(default_factory=dict)
    is_robust: bool = False
    has_modifiers: bool = True
    has_unknown_gain: bool = False
    least_speed: float = 0.0
    group_by: str | None = None
    seed: int = 0
    lowpass_hz: float | None = None
    decimation: int | None = None
    refine: bool | None = None
    torque: Literal["mean", "instant"] = "mean"
    replicas: int = REPLICAS


@dataclass(frozen=True, slots=True, eq=False)
class Identification:
    """All candidates, best first, and why the first one is.

    Attributes
    ----------
    fits : tuple of Fit
        The chosen one, then the others by held-out error.
    reason : str
        One sentence.
    records, validation : tuple of RegressionSegment
        What was fitted to, and what was kept apart.
    settings : Settings
    notes : tuple of str
        What concerns all candidates.
    """

    fits: tuple[Fit, ...]
    reason: str
    records: tuple[RegressionSegment, ...]
    validation: tuple[RegressionSegment, ...]
    settings: Settings
    notes: tuple[str, ...]

    @property
    def best(self) -> Fit:
        """The chosen candidate."""
        return self.fits[0]


def identify(
    recordings: Sequence[Recording],
    settings: Settings | None = None,
    *,
    validation: Sequence[Recording] = (),
    progress: Callable[[str], None] = lambda _: None,
) -> Identification:
    """Identify friction, inertia, offset and gravity of one axis.

    Parameters
    ----------
    recordings : sequence of Recording
        Of the same axis, each with ``position`` and ``torque``.
    settings : Settings, optional
    validation : sequence of Recording
        Kept apart: every candidate is judged on them.
    progress : callable
        Told the name of each candidate before it is fitted.

    Raises
    ------
    RecordingError
        A recording lacks a column or is too short, or the axis does not move.
    UsageError
        A setting does not fit.
    """
    if not recordings:
        raise UsageError("identify needs a recording")
    return _Search(recordings, validation, settings or Settings(), progress).run()


class _Search:
    """The candidates of one identification."""

    def __init__(
        self,
        recordings: Sequence[Recording],
        validation: Sequence[Recording],
        settings: Settings,
        progress: Callable[[str], None],
    ) -> None:
        self.settings, self.progress = settings, progress
        self.families = chosen_families(settings.families)
        self.known = drive.known_torque(settings.held) if settings.has_unknown_gain else {}
        self.data = Data(self._prepared(recordings), self.known)
        if len(self.data) < LEAST_ROWS:
            name = recordings[0].axis
            raise RecordingError(f"axis {name} moves in {len(self.data)} rows only; {LEAST_ROWS} are the least")
        kept = self._prepared(validation)
        self.validation = Data(kept, self.known) if kept else None
        self.held = {} if self.known else {name: x for name, x in settings.held.items() if name in MECHANICS}
        self.notes: list[str] = []
        self._offset: float | None = None
        if not settings.families:
            self.notes += [f"{a} is {b} in a recording: not tried by itself" for a, b in EQUAL_IN_FEEDFORWARD.items()]
        self.loads: list[Array] | None = None
        self.scales = size_up(self.data, ("inertia", "offset"))
        self.gravity = self._gravity()
        if self.gravity:
            self.scales = size_up(self.data, ("inertia", "offset", *self.gravity))
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
                group_by=settings.group_by,
            )
        ]

    def run(self) -> Identification:
        """Fit all candidates and choose."""
        fits = self._families_fitted()
        if self.settings.has_modifiers:
            fits += self._modified(fits)
        fits += self._pruned(fits)
        if self.known:
            fits = drive.usable(fits)
        best, reason = choose(fits, "groups of recordings" if is_grouped(self.data) else "blocks")
        again = to_refine(best, fits) if not self.known else []
        if again and shows_presliding(self.data.records, self.settings.refine):
            once_more = [self._refined(each) for each in again]
            fits = [each for each in fits if each.label not in {other.label for other in once_more}] + once_more
            best, further = choose(once_more)
            reason = (
                "the recording shows presliding, so that the dynamic families were fitted once more, with the position "
                f"to a count and the model in several steps a sample: {further}"
            )
        others = sorted((each for each in fits if each is not best), key=lambda each: each.held_out.rmse)
        if self.known:  # only now: one number for all of a fit, but not the same one for all fits
            best, *others = (drive.in_torque(each, self.data.parts) for each in (best, *others))
        kept = () if self.validation is None else self.validation.records
        return Identification((best, *others), reason, self.data.records, kept, self.settings, tuple(self.notes))

    def _families_fitted(self) -> list[Fit]:
        plain: dict[str, Fit] = {}
        directed: dict[str, Fit] = {}
        for family in self.families:
            related = EXTENDS.get(family, "")
            warm = plain[related].values if related in plain else None
            plain[family] = self.fit(self.build(family, is_directed=False), warm)
            warm = directed[related].values if related in directed else plain[family].values
            directed[family] = self.fit(self.build(family, is_directed=True), warm)
        return [*plain.values(), *directed.values()]

    def build(self, family: str, *, is_directed: bool) -> Structure:
        """Structure of a family with what the user holds."""
        structure = structures.build(
            family, self.scales, self.settings.axis, self.data.records[0].dt, is_directed=is_directed
        )
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
            structure = drive.without_viscous(structure)
        return structure

    def fit(self, structure: Structure, warm: Mapping[str, float] | None = None) -> Fit:
        """Fit one candidate."""
        self.progress(structure.label)
        mechanics, held, notes = self._mechanics(structure)
        if structure.family in EQUAL_IN_FEEDFORWARD:
            notes.append(
                f"not excited: stick_velocity; while it slides {structure.family} is "
                f"{EQUAL_IN_FEEDFORWARD[structure.family]}, and how it sticks is a choice of who simulates it"
            )
        loads = self.loads if "load" in structure.modifiers else None
        kept = self.validation
        problem = Problem(self.data, structure, mechanics, held, loads)
        check = None
        if kept is not None:
            check = Problem(kept, structure, mechanics, held, self._loads_of(kept, warm) if loads else None)
        return fit(
            problem,
            self.scales,
            seed=self.settings.seed,
            warm=warm,
            is_robust=self.settings.is_robust,
            validation=check,
            notes=notes,
        )

    def _refined(self, base: Fit) -> Fit:
        """The chosen fit once more, on fine records."""
        self.progress(f"{base.label}, once more with all that the encoder tells")

        def problem(data: Data) -> Problem:
            loads = self._loads_of(data, base.mechanics) if "load" in base.structure.modifiers else None
            return Problem(data, base.structure, mechanics, held, loads)

        mechanics, held, notes = self._mechanics(base.structure)
        is_mean, check = self.settings.torque == "mean", None
        if self.validation is not None:
            records = self.validation.records
            check = problem(fine_data(records, is_mean=is_mean) if all(map(is_fine, records)) else self.validation)
        return refined(
            base,
            problem(fine_data(self.data.records, is_mean=is_mean)),
            self.data,
            self.scales,
            replicas=self.settings.replicas,
            seed=self.settings.seed,
            validation=check,
            notes=notes,
        )

    def _mechanics(self, structure: Structure) -> tuple[list[str], dict[str, float], list[str]]:
        """Linear parameters of the mechanics that go with a structure, those that are held, and what is odd."""
        level = "gravity.constant" if "gravity.constant" in self.gravity else "offset"
        names = self._linear("inertia", level, *self.gravity)
        held = dict(self.held)
        notes: list[str] = []
        if self.known:
            notes += drive.notes(structure, self.known)
        if "load" in structure.modifiers and self._is_load_found:
            notes.append(
                "collinear: load.motoring and load.driven with gravity, which is found here; one value stands for both"
            )
        if "direction" in structure.modifiers and level in names:
            names.remove(level)
            held[level] = (
                self._constant_torque if abs(self._constant_torque) > _LARGE_OFFSET * self.scales.level else 0.0
            )
            notes.append(
                f"collinear: {level} with the difference between the levels of the two directions; {level} is held at "
                f"{held[level]:.4g}: only a torque at rest that is free of friction could tell them apart"
            )
        return names, held, notes

    @property
    def _constant_torque(self) -> float:
        """Offset of a plain Coulomb fit."""
        if self._offset is None:
            swinging = [name for name in self.gravity if name != "gravity.constant"]
            plain = fit(
                Problem(self.data, self._coulomb(), self._linear("inertia", "offset", *swinging), self.held),
                self.scales,
            )
            self._offset = plain.mechanics["offset"]
        return self._offset

    def _coulomb(self) -> Structure:
        return structures.build("coulomb", self.scales, self.settings.axis, self.data.records[0].dt, is_directed=False)

    def _gravity(self) -> tuple[str, ...]:
        """Parameters of gravity that are looked for."""
        kind = self.settings.gravity
        pendulum = ("gravity.sine", "gravity.cosine")
        if kind == "constant":
            return ("gravity.constant",)
        if kind == "pendulum":
            return pendulum
        if kind == "none" or self.settings.axis == "linear" or self.scales.travel < _PENDULUM_TRAVEL:
            return ()
        structure = self._coulomb()
        without, swinging = (
            fit(Problem(self.data, structure, self._linear("inertia", "offset", *gravity), self.held), self.scales)
            for gravity in ((), pendulum)
        )
        if not is_better(swinging, without):
            return ()
        self.notes.append("gravity: sine and cosine of the position predict held-out blocks better than none")
        return pendulum

    def _modified(self, fits: list[Fit]) -> list[Fit]:
        """The best families with further modifiers, one at a time while that predicts better."""
        found = []
        best: dict[str, Fit] = {}
        for each in sorted(fits, key=lambda each: each.held_out.rmse):
            if EXTENDS.get(each.structure.family) not in self.families:  # else its special case stands for it
                best.setdefault(each.structure.family, each)
        bases = list(best.values())[:_EXTENDED]
        is_plain = {each.structure.family for each in bases if not each.structure.modifiers}
        for each in fits:  # what the load does is easily mistaken for directions, or for the hump of a larger family
            family = each.structure.family
            if each.structure.modifiers or family in is_plain:
                continue
            if family == "coulomb" or any(family == base.structure.family for base in bases):
                found += self._plain_with_load(each)
        for base in bases:
            now = base
            for _ in range(_ROUNDS):
                self.loads = self._loads_of(self.data, now.mechanics)
                left, is_found = now.curves.residual, self._is_load_found
                more = modifiers.excited(
                    now.structure, self.data, self.scales, left, self.loads, is_load_found=is_found
                )
                tried = [
                    self._with_load(each, now) if "load" in each.modifiers else self.fit(each, now.values)
                    for each in more
                ]
                better = [each for each in tried if is_better(each, now)]
                found += tried
                if not better:
                    break
                now = min(better, key=lambda each: each.held_out.rmse)
        return found

    def _plain_with_load(self, plain: Fit) -> list[Fit]:
        """The fit with load dependence, where the load changes."""
        loads = self.loads = self._loads_of(self.data, plain.mechanics)
        if loads is None:
            return []
        is_found, left = self._is_load_found, plain.curves.residual
        more = modifiers.excited(plain.structure, self.data, self.scales, left, loads, is_load_found=is_found)
        return [self._with_load(each, plain) for each in more if "load" in each.modifiers]

    def _pruned(self, fits: list[Fit]) -> list[Fit]:
        """The best fits without what the data do not show."""
        found = []
        for each in sorted(fits, key=lambda each: each.held_out.rmse):
            errors = each.inference.standard_errors
            vague = [
                name for name in _DISPENSABLE if not errors.get(name, 0.0) <= VAGUE * abs(each.values.get(name, 0.0))
            ]
            if not vague or EXTENDS.get(each.structure.family) in self.families:
                continue
            structure = each.structure.drop(vague)
            if any(other.label == structure.label for other in fits):
                continue
            self.loads = self._loads_of(self.data, each.mechanics)
            found.append(self.fit(structure, {**each.values, **each.mechanics}))
            if len(found) == _EXTENDED:
                break
        return found

    def _with_load(self, structure: Structure, base: Fit) -> Fit:
        """Fit with a load that is gravity, which the fit itself finds."""
        fitted = base
        for _ in range(_LOAD_ROUNDS):
            self.loads = self._loads_of(self.data, fitted.mechanics)
            fitted = self.fit(structure, {**fitted.values, **fitted.mechanics})
            if not self._is_load_found:
                break
        return fitted

    def _linear(self, *mechanics: str) -> list[str]:
        """Linear parameters that are looked for, instead of those of the mechanics where the gain is unknown."""
        names = [name for name in dict.fromkeys(mechanics) if name not in self.held]
        if self.known:
            names = [INVERSE_GAIN, *(name for name in (*names, BACK_EMF) if name not in self.known)]
        return names

    @property
    def _is_load_found(self) -> bool:
        """Whether the load is that of a gravity which is looked for, or known in other units than the signal."""
        if self.known:
            return True
        if all(record.load_torque is not None for record in self.data.records):
            return False
        return any(name not in self.held for name in self.gravity)

    def _loads_of(self, data: Data, mechanics: Mapping[str, float] | None) -> list[Array] | None:
        """Load torque of each record: recorded, or that of gravity; None where there is neither."""
        recorded = [record.load_torque for record in data.records if record.load_torque is not None]
        if len(recorded) == len(data.records) and not self.known:
            return recorded
        names = [name for name in MECHANICS if name.startswith("gravity.")]
        factors = [0.0 if mechanics is None else mechanics.get(name, 0.0) for name in names]
        if not any(factors):
            return None
        constant, sine, cosine = factors
        return [constant + sine * np.sin(record.position) + cosine * np.cos(record.position) for record in data.records]

    def _check_held(self) -> None:
        """Refuse a held name that no candidate has."""
        known = {*MECHANICS, BACK_EMF} if self.known else set(MECHANICS)
        for family in self.families:
            for is_directed in (False, True):
                structure = structures.build(
                    family, self.scales, self.settings.axis, self.data.records[0].dt, is_directed=is_directed
                )
                known |= _names(structure)
                if self.known:
                    drive.check_held(structure, self.settings.held)
        for name, value in self.settings.held.items():
            if name not in known:
                raise UsageError(f"no candidate has a parameter {name!r} to hold; {choices(name, known)}")
            if math.isnan(value):
                raise UsageError(f"a value to hold is a number; {name} is {value}")


def _names(structure: Structure) -> set[str]:
    """All names of a structure that can be held."""
    own = {parameter.name for parameter in models.describe(structure.family).parameters}
    tied = {name for each in structure.coordinates for name in each.names}
    return own | tied | set(structure.linear)


def chosen_families(names: Sequence[str]) -> tuple[str, ...]:
    """Families of friction models to look at: those that are named, or all.

    Raises
    ------
    UsageError
        There is no such family, or no recording can be fitted with it.
    """
    if not names:
        return structures.families()
    known = (*structures.families(), *EQUAL_IN_FEEDFORWARD)
    for name in names:
        models.describe(name)
        if name not in known:
            raise UsageError(f"no recording can be fitted with {name!r}; {choices(name, known)}")
    return tuple(dict.fromkeys(names))
