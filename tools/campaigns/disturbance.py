"""What a bad wire does to frames and telegrams on their way: loss, delay, repetition, another order, another length."""

import random
from dataclasses import dataclass

TO_DRIVE, TO_DAEMON = "to the drive", "to the daemon"
DIRECTIONS = (TO_DRIVE, TO_DAEMON)


@dataclass(slots=True)
class Disturbance:
    """A fault of the wire, for a share of what passes.

    Parameters
    ----------
    kind : {"lost", "late", "duplicated", "reordered", "short", "long"}
    share : float
        Part of the frames that it concerns, 0 to 1.
    delay_s : float
        Lateness of late frames, and time by which others overtake a reordered one.
    directions : tuple of str
    random : random.Random
    most : int or None
        Longest data that the bus can carry, bytes.
    """

    kind: str
    share: float
    delay_s: float
    directions: tuple[str, ...]
    random: random.Random
    most: int | None = None
    changed: int = 0

    def apply(self, direction: str, data: bytes) -> list[tuple[float, bytes]]:
        """Return what arrives of a frame: delay in s and data, none or several times."""
        if direction not in self.directions or self.random.random() >= self.share:
            return [(0.0, data)]
        self.changed += 1
        match self.kind:
            case "lost":
                return []
            case "late" | "reordered":
                return [(self.delay_s, data)]
            case "duplicated":
                return [(0.0, data), (self.random.choice((0.0, self.delay_s)), data)]
            case "short":
                return [(0.0, data[: self.random.randrange(max(1, len(data)))])]
            case "long":
                longer = data + self.random.randbytes(self.random.randint(1, 4))
                return [(0.0, longer if self.most is None else longer[: max(self.most, len(data))])]
        raise ValueError(self.kind)
