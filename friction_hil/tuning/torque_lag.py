"""Torque lag of an axis from its trial: what goes into the model file, and why. Pure."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from friction_hil.config import AxisConfig
from friction_hil.daemon.safety import LoopState
from friction_hil.drive import AxisFacts
from friction_hil.errors import RecordingError
from friction_hil.identification.torque_lag import LagEstimate, identify_torque_lag
from friction_hil.identification.torque_timing import TorqueTiming
from friction_hil.recordings import Recording
from friction_hil.replay.verify import facts_of
from friction_hil.tuning import thresholds as th
from friction_hil.tuning.choice import TriedModel


@dataclass(frozen=True, slots=True)
class TorqueLag:
    """Torque lag of an axis."""

    value_s: float  # lag in the model file
    former_s: float  # lag of the former model, with which the trial ran; 0: none is stated
    estimate: LagEstimate | None  # from the recordings of the trial; None if they allow none
    is_determined: bool  # the trial shows the lag
    reason: str  # why the former one is kept; empty if it is not

    @property
    def is_replaced(self) -> bool:
        """True if the lag in the model file is the estimate."""
        return not self.reason

    @property
    def text(self) -> str:
        """One sentence for the user."""
        if self.is_replaced and self.estimate is not None:
            return (
                f"torque lag {_ms(self.value_s)} (standard error {_ms(self.estimate.error_s)}), identified from the "
                f"trial, which ran with {_ms(self.former_s)}"
            )
        said = "torque lag" if self.is_determined else "torque lag not determined"
        return f"{said}: {self.reason}; {_ms(self.former_s)} of the former model is kept"

    @property
    def figures(self) -> dict[str, Any]:
        """Value, estimate and reason as plain values."""
        found = self.estimate
        return {
            "value_s": self.value_s,
            "former_s": self.former_s,
            "is_determined": self.is_determined,
            "is_replaced": self.is_replaced,
            "estimate_s": None if found is None else found.lag_s,
            "standard_error_s": None if found is None else found.error_s,
            "below_s": None if found is None else found.most_s,
            "reason": self.reason,
        }


def find_torque_lag(
    without: Recording, compensated: Sequence[Recording], axis: AxisConfig, timing: TorqueTiming | None
) -> TorqueLag:
    """Identify the torque lag of an axis, and decide whether it replaces that of the former model.

    A sample shows the sum of delay and lag. The delay until the command is in force is ``delay_s`` of the model, or
    what the driver states; the rest is the lag. A filter of the reported torque counts as lag too, unless the age of
    the torque is known. Therefore a stated lag is replaced only if the age is known and the lag found differs clearly.

    ``without``: run of the trial without compensation; ``compensated``: runs with the candidates. ``axis``: with the
    former model. ``timing``: age of the reported torque, if it was looked for.
    """
    former_s = axis.model.mechanics.torque_lag_s
    try:
        estimate = _estimate(without, compensated, axis, timing)
    except RecordingError as error:
        return TorqueLag(former_s, former_s, None, is_determined=False, reason=str(error))
    is_age_known = timing is not None and timing.meaning is not None
    doubt = _doubt(estimate, without.period_s, is_age_known=is_age_known)
    reason = doubt or _objection(estimate, former_s, is_age_known=is_age_known)
    return TorqueLag(former_s if reason else estimate.lag_s, former_s, estimate, not doubt, reason)


def with_torque_lag(tried: TriedModel, lag: TorqueLag) -> TriedModel:
    """Return a tried model with the torque lag in its file; as it is, if the former lag is kept."""
    if not lag.is_replaced or lag.estimate is None:
        return tried
    fit = tried.model["fit"]
    errors = {**fit["standard_errors"], "torque_lag_s": _rounded(lag.estimate.error_s)}
    flags = [*fit["flags"], lag.text]
    mechanics = {**tried.model["mechanics"], "torque_lag_s": _rounded(lag.value_s)}
    return replace(
        tried,
        model={**tried.model, "mechanics": mechanics, "fit": {**fit, "standard_errors": errors, "flags": flags}},
    )


def _estimate(
    without: Recording, compensated: Sequence[Recording], axis: AxisConfig, timing: TorqueTiming | None
) -> LagEstimate:
    facts = facts_of(compensated[0].metadata, compensated[0])
    if facts.torque_delay_s is None:
        raise RecordingError("the drive does not report its torque")
    if facts.torque_delay_s > 0.0:
        raise RecordingError("the torque is read in the background, and not in each period")
    if timing is not None and timing.meaning == "late":
        raise RecordingError(f"the reported torque is {_ms(timing.delay_s)} old, and what it shows contains that delay")
    meaning = "instant" if timing is None else timing.meaning or timing.assumed
    runs = [each.at(each["state"] == LoopState.RUNNING) for each in (without, *compensated)]
    delay_s = _delay_s(axis, facts, without.period_s)
    return identify_torque_lag(runs, axis.mode, delay_s, is_mean=meaning == "mean", resolution=facts.torque_resolution)


def _delay_s(axis: AxisConfig, facts: AxisFacts, period_s: float) -> float:
    """Return the time from a sample until the command is in force; see `friction_hil.daemon.assembly.lead_s`."""
    stated = axis.model.mechanics.delay_s
    return stated if stated > 0.0 else facts.actuation_delay_s - 0.5 * period_s


def _doubt(found: LagEstimate, period_s: float, *, is_age_known: bool) -> str:
    """Return why an estimate says nothing; empty if it does."""
    if found.most_s > th.AT_LIMIT * found.longest_s:
        return f"it is as long as {_ms(found.longest_s)}, or the torque follows the command by another law"
    if abs(found.gain - 1.0) > th.GAIN_ERROR:
        text = f"the reported torque changes by {found.gain:.2g} of the commanded one: the drive"
        if found.gain < 0.0:
            return f"{text} applies it in the other direction, as with 607Eh, which inverts position and velocity alone"
        if found.gain > 1.0:
            return f"{text} reports it in another unit"
        return f"{text} does not apply all of it, or reports it in another unit"
    if found.lag_s < th.CLEAR * found.error_s:
        return (
            f"the reported torque probably follows the command within {_ms(found.most_s)}: samples at {_ms(period_s)} "
            "do not show so short a lag, or the drive reports the torque that it demands"
        )
    if not is_age_known and math.tau * th.SLOWEST_LOOP_HZ * found.lag_s > 1.0:
        return (
            f"the reported torque lags by {_ms(found.lag_s)}, more than usual current loops do, and may be filtered: "
            "its age is not known"
        )
    return ""


def _objection(found: LagEstimate, former_s: float, *, is_age_known: bool) -> str:
    """Return why a lag that the model states stays although another one was found; empty if it does not."""
    if former_s <= 0.0:
        return ""
    figures = f"{_ms(found.lag_s)} (standard error {_ms(found.error_s)})"
    if abs(found.lag_s - former_s) <= th.CLEAR * found.error_s:
        return f"the trial shows {figures}, which agrees with the stated one"
    if not is_age_known:
        return (
            f"the trial shows {figures}, but the age of the reported torque is not known, so that this does not "
            "replace the stated one"
        )
    return ""


def _ms(value_s: float) -> str:
    return f"{1e3 * value_s:.3g} ms"


def _rounded(value: float) -> float:
    """Return six digits of a value."""
    return float(f"{value:.6g}") if math.isfinite(value) else value
