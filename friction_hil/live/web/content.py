"""What the page shows, as messages: figures as texts with units, charts as numbers in readable units. Pure."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from friction_hil.analysis import following
from friction_hil.analysis.circularity import RING_SHARE
from friction_hil.live import AxisSnapshot, LiveFacts, Rows, Snapshot
from friction_hil.live.following_error import motion_columns
from friction_hil.live.friction_map import FrictionMap
from friction_hil.live.lateness import Lateness
from friction_hil.live.values import values_of
from friction_hil.live.web.circle import LiveCircle
from friction_hil.live.web.strips import WINDOW_S, Points, short
from friction_hil.numerics.jit import Array
from friction_hil.numerics.readable import quantity, readable

ERROR = "error"
_ABOVE = 1.1  # a range of -0.99 to 0.99 rad is one of rad, not of mrad


@dataclass(frozen=True, slots=True)
class Strip:
    """A chart over time: columns that have one unit, with their names."""

    title: str
    columns: tuple[str, ...]
    names: tuple[str, ...]


STRIPS = (
    Strip("Position", ("position", "position_demand"), ("measured", "demanded")),
    Strip("Velocity", ("velocity", "velocity_demand"), ("measured", "demanded")),
    Strip("Torque", ("torque", "compensation"), ("measured", "compensation")),
    Strip("Following error", (ERROR,), ("error",)),
)
COLUMNS = tuple(column for strip in STRIPS for column in strip.columns)


def strip_values(rows: Rows, axis: str) -> Array:
    """Return the columns of the strips (n, columns); the following error is in the last."""
    error = following.error(motion_columns(rows, axis))
    return np.stack([error if name == ERROR else rows.of(axis, name) for name in COLUMNS], axis=1)


def hello(facts: LiveFacts, models: Mapping[str, Sequence[str]], points: Mapping[str, Points]) -> list[dict[str, Any]]:
    """Return the messages with which a page begins."""
    axes = {
        name: {
            "models": list(models[name]),
            "strips": [
                {
                    "title": strip.title,
                    "columns": strip.columns,
                    "names": strip.names,
                    "unit": _unit(facts, name, strip),
                }
                for strip in STRIPS
            ],
        }
        for name in facts.axes
    }
    first = {"kind": "hello", "name": facts.name, "source": facts.source, "window_s": WINDOW_S, "axes": axes}
    return [first, rows_message(points)]


def rows_message(points: Mapping[str, Points]) -> dict[str, Any]:
    """Return further points of the strips."""
    axes = {
        name: {"time_s": times, **dict(zip(COLUMNS, columns, strict=True))} for name, (times, columns) in points.items()
    }
    return {"kind": "rows", "axes": axes}


def figures_message(
    facts: LiveFacts, snapshot: Snapshot, points: Mapping[str, Points], circle: LiveCircle | None
) -> dict[str, Any]:
    """Return the figures, with texts that say what the charts show."""
    axes = {}
    for name, axis in snapshot.axes.items():
        _, columns = points[name]
        by_name = dict(zip(COLUMNS, columns, strict=True))
        strips = [_described(by_name, strip, _unit(facts, name, strip)) for strip in STRIPS]
        axes[name] = {
            "values": values_of(axis),
            "scales": [{"factor": factor, "unit": unit} for factor, unit, _ in strips],
            "texts": [text for _, _, text in strips],
            "friction": _friction(axis.friction, axis),
            "enabled": axis.is_enabled,
            "gain": axis.gain,
        }
    return {
        "kind": "figures",
        "state": snapshot.state,
        "stands": snapshot.stands,
        "clock": f"{snapshot.time_s:.1f} s" if math.isfinite(snapshot.time_s) else "",
        "faults": [{"text": each.text, "remedy": plain_text(each.remedy)} for each in snapshot.faults],
        "lateness": _lateness(snapshot.lateness, snapshot),
        "circle": None if circle is None else _circle(circle, facts),
        "axes": axes,
    }


def plain_text(remedy: str) -> str:
    """Return a remedy without the marks of code that it has in a page of Markdown."""
    return remedy.replace("`", "")


def _unit(facts: LiveFacts, axis: str, strip: Strip) -> str:
    return facts.unit(axis, "position" if strip.columns == (ERROR,) else strip.columns[0])


def _described(columns: Mapping[str, Sequence[float | None]], strip: Strip, unit: str) -> tuple[float, str, str]:
    """Return factor and unit in which a strip is readable, and its content in words."""
    known = {name: [each for each in columns[name] if each is not None] for name in strip.columns}
    peak = max((abs(each) for values in known.values() for each in values), default=0.0)
    factor, shown = readable(unit, [_ABOVE * peak])
    parts = [
        f"{label} {quantity(values[-1], unit)}, from {quantity(min(values), unit)} to {quantity(max(values), unit)}"
        for name, label in zip(strip.columns, strip.names, strict=True)
        if (values := known[name])
    ]
    return factor, shown, f"last {WINDOW_S:g} s: {'; '.join(parts)}" if parts else "nothing measured"


def _friction(friction: FrictionMap, axis: AxisSnapshot) -> dict[str, Any]:
    """Return measured friction and the curve of the model over one axis of velocity."""
    curve = friction.curve_torque[np.isfinite(friction.curve_torque)]
    factor, unit = readable(axis.torque_unit, [float(np.max(np.abs([*friction.torque, *curve]), initial=0.0))])
    velocity = np.concatenate([friction.velocity, friction.curve_velocity])
    nothing = np.full_like(friction.curve_velocity, np.nan), np.full_like(friction.velocity, np.nan)
    measured = np.concatenate([friction.torque, nothing[0]]) * factor
    model = np.concatenate([nothing[1], friction.curve_torque]) * factor
    order = np.argsort(velocity, kind="stable")
    text = friction.note
    if not text:
        speeds = (
            f"{quantity(friction.velocity[0], axis.unit + '/s')} to {quantity(friction.velocity[-1], axis.unit + '/s')}"
        )
        text = f"{speeds}: measured {_range(friction.torque, axis)}; {axis.model} {_range(curve, axis)}"
    return {
        "velocity": _plain(velocity[order]),
        "measured": _plain(measured[order]),
        "model": _plain(model[order]),
        "x_label": f"velocity [{axis.unit}/s]",
        "y_label": f"[{unit}]",
        "text": text,
    }


def _range(values: Array, axis: AxisSnapshot) -> str:
    if not values.size:
        return "-"
    low, high = float(values.min()), float(values.max())
    return f"{quantity(low, axis.torque_unit)} to {quantity(high, axis.torque_unit)}"


def _lateness(lateness: Lateness, snapshot: Snapshot) -> dict[str, Any]:
    labels = [f"{bound:g}" for bound in lateness.bounds_us] + ["more"]
    used = np.flatnonzero(lateness.counts)
    inside = slice(max(0, used[0] - 1), used[-1] + 2) if used.size else slice(0, 0)
    text = f"{snapshot.missed} periods missed, {snapshot.lost} rows lost on the way here"
    if used.size:
        p50, p99, most = (f"{value:.0f} µs" for value in (lateness.p50_us, lateness.p99_us, lateness.max_us))
        text = f"last {snapshot.window_s:g} s: median {p50}, 99 % up to {p99}, largest {most}; {text}"
    return {"labels": labels[inside], "counts": lateness.counts[inside].tolist(), "text": text}


def _circle(circle: LiveCircle, facts: LiveFacts) -> dict[str, Any]:
    unit = facts.unit(circle.axes[0], "position")
    shape = f"circle of radius {circle.circle.radius:g} {unit} at {circle.circle.frequency:g} Hz"
    scale = circle.scale
    factor, shown = readable(unit, [scale.ring])
    text = f"{shape}: no whole lap in steady motion yet"
    if circle.error.size:
        low, high = float(circle.error.min()), float(circle.error.max())
        with_what = {0.0: "without compensation", 1.0: "with compensation"}.get(
            circle.compensated, "in part compensated"
        )
        text = (
            f"{shape}, last lap, {with_what}: radius error {quantity(low, unit)} to {quantity(high, unit)}; magnified "
            f"{scale.magnification:g} times, {scale.ring * factor:g} {shown} from ring to ring"
        )
    return {
        "axes": circle.axes,
        "angle": _plain(circle.angle),
        "share": _plain(circle.error * scale.magnification / circle.circle.radius),
        "ring_share": RING_SHARE,
        "inner": scale.inner,
        "outer": scale.outer,
        "labels": [f"{k * scale.ring * factor:+g} {shown}" for k in range(-scale.inner, scale.outer + 1)],
        "text": text,
    }


def _plain(values: Array) -> list[float | None]:
    return [short(value) if math.isfinite(value) else None for value in values.tolist()]
