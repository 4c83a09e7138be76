"""A simulated axis with a compensator whose settings change while it moves; what it records, the learner is given."""

from collections.abc import Container
from dataclasses import dataclass, field

import numpy as np

from friction_hil.compensator import INPUTS, Compensator, CompensatorInputs
from friction_hil.daemon.control.desk import LATEST_CYCLES
from friction_hil.daemon.control.prepare import state_in
from friction_hil.learning.window import RECORDED
from friction_hil.numerics.jit import Array
from friction_hil.servo.assembly import controller_record, machine_record, servo_state
from friction_hil.servo.config import ServoConfig
from friction_hil.servo.parts import Gravity
from tools.benchmarks.compensation.grid import DriveLoops, Plant
from tools.benchmarks.compensation.machine import TRACE, advance
from tools.benchmarks.compensation.simulation import servo_config

_NO_TRACE = np.empty((len(TRACE), 0))


@dataclass(slots=True)
class Sensors:
    """What is wrong with the feedback.

    Attributes
    ----------
    bits : int
        Of the encoder, for one revolution.
    delay_cycles : int
        From reading the encoder to the torque.
    torque_noise : float
        Standard deviation, N m.
    torque_factor : float
        Reported over true torque.
    slip : float
        Added to the position, rad.
    is_frozen : bool
        The torque that is reported stays what it was.
    """

    bits: int = 20
    delay_cycles: int = 1
    torque_noise: float = 0.0
    torque_factor: float = 1.0
    slip: float = 0.0
    is_frozen: bool = False
    reported: float = field(default=0.0, repr=False)


class Axis:
    """A plant behind a drive, moved along a demand.

    Parameters
    ----------
    plant, drive
        Of a grid file.
    compensator : Compensator
    sensors : Sensors
    period_s : float
    seed : int
    gravity : float
        Torque of gravity per sine of the position, N m, which is fed forward as the daemon does.

    Attributes
    ----------
    beside : list of (float, Compensator)
        Whose torques, with these factors, act beside that of the compensator.
    """

    def __init__(
        self,
        plant: Plant,
        drive: DriveLoops,
        compensator: Compensator,
        sensors: Sensors,
        period_s: float,
        seed: int,
        gravity: float = 0.0,
    ) -> None:
        self.drive, self.compensator, self.sensors, self.period_s = drive, compensator, sensors, period_s
        self.samples = round(drive.rate_hz * period_s)
        self.gravity = gravity
        self.beside: list[tuple[float, Compensator]] = []
        servo = self._servo(plant, drive)
        self.record, self.controller = machine_record(servo), controller_record(servo)
        self.state = servo_state(servo, self.record, 0.0)
        self.cycle = 0
        self._pending = [0.0] * (sensors.delay_cycles + 1)
        self._acting = 0.0
        self._random = np.random.default_rng(seed)
        self._torque_step = plant.rated_torque / 1000.0
        self._inputs: list[list[tuple[float, ...]]] = []  # of the latest moves
        self._states: list[Array] = []  # before each of them

    def state_of(self, other: Compensator) -> Array:
        """Return the state of another model after the last move, as the daemon computes it.

        At rest it is that of the present one where both are of the same family.
        """
        is_alike = bool(other.record[0]["kind"] == self.compensator.record[0]["kind"])
        rows = np.concatenate([np.array(move) for move in self._inputs]).T
        return state_in(other, (dict(zip(INPUTS, rows, strict=True)), self._states[0]), "x", is_alike=is_alike)

    def change_plant(self, plant: Plant, drive: DriveLoops | None = None) -> None:
        """Go on with another plant or other loops, from the same motion."""
        servo = self._servo(plant, drive or self.drive)
        self.record, self.controller = machine_record(servo), controller_record(servo)

    def _servo(self, plant: Plant, drive: DriveLoops) -> ServoConfig:
        servo = servo_config(plant, drive)
        if self.gravity == 0.0:
            return servo
        mechanics = servo.mechanics.model_copy(update={"gravity": Gravity(sine=self.gravity)})
        return servo.model_copy(update={"mechanics": mechanics})

    def move(
        self, demands: tuple[Array, Array, Array], ahead: tuple[Array, Array], missed: Container[int] = ()
    ) -> tuple[dict[str, Array], Array]:
        """Move along demands at the samples of the drive; return the rows of the cycles and the following errors.

        Parameters
        ----------
        demands : tuple of (n,) arrays
            Position, velocity and acceleration.
        ahead : tuple of (k,) arrays
            Velocity and acceleration of each cycle when its torque acts.
        missed : container of int
            Those of these cycles in which nothing is computed: the drive stays where it was sent last, with the last
            torque. Not the first one.
        """
        cycles, given = ahead[0].size, self.sensors
        rows = np.full((len(RECORDED), cycles), np.nan)
        demands = demands[0].copy(), demands[1].copy(), demands[2].copy()
        errors = np.empty((2, cycles))
        resolution = np.pi * 2.0 / 2**given.bits
        noise = given.torque_noise * self._random.standard_normal(cycles)
        compensator, state = self.compensator, self.state
        view = state[0]
        kept = max(LATEST_CYCLES // cycles - 1, 0)
        inputs: list[tuple[float, ...]] = []
        self._inputs = [*self._inputs[max(len(self._inputs) - kept, 0) :], inputs]
        self._states = [*self._states[max(len(self._states) - kept, 0) :], compensator.state.copy()]
        for k in range(cycles):
            i = k * self.samples
            if k in missed:
                demands[0][i : i + self.samples] = demands[0][i - 1]
                demands[1][i : i + self.samples] = demands[2][i : i + self.samples] = 0.0
                errors[:, k] = self._advance(demands, i)
                continue
            position = np.floor((view["position"] + given.slip) / resolution) * resolution
            if not given.is_frozen:
                torque = view["torque"] * given.torque_factor + noise[k]
                given.reported = np.floor(torque / self._torque_step + 0.5) * self._torque_step
            motion = (demands[0][i], demands[1][i], ahead[0][k])
            given_now = (float(self.cycle), position, view["velocity"], given.reported)
            values = CompensatorInputs(*given_now, *motion, True, True, ahead[1][k])
            inputs.append(values)
            torque = compensator.step(*values)
            rows[:, k] = (
                self.cycle,
                position,
                given.reported,
                demands[0][i],
                demands[1][i],
                compensator.load_estimate,
                compensator.temperature_estimate,
                torque,
                compensator.gain_factor,
            )
            if self.gravity:
                torque += self.gravity * np.sin(demands[0][i])
            for factor, other in self.beside:
                torque += factor * other.step(*values)
            self._pending.append(torque)
            self._acting = self._pending.pop(0) if given.delay_cycles else self._pending.pop()
            errors[:, k] = self._advance(demands, i)
        return dict(zip(RECORDED, rows[:, np.isfinite(rows[0])], strict=True)), errors

    def _advance(self, demands: tuple[Array, Array, Array], first: int) -> tuple[float, float]:
        """Move for a cycle; return root mean square and peak of the following error, rad."""
        score = np.zeros(2)
        advance(
            self.record,
            self.controller,
            self.state,
            *demands,
            first,
            self.samples,
            self._acting,
            score,
            _NO_TRACE,
        )
        self.cycle += 1
        return float(np.sqrt(score[0] / self.samples)), float(score[1])
