"""The table of a drive's units and limits, shown before the first enable, and notes on its resolution. Pure."""

from typing import TYPE_CHECKING

import numpy as np

from friction_hil.drive import Mode, UnitRow
from friction_hil_drivers.canopen.scales import Kind, Scale, Scales
from friction_hil_drivers.canopen.units import PER_MILLE
from friction_hil_drivers.torque_sign import InvertedTorque

if TYPE_CHECKING:
    from friction_hil.config import AxisConfig
    from friction_hil.config.axis import AxisLimits

_POSITION_INVERTED, _VELOCITY_INVERTED = 0x80, 0x40  # bits of 607Eh
_POLARITY = {_POSITION_INVERTED: "position", _VELOCITY_INVERTED: "velocity"}
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


def polarity_text(polarity: int) -> str:
    """Return object 607Eh in words.

    >>> polarity_text(0xC0)
    'C0h: position and velocity inverted'
    """
    inverted = [name for bit, name in _POLARITY.items() if polarity & bit]
    return f"{polarity:02X}h: {' and '.join(inverted) or 'nothing'} inverted"


def polarity_notes(polarity: int | None, inverted_torque: InvertedTorque) -> list[str]:
    """Return a note where the drive inverts its position or velocity: by CiA 402 it does not invert the torque then."""
    if polarity is None or not polarity & sum(_POLARITY):
        return []
    text = f"607Eh is {polarity_text(polarity)}"
    if polarity & _POSITION_INVERTED and inverted_torque == "none":
        text += (
            "; by CiA 402 the torque is not: if compensation makes the following error larger, set inverted_torque: "
            "both (or command, if only what is sent acts in the other direction)"
        )
    return [text]
