"""Checks of a recorded experiment, before anything is identified from it. Pure."""

import numpy as np

from friction_hil.daemon.safety import LoopState
from friction_hil.numerics.jit import Array
from friction_hil.recordings import Recording
from friction_hil.tuning import thresholds as th
from friction_hil.tuning.motions import TuningError


def with_torque(recording: Recording, mode: str) -> Recording:
    """Return the recording of an experiment with a column ``torque`` that can be used for identification.

    For a drive that does not report its torque, that is the commanded torque at the time at which it acted. ``mode``:
    ``csp``, ``csv`` or ``cst``.

    Raises `TuningError`: the drive does not report its torque, and the command is not the whole torque either.
    """
    [facts] = (each for each in recording.metadata["facts"] if each["name"] == recording.axis)
    if facts["torque_delay_s"] is not None:
        return recording
    if mode != "cst":
        raise TuningError(
            f"{recording.axis}: its drive does not report its torque, and in mode {mode} the daemon does not command "
            "all of it; tune it in mode cst"
        )
    time_s, delay_s = recording["time_s"], facts["actuation_delay_s"] + 0.5 * recording.period_s  # a mean, as measured
    recording.columns["torque"] = np.interp(time_s - delay_s, time_s, recording["command"])
    recording.problems.append("the drive does not report its torque: the commanded one is used")
    return recording


def refuse_limit_cycle(recording: Recording, velocity: float, unit: str) -> str:
    """Refuse an axis whose control loop oscillates; return a warning if the axis jumps at break-away, else "".

    Both move much faster than the experiment asks. An axis that breaks away from friction jumps in the direction of
    its set-point, once or a few times in each stroke. An axis in a limit cycle reverses at such a speed more often than
    its set-point does.

    ``recording``: the slow sweeps of an experiment: in fast ones any loop may lag by half a period. ``velocity``:
    highest speed of the experiment, rad/s or m/s. ``unit``: rad or m. Raises `TuningError`: the control loop
    oscillates.
    """
    is_running = recording["state"] == LoopState.RUNNING
    position, demand = recording["position"][is_running], recording["velocity_demand"][is_running]
    step = max(1, round(th.SPEED_WINDOW_S / recording.period_s))
    measured = (position[step:] - position[:-step]) / (step * recording.period_s)
    fastest = float(np.max(np.abs(measured), initial=0.0))
    if fastest <= th.TOO_FAST * velocity:
        return ""
    found = f"{recording.axis} has moved at {fastest:.3g} {unit}/s, where its experiment asks for {velocity:g} at most"
    if _reversals(measured, velocity) > _reversals(demand, 0.0):
        raise TuningError(
            f"{found}: the loop that controls it swings (lower its velocity_gain, or the drive's, or take a shorter "
            "period_s)"
        )
    return (
        f"{found}: the loop that controls it is soft, and the axis jumps where it breaks away (raise its "
        "velocity_gain, or the experiment's velocity, for a better model)"
    )


def _reversals(velocity: Array, least: float) -> int:
    """Count the sign changes of a velocity (n,) among its values above ``least``."""
    signs = np.sign(velocity[np.abs(velocity) > least])
    return int(np.count_nonzero(signs[1:] != signs[:-1]))
