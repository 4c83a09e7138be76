"""Motion of two simulated servos that share one mechanism. Compiled.

The joints are rigid: the positions q of the two motors are the coordinates of the mechanism. One step of h takes
position and velocity from t to t + h, with v and u the velocities before and after it and w their mean::

    (J + M) (u - v) / h  =  T - F - L - N                q += h w

with the inertias of the motors J (diagonal), the inertia matrix of the mechanism M, the torques of the motors T,
friction F, the load torques of the single axes L, and the forces N of the mechanism:

- Gantry. The beam's translation and yaw are the product of a constant Jacobian and q; M is constant, and N is the yaw
  stiffness and damping of the guides at the mean of the step.
- Two-link arm. M depends on the elbow angle (Spong, Hutchinson and Vidyasagar, Robot Modeling and Control, 2nd ed.,
  section 6.4). M is the mean of its values before and after the step; gravity is the difference of its potential over
  that of the angles (a discrete gradient, Gonzalez, J. Nonlinear Sci. 6, 1996); Coriolis and centrifugal forces are
  those for which ``w' N h`` and ``w' M (u - v)`` together are the exact change of kinetic energy. A force at the tool
  acts through the transposed Jacobian.

So the mechanism never creates energy, at any step. Everything is implicit and symmetric in time, hence of second
order; friction is taken as in `friction_hil.servo.mechanics`. The equations of the arm are solved by fixed-point
iteration, which gains some four digits each time.
"""

import math

from friction_hil.numerics.jit import StructuredArray, compiled, inlined, inner
from friction_hil.servo.mechanics import (
    BALANCE,
    external_torque,
    finish_rigid,
    friction_step,
    static_load,
    velocity_ahead,
)
from friction_hil.servo.plant import driven, is_braked
from friction_hil.servo.records import TWO_LINK_ARM

_PASSES = 5  # each but the last holds or releases one of the two motors
_ITERATIONS = 12
_NEAR = 1e-14  # relative difference of velocities below which the iteration ends
_SMALL = 1e-4  # rad; below it, three terms of a series are exact to rounding


@inner
def _sinc(angle: float) -> float:
    """Return sin(angle) / angle."""
    if abs(angle) < _SMALL:
        return 1.0 - angle * angle / 6.0
    return math.sin(angle) / angle


@inner
def _cosine(angle: float) -> float:
    return 1.0 - 0.5 * angle * angle if abs(angle) < _SMALL else math.cos(angle)


@inner
def _turned(sine: float, cosine: float, angle: float) -> tuple[float, float]:
    """Return sine and cosine of an angle to which ``angle`` is added."""
    if abs(angle) < 0.1 * _SMALL:
        half = 0.5 * angle * angle
        return sine + angle * cosine - half * sine, cosine - angle * sine - half * cosine
    c, s = math.cos(angle), math.sin(angle)
    return sine * c + cosine * s, cosine * c - sine * s


@inner
def _arm(
    mechanism: StructuredArray,  # the `MECHANISM` record
    v1: float,  # velocities before the step, rad/s
    v2: float,
    d1: float,  # mean velocities less these
    d2: float,
    s1: float,  # sines and cosines of the angles in the middle of the step
    c1: float,
    s2: float,
    c2: float,
    dt: float,  # step, s
) -> tuple[float, float, float, float, float]:
    """Return the inertia matrix M11, M12, M22 and the forces N1, N2 of the arm for a step."""
    k = mechanism[0]
    w1, w2 = v1 + d1, v2 + d2
    half1, half2 = 0.5 * dt * w1, 0.5 * dt * w2
    swing = k.swing * c2 * _cosine(half2)
    bend = -k.swing * s2 * _sinc(half2)  # derivative of the swing
    gravity2 = k.gravity2 * (s1 * c2 + c1 * s2) * _sinc(half1 + half2)
    n1 = bend * w2 * (2.0 * w1 + w2) + k.gravity1 * s1 * _sinc(half1) + gravity2
    n2 = bend * (d1 * d1 + d1 * d2 - w1 * w1) + gravity2
    return k.inertia11 + 2.0 * swing, k.inertia12 + swing, k.inertia22, n1, n2


@inner
def _tool_torques(
    mechanism: StructuredArray, s1: float, c1: float, s2: float, c2: float, time: float
) -> tuple[float, float]:
    """Return the torques at the joints of the force at the tool, N m, positive in the direction of motion."""
    k = mechanism[0]
    x = y = 0.0
    for i in range(int(k.tool_forces[0])):
        if time >= k.tool_forces[1 + 3 * i]:
            x, y = k.tool_forces[2 + 3 * i], k.tool_forces[3 + 3 * i]
    second = k.length2 * (x * (c1 * c2 - s1 * s2) + y * (s1 * c2 + c1 * s2))
    return k.length1 * (x * c1 + y * s1) + second, second


@inner
def _friction(
    plant: StructuredArray, s: StructuredArray, middle: float, transmitted: float, applied: float
) -> tuple[float, bool]:
    """Return the friction torque of an axis in this step, and whether it balances the applied torque at rest."""
    c, r = plant[0], s[0]
    v = r.velocity
    friction = friction_step(
        int(c.friction_kind),
        c.friction,
        r.friction,
        v,
        velocity_ahead(v, r.velocity_before),
        c.step_s,
        middle,
        transmitted,
        r.friction_temperature,
        applied,
        r.friction_factor,
        0.0,
    )
    is_balanced = c.is_friction_static > 0.0 and abs(applied - friction) <= BALANCE * abs(applied)
    return friction, is_balanced and abs(v) <= c.stick_velocity


@inlined
def _finish(
    plant: StructuredArray,
    s: StructuredArray,
    torque: float,
    velocity: float,
    friction: float,
    outside: float,
    inertial: float,
) -> None:
    """Move an axis to the end of the step; ``inertial`` is the torque that accelerates its motor, N m."""
    finish_rigid(plant, s, torque, velocity, friction, outside, torque - friction - inertial)
    s[0].shaft_torque = torque
    s[0].steps += 1.0


@inner
def _leaves(u: float, v: float, excess: float) -> bool:
    """Return True if static friction stops a velocity that changes its sign, or one against its own drive."""
    return u * v < 0.0 or (v == 0.0 and u * excess < 0.0)


@compiled
def move(
    mechanism: StructuredArray,
    m: StructuredArray,
    plant1: StructuredArray,
    s1: StructuredArray,
    torque1: float,
    plant2: StructuredArray,
    s2: StructuredArray,
    torque2: float,
) -> None:
    """Advance both axes and their mechanism by one step.

    Records are `MECHANISM` and `MECHANISM_STATE`, and `MACHINE` and `MACHINE_STATE` of each axis. Torques of the motors
    are held over the step, N m.
    """
    k, a, b = mechanism[0], s1[0], s2[0]
    dt, v1, v2 = plant1[0].step_s, a.velocity, b.velocity
    j1, j2 = plant1[0].inertia, plant2[0].inertia
    rate = 2.0 / dt
    time = (a.steps + 0.5) * dt
    middle1, middle2 = a.position + 0.5 * dt * v1, b.position + 0.5 * dt * v2
    outside1 = plant1[0].load_torque + external_torque(plant1, s1, time)
    outside2 = plant2[0].load_torque + external_torque(plant2, s2, time)
    load1, load2 = static_load(plant1, outside1, middle1), static_load(plant2, outside2, middle2)

    # half of the change of velocity, at first that of the step before
    d1, d2 = 0.5 * (v1 - a.velocity_before), 0.5 * (v2 - b.velocity_before)
    is_arm = k.kind == TWO_LINK_ARM
    guess1, guess2 = d1, d2
    sine1 = sine2 = tool1 = tool2 = damping = turning = 0.0
    cosine1 = cosine2 = 1.0
    m11, m12, m22, n1, n2 = k.inertia11, k.inertia12, k.inertia22, 0.0, 0.0
    if is_arm:
        angle1, angle2 = middle1 + 0.5 * dt * d1, middle2 + 0.5 * dt * d2
        sine1, cosine1, sine2, cosine2 = math.sin(angle1), math.cos(angle1), math.sin(angle2), math.cos(angle2)
        if k.tool_forces[0] > 0.0:
            tool1, tool2 = _tool_torques(mechanism, sine1, cosine1, sine2, cosine2, time)
        m11, m12, m22, n1, n2 = _arm(mechanism, v1, v2, d1, d2, sine1, cosine1, sine2, cosine2, dt)
    else:
        inverse = 1.0 / (k.span * k.span)
        damping = k.yaw_damping * inverse
        turning = damping + 0.5 * dt * k.yaw_stiffness * inverse  # resists a difference of the velocities
        n2 = k.yaw_stiffness * inverse * (b.position - a.position) + turning * (v2 - v1)
        n1 = -n2
    push1, push2 = torque1 + tool1 - load1, torque2 + tool2 - load2

    # friction at the acceleration of the step before, on which load and hold depend
    slow = turning * (d1 - d2)
    applied1, applied2 = push1 - n1 - slow - rate * m12 * d2, push2 - n2 + slow - rate * m12 * d1
    expected1 = load1 - tool1 + n1 + slow + rate * (m11 * d1 + m12 * d2)
    expected2 = load2 - tool2 + n2 - slow + rate * (m12 * d1 + m22 * d2)
    friction1, is_held1 = _friction(plant1, s1, middle1, expected1, applied1)
    friction2, is_held2 = _friction(plant2, s2, middle2, expected2, applied2)
    excess1, excess2 = applied1 - friction1, applied2 - friction2
    is_held1, is_held2 = is_held1 or is_braked(plant1, s1), is_held2 or is_braked(plant2, s2)
    is_free1 = plant1[0].is_friction_static == 0.0 or is_held1
    is_free2 = plant2[0].is_friction_static == 0.0 or is_held2

    u1 = u2 = rest1 = rest2 = 0.0
    for _ in range(_PASSES):
        for _ in range(_ITERATIONS):
            a11, a12, a22 = rate * (j1 + m11) + turning, rate * m12 - turning, rate * (j2 + m22) + turning
            b1, b2 = push1 - n1 - friction1, push2 - n2 - friction2
            before1, before2 = d1, d2
            if is_held1:
                d1 = -0.5 * v1
                d2 = -0.5 * v2 if is_held2 else (b2 - a12 * d1) / a22
            elif is_held2:
                d2 = -0.5 * v2
                d1 = (b1 - a12 * d2) / a11
            else:
                determinant = a11 * a22 - a12 * a12
                d1, d2 = (a22 * b1 - a12 * b2) / determinant, (a11 * b2 - a12 * b1) / determinant
            near = _NEAR * (abs(v1) + abs(v2) + abs(d1) + abs(d2))
            if not is_arm or (abs(d1 - before1) <= near and abs(d2 - before2) <= near):
                break
            e1, e2 = 0.5 * dt * (d1 - guess1), 0.5 * dt * (d2 - guess2)
            turned1, turned2 = _turned(sine1, cosine1, e1), _turned(sine2, cosine2, e2)
            m11, m12, m22, n1, n2 = _arm(mechanism, v1, v2, d1, d2, turned1[0], turned1[1], turned2[0], turned2[1], dt)
        u1, u2 = 0.0 if is_held1 else v1 + 2.0 * d1, 0.0 if is_held2 else v2 + 2.0 * d2
        slow = turning * (d1 - d2)
        rest1 = push1 - n1 - slow - rate * ((j1 + m11) * d1 + m12 * d2)  # friction that a held motor needs
        rest2 = push2 - n2 + slow - rate * (m12 * d1 + (j2 + m22) * d2)
        if not is_free1 and not is_held1 and _leaves(u1, v1, excess1):
            is_held1 = True
        elif not is_free1 and is_held1 and rest1 * v1 < 0.0:  # the other torques reverse it within the step
            is_held1, is_free1, friction1 = False, True, 0.0
        elif not is_free2 and not is_held2 and _leaves(u2, v2, excess2):
            is_held2 = True
        elif not is_free2 and is_held2 and rest2 * v2 < 0.0:
            is_held2, is_free2, friction2 = False, True, 0.0
        else:
            break
    if is_held1:
        friction1 = rest1
    if is_held2:
        friction2 = rest2

    w1, w2 = 0.5 * (v1 + u1), 0.5 * (v2 + u2)
    m[0].heat += damping * (w2 - w1) * (w2 - w1) * dt
    m[0].tool_work += (tool1 * w1 + tool2 * w2) * dt
    _finish(plant1, s1, torque1, u1, friction1, outside1, rate * j1 * d1)
    _finish(plant2, s2, torque2, u2, friction2, outside2, rate * j2 * d2)


@compiled
def advance(
    mechanism: StructuredArray,
    m: StructuredArray,
    plant1: StructuredArray,
    controller1: StructuredArray,
    s1: StructuredArray,
    plant2: StructuredArray,
    controller2: StructuredArray,
    s2: StructuredArray,
    steps: int,
) -> None:
    """Simulate ``steps`` integration steps of two servos and their mechanism; for the records see `move`."""
    for _ in range(steps):
        torque1 = driven(plant1, controller1, s1)
        torque2 = driven(plant2, controller2, s2)
        move(mechanism, m, plant1, s1, torque1, plant2, s2, torque2)


@compiled
def stored_energy(mechanism: StructuredArray, q1: float, q2: float, v1: float, v2: float) -> float:
    """Return kinetic energy and energy of yaw stiffness and gravity of the mechanism, without the motors, J."""
    k = mechanism[0]
    swing = k.swing * math.cos(q2) if k.kind == TWO_LINK_ARM else 0.0
    m11, m12 = k.inertia11 + 2.0 * swing, k.inertia12 + swing
    energy = 0.5 * (m11 * v1 * v1 + k.inertia22 * v2 * v2) + m12 * v1 * v2
    if k.kind == TWO_LINK_ARM:
        return energy + k.gravity1 * (1.0 - math.cos(q1)) + k.gravity2 * (1.0 - math.cos(q1 + q2))
    yaw = (q2 - q1) / k.span
    return energy + 0.5 * k.yaw_stiffness * yaw * yaw
