"""Encoder counters, and the velocity that follows from them."""


def unwrap(count: int, raw: int, bits: int) -> int:
    """Return the continuous count of an encoder whose counter wraps.

    ``count``: the continuous count before; at the start the raw one. The result is the nearest count that agrees with
    the counter ``raw``, signed or unsigned, of ``bits`` bits; at exactly half the range the lower one.

    Examples
    --------
    >>> unwrap(32767, -32768, 16)
    32768
    """
    half = 1 << (bits - 1)
    return count + ((raw - count + half) & (2 * half - 1)) - half


def derived_velocity(way: float, elapsed_s: float, before: float, period_s: float) -> float:
    """Return the mean velocity over the time since the position before, but over a period at least.

    A loop that was held up samples late, and the next time on its grid: a step of a count over a small part of a period
    would be a large velocity. What is missing to a whole period is filled up with the velocity before.

    ``way``: distance from the position before, SI. ``elapsed_s``: since that position was sampled, whatever was missed
    or lost in between. ``before``: velocity then.

    Examples
    --------
    >>> derived_velocity(0.03, 15e-3, 2.0, 1e-3), derived_velocity(0.001, 0.5e-3, 2.0, 1e-3)
    (2.0, 2.0)
    """
    if elapsed_s >= period_s:
        return way / elapsed_s
    return (way + before * (period_s - max(elapsed_s, 0.0))) / period_s
