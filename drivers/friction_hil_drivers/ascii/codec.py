"""Exchanges of lines of text: requests made from a process image, and replies stored in it."""

from collections.abc import Mapping, Sequence

from friction_hil_drivers.ascii.messages import CompiledMessage, Language, reader, take_line
from friction_hil_drivers.serial_line.protocol import Exchange, Image, ReplyError, shown


class AsciiExchange:
    """One request, or several that set the same signals to different numbers, and the reply; see `Exchange`.

    The first of ``messages`` whose fixed numbers equal those in the image is sent; all have the same signals and the
    same replies. ``addressee``: drive that answers; the same for all axes if a reply does not show which of them it is
    from.
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
        self._known: bytes | None = (
            None  # the last reply; its numbers are kept because the same reply often comes again
        )
        self._names: tuple[str, ...] = ()
        self._numbers: list[float] = []
        self._is_echo_due = False
        self.addressees = self.unanswered = frozenset((addressee,))
        self.writes = self._first.writes
        self.reads = self._first.reads
        parts = [f"read {' and '.join(self.reads)}"] if self.reads else []
        parts += [f"write {' and '.join(self.writes)}"] if self.writes else []
        self.label = f"{', '.join(parts)} of {axis}"
        longest = max(message.request.size for message in self._messages)
        self.request_size = language.sealed_size(longest, language.request_end)
        replies = self._first.replies
        self._readers = [(form.names, reader(form, language)) for form in replies]
        self.reply_size = self.request_size if language.has_echo else 0
        if replies:
            self.reply_size += language.sealed_size(max(form.size for form in replies), language.reply_end)
        self._words = frozenset(form.words for form in replies)
        self.reports_refusal = self.reply_size == 0 and language.has_error_replies
        self.is_acknowledged = bool(replies)

    def may_follow(self, before: Exchange) -> bool:
        """Return True if the replies to this and to ``before`` differ in their number of words; see `Exchange`."""
        return isinstance(before, AsciiExchange) and self.reply_size > 0 and self._words.isdisjoint(before._words)

    def without(self, addressees: frozenset[str]) -> Exchange | None:
        """Return None: one drive answers, or it is unknown which; see `Exchange`."""
        return None

    def encode(self) -> bytes:
        """Return the request with the values of the image.

        Raises `ValueError`: a value is missing, not finite, or not one that a message can write.
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
        raise ValueError(f"{self._axis}: {given} cannot be written; the messages write {known}")

    def take(self, received: bytearray) -> bool:
        """Remove the reply from ``received`` and store it in the image; return True if it was complete.

        Raises `ReplyError`: the line is an error reply, or no reply to this request; nothing was stored in the image.
        """
        if self._is_echo_due and not self._take_echo(received):
            return False
        if not self._first.replies and not self.reports_refusal:
            return True
        known = self._known
        if known is not None and received.startswith(known):
            del received[: len(known)]
        else:
            found = None
            for names, read in self._readers:
                try:
                    found = read(received)
                except ValueError:  # `_read_line` reports it
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
        """Remove the next line and read it; return True if it was complete. Raises `ReplyError`: see `take`."""
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
            raise ReplyError(f"{self._described(line)}: {error}") from error

    def _take_echo(self, received: bytearray) -> bool:
        # a drive may end lines by more characters than described; the rest of the last reply's end comes first
        while received and received[0] in b"\r\n\0":
            del received[0]
        if not received.startswith(self._sent):
            if self._sent.startswith(received):
                return False
            raise ReplyError(f"{shown(received)} came instead of the echo of {shown(self._sent)}")
        del received[: len(self._sent)]
        self._is_echo_due = False
        return True

    def _error(self, line: bytes) -> ReplyError:
        """Return the error for a line that is none of the expected replies.

        Raises `ValueError`: the line has no checksum, or a wrong one.
        """
        language = self._language
        meaning = language.meaning(line if language.checker is None else language.checker.remove(line))
        if meaning is None:
            right = " or ".join(form.template for form in self._first.replies) or "none"
            return ReplyError(f"{self._described(line)}; expected: {right}")
        if language.is_answering_all:
            return ReplyError(f"{self._described(line)}: {meaning}", is_complete=True)
        # the error may belong to an earlier set-point without a reply: the reply to this request then still follows
        before = ", or to an earlier request" if self._first.replies else ""
        return ReplyError(f"{self._described(line)}{before}: {meaning}", is_unsolicited=True)

    def _described(self, line: bytes) -> str:
        return f"{shown(line)} came in reply to {shown(self._sent)}"
