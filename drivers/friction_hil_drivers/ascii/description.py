"""Description of a drive that exchanges lines of text: its signals and its messages."""

import re
from collections.abc import Iterable, Iterator, Mapping
from typing import Literal

from pydantic import Field, field_validator

from friction_hil.checked_yaml.messages import Mistake
from friction_hil.checked_yaml.text import FieldPath
from friction_hil.errors import choices
from friction_hil_drivers.ascii.checksum import Checksum
from friction_hil_drivers.ascii.signals import AsciiSignal
from friction_hil_drivers.ascii.template import FLOAT, NumberField, fields, parse
from friction_hil_drivers.serial_line.description import Description, Finite, Part, Signal
from friction_hil_drivers.serial_line.protocol import FAST, SLOW, TEMPERATURE

LineEnd = Literal["\n", "\r", "\r\n"]
_REPEATED_GROUP = re.compile(r"\)[*+{]")


class Message(Part):
    """Request and its reply. The fields of the request are written, the fields of the reply are read."""

    request: str = Field(description="template, e.g. v {axis} {velocity_command:float}")
    reply: str | tuple[str, ...] | None = Field(
        None,
        description="template, or a list of possible ones; empty: no reply comes; `acknowledge` when not given",
    )
    sets: dict[str, Finite] = Field(
        {}, description="signals that the request sets to a fixed number: writing that number sends the request"
    )
    feeds_watchdog: bool = Field(False, description="the request resets the drive's watchdog")

    @field_validator("request")
    @classmethod
    def _request_is_template(cls, request: str) -> str:
        parse(request)
        if not request.strip():
            raise ValueError("is empty")
        return request

    @field_validator("reply")
    @classmethod
    def _replies_are_templates(cls, reply: str | tuple[str, ...] | None) -> str | tuple[str, ...] | None:
        forms = (reply,) if isinstance(reply, str) else reply or ()
        found = [sorted(field.name for field in fields(parse(form))) for form in forms]
        if any(names != found[0] for names in found):
            raise ValueError("all templates of the reply must have the same fields")
        return reply

    @property
    def forms(self) -> tuple[str, ...] | None:
        """Templates of the reply; None if the acknowledgement of the description applies."""
        return (self.reply,) if isinstance(self.reply, str) else self.reply

    @property
    def writes(self) -> tuple[str, ...]:
        """Signals that the request writes."""
        return *(field.name for field in fields(parse(self.request))), *self.sets

    @property
    def reads(self) -> tuple[str, ...]:
        """Signals that the reply contains."""
        return tuple(field.name for field in fields(parse(self.forms[0]))) if self.forms else ()

    @property
    def number_fields(self) -> Iterator[NumberField]:
        """All fields of request and replies."""
        for template in (self.request, *(self.forms or ())):
            yield from fields(parse(template))


class AsciiDescription(Description):
    """Drive that exchanges lines of text."""

    protocol: Literal["ascii"]
    signals: dict[str, AsciiSignal]
    messages: dict[str, Message] = Field(min_length=1)
    axis: str = Field("", description="text for {axis} if the configuration gives none")
    request_end: LineEnd = Field("\n", description="end of a request")
    reply_end: LineEnd = Field("\r\n", description="end of a reply")
    echo: bool = Field(False, description="the drive repeats each request before it replies")
    checksum: Checksum | None = Field(None, description="checksum at the end of each line; none when not given")
    acknowledge: str = Field("", description="reply to messages that have no key reply; empty: no reply comes")
    error_replies: dict[str, str] = Field(
        {}, description="replies that report an error: regular expression of the whole line, and its meaning"
    )
    ahead_chars: int = Field(
        0,
        ge=0,
        le=4096,
        description="characters of requests that the drive buffers before it has answered the first one, on a "
        "full-duplex line: requests whose replies differ in their number of words are then sent together; 0: singly",
    )
    refusal: str = Field("", description="reply of the simulated drive to a request that it does not know; empty: none")

    @field_validator("acknowledge", "refusal")
    @classmethod
    def _is_text(cls, text: str) -> str:
        if fields(parse(text)):
            raise ValueError("must not have fields")
        return text

    @field_validator("error_replies")
    @classmethod
    def _are_expressions(cls, replies: dict[str, str]) -> dict[str, str]:
        for expression in replies:
            try:
                re.compile(expression.encode("ascii"))
            except (re.error, UnicodeEncodeError) as error:
                raise ValueError(f"{expression!r} is no regular expression of ASCII text: {error}") from error
            if _REPEATED_GROUP.search(expression):
                raise ValueError(f"{expression!r} repeats a group: matching it could take for ever")
        return replies

    def axis_name(self, given: str | None) -> str:
        """Return the text that replaces ``{axis}``."""
        return self.axis if given is None else given

    def units(self) -> dict[str, Signal]:
        """Return the signals by name."""
        return {**self.signals}

    def can_be_read(self, signal: str) -> bool:
        """Return True if a message reads the signal and writes nothing."""
        return any(signal in message.reads for message in self.messages.values() if not message.writes)

    def replies(self, message: Message) -> tuple[str, ...]:
        """Return the templates of the replies to a message; none if no reply comes."""
        forms = (self.acknowledge,) if message.forms is None else message.forms
        return tuple(form for form in forms if form)

    @property
    def all_replies(self) -> tuple[str, ...]:
        """Templates of all replies."""
        return tuple(form for message in self.messages.values() for form in self.replies(message))

    @property
    def is_answering_all(self) -> bool:
        """True if every request gets a reply, so that no error can be unsolicited."""
        return all(self.replies(message) for message in self.messages.values())

    def _mistakes(self) -> Iterator[Mistake]:
        yield from super()._mistakes()
        yield from self._mistakes_in_lines()
        yield from self._mistakes_in_fields()
        yield from self._mistakes_in_reach()

    def _mistakes_in_lines(self) -> Iterator[Mistake]:
        if self.echo and self.ahead_chars:
            yield ("ahead_chars",), "with an echo, requests cannot be sent ahead (ahead_chars)"

    def _mistakes_in_fields(self) -> Iterator[Mistake]:
        reported: set[str] = set()
        for key, message in self.messages.items():
            for name in message.sets:
                if name not in self.signals:
                    yield ("messages", key), f"sets the signal {name!r}; {choices(name, self.signals)}"
            for field in message.number_fields:
                signal = self.signals.get(field.name)
                if signal is None:
                    yield ("messages", key), f"has the signal {field.name!r}; {choices(field.name, self.signals)}"
                elif (field.type == FLOAT) == (signal.bits is not None) and field.name not in reported:
                    reported.add(field.name)
                    is_float = field.type == FLOAT
                    advice = "is a float: it has no bits" if is_float else f"is of type {field.type}: give its bits"
                    yield ("signals", field.name), f"{field.name} in messages.{key} {advice}"
        writers: dict[frozenset[str], Message] = {}
        for key, message in self.messages.items():
            other = writers.setdefault(frozenset(message.writes), message)
            if message.writes and self.replies(other) != self.replies(message):
                yield ("messages", key), "writes the same signals as another message, but has another reply"

    def _mistakes_in_reach(self) -> Iterator[Mistake]:
        used = {name for message in self.messages.values() for name in (*message.writes, *message.reads)}
        for name in self.signals:
            if name not in used:
                yield ("signals", name), f"no message has the signal {name}"
        plain = [message for message in self.messages.values() if not message.writes]
        readable = {name for message in plain for name in message.reads}
        heard = {*FAST, *SLOW, TEMPERATURE, *(rule.signal for rule in self.states)} & used
        for name in sorted(heard - readable):
            yield ("signals", name), f"no message reads {name} without writing something"
        for key, step in self._steps():
            if not any(set(message.writes) == set(step) for message in self.messages.values()):
                yield key, f"writes {' and '.join(step)}, but no message writes exactly that"
            elif not self._can_take(step):
                yield key, f"writes {step}, but messages can only set other numbers"
        for mode, part in self.modes.items():
            if covering(part.commands, (message.writes for message in self.messages.values())) is None:
                yield ("modes", mode), f"no messages write just {', '.join(part.commands)}"

    def _steps(self) -> Iterator[tuple[FieldPath, Mapping[str, float | None]]]:
        """Yield the field path and the values of each write that needs a message; a value of None is any number."""
        yield from ((path, step.write) for path, step in self.steps())
        if self.watchdog is not None:
            yield ("watchdog",), {self.watchdog.signal: None}
        if self.state_machine == "cia402":
            yield ("state_machine",), {"control": None}

    def _can_take(self, step: Mapping[str, float | None]) -> bool:
        return any(
            set(message.writes) == set(step) and all(step[name] == number for name, number in message.sets.items())
            for message in self.messages.values()
        )


def covering(wanted: Iterable[str], groups: Iterable[tuple[str, ...]]) -> list[tuple[str, ...]] | None:
    """Choose disjoint groups that cover ``wanted`` exactly, the largest first; return None if no choice does."""
    rest, chosen = set(wanted), []
    for group in sorted(groups, key=len, reverse=True):
        if group and rest.issuperset(group):
            chosen.append(group)
            rest.difference_update(group)
    return None if rest else chosen
