"""From the torque demand of the loops to the torque at the shaft, for a servo with further parts. Compiled."""

from friction_hil.numerics.jit import Array, StructuredArray, compiled, inner
from friction_hil.servo.mechanics import harmonics
from friction_hil.servo.records import HISTORY_ROOM


@compiled
def shape(plant: StructuredArray, s: StructuredArray, torque: float) -> float:
    """Return the torque demand after low-pass and notch, N m."""
    c, r = plant[0], s[0]
    if c.torque_filter_coefficient < 1.0:
        r.filtered += c.torque_filter_coefficient * (torque - r.filtered)
        torque = r.filtered
    if c.notch[0] != 0.0:  # direct form II, transposed
        given = torque
        torque = c.notch[0] * given + r.notch[0]
        r.notch[0] = c.notch[1] * given - c.notch[3] * torque + r.notch[1]
        r.notch[1] = c.notch[2] * given - c.notch[4] * torque
    return torque


@inner
def pass_on(plant: StructuredArray, s: StructuredArray, is_off: bool) -> None:
    """Let the torque demand act after the dead time; without power at once, with all filters at rest."""
    c, r = plant[0], s[0]
    if is_off:
        r.filtered = r.notch[0] = r.notch[1] = 0.0
        r.demand_history[:] = 0.0
        r.acting_demand = r.torque_demand
        return
    if c.dead_samples == 0.0:
        r.acting_demand = r.torque_demand
        return
    r.demand_head = (r.demand_head + 1) % HISTORY_ROOM
    r.demand_history[r.demand_head] = r.torque_demand
    r.acting_demand = r.demand_history[(r.demand_head - int(c.dead_samples)) % HISTORY_ROOM]


@compiled
def shaft_torque(plant: StructuredArray, s: StructuredArray, demand: float) -> float:
    """Advance the torque of the motor by one integration step towards its demand; return that at the shaft, N m.

    ``torque`` of the state is the current times the nominal torque constant.
    """
    c, r = plant[0], s[0]
    if c.is_motor_plain > 0.0:
        r.torque += c.torque_lag_coefficient * (demand - r.torque)
        return r.torque
    if c.no_load_speed > 0.0 and demand * r.velocity > 0.0:  # only while it drives: the bus brakes at any speed
        left = (c.no_load_speed - abs(r.velocity)) / (c.no_load_speed - c.corner_speed)
        available = c.peak_torque * min(max(left, 0.0), 1.0)
        demand = min(max(demand, -available), available)
    r.torque += c.torque_lag_coefficient * (demand - r.torque)
    torque = r.torque * (1.0 + c.torque_constant_error)
    if c.torque_ripple[0] > 0.0:
        torque *= 1.0 + harmonics(c.torque_ripple, r.position)[0]
    if c.torque_constant_coefficient != 0.0:
        torque *= 1.0 + c.torque_constant_coefficient * (r.motor_temperature - c.reference_temperature)
    return torque + harmonics(c.cogging, r.position)[0]


@inner
def warm(plant: StructuredArray, s: StructuredArray, dt: float) -> None:
    """Advance temperatures and wear by one sample of the drive's loops, ``dt`` times the time-lapse, by the midpoint.

    Copper loss heats the winding, which heats the motor; friction heats the gear, or the motor where there is none.
    """
    c, r = plant[0], s[0]
    dt *= c.time_lapse
    time = r.samples * dt
    if c.wear[0] > 0.0:
        r.friction_factor = _interpolated(c.wear, time)
    if c.has_heat == 0.0:
        return
    heat = r.friction_heat + r.load_friction_heat + r.coupling_heat
    friction = (heat - r.heat_before) * c.time_lapse / dt
    r.heat_before = heat
    for i in range(int(c.ambient[0])):
        if time >= c.ambient[1 + 2 * i]:
            r.ambient_temperature = c.ambient[2 + 2 * i]
    relative = r.torque / c.rated_torque
    loss = c.copper_loss * relative * relative
    winding, motor, gear = r.winding_temperature, r.motor_temperature, r.gear_temperature
    for half in range(2):
        copper = loss * (1.0 + c.resistance_coefficient * (winding - c.reference_temperature))
        inward = (winding - motor) * c.winding_conductance
        across = (motor - gear) * c.contact_conductance
        outward = (motor - r.ambient_temperature) * c.motor_conductance
        step = dt if half == 1 else 0.5 * dt
        in_motor = inward - across - outward + (friction if c.gear_capacity == 0.0 else 0.0)
        winding = r.winding_temperature + step * (copper - inward) / c.winding_capacity
        motor = r.motor_temperature + step * in_motor / c.motor_capacity
        if c.gear_capacity > 0.0:
            away = (gear - r.ambient_temperature) * c.gear_conductance
            gear = r.gear_temperature + step * (friction + across - away) / c.gear_capacity
        else:
            gear = motor
    r.winding_temperature, r.motor_temperature, r.gear_temperature = winding, motor, gear
    r.friction_temperature = gear


@inner
def _interpolated(table: Array, time: float) -> float:
    """Return the value at a time from a table of its length, times and values; constant before and after."""
    count = int(table[0])
    if time <= table[1]:
        return table[2]
    for i in range(1, count):
        if time < table[1 + 2 * i]:
            begin, end = table[2 * i - 1], table[1 + 2 * i]
            share = (time - begin) / (end - begin)
            return table[2 * i] + share * (table[2 + 2 * i] - table[2 * i])
    return table[2 * count]
