"""Reported over commanded torque of an axis from its trial, and the models that are scaled by it. Pure."""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from friction_hil.config import AxisConfig
from friction_hil.daemon.safety import LoopState
from friction_hil.errors import RecordingError
from friction_hil.friction.scaling import scaled_friction
from friction_hil.identification.torque_ratio import RatioEstimate, identify_torque_ratio
from friction_hil.recordings import Recording
from friction_hil.recordings.contradictions import turned_torque
from friction_hil.replay.verify import facts_of
from friction_hil.tuning import thresholds as th
from friction_hil.tuning.motions import TuningError

_DIGITS = 6
_OTHER_SIGN = {"none": "command", "command": "none", "feedback": "both", "both": "feedback"}  # of what is sent
_OTHER_FEEDBACK = {"none": "feedback", "feedback": "none", "command": "both", "both": "command"}


@dataclass(frozen=True, slots=True)
class TorqueRatio:
    """Reported over commanded torque of an axis."""

    former: float  # ratio with which the models of the trial are scaled; 1 where none is known
    estimate: RatioEstimate | None  # from the recordings of the trial; None if they allow none
    reason: str  # why the trial does not determine the ratio; empty if it does

    @property
    def is_determined(self) -> bool:
        """True if the trial shows the ratio."""
        return not self.reason

    @property
    def is_other(self) -> bool:
        """True if the ratio clearly differs from the former one, so that the models are too small or too large."""
        if self.reason or self.estimate is None:
            return False
        difference = abs(self.estimate.ratio / self.former - 1.0)
        return difference > max(th.NOTEWORTHY, th.CLEAR * self.estimate.error / self.former)

    @property
    def text(self) -> str:
        """One sentence for the user."""
        if self.estimate is None or not self.is_determined:
            return f"ratio of reported to commanded torque not determined: {self.reason}"
        figures = f"{self.estimate.ratio:.3g} (standard error {self.estimate.error:.2g})"
        if not self.is_other:
            known = "1" if self.former == 1.0 else f"that of the model, {self.former:.3g}"
            return f"reported over commanded torque {figures}, which does not clearly differ from {known}"
        return (
            f"reported over commanded torque {figures}: a model of the reported torque is "
            f"{'too small' if self.estimate.ratio < self.former else 'too large'} for the commands by that"
        )

    @property
    def figures(self) -> dict[str, Any]:
        """Values and reason as plain values."""
        found = self.estimate
        return {
            "former": self.former,
            "is_determined": self.is_determined,
            "is_other": self.is_other,
            "estimate": None if found is None else found.ratio,
            "standard_error": None if found is None else found.error,
            "unexplained": None if found is None else found.unexplained,
            "reason": self.reason,
        }


def find_torque_ratio(without: Recording, compensated: Sequence[Recording], axis: AxisConfig) -> TorqueRatio:
    """Identify the reported over the commanded torque of an axis.

    ``without``: run of the trial without compensation; ``compensated``: runs with the candidates. ``axis``: with the
    former model.
    """
    former = axis.model.mechanics.torque_ratio
    delay_s = facts_of(compensated[0].metadata, compensated[0]).torque_delay_s
    if delay_s is None:
        return TorqueRatio(former, None, "the drive does not report its torque")
    if delay_s > 0.0:
        return TorqueRatio(former, None, "the torque is read in the background, and not in each period")
    try:
        found = identify_torque_ratio(
            [each.at(each["state"] == LoopState.RUNNING) for each in (without, *compensated)], axis.mode
        )
    except RecordingError as error:
        return TorqueRatio(former, None, str(error))
    return TorqueRatio(former, found, _doubt(found, getattr(axis.options, "inverted_torque", None)))


def refuse_turned_torque(recording: Recording, axis: AxisConfig) -> None:
    """Refuse an experiment whose torque is reported with the wrong sign: no friction can be identified from it.

    Raises `TuningError`: it names the key that turns it.
    """
    if not (text := turned_torque(recording)):
        return
    inverted = getattr(axis.options, "inverted_torque", None)
    key = "the sign of the torque in the drive" if inverted is None else f"inverted_torque: {_OTHER_FEEDBACK[inverted]}"
    both = " (both, where 607Eh inverts position and velocity)" if inverted == "none" else ""
    raise TuningError(f"{recording.axis}: {text}; set {key}{both}, and tune again")


def with_torque_ratio(model: dict[str, Any], ratio: float, error: float | None = None) -> dict[str, Any]:
    """Return a model file in the torque that is commanded where the drive reports ``ratio`` times that.

    Friction, inertia, weight and load are scaled, and ``mechanics.torque_ratio`` is written, with its standard error
    if that is given. The figures of the fit stay those of the reported torque.
    """
    mechanics = model["mechanics"]
    factor = mechanics.get("torque_ratio", 1.0) / ratio
    friction = model["friction"]
    parameters, modifiers = scaled_friction(
        friction["model"], friction["parameters"], friction.get("modifiers", {}), factor
    )
    gravity = {name: factor * value for name, value in mechanics["gravity"].items()}
    changed = {**mechanics, "gravity": gravity, "torque_ratio": _rounded(ratio)}
    changed |= {name: factor * mechanics[name] for name in ("inertia", "offset")}
    if "load" in mechanics:
        changed["load"] = {
            name: value if value is None else factor * value for name, value in mechanics["load"].items()
        }
    content = {
        **model,
        "friction": {**friction, "parameters": parameters, **({"modifiers": modifiers} if modifiers else {})},
        "mechanics": changed,
    }
    if error is None:
        return content
    fit = model["fit"]
    note = (
        f"the drive reports {ratio:.4g} of the commanded torque (standard error {error:.2g}): parameters and mechanics "
        "are those identified from the reported torque, divided by that; the figures of the fit are as identified"
    )
    errors = {**fit["standard_errors"], "torque_ratio": _rounded(error)}
    return {**content, "fit": {**fit, "standard_errors": errors, "flags": [*fit["flags"], note]}}


def _doubt(found: RatioEstimate, inverted: str | None) -> str:
    """Return why an estimate says nothing; empty if it does. ``inverted`` is the axis's key ``inverted_torque``."""
    figures = f"{found.ratio:.2g} (standard error {found.error:.2g})"
    if not found.error < th.VAGUE_RATIO:
        return (
            f"the trial shows {figures}; command and loops of the drive leave {found.unexplained:.0%} of the reported "
            "torque unexplained, so that it may not be what the drive applies"
        )
    if th.LEAST_RATIO < -found.ratio < th.MOST_RATIO:
        key = "the sign of the torque in the drive" if inverted is None else f"inverted_torque: {_OTHER_SIGN[inverted]}"
        return f"the trial shows {figures}: the torque acts in the opposite direction; set {key}"
    if not th.LEAST_RATIO < found.ratio < th.MOST_RATIO:
        return f"the trial shows {figures}: the drive does not apply all of the command, or reports another torque"
    return ""


def _rounded(value: float) -> float:
    return float(f"{value:.{_DIGITS}g}") if math.isfinite(value) else value
