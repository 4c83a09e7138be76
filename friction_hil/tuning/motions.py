"""Configurations of the runs that tune a machine. Pure."""

import math
from collections.abc import Mapping

from friction_hil.config import (
    AxisConfig,
    Circle,
    Compensation,
    Configuration,
    Experiment,
    ExperimentBounds,
    Hold,
    Multisine,
    Sine,
    Strokes,
    Triangle,
)
from friction_hil.config.trajectories import PeriodicMotion
from friction_hil.daemon.assembly import experiment_sweeps, multisine_plan, ramp_s
from friction_hil.daemon.safety import LoopState
from friction_hil.errors import FrictionHilError, OptionError
from friction_hil.models.model_file import ModelFile
from friction_hil.motion import experiment, multisine
from friction_hil.recordings import Recording
from friction_hil.servo.mechanisms import Gantry
from friction_hil.tuning import thresholds as th
from friction_hil.tuning.trial_motions import sequences, trial_motions


class TuningError(FrictionHilError):
    """A run failed, or its recording cannot be used. Example: a fault of a drive."""


def refuse_shared_beam(name: str, configuration: Configuration) -> None:
    """Refuse an axis that cannot move while the others stand still; an `OptionError`: it is an axis of a gantry."""
    shared = configuration.simulation
    if shared is None or not isinstance(shared.mechanism, Gantry) or name not in shared.mechanism.axes:
        return
    [other] = (each for each in shared.mechanism.axes if each != name)
    raise OptionError(
        name,
        "simulation",
        f"moves one beam with {other} (simulation.mechanism), which would twist while tune moves {name} and holds "
        f"{other}: record a 'friction-hil run' in which both move, and identify the friction from the recording with "
        f"'friction-hil identify RECORDING --axis {name}'",
    )


def experiment_of(name: str, axis: AxisConfig) -> ExperimentBounds:
    """Return how far and how fast an axis may move in its experiment.

    Raises `OptionError`: the configuration does not define it, has no set-point for the axis, or disables the
    compensation.
    """
    if axis.trajectory.kind == "none":
        raise OptionError(
            name,
            "trajectory.kind",
            "is 'none': to move by itself, the axis needs a set-point; try hold, with a controller",
        )
    if not axis.compensation.enabled:
        raise OptionError(
            name,
            "compensation.enabled",
            "is false, and tune tries what it finds: make it true (or record an experiment and use 'identify')",
        )
    if axis.experiment is not None:
        return axis.experiment
    if isinstance(axis.trajectory, Experiment):
        return axis.trajectory
    raise OptionError(
        name,
        "experiment",
        "is missing: it says how far and how fast the axis may move by itself, e.g. "
        f"experiment: {{velocity: {0.5 * axis.limits.velocity:g}, travel: ..., duration_s: 60}}",
    )


def experiment_run(configuration: Configuration, name: str, part_s: float | None = None) -> tuple[Configuration, float]:
    """Return the run in which one axis makes its experiment and the others are held, uncompensated; duration, s.

    With ``part_s`` it is a part of that length, complete in itself; by default the experiment is not divided.
    """
    bounds = part_bounds(configuration, name, part_s)
    motion = Experiment(kind="experiment", **{key: getattr(bounds, key) for key in ExperimentBounds.model_fields})
    run = held(configuration, {name: motion})
    return run, motion.duration_s + ramp_s(run.axes.values()) + th.REST_S


def shaken_run(configuration: Configuration, name: str) -> tuple[Configuration, float]:
    """Return the run in which one axis is shaken while it slides and the others are held, uncompensated; duration, s.

    Raises `UsageError`: the bounds of the experiment leave no room for it.
    """
    bounds = experiment_of(name, configuration.axes[name])
    given = {key: getattr(bounds, key) for key in ("velocity", "travel", "acceleration", "ramp_s")}
    duration_s = min(max(bounds.duration_s, multisine.LEAST_S), multisine.DURATION_S)
    motion = Multisine(kind="multisine", duration_s=duration_s, **given)
    plan = multisine_plan(motion, configuration.period_s)
    run = held(configuration, {name: motion})
    return run, plan.duration_s + motion.ramp_s + ramp_s(run.axes.values()) + th.REST_S


def held(configuration: Configuration, motions: Mapping[str, Experiment | Multisine] | None = None) -> Configuration:
    """Return the run in which axes make these motions and the others are held, uncompensated."""
    axes = {each: _held(axis) for each, axis in configuration.axes.items()}
    for name, motion in (motions or {}).items():
        axes[name] = axes[name].model_copy(update={"trajectory": motion})
    return configuration.model_copy(update={"axes": axes})


def part_bounds(configuration: Configuration, name: str, part_s: float | None = None) -> ExperimentBounds:
    """Return the bounds of a part of an experiment, of ``part_s`` seconds; None for all of it."""
    bounds = experiment_of(name, configuration.axes[name])
    return bounds if part_s is None else bounds.model_copy(update={"duration_s": part_s})


def sliding_part(recording: Recording, configuration: Configuration, part_s: float | None = None) -> Recording:
    """Return the slow sweeps from the recording of an `experiment_run`, for models without presliding.

    In the fast sweeps the torque depends on the position, like that of a spring: no map of the velocity describes it.
    ``configuration``: from which that run was made; ``part_s``: as given to `experiment_run`.
    """
    name = recording.axis
    run, _ = experiment_run(configuration, name)
    [facts] = (each for each in recording.metadata["facts"] if each["name"] == name)
    bounds = part_bounds(configuration, name, part_s)
    sweeps = experiment_sweeps(bounds, facts["position_resolution"], configuration.period_s)
    cycle = recording["cycle"]
    start = cycle[recording["state"] == LoopState.RUNNING][0]
    # the time of the path lags by half of its ramp
    length_s = 0.5 * ramp_s(run.axes.values()) + experiment.sliding_s(sweeps)
    is_kept = cycle < start + length_s / configuration.period_s
    return recording.at(is_kept)


def trial_run(
    configuration: Configuration,
    models: Mapping[str, ModelFile],  # to try, by axis
    resolutions: Mapping[str, float],  # one count of the encoder by axis, rad or m
    gains: Mapping[str, float] | None = None,  # by axis; None: the configured ones
) -> tuple[Configuration, float]:
    """Return the run in which axes make the motions of a trial, compensated by these models; its duration, s.

    The axes begin each motion together (`friction_hil.tuning.trial_motions`). One without a periodic trajectory makes a
    small sine as its own motion; one without a model to try is held.

    Raises `TuningError`: a model lacks the inertia, and the compensation is configured to use it.
    """
    motions, accelerations, ramps = {}, {}, [ramp_s(())]
    for name, model in models.items():
        axis = configuration.axes[name]
        _refuse_unknown_inertia(name, axis, model)
        bounds, own = experiment_of(name, axis), own_motion(name, axis)
        motions[name] = trial_motions(own, bounds, resolutions[name])
        accelerations[name] = math.inf if bounds.acceleration is None else bounds.acceleration
        ramps += [bounds.ramp_s, getattr(own, "ramp_s", 0.0)]
    fade_s = max(configuration.axes[name].compensation.fade_s for name in models)
    paths = sequences(motions, max(ramps), fade_s, accelerations)
    axes = {name: _held(axis) for name, axis in configuration.axes.items()}
    for name, model in models.items():
        axis = configuration.axes[name]
        gain = (gains or {}).get(name, axis.compensation.gain)
        compensation = axis.compensation.model_copy(update={"baseline_s": 0.0, "gain": gain})
        axes[name] = axis.model_copy(update={"trajectory": paths[name], "model": model, "compensation": compensation})
    duration_s = max(path.duration_s for path in paths.values()) + ramp_s(axes.values())
    return configuration.model_copy(update={"axes": axes}), duration_s + th.REST_S


def uncompensated(run: Configuration) -> Configuration:
    """Return the same run without compensation."""
    axes = {
        name: axis.model_copy(update={"compensation": axis.compensation.model_copy(update={"enabled": False})})
        for name, axis in run.axes.items()
    }
    return run.model_copy(update={"axes": axes})


def _held(axis: AxisConfig) -> AxisConfig:
    """Return the configuration of an axis that is held; one that is moved by hand stays free."""
    trajectory = axis.trajectory if axis.trajectory.kind == "none" else Hold(kind="hold")
    return axis.model_copy(
        update={"trajectory": trajectory, "compensation": Compensation(enabled=False), "shadows": ()}
    )


def own_motion(name: str, axis: AxisConfig) -> PeriodicMotion:
    """Return the motion of an axis, or a small sine if it has no periodic one."""
    if isinstance(axis.trajectory, Circle | Sine | Triangle | Strokes):
        return axis.trajectory
    bounds = experiment_of(name, axis)
    amplitude = min(th.TRIAL_TRAVEL * bounds.travel, th.TRIAL_SPEED * bounds.velocity / (math.tau * th.TRIAL_HZ))
    return Sine(kind="sine", amplitude=amplitude, frequency=th.TRIAL_HZ, ramp_s=bounds.ramp_s)


def _refuse_unknown_inertia(name: str, axis: AxisConfig, model: ModelFile) -> None:
    """Refuse to try a model that lacks the inertia if the compensation is configured to use it."""
    given = axis.compensation
    if model.mechanics.inertia > 0.0 or (given.velocity != "kalman" and given.adaptation is None):
        return
    key = "velocity: kalman" if given.velocity == "kalman" else "adaptation"
    raise TuningError(
        f"{name}: the experiment does not show the inertia, which compensation: {{{key}}} needs: let it accelerate "
        "harder (experiment: velocity, acceleration), or take that out of the compensation"
    )
