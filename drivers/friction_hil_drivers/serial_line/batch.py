"""Requests of a cycle that go out together, and what is known of them before. No line, no clock."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Self

from friction_hil_drivers.serial_line.protocol import Exchange


@dataclass(frozen=True, slots=True)
class Batch:
    """Requests that go out together; see `Conversation.say_at_once`."""

    exchanges: tuple[Exchange, ...]
    answered: tuple[Exchange, ...]  # of them
    refusable: tuple[Exchange, ...]  # of them: not answered, but for a refusal
    chars: int
    ahead_chars: int  # that may be sent before the first of them is answered; 0: nothing follows one that is
    wire_ns: int
    are_joint: bool  # nothing forbids that they go together
    may_follow: frozenset[Exchange]  # what may still be awaited when they go out

    @classmethod
    def of(
        cls, exchanges: Sequence[Exchange], wire_s: float, before: Iterable[Exchange] = (), *, keeps_silence: bool
    ) -> Self:
        """Work out how some exchanges go out together.

        Parameters
        ----------
        exchanges : sequence of Exchange
        wire_s : float
            What they take.
        before : iterable of Exchange
            What they may find awaited.
        keeps_silence : bool
            Silence has to pass between frames on that line.
        """
        answered: list[Exchange] = []
        size = ahead_chars = 0
        are_joint = len(exchanges) < 2 or not keeps_silence
        for exchange in exchanges:
            size += exchange.request_size
            if answered:
                ahead_chars = size
                are_joint = are_joint and all(map(exchange.may_follow, answered))
            if exchange.reply_size:
                answered.append(exchange)
        return cls(
            exchanges=tuple(exchanges),
            answered=tuple(answered),
            refusable=tuple(exchange for exchange in exchanges if exchange.tells_refusal),
            chars=size,
            ahead_chars=ahead_chars,
            wire_ns=round(1e9 * wire_s),
            are_joint=are_joint,
            may_follow=frozenset(
                each for each in before if not keeps_silence and all(late.may_follow(each) for late in exchanges)
            ),
        )
