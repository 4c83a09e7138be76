"""What page and monitor say of an axis: texts with units. Pure."""

import math
from pathlib import Path
from typing import Any

from friction_hil.daemon import learning_words
from friction_hil.live.snapshot import AxisSnapshot
from friction_hil.numerics.readable import brief, quantity


def values_of(axis: AxisSnapshot) -> list[tuple[str, str]]:
    """Return names and texts of what page and monitor show of an axis beside its charts."""
    speed = f"{axis.unit}/s"
    file = f" ({Path(axis.model_file).name})" if axis.model_file else ""
    return [
        ("Drive", axis.drive_state),
        ("Position", quantity(axis.position, axis.unit)),
        ("Velocity", quantity(axis.velocity, speed)),
        ("Torque", quantity(axis.torque, axis.torque_unit)),
        ("Compensation", quantity(axis.compensation, axis.torque_unit)),
        ("Compensation, RMS", quantity(axis.compensation_rms, axis.torque_unit)),
        ("Following error", quantity(axis.error, axis.unit)),
        ("Error with compensation", _error(axis.compensated, axis.unit)),
        ("Error without", _error(axis.without, axis.unit)),
        ("Temperature", f"{axis.temperature:.1f} °C" if math.isfinite(axis.temperature) else "-"),
        ("Model", f"{axis.model}{file}, gain {axis.gain:g}{'' if axis.is_enabled else ', off'}"),
        ("Parameters", ", ".join(f"{key} {_parameter(value)}" for key, value in axis.parameters.items())),
        *_learning(axis),
    ]


def _learning(axis: AxisSnapshot) -> list[tuple[str, str]]:
    """Return what learning does for an axis, if it does."""
    if (report := axis.learning) is None:
        return []
    found = [
        ("Learning", learning_words.summary(report)),
        ("Learning, last", report["last"]),
        ("Parameters with standard errors", learning_words.parameters(report)),
    ]
    return [(name, text) for name, text in found if text]


def _error(figures: Any, unit: str) -> str:
    if figures is None:
        return "-"
    return f"{quantity(figures.rms, unit)} RMS, {quantity(figures.peak, unit)} peak"


def _parameter(value: Any) -> str:
    return brief(float(value)) if isinstance(value, int | float) else "..."
