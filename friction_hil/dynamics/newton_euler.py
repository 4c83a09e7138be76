"""Inverse dynamics of a tree of rigid links by the recursive Newton-Euler algorithm. Compiled.

Each link has a frame at its joint, in which all its quantities are given. Outwards, velocity and acceleration of the
frames; inwards, the forces and moments that move the links (Featherstone, Rigid Body Dynamics Algorithms, 2008,
chapter 5; Khalil and Dombre, Modeling, Identification and Control of Robots, 2002, chapter 9). Gravity is an upward
acceleration of the base. What moves the links is linear in ten standard inertial parameters of each: mass, the three
first moments m c, and Ixx, Ixy, Ixz, Iyy, Iyz, Izz about the origin of the frame.
"""

import numpy as np

from friction_hil.numerics.jit import Array, StructuredArray, compiled, compiled_for_one_sample, inlined, inner

PARAMETERS = 10  # of a link
REVOLUTE, PRISMATIC = 0, 1

LINK = np.dtype(
    [
        ("parent", np.int64),  # index of the link that carries it, which comes before it; -1: the base
        ("kind", np.int64),  # REVOLUTE or PRISMATIC
        ("order", np.int64),  # where its joint stands in q, dq, ddq and tau
        ("sign", np.float64),  # of q, dq, ddq and tau against the file's joint
        ("zero", np.float64),  # position of the file's joint at which rotation and origin hold, rad or m
        ("armature", np.float64),  # inertia of the rotor behind the gear, kg m^2 or kg
        ("rotation", np.float64, (9,)),  # from the link's frame to its parent's at zero, row by row
        ("origin", np.float64, (3,)),  # of the frame at zero, in the parent's frame, m
        ("axis", np.float64, (3,)),  # of the joint, in the link's frame, of length 1
        ("parameters", np.float64, (PARAMETERS,)),  # kg, kg m, kg m^2
    ],
    align=True,
)

_ROTATION, _ORIGIN, _W, _DW, _A, _F, _N, WIDTH = 0, 9, 12, 15, 18, 21, 24, 27  # columns of what is known of a link

Vector = tuple[float, float, float]


@inlined
def _cross(a: Vector, b: Vector) -> Vector:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]


@inlined
def _sum(a: Vector, b: Vector) -> Vector:
    return a[0] + b[0], a[1] + b[1], a[2] + b[2]


@inlined
def _get(known: Array, i: int, at: int) -> Vector:
    return known[i, at], known[i, at + 1], known[i, at + 2]


@inlined
def _put(known: Array, i: int, at: int, v: Vector) -> None:
    known[i, at], known[i, at + 1], known[i, at + 2] = v


@inlined
def _to_parent(known: Array, i: int, v: Vector) -> Vector:
    return (
        known[i, 0] * v[0] + known[i, 1] * v[1] + known[i, 2] * v[2],
        known[i, 3] * v[0] + known[i, 4] * v[1] + known[i, 5] * v[2],
        known[i, 6] * v[0] + known[i, 7] * v[1] + known[i, 8] * v[2],
    )


@inlined
def _from_parent(known: Array, i: int, v: Vector) -> Vector:
    return (
        known[i, 0] * v[0] + known[i, 3] * v[1] + known[i, 6] * v[2],
        known[i, 1] * v[0] + known[i, 4] * v[1] + known[i, 7] * v[2],
        known[i, 2] * v[0] + known[i, 5] * v[1] + known[i, 8] * v[2],
    )


@inlined
def _times(p: Array, v: Vector) -> Vector:
    """Return the inertia matrix of parameters times a vector."""
    return (
        p[4] * v[0] + p[5] * v[1] + p[6] * v[2],
        p[5] * v[0] + p[7] * v[1] + p[8] * v[2],
        p[6] * v[0] + p[8] * v[1] + p[9] * v[2],
    )


@inlined
def _place(link: np.void, known: Array, i: int, x: float) -> None:
    """Set rotation and origin of a link whose joint has moved by ``x``."""
    r, axis = link["rotation"], link["axis"]
    a, b, c = axis[0], axis[1], axis[2]
    if link["kind"] == PRISMATIC:
        for k in range(9):
            known[i, _ROTATION + k] = r[k]
        for k in range(3):
            known[i, _ORIGIN + k] = link["origin"][k] + x * (r[3 * k] * a + r[3 * k + 1] * b + r[3 * k + 2] * c)
        return
    sine, cosine = np.sin(x), np.cos(x)
    rest = 1.0 - cosine
    for k in range(3):  # a row of the rotation times Rodrigues' matrix
        u = (r[3 * k], r[3 * k + 1], r[3 * k + 2])
        along = rest * (u[0] * a + u[1] * b + u[2] * c)
        across = _cross(u, (a, b, c))
        known[i, 3 * k] = cosine * u[0] + sine * across[0] + along * a
        known[i, 3 * k + 1] = cosine * u[1] + sine * across[1] + along * b
        known[i, 3 * k + 2] = cosine * u[2] + sine * across[2] + along * c
        known[i, _ORIGIN + k] = link["origin"][k]


@inner
def _move(links: StructuredArray, gravity: Array, q: Array, dq: Array, ddq: Array, known: Array) -> None:
    """Set rotation, origin, angular velocity, angular and linear acceleration of all links."""
    for i in range(len(links)):
        link = links[i]
        k, sign, axis = link["order"], link["sign"], link["axis"]
        v, u = sign * dq[k], sign * ddq[k]
        _place(link, known, i, sign * q[k] - link["zero"])
        parent = link["parent"]
        w, dw, a = (0.0, 0.0, 0.0), (0.0, 0.0, 0.0), (-gravity[0], -gravity[1], -gravity[2])
        if parent >= 0:
            w, dw, a = _get(known, parent, _W), _get(known, parent, _DW), _get(known, parent, _A)
            origin = _get(known, i, _ORIGIN)
            a = _sum(a, _sum(_cross(dw, origin), _cross(w, _cross(w, origin))))
        w, dw, a = _from_parent(known, i, w), _from_parent(known, i, dw), _from_parent(known, i, a)
        turning = _cross(w, (v * axis[0], v * axis[1], v * axis[2]))
        if link["kind"] == PRISMATIC:
            a = (
                a[0] + u * axis[0] + 2.0 * turning[0],
                a[1] + u * axis[1] + 2.0 * turning[1],
                a[2] + u * axis[2] + 2.0 * turning[2],
            )
        else:
            dw = (dw[0] + u * axis[0] + turning[0], dw[1] + u * axis[1] + turning[1], dw[2] + u * axis[2] + turning[2])
            w = (w[0] + v * axis[0], w[1] + v * axis[1], w[2] + v * axis[2])
        _put(known, i, _W, w)
        _put(known, i, _DW, dw)
        _put(known, i, _A, a)


@inlined
def _along(link: np.void, f: Vector, n: Vector) -> float:
    """Return the part of force or moment that the joint of a link feels, with the sign of its joint in tau."""
    axis = link["axis"]
    if link["kind"] == PRISMATIC:
        n = f
    return link["sign"] * (axis[0] * n[0] + axis[1] * n[1] + axis[2] * n[2])


@inlined
def inverse(links: StructuredArray, gravity: Array, q: Array, dq: Array, ddq: Array, known: Array, tau: Array) -> None:
    """Set the torques or forces ``tau`` of one state; ``known``: (n, `WIDTH`) memory."""
    _move(links, gravity, q, dq, ddq, known)
    for i in range(len(links)):
        p = links[i]["parameters"]
        w, dw, a = _get(known, i, _W), _get(known, i, _DW), _get(known, i, _A)
        h = (p[1], p[2], p[3])
        pull = _sum(_cross(dw, h), _cross(w, _cross(w, h)))
        f = (p[0] * a[0] + pull[0], p[0] * a[1] + pull[1], p[0] * a[2] + pull[2])
        _put(known, i, _F, f)
        _put(known, i, _N, _sum(_times(p, dw), _sum(_cross(w, _times(p, w)), _cross(h, a))))
    for i in range(len(links) - 1, -1, -1):
        link = links[i]
        f, n = _get(known, i, _F), _get(known, i, _N)
        tau[link["order"]] = _along(link, f, n) + link["armature"] * ddq[link["order"]]
        parent = link["parent"]
        if parent >= 0:
            f = _to_parent(known, i, f)
            n = _sum(_to_parent(known, i, n), _cross(_get(known, i, _ORIGIN), f))
            _put(known, parent, _F, _sum(_get(known, parent, _F), f))
            _put(known, parent, _N, _sum(_get(known, parent, _N), n))


@compiled_for_one_sample
def inverse_dynamics(links: StructuredArray, gravity: Array, q: Array, dq: Array, ddq: Array, tau: Array) -> bool:
    """Set the torques or forces ``tau`` of one state; return whether all have a number for each joint."""
    n = len(links)
    if len(q) != n or len(dq) != n or len(ddq) != n or len(tau) != n:
        return False
    inverse(links, gravity, q, dq, ddq, np.empty((n, WIDTH)), tau)
    return True


@compiled
def inverse_dynamics_of_rows(
    links: StructuredArray, gravity: Array, q: Array, dq: Array, ddq: Array, tau: Array
) -> None:
    """Set the torques or forces ``tau`` of a state in each row."""
    known = np.empty((len(links), WIDTH))
    for row in range(len(q)):
        inverse(links, gravity, q[row], dq[row], ddq[row], known, tau[row])


@compiled
def inertia_matrices(links: StructuredArray, q: Array, matrices: Array) -> None:
    """Set the inertia matrix of the position in each row: column by column, what accelerates one joint."""
    n = len(links)
    known, none, push, tau = np.empty((n, WIDTH)), np.zeros(n), np.zeros(n), np.empty(n)
    for row in range(len(q)):
        for k in range(n):
            push[k] = 1.0
            inverse(links, np.zeros(3), q[row], none, push, known, tau)
            push[k] = 0.0
            matrices[row, :, k] = tau


@compiled
def regressors(links: StructuredArray, gravity: Array, q: Array, dq: Array, ddq: Array, y: Array) -> None:
    """Set the matrices that give tau, without the armatures, from the parameters of all links in the order of q."""
    n = len(links)
    known = np.empty((n, WIDTH))
    y[:] = 0.0
    for row in range(len(q)):
        _move(links, gravity, q[row], dq[row], ddq[row], known)
        for i in range(n):
            w, dw, a = _get(known, i, _W), _get(known, i, _DW), _get(known, i, _A)
            for k in range(PARAMETERS):
                one = np.zeros(PARAMETERS)
                one[k] = 1.0
                h = (one[1], one[2], one[3])
                pull = _sum(_cross(dw, h), _cross(w, _cross(w, h)))
                f = (one[0] * a[0] + pull[0], one[0] * a[1] + pull[1], one[0] * a[2] + pull[2])
                m = _sum(_times(one, dw), _sum(_cross(w, _times(one, w)), _cross(h, a)))
                column = PARAMETERS * links[i]["order"] + k
                j = i
                while j >= 0:
                    y[row, links[j]["order"], column] = _along(links[j], f, m)
                    f = _to_parent(known, j, f)
                    m = _sum(_to_parent(known, j, m), _cross(_get(known, j, _ORIGIN), f))
                    j = links[j]["parent"]


@inlined
def _dot(a: Vector, b: Vector) -> float:
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


@inlined
def _turned(v: Vector, axis: Vector, along: float, cosine: float, sine: float) -> Vector:
    """Return the sum of what is along an axis, of what is across it, and of that turned backwards, each by a factor."""
    rest, across = (along - cosine) * _dot(axis, v), _cross(axis, v)
    return (
        cosine * v[0] + rest * axis[0] - sine * across[0],
        cosine * v[1] + rest * axis[1] - sine * across[1],
        cosine * v[2] + rest * axis[2] - sine * across[2],
    )


@compiled
def potential_energy(links: StructuredArray, gravity: Array, middle: Array, half: Array) -> tuple[float, float]:
    """Return mean and difference of the potentials at ``middle + half`` and ``middle - half``, J.

    That of a mass at the origin of the base is 0. Mean and difference of gravity in each frame and of the height of its
    origin are passed outwards, so that the difference is exact to rounding of itself, not of the potentials.
    """
    known, mean, difference = np.empty((len(links), WIDTH)), 0.0, 0.0
    for i in range(len(links)):
        link = links[i]
        k, p, o, a, parent = link["order"], link["parameters"], link["origin"], link["axis"], link["parent"]
        g, dg, height, rise = (gravity[0], gravity[1], gravity[2]), (0.0, 0.0, 0.0), 0.0, 0.0
        if parent >= 0:
            g, dg, height, rise = _get(known, parent, _F), _get(known, parent, _N), known[parent, _A], known[parent, _W]
        for j in range(9):
            known[i, j] = link["rotation"][j]
        axis, angle, turn = (a[0], a[1], a[2]), link["sign"] * middle[k] - link["zero"], link["sign"] * half[k]
        at, moved = (o[0], o[1], o[2]), (0.0, 0.0, 0.0)
        if link["kind"] == PRISMATIC:
            way = _to_parent(known, i, axis)
            at = _sum(at, (angle * way[0], angle * way[1], angle * way[2]))
            moved = (2.0 * turn * way[0], 2.0 * turn * way[1], 2.0 * turn * way[2])
            angle = turn = 0.0
        height += _dot(g, at) + 0.25 * _dot(dg, moved)
        rise += _dot(dg, at) + _dot(g, moved)
        g, dg = _from_parent(known, i, g), _from_parent(known, i, dg)
        cosine, sine = np.cos(angle) * np.cos(turn), np.sin(angle) * np.cos(turn)  # means, then differences
        dcosine, dsine = -2.0 * np.sin(angle) * np.sin(turn), 2.0 * np.cos(angle) * np.sin(turn)
        after = _sum(_turned(g, axis, 1.0, cosine, sine), _turned(dg, axis, 0.0, 0.25 * dcosine, 0.25 * dsine))
        dg = _sum(_turned(dg, axis, 1.0, cosine, sine), _turned(g, axis, 0.0, dcosine, dsine))
        _put(known, i, _F, after)
        _put(known, i, _N, dg)
        known[i, _A], known[i, _W] = height, rise
        mean -= p[0] * height + _dot(after, (p[1], p[2], p[3]))
        difference -= p[0] * rise + _dot(dg, (p[1], p[2], p[3]))
    return mean, difference
