"""Friction of all joints of an arm, told from the arm's own dynamics, from a log of all of them. Pure.

Of each joint, in the rows in which it slides::

    torque = Y(q, dq, ddq) p + rotor ddq + coulomb s + viscous dq + offset + load |Y p| s,    s = sign(dq)

Y is the regressor of the rigid links and p their standard inertial parameters, those of all joints together. A file is
never right about p, and a log never determines all of it: p has a normal prior about the file's values, as wide as such
files are wrong, so that each combination comes from the log as far as that knows it better. Friction has none. The
search is Gauss and Newton's, with Huber's weights, and with the rows of each joint weighted by its noise as it counts
for correlated rows. Standard errors allow for that correlation, too, and for the prior (Newey and West 1987).

Sources: M. Gautier, Ph. Poignet, Control Engineering Practice 9(12), 2001; C. Gaz, M. Cognetti, A. Oliva, P. Robuffo
Giordano, A. De Luca, IEEE Robotics and Automation Letters 4(4), 2019 (a log does not determine all parameters).
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from friction_hil.dynamics import Arm
from friction_hil.dynamics.newton_euler import PARAMETERS
from friction_hil.errors import RecordingError, UsageError
from friction_hil.identification import thresholds as th
from friction_hil.identification.arm_search import FRICTION, Rows, Search, prior_spread, solved
from friction_hil.identification.data import RegressionSegment, is_sliding, prepare
from friction_hil.numerics import filtering
from friction_hil.numerics.jit import Array
from friction_hil.recordings import Recording
from friction_hil.recordings.quality import acceleration_noise, resolution
from friction_hil.recordings.segments import between_counts, even_signals


@dataclass(frozen=True, slots=True)
class JointFriction:
    """What a log says of one joint, SI."""

    name: str
    values: dict[str, float]  # those of `FRICTION`, and ``rotor``: inertia, kg m^2 or kg; left out: not determined
    errors: dict[str, float]  # standard errors
    rows: int  # in which it slides
    relative_error: float  # of the torque in these rows; NaN: none
    held_out: float  # the same in blocks of time that were not fitted
    alone: float  # the same for friction, inertia and a pendulum of this joint alone
    least_speed: float  # rad/s or m/s: slower rows do not count
    load_range: tuple[float, float]  # smallest and largest |load| in these rows, N m or N
    flags: tuple[str, ...]

    @property
    def is_known(self) -> bool:
        """True if its friction is determined."""
        return "coulomb" in self.values


@dataclass(frozen=True, slots=True, eq=False)
class ArmFit:
    """Friction and dynamics of an arm from a log."""

    arm: Arm  # with the refitted parameters
    joints: tuple[JointFriction, ...]
    determined: int  # combinations of inertial parameters that the log knows better than the file
    combinations: int  # that any motion could show
    error_of_file: tuple[float, ...]  # of each joint: RMS of file's less refitted rigid torque, over that of the latter
    # how far the log pulls the inertial parameters from the file's, in what such files are off by: about 1, or less
    contradiction: float
    is_physical: bool  # the refitted inertia matrix is positive wherever the log was: it may be simulated
    problems: tuple[str, ...]
    lowpass_hz: float  # of the positions from which velocity and acceleration come
    decimation: int
    sliding_s: float  # time before and after a row in which a joint slides, if the row counts


def _together(recordings: Sequence[Recording], arm: Arm) -> list[Recording]:
    """Return position and torque of all joints in the rows in which all of them have both."""
    if len(recordings) != len(arm):
        raise UsageError(f"the arm has {len(arm)} joints, and the log {len(recordings)}")
    plain = []
    for each in recordings:
        each.require("position", "torque")
        columns = {name: each[name] for name in ("time_s", "position", "torque")}
        plain.append(replace(each, columns=columns, problems=list(each.problems)))
    time = plain[0]["time_s"]
    if any(len(each) != len(time) or not np.array_equal(each["time_s"], time) for each in plain):
        raise RecordingError(f"{plain[0].path}: the joints have different time stamps")
    known = np.all([np.isfinite(values) for each in plain for values in each.columns.values()], axis=0)
    if not known.any():
        empty = [each.axis for each in plain if not np.isfinite(each["position"] + each["torque"]).any()]
        lacking = f"joint {', '.join(empty)} has none" if empty else "no row has them of all joints"
        raise RecordingError(f"{plain[0].path}: position and torque must be finite numbers, and {lacking}")
    return [each.at(known) for each in plain]


def _segments(logs: Sequence[Sequence[Recording]], lowpass_hz: float, decimation: int) -> list[list[RegressionSegment]]:
    """Return the segments of each joint, those of all joints with the same rows."""
    prepared = [
        [part for each in joint for part in prepare(each, lowpass_hz=lowpass_hz, decimation=decimation)]
        for joint in zip(*logs, strict=True)
    ]
    # the rows at the end, where the filters have settled of steady joints only, are left out of all
    ends = [min(each.end for each in parts) for parts in zip(*prepared, strict=True)]
    return [[replace(each, end=end) for each, end in zip(joint, ends, strict=True)] for joint in prepared]


def _lowpass_hz(recording: Recording) -> float:
    """Return the cut-off below which the encoder's counts bias no inertia that other joints feel, too."""
    signals = even_signals(recording)
    assert signals.lowpass_hz is not None  # the recording has no velocity
    cut_hz, rate_hz = signals.lowpass_hz, signals.grid.rate_hz
    longest = max(signals.grid.segments, key=lambda rows: rows.stop - rows.start)
    position = signals.grid.columns["position"][longest]
    step = resolution(position)
    while step is not None and cut_hz > th.ARM_LEAST_LOWPASS * rate_hz:
        smooth = filtering.lowpass(between_counts(position), cut_hz, rate_hz)
        acceleration = np.gradient(np.gradient(smooth, 1.0 / rate_hz), 1.0 / rate_hz)
        if acceleration_noise(step, cut_hz, rate_hz) <= th.ARM_NOISE_RATIO * float(np.std(acceleration)):
            break
        cut_hz *= th.ARM_LOWPASS_STEP
    return cut_hz


def _rows_of(segments: Sequence[Sequence[RegressionSegment]], arm: Arm, lowpass_hz: float, least: Array) -> Rows:
    parts = []
    first = segments[0][0]
    repeated = max(first.rate_hz / first.decimation / (2.0 * lowpass_hz), 1.0)
    for number, joints in enumerate(zip(*segments, strict=True)):
        q, dq, ddq = (
            np.column_stack([each.kept_rows(getattr(each, name)) for each in joints])
            for name in ("position", "velocity", "acceleration")
        )
        torque = np.column_stack([each.kept_rows(each.lowpass(each.torque)) for each in joints])
        reach_s = th.ARM_MIXED_PERIODS / lowpass_hz
        slides = np.column_stack(
            [each.kept_rows(is_sliding(each, speed, reach_s, 0.0)) for each, speed in zip(joints, least, strict=True)]
        )
        parts.append(Rows(dq, ddq, q, torque, arm.regressor(q, dq, ddq), slides, np.full(len(q), number), repeated))
    names = ("velocity", "acceleration", "position", "torque", "regressor", "slides", "part")
    stacked = {name: np.concatenate([getattr(each, name) for each in parts]) for name in names}
    return Rows(**stacked, repeated=repeated)


def identify_arm(
    logs: Sequence[Sequence[Recording]],  # one recording for each joint, with the same time stamps
    arm: Arm,
    *,
    lowpass_hz: float | None = None,  # None: as the encoders allow
    least_speed: float = 0.0,  # rad/s or m/s: slower rows do not count
) -> ArmFit:
    """Find friction of all joints, and the inertial parameters of the arm as far as the log determines them.

    Raises `RecordingError`: a column is missing, the log is too short, or no joint moves; `UsageError`: the log has not
    as many joints as the arm.
    """
    together = [_together(log, arm) for log in logs]
    cut_hz = min(_lowpass_hz(each) for log in together for each in log) if lowpass_hz is None else lowpass_hz
    count = sum(len(log[0]) for log in together)
    decimation = max(1, min(th.ARM_MOST_DECIMATION, count // 1000), count // th.ARM_MOST_ROWS)
    segments = _segments(together, cut_hz, decimation)
    tops, still = [], []
    for joint, is_linear in zip(segments, arm.is_linear, strict=True):
        tops.append(float(np.quantile(np.abs(np.concatenate([each.velocity for each in joint])), 0.99)))
        step = max(each.resolution or 0.0 for each in joint)
        travel = float(np.ptp(np.concatenate([each.encoder for each in joint])))
        still.append(travel <= max(th.ARM_STILL * step, th.ARM_STILL_M if is_linear else th.ARM_STILL_RAD))
    least = np.where(still, math.inf, np.maximum(th.ARM_SLOW * np.array(tops), least_speed))
    rows = _rows_of(segments, arm, cut_hz, least)
    forward = np.sum(rows.slides & (rows.velocity > 0.0), axis=0)
    backward = np.sum(rows.slides & (rows.velocity < 0.0), axis=0)
    moves = [bool(each) for each in forward + backward >= th.ARM_LEAST_ROWS]
    if not any(moves):
        fewest = th.ARM_LEAST_ROWS
        raise RecordingError(f"{logs[0][0].path}: no joint slides in {fewest} rows or more; record more motion")
    both = [bool(each) for each in (np.minimum(forward, backward) >= th.ARM_LEAST_ROWS // 2) & moves]
    rows = replace(rows, slides=rows.slides & np.array(moves))
    for k, name in enumerate(arm.joints):
        if moves[k] and not np.any(rows.torque[rows.slides[:, k], k]):
            raise RecordingError(f"{logs[0][k].path}: the torque of joint {name} is zero wherever it slides")
    used = {"rotor": moves, "coulomb": moves, "viscous": moves, "offset": both, "load": moves}
    search, covariance, information = _searched(rows, arm, used)
    for _ in range(th.ARM_ROUNDS):
        left = {
            name: [flag and _is_kept(search, covariance, name, k) for k, flag in enumerate(flags)]
            for name, flags in used.items()
        }
        if left == used:
            break
        used = left
        search, covariance, information = _searched(rows, arm, used)
    held_out, alone = _cross_validation(rows, arm, used, search.values)
    rigid = search.rigid(rows)
    file = rows.regressor @ search.prior
    off = np.sqrt(np.mean((file - rigid) ** 2, axis=0)) / np.maximum(np.sqrt(np.mean(rigid**2, axis=0)), 1e-12)
    joints = tuple(
        _result(search, covariance, k, both[k], moves[k], rigid[:, k], held_out[k], alone[k], float(least[k]))
        for k in range(len(arm))
    )
    fitted = arm.with_parameters(search.values[: search.wide], search.values[search.wide : search.wide + len(arm)])
    some = rows.position[:: 1 + len(rows.position) // th.ARM_POSITIONS]
    is_physical = bool(np.min(np.linalg.eigvalsh(fitted.inertia_matrix(some))) > 0.0)
    problems = tuple(dict.fromkeys(text for joint in segments for each in joint for text in each.problems))
    every = combinations(arm)
    known = min(_determined(search, information), every)
    pulled = float(np.sum(((search.values[: search.wide] - search.prior) / search.spread) ** 2))
    contradiction = math.sqrt(pulled / max(known, 1))
    return ArmFit(
        fitted,
        joints,
        known,
        every,
        tuple(map(float, off)),
        contradiction,
        is_physical,
        problems,
        cut_hz,
        decimation,
        th.ARM_MIXED_PERIODS / cut_hz,
    )


def _searched(rows: Rows, arm: Arm, used: Mapping[str, Sequence[bool]]) -> tuple[Search, Array, Array]:
    """Return the search with some parameters, their covariance, and the information that the log has of them."""
    search = Search(rows, arm, used)
    search.run()
    return search, *search.covariance()


def _is_kept(search: Search, covariance: Array, name: str, joint: int) -> bool:
    """Return whether a parameter of a joint is determined, and has a sign that it can have."""
    place = search.place(name, joint)
    value = float(search.values[place])
    if name == "load":
        error = math.sqrt(max(float(covariance[search.index(place), search.index(place)]), 0.0))
        return value > 0.0 and error <= max(th.ARM_LOAD, value / th.LOAD_CLEAR)
    return value > 0.0 or name in ("offset", "coulomb")


def _result(
    search: Search,
    covariance: Array,
    joint: int,
    is_both: bool,
    is_moving: bool,
    rigid: Array,
    held_out: float,
    alone: float,
    least: float,
) -> JointFriction:
    name, rows = search.arm.joints[joint], search.rows
    use = rows.slides[:, joint]
    if not is_moving:
        flag = "it hardly slides in this log: nothing of it is determined; move it, both ways"
        return JointFriction(name, {}, {}, int(use.sum()), math.nan, math.nan, math.nan, least, (0.0, 0.0), (flag,))
    places = {each: search.place(each, joint) for each in ("rotor", *FRICTION)}
    values = {each: float(search.values[place]) for each, place in places.items() if search.is_free[place]}
    errors = {
        each: math.sqrt(max(float(covariance[search.index(place), search.index(place)]), 0.0))
        for each, place in places.items()
        if search.is_free[place]
    }
    flags = []
    if not is_both:
        flags.append("it slides in one direction only: its offset is taken for 0 and its friction may be wrong by it")
    if "load" not in values:
        flags.append("friction per load does not show and is taken for 0: let it lift and lower more at several speeds")
    if values["coulomb"] < -th.SURE * errors["coulomb"]:
        flags.append("its torque points against friction: turn the sign of the torque, or of the joint (--signs)")
    flags += [
        f"not determined: {each} {values[each]:.3g} with a standard error of {errors[each]:.2g}"
        for each in ("coulomb", "viscous")
        if each in values and errors[each] > th.VAGUE * abs(values[each])
    ]
    if held_out > th.ARM_WORSE * alone:
        flags.append(
            f"the arm explains its torque less well ({100 * held_out:.1f} % on held-out data) than the joint alone "
            f"({100 * alone:.1f} %): check order, signs and units of the joints, and the file"
        )
    measured = rows.torque[use, joint]
    error = float(np.linalg.norm(measured - search.torque(rows, joint)) / max(float(np.linalg.norm(measured)), 1e-300))
    loads = np.abs(rigid[use])
    span = (float(np.min(loads)), float(np.max(loads)))
    return JointFriction(name, values, errors, int(use.sum()), error, held_out, alone, least, span, tuple(flags))


def _cross_validation(
    rows: Rows, arm: Arm, used: Mapping[str, Sequence[bool]], start: Array
) -> tuple[list[float], list[float]]:
    """Return the errors of each joint's torque in blocks that are not fitted: of the arm, and of the joint alone."""
    count, n = len(rows.torque), len(arm)
    fold = th.ARM_FOLDS * np.arange(count) // count
    squares = np.zeros((3, n))  # of the arm's errors, those of the joints alone, and the torques
    for number in range(th.ARM_FOLDS):
        kept, out = rows.at(fold != number), rows.at(fold == number)
        search = Search(kept, arm, used)
        search.values = start.copy()
        search.run(th.ARM_FOLD_STEPS)
        for k in range(n):
            use, fitted = out.slides[:, k], kept.slides[:, k]
            measured = out.torque[use, k]
            factors = np.linalg.lstsq(_alone(kept, k), kept.torque[fitted, k], rcond=1e-9)[0]
            squares[0, k] += float(np.sum((measured - search.torque(out, k)) ** 2))
            squares[1, k] += float(np.sum((measured - _alone(out, k) @ factors) ** 2))
            squares[2, k] += float(np.sum(measured**2))
    errors = np.sqrt(squares[:2] / np.maximum(squares[2], 1e-300))
    return [float(each) for each in errors[0]], [float(each) for each in errors[1]]


def _alone(rows: Rows, joint: int) -> Array:
    """Return inertia, Coulomb and viscous friction, offset and a pendulum of one joint."""
    use = rows.slides[:, joint]
    q, v = rows.position[use, joint], rows.velocity[use, joint]
    return np.column_stack([rows.acceleration[use, joint], np.sign(v), v, np.ones_like(v), np.sin(q), np.cos(q)])


def _determined(search: Search, information: Array) -> int:
    """Return how many combinations of inertial parameters the log knows better than the file, whatever friction is."""
    wide = search.wide
    links, mixed, others = information[:wide, :wide], information[:wide, wide:], information[wide:, wide:]
    left = links - mixed @ solved(others, mixed.T)
    return int(np.sum(np.linalg.eigvalsh(left * np.outer(search.spread, search.spread)) > 1.0))


def combinations(arm: Arm) -> int:
    """Return how many combinations of inertial parameters change any torque."""
    rng = np.random.default_rng(1)
    states = rng.normal(size=(3, 20 * len(arm), len(arm)))
    stacked = arm.regressor(*states).reshape(-1, PARAMETERS * len(arm)) * prior_spread(arm)
    singular = np.linalg.svd(stacked, compute_uv=False)
    return int(np.sum(singular > th.ARM_RANK * singular[0]))


def as_axes(recordings: Sequence[Recording], fit: ArmFit) -> list[Recording]:
    """Return a recording of each joint as an axis of its own: its torque without that of the links, which is its load.

    What is left is friction and the rotor's inertia.
    """
    segments = _segments([_together(recordings, fit.arm)], fit.lowpass_hz, fit.decimation)
    states = [
        np.concatenate(
            [np.column_stack([getattr(each, name) for each in joints]) for joints in zip(*segments, strict=True)]
        )
        for name in ("position", "velocity", "acceleration")
    ]
    rigid = fit.arm.with_parameters(fit.arm.parameters, np.zeros(len(fit.arm))).inverse_dynamics(*states)
    found = []
    for k, (recording, joint) in enumerate(zip(recordings, segments, strict=True)):
        columns = {
            name: np.concatenate([getattr(each, source) for each in joint])
            for name, source in (("time_s", "time_s"), ("position", "encoder"), ("torque", "torque"))
        }
        columns["torque"] = columns["torque"] - rigid[:, k]
        columns["load_torque"] = np.ascontiguousarray(rigid[:, k])
        found.append(replace(recording, axis=fit.joints[k].name, columns=columns))
    return found
