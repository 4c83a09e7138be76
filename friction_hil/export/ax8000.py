"""Friction parameters of Beckhoff's AX8000 and AMP8000 drives, object 3144h of the velocity controller.

Source: Beckhoff Information System, "AX8xxx, Axis module, Object dictionary", 3144:01 "Static friction spring rate"
(N m/rad), 3144:02 "Static friction torque/force" (N m), 3144:03 "Dynamic friction factor in relation with the feed
forward velocity" (N m s/rad); 3141:08 shows the sum. The units are those of the drive's default scaling. The page does
not print the formula; taken is a spring with this rate that yields at this torque, and a viscous part.
"""

import csv
import io

from friction_hil.export.lossy import Converted, fit_viscous, judge, number
from friction_hil.export.points import Points
from friction_hil.export.subject import Subject, provenance
from friction_hil.printable import on_one_line


def convert(subject: Subject, points: Points) -> Converted:
    """Fit the level and the viscous factor, and write the list of objects."""
    file = subject.model_file
    fit = fit_viscous(points, points.torque(file.friction_model))
    stiffness = file.friction_model.presliding_stiffness
    shape = ["Presliding has the stiffness of the model (3144:01), not its shape."] if stiffness > 0.0 else []
    loss = judge(file, points, lambda at: fit.torque(at.velocity), shape, ["presliding"] if shape else [])
    torque, angle = ("N m", "rad") if file.axis == "rotary" else ("N", "m")
    rows = [
        ("3144", "02", "Static friction torque/force", fit.coulomb, torque),
        ("3144", "03", "Dynamic friction factor", fit.viscous[0], f"{torque} s/{angle}"),
    ]
    notes = [
        "Values at the axis of the model file; check scaling and gear of the drive before they are entered.",
        "3141:08 of the drive shows the resulting torque: compare it with the model before relying on it.",
        "No drive has been tried.",
    ]
    if stiffness > 0.0:
        rows.insert(0, ("3144", "01", "Static friction spring rate", stiffness, f"{torque}/{angle}"))
    else:
        notes.append("3144:01, the spring rate, is left as it is: the model has no presliding.")
    text = io.StringIO()
    for line in [*provenance(subject), *map(on_one_line, (*loss.lines(), *notes))]:
        text.write(f"# {line}\n")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["index", "subindex", "name", "value", "unit"])
    writer.writerows([*head, number(value), unit] for *head, value, unit in rows)
    parameters = {f"{index}:{sub}": value for index, sub, _, value, _ in rows}
    return Converted({f"{subject.name}.csv": text.getvalue()}, parameters, loss)
