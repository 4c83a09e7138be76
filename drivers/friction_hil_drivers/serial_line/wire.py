"""How long a cycle takes on a serial line. Pure arithmetic."""

from friction_hil.errors import UsageError
from friction_hil_drivers.serial_line.options import LineOptions
from friction_hil_drivers.serial_line.protocol import Exchange, Plan


def character_s(line: LineOptions) -> float:
    """Time of one character, s."""
    return line.bits_per_character / line.baud


def exchange_s(exchange: Exchange, line: LineOptions, silence_chars: float) -> float:
    """Least time from one request to the next, s: request, silence, turn-around, reply, silence."""
    frames = 1 if exchange.reply_size == 0 else 2
    characters = exchange.request_size + exchange.reply_size + frames * silence_chars
    return characters * character_s(line) + (line.turnaround_s if frames == 2 else 0.0)


def check_rate(plan: Plan, step: Exchange | None, line: LineOptions, silence_chars: float, period_s: float) -> str:
    """Compare what a cycle takes on the wire with the period; say it.

    Parameters
    ----------
    plan : Plan
        Of which a cycle has the poll, the longest of the turns, and the push.
    step : Exchange, optional
        Longest step of a sequence, which takes the place of a turn.
    line : LineOptions
    silence_chars : float
    period_s : float

    Raises
    ------
    UsageError
        A cycle is longer than the period; the message has the arithmetic.
    """

    def time_s(exchange: Exchange) -> float:
        return exchange_s(exchange, line, silence_chars)

    parts = [*plan.poll, *sorted(plan.turns, key=time_s)[-1:], *plan.push]
    needed = sum(map(time_s, parts))
    if needed <= period_s:
        text = f"a cycle takes {needed * 1e3:.3g} ms of {period_s * 1e3:g} ms on {line.port}"
        with_step = sum(map(time_s, (*plan.poll, *plan.push))) + (0.0 if step is None else time_s(step))
        if with_step > period_s:
            text += f", {with_step * 1e3:.3g} ms with a step on the way to another state: each such step loses a cycle"
        return text
    listed = "; ".join(
        f"{each.what}: {each.request_size} + {each.reply_size} characters, {time_s(each) * 1e3:.3g} ms"
        for each in parts
    )
    raise UsageError(
        f"a period of {period_s * 1e3:g} ms is too short for {line.port} at {line.baud} baud: a cycle takes "
        f"{needed * 1e3:.3g} ms, so {1.0 / needed:.0f} Hz at best. A character has {line.bits_per_character} bits "
        f"({character_s(line) * 1e6:.3g} us), {silence_chars:g} of them are silence after each frame: {listed}. "
        "Take a longer period or a higher baud rate"
    )
