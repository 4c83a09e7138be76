"""Encoder counters."""


def unwrap(count: int, raw: int, bits: int) -> int:
    """Continuous count of an encoder whose counter wraps.

    Parameters
    ----------
    count : int
        Continuous count before; at the start the raw one. The nearest that agrees with the counter follows; at
        exactly half the range the lower.
    raw, bits : int
        The counter, signed or unsigned, and its width.

    Examples
    --------
    >>> unwrap(32767, -32768, 16)
    32768
    """
    half = 1 << (bits - 1)
    return count + ((raw - count + half) & (2 * half - 1)) - half
