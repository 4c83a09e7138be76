"""The picture of a friction model: torque over velocity, over position in a slow cycle, and ripple."""

import math
import textwrap
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from friction_hil import friction as models
from friction_hil.errors import UsageError
from friction_hil.friction import FrictionModel
from friction_hil.friction.steady_curve import velocity_range
from friction_hil.numerics.jit import Array
from friction_hil.reports.figures import BLUE, GREEN, INK, ORANGE, new_figure_for, save
from friction_hil.reports.numbers import readable

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_MAIN, _OTHER, _THIRD = BLUE, ORANGE, GREEN
_FAINT = "#888888"

_SLOW = 1e-3  # speed of the slow cycle, as a fraction of the velocity axis
_SETTLED = 0.9  # of the largest torque: end of the presliding from rest
_SOFTEST = 1e12  # rad: a level that takes longer to build up is not drawn
_STROKE = 2.0  # travel of the cycle to either side, in presliding distances
_INNER_TOP = 0.8  # of the largest torque: start of the inner loop
_INNER_LENGTH = 0.6  # of the distance back to the other end: length of the inner loop
_SAMPLES = 400  # of a leg of the cycle
_LONGEST = 20_000  # samples in which a network without a stiffness comes to slide
_TEMPERATURE_STEP = 20.0  # K


@dataclass(frozen=True, slots=True)
class SlowCycle:
    """A slow motion from rest to one end, to the other end and back, with a small loop on the last leg."""

    position: Array  # (n,), rad; for a static map, which has no length scale, a fraction of the stroke
    torque: Array  # (n,), N m
    # (n,), 0 from rest to the first end; 1 to the other end; 2 back to the small loop; 3 and 4 the small loop; 5 on to
    # the first end
    leg: NDArray[np.int64]
    velocity: float  # rad/s


def draw(model: FrictionModel, path: Path, title: str) -> None:
    """Draw a model into a file; the suffix gives the format.

    ``title``: heading; the parameters are listed below the panels. Raises `UsageError`: matplotlib is not installed, or
    does not know the suffix; `FrictionHilError`: the file cannot be written.
    """
    painters = [_draw_velocity, _draw_cycle]
    if model.modifiers.get("ripple"):
        painters.append(_draw_ripple)
    figure = new_figure_for(path, 5.4 * len(painters), 5.0)
    for axes, paint in zip(figure.subplots(1, len(painters), squeeze=False)[0], painters, strict=True):
        paint(axes, model)
        axes.axhline(0.0, color=_FAINT, linewidth=0.6, zorder=0)
        axes.set_ylabel(_words(model, "friction torque [N m]"))
    figure.suptitle(title)
    figure.supxlabel("\n".join(textwrap.wrap(_caption(model), 78 * len(painters))[:4]), fontsize=8.5, color=INK)
    save(figure, path)


def slow_cycle(model: FrictionModel) -> SlowCycle:
    """Move a model, without its ripple, through a cycle that shows its presliding or its jump at a reversal."""
    velocity = _SLOW * velocity_range(model)
    if model.family.is_static:
        band = max(float(side.get("stick_velocity", 0.0)) for side in _sides(model))
        return _move(model, max(velocity, 2.0 * band), [1.0, -1.0, 0.2, -0.4, 0.2, 1.0])
    stiffness = model.presliding_stiffness
    if model.network is not None and not stiffness > 0.0:
        return _cycle_of_samples(model, velocity)
    if not model.level < _SOFTEST * stiffness:
        raise UsageError(f"{model} cannot be drawn: its stiffness vanishes beside its level")
    deflection = model.level / stiffness
    velocity = min(velocity, deflection)  # at least one second for this distance
    position = deflection * np.geomspace(1e-2, 1e4, 2001)
    steps = np.diff(position, prepend=0.0)
    torque = _torque(model, np.full(steps.size, velocity), steps / velocity)
    end = _STROKE * float(position[np.argmax(torque >= _SETTLED * torque.max())])
    return _with_loop(model, velocity, end)


def _cycle_of_samples(model: FrictionModel, velocity: float) -> SlowCycle:
    """Move a network whose state is no deflection: a narx runs at the period of its training only."""
    assert model.network is not None
    dt = model.network.period_s
    torque = _torque(model, np.full(_LONGEST, velocity), np.full(1, dt))
    settled = int(np.argmax(torque >= _SETTLED * torque.max()))
    return _with_loop(model, velocity, max(_STROKE * settled, 0.5 * _SAMPLES) * dt * velocity, dt)


def _with_loop(model: FrictionModel, velocity: float, end: float, dt: float | None = None) -> SlowCycle:
    """Move to either end, and back with a small loop."""
    whole = _move(model, velocity, [end, -end, end], dt)
    back = np.flatnonzero(whole.leg == 2)
    top = float(whole.position[back[np.argmax(whole.torque[back] >= _INNER_TOP * whole.torque[back].max())]])
    return _move(model, velocity, [end, -end, top, top - _INNER_LENGTH * (top + end), top, end], dt)


def ripple(model: FrictionModel, position: Array) -> Array:
    """Return the torque that the model's ripple adds at each ``position``, N m."""
    modifiers = {"ripple": model.modifiers.get("ripple", [])}
    alone = models.create("coulomb", coulomb=0.0, modifiers=modifiers, axis=model.axis)
    return alone.simulate(np.ones(position.size), 1.0, position=position)


def _sides(model: FrictionModel) -> list[dict[str, Any]]:
    """Return the parameters without directions, and those of each direction."""
    changes = model.modifiers.get("direction", {}).values()
    return [model.parameters, *({**model.parameters, **each} for each in changes)]


def _steady(model: FrictionModel, velocity: Array, load_torque: float = 0.0, temperature: float | None = None) -> Array:
    load = load_torque if "load" in model.modifiers else None
    return model.steady_state(velocity, load_torque=load, temperature=temperature)


def _torque(model: FrictionModel, velocity: Array, dt: Array, applied_torque: Array | float = 0.0) -> Array:
    """Return the torque of a motion from rest, without load and ripple."""
    constant = float(ripple(model, np.zeros(1))[0])
    pushed = np.asarray(applied_torque) + constant
    return model.simulate(velocity, dt, position=0.0, load_torque=0.0, applied_torque=pushed) - constant


def _break_away(model: FrictionModel, sign: float) -> float:
    """Return the break-away torque of a static map, with its sign."""
    plenty = sign * 1e6 * (1.0 + model.level)
    return float(_torque(model, np.zeros(1), np.ones(1), plenty)[0])


def _move(model: FrictionModel, velocity: float, waypoints: list[float], period_s: float | None = None) -> SlowCycle:
    """Move at a constant speed from 0 to each of ``waypoints``, in samples of ``period_s`` if given.

    A static map rests at each reversal while the applied torque changes from that of the previous motion to the
    break-away torque.
    """
    columns: list[list[Array]] = [[], [], [], [], []]
    here, before = 0.0, 0.0
    for leg, there in enumerate(waypoints):
        sign = math.copysign(1.0, there - here)
        if model.family.is_static and sign != before:
            start = float(_steady(model, np.array([before * velocity]))[0])
            applied = np.linspace(start, _break_away(model, sign), _SAMPLES)
            rest = np.zeros(_SAMPLES)
            _append(columns, here + rest, rest, 1.0 + rest, applied, leg + rest)
        seconds = abs(there - here) / velocity
        count = _SAMPLES if period_s is None else max(2, round(seconds / period_s))
        first = here if model.family.is_static else here + (there - here) / count  # a static map jumps at rest
        moved = np.linspace(first, there, count)
        same = np.ones(count)
        dt = seconds / count if period_s is None else period_s
        _append(columns, moved, sign * velocity * same, dt * same, 0.0 * same, leg * same)
        here, before = there, sign
    position, v, steps, applied, leg_numbers = map(np.concatenate, columns)
    return SlowCycle(position, _torque(model, v, steps, applied), leg_numbers.astype(np.int64), velocity)


def _append(columns: list[list[Array]], *values: Array) -> None:
    for column, value in zip(columns, values, strict=True):
        column.append(value)


def _draw_velocity(axes: "Axes", model: FrictionModel) -> None:
    side = np.geomspace(1e-5, 1.0, 500) * velocity_range(model)
    velocity = np.concatenate([-side[::-1], [np.nan], side])
    load = 0.5 * model.level
    curves: list[tuple[str, str, dict[str, float]]] = [("", _MAIN, {})]
    if "load" in model.modifiers:
        curves[0] = ("no load", _MAIN, {})
        curves.append((_words(model, f"load torque {load:.3g} N m"), _OTHER, {"load_torque": load}))
    if "temperature" in model.modifiers:
        reference = model.modifiers["temperature"]["reference"]
        curves[0] = (f"{'no load, ' if curves[0][0] else ''}{reference:g} °C", _MAIN, {})
        for step, color in ((-_TEMPERATURE_STEP, "#56b4e9"), (_TEMPERATURE_STEP, _THIRD)):
            curves.append((f"{reference + step:g} °C", color, {"temperature": reference + step}))
    factor, unit = readable(_words(model, "rad/s"), float(side[-1]))
    for label, color, inputs in curves:
        torque = np.full(velocity.size, np.nan)
        moving = np.isfinite(velocity)
        torque[moving] = _steady(model, velocity[moving], **inputs)
        width, order = (1.8, 3) if color == _MAIN else (1.2, 2)
        axes.plot(velocity * factor, torque, color=color, linewidth=width, zorder=order, label=label or None)
    if model.family.is_static:
        ends = [_break_away(model, -1.0), _break_away(model, 1.0)]
        label = "at rest: the applied torque, up to break-away"
        axes.plot([0.0, 0.0], ends, color=_MAIN, linewidth=1.2, marker="o", markersize=4.5, label=label)
    else:
        edges = _steady(model, -side[:1]), _steady(model, side[:1])
        axes.plot([0.0, 0.0], [edges[0][0], edges[1][0]], ":", color=_MAIN, label="at rest: the torque of its state")
    _legend(axes, 2)
    axes.set(xlabel=f"velocity [{unit}]", title="at constant velocity")


def _draw_cycle(axes: "Axes", model: FrictionModel) -> None:
    cycle = slow_cycle(model)
    factor, unit = 1.0, "fraction of the stroke"
    if not model.family.is_static:
        factor, unit = readable(_words(model, "rad"), float(cycle.position.max()))
    styles = (("from rest", _FAINT, "--", (0,)), ("cycle", _MAIN, "-", (1, 2, 5)), ("small loop", _OTHER, "-", (3, 4)))
    for label, color, style, legs in styles:
        for leg in legs:
            rows = np.flatnonzero(cycle.leg == leg)
            rows = np.concatenate([rows[:1] - 1, rows]) if rows[0] else rows  # from the end of the previous leg
            position, torque = cycle.position[rows] * factor, cycle.torque[rows]
            if leg == 0:
                position, torque = np.insert(position, 0, 0.0), np.insert(torque, 0, 0.0)
            axes.plot(position, torque, style, color=color, linewidth=1.6, label=label if leg == legs[0] else None)
            if leg in (1, 5):
                at = 3 * position.size // 4
                arrow = {"arrowstyle": "-|>", "color": color, "mutation_scale": 16.0}
                axes.annotate("", (position[at + 1], torque[at + 1]), (position[at], torque[at]), arrowprops=arrow)
    _legend(axes, 3)
    speed, speed_unit = readable(_words(model, "rad/s"), cycle.velocity)
    axes.set(xlabel=f"position [{unit}]", title=f"in a slow cycle, {cycle.velocity * speed:.3g} {speed_unit}")


def _draw_ripple(axes: "Axes", model: FrictionModel) -> None:
    lowest = min(float(harmonic["order"]) for harmonic in model.modifiers["ripple"])
    turn = 2.0 * math.pi if model.axis == "rotary" else 1.0
    position = np.linspace(0.0, min(turn, 4.0 * turn / lowest), 2001)
    slow = _SLOW * velocity_range(model)
    added = ripple(model, position)
    factor, unit = readable(_words(model, "rad"), float(position[-1]))
    for sign, label, color in ((1.0, "forward", _MAIN), (-1.0, "backward", _OTHER)):
        level = float(_steady(model, np.array([sign * slow]))[0])
        axes.plot(position * factor, level + added, color=color, linewidth=1.4, label=label)
    _legend(axes, 2)
    axes.set(xlabel=f"position [{unit}]", title="slow motion, with ripple")


def _legend(axes: "Axes", columns: int) -> None:
    """Put the legend below the panel, where it hides nothing."""
    axes.legend(ncols=columns, loc="upper center", bbox_to_anchor=(0.5, -0.13))


def _words(model: FrictionModel, text: str) -> str:
    """Replace the words for a rotary axis by those for the model's axis."""
    if model.axis == "rotary":
        return text
    return text.replace("torque", "force").replace("N m", "N").replace("rad", "m")


def _caption(model: FrictionModel) -> str:
    """Return the parameters with units, the number of points of a table, and the names of the modifiers."""
    words = []
    for parameter in model.family.parameters:
        value = model.parameters[parameter.name]
        unit = "" if parameter.unit in ("", "1") else f" {_words(model, parameter.unit)}"
        if isinstance(value, list) and isinstance(value[0], list):
            words.append(f"{len(value)} {parameter.name}")
        elif isinstance(value, list):
            words.append(f"{parameter.name} {', '.join(f'{each:g}' for each in value)}{unit}")
        else:
            words.append(
                f"{parameter.name} {value:g}{unit}" if isinstance(value, float) else f"{parameter.name} {value}"
            )
    if model.modifiers:
        words.append(f"modified by {', '.join(model.modifiers)}")
    return ";  ".join(words)
