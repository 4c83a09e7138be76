"""Time that requests and a whole cycle take on a serial line. Pure arithmetic."""

from collections.abc import Iterable

from friction_hil.errors import UsageError
from friction_hil_drivers.serial_line.options import LineOptions
from friction_hil_drivers.serial_line.protocol import Exchange, Plan


def character_s(line: LineOptions) -> float:
    """Return the time of one character, s; 0 on a TCP connection, where the baud rate has no effect."""
    return 0.0 if line.is_tcp else line.bits_per_character / line.baud


def wire_s(exchanges: Iterable[Exchange], line: LineOptions, silence_chars: float, ahead_chars: int = 0) -> float:
    """Compute the least time from the beginning of some exchanges to that of the next one after them, s.

    One exchange takes request, silence, turn-around, reply and silence. A request that is sent ahead, with at most
    ``ahead_chars`` before the first of them is answered (0: one request at a time), overlaps with the replies to those
    before it. Commands without a reply have to come first: they are sent at the end of a cycle.
    """
    character = character_s(line)
    silence_s = silence_chars * character
    sent_s = over_s = 0.0  # end of the last request, and of the last exchange
    unread = 0  # characters sent since the last reply
    together: list[Exchange] = []
    for exchange in exchanges:
        is_ahead = bool(together and exchange.reply_size) and unread + exchange.request_size <= ahead_chars
        if not (is_ahead and all(exchange.may_follow(before) for before in together)):
            sent_s = over_s
            if together:
                unread, together = 0, []
        unread += exchange.request_size
        sent_s += exchange.request_size * character + silence_s
        if exchange.reply_size:
            together.append(exchange)
            over_s = max(over_s, sent_s + line.turnaround_s) + exchange.reply_size * character + silence_s
        else:
            over_s = sent_s
    return over_s


def check_rate(
    plan: Plan, step: Exchange | None, line: LineOptions, silence_chars: float, ahead_chars: int, period_s: float
) -> str:
    """Compare the time of a cycle on the wire with the period; return the result as text.

    A cycle consists of the push, the longest background read, which ``step``, the longest of a sequence, may replace,
    and the poll. Raises `UsageError`: it is longer than the period; the message has the arithmetic.
    """

    def time_s(*exchanges: Exchange) -> float:
        return wire_s(exchanges, line, silence_chars, ahead_chars)

    fixed = (*plan.push, *plan.poll)
    parts = max(
        [(*plan.push, each, *plan.poll) for each in plan.background], key=lambda some: time_s(*some), default=fixed
    )
    needed = time_s(*parts)
    if needed <= period_s:
        text = f"a cycle takes {needed * 1e3:.3g} ms of {period_s * 1e3:g} ms on {line.port}"
        with_step = time_s(*fixed) if step is None else time_s(step) + time_s(*fixed)
        if with_step > period_s:
            text += f", {with_step * 1e3:.3g} ms with a step to another state: each such step loses a cycle"
        return text
    listed = "; ".join(
        f"{each.label}: {each.request_size} + {each.reply_size} characters, {time_s(each) * 1e3:.3g} ms"
        for each in parts
    )
    if needed < sum(map(time_s, parts)) - character_s(line):
        listed += ", less the time for which requests and replies overlap"
    raise UsageError(
        f"a period of {period_s * 1e3:g} ms is too short for {line.port} at {line.baud} baud: a cycle takes "
        f"{needed * 1e3:.3g} ms, so {1.0 / needed:.0f} Hz at best. A character has {line.bits_per_character} bits "
        f"({character_s(line) * 1e6:.4g} µs), {silence_chars:g} of them are silence after each frame: {listed}. "
        "Take a longer period or a higher baud rate"
    )
