"""Pictures of friction models beside each other: at constant velocity, and along a motion, over time and position."""

import inspect
import math
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from friction_hil.errors import UsageError, choices
from friction_hil.friction import FrictionModel
from friction_hil.friction.steady_curve import velocity_range
from friction_hil.numerics.jit import Array
from friction_hil.reports.figures import INK, SERIES, new_figure_for, save
from friction_hil.reports.numbers import readable

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_SAMPLES = 4000  # of a period
_MOST_SAMPLES = 2_000_000
_STEPS = (0.0, 1.0, 0.0, -1.0, 1.0, -1.0)  # velocities of a period
_STROKE = 3.0  # of presliding: default amplitude


class Motion(NamedTuple):
    """Velocity held over each sample, and position at its end, (n,); ``dt`` in s."""

    dt: float
    velocity: Array
    position: Array


def sine(time: Array, amplitude: float, frequency: float) -> Array:
    """Return a position that swings about 0, from rest at one end."""
    return -amplitude * np.cos(2.0 * np.pi * frequency * time)


def reversals(time: Array, amplitude: float, frequency: float, small: float = 0.3, times: float = 8.0) -> Array:
    """Return a sine with a smaller and faster one on top, so that it reverses on the way."""
    return sine(time, amplitude, frequency) + sine(time, small * amplitude, times * frequency)


def steps(time: Array, velocity: float, frequency: float) -> Array:
    """Return the position of a velocity that jumps between 0 and +-``velocity``."""
    dt = time[1] - time[0]
    number = np.floor((time + 0.5 * dt) * frequency * len(_STEPS) + 1e-9).astype(int) % len(_STEPS)
    return np.asarray(np.cumsum(velocity * np.array(_STEPS)[number]) * dt)


KINDS: dict[str, Callable[..., Array]] = {"sine": sine, "reversals": reversals, "steps": steps}


def keys_of(kind: str) -> tuple[str, ...]:
    """Return the numbers that a kind of motion takes. Raises `UsageError`: there is no such kind."""
    if kind not in KINDS:
        raise UsageError(f"--motion {kind}: no file, and no motion of this name; {choices(kind, KINDS)}")
    return (*list(inspect.signature(KINDS[kind]).parameters)[1:], "periods")


def make_motion(kind: str, given: Mapping[str, float], models: Mapping[str, FrictionModel]) -> Motion:
    """Make a motion whose size, if it is not given, shows the presliding of the first model.

    Raises `UsageError`: a number is unknown, not finite or not above zero, or the motion has too many samples.
    """
    known = keys_of(kind)
    for name, value in given.items():
        if name not in known:
            raise UsageError(f"--motion {kind} has no {name!r}; {choices(name, known)}")
        if not 0.0 < value < np.inf:
            raise UsageError(f"--motion {kind}: {name} is {value:g}, but must be finite and above zero")
    model = next(iter(models.values()))
    values = {"frequency": 1.0, "periods": 3.0, "amplitude": _amplitude(model), "velocity": 0.1 * velocity_range(model)}
    values |= dict(given)
    own = [each.network.period_s for each in models.values() if each.network is not None]
    dt = own[0] if own else 1.0 / (_SAMPLES * values["frequency"])
    count = values.pop("periods") / values["frequency"] / dt
    if not 2.0 <= count <= _MOST_SAMPLES:
        raise UsageError(f"--motion {kind} has {count:.3g} samples of {dt:.3g} s; 2 to {_MOST_SAMPLES} can be drawn")
    time = np.arange(round(count) + 1) * dt
    position = KINDS[kind](time, **{name: value for name, value in values.items() if name in known})
    return Motion(dt, np.diff(position) / dt, position[1:])


def _amplitude(model: FrictionModel) -> float:
    stiffness = model.presliding_stiffness
    return _STROKE * model.level / stiffness if stiffness > 0.0 else 0.1


def draw_steady(models: Mapping[str, FrictionModel], path: Path) -> None:
    """Draw the friction of models at constant velocity into one picture; static maps with their break-away."""
    figure = new_figure_for(path, 7.5, 5.0)
    axes = figure.subplots()
    first = next(iter(models.values()))
    side = np.geomspace(1e-5, 1.0, 500) * velocity_range(first)
    factor, unit = readable(_words(first, "rad/s"), float(side[-1]))
    for (label, model), (color, width) in zip(models.items(), _lines(models), strict=True):
        for sign in (-1.0, 1.0):
            torque = model.steady_state(sign * side, load_torque=0.0)
            axes.plot(sign * side * factor, torque, color=color, linewidth=width, label=label if sign > 0.0 else None)
        if model.family.is_static:
            ends = [model.simulate([0.0], 1.0, applied_torque=sign * 1e6 * (1.0 + model.level)) for sign in (-1.0, 1.0)]
            axes.plot([0.0, 0.0], [float(end[0]) for end in ends], "o-", color=color, markersize=4.0, linewidth=1.0)
    axes.axhline(0.0, color=INK, linewidth=0.5)
    axes.set(xlabel=f"velocity [{unit}]", ylabel=_words(first, "friction torque [N m]"))
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.14))
    figure.suptitle("Friction at constant velocity")
    save(figure, path)


def draw_motion(models: Mapping[str, FrictionModel], motion: Motion, path: Path, title: str) -> dict[str, float]:
    """Draw the torque of models along a motion, from rest, over time, position and velocity.

    Returns the root mean square of the difference of each further model from the first one, over the RMS torque of
    that.
    """
    first = next(iter(models.values()))
    torques = {label: _torque(model, motion) for label, model in models.items()}
    is_compared = len(models) > 1
    figure = new_figure_for(path, 11.0, 10.0 if is_compared else 7.5)
    grid = figure.add_gridspec(3 if is_compared else 2, 2)
    time = motion.dt * np.arange(1, motion.velocity.size + 1)
    columns = {
        "time": (time, *readable("s", float(time[-1]))),
        "velocity": (motion.velocity, *readable(_words(first, "rad/s"), float(np.ptp(motion.velocity)))),
        "position": (motion.position, *readable(_words(first, "rad"), float(np.ptp(motion.position)))),
    }
    given = figure.add_subplot(grid[0, 0])
    _plot(given, columns, "time", "velocity", INK)
    beside = given.twinx()
    _plot(beside, columns, "time", "position", "#999999", "--")
    given.set(title="the motion: velocity (line), position (dashed)")
    for where, over in ((grid[0, 1], "velocity"), (grid[1, 0], "time"), (grid[1, 1], "position")):
        axes = figure.add_subplot(where)
        x, factor, unit = columns[over]
        for (label, torque), (color, width) in zip(torques.items(), _lines(models), strict=True):
            axes.plot(x * factor, torque, color=color, linewidth=width, label=label)
        axes.set(xlabel=f"{over} [{unit}]", ylabel=_words(first, "friction torque [N m]"), title=f"over {over}")
    figure.legend(*axes.get_legend_handles_labels(), loc="outside lower center")
    found: dict[str, float] = {}
    if is_compared:
        axes = figure.add_subplot(grid[2, :])
        name, wanted = next(iter(torques.items()))
        x, factor, unit = columns["time"]
        for (label, torque), (color, _) in list(zip(torques.items(), _lines(models), strict=True))[1:]:
            power = max(float(np.mean(wanted**2)), 1e-300)
            found[label] = math.sqrt(float(np.mean((torque - wanted) ** 2)) / power)
            axes.plot(x * factor, torque - wanted, color=color, linewidth=1.0)
        shares = ", ".join(f"{100.0 * share:.3g} %" for share in found.values())
        axes.set(xlabel=f"time [{unit}]", ylabel=_words(first, "torque [N m]"))
        axes.set_title(f"difference from {name}: RMS {shares} of its torque")
    figure.suptitle(title)
    save(figure, path)
    return found


def _torque(model: FrictionModel, motion: Motion) -> Array:
    """Return the torque of a motion from rest, without load; a static map at rest balances no torque."""
    return model.simulate(motion.velocity, motion.dt, position=motion.position, load_torque=0.0)


def _plot(axes: "Axes", columns: Mapping[str, Any], x: str, y: str, color: str, style: str = "-") -> None:
    across, x_factor, x_unit = columns[x]
    up, y_factor, y_unit = columns[y]
    axes.plot(across * x_factor, up * y_factor, style, color=color, linewidth=1.0)
    axes.set(xlabel=f"{x} [{x_unit}]", ylabel=f"{y} [{y_unit}]")


def _lines(models: Mapping[str, FrictionModel]) -> list[tuple[str, float]]:
    """Return colour and width of the line of each model: later ones are thinner, so that none hides another."""
    return [(SERIES[k % len(SERIES)], max(3.0 - 0.7 * k, 0.8)) for k in range(len(models))]


def _words(model: FrictionModel, text: str) -> str:
    return text if model.axis == "rotary" else text.replace("torque", "force").replace("N m", "N").replace("rad", "m")
