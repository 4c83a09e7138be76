"""Announcement of the motions of a tuning: which axis moves how far, how fast and how long. Pure."""

from collections.abc import Iterable, Mapping

from friction_hil.config import AxisConfig, Configuration, ExperimentBounds
from friction_hil.config.trajectories import peak_speed
from friction_hil.daemon.assembly import make_path
from friction_hil.daemon.safety import SPEED_MARGIN
from friction_hil.motion.trajectory import extent
from friction_hil.numerics.readable import brief

_ROUNDING = 1e-6


def allowed_speeds(run: Configuration, bounds: Mapping[str, ExperimentBounds]) -> dict[str, float]:
    """Return the highest speed that each of these axes may have in a run, rad/s or m/s.

    It is that of its motion, or of its experiment if that is higher: an axis that breaks away from friction jumps, in a
    slow motion much faster than the motion is, and the user allows it that speed.
    """
    return {name: max(peak_speed(run.axes[name].trajectory), each.velocity) for name, each in bounds.items()}


def experiment_text(run: Configuration, name: str, bounds: ExperimentBounds, duration_s: float) -> str:
    """Describe the experiment of an axis.

    Parameters
    ----------
    run : Configuration
        From `friction_hil.tuning.motions.experiment_run`.
    name : str
    bounds : ExperimentBounds
        Its travel and velocity.
    duration_s : float
        Duration of the run, s.
    """
    unit = _unit(run.axes[name])
    return (
        f"{name} moves by up to {bounds.travel:g} {unit} to either side of where it stands, "
        f"{_speed(run.axes[name], bounds.velocity)}, for {duration_s:.0f} s, without compensation"
        f"{_others(run, (name,))}"
    )


def trial_text(
    run: Configuration, bounds: Mapping[str, ExperimentBounds], labels: Mapping[str, str], duration_s: float
) -> str:
    """Describe the trial of a model on each axis, given its label.

    Parameters
    ----------
    run : Configuration
        From `friction_hil.tuning.motions.trial_run`.
    bounds : dict of ExperimentBounds
        Of these axes.
    labels : dict of str
        Label of the model by axis.
    duration_s : float
        Duration of the run, s.
    """
    motions = []
    speeds = allowed_speeds(run, bounds)
    for name, label in labels.items():
        axis = run.axes[name]
        # none of these motions depends on the resolution of the encoder
        low, high, _ = extent(make_path(axis, 0.0, run.period_s), 1.0 / getattr(axis.trajectory, "frequency", 1.0))
        motions.append(
            f"{name} moves between {_distance(low, high)} and {_distance(high, low)} {_unit(axis)} from where it "
            f"stands ({axis.trajectory.kind}), {_speed(axis, speeds[name])}, compensated by {label}"
        )
    return (
        f"{'; '.join(motions)}; all for {duration_s:.0f} s, the first half without compensation{_others(run, labels)}"
    )


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
    return "rad" if axis.model.axis == "rotary" else "m"
