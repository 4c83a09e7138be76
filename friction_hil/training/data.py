"""Samples to train on: friction in recordings, or friction of a model of the library."""

from collections.abc import Sequence

import numpy as np

from friction_hil.errors import UsageError
from friction_hil.friction import FrictionModel
from friction_hil.identification.data import RegressionSegment
from friction_hil.models.model_file import Mechanics
from friction_hil.numerics.jit import Array
from friction_hil.training import thresholds as th
from friction_hil.training.excitation import excitation
from friction_hil.training.layout import Samples, join


def of_model(
    model: FrictionModel, *, period_s: float, samples: int, top_speed: float | None = None, seed: int = 0
) -> Samples:
    """Return samples of a model of the library along a designed excitation.

    ``top_speed``: rad/s; None: ten Stribeck velocities. Raises `UsageError`: neither a top speed nor a Stribeck
    velocity is known, or the friction depends on load.
    """
    if top_speed is None:
        stribeck_velocity = model.parameters.get("stribeck_velocity")
        if stribeck_velocity is None:
            raise UsageError(f"{model.name} has no stribeck_velocity, which sets the range of speeds: give --speed")
        top_speed = th.TOP_STRIBECK * stribeck_velocity
    if "load" in model.modifiers:
        raise UsageError("a model that depends on load cannot be learned from motion alone: train on recordings")
    velocity = excitation(top_speed, period_s, samples, seed=seed)
    position = np.cumsum(velocity) * period_s
    torque = model.simulate(velocity, period_s, position=position)
    return Samples(period_s, velocity, torque, position=position)


def of_records(records: Sequence[RegressionSegment], mechanics: Mechanics, base: FrictionModel | None) -> Samples:
    """Return samples of friction in records: measured torque minus inertia, offset, gravity and the model ``base``.

    All terms pass the low-pass of the records. Raises `UsageError`: the recordings have different sampling periods.
    """
    return join([_of_record(record, mechanics, base) for record in records])


def _of_record(record: RegressionSegment, mechanics: Mechanics, base: FrictionModel | None) -> Samples:
    load = mechanics.gravity.at(record.position)
    load_torque = load if record.load_torque is None else record.load_torque
    torque = record.torque / mechanics.torque_ratio - mechanics.offset - load
    if base is not None:
        torque = torque - base.simulate(
            record.velocity,
            record.dt,
            position=record.position,
            load_torque=load_torque,
            temperature=record.temperature,
        )
    torque = record.lowpass(torque) - mechanics.inertia * record.acceleration
    weight = np.ones(len(torque))
    weight[: record.begin] = weight[record.end :] = 0.0  # filters settle there: simulated, but not weighted
    return Samples(
        record.dt,
        record.velocity,
        torque,
        position=record.position,
        load_torque=load_torque,
        temperature=np.zeros(0) if record.temperature is None else record.temperature,
        weight=weight,
    )


def total_torque(records: Sequence[RegressionSegment]) -> Array:
    """Return the measured torque of all records, with the low-pass of each."""
    return np.concatenate([each.lowpass(each.torque) for each in records])


def held_out(samples: Samples) -> tuple[Samples, Samples]:
    """Return samples to train on and samples to validate with: every fourth of twenty blocks is held out.

    Both contain the whole motion, so that states evolve alike, and differ in their weights.
    """
    block = np.arange(len(samples)) * th.BLOCKS // len(samples)
    is_held = block % th.HELD_OUT == th.HELD_OUT - 1
    return (
        samples.weighted(np.where(is_held, 0.0, samples.weight)),
        samples.weighted(np.where(is_held, samples.weight, 0.0)),
    )
