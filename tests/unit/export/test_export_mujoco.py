"""Exports to MJCF and URDF in MuJoCo itself: its joint has the torque that the export claims."""

import numpy as np
import pytest

import friction_hil as fh
from friction_hil.export.mujoco_friction import DEFAULT, STIFF
from friction_hil.models.files import load_model_file, model_from_argument
from friction_hil.models.model_file import ModelFile

mujoco = pytest.importorskip("mujoco", minversion="4.0", reason="MuJoCo 4 is not installed")

LUGRE = "config/models/lugre_axis.yaml"
SPEEDS = np.array([-2.0, -0.5, -0.1, 0.05, 0.3, 1.0, 2.0])


def model_of(text, dt=1e-4):
    model = mujoco.MjModel.from_xml_string(text)
    model.opt.timestep = dt
    return model


def steady_torque(model, speeds):
    """Friction torque of the joint while its velocity is held, (n,)."""
    torque = []
    for speed in speeds:
        data = mujoco.MjData(model)
        for _ in range(int(0.05 / model.opt.timestep)):  # bristles settle
            data.qvel[0] = speed
            mujoco.mj_step(model, data)
        data.qvel[0] = speed
        mujoco.mj_forward(model, data)
        torque.append(-(data.qfrc_passive + data.qfrc_constraint + data.qfrc_actuator)[0])
    return np.array(torque)


NAMES = {"mjcf": ("frictionloss", "damping"), "urdf": ("friction", "damping")}


@pytest.mark.parametrize("to", NAMES)
def test_the_joint_has_the_fitted_coulomb_level_and_damping(to):
    converted = fh.export.convert("stribeck:coulomb=0.07,static=0.1,stribeck_velocity=0.05,viscous=0.01", to, speed=2.0)
    (text,) = converted.files.values()
    coulomb, damping = (converted.parameters[each] for each in NAMES[to])
    expected = coulomb * np.sign(SPEEDS) + damping * SPEEDS
    np.testing.assert_allclose(steady_torque(model_of(text), SPEEDS), expected, rtol=1e-3)


def test_the_dcmotor_has_the_torque_of_the_model_at_every_speed():
    (text,) = fh.export.convert(LUGRE, "mjcf_lugre").files.values()
    expected = load_model_file(LUGRE).friction_model.steady_state(SPEEDS)
    np.testing.assert_allclose(steady_torque(model_of(text), SPEEDS), expected, rtol=1e-6)


def test_a_joint_that_slides_to_rest_has_the_torque_of_the_model_all_the_way():
    """Sliding, sticking and the swing of the bristles at rest: compared over the velocities that MuJoCo finds."""
    file = load_model_file(LUGRE)
    (text,) = fh.export.convert(LUGRE, "mjcf_lugre").files.values()
    dt = 2e-6
    model = model_of(text, dt)
    data = mujoco.MjData(model)
    data.qvel[0] = 1.0
    velocity, torque = np.empty(4000), np.empty(4000)
    for k in range(velocity.size):
        mujoco.mj_forward(model, data)
        velocity[k], torque[k] = data.qvel[0], -(data.qfrc_passive + data.qfrc_actuator)[0]
        mujoco.mj_step(model, data)
    assert velocity[0] == 1.0
    assert abs(velocity[-1]) < 2e-3
    expected = file.friction_model.simulate(velocity, dt)
    settled = slice(60, None)  # MuJoCo takes the torque from the state before the step: one step of a steep beginning
    np.testing.assert_allclose(torque[settled], expected[settled], rtol=0.0, atol=0.02 * 0.105)


def test_the_largest_harmonic_is_the_cogging_of_the_dcmotor(tmp_path):
    file = model_from_argument("coulomb:coulomb=0.05")
    modifiers = {"ripple": [{"order": 7, "cosine": 0.001, "sine": 0.002}, {"order": 3, "sine": 0.0005}]}
    friction = file.friction.model_copy(update={"modifiers": modifiers})
    file = file.model_copy(update={"friction": friction})
    converted = fh.export.convert(file, "mjcf_lugre", name="x", speed=1.0)
    model = model_of(converted.files["x.xml"])
    for position in np.linspace(0.0, 2.0, 9):
        data = mujoco.MjData(model)
        data.qpos[0] = position
        mujoco.mj_forward(model, data)
        expected = 0.001 * np.cos(7 * position) + 0.002 * np.sin(7 * position)
        assert -data.qfrc_actuator[0] == pytest.approx(expected, abs=1e-9)


def speed_under(torque, text, dt):
    """The mean speed of the joint in the second half of 0.3 s of constant torque."""
    model = model_of(text, dt)
    data = mujoco.MjData(model)
    data.qfrc_applied[0] = torque
    steps = round(0.3 / dt)
    for k in range(steps):
        mujoco.mj_step(model, data)
        if k == steps // 2:
            half = data.qpos[0]
    return (data.qpos[0] - half) / ((steps - 1 - steps // 2) * dt)


def axis_file(inertia, model="lugre", axis="rotary", **parameters):
    """A model file with a level of 0.08, whose inertia is known."""
    own = {"coulomb": 0.08} | parameters
    content = {"axis": axis, "friction": {"model": model, "parameters": own}}
    return ModelFile.model_validate(content | {"mechanics": {"inertia": inertia}})


AXIS = {"sigma0": 2000.0, "sigma1": 1.0, "sigma2": 0.002, "static": 0.12, "stribeck_velocity": 0.2}


@pytest.mark.parametrize(("axis", "inertia"), [("rotary", 1e-6), ("rotary", 2e-4), ("rotary", 0.5), ("linear", 2.0)])
@pytest.mark.parametrize(("to", "softness"), [("mjcf", STIFF), ("urdf", DEFAULT)])
def test_a_joint_under_a_constant_torque_creeps_as_it_is_said_to(to, softness, axis, inertia):
    converted = fh.export.convert(axis_file(inertia, axis=axis, **AXIS), to, name="x", speed=3.0)
    (text,) = converted.files.values()
    level = converted.parameters[NAMES[to][0]]
    most = softness.creep(level, inertia)
    unit = {"rotary": "rad/s", "linear": "m/s"}[axis]
    assert f"up to {most:.2g} {unit}" in text
    assert f"up to {most:.2g} {unit}" in "\n".join(converted.loss.lines())
    for dt in (1e-4, 2e-3):
        assert speed_under(0.6 * level, text, dt) == pytest.approx(0.6 * most, rel=1e-2)
    assert speed_under(1.2 * level, text, 2e-3) > 0.02 * level / inertia * 0.3


@pytest.mark.parametrize("to", ["mjcf", "urdf"])
@pytest.mark.parametrize(("axis", "inertia"), [("rotary", 1e-5), ("rotary", 2e-4), ("rotary", 1.0), ("linear", 3.0)])
def test_the_stated_loss_is_what_mujoco_shows_in_steady_motion(to, axis, inertia):
    """Inverse dynamics without acceleration: the torque that keeps the joint at its speed."""
    file = axis_file(inertia, axis=axis, **AXIS)
    converted = fh.export.convert(file, to, name="x", speed=3.0)
    (text,) = converted.files.values()
    points, model = converted.loss.points, model_of(text)
    data, seen = mujoco.MjData(model), np.empty(points.velocity.size)
    for k, velocity in enumerate(points.velocity):
        data.qvel[0], data.qacc[0] = velocity, 0.0
        mujoco.mj_inverse(model, data)
        seen[k] = data.qfrc_inverse[0]
    difference = points.torque(file.friction_model) - seen
    assert np.sqrt(points.weight @ difference**2) == pytest.approx(converted.loss.rms, rel=1e-3)
    np.testing.assert_allclose(difference, converted.loss.difference, rtol=0, atol=1e-5 * 0.08)


BRISTLES = {
    "constant": axis_file(2e-4, **AXIS),
    "falling": axis_file(2e-4, **AXIS | {"damping_velocity": 0.2}),
    "none": axis_file(2e-4, **AXIS | {"sigma1": 0.0}),
    "little": axis_file(1e-3, **AXIS | {"sigma0": 5e4, "sigma1": 1e-3}),
    "dahl": axis_file(2e-4, "dahl", sigma0=1500.0),
    "stribeck": axis_file(2e-4, "stribeck", static=0.12, stribeck_velocity=0.2, viscous=0.002),
    "linear": axis_file(2e-3, axis="linear", **AXIS),
}


@pytest.mark.parametrize("name", BRISTLES)
def test_bristles_hold_a_constant_torque(name):
    """At the time step of the file; without their damping they swing, and the joint creeps at 0.03 rad/s and more."""
    (text,) = fh.export.convert(BRISTLES[name], "mjcf_lugre", name="x", speed=3.0).files.values()
    dt = mujoco.MjModel.from_xml_string(text).opt.timestep
    assert f"a time step of {dt:.2g} s at most" in text
    for torque in (0.02, 0.05, 0.07):
        assert abs(speed_under(torque, text, dt)) < 1e-6
    assert speed_under(0.15, text, dt) > 1.0
