"""Loops of a drive from its recordings, and the servo that is simulated with them. Pure."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from pydantic import ValidationError

from friction_hil.config import AxisConfig, from_dict
from friction_hil.daemon.safety import LoopState
from friction_hil.errors import FrictionHilError, RecordingError
from friction_hil.identification.drive_loop import DriveLoops, identify_loops
from friction_hil.models.model_file import NETWORK, ModelFile
from friction_hil.recordings import Recording
from friction_hil.replay.verify import facts_of
from friction_hil.servo.config import Encoder, Loops, Motor, ServoConfig, ServoMechanics, TrueFriction
from friction_hil.servo.parts import Gravity

# tried in turn, for stiff friction
SOFT_HZ = (40_000.0, 80_000.0)
INTEGRATION_HZ = (*SOFT_HZ, 160_000.0, 320_000.0, 640_000.0)
_WHOLE = 1e-6  # of an integration step
_PEAK_RATIO = 3.0  # torque of the drive over the largest that was recorded


def drive_loops(recording: Recording, axis: AxisConfig, resolution: float) -> DriveLoops | None:
    """Return the identified loops of the drive, or None in CST, where the loops are those of the daemon.

    Raises `RecordingError`: the torque of the drive does not follow the usual loops.
    """
    if axis.mode == "cst":
        return None
    gain = axis.controller.position_gain if axis.controller is not None else 0.0
    return identify_loops(recording, axis.mode, resolution, gain)


def recorded_loops(recordings: Sequence[Recording]) -> tuple[DriveLoops | None, str]:
    """Return the loops of the drive from the first recording of the daemon whose uncompensated motion shows them.

    Returns also why none does; that is empty if no recording has such a motion.
    """
    why = ""
    for each in recordings:
        if "configuration" not in each.metadata or "facts" not in each.metadata or "is_enabled" not in each:
            continue
        own = (each["state"] == LoopState.RUNNING) & (each["is_enabled"] == 0.0) & (each["compensation"] == 0.0)
        bounds = np.flatnonzero(np.diff(np.concatenate([[False], own, [False]]).astype(np.int8)))
        if not bounds.size:
            continue
        begin, end = max(bounds.reshape(-1, 2).tolist(), key=lambda pair: pair[1] - pair[0])
        rows = np.arange(len(own))
        try:
            axis = from_dict(each.metadata["configuration"], each.path, reads_files=False).axes[each.axis]
            resolution = facts_of(each.metadata, each).position_resolution
            return drive_loops(each.at((rows >= begin) & (rows < end)), axis, resolution), ""
        except FrictionHilError as error:  # another version's, or a motion that does not show them
            why = why or str(error)
    return None, why


def simulated_axis(
    model: ModelFile,
    # Identified, kg m^2 or kg; that of the model file may be a former one. If it is zero, the recording does not show
    # it, and that of the drive's feed-forward is taken.
    inertia: float,
    loops: DriveLoops | None,  # from `drive_loops`
    recording: Recording,  # of the experiment; its largest torque sets what the drive can give
    period_s: float,  # of the loop: a whole number of integration steps
    resolution: float,  # step of the position, SI
    rates_hz: Sequence[float] = INTEGRATION_HZ,
) -> ServoConfig | None:
    """Return a servo with the friction of a model; None if no simulation has such a friction."""
    mechanics = model.mechanics
    if not inertia > 0.0 and loops is not None:
        inertia = loops.inertia
    if model.friction.model == NETWORK or not inertia > 0.0:
        return None
    turn = math.tau if model.axis == "rotary" else 1.0
    lag_s = mechanics.torque_lag_s if loops is None else loops.torque_lag_s
    parts: dict[str, Any] = {
        "mechanics": _mechanics(model, inertia),
        "encoder": Encoder(counts=turn / resolution),
        "motor": Motor(torque_lag_s=lag_s, peak_torque=_PEAK_RATIO * _largest_torque(recording)),
        "loops": Loops() if loops is None else _loops(loops, inertia),
    }
    for rate_hz in rates_hz:
        if abs(period_s * rate_hz - round(period_s * rate_hz)) > _WHOLE:
            continue
        try:
            friction = TrueFriction(
                model=model.friction.model, parameters=model.friction.parameters, modifiers=model.friction.modifiers
            )
            return ServoConfig(friction=friction, integration_hz=rate_hz, **parts)
        except ValidationError:
            continue  # stiffer than this rate can integrate
    return None


def _mechanics(model: ModelFile, inertia: float) -> ServoMechanics:
    """Return the rigid axis."""
    offset, gravity = model.mechanics.offset, model.mechanics.gravity
    has_swing = model.axis == "rotary" and (gravity.sine or gravity.cosine)
    swing = Gravity(sine=gravity.sine, cosine=gravity.cosine) if has_swing else None
    return ServoMechanics(axis=model.axis, inertia=inertia, load_torque=offset + gravity.constant, gravity=swing)


def _loops(loops: DriveLoops, inertia: float) -> Loops:
    return Loops(
        position_gain=loops.position_gain,
        velocity_gain=loops.velocity_gain,
        integral_hz=max(loops.integral_hz, 0.0),
        velocity_feedforward=max(loops.velocity_feedforward, 0.0),
        inertia_feedforward=max(loops.inertia / inertia, 0.0),
    )


def _largest_torque(recording: Recording) -> float:
    largest = float(np.nanmax(np.abs(recording["torque"])))
    if not 0.0 < largest < math.inf:
        raise RecordingError(f"{recording.path}: {recording.axis}: no torque was recorded")
    return largest
