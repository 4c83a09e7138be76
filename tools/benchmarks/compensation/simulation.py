"""The cases of a grid, each simulated with every method and without compensation, on all cores."""

import math
from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

import numpy as np

from friction_hil import compensator as compensation
from friction_hil.compensator import Compensator
from friction_hil.errors import FrictionHilError
from friction_hil.numerics.jit import Array
from friction_hil.servo.assembly import controller_record, machine_record, servo_state
from friction_hil.servo.config import Loops, Motor, ServoConfig, ServoMechanics, TrueFriction, least_integration_hz
from friction_hil.servo.parts import Load
from tools.benchmarks.compensation import machine
from tools.benchmarks.compensation.grid import DriveLoops, Grid, Plant
from tools.benchmarks.compensation.methods import METHODS, NONE, feedforward
from tools.benchmarks.compensation.progress import with_progress

INTEGRATION_HZ = 80_000.0  # unless a plant needs more


class Error(NamedTuple):
    """RMS and peak of a following error, rad; or the factors by which compensation reduces them."""

    rms: float
    peak: float


class Case(NamedTuple):
    """One combination of the grid; ``motion`` is an index."""

    plant: str
    drive: str
    motion: int
    condition: str


@dataclass(frozen=True, slots=True)
class CaseResult:
    """A case, and the reduction by each method."""

    case: Case
    reduction: dict[str, Error]


class Simulation:
    """A grid ready to run; demands that cases have in common are computed once."""

    def __init__(self, grid: Grid) -> None:
        self.grid = grid
        self.cycles = round(grid.duration_s / grid.period_s)
        self._demands_of = cache(self._demands)

    def cases(self) -> list[Case]:
        """Return all combinations, in the order of the file."""
        grid = self.grid
        return [
            Case(plant, drive, motion, condition)
            for plant in grid.plants
            for drive in grid.drives_of(plant)
            for motion in range(len(grid.motions))
            for condition in grid.conditions
        ]

    def run(self, case: Case, method: str, trace: Array | None = None) -> Error:
        """Simulate a case.

        Parameters
        ----------
        case : Case
        method : str
            One of `METHODS`, or ``none``.
        trace : (6, n) array, optional
            Filled with `machine.TRACE`, one column for each sample of the drive, as far as it has room.
        """
        grid = self.grid
        plant, drive = grid.plants[case.plant], grid.drives[case.drive]
        condition = grid.conditions[case.condition]
        settings = grid.settings(case.plant, case.drive, case.condition)
        believed = grid.believed(case.plant, case.condition)
        compensator = Compensator(believed, settings)
        cycle = np.zeros(1, machine.CYCLE)
        cycle[0] = (
            grid.period_s,
            round(drive.rate_hz * grid.period_s),
            condition.delay_cycles,
            round(grid.settling_s / grid.period_s),
            settings.position_resolution,
            plant.rated_torque / 1000.0,
        )
        servo = servo_config(plant, drive)
        record = machine_record(servo)
        score = np.zeros(2)
        machine.run(
            record,
            controller_record(servo),
            servo_state(servo, record, 0.0),
            cycle,
            feedforward(method, believed, condition.gain, grid.period_s, settings.position_resolution),
            believed.initial_state(),
            compensator.record,
            compensator.state.view(compensation.STATE),
            *self._demands_of(case.motion, drive.rate_hz),
            *self._ahead(case.motion, grid.lead_s(case.drive, case.condition)),
            score,
            np.empty((len(machine.TRACE), 0)) if trace is None else trace,
        )
        scored = round(drive.rate_hz * grid.period_s) * (self.cycles - round(grid.settling_s / grid.period_s))
        rms = math.sqrt(score[0] / scored)
        return Error(rms, float(score[1])) if math.isfinite(rms) else Error(math.inf, math.inf)

    def _demands(self, motion: int, rate_hz: float) -> tuple[Array, Array, Array]:
        samples = self.cycles * round(rate_hz * self.grid.period_s)
        t = np.arange(samples, dtype=np.float64) / rate_hz
        return self.grid.motions[motion].at(t, self.grid.seed)

    def _ahead(self, motion: int, lead_s: float) -> tuple[Array, Array]:
        """Return velocity and acceleration demanded ``lead_s`` after the beginning of each period."""
        t = np.arange(self.cycles, dtype=np.float64) * self.grid.period_s + lead_s
        _, velocity, acceleration = self.grid.motions[motion].at(t, self.grid.seed)
        return velocity, acceleration


def servo_config(plant: Plant, drive: DriveLoops) -> ServoConfig:
    """Return the servo of a plant with a drive; of its drive, the cases use the rate and the torque lag."""
    friction = plant.friction
    mechanics = ServoMechanics(inertia=plant.inertia, load=_load(plant))
    true = TrueFriction(model=friction.model, parameters=friction.parameters, modifiers=friction.modifiers)
    return ServoConfig(
        mechanics=mechanics,
        friction=true,
        motor=Motor(rated_torque=plant.rated_torque, torque_lag_s=drive.torque_lag_s),
        loops=Loops(
            rate_hz=drive.rate_hz,
            position_gain=drive.position_gain,
            velocity_gain=drive.velocity_gain,
            integral_hz=drive.integral_hz,
        ),
        integration_hz=integration_hz(mechanics, true, drive.rate_hz),
    )


def _load(plant: Plant) -> Load | None:
    if plant.compliance is None:
        return None
    coupling = plant.compliance
    return Load(
        inertia=coupling.load_inertia,
        stiffness=coupling.stiffness,
        damping=coupling.damping,
        backlash=plant.backlash,
    )


def integration_hz(mechanics: ServoMechanics, friction: TrueFriction, rate_hz: float) -> float:
    """Return the rate of the integration: a multiple of ``rate_hz``, well inside the stability limits."""
    needed = max(INTEGRATION_HZ, least_integration_hz(mechanics, friction))
    return rate_hz * math.ceil(needed / rate_hz * (1.0 - 1e-9))


def simulate(grid: Grid) -> list[CaseResult]:
    """Run a whole grid on all cores, with a progress bar on a terminal.

    Raises
    ------
    FrictionHilError
        An axis does not follow its demand even without compensation.
    """
    simulation = Simulation(grid)
    cases = simulation.cases()
    first = next(iter(grid.conditions))
    # without compensation all conditions are equal
    plain = list(dict.fromkeys(case._replace(condition=first) for case in cases))
    jobs = [(case, NONE) for case in plain] + [(case, method) for case in cases for method in METHODS]
    errors = dict(zip(jobs, with_progress(lambda job: simulation.run(*job), jobs, "compensation"), strict=True))
    for case in plain:
        if not 0.0 < errors[case, NONE].rms < math.inf:
            raise FrictionHilError(
                f"plant {case.plant} with drive {case.drive}, motion {grid.motions[case.motion].name}: the following "
                f"error without compensation is {errors[case, NONE].rms:g} rad, which is no basis for a comparison"
            )
    return [
        CaseResult(
            case, {m: _reduction(errors[case._replace(condition=first), NONE], errors[case, m]) for m in METHODS}
        )
        for case in cases
    ]


def _reduction(before: Error, after: Error) -> Error:
    return Error(*(b / a if a > 0.0 else math.inf for b, a in zip(before, after, strict=True)))
