"""Mechanics of a simulated servo with two masses, load, gear and friction on both sides. Compiled.

One step takes position and velocity from t to t + h::

    J (u1 - v1) / h   = T - F1 - G C
    JL (u2 - v2) / h  = C - F2 - M                  q += h (v + u) / 2

with the torque of the motor T, friction F, the torque of the coupling C and that of the load M; u are the new
velocities. C is the mean of spring and damper over the step: the spring's is the difference of its energy over the
twist (a discrete gradient, Gonzalez, J. Nonlinear Sci. 6, 1996), the damper's belongs to the mean velocities. Both
are implicit, and solved in closed form within a contact and at its beginning. So the coupling never creates energy,
at any stiffness and through any impact. M is taken in the middle of the step, friction at the velocity extrapolated
to there, with its state half a step behind the velocity. Smooth motion is therefore integrated to second order in h;
only the bristle damping of LuGre, the mean over the last step, is of first order.

Where the inertia J of a rigid axis depends on its position, the step takes sqrt(J) v instead of v: its rate is torque
over sqrt(J), without the inertial term J'/2 v^2, which would have to be extrapolated and took energy from the motion.
With a load behind a coupling that term is taken at the velocity extrapolated to the middle.

A static friction map stops a mass whose velocity would change its sign, and holds it up to break-away.
"""

import math

from friction_hil.friction import kernel
from friction_hil.friction.elementary import approach
from friction_hil.numerics.dual import borrowed_at
from friction_hil.numerics.jit import Array, StructuredArray, compiled, inlined, inner

BALANCE = 1e-12  # relative difference of torque and friction below which they balance
_CORRECTIONS = 3  # of the hysteresis to the twist of a step, and of a velocity to the inertia at its end
_PASSES = 5  # each but the last holds or releases one of the two masses
_HALVINGS = 200


@compiled
def harmonics(table: Array, position: float) -> tuple[float, float]:
    """Return the sum of harmonics of a position, and its derivative."""
    value = slope = 0.0
    for i in range(int(table[0])):
        order, cosine, sine = table[1 + 3 * i], table[2 + 3 * i], table[3 + 3 * i]
        c, s = math.cos(order * position), math.sin(order * position)
        value += cosine * c + sine * s
        slope += order * (sine * c - cosine * s)
    return value, slope


@compiled
def friction_step(
    kind: int,
    p: Array,
    s: Array,
    velocity: float,
    level_velocity: float,
    dt: float,
    position: float,
    load: float,
    temperature: float,
    applied: float,
    factor: float,
    epsilon: float,
) -> float:
    """Return ``factor`` times the friction torque of one step; a separate function, compiled once for all families."""
    applied /= factor
    return factor * kernel.step(kind, p, s, velocity, level_velocity, dt, position, load, temperature, applied, epsilon)


@inner
def spring_energy(stiffness: float, gap: float, twist: float) -> float:
    """Return the energy of a spring with backlash, J."""
    pressed = max(abs(twist) - 0.5 * gap, 0.0)
    return 0.5 * stiffness * pressed * pressed


@inner
def _mean_spring(stiffness: float, gap: float, twist: float, change: float) -> float:
    """Return the torque of the spring that does the work of its energy's change while the twist changes."""
    if change == 0.0:
        pressed = max(abs(twist) - 0.5 * gap, 0.0)
        return math.copysign(stiffness * pressed, twist)
    # from the deflections, not from the difference of two energies, which nearly cancel
    before = math.copysign(max(abs(twist) - 0.5 * gap, 0.0), twist)
    after = math.copysign(max(abs(twist + change) - 0.5 * gap, 0.0), twist + change)
    return 0.5 * stiffness * (after + before) * ((after - before) / change)


@inner
def _hysteresis(torque: float, stiffness: float, before: float, turned: float) -> float:
    """Return the torque of a gear's hysteresis after it has turned by an angle: Dahl's equation, exact."""
    if torque == 0.0 or turned == 0.0:
        return before
    return before + approach(stiffness * abs(turned) / torque) * (math.copysign(torque, turned) - before)


@inner
def _impact(stiffness: float, gap: float, twist: float, free: float, give: float, dt: float) -> float:
    """Return the mean rate of twist in a step that ends or begins a contact, by bisection; the damper is left out."""
    low, high = min(free, -abs(free)), max(free, abs(free))
    while low + give * _mean_spring(stiffness, gap, twist, dt * low) > free:
        low = 2.0 * low - abs(free) - 1e-300
    while high + give * _mean_spring(stiffness, gap, twist, dt * high) < free:
        high = 2.0 * high + abs(free) + 1e-300
    for _ in range(_HALVINGS):
        rate = 0.5 * (low + high)
        if rate in (low, high):
            break
        if rate + give * _mean_spring(stiffness, gap, twist, dt * rate) > free:
            high = rate
        else:
            low = rate
    return 0.5 * (low + high)


@inner
def coupling_torque(
    stiffness: float, damping: float, gap: float, twist: float, free: float, give: float, dt: float
) -> float:
    """Return the mean torque of the coupling over a step, from motor to load, N m.

    ``gap`` is the whole backlash; without it the coupling pulls and pushes, with it its faces only push. ``twist``: at
    the beginning of the step, rad. ``free``: mean rate of twist over the step that there would be without the coupling,
    rad/s. ``give``: by how much a unit of torque reduces that rate. ``dt``: step, s.
    """
    implicit = 0.5 * dt * stiffness + damping
    if gap == 0.0:
        return (stiffness * twist + implicit * free) / (1.0 + give * implicit)
    side = math.copysign(1.0, twist)
    pressed = abs(twist) - 0.5 * gap
    if pressed > 0.0:
        torque = (stiffness * pressed + implicit * side * free) / (1.0 + give * implicit)
        ends = pressed + dt * (side * free - give * torque)
        if torque >= 0.0 and ends >= 0.0:
            return side * torque
        if torque < 0.0 and pressed + dt * side * free >= 0.0:
            return 0.0  # the damper would pull; it takes what the spring gives back
    elif abs(twist + dt * free) <= 0.5 * gap:
        return 0.0
    return _mean_spring(stiffness, gap, twist, dt * _impact(stiffness, gap, twist, free, give, dt))


@inner
def external_torque(plant: StructuredArray, s: StructuredArray, time: float) -> float:
    """Return the load torque that is a function of time, N m, opposing positive motion."""
    c, r = plant[0], s[0]
    torque = 0.0
    if c.external_amplitude != 0.0:
        torque = c.external_amplitude * math.sin(c.external_rad_per_s * time)
    if c.external_rows > 0:
        table = borrowed_at(c.external_address, 2 * c.external_rows)
        row = r.external_row
        while row < c.external_rows and table[2 * row] <= time:
            row += 1
        r.external_row = row  # the first one later than the time
        if row == 0:
            torque += table[1]
        elif row == c.external_rows:
            torque += table[2 * row - 1]
        else:
            before, after = table[2 * row - 2], table[2 * row]
            share = (time - before) / (after - before)
            torque += table[2 * row - 1] + share * (table[2 * row + 1] - table[2 * row - 1])
    return torque


@inlined
def static_load(plant: StructuredArray, outside: float, position: float) -> float:
    """Return the load torque at a position, ``outside`` and that of gravity and spring, N m."""
    c = plant[0]
    load = outside + c.gravity_sine * math.sin(position) + c.gravity_cosine * math.cos(position)
    return load + c.spring_stiffness * (position - c.spring_rest)


@compiled
def velocity_ahead(velocity: float, before: float) -> float:
    """Return the velocity extrapolated by half a step; not across zero."""
    ahead = velocity + 0.5 * (velocity - before)
    return ahead if ahead * velocity > 0.0 else 0.0


@inlined
def finish_rigid(
    plant: StructuredArray,  # a `MACHINE` record
    s: StructuredArray,  # a `MACHINE_STATE` record
    torque: float,  # of the motor; torques are over the step, N m
    velocity: float,  # at the end of the step, rad/s
    friction: float,
    outside: float,  # load torque from outside
    transmitted: float,  # by the gear
) -> None:
    """Move a rigid axis to the end of a step, and keep its account."""
    r, dt = s[0], plant[0].step_s
    mean = 0.5 * (r.velocity + velocity)
    r.friction_torque, r.transmitted_torque = friction, transmitted
    r.position += dt * mean
    r.velocity_before, r.velocity = r.velocity, velocity
    r.load_position, r.load_velocity = r.position, r.velocity
    r.motor_work += torque * mean * dt
    r.load_work -= outside * mean * dt
    r.friction_heat += friction * mean * dt


@inlined
def inertia_at(plant: StructuredArray, position: float) -> float:
    """Return the inertia of a rigid axis at a position."""
    return plant[0].inertia + harmonics(plant[0].inertia_variation, position)[0]


@inner
def _move_one_mass(plant: StructuredArray, s: StructuredArray, torque: float, is_braked: bool) -> None:
    """Advance one mass by a step; see `move`."""
    c, r = plant[0], s[0]
    dt, v = c.step_s, r.velocity
    middle = r.position + 0.5 * dt * v
    ahead = velocity_ahead(v, r.velocity_before)
    outside = c.load_torque + external_torque(plant, s, (r.steps + 0.5) * dt)
    load = static_load(plant, outside, middle)
    inertia = root = c.inertia
    if c.inertia_variation[0] > 0.0:  # geometric mean of those at the start and in the middle of the step
        root = math.sqrt(inertia_at(plant, r.position))
        inertia = root * math.sqrt(inertia_at(plant, middle))
    applied = torque - load
    friction = friction_step(
        int(c.friction_kind),
        c.friction,
        r.friction,
        v,
        ahead,
        dt,
        middle,
        load,
        r.friction_temperature,
        applied,
        r.friction_factor,
        0.0,
    )
    u = v + dt / inertia * (applied - friction)
    if c.is_friction_static > 0.0:
        is_balanced = abs(applied - friction) <= BALANCE * abs(applied) and abs(v) <= c.stick_velocity
        if is_balanced:
            u = 0.0
        elif u * v < 0.0:
            stopping = applied + inertia * v / dt
            if stopping * v >= 0.0:
                u, friction = 0.0, stopping
            else:  # the other torques reverse it within the step
                u, friction = v + dt / inertia * applied, 0.0
    if is_braked:
        u = 0.0
    if c.inertia_variation[0] > 0.0:
        root *= u
        for _ in range(_CORRECTIONS):
            u = root / math.sqrt(inertia_at(plant, r.position + 0.5 * dt * (v + u)))
    finish_rigid(plant, s, torque, u, friction, outside, load)


@inner
def _move_two_masses(plant: StructuredArray, s: StructuredArray, torque: float, is_braked: bool) -> None:
    """Advance motor and load by a step; see `move`."""
    c, r = plant[0], s[0]
    dt, v1, v2 = c.step_s, r.velocity, r.load_velocity
    middle, load_middle = r.position + 0.5 * dt * v1, r.load_position + 0.5 * dt * v2
    ahead, load_ahead = velocity_ahead(v1, r.velocity_before), velocity_ahead(v2, r.load_velocity_before)
    error, ratio = 0.0, 1.0
    if c.transmission_error[0] > 0.0:
        error = harmonics(c.transmission_error, r.position)[0]
        ratio += harmonics(c.transmission_error, middle)[1]
    twist, rate = r.position + error - r.load_position, ratio * v1 - v2
    outside = c.load_torque + external_torque(plant, s, (r.steps + 0.5) * dt)
    load = outside
    if c.gravity_sine != 0.0 or c.gravity_cosine != 0.0:
        load += c.gravity_sine * math.sin(load_middle) + c.gravity_cosine * math.cos(load_middle)
    load += c.spring_stiffness * (load_middle - c.spring_rest)
    load_inertia, inertial = c.load_inertia, 0.0
    if c.inertia_variation[0] > 0.0:
        variation, slope = harmonics(c.inertia_variation, load_middle)
        load_inertia += variation
        inertial = 0.5 * slope * load_ahead * load_ahead
    hysteresis = _hysteresis(c.hysteresis_torque, c.hysteresis_stiffness, r.hysteresis, dt * rate)

    expected = coupling_torque(c.stiffness, c.damping, c.gap, twist, rate, 0.0, dt) + hysteresis
    applied, load_applied = torque - ratio * expected, expected - load - inertial
    friction = friction_step(
        int(c.friction_kind),
        c.friction,
        r.friction,
        v1,
        ahead,
        dt,
        middle,
        expected,
        r.friction_temperature,
        applied,
        r.friction_factor,
        0.0,
    )
    load_friction = 0.0
    if c.load_friction_kind >= 0.0:
        load_friction = friction_step(
            int(c.load_friction_kind),
            c.load_friction,
            r.load_friction,
            v2,
            load_ahead,
            dt,
            load_middle,
            load,
            r.friction_temperature,
            load_applied,
            r.friction_factor,
            0.0,
        )
    is_balanced = c.is_friction_static > 0.0 and abs(applied - friction) <= BALANCE * abs(applied)
    is_held = is_braked or (is_balanced and abs(v1) <= c.stick_velocity)
    is_load_balanced = abs(load_applied - load_friction) <= BALANCE * abs(load_applied)
    is_load_held = c.is_load_friction_static > 0.0 and is_load_balanced and abs(v2) <= c.load_stick_velocity
    is_free, is_load_free = c.is_friction_static == 0.0 or is_held, c.is_load_friction_static == 0.0 or is_load_held
    u1 = u2 = transmitted = 0.0
    for _ in range(_PASSES):
        a, b = 0.5 * dt / c.inertia, 0.5 * dt / load_inertia
        mean, load_mean = v1 + a * (torque - friction), v2 - b * (load + inertial + load_friction)
        if is_held:
            a, mean = 0.0, 0.5 * v1
        if is_load_held:
            b, load_mean = 0.0, 0.5 * v2
        give = ratio * ratio * a + b
        free = ratio * mean - load_mean
        coupled = coupling_torque(c.stiffness, c.damping, c.gap, twist, free - give * hysteresis, give, dt)
        if c.hysteresis_torque > 0.0:  # that of the twist of this step: of another one it might create energy
            steepest = 2.0 * c.hysteresis_stiffness * dt * give
            for _ in range(_CORRECTIONS):
                turned = dt * (free - give * (coupled + hysteresis))
                after = _hysteresis(c.hysteresis_torque, c.hysteresis_stiffness, r.hysteresis, turned)
                hysteresis += (after - hysteresis) / (1.0 + steepest)
                coupled = coupling_torque(c.stiffness, c.damping, c.gap, twist, free - give * hysteresis, give, dt)
        transmitted = coupled + hysteresis
        u1 = 0.0 if is_held else 2.0 * (mean - a * ratio * transmitted) - v1
        u2 = 0.0 if is_load_held else 2.0 * (load_mean + b * transmitted) - v2
        stopping = torque - ratio * transmitted + c.inertia * v1 / dt
        load_stopping = transmitted - load - inertial + load_inertia * v2 / dt
        if not is_free and not is_held and (u1 * v1 < 0.0 or (v1 == 0.0 and u1 * (applied - friction) < 0.0)):
            is_held = True
        elif not is_free and is_held and stopping * v1 < 0.0:  # the other torques reverse it within the step
            is_held, is_free, friction = False, True, 0.0
        elif (
            not is_load_free
            and not is_load_held
            and (u2 * v2 < 0.0 or (v2 == 0.0 and u2 * (load_applied - load_friction) < 0.0))
        ):
            is_load_held = True
        elif not is_load_free and is_load_held and load_stopping * v2 < 0.0:
            is_load_held, is_load_free, load_friction = False, True, 0.0
        else:
            break
    if is_held:
        friction = torque - ratio * transmitted + c.inertia * v1 / dt
    if is_load_held:
        load_friction = transmitted - load - inertial + load_inertia * v2 / dt
    mean, load_mean = 0.5 * (v1 + u1), 0.5 * (v2 + u2)
    r.position += dt * mean
    r.load_position += dt * load_mean
    r.velocity_before, r.velocity = v1, u1
    r.load_velocity_before, r.load_velocity = v2, u2
    r.friction_torque, r.load_friction_torque = friction, load_friction
    r.transmitted_torque = transmitted
    r.motor_work += torque * mean * dt
    r.load_work -= outside * load_mean * dt
    r.friction_heat += friction * mean * dt
    r.load_friction_heat += load_friction * load_mean * dt
    turned = dt * (ratio * mean - load_mean)
    stored = spring_energy(c.stiffness, c.gap, twist + turned) - spring_energy(c.stiffness, c.gap, twist)
    if c.hysteresis_torque > 0.0:
        stored += 0.5 * (hysteresis**2 - r.hysteresis**2) / c.hysteresis_stiffness
        r.hysteresis = hysteresis
    r.coupling_heat += transmitted * turned - stored


@compiled
def move(plant: StructuredArray, s: StructuredArray, torque: float, is_braked: bool) -> None:
    """Advance mechanics by one step.

    Records are `MACHINE` and `MACHINE_STATE`. ``torque``: of the motor, held over the step, N m; a brake may hold the
    motor.
    """
    if plant[0].load_inertia > 0.0:
        _move_two_masses(plant, s, torque, is_braked)
    else:
        _move_one_mass(plant, s, torque, is_braked)
    s[0].shaft_torque = torque
    s[0].steps += 1.0


@compiled
def stored_energy(plant: StructuredArray, s: StructuredArray) -> float:
    """Return kinetic energy and energy of coupling, gear hysteresis, gravity and spring, J; bristles are not counted.

    Its change is motor_work + load_work - friction_heat - load_friction_heat - coupling_heat of the state. This holds
    to rounding for masses, coupling and friction, and to second order in the step for the other parts.
    """
    c, r = plant[0], s[0]
    where = r.load_position
    inertia = c.load_inertia if c.load_inertia > 0.0 else c.inertia
    inertia += harmonics(c.inertia_variation, where)[0]
    energy = 0.5 * inertia * r.load_velocity**2
    if c.load_inertia > 0.0:
        energy += 0.5 * c.inertia * r.velocity**2
        twist = r.position + harmonics(c.transmission_error, r.position)[0] - where
        energy += spring_energy(c.stiffness, c.gap, twist)
        if c.hysteresis_torque > 0.0:
            energy += 0.5 * r.hysteresis**2 / c.hysteresis_stiffness
    energy += c.gravity_sine * (1.0 - math.cos(where)) + c.gravity_cosine * math.sin(where)
    return energy + 0.5 * c.spring_stiffness * (where - c.spring_rest) ** 2
