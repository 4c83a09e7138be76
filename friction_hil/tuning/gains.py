"""Gains that a trial tries with the best model of an axis, and whether its torque limit clipped it. Pure."""

import math
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

from friction_hil.config import AxisConfig, Compensation
from friction_hil.daemon.assembly import make_compensator
from friction_hil.daemon.safety import LoopState
from friction_hil.daemon.static_torque import static_torque
from friction_hil.numerics.readable import digits
from friction_hil.recordings import Recording
from friction_hil.replay.changes import inputs_of
from friction_hil.replay.verify import facts_of
from friction_hil.tuning import thresholds as th
from friction_hil.tuning.sequential import Unknown
from friction_hil.tuning.trial import Trial


@dataclass(frozen=True, slots=True)
class Clipping:
    """How often the torque limit clipped the compensation."""

    share: float  # of the rows
    limit: float  # ``limits.torque``, N m or N
    # limit that would not have clipped it; None where the loop's controller, not the compensation, reached the limit
    enough: float | None


@dataclass(frozen=True, slots=True, eq=False)
class GainTrial:
    """What a gain did with the best model of an axis."""

    gain: float | None  # None where no other one was tried
    trial: Trial
    clipping: Clipping | None = None

    @property
    def text(self) -> str:
        """What it did in the own motion, and where it did harm."""
        harm = [f"oscillates in {', '.join(self.trial.swinging)}"] if self.trial.swinging else []
        return ", ".join([f"{digits(self.trial.reduction.rms, 2)} times lower", *harm])

    @property
    def figures(self) -> dict[str, Any]:
        """Plain values."""
        return {
            "gain": self.gain,
            **self.trial.figures,
            "reduction": asdict(self.trial.reduction),
            "has_helped": self.trial.has_helped,
            "clipping": None if self.clipping is None else asdict(self.clipping),
        }


class Gains:
    """Trials of gains with one model: the configured one, then higher ones, or lower ones where the axis oscillates.

    The first higher gain is 1 less twice the standard deviation of the torque, as in learning; the next one is 1, which
    a drive bears if nothing is wrong but the parameters. Each is tried only if the one before was better.

    ``trial`` is with the configured gain, and ``clipping`` is in that trial. ``unknown``: what is unknown of the
    friction.
    """

    def __init__(self, given: Compensation, trial: Trial, unknown: Unknown | None, clipping: Clipping | None) -> None:
        self.tried = [GainTrial(given.gain, trial, clipping)]
        self._last, self._left = given.gain, list[float]()
        if given.gain_negative is not None:  # the user's own
            return
        if trial.swinging:
            self._left = [given.gain - (k + 1) * th.GAIN_STEP for k in range(th.MOST_GAINS)]
        elif trial.has_helped:
            known = 0.5 * (1.0 + given.gain) if unknown is None else 1.0 - th.GAIN_DOUBT * unknown.known_to
            self._left = [known, 1.0]

    @property
    def best(self) -> GainTrial:
        """Gain that swings nowhere and follows best."""
        return min(self.tried, key=lambda each: each.trial.rank)

    def next(self) -> float | None:
        """Return the gain to try next; None if none is worth it."""
        first, last = self.tried[0], self.tried[-1]
        is_done = not last.trial.swinging if first.trial.swinging else last is not self.best
        if len(self.tried) > 1 and is_done:
            return None
        while self._left:
            gain = round(self._left.pop(0), 2)
            if gain > 0.0 and (first.trial.swinging or gain >= self._last + th.GAIN_DIFFERENCE):
                self._last = gain
                return gain
        return None


def find_clipping(recording: Recording, axis: AxisConfig, period_s: float) -> Clipping | None:
    """Return how often ``limits.torque`` clipped the compensation of a run, and which limit would not have.

    The compensator runs again over the recorded inputs, without a limit. ``axis`` is of that run; ``period_s``: of the
    loop.
    """
    limit = axis.limits.torque
    running = recording["state"] == LoopState.RUNNING
    torques = np.maximum(np.abs(recording["compensation"]), np.abs(recording["command"]))[running]
    share = float(np.mean(torques >= th.NEAR_LIMIT * limit)) if torques.size else 0.0
    if share <= th.CLIPPED:
        return None
    free = axis.model_copy(update={"limits": axis.limits.model_copy(update={"torque": 1e12})})
    compensator = make_compensator(free, axis.model, facts_of(recording.metadata, recording), period_s)
    wanted = compensator.replay_all(inputs_of(recording, 0, len(recording)))["compensation"][running]
    needed = float(np.max(np.abs(wanted))) + static_torque(axis).largest * bool(static_torque(axis).bound)
    return Clipping(share, limit, _rounded_up(needed) if needed > limit else None)


def _rounded_up(value: float) -> float:
    """Return a number of two digits that is not below ``value``."""
    step = 10.0 ** (math.floor(math.log10(value)) - 1)
    return float(f"{math.ceil(value / step) * step:.6g}")
