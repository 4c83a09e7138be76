"""JSON of BAM (Rhoban, Better Actuator Models), model m2, or m1 where there is no Stribeck hump.

Source: BAM's ``bam/model.py`` and its files ``bam/params/*/m2.json``. Friction while sliding is ``friction_base`` +
``friction_stribeck`` exp(-(|v| / ``dtheta_stribeck``)^``alpha``) + ``friction_viscous`` |v|, SI. The models m3 to m6
add friction that grows with the difference of motor torque and external torque, which contains the friction itself; the
modifier ``load`` has no such form, and is lost.
"""

from friction_hil.errors import UsageError
from friction_hil.export.json_text import document, rounded
from friction_hil.export.lossy import Converted, fit_stribeck, judge
from friction_hil.export.mujoco_friction import DEFAULT, STIFF, words
from friction_hil.export.points import Points
from friction_hil.export.subject import Subject

_EXPONENTS = (0.5, 10.0)


def convert(subject: Subject, points: Points) -> Converted:
    """Fit the Stribeck curve and write the file."""
    file = subject.model_file
    if file.axis != "rotary":
        raise UsageError("bam describes rotary actuators; this axis is linear")
    fit = fit_stribeck(points, points.torque(file.friction_model), exponents=_EXPONENTS)
    parameters = {"friction_base": fit.sliding.coulomb, "friction_viscous": fit.sliding.viscous[0]}
    if fit.hump > 0.0:
        parameters |= {"friction_stribeck": fit.hump, "dtheta_stribeck": fit.velocity, "alpha": fit.exponent}
    if file.mechanics.inertia > 0.0:
        parameters["armature"] = file.mechanics.inertia
    if file.mechanics.delay_s > 0.0:
        parameters["command_delay"] = file.mechanics.delay_s
    level, inertia = fit.sliding.coulomb + fit.hump, file.mechanics.inertia or 1.0
    soft = [
        f"{DEFAULT.sentence(level, inertia, file.axis)} BAM's controller for MuJoCo sets its level only: give it "
        f"{words(STIFF.attributes())}."
    ]
    loss = judge(file, points, lambda at: fit.torque(at.velocity), soft if level > 0.0 else [])
    notes = [
        "Fill in actuator, a name that BAM knows, and kt and R of its motor. BAM takes defaults for what is absent."
    ]
    numbers = {name: rounded(value) for name, value in parameters.items()}
    content = {**numbers, "model": "m2" if fit.hump > 0.0 else "m1", "actuator": ""}
    return Converted({f"{subject.name}.json": document(subject, loss, notes, content)}, numbers, loss)
