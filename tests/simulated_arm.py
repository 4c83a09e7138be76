"""A log of an arm of six joints that MuJoCo moves, with friction that grows with the load, and a wrong URDF."""

from dataclasses import dataclass

import mujoco
import numpy as np

LINKS = (  # axis, origin, mass, centre, moments about the centre: of the true arm
    ("0 0 1", "0 0 0.1", 6.0, (0.0, 0.01, 0.1), (0.04, 0.04, 0.02)),
    ("0 1 0", "0 0 0.2", 8.0, (0.02, 0.0, 0.22), (0.10, 0.10, 0.03)),
    ("0 1 0", "0 0 0.43", 4.0, (0.0, 0.02, 0.15), (0.05, 0.05, 0.01)),
    ("0 0 1", "0 0 0.3", 2.0, (0.01, 0.0, 0.05), (0.01, 0.01, 0.005)),
    ("0 1 0", "0 0 0.12", 1.5, (0.0, 0.03, 0.06), (0.006, 0.006, 0.003)),
    ("0 0 1", "0 0 0.1", 0.8, (0.03, 0.0, 0.05), (0.003, 0.003, 0.002)),
)
ROTORS = np.array([0.4, 0.4, 0.25, 0.08, 0.06, 0.04])  # kg m^2 behind the gears
COULOMB = np.array([4.0, 6.0, 3.0, 1.2, 0.8, 0.5])  # N m
VISCOUS = np.array([2.0, 3.0, 1.5, 0.5, 0.4, 0.2])  # N m s/rad
LOAD = np.array([0.1, 0.12, 0.08, 0.1, 0.15, 0.1])
NAMES = tuple(f"joint{k + 1}" for k in range(6))
_RATE_HZ, _STEP_S, _SMOOTH = 250.0, 1e-3, 0.01  # rad/s


def urdf(factors=(1.0,) * 6):
    """The arm with masses and inertias multiplied by factors."""
    parts = ['<robot name="six"><link name="link0"/>']
    for k, (axis, origin, mass, centre, moments) in enumerate(LINKS):
        x, y, z = centre
        a, b, c = (factors[k] * each for each in moments)
        parts.append(
            f'<link name="link{k + 1}"><inertial><origin xyz="{x} {y} {z}"/><mass value="{factors[k] * mass}"/>'
            f'<inertia ixx="{a}" iyy="{b}" izz="{c}" ixy="0" ixz="0" iyz="0"/></inertial></link>'
            f'<joint name="{NAMES[k]}" type="continuous"><parent link="link{k}"/><child link="link{k + 1}"/>'
            f'<origin xyz="{origin}"/><axis xyz="{axis}"/></joint>'
        )
    return "\n".join([*parts, "</robot>"])


@dataclass(frozen=True)
class Log:
    """Columns as a drive of MIT mode reports them."""

    time_s: np.ndarray
    position: np.ndarray  # (k, n), in 16 bits
    velocity: np.ndarray  # in 12 bits
    torque: np.ndarray  # with noise


def record(seed=1, duration_s=60.0, still=()):
    """Move the arm along sines of each joint; ``still``: joints that are held."""
    rng = np.random.default_rng(seed)
    model = mujoco.MjModel.from_xml_string(urdf())
    model.opt.disableflags |= int(mujoco.mjtDisableBit.mjDSBL_CONSTRAINT)
    model.opt.timestep = _STEP_S
    model.dof_armature[:] = ROTORS
    data = mujoco.MjData(model)
    hertz = rng.uniform(0.05, 0.45, (4, 6))
    size = rng.uniform(0.5, 1.0, (4, 6)) * np.array([1.6, 1.0, 1.2, 2.0, 1.6, 2.0]) / (1.0 + 3.0 * hertz) / 2.0
    size[:, list(still)] = 0.0
    phase = rng.uniform(0.0, 2.0 * np.pi, (4, 6))
    gains = np.array([3000.0, 3000.0, 2000.0, 400.0, 300.0, 150.0])
    every, rows = round(1.0 / (_RATE_HZ * _STEP_S)), []
    data.qpos[:] = np.sum(size * np.sin(phase), axis=0)
    tau, friction, push = np.zeros(6), np.zeros(6), np.empty(6)
    for step in range(round(duration_s / _STEP_S)):
        angle = 2.0 * np.pi * hertz * (step * _STEP_S) + phase
        wanted = (size * np.sin(angle)).sum(axis=0)
        speed = (size * 2.0 * np.pi * hertz * np.cos(angle)).sum(axis=0)
        q, dq = data.qpos, data.qvel
        load = tau - friction - ROTORS * data.qacc  # what the links take, of the step before
        tau = gains * (wanted - q) + 0.05 * gains * (speed - dq)
        friction = (COULOMB + LOAD * np.abs(load)) * np.tanh(dq / _SMOOTH) + VISCOUS * dq
        push[:] = tau - friction
        if step % every == 0:
            rows.append(np.concatenate([[step * _STEP_S], q, dq, tau]))
        data.qfrc_applied[:] = push
        mujoco.mj_step(model, data)
    table = np.array(rows)
    noise = 0.02 * np.std(table[:, 13:], axis=0)
    return Log(
        table[:, 0],
        _coarse(table[:, 1:7], 25.0 / 2**16),
        _coarse(table[:, 7:13], 90.0 / 2**12),
        table[:, 13:] + rng.normal(size=(len(table), 6)) * noise,
    )


def _coarse(values, step):
    return np.round(values / step) * step
