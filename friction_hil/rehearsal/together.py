"""Rehearsal of axes that are simulated together: one alone, or two that move one mechanism."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from friction_hil.config.simulation import coupled_servos
from friction_hil.numerics.jit import Array
from friction_hil.rehearsal import kernel
from friction_hil.rehearsal.rehearsal import Motion, Rehearsal

if TYPE_CHECKING:
    from friction_hil.models.model_file import ModelFile
    from friction_hil.servo.config import ServoConfig
    from friction_hil.servo.mechanisms import Gantry, TwoLinkArm


@dataclass(frozen=True, slots=True)
class AxisRun:
    """What one axis does in a rehearsal."""

    rehearsal: Rehearsal  # the loop of the axis
    servo: "ServoConfig"  # this, model and motion: as for `Rehearsal.trace`
    model: "ModelFile"
    motion: Motion

    @property
    def demand(self) -> Array:
        """Demand of each cycle, see `Rehearsal.demand`."""
        return self.rehearsal.demand(self.model, self.motion)


def rehearse(
    mechanism: "Gantry | TwoLinkArm | None", runs: Sequence[AxisRun], *, is_compensated: bool = True
) -> tuple[dict[str, Array], ...]:
    """Simulate the motions of a machine; return the signals of each axis, as `Rehearsal.trace` does.

    Two axes start and end together: the longer ramp is that of both, and the shorter motion is repeated before its part
    that is scored. ``mechanism``: what two axes move; None: there is one axis. ``runs``: one, or those of the axes of
    the mechanism, in its order and with one period.
    """
    if mechanism is None:
        [run] = runs
        return (run.rehearsal.trace(run.servo, run.model, run.motion, is_compensated=is_compensated),)
    one, other = (replace(run, motion=motion) for run, motion in zip(runs, together(runs), strict=True))
    demands = one.demand, other.demand
    coupled = coupled_servos(mechanism, [one.servo, other.servo], [float(demand[0, 0]) for demand in demands])
    servo, other_servo = coupled.servos
    traces = np.empty((len(kernel.TRACE), len(demands[0]))), np.empty((len(kernel.TRACE), len(demands[1])))
    kernel.run_coupled(
        *coupled.records,
        one.rehearsal.records(servo, one.model, is_compensated=is_compensated),
        other.rehearsal.records(other_servo, other.model, is_compensated=is_compensated),
        demands,
        traces,
    )
    return tuple(dict(zip(kernel.TRACE, trace, strict=True)) for trace in traces)


def together(runs: Sequence[AxisRun]) -> list[Motion]:
    """Return the motions of axes that start and end together."""
    motions = [run.motion for run in runs]
    end_s = max(each.start_s + each.duration_s for each in motions)
    ramp_s = max(each.ramp_s for each in motions)
    return [replace(each, ramp_s=ramp_s, start_s=end_s - each.duration_s) for each in motions]
