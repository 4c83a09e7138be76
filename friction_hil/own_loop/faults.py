"""What is said of a fault that the kernel has found, and of arrays that it cannot take."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from friction_hil.drive.codes import FaultCode
from friction_hil.errors import UsageError
from friction_hil.numerics.readable import POSITION_UNITS
from friction_hil.own_loop import kernel
from friction_hil.own_loop.joints import Joints


def fault_of(joints: Joints, fault: int) -> str:
    """Return the message of a fault, with its code."""
    k, reason = divmod(fault, kernel.REASONS)
    name, j = joints.names[k], joints.limits[k]
    unit = POSITION_UNITS[joints.configuration.axes[name].model.axis]
    if reason in (kernel.MISSING, kernel.JUMPS):
        text = f"{name}: no usable feedback for more than {joints.loop['most_stale'].item():.0f} cycles"
        if reason == kernel.MISSING:
            return FaultCode.FEEDBACK_MISSING.append_to(f"{text}: stale, or not finite")
        return FaultCode.POSITION_JUMPS.append_to(
            f"{text}: its position jumps further than limits.velocity allows from {j['position']:.4g} {unit}"
        )
    if reason == kernel.FAST:
        speed = joints.compensators[k].velocity_estimate
        return FaultCode.VELOCITY_LIMIT.append_to(
            f"{name}: velocity {speed:.4g} {unit}/s is beyond its limit of {j['velocity_limit']:g} {unit}/s"
        )
    if reason == kernel.CONTRADICTS:
        seen = j["seen"]
        moved, reported = seen["displacement"] / seen["duration_s"], seen["way"] / seen["duration_s"]
        return FaultCode.VELOCITY_CONTRADICTS.append_to(
            f"{name}: dq is {reported:.4g} {unit}/s, but q changes by {moved:.4g} {unit}/s: another unit, sign or joint"
        )
    if reason == kernel.OUTSIDE:
        low, high = j["position_low"], j["position_high"]
        return FaultCode.POSITION_LIMIT.append_to(
            f"{name}: position {j['position']:.4g} {unit} is outside [{low:g}, {high:g}] {unit}"
        )
    if reason == kernel.FOLLOWING:
        error = j["position_demand"] - j["position"]
        return FaultCode.FOLLOWING_ERROR.append_to(
            f"{name}: following error {error:.4g} {unit} is beyond its limit of {j['following_error']:g} {unit}"
        )
    return FaultCode.MODEL_NOT_FINITE.append_to(f"{name}: the friction model gave a torque that is not finite")


def as_array(name: str, value: Any, joints: Sequence[str]) -> NDArray[Any]:
    """Return one of `kernel.GIVEN` as the kernel takes it, (n,); a `UsageError`: it is not that."""
    kind, shape = np.bool_ if name == "fresh" else np.float64, (len(joints),)
    try:
        found = np.asarray(value)
        if found.dtype.kind not in "biufO":  # text is true, whatever it says, and half of a complex number is none
            raise TypeError(f"{found.dtype} is another type")
        if name == "fresh":
            found = found > 0  # NaN is not fresh
        array: NDArray[Any] = np.require(found, kind, ["C", "W"]) if found.ndim else np.asarray(found, kind)
    except (TypeError, ValueError) as error:
        text = f"{name} must be {len(joints)} numbers, one for each of {', '.join(joints)}"
        raise UsageError(f"{text}: {error}") from None
    if name == "fresh" and array.shape == ():
        return np.full(shape, bool(array))
    if array.shape != shape:
        text = f"it must be {shape}, a number for each of {', '.join(joints)}"
        raise UsageError(f"{name} has the shape {array.shape}: {text}")
    return array


def as_seconds(value: Any) -> float:
    """Return a time as a number, NaN for what is none."""
    try:
        return float(value)
    except Exception:  # noqa: BLE001 - whatever its type raises, it is no time
        return math.nan


def check_first(joints: Joints, given: Sequence[Any]) -> None:
    """Refuse a first call without what a setting needs, by a `UsageError`; ``given``: see `kernel.GIVEN`."""
    needs = ((kernel.DQ, "needs_velocity", "velocity: drive"), (kernel.TAU, "needs_torque", "adaptation or kalman"))
    for index, key, what in needs:
        lacking = [name for name, j in zip(joints.names, joints.limits, strict=True) if j[key]]
        if lacking and given[index] is None:
            name = kernel.GIVEN[index]
            raise UsageError(f"{name} is missing: compensation of {', '.join(lacking)} needs it ({what})")
