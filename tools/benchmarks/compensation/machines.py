"""Machine files in the benchmark: each axis with its own plant, loops, encoder and motions, as `simulate` has them."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

from friction_hil.config import AxisConfig, load
from friction_hil.errors import FrictionHilError, UsageError
from friction_hil.models.model_file import ModelFile
from friction_hil.rehearsal import Motion, Rehearsal, SimulatedAxis, simulated_axes
from friction_hil.servo.config import ServoConfig
from friction_hil.study.machine import LOAD, MOTOR, SIDES, Course, Errors, MotionResult, scored
from friction_hil.tuning.rehearsal_motions import simulated_motions
from tools.benchmarks.compensation.belief import changed, converted
from tools.benchmarks.compensation.grid import SAME, CompensatorKeys, Condition
from tools.benchmarks.compensation.progress import with_progress
from tools.benchmarks.compensation.truth import model_file, true_friction, without_torques

FILE, IDENTIFIED = "file", "identified"  # conditions: the model of the machine file, and the one that `tune` keeps
OWN, SOFT = "own", "soft"  # drives
_SOFTER = 0.5  # velocity gain of the soft drive, in that of the own one


@dataclass(frozen=True, slots=True)
class MachineCase:
    """One combination; ``condition`` is one of the grid's, `FILE` or `IDENTIFIED`."""

    machine: str
    drive: str
    motion: str
    condition: str


@dataclass(frozen=True, slots=True)
class MachineResult:
    """A case with its reductions.

    Attributes
    ----------
    case : MachineCase
    reduction : dict of Errors
        Factors by which the following error of motor and load is lower.
    bound : dict of float
        Factors for the RMS that a feed-forward can be expected to reach. Motor: what the lag of the drive leaves,
        without any friction, weight and disturbance. Load: also with what it deviates from the encoder, by twist, play,
        and errors of gear and encoder.
    gain_factor : float
        What the guard against limit cycles has left of the gain.
    """

    case: MachineCase
    reduction: dict[str, Errors]
    bound: dict[str, float]
    gain_factor: float


@dataclass(frozen=True)
class BenchAxis:
    """An axis of a machine file with the models that compensate it.

    Attributes
    ----------
    name : str
        Of the file, with that of the axis where the file has several.
    axis : SimulatedAxis
    keys : CompensatorKeys
        Of the grid: family of the compensator's model and error of its inertia.
    conditions : mapping of Condition
        Of the grid, applied to the true friction.
    identified : ModelFile or None
        What `tune` has found.
    """

    name: str
    axis: SimulatedAxis
    keys: CompensatorKeys
    conditions: Mapping[str, Condition]
    identified: ModelFile | None = None

    @cached_property
    def motions(self) -> dict[str, Motion]:
        """Motions by name."""
        return simulated_motions(self.axis)

    @cached_property
    def drives(self) -> dict[str, ServoConfig]:
        """The drive of the file, and one of half its velocity gain; in CST only the first: the daemon has that gain."""
        servo = self.axis.servo
        if self.axis.config.mode == "cst":
            return {OWN: servo}
        loops = servo.loops.model_copy(update={"velocity_gain": _SOFTER * servo.loops.velocity_gain})
        return {OWN: servo, SOFT: servo.model_copy(update={"loops": loops})}

    @cached_property
    def compensations(self) -> dict[str, tuple[ModelFile, Rehearsal]]:
        """Model and loop by condition."""
        axis = self.axis
        found = {FILE: (axis.config.model, self._rehearsal())}
        if self.identified is not None:
            found[IDENTIFIED] = (self.identified, self._rehearsal())
        true = true_friction(axis.servo)
        if true is None:
            return found
        if self.keys.model != SAME:
            true = converted(true, self.keys.model)
        for name, condition in self.conditions.items():
            belief = condition.friction
            friction = changed(true, belief.parameters, belief.factors, belief.modifiers)
            compensation = axis.config.compensation.model_copy(update={"gain": condition.gain, "gain_negative": None})
            rehearsal = self._rehearsal(
                axis.config.model_copy(update={"compensation": compensation}), condition.delay_cycles - 1
            )
            found[name] = (model_file(axis.servo, friction, self.keys.inertia_error), rehearsal)
        return found

    def _rehearsal(self, config: AxisConfig | None = None, more_cycles: int = 0) -> Rehearsal:
        """Return the loop, with commands that act some cycles later than the drive takes them."""
        facts, period_s = self.axis.facts, self.axis.period_s
        later_s = more_cycles * period_s
        facts = replace(
            facts,
            actuation_delay_s=facts.actuation_delay_s + later_s,
            setpoint_delay_s=facts.setpoint_delay_s + later_s,
        )
        return Rehearsal(self.axis.config if config is None else config, facts, period_s)

    def cases(self) -> Iterator[MachineCase]:
        """Yield all combinations."""
        for drive in self.drives:
            for motion in self.motions:
                for condition in self.compensations:
                    yield MachineCase(self.name, drive, motion, condition)

    def course(self, case: MachineCase) -> Course:
        """Simulate a case, with compensation."""
        return self._scored(self.drives[case.drive], case.motion, case.condition, is_compensated=True)

    def uncompensated(self, servo: ServoConfig, motion: str) -> Course:
        """Simulate a motion of a servo without compensation."""
        return self._scored(servo, motion, FILE, is_compensated=False)

    def _scored(self, servo: ServoConfig, name: str, condition: str, *, is_compensated: bool) -> Course:
        model, rehearsal = self.compensations[condition]
        motion = self.motions[name]
        trace = rehearsal.trace(servo, model, motion, is_compensated=is_compensated)
        return scored(trace, self.axis.period_s, motion.duration_s)


def read_axes(
    files: Sequence[Path],
    keys: CompensatorKeys,
    conditions: Mapping[str, Condition],
    identified: Mapping[tuple[str, str], ModelFile] | None = None,
) -> list[BenchAxis]:
    """Return the axes of machine files.

    Parameters
    ----------
    files : sequence of Path
    keys, conditions
        Of the grid. A condition that only changes the encoder is left out: a machine has its own.
    identified : mapping of ModelFile, optional
        By stem of the file and name of the axis.

    Raises
    ------
    ConfigurationError, UsageError
        A file cannot be read, or has no simulated axis.
    """
    kept = {name: each for name, each in conditions.items() if "encoder_bits" not in each.model_fields_set}
    for name, each in kept.items():
        if each.friction.parameters:
            raise UsageError(
                f"conditions.{name}.friction.parameters: values of one plant do not suit other machines; give factors"
            )
    found = []
    for file in files:
        axes = simulated_axes(load(file, needs_models=False))
        for axis in axes:
            name = file.stem if len(axes) == 1 else f"{file.stem}.{axis.name}"
            model = None if identified is None else identified.get((file.stem, axis.name))
            found.append(BenchAxis(name, axis, keys, kept, model))
    return found


def simulate_machines(axes: Sequence[BenchAxis]) -> list[MachineResult]:
    """Simulate all cases of some axes on all cores, with a progress bar on a terminal.

    Raises
    ------
    FrictionHilError
        An axis does not follow its demand even without compensation.
    """
    jobs = [(axis, drive, motion) for axis in axes for drive in axis.drives for motion in axis.motions]
    found = with_progress(lambda job: (_plain(*job), _ideal(*job)), jobs, "without compensation")
    plain = dict(zip([(axis.name, drive, motion) for axis, drive, motion in jobs], found, strict=True))
    for (name, drive, motion), (course, _) in plain.items():
        if not 0.0 < course.errors("motor").rms < math.inf:
            raise FrictionHilError(
                f"{name} with the {drive} drive, motion {motion}: the following error without compensation is "
                f"{course.errors('motor').rms:g}, which is no basis for a comparison"
            )
    cases = [(axis, case) for axis in axes for case in axis.cases()]

    def result(job: tuple[BenchAxis, MachineCase]) -> MachineResult:
        axis, case = job
        without, ideal = plain[case.machine, case.drive, case.motion]
        both = MotionResult(without, axis.course(case))
        lag = ideal.errors(MOTOR).rms
        left = {MOTOR: lag, LOAD: math.hypot(lag, both.compensated.unseen)}
        bound = {side: without.errors(side).rms / left[side] if left[side] > 0.0 else math.inf for side in SIDES}
        return MachineResult(case, {side: both.reduction(side) for side in SIDES}, bound, both.compensated.gain_factor)

    return list(with_progress(result, cases, "with compensation"))


def _plain(axis: BenchAxis, drive: str, motion: str) -> Course:
    return axis.uncompensated(axis.drives[drive], motion)


def _ideal(axis: BenchAxis, drive: str, motion: str) -> Course:
    return axis.uncompensated(without_torques(axis.drives[drive]), motion)
