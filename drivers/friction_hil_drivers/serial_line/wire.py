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


def cycle_s(plan: Plan, step: Exchange | None, line: LineOptions, silence_chars: float) -> float:
    """Least time of the longest cycle, s: with the longest of the turns, and a step of a sequence."""
    total = sum(exchange_s(exchange, line, silence_chars) for exchange in (*plan.poll, *plan.push))
    total += max((exchange_s(exchange, line, silence_chars) for exchange in plan.turns), default=0.0)
    return total + (exchange_s(step, line, silence_chars) if step is not None else 0.0)


def check_rate(plan: Plan, step: Exchange | None, line: LineOptions, silence_chars: float, period_s: float) -> str:
    """Compare what a cycle takes on the wire with the period; say it.

    Raises
    ------
    UsageError
        A cycle is longer than the period; the message has the arithmetic.
    """
    needed = cycle_s(plan, step, line, silence_chars)
    if needed <= period_s:
        return f"a cycle takes {needed * 1e3:.3g} ms of {period_s * 1e3:g} ms on {line.port}"
    parts = [*plan.poll, *plan.push]
    if plan.turns:
        parts.append(max(plan.turns, key=lambda exchange: exchange_s(exchange, line, silence_chars)))
    if step is not None:
        parts.append(step)
    listed = "; ".join(
        f"{part.what}: {part.request_size} + {part.reply_size} characters, "
        f"{exchange_s(part, line, silence_chars) * 1e3:.3g} ms"
        for part in parts
    )
    raise UsageError(
        f"a period of {period_s * 1e3:g} ms is too short for {line.port} at {line.baud} baud: a cycle takes "
        f"{needed * 1e3:.3g} ms, so {1.0 / needed:.0f} Hz at best. A character has {line.bits_per_character} bits "
        f"({character_s(line) * 1e6:.3g} us), {silence_chars:g} of them are silence after each frame: {listed}. "
        "Take a longer period or a higher baud rate"
    )
