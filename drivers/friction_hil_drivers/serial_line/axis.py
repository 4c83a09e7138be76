"""One drive in the cyclic phase: conversion between its process image and feedback and commands. No line, no clock."""

import math
import operator
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

from friction_hil.drive import Command, DriveState, Feedback, Request
from friction_hil.drive.codes import coded
from friction_hil.drive.encoder import derived_velocity, unwrap
from friction_hil.errors import OptionError
from friction_hil_drivers.cia402 import profile
from friction_hil_drivers.serial_line import codes
from friction_hil_drivers.serial_line.description import Description, Signal, Step
from friction_hil_drivers.serial_line.protocol import COMMANDS, TEMPERATURE, Image
from friction_hil_drivers.serial_line.read_back import contradiction
from friction_hil_drivers.serial_line.sequences import Sequencer, disable_writes, meaning_of, state_of, state_signals
from friction_hil_drivers.serial_line.units import LINEAR, NEEDS, ROTARY, UNITS, AxisUnits
from friction_hil_drivers.torque_sign import InvertedTorque, torque_signs

_WANTED = {
    "position_command": operator.attrgetter("position"),
    "velocity_command": operator.attrgetter("velocity"),
    "torque_command": operator.attrgetter("torque"),
}
ACTING = ("torque_command", "velocity_command")  # in force as soon as somebody enables the drive
_STATUS_LOSS_S = 0.5  # longest time without a report of the state


@dataclass(frozen=True, slots=True)
class SignalScales:
    """SI value of one step of the drive's number, by signal; negative if the axis is inverted."""

    of: Mapping[str, float]
    position_bits: int | None  # width of the position counter, which wraps


def unit_mistakes(axis: str, description: Description, units: AxisUnits, kind: str) -> list[OptionError]:
    """Return the mistakes in the units of a drive: missing keys, and units that do not fit the kind of axis."""
    found: dict[str, OptionError] = {}
    for name, signal in _scaled(description).items():
        text = f"{description.name} has {name} in {signal.unit}"
        if signal.unit in (ROTARY if kind == "linear" else LINEAR):
            found.setdefault("description", OptionError(axis, "description", f"{text}, but the axis is {kind}"))
        elif not math.isfinite(UNITS[signal.unit](units)):
            key = NEEDS[signal.unit]
            found.setdefault(key, OptionError(axis, key, f"{text}: give {key} of the axis"))
    return list(found.values())


def _scaled(description: Description) -> dict[str, Signal]:
    """Return the signals that are converted to SI."""
    known = (*COMMANDS, "position", "velocity", "torque")
    return {name: signal for name, signal in description.units().items() if name in known}


def make_scales(
    axis: str,
    description: Description,
    units: AxisUnits,
    *,
    kind: str,
    is_inverted: bool,
    inverted_torque: InvertedTorque = "none",
) -> SignalScales:
    """Compute the scales of a drive on one axis.

    Raises `OptionError`: a unit needs a key that the configuration does not give, or does not fit this kind of axis.
    """
    for mistake in unit_mistakes(axis, description, units, kind):
        raise mistake
    of_command, of_feedback = torque_signs(inverted_torque)
    signs = {"torque_command": of_command, "torque": of_feedback}
    scales = {}
    for name, signal in _scaled(description).items():
        scale = signal.scale * UNITS[signal.unit](units)
        if not (math.isfinite(scale) and scale):
            raise OptionError(
                axis, "description", f"one step of {name} would be {scale:g}; it must be finite and not zero"
            )
        scales[name] = signs.get(name, 1.0) * (-scale if is_inverted else scale)
    return SignalScales(scales, description.units()["position"].counter_bits)


def error_text(description: Description, number: float) -> str:
    """Return the number of the signal ``error`` with its meaning: ``32 (20h) overload``."""
    code = int(number)
    if code in description.errors:
        return f"{code} ({code:X}h) {description.errors[code]}"
    return profile.error_text(code) if description.state_machine == "cia402" else f"error {code} ({code:X}h)"


def not_zero(
    description: Description,
    names: Iterable[str],
    # the drive's number of a signal, None where it does not tell it: some registers can only be written
    read: Callable[[str], float | None],
    write_zero: Callable[[str], None],
) -> list[str]:
    """Set commands that the drive lets be read to zero where they are not; return those that stay, in words."""
    left = []
    for name in filter(description.can_be_read, names):
        if held := read(name):
            write_zero(name)
            held = read(name)
            if held is None or held:
                left.append(f"{name} of the drive {'is not shown any more' if held is None else f'stays {held:g}'}")
    return left


class SerialAxis:
    """Decodes and encodes the process image of one drive."""

    def __init__(
        self,
        name: str,
        description: Description,
        scales: SignalScales,
        image: Image,  # that the exchanges on the line fill and read
        commands: tuple[str, ...],  # written in each cycle
        before: Sequence[Step] = (),  # written before the drive is enabled
        period_s: float = 0.0,  # least time over which a velocity is derived from positions, s
    ) -> None:
        self.name = name
        self.image = image
        self._period_s = period_s
        self.sequencer = Sequencer(description, before)
        self.state = DriveState.UNKNOWN
        # signals of the watchdog that the drive lets be read: on the way to power, a step that writes one of them is
        # done when the drive reports what was written
        self.read_back: frozenset[str] = frozenset()
        # step that the drive accepted, and whose values are still to be read back
        self.written: Mapping[str, float] | None = None
        self._description = description
        self.scales = scales
        self._scales = scales.of
        self._position_scale = scales.of["position"]
        self._velocity_scale = scales.of.get("velocity")
        self._temperature_scale = description.units()[TEMPERATURE].scale if TEMPERATURE in description.units() else 1.0
        self._torque_scale = scales.of.get("torque", 0.0)
        self._position_bits = scales.position_bits
        self._commands = commands
        self._wanted = [(name, _WANTED[name], scales.of[name]) for name in commands]
        self._fast = tuple(n for n in ("position", "velocity") if n in scales.of)
        self._counts: int | None = None
        self._position = self._velocity = 0.0
        self._position_s = math.nan
        self._state_s = self._filled_s = math.nan
        self._state_numbers: list[float | None] = []  # that the state was derived from
        self._why = ""  # meaning of the number that shows a fault
        self._status = ""  # statusword of a drive that is not enabled, in words
        self.state_signals = state_signals(description)

    def fill(self, feedback: Feedback, time_s: float, last_error: str) -> None:
        """Fill the feedback from the image; position and velocity that were not read keep their last values.

        ``time_s``: when this cycle's values were asked for; ``last_error``: on the line.
        """
        values, fresh = self.image.values, self.image.fresh
        is_fresh = fresh.issuperset(self._fast)
        if is_fresh:
            number = values["position"]
            if self._position_bits is not None:
                number = self._unwrapped(number)
            position = number * self._position_scale
            if self._velocity_scale is not None:
                self._velocity = values["velocity"] * self._velocity_scale
            elif time_s > self._position_s:
                way, elapsed_s = position - self._position, time_s - self._position_s
                self._velocity = derived_velocity(way, elapsed_s, self._velocity, self._period_s)
            self._position, self._position_s = position, time_s
        if not fresh.isdisjoint(self.state_signals):
            if list(map(values.get, self.state_signals)) != self._state_numbers:
                self.read_state()
            self._state_s = time_s
        elif math.isnan(self._state_s):
            self._state_s = time_s
        elif not is_fresh:  # time without any feedback does not count here: the loop has its own limit for it
            self._state_s += time_s - self._filled_s
        self._filled_s = time_s
        fresh.clear()
        feedback.position = self._position
        feedback.velocity = self._velocity
        feedback.torque = values.get("torque", 0.0) * self._torque_scale
        feedback.temperature = values.get(TEMPERATURE, math.nan) * self._temperature_scale
        feedback.state, feedback.status = self.state, self._status
        feedback.is_fresh = is_fresh
        number = values.get("error", 0.0)
        feedback.error = self._why
        if number:
            error = error_text(self._description, number)
            feedback.error = f"{self._why}; {error}" if self._why else error
        feedback.missing = "" if is_fresh else last_error
        feedback.message = coded(self.sequencer.problem, codes.SEQUENCE_STUCK) if self.sequencer.problem else ""
        if self._position_s - self._state_s > _STATUS_LOSS_S:
            text = f"the drive has not reported its state for more than {_STATUS_LOSS_S:g} s: {last_error}"
            feedback.message = coded(text, codes.STATE_NOT_REPORTED)

    def read_state(self) -> DriveState:
        """Return the state that the image shows."""
        values = self.image.values
        self._state_numbers, self.state = list(map(values.get, self.state_signals)), state_of(self._description, values)
        self._why = meaning_of(self._description, values) if self.state is DriveState.FAULT else ""
        has_word = self._description.state_machine == "cia402" and self.state is not DriveState.OPERATION_ENABLED
        self._status = profile.status_words(int(values["status"])) if has_word and "status" in values else ""
        return self.state

    @property
    def acting_commands(self) -> list[str]:
        """Commands to this drive that act as soon as somebody enables it."""
        return [name for name in self._commands if name in ACTING]

    def not_zero(self, read: Callable[[str], float | None], write_zero: Callable[[str], None]) -> list[str]:
        """Set to zero what the drive still holds of these commands; see `not_zero`."""
        return not_zero(self._description, self.acting_commands, read, write_zero)

    def disable_writes(self) -> list[Mapping[str, float]]:
        """Return the values that disable the drive, in the order in which they are written."""
        return disable_writes(self._description)

    def _unwrapped(self, number: float) -> float:
        if self._position_bits is None:
            return number
        raw = int(number)
        self._counts = raw if self._counts is None else unwrap(self._counts, raw, self._position_bits)
        return float(self._counts)

    def to_read_back(self, step: Mapping[str, float]) -> list[str]:
        """Return the signals of a step that have to be read back: before the drive gets its power, never after."""
        return sorted(self.read_back & step.keys()) if self.sequencer.is_enabling else []

    def note_written(self, step: Mapping[str, float]) -> None:
        """Note that the drive accepted a step whose values are still to be read back."""
        self.written = step

    def acknowledge(self, step: Mapping[str, float]) -> None:
        """Note that the drive accepted a step, and reported the signals in `read_back` that it writes."""
        self.written = None
        differing = contradiction(self._description, step, self.image.values, self.to_read_back(step))
        self.sequencer.acknowledge(differing)

    def hold(self) -> None:
        """Set commands that do not move the axis: zero, and the position that was read last."""
        for name in self._commands:
            self.image.values[name] = 0.0
        if "position_command" in self._commands:
            position = self._unwrapped(self.image.values["position"]) * self._scales["position"]
            self.image.values["position_command"] = position / self._scales["position_command"]

    def take(self, command: Command, time_s: float) -> Mapping[str, float]:
        """Put a command into the image; return the values to write in addition, for the requested state."""
        values = self.image.values
        for name, wanted, scale in self._wanted:
            values[name] = wanted(command) / scale
        if command.request is Request.LISTEN:
            return {}
        return self.sequencer.next_write(command.request, self.state, time_s)
