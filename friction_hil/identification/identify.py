"""From recordings to a model: every candidate on equal terms, and the choice among them."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from friction_hil import models
from friction_hil.errors import RecordingError, UsageError, choices
from friction_hil.identification import modifiers, structures
from friction_hil.identification.data import Data, Record, prepare
from friction_hil.identification.fits import MECHANICS, Fit, fit
from friction_hil.identification.inference import VAGUE
from friction_hil.identification.problem import Problem
from friction_hil.identification.scales import scales as size_up
from friction_hil.identification.structures import EQUAL_IN_FEEDFORWARD, EXTENDS, Structure
from friction_hil.jit import Array
from friction_hil.models.modifiers import SIDES
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
    seed : int
        Of the random starts.
    lowpass_hz, decimation
        See `friction_hil.identification.data.prepare`.
    """

    families: tuple[str, ...] = ()
    axis: Literal["rotary", "linear"] = "rotary"
    gravity: GravityKind = "auto"
    held: Mapping[str, float] = field(default_factory=dict)
    is_robust: bool = False
    has_modifiers: bool = True
    seed: int = 0
    lowpass_hz: float | None = None
    decimation: int | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Identification:
    """All candidates, best first, and why the first one is.

    Attributes
    ----------
    fits : tuple of Fit
        The chosen one, then the others by held-out error.
    reason : str
        One sentence.
    records, validation : tuple of Record
        What was fitted to, and what was kept apart.
    settings : Settings
    notes : tuple of str
        What concerns all candidates.
    """

    fits: tuple[Fit, ...]
    reason: str
    records: tuple[Record, ...]
    validation: tuple[Record, ...]
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
        self.families = _families(settings)
        self.data = Data(self._prepared(recordings))
        kept = self._prepared(validation)
        self.validation = Data(kept) if kept else None
        self.held = {name: value for name, value in settings.held.items() if name in MECHANICS}
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

    def _prepared(self, recordings: Sequence[Recording]) -> list[Record]:
        lowpass_hz, decimation = self.settings.lowpass_hz, self.settings.decimation
        return [part for each in recordings for part in prepare(each, lowpass_hz=lowpass_hz, decimation=decimation)]

    def run(self) -> Identification:
        """Fit all candidates and choose."""
        fits = self._families_fitted()
        if self.settings.has_modifiers:
            fits += self._modified(fits)
        fits += self._pruned(fits)
        best, reason = choose(fits)
        others = sorted((each for each in fits if each is not best), key=lambda each: each.held_out.rmse)
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
            if name in MECHANICS:
                continue
            sides = [f"direction.{side}.{name}" for side in SIDES]
            if all(side in structure.names for side in sides):
                for side in sides:
                    structure = structure.hold(side, value)
            elif name in _names(structure):
                structure = structure.hold(name, value)
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

    def _mechanics(self, structure: Structure) -> tuple[list[str], dict[str, float], list[str]]:
        """Linear parameters of the mechanics that go with a structure, those that are held, and what is odd."""
        level = "gravity.constant" if "gravity.constant" in self.gravity else "offset"
        names = list(dict.fromkeys(["inertia", level, *self.gravity]))
        held = dict(self.held)
        notes: list[str] = []
        if "direction" in structure.modifiers and level not in held:
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
            plain = fit(
                Problem(self.data, self._coulomb(), ["inertia", "offset", *_swinging(self.gravity)], self.held),
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
            fit(Problem(self.data, structure, ["inertia", "offset", *gravity], self.held), self.scales)
            for gravity in ((), pendulum)
        )
        if not _is_better(swinging, without):
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
        for base in list(best.values())[:_EXTENDED]:
            now = base
            for _ in range(_ROUNDS):
                self.loads = self._loads_of(self.data, now.mechanics)
                more = list(modifiers.excited(now.structure, self.data, self.scales, now.curves.residual, self.loads))
                tried = [
                    self._with_load(each, now) if "load" in each.modifiers else self.fit(each, now.values)
                    for each in more
                ]
                better = [each for each in tried if _is_better(each, now)]
                found += tried
                if not better:
                    break
                now = min(better, key=lambda each: each.held_out.rmse)
        return found

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
            structure = each.structure
            for name in vague:
                structure = structure.hold(name, 0.0)
            found.append(self.fit(replace(structure, without=tuple(vague)), each.values))
            if len(found) == _EXTENDED:
                break
        return found

    def _with_load(self, structure: Structure, base: Fit) -> Fit:
        """Fit with a load that is gravity, which the fit itself finds."""
        fitted = base
        for _ in range(_LOAD_ROUNDS):
            self.loads = self._loads_of(self.data, fitted.mechanics)
            fitted = self.fit(structure, {**fitted.values, **fitted.mechanics})
            if all(record.load_torque is not None for record in self.data.records):
                break
        return fitted

    def _loads_of(self, data: Data, mechanics: Mapping[str, float] | None) -> list[Array] | None:
        """Load torque of each record: recorded, or that of gravity; None where there is neither."""
        recorded = [record.load_torque for record in data.records if record.load_torque is not None]
        if len(recorded) == len(data.records):
            return recorded
        names = [name for name in MECHANICS if name.startswith("gravity.")]
        factors = [0.0 if mechanics is None else mechanics.get(name, 0.0) for name in names]
        if not any(factors):
            return None
        constant, sine, cosine = factors
        return [constant + sine * np.sin(record.position) + cosine * np.cos(record.position) for record in data.records]

    def _check_held(self) -> None:
        """Refuse a held name that no candidate has."""
        known = set(MECHANICS)
        for family in self.families:
            for is_directed in (False, True):
                structure = structures.build(
                    family, self.scales, self.settings.axis, self.data.records[0].dt, is_directed=is_directed
                )
                known |= _names(structure)
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


def _swinging(gravity: Sequence[str]) -> list[str]:
    return [name for name in gravity if name != "gravity.constant"]


def _families(settings: Settings) -> tuple[str, ...]:
    if not settings.families:
        return structures.families()
    known = (*structures.families(), *EQUAL_IN_FEEDFORWARD)
    for name in settings.families:
        models.describe(name)
        if name not in known:
            raise UsageError(f"no recording can be fitted with {name!r}; {choices(name, known)}")
    return tuple(dict.fromkeys(settings.families))


def _limit(fit: Fit) -> float:
    """Mean square error of held-out blocks plus its standard error."""
    errors = np.array(fit.held_out.blocks)
    error = float(np.std(errors, ddof=1)) / math.sqrt(len(errors)) if len(errors) > 1 else 0.0
    return float(np.mean(errors)) + error


def _is_better(fit: Fit, base: Fit) -> bool:
    """Whether a fit predicts held-out blocks better, block by block, by more than one standard error."""
    gain = np.array(base.held_out.blocks) - np.array(fit.held_out.blocks)
    error = float(np.std(gain, ddof=1)) / math.sqrt(len(gain)) if len(gain) > 1 else 0.0
    return float(np.mean(gain)) > error


def is_determined(fit: Fit) -> bool:
    """Whether each parameter that was searched for is larger than its standard error."""
    errors = fit.inference.standard_errors
    return all(
        errors[each.name] <= abs(fit.values[each.name]) for each in fit.structure.coordinates if each.name in errors
    )


def choose(fits: Sequence[Fit]) -> tuple[Fit, str]:
    """The fit with the fewest parameters within one standard error of the one that predicts best, and the reason.

    One whose parameters the data determine goes before one whose they do not: where any size of a parameter fits
    alike, it need not elsewhere.

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
        where = "blocks held out in turn"
    if len(usable) == 1:
        return chosen, f"{chosen.label} is the only candidate; it predicts {where} to {_percent(chosen)}"
    shown = "whose parameters the data determine" if sound else "though the data do not determine its parameters"
    first = f"of {len(usable)} candidates {lowest.label} predicts {where} best ({_percent(lowest)})"
    if chosen is lowest:
        return chosen, f"{first}, and no simpler one within one standard error of it does as well"
    return chosen, (
        f"{first}; {chosen.label} ({_percent(chosen)}) is the simplest within one standard error of it {shown}: "
        f"{chosen.count} parameters, not {lowest.count}"
    )


def _percent(fit: Fit) -> str:
    return f"{100.0 * fit.held_out.relative_error:.2f} %"
