"""Karnopp's model: Stribeck friction with a band of velocities that counts as standstill, for simulation."""

from friction_hil.friction import stribeck
from friction_hil.friction.curves import modified, sticking
from friction_hil.friction.family import Family
from friction_hil.friction.parameters import Parameter
from friction_hil.numerics.jit import Array, inlined

_sliding, _steady, _run_with_band = stribeck.step, stribeck.steady, stribeck.run_with_band

_STICK_VELOCITY = Parameter(
    "stick_velocity", "Dv", "rad/s", "below this velocity the axis counts as stuck", is_lower_allowed=False
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
    """Torque of one sample; see `friction_hil.friction.kernel`. A feed-forward has no use for the band."""
    if epsilon == 0.0 and abs(velocity) < p[5]:
        return sticking(applied_torque, modified(p[1], extra, scale))
    return _sliding(p, s, velocity, level_velocity, dt, extra, scale, applied_torque, epsilon)


@inlined
def run(p: Array, s: Array, velocity: Array, dt: float, applied_torque: float, torque: Array) -> bool:
    """Fill ``torque`` with that of every sample: the bits of `step`. Return whether every velocity is finite."""
    return _run_with_band(p, velocity, p[5], applied_torque, torque)


@inlined
def steady(p: Array, velocity: float, extra: float, scale: float) -> float:
    """Torque at constant ``velocity``; 0 at rest."""
    return _steady(p, velocity, extra, scale)


FAMILY = Family(
    name="karnopp",
    summary="Stribeck friction that sticks exactly inside a band of velocities; for simulation",
    formula="|v| < Dv: F balances the applied torque up to Fs, and the axis stands;  else F as stribeck",
    source="Karnopp, Journal of Dynamic Systems, Measurement, and Control 107(1), 1985",
    parameters=(*stribeck.FAMILY.parameters, _STICK_VELOCITY),
    states=(),
    example={**stribeck.FAMILY.example, "stick_velocity": 1e-3},
    note="who simulates an axis with it sets the velocity to zero while F balances; the simulated servo does",
)
