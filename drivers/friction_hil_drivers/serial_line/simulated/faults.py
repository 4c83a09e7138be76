"""Faults of a simulated line. The same seed and the same replies give the same faults."""

from dataclasses import dataclass

import numpy as np

from friction_hil_drivers.serial_line.simulated.options import LineFaults

_MOST_NOISE = 4  # stray bytes


@dataclass(frozen=True, slots=True)
class Spoiled:
    """Faults of one reply."""

    pieces: tuple[bytes, ...]  # of the reply, in order; none if it is lost
    is_late: bool = False


class Faults:
    """Draws the faults of each reply."""

    def __init__(self, options: LineFaults) -> None:
        self._options = options
        self._random = np.random.default_rng(options.seed)
        chances = (options.drop, options.delay, options.corrupt, options.split, options.noise)
        self._is_good = not any(chances)

    def spoil(self, reply: bytes) -> Spoiled:
        """Draw the faults of a reply of at least one byte."""
        if self._is_good:
            return Spoiled((reply,))
        # all are drawn for every reply, so that one more fault in the options does not change the others
        drop, delay, corrupt, split, noise = self._random.random(5)
        byte, bit, cut, stray = self._random.random(4)
        o = self._options
        if drop < o.drop:
            return Spoiled(())
        data = bytearray(reply)
        if corrupt < o.corrupt:
            data[int(byte * len(data))] ^= 1 << int(bit * 8)
        if noise < o.noise:
            data[:0] = self._random.bytes(1 + int(stray * _MOST_NOISE))
        pieces: tuple[bytes, ...] = (bytes(data),)
        if split < o.split and len(data) > 1:
            first = 1 + int(cut * (len(data) - 1))
            pieces = bytes(data[:first]), bytes(data[first:])
        return Spoiled(pieces, delay < o.delay)
