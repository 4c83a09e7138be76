"""Coupling, masses and friction of either side where the position of the load was recorded, too. Pure.

With both motions known, each side has an equation of its own. That of the motor,

    torque = motor_inertia qm'' + motor_friction sign(qm') + viscous qm' + offset + stiffness p + damping p',

is nonlinear only in the width and the middle of the gap, which decide what the twist p beyond the gap is. It holds
where the motor moves, whether the load does or not, so that a load that sticks shows the coupling. That of the load,

    stiffness p + damping p' = load_inertia ql'' + load_friction sign(ql') + offset,

holds where the load slides. The load encoder is in the unit of the motor's: a gear ratio belongs into its scale.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from friction_hil.identification import thresholds as th
from friction_hil.identification.compliance import sandwich
from friction_hil.identification.data import RegressionSegment
from friction_hil.identification.least_squares import scaled_solution
from friction_hil.identification.motor_motion import derivatives
from friction_hil.numerics import filtering
from friction_hil.numerics.jit import Array
from friction_hil.recordings import Recording
from friction_hil.recordings.quality import resolution

COLUMN = "load_position"
_SMALLEST = 1e-10  # relative singular value that counts


@dataclass(frozen=True, slots=True)
class LoadSide:
    """What motor and load position tell together: values and standard errors by the names of the mechanics."""

    values: dict[str, float]
    errors: dict[str, float]


@dataclass(frozen=True, slots=True, eq=False)
class _Part:
    """Both sides of one segment; arrays (n,) at the full rate, and the rows in which each side moves."""

    twist: Array
    rate: float
    cut: float
    motor: Array  # (n, 4): acceleration, direction, velocity, 1
    load: Array  # (n, 3): acceleration, direction, 1
    torque: Array
    motor_rows: Any
    load_rows: Any

    def coupling(self, width: float, middle: float) -> Array:
        """Return twist beyond the gap and its rate (n, 2)."""
        twist = self.twist - middle
        beyond = twist - np.clip(twist, -0.5 * width, 0.5 * width)
        return np.column_stack([beyond, np.gradient(twist) * self.rate * (beyond != 0.0)])

    def low(self, values: Array, rows: Any) -> Array:
        """Low-pass values (n, ...) and return rows of them."""
        return np.asarray(filtering.lowpass(values, self.cut, self.rate)[rows])

    def starts(self, rows: Any) -> Any:
        """Return the first of the rows in each stretch of time."""
        return np.flatnonzero(np.diff(rows // max(1, round(th.STRETCH_S * self.rate)), prepend=-1))


def find_load_side(recordings: Sequence[Recording], records: Sequence[RegressionSegment]) -> LoadSide | None:
    """Find masses, coupling, backlash and friction by both positions; None without a column ``load_position``.

    ``records``: segments of the same recordings.
    """
    parts: list[_Part] = []
    for recording in recordings:
        if COLUMN not in recording:
            return None
        known = np.isfinite(recording[COLUMN])
        for each in records:
            if each.path == recording.path and float(np.mean(known)) >= th.LEAST_KNOWN:
                load = np.interp(each.time_s, recording["time_s"][known], recording[COLUMN][known])
                part = _part(each, load)
                parts += [] if part is None else [part]
    if sum(min(len(each.motor_rows), len(each.load_rows)) for each in parts) < th.LOAD_SIDE_LEAST_ROWS:
        return None
    return _found(parts, max((resolution(recording[COLUMN]) or 0.0) for recording in recordings))


def _part(record: RegressionSegment, load: Array) -> _Part | None:
    from scipy.ndimage import maximum_filter1d  # imported here: commands start faster without it

    rate, cut = record.rate_hz, th.LOAD_SIDE_BAND * record.rate_hz
    edge, every = filtering.settling_samples(cut, rate), max(1, int(rate / (2.5 * cut)))
    if len(load) < 3 * edge:
        return None
    inner = np.arange(edge, len(load) - edge, every)
    sides, rows = [], []
    for position in (record.encoder, load):
        speed, acceleration = derivatives(position, record.dt)
        smooth = filtering.lowpass(speed, 2.0 * cut, rate)
        # at rest friction is whatever holds that side, and the low-pass mixes it with the rows beside
        slow = np.abs(smooth) < th.LEAST_SPEED * float(np.sqrt(np.mean(smooth**2)))
        rows.append(inner[~maximum_filter1d(slow, 2 * round(0.5 * rate / cut) + 1)[inner]])
        sides.append(np.column_stack([acceleration, np.sign(smooth), speed, np.ones_like(speed)]))
    motor, other = sides
    return _Part(record.encoder - load, rate, cut, motor, other[:, [0, 1, 3]], record.torque, rows[0], rows[1])


def _found(parts: Sequence[_Part], count: float) -> LoadSide | None:
    from scipy.optimize import least_squares  # imported here: commands that do not need it start faster

    torque = np.concatenate([each.low(each.torque, each.motor_rows) for each in parts])
    fixed = np.concatenate([each.low(each.motor, each.motor_rows) for each in parts])
    spread = max(float(np.ptp(each.twist)) for each in parts)
    middle = float(np.median(np.concatenate([each.twist for each in parts])))
    if spread <= count:
        return None

    def columns(at: Array) -> Array:
        width, centre = abs(at[0]) * spread, middle + at[1] * spread
        coupling = [each.low(each.coupling(width, centre), each.motor_rows) for each in parts]
        return np.column_stack([fixed, np.concatenate(coupling)])

    def residual(at: Array) -> Array:
        return torque - columns(at) @ scaled_solution(columns(at), torque, _SMALLEST)

    bounds = [0.0, -0.5], [th.WIDEST, 0.5]
    ends = [
        least_squares(residual, [each, 0.0], bounds=bounds, diff_step=1e-3, x_scale=0.1, max_nfev=30)
        for each in th.WIDTHS
    ]
    at = min(ends, key=lambda each: float(each.cost)).x
    closed = np.array([0.0, 0.0])
    has_gap = np.linalg.norm(residual(at)) < th.FALL * np.linalg.norm(residual(closed))
    if not has_gap:
        at = closed
    factors = scaled_solution(columns(at), torque, _SMALLEST)
    steps = [np.array([1e-3, 0.0]), np.array([0.0, 1e-3])]
    slopes = [(columns(at + step) - columns(at - step)) @ factors / 2e-3 for step in steps]
    starts = _joined([each.starts(each.motor_rows) for each in parts], [len(each.motor_rows) for each in parts])
    covariance = sandwich(np.column_stack([columns(at), *slopes]), residual(at), starts)
    own = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    values = {"motor_inertia": factors[0], "motor_friction": factors[1], "stiffness": factors[4], "damping": factors[5]}
    errors = {"motor_inertia": own[0], "motor_friction": own[1], "stiffness": own[4], "damping": own[5]}
    width, its_error = abs(float(at[0])) * spread, float(own[6]) * spread
    if has_gap and width > max(th.LOAD_SIDE_CLEAR * its_error, th.LEAST_COUNTS * count, th.LEAST_WIDTH * spread):
        values["backlash"], errors["backlash"] = width, its_error
    centre = middle + float(at[1]) * spread
    coupling = np.concatenate([each.low(each.coupling(width, centre), each.load_rows) for each in parts]) @ factors[4:6]
    load = np.concatenate([each.low(each.load, each.load_rows) for each in parts])
    found = scaled_solution(load, coupling, _SMALLEST)
    starts = _joined([each.starts(each.load_rows) for each in parts], [len(each.load_rows) for each in parts])
    again = np.sqrt(np.maximum(np.diag(sandwich(load, coupling - load @ found, starts)), 0.0))
    # the torque of the coupling is in proportion to its stiffness, whose error it shares
    share = own[4] / abs(factors[4]) if factors[4] else math.inf
    for name, k in (("load_inertia", 0), ("load_friction", 1)):
        values[name], errors[name] = found[k], math.hypot(again[k], share * found[k])
    clear = [name for name in values if values[name] > th.LOAD_SIDE_CLEAR * errors[name]]
    return LoadSide({name: float(values[name]) for name in clear}, {name: float(errors[name]) for name in clear})


def _joined(starts: Sequence[Any], counts: Sequence[int]) -> Any:
    begins = np.cumsum([0, *counts])[:-1]
    return np.concatenate([begin + each for begin, each in zip(begins, starts, strict=True)]).astype(np.intp)
