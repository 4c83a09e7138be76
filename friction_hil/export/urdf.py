"""URDF: a robot of one joint with ``<dynamics damping friction>``.

Source: the URDF specification of ROS, element joint: ``damping`` is the viscous coefficient, N m s/rad or N s/m,
``friction`` the static friction, N m or N. Simulators take it for the Coulomb level while sliding. MuJoCo's importer
makes it the ``frictionloss`` of a joint, as soft as MuJoCo's default: URDF has no place for ``solreffriction``.
"""

from friction_hil.export.lossy import Converted, fit_viscous, judge
from friction_hil.export.mujoco_friction import DEFAULT, STIFF, words
from friction_hil.export.points import Points, identified
from friction_hil.export.subject import Subject
from friction_hil.export.xml_text import element, head

_UNKNOWN_MASS = 1.0


def convert(subject: Subject, points: Points) -> Converted:
    """Fit Coulomb level and viscous coefficient, and write the file."""
    file = subject.model_file
    fit = fit_viscous(points, points.torque(file.friction_model))
    parameters = {"damping": fit.viscous[0], "friction": fit.coulomb}
    known = file.mechanics.inertia > 0.0
    inertia = file.mechanics.inertia or _UNKNOWN_MASS
    creep = DEFAULT.creep(fit.coulomb, inertia)
    held = judge(file, points, lambda at: fit.torque(at.velocity))
    soft = [
        f"{DEFAULT.sentence(fit.coulomb, inertia, file.axis)} The loss is the one there. Where a simulator holds the "
        f"joint, or MuJoCo's joint is given {words(STIFF.attributes())}, it is {held.amount()}."
    ]
    loss = judge(file, points, lambda at: fit.torque(at.velocity, creep), soft if creep > 0.0 else [])
    notes = [
        "Copy the element dynamics into a joint of your robot; the links are there to make the file complete."
        + ("" if known else " The inertia of the model file is not known: 1 stands for it."),
    ]
    text = f'<?xml version="1.0"?>\n{head(subject, loss, notes)}\n' + _robot(subject, parameters)
    return Converted({f"{subject.name}.urdf": text}, parameters, loss)


def _robot(subject: Subject, dynamics: dict[str, float]) -> str:
    file = subject.model_file
    inertia = file.mechanics.inertia or _UNKNOWN_MASS
    is_rotary = file.axis == "rotary"
    mass = _UNKNOWN_MASS if is_rotary else inertia
    about = inertia if is_rotary else _UNKNOWN_MASS
    tensor = {"ixx": about, "iyy": about, "izz": about, "ixy": "0", "ixz": "0", "iyz": "0"}
    travel = identified(file, "position") or (-1.0, 1.0)
    speed = max(map(abs, identified(file, "velocity") or (1.0,)))
    limit = {"lower": travel[0], "upper": travel[1], "effort": "1000", "velocity": speed}
    joint = {"name": subject.name, "type": "continuous" if is_rotary else "prismatic"}
    lines = [
        element("robot", {"name": subject.name}, is_open=True),
        '  <link name="base"/>',
        '  <link name="moving">',
        "    <inertial>",
        f"      {element('mass', {'value': mass})}",
        f"      {element('inertia', tensor)}",
        "    </inertial>",
        "  </link>",
        f"  {element('joint', joint, is_open=True)}",
        '    <parent link="base"/>',
        '    <child link="moving"/>',
        f'    <axis xyz="{"0 0 1" if is_rotary else "1 0 0"}"/>',  # across gravity
        *([] if is_rotary else [f"    {element('limit', limit)}"]),
        f"    {element('dynamics', dynamics)}",
        "  </joint>",
        "</robot>",
    ]
    return "\n".join(lines) + "\n"
