"""Motions on which candidates are rehearsed: those of the trial, and constant speed with reversals. Pure."""

import math

from friction_hil.config import Circle, ExperimentBounds, Sine, Strokes, Triangle
from friction_hil.config.trajectories import PeriodicMotion, peak_speed
from friction_hil.daemon.assembly import periodic_path
from friction_hil.errors import OptionError
from friction_hil.rehearsal import Motion, SimulatedAxis, SimulatedMachine
from friction_hil.servo.mechanisms import Gantry
from friction_hil.tuning import thresholds as th
from friction_hil.tuning.motions import own_motion
from friction_hil.tuning.trial_motions import OWN, amplitude_of, trial_motions

TRIANGLE = "triangle"

_STROKE, _FREQUENCY, _ROUNDING = 0.3, 0.5, 0.1  # of the triangle, in those of the own motion
_PERIODS, _LEAST_S = 2, 2.0  # that are scored


def rehearsal_motions(own: PeriodicMotion, bounds: ExperimentBounds, resolution: float) -> dict[str, Motion]:
    """Return the motions of a rehearsal by name; the parameters are those of `trial_motions`."""
    motions = trial_motions(own, bounds, resolution)
    motions[TRIANGLE] = Triangle(
        kind="triangle",
        amplitude=_STROKE * amplitude_of(own),
        frequency=_FREQUENCY * own.frequency,
        rounding=_ROUNDING,
    )
    return {name: _rehearsed(each) for name, each in motions.items()}


def simulated_motions(machine: SimulatedMachine) -> dict[str, tuple[Motion, ...]]:
    """Return the motions by which compensation on a simulated machine is judged, by name: those of a rehearsal.

    Axes of a mechanism make motions of the same name together, and only those that all of them have. Both sides of a
    gantry make those of the side with the coarser encoder, except for their own, or they would twist its beam.

    Raises `OptionError`: an axis has neither a periodic trajectory nor an experiment.
    """
    each = [_motions_of(axis) for axis in machine.axes]
    if isinstance(machine.mechanism, Gantry):
        coarsest = max(range(len(each)), key=lambda k: machine.axes[k].facts.position_resolution)
        each = [{**each[coarsest], OWN: motions[OWN]} for motions in each]
    names = [name for name in each[0] if all(name in motions for motions in each)]
    return {name: tuple(motions[name] for motions in each) for name in names}


def _motions_of(axis: SimulatedAxis) -> dict[str, Motion]:
    config, given = axis.config, axis.config.trajectory
    bounds: ExperimentBounds | None = config.experiment
    if isinstance(given, Circle | Sine | Triangle | Strokes):
        own: PeriodicMotion = given
        if bounds is None:  # as fast and as far as the own motion
            bounds = ExperimentBounds(velocity=peak_speed(given), travel=amplitude_of(given))
    elif bounds is None:
        text = f"is {given.kind}, and the axis has no experiment: there is no motion to simulate; try kind: sine"
        raise OptionError(axis.name, "trajectory.kind", text)
    else:
        own = own_motion(axis.name, config)
    return rehearsal_motions(own, bounds, axis.facts.position_resolution)


def _rehearsed(motion: PeriodicMotion) -> Motion:
    """Return two periods of a motion, and at least two seconds, after one in which the compensation fades in."""
    period_s = 1.0 / motion.frequency
    periods = max(_PERIODS, math.ceil(_LEAST_S / period_s))
    return Motion(periodic_path(motion), periods * period_s, start_s=th.START_S + period_s)
