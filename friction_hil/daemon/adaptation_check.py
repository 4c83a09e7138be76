"""Can adaptation learn anything in the motion of an axis? Found out from its configuration, before any run. Pure."""

import math
from typing import TYPE_CHECKING

import numpy as np

from friction_hil.compensator import adaptation
from friction_hil.daemon.assembly import make_compensator, make_path, ramp_s
from friction_hil.daemon.notices import adaptation_needs
from friction_hil.drive import AxisFacts
from friction_hil.errors import UsageError
from friction_hil.motion.trajectory import PathTime, Trajectory
from friction_hil.numerics.jit import Array
from friction_hil.numerics.readable import POSITION_UNITS
from friction_hil.servo.config import ServoConfig

if TYPE_CHECKING:
    from friction_hil.compensator import Compensator
    from friction_hil.config import AxisConfig

_PERIODS = 2.0  # of a periodic motion that are looked at
_MOST_SAMPLES = 20_000
_DELAY_CYCLES = 1.5  # of any drive: it makes no difference here


def adaptation_problem(name: str, axis: "AxisConfig", period_s: float) -> str | None:
    """Return why adaptation will learn nothing in the configured motion; None if it will, or if that is not known.

    It is not known without a model, without the resolution of the encoder (``counts_per_unit``, or the simulated
    encoder), or where the daemon does not move the axis.
    """
    resolution = _resolution(axis)
    file = axis.model.source_path
    is_model_missing = file is not None and not file.exists()
    if axis.compensation.adaptation is None or not axis.compensation.enabled or resolution is None or is_model_missing:
        return None
    if axis.trajectory.kind in ("none", "master"):
        return None
    delay_s = _DELAY_CYCLES * period_s
    facts = AxisFacts(name, "", resolution, 0.0, delay_s, delay_s)
    try:
        compensator = make_compensator(axis, axis.model, facts, period_s)
        velocity, step_s = _demanded(axis, resolution, period_s)
    except UsageError:  # e.g. an encoder that is too coarse for the experiment: the run itself says so
        return None
    if can_learn(velocity, step_s, compensator):
        return None
    unit = POSITION_UNITS[axis.model.axis]
    return f"will learn nothing in this motion: {adaptation_needs(unit, compensator)}"


def can_learn(velocity: Array, step_s: float, compensator: "Compensator") -> bool:
    """Return True if a velocity (n,), sampled at an interval, SI, is steady sliding for long enough somewhere."""
    direction = np.where(np.abs(velocity) >= compensator.slowest_learning, np.sign(velocity), 0.0)
    edges = np.flatnonzero(np.diff(direction)) + 1
    return any(
        len(part) * step_s > adaptation.SETTLED_S and float(np.sum(np.abs(part))) * step_s > compensator.sliding_travel
        for part, sign in zip(np.split(velocity, edges), direction[np.concatenate([[0], edges])], strict=True)
        if sign
    )


def _resolution(axis: "AxisConfig") -> float | None:
    """Return one count of the encoder, rad or m, as far as the configuration tells."""
    if (counts := getattr(axis.options, "counts_per_unit", None)) is not None:
        return 1.0 / float(counts)
    if isinstance(axis.simulation, ServoConfig):
        turn = math.tau if axis.model.axis == "rotary" else 1.0
        return turn / axis.simulation.encoder.counts
    return None


def _demanded(axis: "AxisConfig", resolution: float, period_s: float) -> tuple[Array, float]:
    """Return the velocity demand of the configured motion, its start included, and the sampling interval."""
    motion = axis.trajectory
    frequency = getattr(motion, "frequency", None)
    length_s = _PERIODS / frequency if frequency else getattr(motion, "duration_s", 1.0)
    start_s = ramp_s([axis])
    time = PathTime(start_s)
    time.start(0.0)
    trajectory = Trajectory(make_path(axis, resolution, period_s), time)
    whole_s = start_s + length_s
    step_s = max(period_s, whole_s / _MOST_SAMPLES)
    return np.array([trajectory.at(k * step_s).velocity for k in range(round(whole_s / step_s))]), step_s
