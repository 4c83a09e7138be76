"""A message as the loop takes it: unpacked, and judged.

The loop takes only what cannot harm it: numbers that are finite where they must be, indices within their arrays, and
period, resolution, limits and velocity estimator as they are.
"""

import math
from collections.abc import Collection, Sequence

import numpy as np

from friction_hil.compensator import prediction, reference
from friction_hil.compensator.records import FIXED, settings_type
from friction_hil.daemon.control.message import AXIS_HEAD, HEAD, TEXT_BYTES, Action, AxisChange, Change
from friction_hil.daemon.static_torque import StaticTorque
from friction_hil.friction.dispatch import FAMILIES
from friction_hil.friction.kernel import PARAMETER_ROOM, PLAIN_ROOM, STATE_ROOM
from friction_hil.numerics.jit import Array, StructuredArray

MOST_GAIN = 1.5
_FINITE = ("level", "inertia", "lead_s", "ahead_s", "ahead_noise_square", "noise", "rest", "epsilon", "gate_square")
_STATIC_ROOM = len(StaticTorque._fields)
_NOT_KNOWN = "reference_temperature"  # NaN: the model does not depend on temperature


def room(axes: int) -> int:
    """Return the length of the longest message to so many axes, bytes."""
    largest = settings_type(PARAMETER_ROOM).itemsize // 8
    return 8 * (HEAD + axes * (AXIS_HEAD + largest + STATE_ROOM + _STATIC_ROOM)) + TEXT_BYTES


def unpack(message: bytes, records: Sequence[StructuredArray], rooms: Collection[int] = (PLAIN_ROOM,)) -> Change:
    """Return the change that a message holds.

    ``records``: present settings of each axis. ``rooms``: numbers of model parameters for which the loop has compiled
    code; any other would be compiled within a cycle. Raises `ValueError`: the message is not a change that can be
    applied to these axes; it says why.
    """
    if len(message) < 8 * HEAD + TEXT_BYTES or len(message) % 8:
        raise ValueError("it is no change")
    numbers = np.frombuffer(message[:-TEXT_BYTES], "<f8")
    head = [_whole(value, "head") for value in numbers[:HEAD].tolist()]
    number, action, count, size = head
    if size != numbers.size or count not in (0, len(records)) or action not in list(Action) or number < 1:
        raise ValueError("its head is wrong")
    axes: list[AxisChange | None] = []
    at = HEAD
    for record in records[:count]:
        change, at = _unpack_axis(numbers, at, record, rooms)
        axes.append(change)
    if at != numbers.size:
        raise ValueError("its length is wrong")
    text = message[-TEXT_BYTES:].rstrip(b"\0").decode("utf-8", "replace")
    return Change(number, Action(action), axes, text)


def _unpack_axis(
    numbers: Array, at: int, present: StructuredArray, rooms: Collection[int]
) -> tuple[AxisChange | None, int]:
    head = numbers[at : at + AXIS_HEAD].tolist()
    if len(head) < AXIS_HEAD:
        raise ValueError("its length is wrong")
    enabled = head[0]
    record_size, friction_size, static_size = (_whole(value, "length") for value in head[1:])
    if not (math.isnan(enabled) or enabled in (0.0, 1.0)) or min(record_size, friction_size, static_size) < 0:
        raise ValueError("the head of an axis is wrong")
    at += AXIS_HEAD
    record = friction = None
    if record_size:
        record = _record(numbers[at : at + record_size], present, rooms)
        at += record_size
    if friction_size:
        friction = numbers[at : at + friction_size].copy()
        if record is None or friction.size != STATE_ROOM or not np.isfinite(friction).all():
            raise ValueError("the state of the model is wrong")
        at += friction_size
    static = None
    if static_size:
        static = _static(numbers[at : at + static_size], present)
        at += static_size
    if record is not None and friction is None and not _is_same_model(record, present):
        raise ValueError("another model needs a state")
    is_enabled = None if math.isnan(enabled) else bool(enabled)
    if record is None and is_enabled is None and static is None:
        return None, at
    return AxisChange(is_enabled, record, friction, static), at


def _static(numbers: Array, present: StructuredArray) -> StaticTorque:
    """Return the feed-forward of gravity and offset, which stays within the torque limit of the axis."""
    if numbers.size != _STATIC_ROOM or not np.isfinite(numbers).all():
        raise ValueError("the feed-forward of gravity is damaged")
    static = StaticTorque(*numbers.tolist())
    if not (0.0 <= static.bound <= present[0]["torque_limit"] and static.per_load >= 0.0):
        raise ValueError("the feed-forward of gravity is out of its range")
    return static


def _record(numbers: Array, present: StructuredArray, rooms: Collection[int]) -> StructuredArray:
    """Return settings that are fit for the axis whose settings are ``present``."""
    for parameters in rooms:
        kind = settings_type(parameters)
        if numbers.size * 8 == kind.itemsize:
            record = numbers.copy().view(kind)
            break
    else:
        raise ValueError("the settings of an axis have the wrong size")
    new, old = record[0], present[0]
    for name, _ in FIXED:
        if new[name] != old[name]:
            raise ValueError(f"{name} is not to be changed")
    assert kind.names is not None
    for name in kind.names:
        if name != _NOT_KNOWN and np.isnan(np.atleast_1d(new[name]).view(np.float64)).any():
            raise ValueError(f"{name} is not a number")
    if not all(math.isfinite(new[name]) for name in _FINITE):
        raise ValueError("a setting is not finite")
    is_fit = (
        0.0 <= new["gain_positive"] <= MOST_GAIN
        and 0.0 <= new["gain_negative"] <= MOST_GAIN
        and 0.0 < new["fade_s"] < math.inf
        and 0.0 <= new["dead_band"] < math.inf
        and 0.0 <= new["adaptation_s"] < math.inf
        and 0.0 <= new["adaptation_bound"] < 1.0
        and new["level"] >= 0.0
        and new["source"] in reference.SOURCES.values()
        and new["kind"] in range(len(FAMILIES))
        and new["judged_cycles"] in range(1, reference.HORIZON + 1)
        and 0.0 <= new["ahead_cycles"] <= prediction.HORIZON
    )
    if not is_fit:
        raise ValueError("a setting is out of its range")
    begins = [_whole(value, "index") for value in new["friction"][1:4].tolist()]
    if not all(0 <= begin < parameters for begin in begins) or (begins[2] and parameters == PLAIN_ROOM):
        raise ValueError("the parameters of the model are damaged")
    return record


def _is_same_model(record: StructuredArray, present: StructuredArray) -> bool:
    new, old = record[0], present[0]
    same = new["kind"] == old["kind"] and new["friction"].size == old["friction"].size
    return bool(same and np.array_equal(new["friction"], old["friction"]))


def _whole(value: float, what: str) -> int:
    if not (math.isfinite(value) and value == int(value) and abs(value) < 2**53):
        raise ValueError(f"its {what} is wrong")
    return int(value)
