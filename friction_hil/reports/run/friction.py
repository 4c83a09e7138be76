"""Friction of a run over velocity: measured, of the model, and as it was compensated."""

from dataclasses import dataclass

import numpy as np

from friction_hil.config import AxisConfig
from friction_hil.daemon.safety import LoopState
from friction_hil.errors import FrictionHilError
from friction_hil.friction.steady_curve import steady_curve
from friction_hil.models.model_file import ModelFile
from friction_hil.numerics.jit import Array
from friction_hil.recordings import Recording
from friction_hil.recordings.columns import TIME
from friction_hil.replay.comparison import is_own, mechanics_torque
from friction_hil.replay.preparation import replay_segments

_MOST_POINTS = 6000
_BINS = 200
_GOLDEN = 0.6180339887498949


@dataclass(frozen=True, slots=True, eq=False)
class FrictionOverVelocity:
    """What is drawn over velocity; SI, torques in N m or N. Pairs are velocity and torque, each (k,)."""

    measured: tuple[Array, Array] | None  # torque, less the mechanics of the model if there is one
    is_friction: bool  # the mechanics could be subtracted
    compensation: tuple[Array, Array] | None  # over the velocity that the model was given, where it was in force
    curve: tuple[Array, Array] | None  # steady state of the model


def friction_over_velocity(
    recording: Recording, config: AxisConfig | None, notes: list[str]
) -> FrictionOverVelocity | None:
    """Return what a recording shows over velocity, or None; ``notes`` gets what is missing, and why."""
    model = None if config is None else config.model
    measured, is_friction = _measured(recording, model, notes)
    compensation = _compensation(recording, 0.0 if config is None else config.compensation.fade_s)
    fastest = max((float(np.max(np.abs(pair[0]))) for pair in (measured, compensation) if pair), default=0.0)
    if measured is None and compensation is None:
        notes.append("no friction over velocity: it takes a velocity, and a torque or a compensation")
        return None
    curve = None
    if model is not None and fastest > 0.0:
        curve = steady_curve(model.friction_model, fastest)
    elif model is None:
        notes.append("no curve of a model: there is no configuration in the recording; name one with --config")
    return FrictionOverVelocity(measured, is_friction, compensation, curve)


def _measured(
    recording: Recording, model: ModelFile | None, notes: list[str]
) -> tuple[tuple[Array, Array] | None, bool]:
    """Return velocity and friction of the moving axis; without a model, velocity and torque."""
    if "torque" not in recording:
        return None, False
    if "position" in recording and not np.any(recording["torque"]):
        notes.append("no measured friction: the drive does not report its torque")
        return None, False
    if "load_torque" in recording and is_own(recording):
        notes.append("no measured friction: weight and inertia of the arm that loads the axis are in the torque")
        return None, False
    if model is not None and "position" in recording:
        try:
            segments, _, _ = replay_segments(recording)
        except FrictionHilError as error:
            notes.append(f"no measured friction: {error}")
            return None, False
        velocity = np.concatenate([each.velocity for each in segments])
        ratio = model.mechanics.torque_ratio
        friction = np.concatenate([each.torque / ratio - mechanics_torque(model, each) for each in segments])
        return thinned(velocity, friction), True
    if "velocity" in recording:
        return thinned(recording["velocity"], recording["torque"]), False
    return None, False


def _compensation(recording: Recording, fade_s: float) -> tuple[Array, Array] | None:
    """Return velocity and compensation of the rows in which it was in force, without those in which it faded in."""
    if "compensation" not in recording or "velocity_estimate" not in recording:
        return None
    rows = np.isfinite(recording["compensation"]) & np.isfinite(recording["velocity_estimate"])
    if "is_enabled" in recording:
        rows &= recording["is_enabled"] == 1.0
        rows &= recording[TIME] >= recording[TIME][np.argmax(rows)] + fade_s
    if "state" in recording:
        rows &= recording["state"] == LoopState.RUNNING
    if not rows.any():
        return None
    return thinned(recording["velocity_estimate"][rows], recording["compensation"][rows])


def thinned(velocity: Array, torque: Array) -> tuple[Array, Array] | None:
    """Return a fair sample of the points, and the extremes of the torque at each velocity; None without any point.

    The sample is spread by the golden ratio: even steps might meet the same points of each period of the motion.
    """
    known = np.isfinite(velocity) & np.isfinite(torque)
    velocity, torque = velocity[known], torque[known]
    count = velocity.size
    if count <= _MOST_POINTS:
        return (velocity, torque) if count else None
    sample = (np.arange(_MOST_POINTS) * _GOLDEN % 1.0 * count).astype(np.intp)
    low, high = float(velocity.min()), float(velocity.max())
    bins = ((velocity - low) * (_BINS / ((high - low) or 1.0))).astype(np.intp)
    order = np.lexsort((torque, bins))
    ends = np.flatnonzero(np.diff(bins[order], append=_BINS + 1))
    rows = np.unique(np.concatenate([sample, order[ends], order[np.concatenate([[0], ends[:-1] + 1])]]))
    return velocity[rows], torque[rows]
