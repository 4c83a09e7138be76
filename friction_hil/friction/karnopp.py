"""Karnopp's model: Stribeck friction with a velocity band that counts as standstill, for simulation."""

from friction_hil.friction import stribeck
from friction_hil.friction.curves import modified, sticking
from friction_hil.friction.family import Family
from friction_hil.friction.parameters import Parameter
from friction_hil.numerics.jit import Array, inlined

_sliding, _steady, _run_with_band = stribeck.step, stribeck.steady, stribeck.run_with_band

BAND = len(stribeck.FAMILY.parameters)  # index of the stick velocity, which comes behind them
_STICK_VELOCITY = Parameter(
    "stick_velocity", "Dv", "rad/s", "velocity below which the axis sticks", is_lower_allowed=False
)


@inlined
def step(
    p: Array,
    s: Array,
    velocity: float,
    level_velocity: float,
    dt: float,
    extra: float,
    scale: float,
    applied_torque: float,
    epsilon: float,
) -> float:
    """Compute the torque of one sample; see `friction_hil.friction.kernel`. A feed-forward ignores the band."""
    if epsilon == 0.0 and abs(velocity) < p[BAND]:
        return sticking(applied_torque, modified(p[1], extra, scale))
    return _sliding(p, s, velocity, level_velocity, dt, extra, scale, applied_torque, epsilon)


@inlined
def run(p: Array, s: Array, velocity: Array, dt: float, applied_torque: float, torque: Array) -> bool:
    """Fill ``torque`` for every sample, with the same bits as `step`; return True if every velocity is finite."""
    return _run_with_band(p, velocity, p[BAND], applied_torque, torque)


@inlined
def steady(p: Array, velocity: float, extra: float, scale: float) -> float:
    """Compute the torque at constant ``velocity``; 0 at rest."""
    return _steady(p, velocity, extra, scale)


FAMILY = Family(
    name="karnopp",
    summary="Stribeck friction that sticks exactly inside a velocity band; for simulation",
    formula="|v| < Dv: F balances the applied torque up to Fs and the axis stands still;  otherwise F as in stribeck",
    source="Karnopp, Journal of Dynamic Systems, Measurement, and Control 107(1), 1985",
    parameters=(*stribeck.FAMILY.parameters, _STICK_VELOCITY),
    states=(),
    example={**stribeck.FAMILY.example, "stick_velocity": 1e-3},
    note="a simulation must set the velocity to zero while F balances the torque, as the simulated servo does",
)
