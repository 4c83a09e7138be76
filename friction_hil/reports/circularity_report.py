"""The report of the circularity test: pictures, figures, and the parameters of plant and compensator."""

import html
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from friction_hil import __version__
from friction_hil.analysis.circularity import Circularity
from friction_hil.friction.parameters import COULOMB, STATIC, STRIBECK_VELOCITY, VISCOUS
from friction_hil.reports.circularity_picture import draw_error, draw_friction
from friction_hil.reports.figures import WITH, WITHOUT
from friction_hil.reports.numbers import digits, unit_of_figures
from friction_hil.reports.page import generator, page, picture, table

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from friction_hil.friction import FrictionModel

MARK = generator("demo")

_STYLE = f"""
figure.circle img {{ display: block; width: 100%; max-width: 46rem; margin: auto }}
.without {{ color: {WITHOUT}; font-weight: 600 }} .with {{ color: {WITH}; font-weight: 600 }}
""".lstrip()


def write_report(
    path: Path, circularity: Circularity, circle: "Figure", loop: Mapping[str, Any], notes: str, pace: str
) -> None:
    """Write the report.

    Parameters
    ----------
    path : Path
        The HTML file; overwritten.
    circularity : Circularity
    circle : Figure
        Its picture.
    loop : dict
        ``cycles``, ``late_p50_us``, ``late_p99_us`` and ``missed`` of the output of ``friction-hil run --json``.
    notes : str
        Messages of the daemon.
    pace : str
        ``real`` or ``sync``.
    """
    first, second = circularity.axes
    factors = [f"{digits(circularity.factor(axis, 'rms'), 2)} times smaller on {axis}" for axis in circularity.axes]
    result = f"With compensation the RMS following error is {' and '.join(factors)}."
    if circularity.not_helped:
        result = f"Compensation did not help: {', '.join(circularity.not_helped)}."
    body = f"""
<h1>Friction compensation on a circle of two axes</h1>
<p><strong>{html.escape(result)}</strong> {_what_ran(circularity, pace)}</p>
{picture(circle, _CIRCLE_CAPTION.format(x=first, y=second), "circle")}
<h2>Figures</h2>
{_figures(circularity)}
<p class="note">{_left_out(circularity)}</p>
{_loop(circularity, loop, pace)}
<h2>Following error over time</h2>
{picture(draw_error(circularity), _ERROR_CAPTION, "wide")}
<h2>Friction over velocity</h2>
{picture(draw_friction(circularity), _FRICTION_CAPTION, "wide")}
<h2>Parameters of the axes and of the compensator</h2>
<p>The compensator's model and parameters deviate from the true ones on purpose, as they always do on a real axis.</p>
{"".join(_parameters(circularity, axis) for axis in circularity.axes)}
<h2>Control loops of the drive, the same in all laps</h2>
{_loops(circularity)}
<h2>Messages of the daemon</h2>
<pre>{html.escape(notes.strip() or "nothing")}</pre>
<p class="note">friction-hil {__version__}. The recording beside this file holds every cycle and the whole
configuration; <code>friction-hil replay RECORDING --verify</code> runs the compensator again, bit for bit.</p>
"""
    title = "friction-hil: circularity without and with compensation"
    path.write_text(page(title, f'{MARK} {__version__}">', body, _STYLE), encoding="utf-8")


_CIRCLE_CAPTION = (
    "Distance from the centre minus the nominal radius, over the angle. Where {x} or {y} reverses, friction changes "
    "its sign faster than the control loops of the drive can react: the axis lags behind, which causes a spike."
)
_ERROR_CAPTION = (
    "The whole run. Shaded: the complete laps in steady motion that the figures refer to. Grey: the computer was late."
)
_FRICTION_CAPTION = (
    "Lines: friction at constant velocity, true and of the compensator's model. Blue: the torque that was added in the "
    "laps with compensation, over the estimated velocity: the model's friction times the gain, with the presliding of "
    "the bristle around zero."
)


def _what_ran(circularity: Circularity, pace: str) -> str:
    period = f"{circularity.configuration.period_s * 1e3:g} ms"
    time = "in real time" if pace == "real" else "in simulated time, one period for each SYNC"
    return (
        f"The daemon, its CANopen driver and two simulated CiA 402 drives ran as separate processes on a virtual CAN "
        f"bus, with a period of {period}, {time}. Laps without and with compensation come from one run, in which "
        "only the added friction torque differs."
    )


def _figures(circularity: Circularity) -> str:
    factor, unit = unit_of_figures(circularity)
    before, after = circularity.uncompensated, circularity.compensated
    rows = []
    for axis in circularity.axes:
        for name in ("rms", "peak"):
            values = [digits(getattr(laps.figures[axis], name) * factor) for laps in (before, after)]
            times = digits(circularity.factor(axis, name), 2)
            rows.append((f"following error of {axis}, {name}", unit, *values, times))
    ranges = before.circular_range, after.circular_range
    rows.append(
        (
            "radius error, largest minus smallest",
            unit,
            *(digits(value * factor) for value in ranges),
            digits(ranges[0] / ranges[1], 2),
        )
    )
    header = ("", "unit", "without", "with compensation", "times smaller")
    return table(header, rows, ("", "without", "with", ""))


def _left_out(circularity: Circularity) -> str:
    before, after = circularity.uncompensated, circularity.compensated
    text = f"{before.count} laps each, {before.rows} periods. "
    if before.left_out or after.left_out:
        text += (
            f"{before.left_out} of them without and {after.left_out} with compensation are left out: the computer "
            "was late in them or shortly before."
        )
    return text


def _loop(circularity: Circularity, loop: Mapping[str, Any], pace: str) -> str:
    period = f"{circularity.configuration.period_s * 1e3:g} ms"
    if pace == "sync":
        return f"<p>Loop: {loop['cycles']} cycles of {period}, in simulated time.</p>"
    return (
        f"<p>Loop: {loop['cycles']} cycles of {period}; a cycle began late by {digits(loop['late_p50_us'], 1)} µs in "
        f"the median and by {digits(loop['late_p99_us'], 1)} µs at the 99th percentile; {loop['missed']} missed.</p>"
    )


def _parameters(circularity: Circularity, axis: str) -> str:
    """Return a table of the parameters of plant and compensator, side by side."""
    config = circularity.configuration.axes[axis]
    plant: Any = config.simulation
    is_rotary = circularity.unit == "rad"
    true_model, model = plant.friction_model, config.model.friction_model
    rows = [
        (name, unit if is_rotary else unit.replace("N m", "N").replace("rad", "m"), true, assumed, meaning)
        for (name, unit, true, meaning), (*_, assumed, _) in zip(
            _shared_quantities(true_model), _shared_quantities(model), strict=True
        )
        if true is not None and assumed is not None
    ]
    mechanics = config.model.mechanics
    rows.append(
        ("inertia", "kg m²" if is_rotary else "kg", plant.mechanics.inertia, mechanics.inertia, "motor and load")
    )
    rows.append(("torque_lag_s", "s", plant.motor.torque_lag_s, mechanics.torque_lag_s, "time constant of the torque"))
    cells = [
        (
            html.escape(name),
            unit,
            f"{true:g}",
            f"{assumed:g}",
            f"{100.0 * (assumed / true - 1.0):+.0f} %".replace("-", "−") if assumed != true else "",
            f"<span class='note'>{html.escape(meaning)}</span>",
        )
        for name, unit, true, assumed, meaning in rows
    ]
    header = (f"<strong>{axis}</strong>", "unit", "true", "compensator", "difference", "")
    notes = (
        f"True: {true_model}.",
        f"Compensator: {model}.",
        f"Gain of the compensation on {axis}: {config.compensation.gain:g}.",
    )
    paragraphs = "".join(f'<p class="note">{html.escape(note)}</p>' for note in notes)
    return table(header, cells, ("", "", "", "", "text")) + paragraphs


def _shared_quantities(model: "FrictionModel") -> list[tuple[str, str, float | None, str]]:
    """Return name, unit, value and meaning of quantities that most models have; value None if this one has not."""
    named = [
        (each.name, each.unit, model.parameters.get(each.name), each.meaning)
        for each in (COULOMB, STATIC, STRIBECK_VELOCITY)
    ]
    stiffness = ("presliding stiffness", "N m/rad", model.presliding_stiffness or None, "torque over position at rest")
    viscous = (
        VISCOUS.name,
        VISCOUS.unit,
        model.parameters.get("viscous", model.parameters.get("sigma2")),
        VISCOUS.meaning,
    )
    return [stiffness, *named, viscous]


def _loops(circularity: Circularity) -> str:
    plants: list[Any] = [circularity.configuration.axes[axis].simulation for axis in circularity.axes]
    fields = type(plants[0].loops).model_fields
    rows = []
    for name, field in fields.items():
        values = [getattr(plant.loops, name) for plant in plants]
        if all(value is None for value in values):
            continue  # a part that these drives have not
        rows.append((name, *map(_shown, values), f"<span class='note'>{html.escape(field.description or '')}</span>"))
    return table(("", *circularity.axes, ""), rows, ("", "", "text"))


def _shown(value: object) -> str:
    if isinstance(value, bool):
        return "yes" if value else "no"
    return f"{value:g}" if isinstance(value, int | float) else html.escape("none" if value is None else str(value))
