"""MJCF with the LuGre friction of MuJoCo 4: a passive ``dcmotor`` beside the joint's damping.

Source: MuJoCo's XML reference, actuator/dcmotor: ``lugre`` = stiffness, damping, coulomb, static, stribeck velocity,
with a Gaussian hump; ``cogging`` = amplitude, poles, phase of a torque amplitude sin(poles position + phase) of the
motor; body/joint: ``damping`` = coefficients of v, v |v| and v^3. With ``input="none"`` and ``motorconst="0"`` the
motor is nothing but friction.
"""

import math

from friction_hil.export.lossy import MEMORY, Converted, Stribeck, fit_stribeck, judge, number
from friction_hil.export.mjcf import armature, document, notes
from friction_hil.export.points import Points
from friction_hil.export.subject import Subject
from friction_hil.export.xml_text import element, head
from friction_hil.friction import FrictionModel

_POWERS = 3  # of the velocity, in the damping of a joint
_STATIC_DEFLECTION_S = 1e-3  # for a model without presliding: bristles bend by the travel of this time


def convert(subject: Subject, points: Points) -> Converted:
    """Fit the Stribeck curve and the damping, and write the file."""
    file = subject.model_file
    model = file.friction_model
    fit = fit_stribeck(points, points.torque(model), _POWERS)
    stiffness, lost = _stiffness(model, fit)
    lugre = (
        stiffness,
        _bristle_damping(model),
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
    remarks = [*notes(file), *_time_step(file.mechanics.inertia, stiffness), *_cogging_note(model, cogging)]
    actuator = ["  <actuator>", f"    {element('dcmotor', motor)}", "  </actuator>"]
    text = f"{head(subject, loss, remarks)}\n{document(subject, joint, actuator)}"
    return Converted({f"{subject.name}.xml": text}, parameters, loss)


def _stiffness(model: FrictionModel, fit: Stribeck) -> tuple[float, list[str]]:
    """Return the stiffness of the bristles, and what is lost of presliding."""
    level = fit.sliding.coulomb + fit.hump
    if (own := model.presliding_stiffness) > 0.0:
        lost = [] if model.name == "lugre" else ["Presliding has the stiffness of the model, not its shape."]
        if model.name == "lugre" and model.parameters["sigma1"] > 0.0 and not _bristle_damping(model):
            lost = ["The damping of the bristles is left out: it falls with the velocity, and that of MuJoCo does not."]
        return float(model.parameters.get("sigma0", own)), lost
    if level == 0.0:
        return 0.0, []
    travel, angle = fit.velocity * _STATIC_DEFLECTION_S, "rad" if model.axis == "rotary" else "m"
    added = f"The model has no presliding; in MuJoCo the torque builds up over {travel:.3g} {angle} after a reversal."
    return level / travel, [*([] if model.family.is_static and model.network is None else [MEMORY]), added]


def _bristle_damping(model: FrictionModel) -> float:
    """Return sigma1 of a LuGre model whose bristle damping is constant, as MuJoCo's is."""
    if model.name == "lugre" and math.isinf(model.parameters["damping_velocity"]):
        return float(model.parameters["sigma1"])
    return 0.0


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


def _time_step(inertia: float, stiffness: float) -> list[str]:
    """Return the note on the time step: the bristles are a spring that MuJoCo integrates explicitly."""
    if inertia <= 0.0:
        return []
    return [f"Bristles and inertia need a time step well below {2.0 * math.sqrt(inertia / stiffness):.2g} s."]


def _words(values: tuple[float, ...]) -> str:
    return " ".join(number(each) for each in values)
