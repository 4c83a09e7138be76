"""Simulated servos on the joints of an arm from a file, compared with MuJoCo and with arms of fewer joints."""

import itertools
import math

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from friction_hil.config.simulation import UrdfArm
from friction_hil.errors import ConfigurationError, UsageError
from friction_hil.servo.coupled_servos import CoupledServos
from friction_hil.servo.mechanisms import planar
from tests import random_arms
from tests.unit.servo.test_servo_coupled import (
    ARM,
    CST,
    HZ,
    LUGRE,
    Mechanism,
    TypeAdapter,
    positions,
    push,
    residual,
    velocities,
)
from tests.unit.servo.test_servo_coupled import servo as servo_of
from tests.unit.servo.test_servo_machine import coulomb


@pytest.fixture(scope="session")
def files(tmp_path_factory):
    folder, numbers = tmp_path_factory.mktemp("arms"), itertools.count()

    def write(text):
        path = folder / f"{next(numbers)}.xml"
        path.write_text(text)
        return path

    return write


def arm_of(path, joints, **keys):
    return UrdfArm.model_validate({"kind": "urdf", "file": path, "axes": {f"a{k}": k for k in joints}, **keys})


def couple(mechanism, start, rotors, friction=None, hz=HZ, *, brakes=(), **parts):
    linkage = mechanism.linkage()
    frictions = friction if isinstance(friction, list) else [friction or coulomb()] * len(rotors)
    configs = [
        servo_of(rotor, each, "linear" if is_linear else "rotary", hz, brake=k in brakes, **parts)
        for k, (rotor, each, is_linear) in enumerate(zip(rotors, frictions, linkage.arm.is_linear, strict=True))
    ]
    return CoupledServos(linkage, configs, start)


def random_arm(files, rng, kind, count, **keys):
    """A random tree for MuJoCo and as a mechanism, and the inertias of its motors."""
    text = getattr(random_arms, kind)(rng, count)
    model, data = random_arms.compiled(text)
    model.opt.timestep, model.opt.integrator = 1e-4, mujoco.mjtIntegrator.mjINT_RK4
    rotors = rng.uniform(0.05, 0.5, model.nv)
    model.dof_armature[:] = rotors  # not those of the file: the motors are in the configuration
    gravity = {} if kind == "mjcf" else {"gravity": tuple(model.opt.gravity)}
    return model, data, arm_of(files(text), random_arms.names(model), **gravity, **keys), rotors


@pytest.mark.parametrize("kind", ["urdf", "mjcf"])
@pytest.mark.parametrize("count", [1, 3, 5])
def test_an_arm_moves_freely_as_in_mujoco(files, kind, count):
    """For a second, under constant torques and viscous friction; then its energy is that of MuJoCo too."""
    rng = np.random.default_rng(10 * count + (kind == "mjcf"))
    model, data, mechanism, rotors = random_arm(files, rng, kind, count)
    model.opt.enableflags |= int(mujoco.mjtEnableBit.mjENBL_ENERGY)
    model.dof_damping[:] = 0.5
    torques, start = rng.normal(0.0, 3.0, model.nv), rng.normal(size=model.nv)
    both = couple(mechanism, start, rotors, coulomb(viscous=0.5))
    push(both, *torques)
    data.qpos[:], data.qfrc_applied[:] = start, torques
    mujoco.mj_forward(model, data)
    before, of_mujoco = both.energy.stored, data.energy.sum()
    for _ in range(10):
        both.advance(HZ // 10)
        for _ in range(1000):
            mujoco.mj_step(model, data)
        scale = 1.0 + np.abs(data.qvel).max()
        assert positions(both) == pytest.approx(data.qpos, abs=1e-5 * scale)
        assert velocities(both) == pytest.approx(data.qvel, abs=1e-4 * scale)
    assert np.abs(positions(both) - start).max() > 0.1
    mujoco.mj_forward(model, data)
    change = data.energy.sum() - of_mujoco
    assert both.energy.stored - before == pytest.approx(change, abs=1e-4 * (1.0 + abs(change)))


@settings(max_examples=25, deadline=None)
@given(
    seed=st.integers(0, 10**6),
    kind=st.sampled_from(["urdf", "mjcf"]),
    count=st.integers(1, 5),
    levels=st.tuples(st.floats(0.0, 5.0), st.floats(0.0, 3.0), st.floats(0.0, 0.5)),
    hz=st.sampled_from([24_000, 80_000]),
)
def test_no_arm_creates_energy(files, seed, kind, count, levels, hz):
    """With Coulomb and static friction, payload and a force at the tool, pushed to and fro."""
    rng = np.random.default_rng(seed)
    force = [{"time_s": 0.01, "x": 5.0, "y": -3.0, "z": 2.0}, {"time_s": 0.05}]
    given_parts = {"payload": {"mass": 0.7, "center": (0.1, 0.0, 0.05)}, "tool": {"position": (0.1, 0.2, 0.0)}}
    model, _, mechanism, rotors = random_arm(files, rng, kind, count, tool_force=force, **given_parts)
    friction = coulomb(levels[0], levels[0] + levels[1], levels[2])
    both = couple(mechanism, rng.normal(size=model.nv), rotors, friction, hz)
    before = at_start = both.energy
    scale = 20.0 * count  # largest potential, in which differences are lost to rounding
    for _ in range(5):
        push(both, *rng.normal(0.0, 10.0, model.nv))
        both.advance(hz // 50)
        now = both.energy
        scale += abs(now.motor_work) + abs(now.load_work) + now.friction_heat
        assert now.friction_heat >= before.friction_heat - 1e-12 * scale
        assert abs(residual(both, at_start.stored)) < 1e-11 * scale
        before = now


def test_a_fast_arm_keeps_its_energy_whatever_the_step(files):
    """At up to 1e-2 rad a step: the error of the trajectory is seen, one of the energy is not."""
    model, _, mechanism, rotors = random_arm(files, np.random.default_rng(2), "mjcf", 3)
    courses = []
    for hz in (24_000, 48_000):
        both = couple(mechanism, np.zeros(model.nv), rotors, hz=hz)
        for record, speed in zip(both.records.states, (300.0, -200.0, 100.0), strict=True):
            record["velocity"] = record["velocity_before"] = record["load_velocity"] = speed
        inertia = mechanism.linkage().arm.inertia_matrix(positions(both))
        both.records.total["kinetic"] = 0.5 * velocities(both) @ inertia @ velocities(both)
        start = both.energy.stored
        push(both, *[0.0] * model.nv)
        both.advance(hz // 20)
        assert residual(both, start) == pytest.approx(0.0, abs=1e-11 * start)
        courses.append(positions(both))
    assert np.abs(courses[0] - courses[1]).max() > 1e-6


def test_halving_the_step_quarters_the_error(files):
    model, _, mechanism, rotors = random_arm(files, np.random.default_rng(4), "urdf", 4)
    courses = []
    for factor in (1, 2, 4, 16):
        both = couple(mechanism, np.zeros(model.nv), rotors, coulomb(viscous=0.1), 24_000 * factor)
        push(both, 3.0, -2.0, 4.0, 1.0)
        rows = []
        for _ in range(10):
            both.advance(1200 * factor)
            rows.append([*positions(both), *velocities(both)])
        courses.append(np.array(rows))
    errors = [np.sqrt(np.mean((course - courses[-1]) ** 2)) for course in courses[:-1]]
    own = 1.0 / 16.0**2  # error of the finest, relative to that of the coarsest
    assert errors[0] / errors[1] == pytest.approx((1.0 - own) / (1.0 / 4.0 - own), rel=0.05)
    assert errors[1] / errors[2] == pytest.approx((1.0 / 4.0 - own) / (1.0 / 16.0 - own), rel=0.05)


def test_an_arm_at_rest_stays_where_friction_or_the_torque_of_gravity_holds_it(files):
    model, _, mechanism, rotors = random_arm(files, np.random.default_rng(6), "urdf", 5)
    start = np.random.default_rng(7).normal(size=model.nv)
    needed = mechanism.linkage().arm.gravity(start)
    assert np.abs(needed).max() > 5.0
    held = couple(mechanism, start, rotors, coulomb(0.5, 1.01 * np.abs(needed).max()))
    held.advance(HZ // 20)
    assert positions(held).tolist() == start.tolist()
    balanced = couple(mechanism, start, rotors)
    push(balanced, *needed)
    balanced.advance(HZ // 20)
    assert positions(balanced) == pytest.approx(start, abs=1e-9)
    falling = couple(mechanism, start, rotors, coulomb(0.5, 0.99 * np.abs(needed).max()))
    falling.advance(HZ // 20)
    moved = positions(falling) != start
    assert moved[np.abs(needed).argmax()]


@pytest.mark.parametrize("kind", ["urdf", "mjcf"])
def test_joints_that_brakes_hold_are_locked_joints(files, kind):
    """Those between and around the moving ones; the reaction does not move them, and they do not brake the others."""
    rng = np.random.default_rng(8)
    model, _, mechanism, rotors = random_arm(files, rng, kind, 5)
    start, names = rng.normal(size=model.nv), list(mechanism.axes.values())
    braked, free = [0, 2], [1, 3, 4]
    whole = couple(mechanism, start, rotors, LUGRE, brakes=braked)
    locked = {names[k]: start[k] for k in braked}
    fewer = arm_of(mechanism.file, [names[k] for k in free], gravity=mechanism.gravity, locked=locked)
    part = couple(fewer, start[free], rotors[free], LUGRE)
    for k, one in zip(free, part.servos, strict=True):
        for each in (whole.servos[k], one):
            each.command(CST, 2.0)
    whole.advance(HZ // 4)
    part.advance(HZ // 4)
    assert positions(whole)[braked].tolist() == start[braked].tolist()
    assert np.abs(positions(part) - start[free]).max() > 0.1
    assert positions(whole)[free] == pytest.approx(positions(part), abs=1e-9)


def test_a_force_at_the_tool_acts_through_the_jacobian_of_mujoco(files):
    """Torques that balance it hold a weightless arm; the tool is where MuJoCo has it."""
    rng = np.random.default_rng(9)
    point, force = (0.1, -0.2, 0.3), {"time_s": 0.0, "x": 4.0, "y": -7.0, "z": 5.0}
    keys = {"tool": {"position": point}, "tool_force": [force]}
    model, data, mechanism, rotors = random_arm(files, rng, "urdf", 4, **keys)
    mechanism = mechanism.model_copy(update={"gravity": (0.0, 0.0, 0.0)})
    start = rng.normal(size=model.nv)
    data.qpos[:] = start
    mujoco.mj_forward(model, data)
    body = model.jnt_bodyid[-1]
    where = data.xpos[body] + data.xmat[body].reshape(3, 3) @ point
    jacobian = np.zeros((3, model.nv))
    mujoco.mj_jac(model, data, jacobian, None, where, body)
    both = couple(mechanism, start, rotors)
    assert both.tool == pytest.approx(where)
    push(both, *(-jacobian.T @ [force[each] for each in "xyz"]))
    both.advance(HZ // 10)
    assert positions(both) == pytest.approx(start, abs=1e-9)


def test_a_two_link_arm_of_a_file_is_the_one_of_the_configuration(files):
    """The same motion with static friction, payload and force, and what is said of it."""
    first, second = ARM["links"]
    bodies = [
        f'<inertial><origin xyz="0 {-each["center"]} 0"/><mass value="{each["mass"]}"/>'
        f'<inertia ixx="1" iyy="1" izz="{each["inertia"]}" ixy="0" ixz="0" iyz="0"/></inertial>'
        for each in (first, second)
    ]
    path = files(
        f"""<robot name="two"><link name="base"/><link name="upper">{bodies[0]}</link>
        <link name="fore">{bodies[1]}</link><link name="tool"/>
        <joint name="x" type="continuous"><parent link="base"/><child link="upper"/><axis xyz="0 0 -1"/></joint>
        <joint name="y" type="continuous"><parent link="upper"/><child link="fore"/><axis xyz="0 0 1"/>
        <origin xyz="0 {-first["length"]} 0"/></joint><joint name="end" type="fixed"><parent link="fore"/>
        <child link="tool"/><origin xyz="0 {-second["length"]} 0"/></joint></robot>"""
    )
    force = [{"time_s": 0.1, "x": 3.0, "y": -2.0}]
    keys = {"signs": {"ax": -1}, "gravity": (0.0, -9.81, 0.0), "tool": {"link": "tool"}, "tool_force": force}
    mechanism = arm_of(path, ["x", "y"], payload={"mass": ARM["payload"], "link": "tool"}, **keys)
    friction, start, rotors = coulomb(0.4, 0.6, 0.05), (1.4, -0.9), (0.08, 0.03)
    of_file = couple(mechanism, start, rotors, friction)
    planar_arm = TypeAdapter(Mechanism).validate_python({**ARM, "tool_force": force})
    own = CoupledServos(planar_arm, [servo_of(each, friction, "rotary") for each in rotors], start)
    for both in (of_file, own):
        push(both, 3.0, -1.0)
        both.advance(HZ // 2)
    assert positions(of_file) == pytest.approx(positions(own), abs=1e-9)
    assert of_file.tool == pytest.approx((*own.tool, 0.0), abs=1e-9)
    assert of_file.energy.load_work == pytest.approx(own.energy.load_work)
    states = np.random.default_rng(1).normal(size=(3, 2))
    assert mechanism.linkage().arm.inverse_dynamics(*states) == pytest.approx(
        planar(planar_arm).arm.inverse_dynamics(*states)
    )


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ({"axes": {"a": "j9"}}, "no joint 'j9'"),
        ({"locked": {"swing": 0.1}}, "'swing' is one of the joints"),
        ({"payload": {"mass": 1.0, "link": "hand"}}, "no link 'hand'"),
        ({"payload": {"mass": 1.0, "inertia": (1.0, 0.0, 0.0, 0.0, 0.0, 0.0)}}, "belong to no body"),
        ({"tool": {"link": "hand"}}, "no link 'hand'"),
        ({"file": "nowhere.urdf"}, "cannot be read"),
    ],
)
def test_what_does_not_go_with_the_file_is_refused(files, keys, words):
    links = "".join(f'<link name="{name}"/>' for name in ("base", "arm", "carriage"))
    text = f"""<robot name="p">{links}<joint name="swing" type="continuous"><parent link="base"/><child link="arm"/>
    <axis xyz="1 0 0"/></joint><joint name="slide" type="prismatic"><parent link="arm"/><child link="carriage"/>
    <axis xyz="1 0 0"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint></robot>"""
    whole = {"kind": "urdf", "file": files(text), "axes": {"a": "swing", "b": "slide"}}
    arm = UrdfArm.model_validate(whole)
    assert arm.linkage().arm.is_linear == (False, True)
    with pytest.raises(UsageError, match=r"b: mechanics.axis must be linear: .*'slide'"):
        CoupledServos(arm.linkage(), [servo_of(0.1, LUGRE, "rotary")] * 2)
    with pytest.raises((UsageError, ConfigurationError), match=words):
        UrdfArm.model_validate({**whole, **keys}).linkage()


def test_the_inertia_of_the_file_s_rotors_is_left_out(files):
    """The motors are in the configuration; counted twice, a joint would be too slow."""
    joint = '<joint name="s" axis="0 0 1" armature="0.5"/><inertial pos="0 0 0" mass="1" diaginertia="0.1 0.1 0.1"/>'
    arm = arm_of(files(f"<mujoco><worldbody><body>{joint}</body></worldbody></mujoco>"), ["s"])
    one = couple(arm, (0.0,), (0.3,))
    assert one.servos[0].total_inertia == pytest.approx(0.4)
    push(one, 2.0)
    one.advance(HZ // 10)
    assert velocities(one) == pytest.approx([0.1 * 2.0 / 0.4])
    assert math.isclose(one.energy.stored, 0.5 * 0.4 * 0.5**2)
