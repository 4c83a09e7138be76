"""The table of a drive's units and limits, shown before the first enable, and notes on its resolution. Pure."""

from typing import TYPE_CHECKING

import numpy as np

from friction_hil.drive import Mode, UnitRow
from friction_hil_drivers.canopen.scales import Kind, Scale, Scales
from friction_hil_drivers.canopen.units import PER_MILLE

if TYPE_CHECKING:
    from friction_hil.config import AxisConfig
    from friction_hil.config.axis import AxisLimits

_COARSE = 0.1  # of the friction: a larger step of the torque is told
_SPEED = 0.1  # of the velocity limit: where the level of the friction is taken


def unit_rows(scales: Scales, limits: "AxisLimits", mode: Mode, kind: Kind) -> tuple[UnitRow, ...]:
    """Return the rows for position, velocity and torque."""
    unit, force = ("m", "N") if kind == "linear" else ("rad", "N m")
    position = "none"
    if limits.position is not None:
        low, high = limits.position
        counts = [f"{bound * scales.position.value:.0f}" for bound in (low, high)]
        position = f"[{low:g}, {high:g}] {unit} = [{counts[0]}, {counts[1]}] counts"
    increments = limits.velocity * scales.velocity.value
    per_mille = int(limits.torque / scales.torque.value * PER_MILLE + 1e-9)
    velocity = f"{limits.velocity:g} {unit}/s = {_in_words(increments)} increments"
    further = "examined by the first motion" if mode is Mode.CSV else ""
    return (
        _row("position", scales.position, position),
        _row("velocity", scales.velocity, velocity, further),
        _row("torque", scales.torque, f"{limits.torque:g} {force} = {per_mille} per mille"),
    )


def _row(quantity: str, scale: Scale, limit: str, further: str = "") -> UnitRow:
    confirmation = f"{scale.confirmation}; {further}" if further else scale.confirmation
    return UnitRow(quantity, scale.text, scale.source, confirmation, limit)


def _in_words(value: float) -> str:
    return f"{value:.0f}" if value >= 100.0 else f"{value:.3g}"


def resolution_notes(scales: Scales, axis: "AxisConfig") -> list[str]:
    """Return a note where a step of the drive's torque is coarse, relative to the limit or to the friction.

    The torque is rounded towards zero, so that up to a step of the compensation is missing.
    """
    step, limit = scales.torque.value / PER_MILLE, axis.limits.torque
    force = "N" if axis.model.axis == "linear" else "N m"
    if limit < step:
        return [
            f"a step of the drive's torque is {step:.3g} {force}, more than limits.torque ({limit:g} {force}): no "
            "torque can be sent"
        ]
    velocity = np.array([_SPEED * axis.limits.velocity])
    level = abs(float(axis.model.friction_model.steady_state(velocity, load_torque=0.0)[0]))
    if 0.0 < level * _COARSE < step:
        return [
            f"a step of the drive's torque is {step:.3g} {force}, and the friction of the model {level:.3g} {force}: "
            f"torque is rounded towards zero, so that up to {min(step / level, 1.0):.0%} of the compensation is missing"
        ]
    return []
