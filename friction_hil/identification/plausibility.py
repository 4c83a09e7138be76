"""Checks of a finished identification: does the model explain the torque, and if not, why? Pure.

A search always ends with a best candidate, also where the torque has a wrong sign, belongs to another joint or follows
the motion of others. The checks compare the result with what little every axis obeys: inertia, Coulomb and viscous
friction are not negative, and a model predicts the torque better than its mean does.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from friction_hil import friction as models
from friction_hil.identification import coupling
from friction_hil.identification import thresholds as th
from friction_hil.identification.data import Data
from friction_hil.identification.fits import Fit
from friction_hil.identification.identify import Identification
from friction_hil.identification.plain_axis import PlainAxis
from friction_hil.motion.experiment import is_fast
from friction_hil.recordings import Recording
from friction_hil.recordings.contradictions import contradictions, unsigned_register
from friction_hil.recordings.mapping import parse_source


@dataclass(frozen=True, slots=True)
class Finding:
    """One sentence about a finished identification, and whether it makes the model worthless."""

    text: str
    is_fatal: bool = False


def check_result(result: Identification, recordings: Sequence[Recording]) -> list[Finding]:
    """Return what speaks against the chosen model of an identification, fatal findings first.

    ``recordings``: those that the model was fitted to, with all their columns.
    """
    data = Data(result.records)
    plain = PlainAxis(
        data, [name for name in result.best.mechanics if name.startswith("gravity.") and _has(result, name)]
    )
    is_rotary = result.settings.axis == "rotary"
    swinging = ["gravity.sine", "gravity.cosine"] if is_rotary else []
    found = _register(recordings) or _sign(result, PlainAxis(data, swinging, has_spring=True), recordings)
    is_turned = bool(found)
    found += [*_of_motion(result, recordings), *_one_way(result, data)]
    found += [] if is_turned else _without_friction(result.best)
    error, constant = result.best.held_out.relative_error, _error_of_constant(result)
    causes = []
    if error > th.GOOD and not is_turned:
        causes = [*coupling.other_joints(result, recordings), *_slow_rows(result, data, plain)]
        # gravity may show in another torque and not in this one
        causes += coupling.other_torques(PlainAxis(data, swinging), result, recordings)
    if not error < th.NOTHING * min(constant, 1.0):  # also if all torques are zero, where the error is NaN
        advice = "" if found or causes else f": {_advice(result)}"
        found.insert(0, Finding(f"{_compared(error, constant)}, so that it explains nothing{advice}", is_fatal=True))
    elif error > th.POOR * constant and not is_turned:
        advice = "" if causes else f": {_advice(result)}"
        found.append(Finding(f"{_compared(error, constant)}, so that it explains little{advice}"))
    found += [Finding(each) for each in causes]
    return sorted(found, key=lambda each: not each.is_fatal)


_ADVICE = (
    "check that the column torque is that of this axis, its sign (--scale torque=-1), its factor and what --fix holds, "
    "and that nothing else moves the axis or loads it: other joints, contact, a hand"
)


def _advice(result: Identification) -> str:
    return f"{_ADVICE}; try all models (without --models)" if result.settings.families else _ADVICE


def _has(result: Identification, name: str) -> bool:
    return name in result.best.values or bool(result.best.mechanics[name])


def _compared(error: float, constant: float) -> str:
    return (
        f"the model predicts data that it was not fitted to with an error of {100.0 * error:.3g} %, a constant torque "
        f"with {100.0 * constant:.3g} %"
    )


def _error_of_constant(result: Identification) -> float:
    """Return the relative error with which the mean torque of the fitted rows predicts the rows to judge by."""
    if result.best.validation is not None and result.validation:
        constant, judged = float(np.mean(Data(result.records).torque)), Data(result.validation).torque
    else:
        judged = result.best.curves.measured
        constant = float(np.mean(judged))
    norm = float(np.linalg.norm(judged))
    return float(np.linalg.norm(judged - constant)) / norm if norm > 0.0 else 0.0


def _register(recordings: Sequence[Recording]) -> list[Finding]:
    """Report a torque that is a signed register, read as an unsigned one."""
    text = unsigned_register(recordings)
    return [Finding(text, is_fatal=True)] if text else []


def _one_way(result: Identification, data: Data) -> list[Finding]:
    """Report a motion in one direction, in which friction cannot be told from a constant torque."""
    velocity = data.motion("velocity")
    fast = np.abs(velocity) > th.PLAUSIBILITY_MOVING * float(np.max(np.abs(velocity)))
    shares = [float(np.mean(velocity[fast] * sign > 0.0)) for sign in (1.0, -1.0)]
    if min(shares) >= th.ONE_WAY or "offset" in result.settings.held:
        return []
    return [
        Finding(
            f"the axis moves in one direction ({100.0 * max(shares):.3g} % of the moving rows), in which Coulomb "
            "friction cannot be told from an offset or gravity: record strokes in both directions, or, if nothing but "
            "friction holds the axis, give --fix offset=0",
            is_fatal=True,
        )
    ]


def _of_motion(result: Identification, recordings: Sequence[Recording]) -> list[Finding]:
    """Report recordings whose velocity contradicts their position, where the velocity counts."""
    if all(record.lowpass_hz is not None for record in result.records):
        return []  # the velocity is derived
    return [Finding(each, is_fatal=True) for each in dict.fromkeys(itertools.chain(*map(contradictions, recordings)))]


def _sign(result: Identification, plain: PlainAxis, recordings: Sequence[Recording]) -> list[Finding]:
    """Report a torque whose sign is turned: only its negative is that of an axis with inertia and friction.

    What depends on the position (gravity, a spring) has no sign that is known, and is fitted with either.
    """
    error, turned = plain.error(), plain.error(sign=-1.0)
    if not turned < th.CLEARLY * min(error, result.best.held_out.relative_error):
        return []
    return [
        Finding(
            "the sign of the torque is turned, or that of the position: inertia, Coulomb and viscous friction, none of "
            f"them negative, leave an error of {100.0 * turned:.3g} % with the sign turned and of "
            f"{100.0 * error:.3g} % as it is; {_turned_option(recordings[0])}",
            is_fatal=True,
        )
    ]


def _turned_option(recording: Recording) -> str:
    """Return what turns the sign of the torque, beside the mapping that was given."""
    source, factor = parse_source(recording.sources.get("torque", "torque"))
    if factor == 1.0:
        return "give --scale torque=-1"
    if factor == -1.0:
        return "leave out the factor -1"
    return (
        f"give --scale torque={-factor:.10g}"
        if source == "torque"
        else f"give --column torque='{source}*{-factor:.10g}'"
    )


def _without_friction(best: Fit) -> list[Finding]:
    """Report a model whose friction is zero at all speeds of the recording."""
    parameters, modifiers = best.friction
    if any(modifiers.get("load", {}).values()):
        return []
    own = {name: content for name, content in modifiers.items() if name in ("direction", "viscous")}
    model = models.create(best.structure.family, modifiers=own or None, **parameters)
    top = float(np.max(np.abs(best.curves.velocity)))
    speeds = np.linspace(0.0, top, th.SPEEDS + 1)[1:]
    level = max(float(np.max(np.abs(model.steady_state(sign * speeds)))) for sign in (1.0, -1.0))
    if level > th.NO_FRICTION * float(np.sqrt(np.mean(best.curves.measured**2))):
        return []
    return [
        Finding(
            f"{best.label} has no friction: its levels are zero at all speeds up to {top:.3g}, so that there is "
            f"nothing to compensate; {_ADVICE}",
            is_fatal=True,
        )
    ]


def _slow_rows(result: Identification, data: Data, plain: PlainAxis) -> list[str]:
    """Suggest the least speed at which rows count, if slower rows spoil the prediction of faster ones."""
    if result.settings.least_speed > 0.0 or all(is_fast(record.rate_hz) for record in result.records):
        return []  # sampled fast, presliding shows: it takes a dynamic model, not fewer rows
    speed = np.abs(data.motion("velocity"))
    least = plain.least_speed(speed)
    if least is None:
        return []
    own = np.abs(result.best.curves.velocity)
    slow, fast = (result.best.curves.residual[rows] for rows in (own < least, own >= least))
    if not len(slow) or not len(fast) or np.mean(slow**2) < np.mean(fast**2):
        return []
    share = 100.0 * float(np.mean(own < least))
    unit = "m/s" if result.settings.axis == "linear" else "rad/s"
    return [
        f"{share:.0f} % of the rows are slower than {least:.2g} {unit}; what holds the axis there spoils the "
        "prediction of its motion, and at this rate the recording does not show "
        f"it: try --min-speed {least:.2g}"
    ]
