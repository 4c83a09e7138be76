"""The report of the circularity test: pictures, figures, what was learned, parameters of plant and compensator."""

import html
import itertools
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from friction_hil import __version__
from friction_hil.analysis.circularity import Circularity, Laps
from friction_hil.daemon import learning_words
from friction_hil.friction.parameters import COULOMB, STATIC, STRIBECK_VELOCITY, VISCOUS
from friction_hil.reports.circularity_picture import draw_error, draw_friction, draw_lap_errors
from friction_hil.reports.figures import LEARNED, WITH, WITHOUT
from friction_hil.reports.numbers import digits, figure_rows, unit_of_figures
from friction_hil.reports.page import generator, page, picture, table

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from friction_hil.friction import FrictionModel

MARK = generator("demo")

_STYLE = f"""
figure.circle img {{ display: block; width: 100%; max-width: 46rem; margin: auto }}
figure.circles img {{ display: block; width: 100% }}
.without {{ color: {WITHOUT}; font-weight: 600 }} .with {{ color: {WITH}; font-weight: 600 }}
.learned {{ color: {LEARNED}; font-weight: 600 }}
""".lstrip()


def write_report(
    path: Path, circularity: Circularity, circle: "Figure", loop: Mapping[str, Any], notes: str, pace: str
) -> None:
    """Write the report; an existing file is overwritten. ``circle`` is the picture.

    ``loop``: ``cycles``, ``late_p50_us``, ``late_p99_us``, ``missed`` and ``learning`` of the output of ``friction-hil
    run --json``. ``notes``: messages of the daemon. ``pace``: ``real`` or ``sync``.
    """
    first, second = circularity.axes
    has_learned = circularity.learned is not None
    caption = _CIRCLE_CAPTION.format(x=first, y=second) + _BESIDE_CAPTION * has_learned
    body = f"""
<h1>Friction compensation on a circle of two axes</h1>
<p><strong>{html.escape(_result(circularity))}</strong> {_what_ran(circularity, pace)}</p>
{picture(circle, caption, "circles" if has_learned else "circle")}
<h2>Figures</h2>
{_figures(circularity)}
<p class="note">{_left_out(circularity)}</p>
{_loop(circularity, loop, pace)}
{_learning(circularity, loop)}
<h2>Following error over time</h2>
{picture(draw_error(circularity), _ERROR_CAPTION, "wide")}
<h2>Friction over velocity</h2>
{picture(draw_friction(circularity), _FRICTION_CAPTION, "wide")}
<h2>Parameters of the axes and of the compensator</h2>
<p>The compensator's model and parameters deviate from the true ones on purpose, as they always do on a real axis.
{_LEARNED_NOTE if has_learned else ""}</p>
{"".join(_parameters(circularity, axis) for axis in circularity.axes)}
<h2>Control loops of the drive, the same in all laps</h2>
{_loops(circularity)}
<h2>Messages of the daemon</h2>
<pre>{html.escape(notes.strip() or "nothing")}</pre>
<p class="note">friction-hil {__version__}. The recording beside this file holds every cycle and the whole
configuration; <code>friction-hil replay RECORDING --verify</code> runs the compensator again, bit for bit.</p>
"""
    title = "friction-hil: circularity without and with compensation, and after learning"
    path.write_text(page(title, f'{MARK} {__version__}">', body, _STYLE), encoding="utf-8")


_REMEDY = "friction-hil demo --pace sync does without real time"
_NAMES = ("without compensation", "with the model as given", "after learning")  # of the laps
_CIRCLE_CAPTION = (
    "Distance from the centre minus the nominal radius, over the angle. Where {x} or {y} reverses, friction changes "
    "its sign faster than the control loops of the drive can react: the axis lags behind, which causes a spike."
)
_BESIDE_CAPTION = (
    " On the right the laps with compensation alone, magnified more. The waves between the reversals are cogging, of "
    "which the model as given knows nothing."
)
_ERROR_CAPTION = (
    "The whole run. Shaded: the complete laps in steady motion that the figures refer to. Dotted: learning changed "
    "parameters or gain. Grey: the computer was late."
)
_LAP_CAPTION = (
    "Shaded: the laps that the figures refer to. Dotted: learning changed parameters or gain, first by a third of the "
    "change, then by the whole; what does not lower the error is taken back."
)
_LEARNED_NOTE = (
    "Learned are the values with which the simpler model follows the torque of this motion best. They need not be the "
    "true ones, least of all the stiffness, which stands for that of several springs in turn."
)
_FRICTION_CAPTION = (
    "Lines: friction at constant velocity, true and of the compensator's models. Blue: the torque that was added in "
    "the laps with the model as given, over the estimated velocity: the model's friction times the gain, with the "
    "presliding of the bristle around zero."
)


def _what_ran(circularity: Circularity, pace: str) -> str:
    period = f"{circularity.configuration.period_s * 1e3:g} ms"
    time = "in real time" if pace == "real" else "in simulated time, one period for each SYNC"
    return (
        f"The daemon, its CANopen driver and two simulated CiA 402 drives ran as separate processes on a virtual CAN "
        f"bus, with a period of {period}, {time}. All laps come from one run, in which only the added friction torque "
        "differs: none at first, then that of the model as given, then that of the model as it was refined from the "
        "motion (<code>compensation: {learning: on}</code>, which is off by default)."
    )


def _result(circularity: Circularity) -> str:
    """Return the outcome in a sentence or two."""
    if circularity.not_helped:
        return f"Compensation did not help: {', '.join(circularity.not_helped)}."
    text = f"With compensation the RMS following error is {_factors(circularity, circularity.compensated)}"
    if circularity.learned is None:
        return f"{text}."
    text += f", after learning {_factors(circularity, circularity.learned)}."
    if circularity.learning_not_helped:
        text += f" Not lower after learning: {', '.join(circularity.learning_not_helped)}."
    return text


def _factors(circularity: Circularity, laps: Laps) -> str:
    factors = {axis: digits(circularity.factor(axis, "rms", laps), 2) for axis in circularity.axes}
    return " and ".join(f"{factor} times smaller on {axis}" for axis, factor in factors.items())


def learning_lines(circularity: Circularity, loop: Mapping[str, Any]) -> list[str]:
    """Return what learning has done for each axis, and what that means for the laps after learning."""
    reports = loop.get("learning", {}).get("axes", {})
    lines = [learning_words.last_line(axis, report) for axis, report in reports.items()]
    if reports and circularity.learned is None:
        lines.append("There are no laps with what was learned: learning has kept nothing, or too late.")
    is_late = loop["missed"] > 0 or any(each.left_out for each in circularity.laps)
    if reports and is_late and (circularity.learned is None or circularity.learning_not_helped):
        lines.append(f"The computer was late at times, which costs learning its motion: {_REMEDY}.")
    return lines


def _learning(circularity: Circularity, loop: Mapping[str, Any]) -> str:
    lines = learning_lines(circularity, loop)
    if not lines:
        return ""
    shown = picture(draw_lap_errors(circularity), _LAP_CAPTION, "wide")
    return f"<h2>Learning</h2>\n<pre>{html.escape(chr(10).join(lines))}</pre>\n{shown}"


def _figures(circularity: Circularity) -> str:
    factor, unit = unit_of_figures(circularity)
    shown = [
        (f"following error of {axis}, {name}", errors, ratios)
        for axis, name, errors, ratios in figure_rows(circularity)
    ]
    first, *others = (each.circular_range for each in circularity.laps)
    ranges = [digits(each * factor) for each in (first, *others)], [digits(first / each, 2) for each in others]
    rows: list[tuple[str, ...]] = []
    for name, (without, *errors), ratios in [*shown, ("radius error, largest minus smallest", *ranges)]:
        rows.append((name, unit, without, *itertools.chain(*zip(errors, ratios, strict=True))))
    header = ("", "unit", "without", "model as given", "times smaller", "after learning", "times smaller")
    return table(header[: len(rows[0])], rows, ("", "without", "with", "", "learned", ""))


def _left_out(circularity: Circularity) -> str:
    laps = circularity.laps
    text = f"{laps[0].count} laps each, {laps[0].rows} periods. "
    if any(each.left_out for each in laps):
        shown = ", ".join(f"{each.left_out} {name}" for each, name in zip(laps, _NAMES, strict=False))
        text += f"Left out, because the computer was late in them or shortly before: {shown}."
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
    """Return a table of the parameters of plant and compensator, as given and as learned, side by side."""
    plant: Any = circularity.configuration.axes[axis].simulation
    settings = [circularity.configuration.axes[axis]]
    if axis in circularity.learned_axes:
        settings.append(circularity.learned_axes[axis])
    true = _quantities(plant.friction_model, plant.mechanics.inertia, plant.motor.torque_lag_s, circularity.unit)
    assumed = [
        _quantities(each.model.friction_model, mechanics.inertia, mechanics.torque_lag_s, circularity.unit)
        for each in settings
        for mechanics in (each.model.mechanics,)
    ]
    rows = []
    for (name, unit, value, meaning), *others in zip(true, *assumed, strict=True):
        values = [each[2] for each in others]
        if value is None or None in values:
            continue  # a quantity that one of the models has not
        cells = [cell for each in values for cell in (f"{each:.4g}", _difference(each, value))]
        note = f"<span class='note'>{html.escape(meaning)}</span>"
        rows.append((html.escape(name), unit, f"{value:g}", *cells, note))
    names = ("compensator", "learned")[: len(settings)]
    header = (f"<strong>{axis}</strong>", "unit", "true", *itertools.chain(*((name, "difference") for name in names)))
    notes = [f"True: {plant.friction_model}."]
    for name, each in zip(names, settings, strict=True):
        notes.append(f"{name.capitalize()}: {each.model.friction_model}; gain {each.compensation.gain:.3g}.")
    paragraphs = "".join(f'<p class="note">{html.escape(note)}</p>' for note in notes)
    return table((*header, ""), rows, ("", "", *["", ""] * len(names), "text")) + paragraphs


def _difference(value: float, true: float) -> str:
    return f"{round(100.0 * (value / true - 1.0)):+d} %".replace("-", "−") if value != true else ""


def _quantities(
    model: "FrictionModel", inertia: float, torque_lag_s: float, position_unit: str
) -> list[tuple[str, str, float | None, str]]:
    """Return name, unit, value and meaning of what a plant and the model of its axis have."""
    is_rotary = position_unit == "rad"
    return [
        *(
            (name, unit if is_rotary else unit.replace("N m", "N").replace("rad", "m"), value, meaning)
            for name, unit, value, meaning in _shared_quantities(model)
        ),
        ("inertia", "kg m²" if is_rotary else "kg", inertia, "motor and load"),
        ("torque_lag_s", "s", torque_lag_s, "time constant of the torque"),
    ]


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
