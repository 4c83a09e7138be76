"""Machine files in the benchmark: each axis with its own plant, loops, encoder and motions, as `simulate` has them."""

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain
from pathlib import Path

from friction_hil.cli.work.study_machine import courses
from friction_hil.config import AxisConfig, load
from friction_hil.config.simulation import moved
from friction_hil.errors import FrictionHilError, UsageError
from friction_hil.models.model_file import ModelFile
from friction_hil.rehearsal import AxisRun, Motion, Rehearsal, SimulatedAxis, SimulatedMachine, simulated_machines
from friction_hil.servo.config import ServoConfig
from friction_hil.servo.mechanisms import hanging_gravity, reflected_inertias
from friction_hil.study.machine import LOAD, MOTOR, SIDES, Course, Errors, MotionResult
from friction_hil.tuning.rehearsal_motions import simulated_motions
from tools.benchmarks.compensation.belief import changed, converted
from tools.benchmarks.compensation.grid import SAME, CompensatorKeys, Condition
from tools.benchmarks.compensation.progress import with_progress
from tools.benchmarks.compensation.truth import (
    model_file,
    true_friction,
    without_forces,
    without_gravity,
    without_torques,
)

FILE, IDENTIFIED = "file", "identified"  # conditions: the model of the machine file, and the one that `tune` keeps
OWN, SOFT = "own", "soft"  # drives
_SOFTER = 0.5  # velocity gain of the soft drive, in that of the own one

_Job = tuple["BenchMachine", str, str]  # drive and motion
_Reference = tuple[tuple[Course, ...], tuple[Course, ...]]  # of each axis, without compensation, and the ideal


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
class BenchMachine:
    """A machine of a file, of one axis or of those of a mechanism, with the models that compensate it.

    Attributes
    ----------
    names : tuple of str
        Of the axes: of the file, with that of the axis where the file has several.
    machine : SimulatedMachine
    keys : CompensatorKeys
        Of the grid: family of the compensator's model and error of its inertia.
    conditions : mapping of Condition
        Of the grid, applied to the true friction.
    identified : tuple of ModelFile or None
        What `tune` has found for each axis.
    """

    names: tuple[str, ...]
    machine: SimulatedMachine
    keys: CompensatorKeys
    conditions: Mapping[str, Condition]
    identified: tuple[ModelFile | None, ...]

    @cached_property
    def motions(self) -> dict[str, tuple[Motion, ...]]:
        """Motions of the axes by name."""
        return simulated_motions(self.machine)

    @cached_property
    def drives(self) -> dict[str, tuple[ServoConfig, ...]]:
        """The drives of the file, and those of half their velocity gain; in CST only the first: there it is ours."""
        servos = tuple(axis.servo for axis in self.machine.axes)
        if any(axis.config.mode == "cst" for axis in self.machine.axes):
            return {OWN: servos}
        return {OWN: servos, SOFT: tuple(map(_softer, servos))}

    @cached_property
    def compensations(self) -> dict[str, list[tuple[ModelFile, Rehearsal]]]:
        """Model and loop of each axis by condition; only conditions that all of them have."""
        mechanism = self.machine.mechanism
        shares = (0.0,) if mechanism is None else reflected_inertias(moved(mechanism))
        swings = (0.0,) if mechanism is None else hanging_gravity(moved(mechanism))
        each = [
            self._compensations_of(axis, identified, share, swing)
            for axis, identified, share, swing in zip(self.machine.axes, self.identified, shares, swings, strict=True)
        ]
        return {name: [found[name] for found in each] for name in each[0] if all(name in found for found in each)}

    def _compensations_of(
        self, axis: SimulatedAxis, identified: ModelFile | None, share: float, swing: float
    ) -> dict[str, tuple[ModelFile, Rehearsal]]:
        """Return model and loop of an axis by condition; ``share`` and ``swing`` are those of `model_file`."""
        found = {FILE: (axis.config.model, _rehearsal(axis, axis.config))}
        if identified is not None:
            found[IDENTIFIED] = (identified, _rehearsal(axis, axis.config))
        true = true_friction(axis.servo)
        if true is None:
            return found
        if self.keys.model != SAME:
            true = converted(true, self.keys.model)
        for name, condition in self.conditions.items():
            belief = condition.friction
            friction = changed(true, belief.parameters, belief.factors, belief.modifiers)
            compensation = axis.config.compensation.model_copy(update={"gain": condition.gain, "gain_negative": None})
            config = axis.config.model_copy(update={"compensation": compensation})
            model = model_file(axis.servo, friction, self.keys.inertia_error, share=share, swing=swing)
            found[name] = (model, _rehearsal(axis, config, condition.delay_cycles - 1))
        return found

    def jobs(self) -> Iterator[tuple[str, str]]:
        """Yield all combinations of drive and motion."""
        for drive in self.drives:
            for motion in self.motions:
                yield drive, motion

    def plain(self, drive: str, motion: str) -> tuple[Course, ...]:
        """Simulate a motion without compensation; return the course of each axis."""
        runs = self._runs(self.drives[drive], motion, self.compensations[FILE])
        return courses(self.machine.mechanism, runs, is_compensated=False)

    def ideal(self, drive: str, motion: str) -> tuple[Course, ...]:
        """Simulate a motion without compensation, and without what it could compensate."""
        mechanism = self.machine.mechanism
        servos = tuple(map(without_torques, self.drives[drive]))
        bare = None if mechanism is None else without_forces(mechanism)
        loops = [(without_gravity(model), rehearsal) for model, rehearsal in self.compensations[FILE]]
        return courses(bare, self._runs(servos, motion, loops), is_compensated=False)

    def compensated(self, drive: str, motion: str, condition: str) -> tuple[Course, ...]:
        """Simulate a motion with compensation."""
        runs = self._runs(self.drives[drive], motion, self.compensations[condition])
        return courses(self.machine.mechanism, runs, is_compensated=True)

    def _runs(
        self, servos: tuple[ServoConfig, ...], motion: str, loops: Sequence[tuple[ModelFile, Rehearsal]]
    ) -> list[AxisRun]:
        return [
            AxisRun(rehearsal, servo, model, each)
            for (model, rehearsal), servo, each in zip(loops, servos, self.motions[motion], strict=True)
        ]


def _softer(servo: ServoConfig) -> ServoConfig:
    loops = servo.loops.model_copy(update={"velocity_gain": _SOFTER * servo.loops.velocity_gain})
    return servo.model_copy(update={"loops": loops})


def _rehearsal(axis: SimulatedAxis, config: AxisConfig, more_cycles: int = 0) -> Rehearsal:
    """Return the loop of an axis, with commands that act some cycles later than the drive takes them."""
    facts, later_s = axis.facts, more_cycles * axis.period_s
    facts = replace(
        facts,
        actuation_delay_s=facts.actuation_delay_s + later_s,
        setpoint_delay_s=facts.setpoint_delay_s + later_s,
    )
    return Rehearsal(config, facts, axis.period_s)


def read_machines(
    files: Sequence[Path],
    keys: CompensatorKeys,
    conditions: Mapping[str, Condition],
    identified: Mapping[tuple[str, str], ModelFile] | None = None,
) -> list[BenchMachine]:
    """Return the machines of files.

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
    models = {} if identified is None else identified
    found = []
    for file in files:
        machines = simulated_machines(load(file, needs_models=False))
        is_single = sum(len(machine.axes) for machine in machines) == 1
        for machine in machines:
            names = tuple(file.stem if is_single else f"{file.stem}.{axis.name}" for axis in machine.axes)
            own = tuple(models.get((file.stem, axis.name)) for axis in machine.axes)
            found.append(BenchMachine(names, machine, keys, kept, own))
    return found


def simulate_machines(machines: Sequence[BenchMachine]) -> list[MachineResult]:
    """Simulate all cases of some machines on all cores, with a progress bar on a terminal.

    Raises
    ------
    FrictionHilError
        An axis does not follow its demand even without compensation.
    """
    jobs = [(machine, *job) for machine in machines for job in machine.jobs()]
    found = with_progress(lambda job: (_plain(*job), job[0].ideal(*job[1:])), jobs, "without compensation")
    references = list(zip(jobs, found, strict=True))
    cases = [(*each, condition) for each in references for condition in each[0][0].compensations]

    def results(case: tuple[_Job, _Reference, str]) -> list[MachineResult]:
        (machine, drive, motion), (plain, ideal), condition = case
        compensated = machine.compensated(drive, motion, condition)
        return [
            _result(MachineCase(name, drive, motion, condition), *of_axis)
            for name, *of_axis in zip(machine.names, plain, ideal, compensated, strict=True)
        ]

    return list(chain.from_iterable(with_progress(results, cases, "with compensation")))


def _result(case: MachineCase, without: Course, ideal: Course, compensated: Course) -> MachineResult:
    both = MotionResult(without, compensated)
    lag = ideal.errors(MOTOR).rms
    left = {MOTOR: lag, LOAD: math.hypot(lag, compensated.unseen)}
    bound = {side: without.errors(side).rms / left[side] if left[side] > 0.0 else math.inf for side in SIDES}
    return MachineResult(case, {side: both.reduction(side) for side in SIDES}, bound, compensated.gain_factor)


def _plain(machine: BenchMachine, drive: str, motion: str) -> tuple[Course, ...]:
    found = machine.plain(drive, motion)
    for name, course in zip(machine.names, found, strict=True):
        rms = course.errors(MOTOR).rms
        if not 0.0 < rms < math.inf:
            raise FrictionHilError(
                f"{name} with the {drive} drive, motion {motion}: the following error without compensation is "
                f"{rms:g}, which is no basis for a comparison"
            )
    return found
