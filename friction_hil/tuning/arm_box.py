"""The space that an arm does not leave while it is tuned: planned motions by forward kinematics, before it moves."""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from friction_hil.config import Compensation, Configuration
from friction_hil.config.arm import ArmConfig
from friction_hil.daemon.assembly import make_path
from friction_hil.dynamics import Arm
from friction_hil.dynamics.newton_euler import potential_energy
from friction_hil.errors import RecordingError, UsageError
from friction_hil.numerics.jit import Array
from friction_hil.recordings import Recording
from friction_hil.replay.verify import facts_of
from friction_hil.tuning.motions import experiment_of, experiment_run, shaken_run, trial_run
from friction_hil.tuning.sequential import part_durations

_RATE_HZ = 50.0  # of the poses that are looked at
_MODEL_FREE = {"velocity": Compensation().velocity, "adaptation": None}  # a path needs no inertia


def has_box(configuration: Configuration) -> bool:
    """Return whether the arm of a configuration has a box."""
    return configuration.arm is not None and configuration.arm.box is not None


def refuse_plan(
    configuration: Configuration, names: Sequence[str], seen: Mapping[str, Recording], *, is_shaken: bool
) -> None:
    """Refuse a tuning in which the arm would leave its box; parameters and errors are those of `refuse_outside`."""
    for name in names:
        for part_s in dict.fromkeys(part_durations(experiment_of(name, configuration.axes[name]).duration_s)):
            refuse_outside(*experiment_run(configuration, name, part_s), seen, f"the experiment of {name}")
        if is_shaken:
            refuse_outside(*shaken_run(configuration, name), seen, f"the experiment in which {name} is shaken")
    axes = {
        name: axis.model_copy(update={"compensation": axis.compensation.model_copy(update=_MODEL_FREE)})
        for name, axis in configuration.axes.items()
    }
    plain = configuration.model_copy(update={"axes": axes})
    resolutions = {name: _resolution(each) for name, each in seen.items()}
    run = trial_run(plain, {name: axes[name].model for name in names}, resolutions)
    refuse_outside(*run, seen, "the trial")


def refuse_outside(
    run: Configuration,
    duration_s: float,
    seen: Mapping[str, Recording],  # of all axes at rest, where the run begins
    what: str,  # the run, in words
) -> None:
    """Refuse a run in which the origin of a joint or the centre of the payload would leave the box of the arm.

    Raises `UsageError`: it names the point, where it would be and when.
    """
    arm = run.arm
    assert arm is not None
    assert arm.box is not None
    times = np.linspace(0.0, duration_s, 1 + int(duration_s * _RATE_HZ))
    poses = np.column_stack([_start(seen[name]) + _way(run, name, seen[name], times) for name in arm.joints])
    low, high = (np.array(corner) for corner in arm.box)
    for point, places in _points(arm, poses):
        outside = np.flatnonzero(np.any((places < low) | (places > high), axis=1))
        if outside.size:
            first = int(outside[0])
            at, pose = (", ".join(f"{value:.3g}" for value in values[first]) for values in (places, poses))
            raise UsageError(
                f"{what}: {point} would be at [{at}] m after {times[first]:.1f} s, with {', '.join(arm.joints)} at "
                f"{pose}, outside arm.box {[list(corner) for corner in arm.box]}: begin in another pose, or lower "
                "'travel' of the experiment or the stroke of the trajectory of the joints that carry it"
            )


def _start(recording: Recording) -> float:
    """Return where an axis stands; a `RecordingError`: it has not reported a position."""
    position = recording["position"][np.isfinite(recording["position"])]
    if not position.size:
        raise RecordingError(f"{recording.axis}: the drive has reported no position, by which arm.box is checked")
    return float(position[-1])


def _resolution(recording: Recording) -> float:
    return facts_of(recording.metadata, recording).position_resolution


def _way(run: Configuration, name: str, recording: Recording, times: Array) -> Array:
    """Return how far an axis is from its start; start and stop of the run, which slow its path, are not in it."""
    path = make_path(run.axes[name], _resolution(recording), run.period_s)
    places = np.array([path(float(time_s))[0] for time_s in times])
    return np.asarray(places - places[0])


def _points(arm: ArmConfig, poses: Array) -> Iterator[tuple[str, Array]]:
    """Yield the points that are looked at, (rows, 3) in the frame of the base, m."""
    found = arm.dynamics
    for number, joint in enumerate(found.joints):
        mass = np.zeros(found.parameters.shape)
        mass[number, 0] = 1.0
        yield f"the origin of {joint}", _places(found.with_parameters(mass), poses)
    if (payload := arm.payload) is not None:
        mass = arm.point_mass(arm.joints, payload.center, payload.link)
        yield "the centre of the payload", _places(found.with_parameters(mass), poses)


def _places(mass: Arm, poses: Array) -> Array:
    """Return where the only mass of an arm is, 1 kg, by its potentials in fields along x, y and z."""
    rest, fields = np.zeros(len(mass)), -np.eye(3)
    return np.array([[potential_energy(mass.links, field, pose, rest)[0] for field in fields] for pose in poses])
