"""The temperature that the friction model is given: measured, from a thermal observer, or the model's reference.

The observer is one lumped body, heated by the losses and cooled by its surroundings (Newton's law of cooling):

    C dT/dt = F v + k tau^2 - (T - T_ambient) / R

with the friction torque F of the model, the copper loss k tau^2 and the thermal resistance R. The model's temperature
follows its source no faster than `SLEW`, so that a sensor that appears, fails or jumps makes no step of torque.
"""

import math
from typing import Any

from friction_hil.numerics.jit import inlined

STATE = [
    ("given", "f8"),  # to the model, as far as it depends on one
    ("body", "f8"),  # of the observer
]
LOWEST, HIGHEST = -60.0, 250.0  # deg C: what lies outside is no temperature of a motor, but a code for "no sensor"
SLEW = 1.0  # K/s


@inlined
def is_plausible(temperature: float) -> bool:
    """Return True for a finite temperature between `LOWEST` and `HIGHEST`."""
    return LOWEST <= temperature <= HIGHEST


@inlined
def observe(c: Any, r: Any, friction: float, velocity: float, torque: float, dt: float) -> None:
    """Advance the observer by ``dt``; a torque that is not finite heats nothing."""
    heat = friction * velocity
    if math.isfinite(torque):
        heat += c.copper_loss * torque * torque
    if not math.isfinite(heat):
        return
    cooled = r.body - c.ambient
    # exact for a heat that is constant over dt
    kept = math.exp(-dt / (c.thermal_resistance * c.heat_capacity))
    body = c.ambient + kept * cooled + (1.0 - kept) * c.thermal_resistance * heat
    r.body = min(max(body, LOWEST), HIGHEST)


@inlined
def follow(c: Any, r: Any, measured: float, is_first: bool, dt: float) -> float:
    """Return the temperature for the model, deg C; NaN for a model that does not depend on it."""
    if math.isnan(c.reference_temperature):
        return math.nan
    source = c.reference_temperature
    if is_plausible(measured):
        source = measured
    elif c.heat_capacity > 0.0:
        source = r.body
    if is_first:
        r.given = source  # nothing is commanded yet
    else:
        r.given += min(max(source - r.given, -SLEW * dt), SLEW * dt)
    return float(r.given)
