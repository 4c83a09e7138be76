"""Simulated drives that answer lines of text."""

from collections.abc import Mapping
from typing import TYPE_CHECKING

from friction_hil.drive.encoder import unwrap
from friction_hil_drivers.ascii import DESCRIPTIONS
from friction_hil_drivers.ascii.description import AsciiDescription
from friction_hil_drivers.ascii.driver import AsciiLine
from friction_hil_drivers.ascii.messages import CompiledMessage, Language, take_line
from friction_hil_drivers.ascii.options import AsciiOptions
from friction_hil_drivers.serial_line.simulated.drive import RefusedError
from friction_hil_drivers.serial_line.simulated.drives import SimulatedSerialDrives

if TYPE_CHECKING:
    from friction_hil_drivers.serial_line.simulated.drive import SimulatedDrive

_NO_REPLY = b""


class _Station:
    """One simulated drive on the line."""

    def __init__(self, drive: "SimulatedDrive", description: AsciiDescription, axis: str) -> None:
        self.language = Language(description, axis)
        self._any_axis = Language(description, None)
        self._drive = drive
        self._position_bits = description.signals["position"].bits
        self._refusal = description.refusal.encode()

    def is_for_another_axis(self, line: bytes) -> bool:
        """Return True if the request is one of the description's messages, with any name of an axis."""
        return any(_numbers(message, line) is not None for message in self._any_axis.messages)

    def answer(self, line: bytes) -> bytes | None:
        """Carry out a request and return the reply; None if it is no request to this drive."""
        for message in self.language.messages:
            numbers = _numbers(message, line)
            if numbers is not None:
                return self._carry_out(message, numbers)
        return None

    def refusal(self) -> bytes:
        """Return the reply to a request that the drive does not know."""
        return self.reply(self._refusal) if self._refusal else _NO_REPLY

    def reply(self, text: bytes) -> bytes:
        """Return a reply with checksum and line end."""
        return self.language.seal_reply(text)

    def _carry_out(self, message: CompiledMessage, numbers: Mapping[str, float]) -> bytes:
        if "position" in message.reads:
            self._drive.sample()
        if message.feeds_watchdog:
            self._drive.fed()
        try:
            for name, number in (*numbers.items(), *message.sets.items()):
                self._drive.write(name, self._unwrapped(number) if name == "position_command" else number)
        except RefusedError:
            return self.refusal()
        if not message.replies:
            return _NO_REPLY
        return self.reply(message.replies[0].write({name: self._drive.read(name) for name in message.reads}))

    def _unwrapped(self, number: float) -> float:
        if self._position_bits is None:
            return number
        return float(unwrap(round(self._drive.read("position")), int(number), self._position_bits))


def _numbers(message: CompiledMessage, line: bytes) -> Mapping[str, float] | None:
    """Return the numbers in a request by signal; None if the line is another request."""
    try:
        numbers = message.request.read(line)
    except ValueError:
        return None
    return None if numbers is None else dict(zip(message.request.names, numbers, strict=True))


class AsciiResponder:
    """Answers requests for the simulated drives on one line; see `Responder` of `serial_line.simulated.server`.

    Line ends, checksum and echo are those of the first description.
    """

    def __init__(
        self,
        drives: "Mapping[str, SimulatedDrive]",
        descriptions: Mapping[str, AsciiDescription],
        options: Mapping[str, AsciiOptions],
    ) -> None:
        self._stations = [
            _Station(drives[axis], descriptions[axis], descriptions[axis].axis_name(options[axis].axis))
            for axis in drives
        ]
        self._language = self._stations[0].language
        self.request_end = self._language.request_end
        self._is_too_long = False  # the rest of a line that is too long is still to come

    def take(self, received: bytearray) -> bytes | None:
        """Remove one whole request and return the reply; None if the request is not complete.

        The reply is empty if none is due: the request was a set-point, damaged, or for none of these drives.
        """
        language = self._language
        try:
            line = take_line(received, language.request_end)
        except ValueError:
            self._is_too_long = True
            return None
        if line is None:
            return None
        if self._is_too_long:
            self._is_too_long = False
            return _NO_REPLY
        echo = line + language.request_end if language.has_echo else _NO_REPLY
        if language.checker is not None:
            try:
                line = language.checker.remove(line)
            except ValueError:
                return echo
        return echo + self._answer(line)

    def _answer(self, line: bytes) -> bytes:
        # a request that names no axis is for all drives
        replies = [reply for station in self._stations if (reply := station.answer(line)) is not None]
        if replies:
            return replies[0]
        if any(station.is_for_another_axis(line) for station in self._stations):
            return _NO_REPLY
        return self._stations[0].refusal()

    def forget(self) -> None:
        """Treat the next bytes as the beginning of a line."""
        self._is_too_long = False


class SimulatedAsciiDrives(SimulatedSerialDrives):
    """Simulated drives that exchange lines of text."""

    description_type = AsciiDescription
    descriptions = DESCRIPTIONS
    protocol = AsciiLine
    responder = AsciiResponder
