"""Identification with a torque signal of unknown gain, in volts, amperes or per cent of a duty cycle. Pure.

The equation is gain u - back_emf v = inertia a + offset + gravity(q) + friction. Both sides can be multiplied by any
number, so that a term of the right-hand side must be known. The regression runs in the units of the signal u, which
carries the error (model error, and static friction at rest). The torque of all known terms is one regressor, with the
coefficient 1 / gain. Regressing the known torque on the signal instead would put the error into a regressor and
underestimate the gain. The result is converted to torque at the end.

Back-EMF and viscous friction are both proportional to the velocity: only their sum can be identified.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

from friction_hil import friction as models
from friction_hil.errors import RecordingError, UsageError, choices
from friction_hil.friction.modifiers import HARMONIC, VISCOUS
from friction_hil.identification.fits import MECHANICS, Curves, Fit
from friction_hil.identification.inference import flags, infer
from friction_hil.identification.prediction_errors import PredictionError
from friction_hil.identification.regression import BACK_EMF, GAIN, INVERSE_GAIN, Estimate
from friction_hil.identification.structures import ModelStructure

_SCALING = ("inertia", "gravity.constant", "gravity.sine", "gravity.cosine")
_VISCOUS_COLUMNS = ("viscous", "viscous.positive", "viscous.negative")  # their span contains the back-EMF's column


def known_torque(held: Mapping[str, float]) -> dict[str, float]:
    """Return those of the held parameters that are mechanical or the back-EMF; they set the scale of the torque.

    Raises `UsageError`: no held parameter sets the scale, or the gain itself is held.
    """
    known = {name: value for name, value in held.items() if name in (*MECHANICS, BACK_EMF)}
    if GAIN in held:
        raise UsageError(f"{GAIN} is identified here; if it is known, scale the signal: --scale torque=GAIN")
    if not any(known.get(name) for name in _SCALING):
        raise UsageError(
            "the gain of the drive is unknown, so that no torque has a scale: hold a known parameter, "
            "--fix gravity.sine=MASS*9.81*LENGTH (N m) of a pendulum, --fix gravity.constant=..., or --fix inertia=..."
        )
    return known


def without_viscous(structure: ModelStructure) -> ModelStructure:
    """Return the structure without the viscous friction that the back-EMF can replace."""
    for name, key in dict(structure.linear).items():
        if key in _VISCOUS_COLUMNS:
            structure = structure.hold(name, 0.0)
    return structure


def notes(structure: ModelStructure, known: Mapping[str, float]) -> list[str]:
    """Return notes on a candidate that concern the unknown gain."""
    if BACK_EMF in known or not any(name.rpartition(".")[2] in ("viscous", "sigma2") for name in structure.constants):
        return []
    return [
        f"collinear: {BACK_EMF} with viscous friction; {BACK_EMF} holds their sum, viscous friction is held at 0: "
        f"--fix {BACK_EMF}=k_e*k_t/R of the motor's data sheet (N m s/rad) tells them apart"
    ]


def check_held(structure: ModelStructure, held: Mapping[str, float]) -> None:
    """Raise `UsageError` if a friction torque is held: before the gain is known, nothing can be in N m."""
    for name, value in held.items():
        if value and name not in (*MECHANICS, BACK_EMF) and _is_torque(structure, name):
            possible = [*_SCALING, "offset", BACK_EMF]
            raise UsageError(
                f"--fix {name}: with an unknown gain a torque of friction cannot be held; {choices(name, possible)}"
            )


def usable(fits: Sequence[Fit]) -> list[Fit]:
    """Return the fits, in units of the signal, whose gain is positive; a `RecordingError`: none is."""
    found = [each for each in fits if each.values[INVERSE_GAIN] > 0.0]
    if not found:
        raise RecordingError(
            "the signal does not grow with the held torque: the sign of the signal (--scale torque=-1), of the "
            "position or of the held parameter is wrong, or the axis moves too little to tell"
        )
    return found


def in_torque(fit: Fit, parts: Sequence[slice]) -> Fit:
    """Convert a fit from units of the signal to torque; ``parts`` are the rows of each record."""
    structure, gain = fit.structure, 1.0 / fit.values[INVERSE_GAIN]
    before = flags(fit.estimate, fit.inference)
    estimate = _estimate_in_torque(structure, fit.estimate, gain, fit.curves)
    inference = infer(estimate, parts)
    constants = {
        name: value * gain if _is_torque(structure, name) and isinstance(value, float) else value
        for name, value in structure.constants.items()
    }
    curves = fit.curves
    return replace(
        fit,
        structure=replace(structure, constants=constants),
        values=estimate.values,
        mechanics={name: value * gain for name, value in fit.mechanics.items()},
        inference=inference,
        train=_scaled(fit.train, gain),
        cross_validation=_scaled(fit.cross_validation, gain),
        across_speeds=None if fit.across_speeds is None else _scaled(fit.across_speeds, gain),
        validation=None if fit.validation is None else _scaled(fit.validation, gain),
        flags=(*fit.flags[: len(fit.flags) - len(before)], *flags(estimate, inference)),
        estimate=estimate,
        curves=replace(
            curves,
            measured=gain * curves.measured,
            predicted=gain * curves.predicted,
            residual=gain * curves.residual,
            friction=gain * curves.friction,
        ),
    )


def _estimate_in_torque(structure: ModelStructure, estimate: Estimate, gain: float, curves: Curves) -> Estimate:
    """Convert an estimate from units of the signal to torque, with the gain in place of its inverse.

    The signal is u = tau(parameters) / gain, and tau is proportional to all torque parameters. The Jacobian keeps its
    columns for these, is multiplied by the gain for the others, and is -u for the gain.
    """
    jacobian = estimate.jacobian.copy()
    for column, name in enumerate(estimate.names):
        if name == INVERSE_GAIN:
            jacobian[:, column] = -curves.predicted
        elif not _is_torque(structure, name):
            jacobian[:, column] *= gain
    values = {}
    for name, value in estimate.values.items():
        if name == INVERSE_GAIN:
            values[GAIN] = gain
        else:
            values[name] = value * gain if _is_torque(structure, name) else value
    names, at_bound, dependent = (
        tuple(GAIN if name == INVERSE_GAIN else name for name in each)
        for each in (estimate.names, estimate.at_bound, estimate.dependent)
    )
    return replace(
        estimate,
        values=values,
        names=names,
        at_bound=at_bound,
        dependent=dependent,
        jacobian=jacobian,
        residual=gain * estimate.residual,
    )


def _is_torque(structure: ModelStructure, name: str) -> bool:
    """Return True if a parameter is proportional to the unit of torque."""
    if name in (*MECHANICS, BACK_EMF):
        return True
    parameters = (*models.describe(structure.family).parameters, *VISCOUS.parameters, *HARMONIC.parameters)
    units = {each.name: each.unit for each in parameters}
    last = name.rpartition(".")[2].partition("[")[0]
    return last == "points" or units.get(last, "").startswith("N m")


def _scaled(error: PredictionError, gain: float) -> PredictionError:
    blocks, stretches = (tuple(gain**2 * each for each in errors) for errors in (error.blocks, error.stretches))
    return PredictionError(gain * error.rmse, error.relative_error, blocks, stretches)
