"""JSON of BAM (Rhoban, Better Actuator Models): m1, m2 with a Stribeck hump, m3 and m4 with friction that load raises.

`friction_hil.models.bam_file` has BAM's law. The share k of the load friction, the same for motor and load, gives this
model's ``motoring`` 2 k / (1 - k); in steady motion BAM divides all other friction by 1 - k.
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
    load = file.friction_model.modifiers.get("load", {"motoring": 0.0, "driven": 0.0})
    share = load["motoring"] / (2.0 + load["motoring"])
    parameters = {"friction_base": fit.sliding.coulomb, "friction_viscous": fit.sliding.viscous[0]}
    if fit.hump > 0.0:
        parameters["friction_stribeck"] = fit.hump
    parameters = {name: (1.0 - share) * each for name, each in parameters.items()}
    if fit.hump > 0.0:
        parameters |= {"dtheta_stribeck": fit.velocity, "alpha": fit.exponent}
    if share > 0.0:
        parameters |= {"load_friction_base": share} | ({"load_friction_stribeck": 0.0} if fit.hump > 0.0 else {})
    if file.mechanics.inertia > 0.0:
        parameters["armature"] = file.mechanics.inertia
    if file.mechanics.delay_s > 0.0:
        parameters["command_delay"] = file.mechanics.delay_s
    level, inertia = fit.sliding.coulomb + fit.hump, file.mechanics.inertia or 1.0
    soft = [
        f"{DEFAULT.sentence(level, inertia, file.axis)} BAM's controller for MuJoCo sets its level only: give it "
        f"{words(STIFF.attributes())}."
    ]
    lost = soft if level > 0.0 else []
    if share > 0.0:
        lost.append(
            f"Load that drives the motor: {load['driven']:g} of it here; BAM's friction falls with a small one, and "
            f"grows by {2.0 * share / (1.0 + share):.3g} of a large one."
        )
    loss = judge(file, points, lambda at: fit.torque(at.velocity), lost, {"load"} if share > 0.0 else ())
    imported = (file.fit or {}).get("imported", {})
    motor = imported.get("motor", {}) if imported.get("format") == "bam" else {}
    notes = ["BAM takes defaults for what is absent."]
    if not motor.get("actuator"):
        notes.insert(0, "Fill in actuator, a name that BAM knows, and kt and R of its motor.")
    numbers = {name: rounded(value) for name, value in parameters.items()}
    model = ("m4" if fit.hump > 0.0 else "m3") if share > 0.0 else ("m2" if fit.hump > 0.0 else "m1")
    content = {**numbers, "model": model, "actuator": "", **motor}
    return Converted({f"{subject.name}.json": document(subject, loss, notes, content)}, numbers, loss)
