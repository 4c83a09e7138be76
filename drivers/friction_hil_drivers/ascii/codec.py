"""Lines of text as exchanges: requests made from a process image, replies put into it."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from friction_hil.errors import UsageError
from friction_hil_drivers.ascii.description import AsciiDescription, covering
from friction_hil_drivers.ascii.messages import CompiledMessage, Language, reader, take_line
from friction_hil_drivers.ascii.options import AsciiOptions
from friction_hil_drivers.ascii.template import AXIS
from friction_hil_drivers.serial_line.protocol import CycleSignals, Exchange, Image, Plan, ReplyError, shown


class AsciiExchange:
    """One request, or several that set the same signals to different numbers, and the reply; see `Exchange`.

    Parameters
    ----------
    axis : str
        For people.
    language : Language
    messages : sequence of CompiledMessage
        With the same signals and the same replies; the first whose fixed numbers are those of the image is sent.
    image : Image
    addressee : str
        Who answers; the same for all axes whose replies do not tell them apart.
    """

    def __init__(
        self, axis: str, language: Language, messages: Sequence[CompiledMessage], image: Image, addressee: str
    ) -> None:
        self._axis = axis
        self._language = language
        self._messages = tuple(messages)
        self._first = self._messages[0]
        self._is_fixed = any(message.sets for message in self._messages)
        self._image = image
        self._sent = b""
        self.constant = b""
        self._known: bytes | None = None  # the last reply, and what it tells: it often comes again
        self._names: tuple[str, ...] = ()
        self._numbers: list[float] = []
        self._is_echo_due = False
        self.addressees = self.unanswered = frozenset((addressee,))
        self.writes = self._first.writes
        self.reads = self._first.reads
        parts = [f"read {' and '.join(self.reads)}"] if self.reads else []
        parts += [f"write {' and '.join(self.writes)}"] if self.writes else []
        self.what = f"{', '.join(parts)} of {axis}"
        longest = max(message.request.size for message in self._messages)
        self.request_size = language.sealed_size(longest, language.request_end)
        replies = self._first.replies
        self._readers = [(form.names, reader(form, language)) for form in replies]
        self.reply_size = self.request_size if language.has_echo else 0
        if replies:
            self.reply_size += language.sealed_size(max(form.size for form in replies), language.reply_end)
        self._words = frozenset(form.words for form in replies)
        self.tells_refusal = self.reply_size == 0 and language.has_error_replies

    def may_follow(self, before: Exchange) -> bool:
        """Whether it may be sent while ``before`` is not answered: their replies have different numbers of words."""
        return isinstance(before, AsciiExchange) and self.reply_size > 0 and self._words.isdisjoint(before._words)

    def without(self, addressees: frozenset[str]) -> Exchange | None:
        """See `Exchange`: one drive answers, or nobody knows which."""
        return None

    def encode(self) -> bytes:
        """Make the request, from the image's values where it writes.

        Raises
        ------
        ValueError
            A value is missing, not finite, or not one of those that can be written.
        """
        language = self._language
        self._is_echo_due = language.has_echo
        if self._sent and not self.writes:
            return self._sent
        values = self._image.values
        message = self._chosen(values) if self._is_fixed else self._first
        self._sent = language.seal_request(message.request.write(values))
        if not (self.writes or language.has_echo):
            self.constant = self._sent
        return self._sent

    def _chosen(self, values: Mapping[str, float]) -> CompiledMessage:
        for message in self._messages:
            if all(values.get(name) == number for name, number in message.sets.items()):
                return message
        given = ", ".join(f"{name} = {values.get(name)}" for name in self.writes)
        known = "; ".join(", ".join(f"{n} = {v:g}" for n, v in message.sets.items()) for message in self._messages)
        raise ValueError(f"{self._axis}: {given} cannot be written; what can be is {known}")

    def take(self, received: bytearray) -> bool:
        """Remove the reply from ``received`` and put what it tells into the image; whether it was complete.

        Raises
        ------
        ReplyError
            It is an error reply, or no reply to this request; nothing was put into the image.
        """
        if self._is_echo_due and not self._take_echo(received):
            return False
        if not self._first.replies and not self.tells_refusal:
            return True
        known = self._known
        if known is not None and received.startswith(known):
            del received[: len(known)]
        else:
            found = None
            for names, read in self._readers:
                try:
                    found = read(received)
                except ValueError:  # told below
                    break
                if found is not None:
                    self._numbers, size = found
                    self._names, self._known = names, bytes(received[:size])
                    del received[:size]
                    break
            if found is None and not self._read_line(received):
                return False
        self._image.put(self._names, self._numbers)
        return True

    def _read_line(self, received: bytearray) -> bool:
        """Take whatever line has come off; whether it was complete.

        Raises
        ------
        ReplyError
            As `take`.
        """
        language = self._language
        try:
            line = take_line(received, language.reply_end)
        except ValueError as error:
            raise ReplyError(str(error)) from error
        if line is None:
            return False
        whole = line + language.reply_end
        try:
            for names, read in self._readers:
                if (found := read(whole)) is not None:
                    self._names, self._numbers, self._known = names, found[0], whole
                    return True
            raise self._error(line)
        except ValueError as error:
            raise ReplyError(f"{self._story(line)}: {error}") from error

    def _take_echo(self, received: bytearray) -> bool:
        # the other half of a line end like \r\n, of which the drive's reply before has left one
        while received and received[0] in b"\r\n\0":
            del received[0]
        if not received.startswith(self._sent):
            if self._sent.startswith(received):
                return False
            raise ReplyError(f"{shown(received)} came in place of the echo of {shown(self._sent)}")
        del received[: len(self._sent)]
        self._is_echo_due = False
        return True

    def _error(self, line: bytes) -> ReplyError:
        """What is wrong with a line that is none of the replies.

        Raises
        ------
        ValueError
            Its checksum.
        """
        language = self._language
        meaning = language.meaning(line if language.checker is None else language.checker.remove(line))
        if meaning is None:
            right = " or ".join(form.template for form in self._first.replies) or "none"
            return ReplyError(f"{self._story(line)}; right would be {right}")
        if language.is_answering_all:
            return ReplyError(f"{self._story(line)}: {meaning}", is_complete=True)
        # an error of a set-point to which nothing is replied comes unasked: the reply proper then follows
        before = ", or to what was sent before" if self._first.replies else ""
        return ReplyError(f"{self._story(line)}{before}: {meaning}", is_unsolicited=True)

    def _story(self, line: bytes) -> str:
        return f"{shown(line)} came in reply to {shown(self._sent)}"


@dataclass(frozen=True, slots=True)
class _Axis:
    language: Language
    image: Image
    name: str
    addressee: str

    def exchange(self, messages: Sequence[CompiledMessage]) -> AsciiExchange:
        return AsciiExchange(self.name, self.language, messages, self.image, self.addressee)

    def writing(self, names: Iterable[str]) -> list[CompiledMessage]:
        """Messages that write just these."""
        wanted = set(names)
        return [message for message in self.language.messages if set(message.writes) == wanted]

    def reading(self, names: Iterable[str], along: Iterable[str] = ()) -> list[CompiledMessage]:
        """Messages that read all of these without writing, as few as there can be, best with some others along.

        Raises
        ------
        UsageError
            None of them reads one of these.
        """
        rest, others, chosen = set(names), set(along), []
        plain = [message for message in self.language.messages if message.reads and not message.writes]
        while rest:
            best = max(plain, key=lambda m: (len(rest & set(m.reads)), len(others & set(m.reads))), default=None)
            if best is None or rest.isdisjoint(best.reads):
                missing = " and ".join(sorted(rest))
                raise UsageError(f"{self.name}: no message of its description reads {missing} without writing")
            chosen.append(best)
            rest.difference_update(best.reads)
        return chosen


class AsciiLine:
    """Lines of text as they are spoken on one serial line; see `LineProtocol`.

    Parameters
    ----------
    descriptions : mapping of str to AsciiDescription
        By axis, all on this line.
    options : mapping of str to AsciiOptions
    images : mapping of str to Image
    """

    numbers_replies = False
    silence_chars = 0.0  # line ends part the lines

    def __init__(
        self,
        descriptions: Mapping[str, AsciiDescription],
        options: Mapping[str, AsciiOptions],
        images: Mapping[str, Image],
    ) -> None:
        is_divided = next(iter(options.values())).line.is_rs485  # both sides on one pair: they would talk at once
        self.ahead_chars = 0 if is_divided else min(each.ahead_chars for each in descriptions.values())
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
        """Put a cycle together from as few exchanges as there can be, for the axes by name.

        Raises
        ------
        UsageError
            No message reads or writes what is wanted.
        """
        poll: list[Exchange] = []
        turns: list[Exchange] = []
        push: list[Exchange] = []
        for name, want in wanted.items():
            axis, fast, slow = self._axes[name], set(want.fast), set(want.slow)
            for messages in self._commanding(axis, want.commands):
                # what reads feedback in the same breath has to be asked before the computation
                (push if fast.isdisjoint(messages[0].reads) else poll).append(axis.exchange(messages))
                fast.difference_update(messages[0].reads)
                slow.difference_update(messages[0].reads)
            often = axis.reading(fast, slow)
            slow.difference_update(*(message.reads for message in often))
            poll += [axis.exchange((message,)) for message in often]
            turns += [axis.exchange((message,)) for message in axis.reading(slow)]
        return Plan(tuple(poll), tuple(turns), tuple(push))

    def _commanding(self, axis: _Axis, commands: tuple[str, ...]) -> list[list[CompiledMessage]]:
        """Messages that write the commands together, each with its alternatives."""
        ways = covering(commands, (message.writes for message in axis.language.messages))
        if ways is None:
            raise UsageError(f"{axis.name}: no messages of its description write just {', '.join(commands)}")
        return [axis.writing(way) for way in ways]

    def read(self, axis: str, names: Sequence[str]) -> AsciiExchange:
        """Exchange that reads some signals of an axis that one message has.

        Raises
        ------
        UsageError
            None has them.
        """
        chosen = self._axes[axis].reading(names)
        if len(chosen) != 1:
            raise UsageError(f"{axis}: no message of its description reads {' and '.join(names)} at once")
        return self._axes[axis].exchange(chosen)

    def write(self, axis: str, names: Sequence[str]) -> AsciiExchange:
        """Exchange that writes some signals of an axis, those and no others, by one message.

        Raises
        ------
        UsageError
            None writes just these.
        """
        messages = self._axes[axis].writing(names)
        if not messages:
            raise UsageError(f"{axis}: no message of its description writes just {' and '.join(names)}")
        return self._axes[axis].exchange(messages)
