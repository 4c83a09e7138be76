"""Check of a trained network at rest: ten minutes, with and without a dithering encoder."""

import math
from dataclasses import dataclass

import numpy as np

from friction_hil.friction import NetworkStructure, network, network_runs
from friction_hil.numerics.jit import Array
from friction_hil.training import thresholds as th

REST_S = 600.0


def simulate(
    structure: NetworkStructure,
    p: Array,
    velocity: Array,
    dt: float,
    *,
    position: Array | None = None,
    load_torque: Array | None = None,
    temperature: Array | None = None,
    state: Array | None = None,
) -> Array:
    """Return the torque of a velocity record in free run, N m, from rest or a ``state`` (changed in place)."""
    torque = np.empty(len(velocity))
    zero, unknown = np.zeros(1), np.full(1, math.nan)
    network_runs.run(
        p,
        np.zeros(structure.state_room) if state is None else state,
        np.ascontiguousarray(velocity, dtype=np.float64),
        dt,
        zero if position is None else position,
        zero if load_torque is None else load_torque,
        unknown if temperature is None else temperature,
        torque,
    )
    return torque


@dataclass(frozen=True, slots=True)
class Rest:
    """Behaviour of a network in ten minutes of rest: the worst of several approaches to rest."""

    rise: float  # largest increase of the absolute torque since the beginning of the rest, N m
    late_change: float  # range of the torque in the last tenth of the time, N m
    # increase of the largest absolute torque under a dithering velocity from the first to the last tenth of the time,
    # N m
    dither_growth: float
    is_steady: bool  # the torque stays or decays, without drift and limit cycle


def at_rest(structure: NetworkStructure, p: Array, dt: float, *, seconds: float = REST_S) -> Rest:
    """Simulate a network that comes to rest and stays there for ``seconds``."""
    samples = max(th.LEAST_SAMPLES, round(seconds / dt))
    limit, scale = p[network.SPEED_LIMIT], p[network.TORQUE_SCALE]
    still = np.zeros(samples)
    # velocity of an encoder that toggles between two counts: the mean position stays, and so must the torque
    dither = th.DITHER * limit * np.diff(np.random.default_rng(0).choice([0.0, 1.0], samples), prepend=0.0)
    tenth = samples // 10
    rise = late = growth = 0.0
    for approach in th.APPROACHES:
        state = np.zeros(structure.state_room)
        arrival = simulate(structure, p, approach * limit * np.linspace(1.0, 0.0, 200), dt, state=state)
        shaken = simulate(structure, p, dither, dt, state=state.copy())
        held = simulate(structure, p, still, dt, state=state)
        # the first inputs of a narx at rest still contain the motion
        begin = max(abs(float(arrival[-1])), float(np.max(np.abs(held[: structure.lags + 1]))))
        rise = max(rise, float(np.max(np.abs(held))) - begin)
        late = max(late, float(np.ptp(held[-tenth:])))
        growth = max(growth, float(np.max(np.abs(shaken[-tenth:])) - np.max(np.abs(shaken[:tenth]))))
    is_steady = bool(max(rise, late, growth) <= th.STEADY * scale)
    return Rest(rise, late, growth, is_steady)
