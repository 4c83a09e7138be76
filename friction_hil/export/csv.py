"""CSV: the steady torque over velocity and temperature, each direction by itself."""

import csv
import io

import numpy as np

from friction_hil.export.lossy import Converted, break_away, judge, number
from friction_hil.export.points import Points
from friction_hil.export.subject import Subject, provenance
from friction_hil.friction import FrictionModel
from friction_hil.numerics.jit import Array
from friction_hil.printable import on_one_line

_ROWS = 60  # of each direction
_SLOWEST = 1e-4  # of the largest speed: the first row beside rest


def convert(subject: Subject, points: Points) -> Converted:
    """Write torque over velocity, one column per temperature; between the rows the reader interpolates."""
    file = subject.model_file
    model = file.friction_model
    velocity = _velocities(points)
    celsius = np.unique(points.temperature)
    table = np.stack([_torque(model, velocity, each) for each in celsius], axis=1)

    def read(at: Points) -> Array:
        columns = np.stack([np.interp(at.velocity, velocity, each) for each in table.T], axis=1)
        own = np.zeros(at.velocity.size, int) if np.isnan(celsius[0]) else np.searchsorted(celsius, at.temperature)
        return np.asarray(columns[np.arange(own.size), own])

    loss = judge(file, points, read, carried=["directions"])
    torque, speed = ("N m", "rad/s") if file.axis == "rotary" else ("N", "m/s")
    names = ["torque" if np.isnan(each) else f"torque_at_{each:g}_degC" for each in celsius]
    words = [
        *provenance(subject),
        *loss.lines(),
        f"Break-away: {break_away(model, points):.6g} {torque}, the mean of both directions.",
        f"Columns: velocity, {speed}; torque, {torque}, which opposes it; read it linearly between the rows.",
    ]
    text = io.StringIO()
    for line in map(on_one_line, words):
        text.write(f"# {line}\n")
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["velocity", *names])
    writer.writerows([number(v), *(number(each) for each in row)] for v, row in zip(velocity, table, strict=True))
    return Converted({f"{subject.name}.csv": text.getvalue()}, {"rows": int(velocity.size), "columns": names}, loss)


def _velocities(points: Points) -> Array:
    """Return the velocities of the rows, rising, denser at rest; none is zero."""
    unit = np.geomspace(_SLOWEST, 1.0, _ROWS)
    sides = [points.low * unit[::-1]] if points.low < 0.0 else []
    return np.concatenate([*sides, *([points.high * unit] if points.high > 0.0 else [])])


def _torque(model: FrictionModel, velocity: Array, celsius: float) -> Array:
    load = 0.0 if model.depends_on_load else None
    return model.steady_state(velocity, load_torque=load, temperature=None if np.isnan(celsius) else float(celsius))
