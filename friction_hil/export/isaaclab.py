"""Values of an actuator group of Isaac Lab, for PhysX and for Newton.

Source: Isaac Lab 3, ``isaaclab/actuators/actuator_base_cfg.py``: ``friction`` is the static (Coulomb) effort,
``dynamic_friction`` the effort while the joint moves, N m or N, ``viscous_friction`` the coefficient of the velocity,
``armature`` is added to the joint's inertia. PhysX has the two levels. Newton (MJWarp) has one, ``friction``, as the
dry friction of MuJoCo, with its default softness; there the fitted level is the one to take.
"""

from friction_hil.export.json_text import document, rounded
from friction_hil.export.lossy import Converted, break_away, fit_viscous, judge
from friction_hil.export.mujoco_friction import DEFAULT
from friction_hil.export.points import Points
from friction_hil.export.subject import Subject


def convert(subject: Subject, points: Points) -> Converted:
    """Fit the level while sliding and the viscous coefficient, and write the file."""
    file = subject.model_file
    model = file.friction_model
    fit = fit_viscous(points, points.torque(model))
    inertia = file.mechanics.inertia or 1.0
    creep = DEFAULT.creep(fit.coulomb, inertia)
    in_newton = judge(file, points, lambda at: fit.torque(at.velocity, creep))
    soft = f"{DEFAULT.sentence(fit.coulomb, inertia, file.axis, 'In Newton')} The loss there is {in_newton.amount()}."
    loss = judge(file, points, lambda at: fit.torque(at.velocity), [soft] if creep > 0.0 else [])
    common = {"viscous_friction": rounded(fit.viscous[0])}
    if file.mechanics.inertia > 0.0:
        common["armature"] = rounded(file.mechanics.inertia)
    sliding = rounded(fit.coulomb)
    static = max(rounded(break_away(model, points)), sliding)  # PhysX wants no level at rest below that of sliding
    content = {
        "physx": {"friction": static, "dynamic_friction": sliding, **common},
        "newton": {"friction": sliding, **common},
    }
    if file.axis == "linear":  # its dry friction would be soft: see `mjcf.armature`
        content["newton"].pop("armature", None)
    notes = [
        "Pass one of the two objects to an actuator group: ImplicitActuatorCfg(joint_names_expr=[...], **values).",
        "For Isaac Sim 5.0 and later; before, friction was a coefficient without a unit.",
    ]
    text = document(subject, loss, notes, content)
    return Converted({f"{subject.name}.json": text}, content, loss)
