"""Scales of a drive: from the configuration, else from its own objects; whether the two agree; the table of units.

Formulas of CiA 402-2 ("factor group"), for one revolution of the motor:

- 608Fh, position encoder resolution: ``608Fh:01 / 608Fh:02`` counts
- 6091h, gear ratio: ``6091h:02 / 6091h:01`` revolutions of the driving shaft
- 6092h, feed constant: ``6092h:01 / 6092h:02`` position units for a revolution of the driving shaft
- 6064h, position: encoder counts x feed constant / (encoder resolution x gear ratio)
- 6090h, velocity encoder resolution: ``6090h:01 / 6090h:02`` counts/s at one revolution per second
- 6096h, velocity factor: velocity unit = position units per second x ``6096h:01 / 6096h:02``

Many drives report 1/1 in objects that they do not use; such a value says nothing here.
"""

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from friction_hil.drive import Mode, UnitRow
from friction_hil.errors import DriveError
from friction_hil_drivers.cia402 import codes, objects
from friction_hil_drivers.cia402.access import ObjectReader
from friction_hil_drivers.cia402.objects import Object
from friction_hil_drivers.cia402.options import DriveOptions
from friction_hil_drivers.cia402.units import (
    LEAST_RESOLUTION,
    PER_MILLE,
    TOLERANCE,
    DriveUnits,
    Kind,
    Measure,
    Unit,
    decode_position_unit,
    decode_velocity_unit,
    parse_velocity_unit,
)
from friction_hil_drivers.torque_sign import InvertedTorque, torque_signs

if TYPE_CHECKING:
    from friction_hil.config import AxisConfig
    from friction_hil.config.axis import AxisLimits

NOTHING_CONFIRMS = "not cross-checked"
TRUSTED = "trusted although"
_TORQUE_TOLERANCE = 1e-2
_TORQUE_STEP = 0.5e-3  # N m; half a step of 6076h
_TURN = 2.0 * math.pi  # rad
_POSITION_INVERTED, _VELOCITY_INVERTED = 0x80, 0x40  # bits of 607Eh
_POLARITY = {_POSITION_INVERTED: "position", _VELOCITY_INVERTED: "velocity"}
_COARSE = 0.1  # of the friction: a larger step of the torque is told
_SPEED = 0.1  # of the velocity limit: where the level of the friction is taken


@dataclass(frozen=True, slots=True)
class Reported:
    """A scale as the drive reports it, and the objects that it follows from."""

    value: float
    source: str


@dataclass(frozen=True, slots=True)
class Scale:
    """One scale of a drive."""

    value: float  # counts per rad (m), increments per rad/s (m/s), or N m (N) at 1000 per mille
    text: str  # the same in words, with its unit
    source: str  # where it comes from
    confirmation: str  # what agrees with it
    contradiction: str = ""  # what the drive says instead; empty if it agrees, or says nothing


@dataclass(frozen=True, slots=True)
class Scales:
    """All scales of one drive, without the signs that `DriveOptions` inverts."""

    position: Scale
    velocity: Scale
    torque: Scale

    def units(self, *, is_inverted: bool, inverted_torque: InvertedTorque = "none") -> DriveUnits:
        """Return the conversion that the cyclic phase uses."""
        sign = -1.0 if is_inverted else 1.0
        of_command, of_feedback = torque_signs(inverted_torque)
        torque = sign * of_feedback * self.torque.value
        return DriveUnits(sign * self.position.value, sign * self.velocity.value, torque, of_command * of_feedback)


def read_units(access: ObjectReader, options: DriveOptions, kind: Kind) -> DriveUnits:
    """Return the conversion of a drive, without comparing configuration and drive; see `read_scales`."""
    scales = read_scales(access, options, kind)
    return scales.units(is_inverted=options.is_inverted, inverted_torque=options.inverted_torque)


def read_scales(access: ObjectReader, options: DriveOptions, kind: Kind) -> Scales:
    """Return the scales of a drive; raises a `DriveError` if neither options nor drive give one, or leave it open."""
    position = _position(access, options, kind)
    return Scales(position, _velocity(access, options, kind, position.value), _torque(access, options, kind))


def require_velocity_unit(access: ObjectReader, options: DriveOptions) -> None:
    """Raise a `DriveError` where the drive has a unit for velocity targets that neither it nor the options show."""
    hidden = access.why_hidden(objects.VELOCITY_UNIT)
    if hidden and options.velocity_unit is None:
        text = (
            f"{access.axis}: {access.where} has a unit for velocities ({objects.VELOCITY_UNIT}), but does not show it "
            f"({hidden}): start again, or give velocity_unit (counts/s, rpm, 0.1 rpm, deg/s ...)"
        )
        raise DriveError(text, code=codes.UNIT_UNKNOWN)


def require_agreement(access: ObjectReader, options: DriveOptions, scales: Scales) -> None:
    """Raise a `DriveError` with both numbers for a key that contradicts the drive and has no `trust`."""
    for key, scale in (
        ("counts_per_unit", scales.position),
        ("velocity_unit", scales.velocity),
        ("rated_torque", scales.torque),
    ):
        if scale.contradiction and key not in options.trust:
            text = (
                f"{access.axis}: {key} says {scale.text}, but {access.where} says {scale.contradiction}. One of them "
                f"is wrong: correct {key} or leave it out; if it is the drive that is wrong, set trust: [{key}]"
            )
            raise DriveError(text, code=codes.UNITS_CONTRADICT)


# Position


def _position(access: ObjectReader, options: DriveOptions, kind: Kind) -> Scale:
    per = "m" if kind == "linear" else "rad"
    reported = _reported_positions(access, kind, is_needed=options.counts_per_unit is None)
    given = options.counts_per_unit
    if given is not None:
        return _compared(given, f"{given:.7g} counts per {per}", "counts_per_unit", reported, f"counts per {per}")
    if not reported:
        text = (
            f"{access.axis}: {access.where} does not report its encoder resolution "
            f"({objects.ENCODER_INCREMENTS}): give counts_per_unit (counts per {per})"
        )
        raise DriveError(text, code=codes.UNIT_UNKNOWN)
    first = reported[0]
    others = [other for other in reported[1:] if not math.isclose(other.value, first.value, rel_tol=TOLERANCE)]
    if others:
        text = (
            f"{access.axis}: the objects of {access.where} leave open what a count of 6064h is: {first.value:.7g} "
            f"counts per rad by {first.source}, {others[0].value:.7g} by {others[0].source}; give counts_per_unit "
            "(counts per rad of the motor)"
        )
        raise DriveError(text, code=codes.UNIT_AMBIGUOUS)
    agreed = " and ".join(f"{other.source} agrees" for other in reported[1:])
    return Scale(first.value, f"{first.value:.7g} counts per {per}", first.source, agreed or NOTHING_CONFIRMS)


def _reported_positions(access: ObjectReader, kind: Kind, *, is_needed: bool) -> list[Reported]:
    """Return what the drive's objects say of the scale of 6064h, per rad of the motor or per m; the surest first.

    More than one: the objects contradict each other, or it depends on which side of a gear they refer to.
    """
    unit = _decoded(access, objects.POSITION_UNIT, is_needed=is_needed)
    if kind == "linear":
        if unit is not None and unit.measure is Measure.LENGTH:
            return [Reported(1.0 / unit.scale, f"60A8h {unit.text}")]
        return []  # counts per revolution say nothing about a metre
    resolution, gear, feed = (_ratio(access, *pair) for pair in (_RESOLUTION, _GEAR, _FEED))
    has_gear = gear is not None and gear != 1.0
    reported = []
    if unit is not None and unit.measure is Measure.ANGLE:
        reported.append(Reported(1.0 / unit.scale, f"60A8h {unit.text}"))
        if gear is not None and has_gear:
            reported.append(Reported(1.0 / unit.scale / gear, f"60A8h {unit.text} behind the gear 6091h"))
        return reported
    if feed is not None and feed != 1.0:
        name = f"6092h {feed:g} and 6091h {gear:g}" if gear is not None and has_gear else f"6092h {feed:g}"
        reported.append(Reported(feed / (gear or 1.0) / _TURN, name))
    if resolution is not None and resolution >= LEAST_RESOLUTION:
        reported.append(Reported(resolution / _TURN, f"608Fh {resolution:.10g} per revolution"))
        if gear is not None and has_gear and len(reported) == 1:
            reported.append(Reported(resolution / gear / _TURN, f"608Fh behind the gear 6091h of {gear:g}"))
    return reported


_RESOLUTION = objects.ENCODER_INCREMENTS, objects.MOTOR_REVOLUTIONS
_VELOCITY_RESOLUTION = objects.VELOCITY_ENCODER_INCREMENTS, objects.VELOCITY_MOTOR_REVOLUTIONS
_GEAR = objects.GEAR_MOTOR_REVOLUTIONS, objects.GEAR_SHAFT_REVOLUTIONS
_FEED = objects.FEED, objects.FEED_SHAFT_REVOLUTIONS
_VELOCITY_FACTOR = objects.VELOCITY_FACTOR_NUMERATOR, objects.VELOCITY_FACTOR_DIVISOR


def _ratio(access: ObjectReader, numerator: Object, divisor: Object) -> float | None:
    """Return the ratio of two entries; None where the drive lacks the first one or it holds 0."""
    value = access.find(numerator)
    return value / (access.find(divisor) or 1) if value else None


# Velocity


def _velocity(access: ObjectReader, options: DriveOptions, kind: Kind, counts: float) -> Scale:
    given = None if options.velocity_unit is None else parse_velocity_unit(options.velocity_unit)
    unit = _decoded(access, objects.VELOCITY_UNIT, is_needed=given is None)
    per = "m/s" if kind == "linear" else "rad/s"
    reported = []
    if unit is not None and (given is None or _fits(unit, kind)):
        reported = [Reported(_increments(access, unit, kind, counts, "60A9h"), f"60A9h {unit.text}")]
    if given is not None:
        value = _increments(access, given, kind, counts, "velocity_unit")
        text = f"{given.text}, {value:.7g} increments per {per}"
        return _compared(value, text, "velocity_unit", reported, f"increments per {per}")
    if unit is not None:
        value = reported[0].value
        return Scale(value, f"{unit.text}, {value:.7g} increments per {per}", "60A9h", NOTHING_CONFIRMS)
    factor = _ratio(access, *_VELOCITY_FACTOR) or 1.0
    hidden = access.why_hidden(objects.VELOCITY_UNIT)
    source = f"the assumption counts/s, as {f'60A9h was not read ({hidden})' if hidden else 'there is no 60A9h'}"
    if factor != 1.0:
        source = f"6096h, {factor:.7g} times counts/s"
    value = factor * counts
    return Scale(value, f"{value:.7g} increments per {per}", source, NOTHING_CONFIRMS)


def _increments(access: ObjectReader, unit: Unit, kind: Kind, counts: float, where: str) -> float:
    """Return the increments per rad/s (m/s) of a unit of velocity."""
    if unit.measure is Measure.COUNTS:
        resolution = None if kind == "linear" else _ratio(access, *_VELOCITY_RESOLUTION)
        if where == "60A9h" and resolution is not None and resolution >= LEAST_RESOLUTION:
            return resolution / _TURN / unit.scale
        return counts / unit.scale
    if not _fits(unit, kind):
        wanted = "counts/s or m/s" if kind == "linear" else "counts/s, rpm, rad/s or deg/s"
        text = f"{access.axis}: {where} of {access.where} is {unit.text}; a {kind} axis needs {wanted}"
        raise DriveError(text, code=codes.UNIT_UNKNOWN)
    return 1.0 / unit.scale


def _fits(unit: Unit, kind: Kind) -> bool:
    return unit.measure is not (Measure.ANGLE if kind == "linear" else Measure.LENGTH)


def _decoded(access: ObjectReader, entry: Object, *, is_needed: bool) -> Unit | None:
    """Return the unit in 60A8h or 60A9h; None where the drive has none, or has one that is neither known nor needed."""
    code = access.find(entry)
    decode = decode_position_unit if entry is objects.POSITION_UNIT else decode_velocity_unit
    try:
        return None if code is None else decode(code)
    except ValueError as error:
        if not is_needed:
            return None
        position = entry is objects.POSITION_UNIT
        fix = "counts_per_unit" if position else "velocity_unit (counts/s, rpm, 0.1 rpm, deg/s ...)"
        text = f"{access.axis}: {access.where} reports a unit that is not known here: {entry} = {error}; give {fix}"
        raise DriveError(text, code=codes.UNIT_UNKNOWN) from None


# Torque


def _torque(access: ObjectReader, options: DriveOptions, kind: Kind) -> Scale:
    per = "N" if kind == "linear" else "N m"
    milli = access.find(objects.RATED_TORQUE)
    given = options.rated_torque
    if given is None:
        if not milli:
            text = (
                f"{access.axis}: {access.where} does not report its rated torque ({objects.RATED_TORQUE}): give "
                "rated_torque in N m (rated current times torque constant)"
            )
            raise DriveError(text, code=codes.UNIT_UNKNOWN)
        return Scale(milli / 1e3, f"{milli / 1e3:.6g} {per} at 1000 per mille", "6076h", NOTHING_CONFIRMS)
    text = f"{given:.6g} {per} at 1000 per mille"
    if not milli:
        return Scale(given, text, "rated_torque", NOTHING_CONFIRMS)
    found = milli / 1e3
    if abs(given - found) <= _TORQUE_TOLERANCE * given + _TORQUE_STEP:
        return Scale(given, text, "rated_torque", "6076h agrees")
    if kind == "linear":  # 6076h may hold the torque of the motor before the screw
        return Scale(given, text, "rated_torque", f"{NOTHING_CONFIRMS} (6076h {found:.6g}, of the motor?)")
    return _contradicted(given, text, "rated_torque", Reported(found, "6076h"), f"{per} at 1000 per mille")


def _compared(value: float, text: str, key: str, reported: list[Reported], unit: str) -> Scale:
    """Return a scale of the configuration, compared with what the drive reports."""
    if not reported:
        return Scale(value, text, key, NOTHING_CONFIRMS)
    for one in reported:
        if math.isclose(value, one.value, rel_tol=TOLERANCE):
            return Scale(value, text, key, f"{one.source} agrees")
    return _contradicted(value, text, key, reported[0], unit)


def _contradicted(value: float, text: str, key: str, reported: Reported, unit: str) -> Scale:
    ratio = max(value / reported.value, reported.value / value)
    says = f"{reported.value:.7g} {unit} ({reported.source}): a factor of {ratio:.4g}"
    return Scale(value, text, key, f"{TRUSTED} the drive says {says}", says)


# Table of units and limits, shown before the first enable, and notes


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
