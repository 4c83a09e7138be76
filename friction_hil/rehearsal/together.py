"""Rehearsal of axes that are simulated together: one alone, or those that move one mechanism."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from friction_hil.config.simulation import Mechanism, coupled_servos
from friction_hil.numerics.jit import Array
from friction_hil.rehearsal import kernel
from friction_hil.rehearsal.rehearsal import Motion, Rehearsal

if TYPE_CHECKING:
    from friction_hil.models.model_file import ModelFile
    from friction_hil.servo.config import ServoConfig


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
    mechanism: Mechanism | None, runs: Sequence[AxisRun], *, is_compensated: bool = True
) -> tuple[dict[str, Array], ...]:
    """Simulate the motions of a machine; return the signals of each axis, as `Rehearsal.trace` does.

    All axes start and end together: the longest ramp is that of all, and a shorter motion is repeated before its part
    that is scored. ``mechanism``: what the axes move; None: there is one axis. ``runs``: one, or those of the axes of
    the mechanism, in its order and with one period.
    """
    if mechanism is None:
        [run] = runs
        return (run.rehearsal.trace(run.servo, run.model, run.motion, is_compensated=is_compensated),)
    runs = [replace(run, motion=motion) for run, motion in zip(runs, together(runs), strict=True)]
    demands = np.array([run.demand for run in runs])
    coupled = coupled_servos(mechanism, [run.servo for run in runs], [float(each[0, 0]) for each in demands])
    axes = [
        run.rehearsal.records(servo, run.model, is_compensated=is_compensated)
        for run, servo in zip(runs, coupled.servos, strict=True)
    ]
    records, all_axes = coupled.records, kernel.Axis(*map(np.concatenate, zip(*axes, strict=True)))
    all_axes = all_axes._replace(servo=records.plants, controller=records.controllers, state=records.states)
    daemon, traces = all_axes.daemon, np.empty((len(runs), len(kernel.TRACE), demands.shape[1]))
    order = np.argsort(daemon["delay_steps"] % daemon["period_steps"], kind="stable")
    kernel.run_coupled(records, all_axes, order, demands, traces)
    return tuple(dict(zip(kernel.TRACE, trace, strict=True)) for trace in traces)


def together(runs: Sequence[AxisRun]) -> list[Motion]:
    """Return the motions of axes that start and end together."""
    motions = [run.motion for run in runs]
    end_s = max(each.start_s + each.duration_s for each in motions)
    ramp_s = max(each.ramp_s for each in motions)
    return [replace(each, ramp_s=ramp_s, start_s=end_s - each.duration_s) for each in motions]
