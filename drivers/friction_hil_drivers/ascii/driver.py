"""Driver for drives that exchange lines of text: exchanges of a cycle on one line, and the drive port."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, ClassVar

from friction_hil.errors import UsageError
from friction_hil_drivers.ascii import DESCRIPTIONS
from friction_hil_drivers.ascii.codec import AsciiExchange
from friction_hil_drivers.ascii.description import AsciiDescription, covering
from friction_hil_drivers.ascii.messages import CompiledMessage, Language
from friction_hil_drivers.ascii.options import AsciiOptions
from friction_hil_drivers.ascii.template import AXIS
from friction_hil_drivers.serial_line.drives import SerialDrives
from friction_hil_drivers.serial_line.protocol import CycleSignals, Exchange, Image, Plan, shown


@dataclass(frozen=True, slots=True)
class _Axis:
    language: Language
    image: Image
    name: str
    addressee: str

    def exchange(self, messages: Sequence[CompiledMessage]) -> AsciiExchange:
        return AsciiExchange(self.name, self.language, messages, self.image, self.addressee)

    def writing(self, names: Iterable[str]) -> list[CompiledMessage]:
        """Return the messages that write exactly these signals."""
        wanted = set(names)
        return [message for message in self.language.messages if set(message.writes) == wanted]

    def reading(self, names: Iterable[str], optional: Iterable[str] = ()) -> list[CompiledMessage]:
        """Return the fewest messages that read the signals ``names`` without writing.

        Of messages that read equally many of them, the one that also reads most of ``optional`` is taken. Raises
        `UsageError`: no message reads one of ``names`` without writing.
        """
        rest, others, chosen = set(names), set(optional), []
        plain = [message for message in self.language.messages if message.reads and not message.writes]
        while rest:
            best = max(plain, key=lambda m: (len(rest & set(m.reads)), len(others & set(m.reads))), default=None)
            if best is None or rest.isdisjoint(best.reads):
                missing = " and ".join(sorted(rest))
                raise UsageError(f"{self.name}: no message of its description reads {missing} without writing")
            chosen.append(best)
            rest.difference_update(best.reads)
        return chosen


def _reply_form(description: AsciiDescription) -> str:
    """Return what the lines of a drive end in, in words."""
    checksum = (
        "without a checksum" if description.checksum is None else f"with a checksum ({description.checksum.kind})"
    )
    return f"by the description a reply ends in {shown(description.reply_end.encode())}, {checksum}"


class AsciiLine:
    """Exchanges with the axes on one line, in lines of text; see `LineProtocol`."""

    numbers_replies = False
    show = staticmethod(shown)
    silence_chars = 0.0  # lines are separated by line ends

    def __init__(
        self,
        descriptions: Mapping[str, AsciiDescription],
        options: Mapping[str, AsciiOptions],
        images: Mapping[str, Image],
    ) -> None:
        is_half_duplex = next(iter(options.values())).line.is_rs485  # a request sent ahead would collide with a reply
        self.ahead_chars = 0 if is_half_duplex else min(each.ahead_chars for each in descriptions.values())
        self.reply_form = " or ".join(dict.fromkeys(map(_reply_form, descriptions.values())))
        are_named = all(f"{{{AXIS}}}" in form for each in descriptions.values() for form in each.all_replies)
        self.names_drives = are_named or len(descriptions) == 1
        self._axes = {
            name: _Axis(
                Language(description, description.axis_name(options[name].axis)),
                images[name],
                name,
                name if are_named else "any of them",
            )
            for name, description in descriptions.items()
        }

    def plan(self, wanted: Mapping[str, CycleSignals]) -> Plan:
        """Plan a cycle with as few exchanges as possible, for the axes by name.

        Raises `UsageError`: no message reads or writes one of the wanted signals.
        """
        poll: list[Exchange] = []
        background: list[Exchange] = []
        push: list[Exchange] = []
        for name, want in wanted.items():
            axis, fast, slow = self._axes[name], set(want.fast), set(want.slow)
            for messages in self._commanding(axis, want.commands):
                # a command whose reply contains feedback belongs to the poll, which precedes the computation
                (push if fast.isdisjoint(messages[0].reads) else poll).append(axis.exchange(messages))
                fast.difference_update(messages[0].reads)
                slow.difference_update(messages[0].reads)
            reads = axis.reading(fast, slow)
            slow.difference_update(*(message.reads for message in reads))
            poll += [axis.exchange((message,)) for message in reads]
            background += [axis.exchange((message,)) for message in axis.reading(slow)]
        return Plan(tuple(poll), tuple(background), tuple(push))

    def _commanding(self, axis: _Axis, commands: tuple[str, ...]) -> list[list[CompiledMessage]]:
        """Return the messages that write the commands together, each with its alternatives."""
        groups = covering(commands, (message.writes for message in axis.language.messages))
        if groups is None:
            raise UsageError(f"{axis.name}: no messages of its description write just {', '.join(commands)}")
        return [axis.writing(group) for group in groups]

    def read(self, axis: str, names: Sequence[str]) -> AsciiExchange:
        """Return the exchange that reads some signals of an axis, all by one message.

        Raises `UsageError`: no message reads all of them.
        """
        chosen = self._axes[axis].reading(names)
        if len(chosen) != 1:
            raise UsageError(f"{axis}: no message of its description reads {' and '.join(names)} together")
        return self._axes[axis].exchange(chosen)

    def write(self, axis: str, names: Sequence[str]) -> AsciiExchange:
        """Return the exchange that writes exactly these signals of an axis, by one message.

        Raises `UsageError`: no message writes exactly these signals.
        """
        messages = self._axes[axis].writing(names)
        if not messages:
            raise UsageError(f"{axis}: no message of its description writes just {' and '.join(names)}")
        return self._axes[axis].exchange(messages)

    def reboot(self, axis: str) -> None:
        """See `LineProtocol`: there is no request for it."""


class AsciiDrives(SerialDrives):
    """Drives that exchange lines of text."""

    Options = AsciiOptions
    description_type = AsciiDescription
    descriptions = DESCRIPTIONS
    protocol = AsciiLine
    address_key = "axis"
    simulated: ClassVar[Mapping[str, Any]] = {
        "description": "odrive",
        "counts_per_unit": 166886.05,
        "torque_constant": 0.06,
        "baud": 921600,
        "period_s": 4e-3,
    }
