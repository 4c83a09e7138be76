"""Rehearsal of one axis: what a model does to the following error, simulated before the axis moves."""

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from friction_hil import compensator as compensation
from friction_hil.compensator import velocity_offset
from friction_hil.config.external_torque import simulated_servo
from friction_hil.daemon.assembly import (
    lead_s,
    make_compensator,
    make_controller,
    make_setpoint_shift,
    make_velocity_offset,
)
from friction_hil.daemon.figures import Figures, figures_of
from friction_hil.daemon.static_torque import static_torque
from friction_hil.motion.trajectory import Path, PathTime, Trajectory
from friction_hil.numerics.jit import Array, StructuredArray
from friction_hil.rehearsal import kernel
from friction_hil.servo import plant

if TYPE_CHECKING:
    from friction_hil.config import AxisConfig
    from friction_hil.drive import AxisFacts
    from friction_hil.models.model_file import ModelFile
    from friction_hil.servo.config import ServoConfig
    from friction_hil.servo.servo import Servo

_MODES = {"csp": plant.CSP, "csv": plant.CSV, "cst": plant.CST}


@dataclass(frozen=True, slots=True)
class Motion:
    """A motion to rehearse."""

    path: Path  # position, velocity and acceleration over path time
    duration_s: float  # of the part that is scored: whole periods
    ramp_s: float = 1.0  # in which path time starts
    start_s: float = 2.0  # before the part that is scored


@dataclass(frozen=True, slots=True)
class Outcome(Figures):
    """Following error of a motion, and the factor on the gain that the guard against limit cycles has left."""

    gain_factor: float  # 1: no limit cycle was found


class Rehearsal:
    """Closed loop of the daemon with a simulated servo, without a bus.

    The loop samples and commands as on a bus paced by SYNC: what it computes from a sample acts after the actuation
    delay that the driver states. A set-point of the position is a whole number of counts, as a drive takes it: with a
    coarse encoder its steps shake the axis.

    ``axis``: mode, controller, limits and compensation. ``facts``: resolution and delays. ``period_s``: of the loop.
    """

    def __init__(self, axis: "AxisConfig", facts: "AxisFacts", period_s: float) -> None:
        self._axis, self._facts, self.period_s = axis, facts, period_s
        self._demands: dict[tuple[Motion, float], Array] = {}

    def run(self, servo: "ServoConfig", model: "ModelFile", motion: Motion, *, is_compensated: bool = True) -> Outcome:
        """Simulate a motion, with compensation by ``model`` or without; return the following error.

        The model gives inertia, gravity and offset to the loop's own controller (CST) in both cases. ``servo``:
        mechanics, friction, encoder, motor and loops of the drive; the resolution of the encoder is that of the facts.
        """
        found = self.trace(servo, model, motion, is_compensated=is_compensated)
        scored = found["error"][-round(motion.duration_s / self.period_s) :]
        figures = figures_of(scored)
        gain_factor = float(found["gain_factor"][-1]) if math.isfinite(figures.rms) else 0.0
        return Outcome(figures.rms, figures.peak, gain_factor)

    def trace(
        self, servo: "ServoConfig", model: "ModelFile", motion: Motion, *, is_compensated: bool = True
    ) -> dict[str, Array]:
        """Return the signals of each cycle from the start on, (n,) each, by the names `kernel.TRACE`."""
        demand = self.demand(model, motion)
        simulated = simulated_servo(servo, float(demand[0, 0]))
        trace = np.empty((len(kernel.TRACE), len(demand)))
        kernel.run(self.records(simulated, model, is_compensated=is_compensated), demand, trace)
        return dict(zip(kernel.TRACE, trace, strict=True))

    def ahead(
        self,
        servo: "ServoConfig",
        model: "ModelFile",
        demand: Array,
        measured: Array,
        torque: float,
        correction: tuple[float, float],
    ) -> Array:
        """Return measured less predicted positions (n,) of a recorded motion: see `kernel.follow`."""
        simulated = simulated_servo(servo, float(measured[np.isfinite(measured)][0]))
        found = np.empty(len(demand))
        kernel.follow(self.records(simulated, model, is_compensated=False), demand, measured, torque, correction, found)
        return found

    def records(self, simulated: "Servo", model: "ModelFile", *, is_compensated: bool) -> kernel.Axis:
        """Return the axis with a simulated servo at rest, as the kernels take it."""
        axis = self._axis.model_copy(update={"model": model})
        facts, period_s = self._facts, self.period_s
        simulated.set_period(period_s)
        compensator, shift = make_compensator(axis, model, facts, period_s), make_setpoint_shift(axis, period_s)
        daemon = np.zeros(1, kernel.DAEMON)
        d = daemon[0]
        d["mode"], d["is_compensated"] = _MODES[axis.mode], is_compensated
        d["period_s"], d["period_steps"] = period_s, round(period_s * simulated.steps_per_second)
        delay_s = facts.actuation_delay_s - 0.5 * period_s
        d["delay_steps"] = min(
            max(round(delay_s * simulated.steps_per_second), 0), kernel.MOST_DELAY_CYCLES * int(d["period_steps"])
        )
        d["torque_limit"] = axis.limits.torque
        d["torque_slew"] = math.inf if axis.limits.torque_slew is None else axis.limits.torque_slew
        d["largest_static"], d["offset"] = static_torque(axis).bound, model.mechanics.offset
        return kernel.Axis(
            daemon,
            np.zeros(1, kernel.LOOP),
            make_controller(axis),
            *simulated.records,
            compensator.record,
            compensator.state.view(compensation.STATE),
            *_records(make_velocity_offset(axis, facts, period_s)),
            np.zeros(1, velocity_offset.SHIFT) if shift is None else shift.record,
        )

    def demand(self, model: "ModelFile", motion: Motion) -> Array:
        """Return the demand of each cycle of a motion as `kernel.run` takes it, (n, 7)."""
        ahead_s = lead_s(model, self._facts, self.period_s)
        key = (motion, ahead_s)
        if key not in self._demands:
            time = PathTime(motion.ramp_s)
            time.start(0.0)
            trajectory = Trajectory(motion.path, time)
            rows = []
            delay_s, resolution = self._facts.setpoint_delay_s, self._facts.position_resolution
            for k in range(round((motion.start_s + motion.duration_s) / self.period_s)):
                t = k * self.period_s
                now, sent = trajectory.at(t), trajectory.at(t + delay_s)
                counts = round(sent.position / resolution)
                ahead = trajectory.at(t + ahead_s)
                rows.append((*now, ahead.velocity, ahead.acceleration, counts * resolution, sent.velocity))
            self._demands[key] = np.array(rows)
        return self._demands[key]


def _records(offset: velocity_offset.VelocityOffset | None) -> tuple[StructuredArray, StructuredArray]:
    """Return settings and state of a velocity offset, zeros where the drive is given the torque."""
    if offset is None:
        return np.zeros(1, velocity_offset.SETTINGS), np.zeros(1, velocity_offset.STATE)
    return offset.record, offset.state_record
