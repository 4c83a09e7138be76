"""Other joints in the recording of an axis: do they move its torque, and is the torque that of another one? Pure."""

import itertools
import re
from collections.abc import Collection, Iterator, Sequence

import numpy as np

from friction_hil.identification import thresholds as th
from friction_hil.identification.data import RegressionSegment
from friction_hil.identification.identify import Identification
from friction_hil.identification.plain_axis import PlainAxis
from friction_hil.numerics import filtering
from friction_hil.numerics.jit import Array
from friction_hil.recordings import Recording
from friction_hil.recordings.columns import NAMES, TIME
from friction_hil.recordings.mapping import parse_source
from friction_hil.recordings.segments import DEFAULT_LOWPASS_RATIO

_RIDGE = 1e-6
_QUALIFIERS = frozenset(
    (
        *("demand", "demanded", "reference", "ref", "error", "err", "target", "command", "commanded", "cmd", "set"),
        *("setpoint", "desired", "des", "goal", "estimate", "estimated", "est", "raw", "filtered", "filt", "actual"),
        *("act", "measured", "meas", "feedback", "dot", "vel", "velocity", "speed", "acc", "acceleration", "torque"),
        *("tau", "effort", "current", "time", "in", "out", "motor", "link"),
    )
)
"""Words that say what a column holds of a joint, and do not name another joint."""


def siblings(name: str, there: Collection[str]) -> list[str]:
    """Return the columns that are named as ``name`` but for the joint: ``q2`` for ``q1``, ``q[:,2]`` for ``q[:,1]``."""
    own = _tokens(name)
    is_worded = len(own) > 1 and not any(token.isdigit() for token in own)  # else numbers tell the joints apart
    found = []
    for other in there:
        tokens = _tokens(other)
        pairs = [(a, b) for a, b in zip(own, tokens, strict=False) if a != b]
        if len(tokens) != len(own) or len(pairs) != 1 or other in NAMES:
            continue
        first, second = pairs[0]
        is_word = (
            is_worded and first.isalpha() and second.isalpha() and not {first.lower(), second.lower()} & _QUALIFIERS
        )
        if (first.isdigit() and second.isdigit()) or is_word:
            found.append(other)
    return found[: th.MOST]


def _tokens(name: str) -> list[str]:
    return re.findall(r"\d+|[^\W\d_]+|[\W_]", name)


def other_joints(result: Identification, recordings: Sequence[Recording]) -> list[str]:
    """Report other joints whose motion the residual of the chosen model follows.

    The residual is regressed on acceleration, velocity and gravity of each other joint, and on the inertia of this axis
    that depends on their position; what they explain is judged by blocks held out. ``recordings``: those that the model
    was fitted to, with all their columns.
    """
    first = recordings[0]
    source, factor = parse_source(first.sources.get("position", "position"))
    names = [name for name in siblings(source, first.columns) if all(name in each for each in recordings)]
    by_path = {each.path: each for each in recordings}
    is_rotary = result.settings.axis == "rotary"
    found: dict[str, Array] = {}
    for name in names:
        parts = [terms(record, by_path[record.path], name, factor, is_rotary) for record in result.records]
        if all(part is not None for part in parts):
            found[name] = np.concatenate([part for part in parts if part is not None])
    residual = result.best.curves.residual
    if not found or any(len(each) != len(residual) for each in found.values()):
        return []
    share = explained(np.hstack(list(found.values())), residual)
    alone = {name: explained(each, residual) for name, each in found.items()}
    named = sorted((name for name in alone if alone[name] > th.NAMED), key=lambda name: -alone[name])
    share = max(share, *alone.values())
    if share < th.JOINTS_TOLD:
        return []
    return [
        f"this recording is not one of a single axis: the motion of {listed(named or list(found))} explains "
        f"{100.0 * share:.0f} % of what the model leaves, on blocks held out; hold the other joints still while "
        "recording, or subtract the torque that a rigid-body model of the arm gives for them"
    ]


def other_torques(plain: PlainAxis, result: Identification, recordings: Sequence[Recording]) -> list[str]:
    """Report a torque column of another joint that fits the motion of this one clearly better."""
    first = recordings[0]
    source, _ = parse_source(first.sources.get("torque", "torque"))
    by_path = {each.path: each for each in recordings}
    errors: dict[str, float] = {}
    for name in siblings(source, first.columns):
        if not all(name in each for each in recordings):
            continue
        values = np.concatenate(
            [record.reduce(_on_grid(record, by_path[record.path], name)) for record in result.records]
        )
        errors[name] = min(plain.error(values), plain.error(values, sign=-1.0))
    if not errors:
        return []
    best = min(errors, key=lambda name: errors[name])
    own = min(plain.error(), result.best.held_out.relative_error)
    if not errors[best] < th.JOINTS_BETTER * own:
        return []
    return [
        f"the column {best} fits the motion of this axis better than {source}, with an error of "
        f"{100.0 * errors[best]:.3g} %: if it is the torque of this axis, give --column torque='{best}'"
    ]


def _on_grid(record: RegressionSegment, recording: Recording, name: str) -> Array:
    """Return a column at the time stamps of a record (n,); it is interpolated where it is not finite."""
    time, values = recording[TIME], recording[name]
    known = np.flatnonzero(np.isfinite(values))
    order = known[np.argsort(time[known], kind="stable")]
    found: Array = np.interp(record.time_s, time[order], values[order])
    return found


def terms(record: RegressionSegment, recording: Recording, name: str, factor: float, is_rotary: bool) -> Array | None:
    """Return what another joint may add to the torque, reduced (k, p); None if it stands still or is this one.

    Its position is ``factor`` times the column ``name`` of ``recording``, whose time stamps are those of ``record``.
    """
    cutoff = record.lowpass_hz or DEFAULT_LOWPASS_RATIO * record.rate_hz
    raw = factor * _on_grid(record, recording, name)
    other = filtering.lowpass(raw, cutoff, record.rate_hz)
    own = record.position
    if np.ptp(raw) == 0.0 or abs(np.corrcoef(raw, record.encoder)[0, 1]) > th.JOINTS_SAME:
        return None
    velocity = np.gradient(other, record.dt)
    columns = [np.gradient(velocity, record.dt), velocity]
    if is_rotary:
        columns += [np.sin(other), np.cos(other), np.sin(other + own), np.cos(other + own)]
        columns += [np.cos(other) * record.acceleration]
    else:
        columns += [other]
    return record.reduce_smooth(np.column_stack(columns))


def explained(columns: Array, residual: Array) -> float:
    """Return the share of the residual's variance (k,) that columns (k, p) explain on blocks held out."""
    size = np.std(columns, axis=0)
    scaled = np.column_stack([np.ones(len(columns)), (columns / np.where(size > 0.0, size, 1.0))])
    left = np.empty(len(residual))
    for rows in _blocks(len(residual)):
        kept = np.ones(len(residual), dtype=bool)
        kept[rows] = False
        matrix = scaled[kept]
        normal = matrix.T @ matrix + _RIDGE * len(matrix) * np.eye(matrix.shape[1])
        left[rows] = residual[rows] - scaled[rows] @ np.linalg.solve(normal, matrix.T @ residual[kept])
    return 1.0 - float(np.sum(left**2)) / float(np.sum((residual - np.mean(residual)) ** 2))


def _blocks(rows: int) -> Iterator[slice]:
    edges = np.linspace(0, rows, th.BLOCKS + 1).round().astype(int).tolist()
    return (slice(begin, end) for begin, end in itertools.pairwise(edges))


def listed(names: Sequence[str]) -> str:
    """Return names as a list in a sentence."""
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
