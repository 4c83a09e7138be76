"""Joints of a configuration: facts and compensators, and the arrays in which one compiled call steps all of them."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from friction_hil.compensator import STATE, records
from friction_hil.compensator import Compensator as JointCompensator
from friction_hil.compensator.change import carry_over
from friction_hil.config import AxisConfig, Configuration, located
from friction_hil.daemon.assembly import make_compensator, make_limits
from friction_hil.daemon.axis import check_torque
from friction_hil.daemon.control.message import AxisChange
from friction_hil.daemon.safety import JUMP_MARGIN, SLACK_STEPS
from friction_hil.daemon.velocity_check import VelocityCheck
from friction_hil.drive import AxisFacts
from friction_hil.dynamics import Arm, torques
from friction_hil.errors import OptionError, UsageError, choices
from friction_hil.numerics.jit import Array, StructuredArray
from friction_hil.own_loop.kernel import JOINT, LOOP


@dataclass(frozen=True, slots=True)
class Joints:
    """The joints of a loop, in the order of its arrays."""

    names: tuple[str, ...]
    configuration: Configuration
    facts: tuple[AxisFacts, ...]
    compensators: tuple[JointCompensator, ...]  # whose settings and states are the rows of these arrays
    settings: StructuredArray  # (2 n,), behind those of the joints the ones before their last change
    state: StructuredArray
    flat_state: Array  # (2 n, width), the same memory
    limits: StructuredArray  # (n,) `JOINT`
    loop: StructuredArray  # (1,) `LOOP`
    arm: Arm | None  # whose joints are those of ``names`` that it has, in their order
    # of the kernel: place of each joint in the arm, -1 outside; links and gravity; workspace; loads, (n,)
    arm_arrays: tuple[Any, ...]

    def places(self, names: Sequence[str]) -> list[int]:
        """Return the places of joints in the arrays; a `UsageError`: there is none of a name."""
        for name in names:
            if name not in self.names:
                raise UsageError(f"there is no joint {name!r}; {choices(str(name), self.names)}")
        return [self.names.index(name) for name in names]


def make_joints(configuration: Configuration, names: Sequence[str] | None) -> Joints:
    """Return the joints of a configuration, by default all, in its order.

    Raises `UsageError`: a name is wrong, or a joint has settings that a loop of one's own cannot use.
    """
    chosen = _chosen(configuration, names)
    axes = {name: configuration.axes[name] for name in chosen}
    if len(axes) < len(configuration.axes):  # a mechanism of simulated drives needs all of its axes
        configuration = configuration.model_copy(update={"simulation": None})
    configuration = configuration.model_copy(update={"axes": axes})
    facts = tuple(_facts(configuration, name) for name in chosen)
    period_s, pairs = configuration.period_s, list(zip(axes.values(), facts, strict=True))
    made = [make_compensator(axis, axis.model, fact, period_s) for axis, fact in pairs]
    widest = max((one.record for one in made), key=lambda record: record.dtype.itemsize)
    settings, state = np.zeros(2 * len(made), widest.dtype), np.zeros(2 * len(made), STATE)
    for k, one in enumerate(made):
        one.move_to(settings[k : k + 1], state[k : k + 1])
    flat_state = state.view(np.float64).reshape(2 * len(made), -1)
    loop = np.zeros(1, LOOP)
    loop["period_s"], loop["most_stale"], loop["is_on"] = period_s, configuration.realtime.max_missed, 1.0
    limits = np.array([_limits(axis, fact, period_s) for axis, fact in pairs], JOINT)
    arm, arrays = _arm(configuration, chosen)
    return Joints(chosen, configuration, facts, tuple(made), settings, state, flat_state, limits, loop, arm, arrays)


def _arm(configuration: Configuration, names: Sequence[str]) -> tuple[Arm | None, tuple[Any, ...]]:
    """Return the arm of some joints, with arrays for the kernel; a `UsageError`: not all of its joints are there."""
    given, places = configuration.arm, np.full(len(names), -1)
    if given is None:
        return None, ()
    if lacking := [name for name in given.joints if name not in names]:
        text = f"joints: {', '.join(lacking)} is missing, without whose position the torques of the arm are not known"
        raise UsageError(text)
    own = [k for k, name in enumerate(names) if name in given.joints]
    places[own] = np.arange(len(own))
    arm = given.ordered([names[k] for k in own])
    return arm, (places, arm.links, arm.gravity_vector, *torques.workspace(len(own)), np.zeros(len(names)))


def _chosen(configuration: Configuration, names: Sequence[str] | None) -> tuple[str, ...]:
    if names is None:
        return tuple(configuration.axes)
    chosen = tuple(names)
    for name in chosen:
        if name not in configuration.axes:
            near = choices(str(name), configuration.axes)
            raise UsageError(f"joints: the configuration has no axis {name!r}; {near}")
    if isinstance(names, str) or not chosen or len(set(chosen)) < len(chosen):
        raise UsageError(f"joints = {names!r} must be different names, in the order of the loop's arrays")
    return chosen


def _facts(configuration: Configuration, name: str) -> AxisFacts:
    """Return what a driver would find of a drive, here from the configuration."""
    axis, period_s = configuration.axes[name], configuration.period_s
    resolution = getattr(axis.options, "position_resolution", None)
    if resolution is None and (counts := getattr(axis.options, "counts_per_unit", None)):
        resolution = 1.0 / counts
    delay_s = getattr(axis.options, "delay_s", None)
    torque_delay_s = 0.0 if getattr(axis.options, "has_torque", True) else None
    try:
        if resolution is None:
            key = "position_resolution" if configuration.is_own_loop else "counts_per_unit"
            raise OptionError(name, key, "is missing: a loop of your own needs the smallest step of its position")
        for key in ("transmission", "velocity_offset"):
            if getattr(axis.compensation, key) is not None:
                text = "is not possible in a loop of your own, which is given a torque alone: remove it"
                raise OptionError(name, f"compensation.{key}", text)
        delay_s = 0.5 * period_s if delay_s is None else delay_s
        facts = AxisFacts(name, "", resolution, 0.0, 0.0, delay_s + 0.5 * period_s, torque_delay_s=torque_delay_s)
        check_torque(name, axis, facts)
    except OptionError as error:
        source: Path | None = configuration.source_path
        raise error if source is None else located(source, error) from None
    return facts


def _limits(axis: AxisConfig, facts: AxisFacts, period_s: float) -> tuple[Any, ...]:
    """Return a `JOINT` before the first cycle."""
    limits, given = make_limits(axis), axis.compensation
    jump, slack = JUMP_MARGIN * limits.velocity * period_s, SLACK_STEPS * facts.position_resolution
    needs_torque = given.velocity == "kalman" or given.adaptation is not None
    bounds = (limits.velocity, limits.position_low, limits.position_high, limits.following_error)
    fixed = (jump, slack, *bounds, given.velocity == "drive", needs_torque, given.baseline_s)
    unknown = (math.nan, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, math.nan, math.nan)
    check = VelocityCheck(period_s, limits.velocity, facts.position_resolution, facts.velocity_resolution)
    return (*map(float, fixed), float(given.enabled), 0.0, *unknown, math.nan, *check.fields)


def adopt(joints: Joints, number: int, changes: Sequence[AxisChange | None]) -> None:
    """Take changed settings of each joint between two cycles; the kernel makes one step more with the former ones."""
    settings, state, n = joints.settings, joints.state, len(joints.names)
    for k, change in enumerate(changes):
        if change is None:
            continue
        j = joints.limits[k]
        if change.record is not None:
            if not j["is_changing"]:
                settings[n + k], state[n + k] = settings[k], state[k]
            new = np.zeros(1, settings.dtype)
            records.copy(change.record, new)
            carry_over(settings[k : k + 1], new, state[k : k + 1], change.friction)
            settings[k], j["is_changing"] = new[0], 1.0
        if change.is_enabled is not None:
            j["is_wanted"] = float(change.is_enabled)
    joints.loop["change"] = number


def remarks(configuration: Configuration) -> Iterator[str]:
    """Yield what the user should know of settings: units, and what is left to the daemon."""
    for name, axis in configuration.axes.items():
        if axis.model.axis == "linear":
            yield f"{name}: its model is of a linear axis: positions in m, velocities in m/s, torques in N"
        if axis.compensation.learning != "off":
            yield f"{name}: compensation.learning is a process of the daemon, and off in a loop of your own"
        if axis.shadows:
            yield f"{name}: shadows are evaluated by the daemon alone"
