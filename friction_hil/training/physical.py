"""Physical models fitted to the samples of a training, for comparison with the network."""

import itertools

import numpy as np

from friction_hil.friction import Axis, FrictionModel, create
from friction_hil.identification import structures
from friction_hil.identification.data import Data, RegressionSegment
from friction_hil.identification.fits import fit
from friction_hil.identification.regression import Regression
from friction_hil.identification.scales import estimate_scales
from friction_hil.numerics.jit import Array
from friction_hil.training.layout import Samples

FAMILIES = ("coulomb", "stribeck", "dahl", "lugre")


def parts_of(samples: Samples) -> list[slice]:
    """Return the rows of each record of the samples."""
    ends = [*np.flatnonzero(samples.starts).tolist(), len(samples)]
    return [slice(a, b) for a, b in itertools.pairwise(ends)]


def simulate(model: FrictionModel, samples: Samples) -> Array:
    """Return the torque of a model along samples, (n,), N m; every record starts from rest."""
    return np.concatenate(
        [
            model.simulate(
                samples.velocity[part],
                samples.dt,
                position=samples.position[part],
                load_torque=samples.load_torque[part],
                temperature=None if np.isnan(samples.temperature).any() else samples.temperature[part],
            )
            for part in parts_of(samples)
        ]
    )


def fitted(samples: Samples, axis: Axis, *, is_directed: bool = False) -> dict[str, FrictionModel]:
    """Fit each of `FAMILIES` to the torque of the weighted samples, as `identify` does for known mechanics.

    ``samples``: friction torque alone. ``is_directed``: each direction has parameters of its own.
    """
    data = Data([_record(samples, part, axis) for part in parts_of(samples)])
    scales, found = estimate_scales(data, ()), {}
    for family in FAMILIES:
        structure = structures.build(family, scales, axis, samples.dt, is_directed=is_directed)
        parameters, modifiers = fit(Regression(data, structure, ()), scales).friction
        found[structure.label] = create(family, modifiers=modifiers, axis=axis, **parameters)
    return found


def _record(samples: Samples, part: slice, axis: Axis) -> RegressionSegment:
    """Return the samples of a record for regression: unfiltered, with friction as the only torque."""
    velocity, position, count = samples.velocity[part], samples.position[part], part.stop - part.start
    temperature = samples.temperature[part]
    if np.ptp(position) == 0.0:  # not given
        position = np.cumsum(velocity) * samples.dt
    return RegressionSegment(
        path="the samples",
        axis=axis,
        rows=count,
        time_s=samples.dt * np.arange(count),
        position=position,
        velocity=velocity,
        acceleration=np.zeros(count),
        torque=samples.torque[part],
        load_torque=samples.load_torque[part],
        temperature=None if np.isnan(temperature).any() else temperature,
        demand=None,
        rate_hz=1.0 / samples.dt,
        lowpass_hz=None,
        decimation=1,
        begin=0,
        end=count,
        problems=(),
        encoder=position,
        resolution=None,
        is_moving=samples.weight[part] > 0.0,
    )
