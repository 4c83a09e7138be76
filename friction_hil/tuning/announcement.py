"""Announcement of the motions of a tuning: which axis moves how far, how fast and how long. Pure."""

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence

from friction_hil.config import AxisConfig, Configuration, ExperimentBounds, MotionSequence, Multisine
from friction_hil.config.trajectories import PeriodicMotion, peak_speed
from friction_hil.daemon.assembly import multisine_plan, periodic_path
from friction_hil.daemon.safety import SPEED_MARGIN
from friction_hil.motion.experiment import coarsest, is_fast
from friction_hil.motion.trajectory import extent
from friction_hil.numerics.readable import POSITION_UNITS, brief
from friction_hil.tuning import thresholds as th
from friction_hil.tuning.trial_motions import RESTS, SLOW, SMALL, TINY

_ROUNDING = 1e-6


def allowed_speeds(run: Configuration, bounds: Mapping[str, ExperimentBounds]) -> dict[str, float]:
    """Return the highest speed that each of these axes may have in a run, rad/s or m/s.

    It is that of its motion, or of its experiment if that is higher, but at least a part of ``limits.velocity``: an
    axis that breaks away from friction jumps, however slow its motion is.
    """
    return {name: _allowed_speed(run.axes[name], each) for name, each in bounds.items()}


def _allowed_speed(axis: AxisConfig, bounds: ExperimentBounds) -> float:
    return max(peak_speed(axis.trajectory), bounds.velocity, th.JUMP * axis.limits.velocity / SPEED_MARGIN)


def experiment_text(
    run: Configuration, name: str, bounds: ExperimentBounds, duration_s: float, parts_s: Sequence[float] = ()
) -> str:
    """Describe the experiment of an axis.

    ``run``: from `friction_hil.tuning.motions.experiment_run`. ``bounds``: travel and velocity of the experiment.
    ``duration_s``: of all runs. ``parts_s``: lengths of its parts, s.
    """
    axis = run.axes[name]
    unit = _unit(axis)
    is_divided = len(parts_s) > 1
    in_parts = (
        f"; it moves in parts of {', '.join(f'{each:g}' for each in parts_s)} s, as many as needed: after each its "
        "drive is disabled for some seconds, and the next one begins without a question"
    )
    return (
        f"{name} moves by up to {bounds.travel:g} {unit} to either side of where it stands, "
        f"{_speed(axis, _allowed_speed(axis, bounds))}, for {'at most ' if is_divided else ''}{duration_s:.0f} s, "
        f"without compensation{in_parts if is_divided else ''}"
        f"{_others(run, (name,))}{_presliding(run, bounds, unit)}"
    )


def shaken_text(run: Configuration, name: str, bounds: ExperimentBounds, duration_s: float) -> str:
    """Describe the motion that shakes an axis; parameters as of `experiment_text`, of `motions.shaken_run`."""
    axis = run.axes[name]
    if not isinstance(axis.trajectory, Multisine):
        raise TypeError(f"an axis is shaken by a multisine, not by {axis.trajectory.kind}")
    plan = multisine_plan(axis.trajectory, run.period_s)
    unit = _unit(axis)
    return (
        f"{name} moves by up to {bounds.travel:g} {unit} to either side of where it stands, "
        f"{_speed(axis, _allowed_speed(axis, bounds))}, for {duration_s:.0f} s, without compensation: strokes of "
        f"constant speed, shaken by up to {plan.sine_acceleration:.3g} {unit}/s^2 from {plan.low_hz:g} to "
        f"{plan.high_hz:g} Hz, which can be heard{_others(run, (name,))}"
    )


def _presliding(run: Configuration, bounds: ExperimentBounds, unit: str) -> str:
    """Return what it takes to show presliding: which encoder there is, is known when the drive answers."""
    if not is_fast(1.0 / run.period_s):
        text = "is too long to show presliding: only sliding friction is identified"
        return f"; a period of {1e3 * run.period_s:g} ms {text}"
    acceleration = math.inf if bounds.acceleration is None else bounds.acceleration
    count = coarsest(bounds.velocity, bounds.travel, acceleration=acceleration)
    return f"; presliding is identified too if one encoder count is {count:.2g} {unit} or less"


def trial_text(
    run: Configuration,  # from `friction_hil.tuning.motions.trial_run`
    bounds: Mapping[str, ExperimentBounds],  # of these axes
    labels: Sequence[Mapping[str, str]],  # label of the model by axis, for each run with compensation
    duration_s: float,  # of each run
    *,
    has_baseline: bool = False,  # the run without compensation was made ahead; without labels it is described alone
) -> str:
    """Describe the runs of a trial: the motions of each axis, and what compensates it in each run."""
    speeds = allowed_speeds(run, bounds)
    lines = [line for name in bounds for line in _motions(name, run, speeds[name])]
    turns = [
        *([] if has_baseline else ["without compensation"]),
        *(f"compensated by {_models(each)}" for each in labels),
    ]
    has_other_gains = any(run.axes[name].compensation.gain_negative is None for name in bounds)
    more = f", then at most {th.MOST_GAINS} times more by the best model at other gains" if has_other_gains else ""
    if not labels:
        more = ", while the models are computed that are tried on the same motions then"
    every = "all of it" if len(bounds) == 1 else "all axes at once, all of it"
    times = f"{len(turns)} times" if len(turns) > 1 else "once"
    return "\n".join(
        [*lines, f"{every} in {duration_s:.0f} s, {times}: {', '.join(turns)}{more}{_others(run, bounds)}"]
    )


def once_more_text(
    run: Configuration, bounds: Mapping[str, ExperimentBounds], labels: Mapping[str, str], duration_s: float
) -> str:
    """Describe a further run of a trial, with the parameters of `trial_text` and the label of the model by axis."""
    return (
        f"the same motions once more, for {duration_s:.0f} s, compensated by {_models(labels)}, because the reported "
        f"torque is not the commanded one{_others(run, bounds)}"
    )


def _motions(name: str, run: Configuration, allowed: float) -> Iterator[str]:
    """Yield how far and how fast an axis moves, then a line for each of its motions."""
    axis = run.axes[name]
    sequence = axis.trajectory
    if not isinstance(sequence, MotionSequence):
        raise TypeError(f"a trial is a sequence of motions, not {sequence.kind}")
    ends = [_ends(part.motion) for part in sequence.motions]
    low, high = min(each[0] for each in ends), max(each[1] for each in ends)
    unit = _unit(axis)
    yield (
        f"{name} moves between {_distance(low, high)} and {_distance(high, low)} {unit} from where it stands, "
        f"{_speed(axis, allowed)}:"
    )
    for part, (low, high) in zip(sequence.motions, ends, strict=True):
        yield (
            f"  {part.name}: {part.motion.kind} between {_distance(low, high)} and {_distance(high, low)} {unit}, "
            f"at up to {peak_speed(part.motion):.3g} {unit}/s, for {brief(part.moving_s, 2)} s"
        )
    names = [part.name for part in sequence.motions]
    if hidden := [each for each in (SLOW, SMALL, TINY, RESTS) if each not in names]:
        yield f"  without {', '.join(hidden)}: the encoder does not show such strokes"


def _ends(motion: PeriodicMotion) -> tuple[float, float]:
    """Return the lowest and the highest position of a motion relative to its start."""
    return extent(periodic_path(motion), 1.0 / motion.frequency)[:2]


def _models(labels: Mapping[str, str]) -> str:
    if len(set(labels.values())) == 1:
        return next(iter(labels.values()))
    return " and ".join(f"{label} ({name})" for name, label in labels.items())


def _distance(end: float, other: float) -> str:
    """Return one end of a motion; 0 for what is nothing but rounding beside the other end."""
    return brief(end if abs(end) > _ROUNDING * abs(other) else 0.0, 3)


def _speed(axis: AxisConfig, allowed: float) -> str:
    speed, unit = peak_speed(axis.trajectory), _unit(axis)
    limit = min(SPEED_MARGIN * allowed, axis.limits.velocity)
    first = ", after a small motion that confirms its units" if axis.mode == "csv" else ""
    return f"at up to {speed:.3g} {unit}/s (stopped above {limit:.3g} {unit}/s){first}"


def _others(run: Configuration, names: Iterable[str]) -> str:
    """Return which axes are held, and which may be moved by hand."""
    others = {name: axis.trajectory.kind for name, axis in run.axes.items() if name not in set(names)}
    held = [name for name, kind in others.items() if kind != "none"]
    free = [name for name, kind in others.items() if kind == "none"]
    return "".join(f"; {', '.join(some)} {how}" for some, how in ((held, "held"), (free, "free")) if some)


def _unit(axis: AxisConfig) -> str:
    return POSITION_UNITS[axis.model.axis]
