"""Encoder counters."""


def unwrap(count: int, raw: int, bits: int) -> int:
    """Return the continuous count of an encoder whose counter wraps.

    Parameters
    ----------
    count : int
        Continuous count before; at the start the raw one. The result is the nearest count that agrees with the
        counter; at exactly half the range the lower one.
    raw, bits : int
        Counter, signed or unsigned, and its width in bits.

    Examples
    --------
    >>> unwrap(32767, -32768, 16)
    32768
    """
    half = 1 << (bits - 1)
    return count + ((raw - count + half) & (2 * half - 1)) - half
