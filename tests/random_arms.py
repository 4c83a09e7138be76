"""Random trees of links as URDF and MJCF, and what MuJoCo computes for them."""

import mujoco
import numpy as np


def _inertia(rng):
    """Mass and inertia about the centre of a box with its axes turned."""
    mass, sides = rng.uniform(0.2, 3.0), rng.uniform(0.05, 0.4, 3)
    turn = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    return mass, turn @ np.diag(mass / 12.0 * (np.sum(sides**2) - sides**2)) @ turn.T


def _text(values):
    return " ".join(f"{each:.17g}" for each in np.atleast_1d(values))


def urdf(rng, count, fixed=0.3):
    """A branched tree of revolute, continuous, prismatic and fixed joints."""
    parts = ['<link name="base"/>']
    moving = 0
    parents = ["base"]
    while moving < count:
        number = len(parents)
        kind = "fixed" if rng.random() < fixed else str(rng.choice(["revolute", "continuous", "prismatic"]))
        moving += kind != "fixed"
        mass, inertia = _inertia(rng)
        six = dict(zip(("ixx", "ixy", "ixz", "iyy", "iyz", "izz"), inertia[np.triu_indices(3)], strict=True))
        values = " ".join(f'{name}="{value:.17g}"' for name, value in six.items())
        parts.append(
            f'<link name="l{number}"><inertial><origin xyz="{_text(rng.normal(0, 0.1, 3))}" '
            f'rpy="{_text(rng.uniform(-3, 3, 3))}"/><mass value="{mass:.17g}"/><inertia {values}/></inertial></link>'
        )
        limit = '<limit lower="-9" upper="9" effort="9" velocity="9"/>' if kind in ("revolute", "prismatic") else ""
        parts.append(
            f'<joint name="j{number}" type="{kind}"><parent link="{rng.choice(parents[-3:])}"/>'
            f'<child link="l{number}"/><origin xyz="{_text(rng.normal(0, 0.3, 3))}" '
            f'rpy="{_text(rng.uniform(-3, 3, 3))}"/><axis xyz="{_text(_direction(rng))}"/>{limit}</joint>'
        )
        parents.append(f"l{number}")
    return "<robot name='arm'>\n" + "\n".join(parts) + "\n</robot>"


def _direction(rng):
    return np.round(rng.normal(size=3), 2) + np.array([0.0, 0.0, 0.01])


def mjcf(rng, count):
    """A tree with the orientations, classes, frames, anchors and several joints of a body that MJCF has."""
    left = [count]

    def turn():
        return str(
            rng.choice(
                [
                    f'quat="{_text(rng.normal(size=4))}"',
                    f'axisangle="{_text([*rng.normal(size=3), rng.uniform(-180, 180)])}"',
                    f'euler="{_text(rng.uniform(-180, 180, 3))}"',
                    f'xyaxes="{_text(rng.normal(size=6))}"',
                    f'zaxis="{_text(rng.normal(size=3))}"',
                    "",
                ]
            )
        )

    def joint():
        left[0] -= 1
        name, kind = f"j{count - left[0]}", rng.choice(["", 'type="slide"', 'class="slow"'])
        ref = f'ref="{rng.uniform(-0.5, 0.5):.17g}"' if rng.random() < 0.4 else ""
        return (
            f'<joint name="{name}" {kind} pos="{_text(rng.normal(0, 0.1, 3))}" axis="{_text(_direction(rng))}" {ref}/>'
        )

    def body(depth):
        joints = "".join(joint() for _ in range(min(left[0], int(rng.choice([0, 1, 1, 2])) if depth else 1)))
        mass, inertia = _inertia(rng)
        full = [inertia[0, 0], inertia[1, 1], inertia[2, 2], inertia[0, 1], inertia[0, 2], inertia[1, 2]]
        own = f'<inertial pos="{_text(rng.normal(0, 0.1, 3))}" mass="{mass:.17g}" '
        own += (
            f'fullinertia="{_text(full)}"/>'
            if rng.random() < 0.5
            else f'{turn()} diaginertia="{_text(np.linalg.eigvalsh(inertia))}"/>'
        )
        inner = ""
        while left[0] and (not inner or rng.random() < 0.5):
            below = body(depth + 1)
            is_framed = rng.random() < 0.4
            inner += f'<frame pos="{_text(rng.normal(0, 0.2, 3))}" {turn()}>{below}</frame>' if is_framed else below
        more = rng.choice(["", 'childclass="slow"'])
        return f'<body pos="{_text(rng.normal(0, 0.3, 3))}" {turn()} {more}>\n{joints}{own}{inner}</body>'

    bodies = ""
    while left[0]:
        bodies += body(0)
    return (
        '<mujoco><compiler eulerseq="zYx"/><option gravity="1 2 -9"/><default><joint armature="0.01"/>'
        f'<default class="slow"><joint armature="0.3"/></default></default>\n<worldbody>{bodies}</worldbody></mujoco>'
    )


def compiled(text):
    """MuJoCo's own model of a URDF or MJCF, without limits and contacts, and its data."""
    model = mujoco.MjModel.from_xml_string(text)
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
    return model, mujoco.MjData(model)


def names(model):
    """Names of the joints in MuJoCo's order."""
    return [model.joint(k).name for k in range(model.njnt)]


def inverse(model, data, q, dq, ddq):
    """Torques by mj_inverse."""
    data.qpos[:], data.qvel[:], data.qacc[:] = q, dq, ddq
    mujoco.mj_inverse(model, data)
    return data.qfrc_inverse.copy()
