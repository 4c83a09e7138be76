"""A drive whose torque is a signal of unknown gain: volts, amperes, per cent of a duty cycle. Pure.

gain u - back_emf v = inertia a + offset + gravity(q) + friction: all of it can be multiplied by one number, so that
something on the right-hand side has to be known. The regression runs in the units of the signal u, which is where
the error is (what the model leaves out, and what an axis at rest does not show), with the torque of all that is
known as one regressor, whose factor is 1 / gain; regressing the known torque on the signal would take that error
into a regressor, and make the gain too small. Afterwards everything is brought to torque.

Back-EMF and viscous friction are both proportional to the velocity: only their sum shows.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

from friction_hil import friction as models
from friction_hil.errors import RecordingError, UsageError, choices
from friction_hil.friction.modifiers import HARMONIC, VISCOUS
from friction_hil.identification.errors import PredictionError
from friction_hil.identification.fits import MECHANICS, Curves, Fit
from friction_hil.identification.inference import flags, infer
from friction_hil.identification.problem import BACK_EMF, GAIN, INVERSE_GAIN, Estimate
from friction_hil.identification.structures import Structure

_SCALING = ("inertia", "gravity.constant", "gravity.sine", "gravity.cosine")
_TOGETHER = ("viscous", "viscous.positive", "viscous.negative")  # columns that make up the one of back-EMF


def known_torque(held: Mapping[str, float]) -> dict[str, float]:
    """What is held of the mechanics and the back-EMF, N m per unit of its column: that sets the scale.

    Raises
    ------
    UsageError
        Nothing that is held does.
    """
    known = {name: value for name, value in held.items() if name in (*MECHANICS, BACK_EMF)}
    if GAIN in held:
        raise UsageError(f"{GAIN} is what is looked for; where it is known, scale the signal: --scale torque=GAIN")
    if not any(known.get(name) for name in _SCALING):
        raise UsageError(
            "the gain of the drive is unknown, so that nothing says how large a torque is: hold what is known, "
            "--fix gravity.sine=MASS*9.81*LENGTH (N m) of a pendulum, --fix gravity.constant=..., or --fix inertia=..."
        )
    return known


def without_viscous(structure: Structure) -> Structure:
    """The structure without what the back-EMF makes up as well."""
    for name, key in dict(structure.linear).items():
        if key in _TOGETHER:
            structure = structure.hold(name, 0.0)
    return structure


def notes(structure: Structure, known: Mapping[str, float]) -> list[str]:
    """What an unknown gain means for a candidate."""
    if BACK_EMF in known or not any(name.rpartition(".")[2] in ("viscous", "sigma2") for name in structure.constants):
        return []
    return [
        f"collinear: {BACK_EMF} with viscous friction; {BACK_EMF} holds their sum, viscous friction is held at 0: "
        f"--fix {BACK_EMF}=k_e*k_t/R of the motor's data sheet (N m s/rad) tells them apart"
    ]


def check_held(structure: Structure, held: Mapping[str, float]) -> None:
    """Refuse held friction torques: they are in N m, which nothing is before the gain is known."""
    for name, value in held.items():
        if value and name not in (*MECHANICS, BACK_EMF) and _is_torque(structure, name):
            possible = [*_SCALING, "offset", BACK_EMF]
            raise UsageError(
                f"--fix {name}: with an unknown gain a torque of friction cannot be held; {choices(name, possible)}"
            )


def usable(fits: Sequence[Fit]) -> list[Fit]:
    """Fits, in units of the signal, whose gain is positive.

    Raises
    ------
    RecordingError
        The gain of none is positive.
    """
    found = [each for each in fits if each.values[INVERSE_GAIN] > 0.0]
    if not found:
        raise RecordingError(
            "the signal does not grow with the torque that is held: the sign of the signal (--scale torque=-1), of the "
            "position, or of what is held is the other one, or the axis does not move enough to tell"
        )
    return found


def in_torque(fit: Fit, parts: Sequence[slice]) -> Fit:
    """Bring a fit in units of the signal, to records that are the ``parts`` of its rows, to torque."""
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


def _estimate_in_torque(structure: Structure, estimate: Estimate, gain: float, curves: Curves) -> Estimate:
    """An estimate whose predicted quantity is the torque gain u, with the gain for its inverse.

    The signal is tau(parameters) / gain, tau being proportional to all that is a torque: gain times its derivatives
    is what it was for those, and -u for the gain.
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


def _is_torque(structure: Structure, name: str) -> bool:
    """Whether a parameter is proportional to the unit of torque."""
    if name in (*MECHANICS, BACK_EMF):
        return True
    parameters = (*models.describe(structure.family).parameters, *VISCOUS.parameters, *HARMONIC.parameters)
    units = {each.name: each.unit for each in parameters}
    last = name.rpartition(".")[2].partition("[")[0]
    return last == "points" or units.get(last, "").startswith("N m")


def _scaled(error: PredictionError, gain: float) -> PredictionError:
    blocks = tuple(gain**2 * each for each in error.blocks)
    return PredictionError(gain * error.rmse, error.relative_error, blocks)
