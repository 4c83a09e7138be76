"""MJCF: a joint of MuJoCo with ``frictionloss``, ``damping`` and ``armature``.

Source: MuJoCo's XML reference, body/joint: ``frictionloss`` is dry friction, N m or N; ``damping`` the coefficient of
the velocity; ``armature`` is added to the inertia of the joint. ``solreffriction`` and ``solimpfriction`` make the dry
friction as stiff as MuJoCo has it (`mujoco_friction`).
"""

from collections.abc import Sequence

from friction_hil.export.lossy import Converted, fit_viscous, judge, number
from friction_hil.export.mujoco_friction import STIFF
from friction_hil.export.points import Points
from friction_hil.export.subject import Subject
from friction_hil.export.xml_text import element, head
from friction_hil.models.model_file import ModelFile

_NEARLY_NOTHING = 1e-6  # mass and inertia of the body, of the armature
_UNKNOWN = 1.0


def convert(subject: Subject, points: Points) -> Converted:
    """Fit Coulomb level and viscous coefficient, and write the file."""
    file = subject.model_file
    fit = fit_viscous(points, points.torque(file.friction_model))
    parameters = {"frictionloss": fit.coulomb, "damping": fit.viscous[0], **armature(file)}
    creep = STIFF.creep(fit.coulomb, moved(file))
    soft = [STIFF.sentence(fit.coulomb, moved(file), file.axis)] if creep > 0.0 else []
    loss = judge(file, points, lambda at: fit.torque(at.velocity, creep), soft)
    joint = {name: number(value) for name, value in parameters.items()} | STIFF.attributes()
    text = f"{head(subject, loss, notes(file))}\n{document(subject, joint)}"
    return Converted({f"{subject.name}.xml": text}, parameters, loss)


def armature(file: ModelFile) -> dict[str, float]:
    """Return the armature by its name, nothing if the inertia is not known.

    A sliding joint has none: MuJoCo would take the mass of the body alone for what its dry friction has to hold.
    """
    return {"armature": file.mechanics.inertia} if file.mechanics.inertia > 0.0 and file.axis == "rotary" else {}


def moved(file: ModelFile) -> float:
    """Return the inertia that the joint of the exported file moves, kg m^2 or kg."""
    return file.mechanics.inertia or _UNKNOWN


def notes(file: ModelFile) -> list[str]:
    """Return what a user of the file should know."""
    own = "Copy the attributes of the joint into a joint of your model."
    if file.mechanics.inertia <= 0.0:
        return [own, "The model file does not state the inertia: the body has 1."]
    if file.axis == "linear":
        return [own, "The body has the mass of motor and load; an armature would make the dry friction of MuJoCo soft."]
    return [
        own,
        "The armature is the inertia of motor and load together; subtract that of the bodies which your model moves.",
    ]


def document(subject: Subject, joint: dict[str, str], actuator: Sequence[str] = (), timestep: str | None = None) -> str:
    """Return a model of one joint that MuJoCo loads as it is."""
    file = subject.model_file
    own = moved(file) * (_NEARLY_NOTHING if armature(file) else 1.0)
    kind = {"name": subject.name, "type": "hinge" if file.axis == "rotary" else "slide", "axis": "0 0 1"}
    inertial = {"pos": "0 0 0", "mass": own, "diaginertia": " ".join([f"{own:g}"] * 3)}
    lines = [
        element("mujoco", {"model": subject.name}, is_open=True),
        f"  {element('option', {'gravity': '0 0 0', 'timestep': timestep})}",
        "  <worldbody>",
        "    <body>",
        f"      {element('joint', kind | joint)}",
        f"      {element('inertial', inertial)}",
        "    </body>",
        "  </worldbody>",
        *actuator,
        "</mujoco>",
    ]
    return "\n".join(lines) + "\n"
