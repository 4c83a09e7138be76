"""Static networks for what a physical model leaves: small ones, each stopped on another part of the data, averaged.

What a physical model leaves is mostly noise, and a network that is trained to the end learns it. Each member is
therefore stopped where its error on a part that it is not trained on is smallest. Their mean varies less than each of
them, and is a static network again, because the output is linear in the units of the last layer.

Source: A. Krogh, J. Vedelsby, Neural network ensembles, cross validation, and active learning, NIPS 7, 1995.
"""

import math
from collections.abc import Sequence

import numpy as np

from friction_hil.friction import NetworkStructure, network
from friction_hil.identification.data import Mask
from friction_hil.numerics.jit import Array
from friction_hil.training import levenberg
from friction_hil.training import thresholds as th
from friction_hil.training.constraints import CONTRACTIONS, Constraint
from friction_hil.training.first_weights import first_weights
from friction_hil.training.layout import Samples, empty
from friction_hil.training.objective import NetworkRun, Objective


def fit(structure: NetworkStructure, samples: Samples, parts: Sequence[Mask], *, seed: int = 0) -> Array:
    """Return the parameter array of the mean of one member for each part.

    ``structure``: of one member: static, with one layer. Samples of weight 0 are used neither for training nor for
    stopping. ``parts``: masks (n,) of the samples that stop the member; it is trained on the others. The same seed
    gives the same bits.
    """
    used = samples.weight > 0.0
    if not np.any(used):  # nothing to learn from: a network whose torque is zero
        return mean(structure, [empty(structure, samples.weighted(np.ones(len(samples))))])
    header = empty(structure, samples)
    largest = float(np.quantile(np.abs(samples.torque[used]), th.SEEN)) or 1.0
    header[network.BOUND] = largest / header[network.TORQUE_SCALE]
    members = []
    for number, part in enumerate(parts):
        if not np.any(used & part) or not np.any(used & ~part):
            continue
        inner, outer = (samples.weighted(np.where(part == is_part, samples.weight, 0.0)) for is_part in (False, True))
        members.append(_member(header, structure, inner, outer, np.random.default_rng((seed, number))))
    return mean(structure, members or [header])


def _member(
    header: Array, structure: NetworkStructure, inner: Samples, outer: Samples, random: np.random.Generator
) -> Array:
    """Return the network trained on ``inner`` with the smallest error on ``outer``, over all decays."""
    training, stopping = NetworkRun(header, inner), NetworkRun(header, outer)
    constraint = Constraint(structure, CONTRACTIONS["static"])
    best = header.copy()  # weights of zero: leaves the physical model alone
    lowest = stopping.simulate(best, is_free=True)
    for decay in th.MEAN_DECAYS:
        objective = Objective(header, training, constraint, decay, is_free=True)
        stale, smallest = 0, math.inf

        def judge(reached: levenberg.SearchStep, objective: Objective = objective) -> bool:
            nonlocal best, lowest, stale, smallest
            p = objective.network_at(reached.at)
            error = stopping.simulate(p, is_free=True)
            stale = 0 if error < smallest else stale + 1
            smallest = min(smallest, error)
            if error < lowest:
                lowest, best = error, p
            return stale < th.MEAN_PATIENCE

        levenberg.minimise_unbounded(
            objective.cost,
            objective.normal_equations,
            first_weights(header, structure, inner, random),
            iterations=th.MEAN_ITERATIONS,
            goes_on=judge,
        )
    return best


def mean(structure: NetworkStructure, members: Sequence[Array]) -> Array:
    """Return the parameter array of the static network whose output is the mean of those of ``members``."""
    count, width, inputs = len(members), structure.hidden[0], structure.inputs
    wide = NetworkStructure(
        "static",
        (count * width,),
        0,
        0,
        structure.has_position,
        structure.has_load,
        structure.has_temperature,
        structure.orders,
    )
    p = wide.parameter_array()
    whole = members[0].copy()
    whole[network.WIDTH] = p[network.WIDTH]
    p[: network.HEADER] = whole[: network.HEADER]
    bias, into, last = [], [], []
    path = np.zeros(1 + inputs)
    for member in members:
        w = member[network.HEADER :]
        bias.append(w[:width])
        into.append(w[width : width * (1 + inputs)].reshape(inputs, width))
        out = w[structure.outputs_begin :]
        last.append(out[1 : 1 + width] / count)
        path += np.concatenate([out[:1], out[1 + width :]]) / count
    p[network.HEADER :] = np.concatenate([*bias, np.concatenate(into, axis=1).ravel(), path[:1], *last, path[1:]])
    return p
