"""MJCF with the LuGre friction of MuJoCo 4: a passive ``dcmotor`` beside the joint's damping.

Source: MuJoCo's XML reference, actuator/dcmotor: ``lugre`` = stiffness, damping, coulomb, static, stribeck velocity,
with a Gaussian hump; ``cogging`` = amplitude, poles, phase of a torque amplitude sin(poles position + phase) of the
motor; body/joint: ``damping`` = coefficients of v, v |v| and v^3. With ``input="none"`` and ``motorconst="0"`` the
motor is nothing but friction.
"""

import math

from friction_hil.export.lossy import MEMORY, Converted, Stribeck, fit_stribeck, judge, number
from friction_hil.export.mjcf import armature, document, moved, notes
from friction_hil.export.points import Points
from friction_hil.export.subject import Subject
from friction_hil.export.xml_text import element, head
from friction_hil.friction import FrictionModel
from friction_hil.models.model_file import ModelFile
from friction_hil.numerics.readable import POSITION_UNITS

_POWERS = 3  # of the velocity, in the damping of a joint
_DEFAULT_STEP = 0.002  # s, of MuJoCo
_SHORTER = 0.25  # steps, of the longest possible, for which the damping of the model is kept
_STATIC_DEFLECTION_S = 1e-3  # for a model without presliding: bristles bend by the travel of this time


def convert(subject: Subject, points: Points) -> Converted:
    """Fit the Stribeck curve and the damping, and write the file."""
    file = subject.model_file
    model = file.friction_model
    fit = fit_stribeck(points, points.torque(model), _POWERS)
    stiffness, lost = _stiffness(model, fit)
    damping, changed = _bristle_damping(file, stiffness)
    lost += changed
    lugre = (
        stiffness,
        damping,
        fit.sliding.coulomb,
        fit.sliding.coulomb + fit.hump,
        fit.velocity,
    )
    cogging = _cogging(model)
    parameters = {"lugre": list(lugre), "damping": list(fit.sliding.viscous), **armature(file)}
    parameters |= {"cogging": list(cogging)} if cogging else {}
    carried = ["presliding"]
    if cogging:
        carried.append("ripple")
        lost += _other_ripple(model, cogging)
    loss = judge(file, points, lambda at: fit.torque(at.velocity), lost, carried)
    joint = {"damping": _words(fit.sliding.viscous), **{name: number(each) for name, each in armature(file).items()}}
    motor = {
        "name": f"{subject.name}_friction",
        "joint": subject.name,
        "input": "none",
        "motorconst": "0",
        "resistance": "1",
        "lugre": _words(lugre),
        "cogging": _words(cogging) if cogging else None,
    }
    longest = _longest_step(stiffness, damping, moved(file))
    remarks = [*notes(file), *_time_step(longest), *_cogging_note(model, cogging)]
    actuator = ["  <actuator>", f"    {element('dcmotor', motor)}", "  </actuator>"]
    timestep = f"{longest:.2g}" if longest < _DEFAULT_STEP else None
    text = f"{head(subject, loss, remarks)}\n{document(subject, joint, actuator, timestep)}"
    return Converted({f"{subject.name}.xml": text}, parameters, loss)


def _stiffness(model: FrictionModel, fit: Stribeck) -> tuple[float, list[str]]:
    """Return the stiffness of the bristles, and what is lost of presliding."""
    level = fit.sliding.coulomb + fit.hump
    if (own := model.presliding_stiffness) > 0.0:
        lost = [] if model.name == "lugre" else ["Presliding has the stiffness of the model, not its shape."]
        return float(model.parameters.get("sigma0", own)), lost
    if level == 0.0:
        return 0.0, []
    travel, angle = fit.velocity * _STATIC_DEFLECTION_S, POSITION_UNITS[model.axis]
    added = f"The model has no presliding; in MuJoCo the torque builds up over {travel:.3g} {angle} after a reversal."
    return level / travel, [*([] if model.family.is_static and model.network is None else [MEMORY]), added]


def _bristle_damping(file: ModelFile, stiffness: float) -> tuple[float, list[str]]:
    """Return the damping of the bristles, and what is lost of that of the model.

    With too little of it, MuJoCo's explicit steps make bristles and inertia swing, and the joint creeps under a
    constant torque; that of the model is replaced by the best for long steps where it would need much shorter ones.
    """
    parameters, inertia = file.friction_model.parameters, moved(file)
    own, best = float(parameters.get("sigma1", 0.0)), math.sqrt(2.0 * stiffness * inertia)
    if own > 0.0 and (
        file.mechanics.inertia <= 0.0
        or _longest_step(stiffness, own, inertia) >= _SHORTER * _longest_step(stiffness, best, inertia)
    ):
        falls = "The damping of the bristles falls with the velocity, and that of MuJoCo does not."
        return own, [] if math.isinf(parameters["damping_velocity"]) else [falls]
    if best == 0.0:
        return 0.0, []
    unit = "N m s/rad" if file.axis == "rotary" else "N s/m"
    return best, [f"The damping of the bristles is {best:.3g} {unit} instead of {own:.3g}: the joint would creep."]


def _cogging(model: FrictionModel) -> tuple[float, float, float] | None:
    """Return the largest harmonic of the ripple as amplitude, poles and phase of the motor's torque.

    Friction cosine cos(n q) + sine sin(n q) opposes the motion; the motor's torque is its negative.
    """
    if model.axis != "rotary" or not model.modifiers.get("ripple"):
        return None
    whole = [each for each in model.modifiers["ripple"] if float(each["order"]).is_integer()]
    if not whole:
        return None
    largest = max(whole, key=lambda each: math.hypot(each["cosine"], each["sine"]))
    amplitude = math.hypot(largest["cosine"], largest["sine"])
    return amplitude, float(largest["order"]), math.atan2(-largest["cosine"], -largest["sine"])


def _other_ripple(model: FrictionModel, cogging: tuple[float, float, float]) -> list[str]:
    """Return a sentence about the harmonics that are not carried."""
    others = [
        math.hypot(each["cosine"], each["sine"])
        for each in model.modifiers["ripple"]
        if float(each["order"]) != cogging[1]
    ]
    return [f"Ripple over position: other harmonics of up to {max(others):.3g} N m."] if others else []


def _cogging_note(model: FrictionModel, cogging: tuple[float, float, float] | None) -> list[str]:
    return [] if cogging is None else [f"Of the ripple, the harmonic of order {cogging[1]:g} is carried, as cogging."]


def _longest_step(stiffness: float, damping: float, inertia: float) -> float:
    """Return half the time step, s, from which on explicit steps make bristles and inertia swing more and more."""
    return math.inf if stiffness == 0.0 else 0.5 * min(damping / stiffness, 2.0 * inertia / damping)


def _time_step(longest: float) -> list[str]:
    if math.isinf(longest):
        return []
    return [
        f"Bristles and this inertia need a time step of {longest:.2g} s at most, and MuJoCo's integrator Euler: with "
        "longer ones the joint creeps under a constant torque, or the simulation is not stable."
    ]


def _words(values: tuple[float, ...]) -> str:
    return " ".join(number(each) for each in values)
