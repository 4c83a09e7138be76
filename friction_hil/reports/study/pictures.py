"""The pictures of the study, one function for each."""

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np

from friction_hil.numerics.jit import Array
from friction_hil.reports.figures import INK, WITH, WITHOUT, new_figure
from friction_hil.reports.numbers import digits
from friction_hil.reports.study.panels import FAINT, matrix, panels, together
from friction_hil.study import Study

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_SHOWN_HUNTING_M = (0.55, 1.45)
_SHOWN_REVERSAL_DEG = (-3.0, 21.0)


def draw_static_curves(study: Study) -> "Figure":
    """Draw friction over constant velocity."""
    lines = _lines(study, "static_curve", "force", 1e3)
    return together(lines, ("velocity [mm/s]", "friction at constant velocity [N]"), log=True)


def draw_pulse(study: Study) -> "Figure":
    """Draw friction over time during a velocity pulse in each direction."""

    def draw(axes: "Axes", name: str) -> None:
        lines = study.single["velocity_pulse"][name].lines
        time, velocity = lines["velocity"]
        axes.fill_between(time, velocity / velocity.max(), color=FAINT, alpha=0.5, linewidth=0.0, label="velocity")
        axes.plot(*lines["force"], color=WITH, linewidth=1.5, label="friction")

    return panels(study.models, draw, ("time [s]", "friction [N]"), legend=True)


def draw_presliding(study: Study) -> "Figure":
    """Draw force over displacement while the force is cycled below break-away."""

    def draw(axes: "Axes", name: str) -> None:
        position, force = study.single["presliding"][name].lines["force"]
        axes.plot(position * 1e6, force, color=WITH, linewidth=1.5)

    return panels(study.models, draw, ("displacement [µm]", "friction [N]"))


def draw_drift(study: Study) -> "Figure":
    """Draw displacement over time under an oscillating force."""
    lines = {
        name: (time, position * 1e6) for name, (time, position) in _lines(study, "presliding", "shaken", 1.0).items()
    }
    return together(lines, ("time [s]", "displacement [µm]"))


def draw_strain(study: Study) -> "Figure":
    """Draw friction over a displacement with a small loop inside the large one."""

    def draw(axes: "Axes", name: str) -> None:
        position, force = study.single["stress_strain"][name].lines["force"]
        axes.plot(position * 1e6, force, color=WITH, linewidth=1.3)
        axes.axvline(0.0, color=FAINT, linewidth=0.8, zorder=0)

    return panels(study.models, draw, ("displacement [µm]", "friction [N]"))


def draw_lag(study: Study) -> "Figure":
    """Draw friction over an oscillating velocity."""

    def draw(axes: "Axes", name: str) -> None:
        for (label, (velocity, force)), color in zip(
            study.single["frictional_lag"][name].lines.items(), (INK, WITH, WITHOUT), strict=True
        ):
            axes.plot(velocity * 1e3, force, color=color, linewidth=1.3, label=label)
        axes.set_ylim(0.9 * study.settings.friction.coulomb, 1.05 * study.settings.friction.static)

    return panels(study.models, draw, ("velocity [mm/s]", "friction [N]"), legend=True)


def draw_break_away(study: Study) -> "Figure":
    """Draw the break-away force over the rate of the force."""
    lines = _lines(study, "break_away", "force", 1.0)
    return together(lines, ("rate of the force [N/s]", "break-away force [N]"), log=True, markers=True)


def draw_stick_slip(study: Study) -> "Figure":
    """Draw the velocity of the pulled mass, without and with compensation by its own model."""

    def draw(axes: "Axes", name: str) -> None:
        for assumed, color, label in _pair(name):
            time, velocity = study.paired["stick_slip"][name, assumed].lines["velocity"]
            axes.plot(time, velocity, color=color, linewidth=1.2, label=label)

    return panels(study.models, draw, ("time [s]", "velocity [m/s]"), legend=True)


def draw_hunting(study: Study) -> "Figure":
    """Draw the position under PID control, without and with compensation by its own model."""

    def draw(axes: "Axes", name: str) -> None:
        for assumed, color, label in _pair(name):
            time, position = study.paired["hunting"][name, assumed].lines["position"]
            axes.plot(time, position, color=color, linewidth=1.2, label=label)
        axes.axhline(1.0, color=FAINT, linewidth=0.8, zorder=0)
        axes.set_ylim(*_SHOWN_HUNTING_M)

    return panels(study.models, draw, ("time [s]", "position [m]"), legend=True)


def draw_reversal(study: Study) -> "Figure":
    """Draw the radius error after a reversal, without and with compensation by its own model."""

    def draw(axes: "Axes", name: str) -> None:
        for assumed, color, label in _pair(name):
            angle, error = study.paired["reversal"][name, assumed].lines["radius error"]
            shown = np.degrees((angle + np.pi) % (2.0 * np.pi) - np.pi)
            order = np.argsort(shown)
            axes.plot(shown[order], error[order] * 1e3, color=color, linewidth=1.3, label=label)
        axes.set_xlim(*_SHOWN_REVERSAL_DEG)

    return panels(
        study.models, draw, ("angle on the circle, from the reversal [°]", "radius error [mrad]"), legend=True
    )


def draw_circle(study: Study, name: str) -> "Figure":
    """Draw the whole circle of one model, with its radius error magnified."""
    outcomes = study.paired["reversal"]
    worst = max(outcomes[name, each].facts["peak_urad"] for each in (None, name)) * 1e-6
    radius = study.settings.radius
    magnification = 10.0 ** np.floor(np.log10(0.4 * radius / worst))
    magnification *= 1.0 + np.floor(0.4 * radius / worst / magnification - 1.0)
    figure = new_figure(6.0, 6.3)
    axes = figure.subplots()
    turn = np.linspace(0.0, 2.0 * np.pi, 400)
    axes.plot(np.cos(turn), np.sin(turn), color=FAINT, linewidth=0.9, label="set-point")
    for assumed, color, label in _pair(name):
        angle, error = outcomes[name, assumed].lines["radius error"]
        drawn = 1.0 + error * magnification / radius
        axes.plot(drawn * np.cos(angle), drawn * np.sin(angle), color=color, linewidth=1.4, label=label)
    axes.set_aspect("equal")
    axes.set(xlabel="first axis [rad]", ylabel="second axis [rad]")
    axes.set_title(f"{name}: radius error magnified {magnification:g} times")
    axes.legend(loc="center")
    for side in axes.spines.values():
        side.set_visible(False)
    return figure


def draw_matrix(study: Study, experiment: str, fact: str, floor: float) -> "Figure":
    """Draw a number of a closed-loop experiment for each true friction and each compensating model."""
    outcomes = study.paired[experiment]
    return matrix(
        study.models, lambda name, each: outcomes[name, each].facts[fact], lambda value: _brief(value), floor=floor
    )


def _brief(value: float) -> str:
    return f"{value:.0f}" if abs(value) >= 100.0 else digits(value, 2) if abs(value) >= 0.1 else "0"


def _pair(name: str) -> tuple[tuple[str | None, str, str], ...]:
    return (None, WITHOUT, "without compensation"), (name, WITH, "with compensation by its own model")


def _lines(study: Study, experiment: str, line: str, factor: float) -> Mapping[str, tuple[Array, Array]]:
    outcomes = study.single[experiment]
    return {name: (outcomes[name].lines[line][0] * factor, outcomes[name].lines[line][1]) for name in study.models}
