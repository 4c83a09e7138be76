"""Motion of simulated servos that share one mechanism. Compiled.

The joints are rigid: the positions q of the motors are the coordinates of the mechanism. One step of h takes position
and velocity from t to t + h, with v and u the velocities before and after it and w their mean::

    J (u - v) / h  =  T - F - L - N                q += h w

with the inertias of the motors J (diagonal), the torques of the motors T, friction F, the load torques of the single
axes L, and the torques N that move the mechanism:

- Gantry. The beam's translation and yaw are the product of a constant Jacobian and q; N is a constant inertia matrix
  times the acceleration, and the yaw stiffness and damping of the guides at the mean of the step.
- Arm. N is its inverse dynamics (`friction_hil.dynamics`) in the middle of the step, at the velocity w and the
  acceleration (u - v) / h, and a torque in the direction of w, of the order of h^2, with which ``w' N h`` is the exact
  change of its kinetic and potential energy (after Gonzalez, J. Nonlinear Sci. 6, 1996). A force at the tool acts
  through the transposed Jacobian.

So the mechanism never creates energy, at any step. Everything is implicit and symmetric in time, hence of second
order; friction is taken as in `friction_hil.servo.mechanics`. The equations are solved by Newton's method with the
inertia matrix as derivative; what is left out of it is of the order of h, so that an iteration gains some four digits.
"""

from typing import NamedTuple

import numpy as np

from friction_hil.dynamics import newton_euler
from friction_hil.numerics.jit import Array, StructuredArray, compiled, inlined, inner
from friction_hil.servo.mechanics import (
    BALANCE,
    external_torque,
    finish_rigid,
    friction_step,
    static_load,
    velocity_ahead,
)
from friction_hil.servo.plant import driven, is_braked
from friction_hil.servo.records import GANTRY

_ITERATIONS = 30
_NEAR = 1e-14  # relative error of velocities below which the iteration ends
_GAIN = 1e-2  # of an iteration, at least
_TURNED = 1e-3  # rad or m, after which the inertia matrix is computed anew
_LEAST = 1e-8  # mean velocity over half of its change, below which a reversal takes and leaves the same energy


class Coupled(NamedTuple):
    """Records of servos and their mechanism, which the compiled functions read and change."""

    mechanism: StructuredArray  # `MECHANISM`, of length 1
    total: StructuredArray  # `MECHANISM_STATE`, of length 1
    joints: StructuredArray  # `JOINT`, of length n, as the next three
    plants: StructuredArray  # `MACHINE`
    controllers: StructuredArray  # `friction_hil.motion.controller.CONTROLLER`
    states: StructuredArray  # `MACHINE_STATE`
    links: StructuredArray  # of an arm, `friction_hil.dynamics.newton_euler.LINK`; else empty
    tool: StructuredArray  # the same links, of which only one has a mass: 1 kg at the tool
    gravity: Array  # (3,), m/s^2
    matrix: Array  # (n, n), derivative of N by half of the change of velocity, N m s/rad
    factor: Array  # (n, n), scratch


@inlined
def _set_gantry_torques(c: Coupled) -> None:
    """Set N of a gantry: what there is of it without a change of velocity, and the rest."""
    k, (one, other) = c.mechanism[0], (c.states[0], c.states[1])
    rate = (other.velocity - one.velocity) / k.span
    yaw = (other.position - one.position) / k.span + 0.5 * c.plants[0].step_s * rate
    c.joints[1].torque = (k.yaw_stiffness * yaw + k.yaw_damping * rate) / k.span
    c.joints[0].torque = -c.joints[1].torque
    for i in range(2):
        c.joints[i].torque += c.matrix[i, 0] * c.joints[0].half + c.matrix[i, 1] * c.joints[1].half


@inlined
def _set_arm_torques(c: Coupled) -> None:
    """Set N of an arm, and its kinetic energy at the end of the step."""
    j, dt = c.joints, c.plants[0].step_s
    newton_euler.inverse_dynamics(c.links, c.gravity, j["middle"], j["mean_velocity"], j["acceleration"], j["torque"])
    newton_euler.inverse_dynamics(c.links, np.zeros(3), j["end"], j["rest"], j["end_velocity"], j["momentum"])
    missing = newton_euler.potential_energy(c.links, c.gravity, j["middle"], j["way"])[1] - c.total[0].kinetic
    after = moved = changed = 0.0  # the last two: inertia times squares of mean velocity and half of its change
    for i in range(len(j)):
        after += 0.5 * j[i].end_velocity * j[i].momentum
        missing -= dt * j[i].mean_velocity * j[i].torque
        moved += c.matrix[i, i] * j[i].mean_velocity * j[i].mean_velocity
        changed += c.matrix[i, i] * j[i].half * j[i].half
    c.total[0].kinetic_after = after
    if moved > _LEAST * _LEAST * changed:
        for i in range(len(j)):
            j[i].torque += (missing + after) / (dt * moved) * c.matrix[i, i] * j[i].mean_velocity


@inner
def _set_torques(c: Coupled) -> None:
    """Set N and the motion in this step for ``half`` of the change of velocity."""
    dt = c.plants[0].step_s
    for i in range(len(c.joints)):
        j, r = c.joints[i], c.states[i]
        j.mean_velocity, j.end_velocity = r.velocity + j.half, r.velocity + 2.0 * j.half
        j.acceleration, j.way = 2.0 / dt * j.half, 0.5 * dt * j.mean_velocity
        j.middle, j.end = r.position + j.way, r.position + 2.0 * j.way
    if c.mechanism[0].kind == GANTRY:
        _set_gantry_torques(c)
    else:
        _set_arm_torques(c)


@inner
def _set_matrix(c: Coupled) -> None:
    """Set the derivative of N, with the inertia matrix of an arm where it stands now."""
    m, rate, n = c.mechanism[0], 2.0 / c.plants[0].step_s, len(c.joints)
    if m.kind == GANTRY:
        turning = (m.yaw_damping + m.yaw_stiffness / rate) / (m.span * m.span)
        for i in range(n):
            for k in range(n):
                c.matrix[i, k] = rate * m.inertia[2 * i + k] + (turning if i == k else -turning)
        return
    for k in range(n):  # column by column
        c.joints[k].matrix_at = c.states[k].position
        for i in range(n):
            c.joints[i].acceleration = rate if i == k else 0.0
        motion = c.states["position"], c.joints["rest"], c.joints["acceleration"]
        newton_euler.inverse_dynamics(c.links, np.zeros(3), *motion, c.joints["momentum"])
        for i in range(n):
            c.matrix[i, k] = c.joints[i].momentum


@compiled
def prepare(c: Coupled) -> None:
    """Set what a step takes from the one before it, for a mechanism at rest."""
    _set_matrix(c)
    _set_torques(c)
    for i in range(len(c.joints)):
        c.joints[i].bias = c.joints[i].bias_before = c.joints[i].torque


@inlined
def _predict(c: Coupled) -> None:
    """Set ``half`` as it was in the step before, and N with what does not depend on it extrapolated."""
    n, is_turned = len(c.joints), False
    for i in range(n):
        j, r = c.joints[i], c.states[i]
        j.half = 0.0 if r.velocity == 0.0 else 0.5 * (r.velocity - r.velocity_before)
        j.torque = 2.0 * j.bias - j.bias_before
        is_turned = is_turned or abs(r.position - j.matrix_at) > _TURNED
        for k in range(n):
            c.factor[i, k] = c.matrix[i, k]
    if is_turned and c.mechanism[0].kind != GANTRY:
        _set_matrix(c)
    for i in range(n):
        for k in range(n):
            c.joints[i].torque += c.factor[i, k] * c.joints[k].half
            c.joints[i].bias += (c.factor[i, k] - c.matrix[i, k]) * c.joints[k].half


@inlined
def _set_pull(c: Coupled, time: float) -> None:
    """Set the torques of the force at the tool: those that hold a mass there where gravity is the force, reversed."""
    j, forces, last = c.joints, c.mechanism[0].tool_forces, -1
    for i in range(int(forces[0])):
        if time >= forces[1 + 4 * i]:
            last = i
    if last >= 0:
        for i in range(len(j)):
            j[i].middle = c.states[i].position + 0.5 * c.plants[0].step_s * (c.states[i].velocity + j[i].half)
        reversed_force = forces[2 + 4 * last : 5 + 4 * last]
        newton_euler.inverse_dynamics(c.tool, reversed_force, j["middle"], j["rest"], j["rest"], j["pull"])


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


@inner
def _factorise(c: Coupled) -> None:
    """Set Cholesky's factor of the derivative of the equations of the joints that are not held."""
    rate = 2.0 / c.plants[0].step_s
    for i in range(len(c.joints)):
        for k in range(i + 1):
            rest = c.matrix[i, k]
            if i == k:
                rest += rate * c.plants[i].inertia
            for m in range(k):
                rest -= c.factor[i, m] * c.factor[k, m]
            if c.joints[i].is_held > 0.0 or c.joints[k].is_held > 0.0:
                c.factor[i, k] = 1.0 if i == k else 0.0
            else:
                c.factor[i, k] = np.sqrt(rest) if i == k else rest / c.factor[k, k]


@inner
def _correct(c: Coupled) -> float:
    """Correct ``half``, with N, to what the equations are then to first order; return the square of the correction.

    It is weighted by the inertia of each joint, and relative to the velocities.
    """
    rate, n = 2.0 / c.plants[0].step_s, len(c.joints)
    size = whole = 0.0
    for i in range(n):
        j, inertia = c.joints[i], rate * c.plants[i].inertia
        j.step = 0.0 if j.is_held > 0.0 else j.push - j.torque - j.friction - inertia * j.half
        for k in range(i):
            j.step -= c.factor[i, k] * c.joints[k].step
        j.step /= c.factor[i, i]
    for i in range(n - 1, -1, -1):
        j, inertia = c.joints[i], rate * c.plants[i].inertia
        for k in range(i + 1, n):
            j.step -= c.factor[k, i] * c.joints[k].step
        j.step /= c.factor[i, i]
        j.half += j.step
        size += (c.matrix[i, i] + inertia) * j.step**2
        whole += (c.matrix[i, i] + inertia) * (c.states[i].velocity ** 2 + j.half**2)
    for i in range(n):
        c.total[0].kinetic_after += 2.0 * c.joints[i].momentum * c.joints[i].step
        for k in range(n):
            c.joints[i].torque += c.matrix[i, k] * c.joints[k].step
    return size / whole if size > 0.0 else 0.0


@inlined
def _solve(c: Coupled) -> None:
    """Set ``half`` and N for the joints that are held and their friction."""
    for i in range(len(c.joints)):
        if c.joints[i].is_held > 0.0:  # at the end of the step it is at rest
            for k in range(len(c.joints)):
                c.joints[k].torque -= c.matrix[k, i] * (0.5 * c.states[i].velocity + c.joints[i].half)
            c.joints[i].half = -0.5 * c.states[i].velocity
    _factorise(c)
    _correct(c)
    last = 0.0
    for _ in range(_ITERATIONS):
        _set_torques(c)
        size = _correct(c)
        gain = _GAIN * _GAIN if last == 0.0 else size / last
        if c.mechanism[0].kind == GANTRY or size * gain <= _NEAR * _NEAR or gain >= 1.0:  # or no longer nearer
            break
        last = size


@inlined
def _changes_hold(c: Coupled) -> bool:
    """Hold or release one of the joints that static friction stops or lets go; return False if there is none."""
    rate = 2.0 / c.plants[0].step_s
    for i in range(len(c.joints)):
        j, v = c.joints[i], c.states[i].velocity
        if j.is_free > 0.0:
            continue
        u = v + 2.0 * j.half
        rest = j.push - j.torque - rate * c.plants[i].inertia * j.half  # friction that a held motor needs
        if j.is_held == 0.0 and (u * v < 0.0 or (v == 0.0 and u * j.excess < 0.0)):
            j.is_held = 1.0  # its velocity would change its sign, or be against its own drive
            return True
        if j.is_held > 0.0 and rest * v < 0.0:  # the other torques reverse it within the step
            j.is_held, j.is_free, j.friction = 0.0, 1.0, 0.0
            return True
    return False


@inner
def _move(c: Coupled) -> None:
    """Advance all axes and their mechanism by one step; ``joints`` has the torques of the motors, ``drive``."""
    n, dt = len(c.joints), c.plants[0].step_s
    rate = 2.0 / dt
    time = (c.states[0].steps + 0.5) * dt
    _predict(c)
    _set_pull(c, time)
    for i in range(n):  # friction at the acceleration of the step before, on which load and hold depend
        j, plant, s = c.joints[i], c.plants[i : i + 1], c.states[i : i + 1]
        middle = s[0].position + 0.5 * dt * s[0].velocity
        j.outside = plant[0].load_torque + external_torque(plant, s, time)
        load = static_load(plant, j.outside, middle)
        j.push = j.drive + j.pull - load
        applied = j.push - j.torque + c.matrix[i, i] * j.half
        j.friction, is_held = _friction(plant, s, middle, load - j.pull + j.torque, applied)
        j.excess = applied - j.friction
        j.is_held = 1.0 if is_held or is_braked(plant, s) else 0.0
        j.is_free = 1.0 if plant[0].is_friction_static == 0.0 or j.is_held > 0.0 else 0.0
    _solve(c)
    for _ in range(2 * n):
        if not _changes_hold(c):
            break
        _solve(c)
    if c.mechanism[0].kind == GANTRY:
        yawed = c.states[1].velocity + c.joints[1].half - c.states[0].velocity - c.joints[0].half
        c.total[0].heat += c.mechanism[0].yaw_damping * (yawed / c.mechanism[0].span) ** 2 * dt
    for i in range(n):
        j, plant, s = c.joints[i], c.plants[i : i + 1], c.states[i : i + 1]
        inertial = rate * plant[0].inertia * j.half
        u = s[0].velocity + 2.0 * j.half
        if j.is_held > 0.0:
            u, j.friction = 0.0, j.push - j.torque - inertial
        c.total[0].tool_work += j.pull * (s[0].velocity + j.half) * dt
        finish_rigid(plant, s, j.drive, u, j.friction, j.outside, j.drive - j.friction - inertial)
        s[0].shaft_torque = j.drive
        s[0].steps += 1.0
        j.bias_before, j.bias, j.pull = j.bias, j.torque, 0.0
        for k in range(n):
            j.bias -= c.matrix[i, k] * c.joints[k].half
    c.total[0].kinetic = c.total[0].kinetic_after


@compiled
def advance(c: Coupled, steps: int) -> None:
    """Simulate ``steps`` integration steps of servos and their mechanism."""
    for _ in range(steps):
        for i in range(len(c.joints)):
            c.joints[i].drive = driven(c.plants[i : i + 1], c.controllers[i : i + 1], c.states[i : i + 1])
        _move(c)


@compiled
def stored_energy(c: Coupled) -> float:
    """Return kinetic energy and energy of yaw stiffness and gravity of the mechanism, without the motors, J."""
    k, r, j = c.mechanism[0], c.states, c.joints
    if k.kind == GANTRY:
        yaw = (r[1].position - r[0].position) / k.span
        moved = k.inertia[0] * r[0].velocity ** 2 + k.inertia[3] * r[1].velocity ** 2
        moved += 2.0 * k.inertia[1] * r[0].velocity * r[1].velocity
        return 0.5 * (moved + k.yaw_stiffness * yaw * yaw)
    return c.total[0].kinetic + newton_euler.potential_energy(c.links, c.gravity, r["position"], j["rest"])[0]
