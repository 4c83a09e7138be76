"""The grid file: plants, drives, motions and conditions, and the knowledge of the compensator."""

import math
from collections.abc import Iterator
from glob import glob
from pathlib import Path
from typing import Annotated, Any, Literal, Self

from pydantic import Field, ValidationError, model_validator

from friction_hil import models
from friction_hil.checked_yaml import text as yaml_text
from friction_hil.checked_yaml.files import field_name
from friction_hil.checked_yaml.messages import Mistake, mistakes_of, refuse, validate
from friction_hil.checked_yaml.section import Section, key
from friction_hil.checked_yaml.text import Document, FieldPath
from friction_hil.compensator import Compensator, CompensatorSettings
from friction_hil.errors import ConfigurationError, Problem, UsageError, choices
from friction_hil.friction.parameters import InvalidParameterError
from friction_hil.models import FrictionModel
from friction_hil.models.model_file import Friction
from tools.benchmarks.compensation.belief import changed, converted, has_factor
from tools.benchmarks.compensation.machine import MOST_DELAY_CYCLES
from tools.benchmarks.compensation.motions import GridMotion

SAME = "same"
_UNLIMITED = 1e9  # N m
_WHOLE = 1e-9  # relative difference from a whole number that is rounding


class Compliance(Section):
    """A spring and damper to a second mass."""

    stiffness: float = key("of the coupling", "N m/rad", gt=0)
    damping: float = key("of the coupling", "N m s/rad", ge=0)
    load_inertia: float = key("behind the coupling", "kg m^2", gt=0)


class Plant(Section):
    """Motor with friction and encoder, and its load."""

    inertia: float = key("of the motor, or of motor and load without compliance", "kg m^2", gt=0)
    friction: Friction = key("the true one, at the motor")
    compliance: Compliance | None = key("between motor and load", default=None)
    backlash: float = key("total gap of the coupling; needs compliance", "rad", default=0.0, ge=0)
    rated_torque: float = key("its 1/1000 is the step of the torque feedback", "N m", default=0.64, gt=0)
    drives: list[str] | None = key("drives that it is combined with; all by default", default=None, min_length=1)

    @property
    def total_inertia(self) -> float:
        """Of motor and load, kg m^2."""
        return self.inertia + (self.compliance.load_inertia if self.compliance else 0.0)

    @property
    def friction_model(self) -> FrictionModel:
        """The true friction, made anew at each call."""
        return models.create(self.friction.model, modifiers=self.friction.modifiers, **self.friction.parameters)


class DriveLoops(Section):
    """The drive's own loops; a key that a drive omits has the value of the first drive of the file."""

    position_gain: float = key("position loop", "1/s", ge=0)
    velocity_gain: float = key("velocity loop", "N m s/rad", ge=0)
    integral_hz: float = key("corner of the velocity loop's integral action", "Hz", ge=0)
    torque_lag_s: float = key("time constant from torque demand to torque", "s", ge=0)
    rate_hz: float = key("sampling rate of the loops", "Hz", gt=0, le=80000)


class Belief(Section):
    """Friction of the compensator where it differs from the plant's."""

    parameters: dict[str, Any] = key("values, of the compensator's model", default={})
    factors: dict[str, Annotated[float, Field(gt=0)]] = key("factors of the plant's own values", default={})
    modifiers: dict[str, Any] | None = key("instead of those of the plant", default=None)


class Condition(Section):
    """Knowledge and feedback of the compensator."""

    gain: float = key("fraction of the friction torque that is commanded", "1", default=1.0, gt=0, le=2)
    friction: Belief = key("friction of the compensator; the plant's own by default", default=Belief())
    encoder_bits: int = key("of one revolution", default=20, ge=4, le=40)
    delay_cycles: int = key("from reading the encoder to the torque", default=1, ge=0, le=MOST_DELAY_CYCLES)


class CompensatorKeys(Section):
    """Model of the compensator, error of its inertia, and settings other than the defaults."""

    model: str = key(f"name of a friction model, or {SAME}: the plant's own family")
    inertia_error: float = key("relative error of the compensator's inertia", "1", default=0.0, gt=-1)
    source: Literal["auto", "measured", "demand"] | None = key("see CompensatorSettings", default=None)
    velocity: Literal["difference", "tracking", "kalman", "drive"] | None = key("see there", default=None)
    smoothing: float | None = key("see there", default=None, gt=0, le=1)
    acceleration: float | None = key("see there", "rad/s^2", default=None, gt=0)
    dead_band: float | None = key("see there", "rad/s", default=None, ge=0)
    adaptation_s: float | None = key("see there", "s", default=None, ge=0)

    @property
    def options(self) -> dict[str, Any]:
        """Given settings, by their name in `CompensatorSettings`."""
        return self.model_dump(exclude={"model", "inertia_error"}, exclude_none=True)


class Grid(Section):
    """Plants, drives, motions and conditions, each combined with each."""

    plants: dict[str, Plant] = key("simulated axes", min_length=1)
    drives: dict[str, DriveLoops] = key("control loops of the drives", min_length=1)
    motions: list[GridMotion] = key("demanded motions", min_length=1)
    conditions: dict[str, Condition] = key("knowledge and feedback of the compensator", min_length=1)
    compensator: CompensatorKeys = key("compensator that is compared with the other methods")
    machines: list[str] = key(
        "machine files, relative to this file, with * as in a shell; each is combined with the conditions", default=[]
    )
    duration_s: float = key("of each run", "s", default=6.0, gt=0, le=3600)
    settling_s: float = key("at the beginning of each run, not scored", "s", default=3.0, ge=0)
    period_s: float = key("of the compensator", "s", default=1e-3, gt=0)
    seed: int = key("of random phases", default=1, ge=0)

    @model_validator(mode="after")
    def _check(self) -> Self:
        refuse(self, _mistakes(self))
        refuse(self, _belief_mistakes(self))
        refuse(self, _compensator_mistakes(self))
        return self

    def drives_of(self, plant: str) -> list[str]:
        """Return the names of the drives that a plant is combined with."""
        named = self.plants[plant].drives
        return list(self.drives) if named is None else named

    def believed(self, plant: str, condition: str) -> FrictionModel:
        """Return the compensator's model."""
        own = self.plants[plant].friction_model
        belief = self.conditions[condition].friction
        if self.compensator.model != SAME:
            own = converted(own, self.compensator.model)
        return changed(own, belief.parameters, belief.factors, belief.modifiers)

    def settings(self, plant: str, drive: str, condition: str) -> CompensatorSettings:
        """Return the compensator's settings, with the gain of the condition."""
        given = self.conditions[condition]
        return CompensatorSettings(
            period_s=self.period_s,
            position_resolution=math.tau / 2**given.encoder_bits,
            torque_limit=_UNLIMITED,
            lead_s=self.lead_s(drive, condition),
            inertia=self.plants[plant].total_inertia * (1.0 + self.compensator.inertia_error),
            gain=given.gain,
            fade_s=self.period_s,
            **self.compensator.options,
        )

    def lead_s(self, drive: str, condition: str) -> float:
        """Return the time from reading the encoder to the middle of the torque, s: delay, half a period, torque lag."""
        return (self.conditions[condition].delay_cycles + 0.5) * self.period_s + self.drives[drive].torque_lag_s


def load(path: str | Path) -> Grid:
    """Read a grid file.

    Raises
    ------
    ConfigurationError
        It cannot be read or has mistakes; ``problems`` has each with its line.
    """
    document = yaml_text.read(path)
    problems = list(document.problems)
    value = _with_inherited_keys(document.value)
    grid: Grid | None = None
    try:
        grid = validate(Grid, value)
    except ValidationError as error:
        for steps, message in mistakes_of(error, Grid, value):
            if not _is_inherited(steps, document):
                problems.append(Problem(document.path, document.line(steps), field_name(steps), message))
    if problems or grid is None:
        raise ConfigurationError(sorted(dict.fromkeys(problems), key=lambda problem: problem.line or 0))
    return grid


def machine_files(grid: Grid, path: Path) -> list[Path]:
    """Return the machine files that a grid file names.

    Raises
    ------
    UsageError
        There is none of a name.
    """
    found: list[Path] = []
    for pattern in grid.machines:
        files = sorted(Path(name) for name in glob(str(path.parent / pattern)))
        if not files:
            raise UsageError(f"{path}: machines: there is no file {pattern}")
        found += files
    return found


def _with_inherited_keys(value: Any) -> Any:
    """Add the first drive's keys to the drives that omit them."""
    drives = value.get("drives") if isinstance(value, dict) else None
    if not isinstance(drives, dict) or not all(isinstance(drive, dict) for drive in drives.values()):
        return value
    first: dict[str, Any] = next(iter(drives.values()), {})
    return {**value, "drives": {name: {**first, **drive} for name, drive in drives.items()}}


def _is_inherited(steps: FieldPath, document: Document) -> bool:
    """True for a mistake in an inherited key, which is reported for the first drive."""
    if len(steps) < 3 or steps[0] != "drives":
        return False
    drives = document.value["drives"]
    return steps[1] != next(iter(drives)) and steps[2] not in drives[steps[1]]


def _mistakes(grid: Grid) -> Iterator[Mistake]:
    if grid.settling_s > grid.duration_s - grid.period_s:
        yield ("settling_s",), f"leaves nothing to score of duration_s = {grid.duration_s:g}"
    for name, drive in grid.drives.items():
        samples = drive.rate_hz * grid.period_s
        if samples < 1.0 - _WHOLE or abs(samples - round(samples)) > _WHOLE * samples:
            wanted = f"{max(round(samples), 1) / grid.period_s:g} would do"
            message = f"must be a multiple of 1 / period_s = {1.0 / grid.period_s:g} Hz, not {samples:g} times it"
            yield ("drives", name, "rate_hz"), f"{message}; {wanted}"
    names = [motion.name for motion in grid.motions]
    for index, motion in enumerate(names):
        if motion in names[:index]:
            yield ("motions", index), f"{motion} is there already"
    for name, plant in grid.plants.items():
        if plant.backlash > 0.0 and plant.compliance is None:
            yield ("plants", name, "backlash"), "needs compliance: the gap is in the coupling to the load"
        for index, drive_name in enumerate(plant.drives or ()):
            if drive_name not in grid.drives:
                yield (
                    ("plants", name, "drives", index),
                    f"no drive is called {drive_name!r}; {choices(drive_name, grid.drives)}",
                )


def _belief_mistakes(grid: Grid) -> Iterator[Mistake]:
    """Check that every condition yields a model for every plant, and that each factor is used."""
    known = (*models.names(), SAME)
    if grid.compensator.model not in known:
        wrong = grid.compensator.model
        yield ("compensator", "model"), f"no friction model is called {wrong!r}; {choices(wrong, known)}"
        return
    reported: set[FieldPath] = set()
    for name, condition in grid.conditions.items():
        unused = set(condition.friction.factors)
        for plant in grid.plants:
            try:
                own = grid.believed(plant, name).parameters
            except UsageError as error:
                steps = _origin(grid, name, error)
                unused.clear()
                if steps not in reported:
                    reported.add(steps)
                    yield steps, f"plant {plant}: {error}"
                continue
            unused = {factor for factor in unused if not has_factor(factor, own)}
        for factor in sorted(unused):
            yield ("conditions", name, "friction", "factors", factor), "is no parameter of any of the models"


def _origin(grid: Grid, condition: str, error: UsageError) -> FieldPath:
    """Return the path of the key that is the reason why there is no model."""
    belief = grid.conditions[condition].friction
    wrong = error.parameter if isinstance(error, InvalidParameterError) else None
    if wrong in belief.parameters:
        return ("conditions", condition, "friction", "parameters", str(wrong))
    if wrong in belief.factors:
        return ("conditions", condition, "friction", "factors", str(wrong))
    if belief.modifiers is not None and str(wrong).partition(".")[0] in belief.modifiers:
        return ("conditions", condition, "friction", "modifiers")
    return ("compensator", "model")


def _compensator_mistakes(grid: Grid) -> Iterator[Mistake]:
    condition = next(iter(grid.conditions))
    plant = next(iter(grid.plants))
    settings = grid.settings(plant, grid.drives_of(plant)[0], condition)
    try:
        Compensator(grid.believed(plant, condition), settings)
    except UsageError as error:
        yield ("compensator",), str(error)
