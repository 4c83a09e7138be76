"""Dynamics of arms against MuJoCo, closed forms, and what holds for every mechanism."""

import math

import mujoco
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import friction_hil as fh
from friction_hil.errors import UsageError
from friction_hil.servo.mechanisms import Link, TwoLinkArm, planar
from tests import random_arms
from tools.benchmarks import dynamics as benchmark

PENDULUM = """<robot name="p"><link name="base"/><link name="arm"><inertial><origin xyz="0 0 -0.3"/><mass value="2"/>
<inertia ixx="0.02" iyy="0.02" izz="0.001" ixy="0" ixz="0" iyz="0"/></inertial></link>
<joint name="swing" type="continuous"><parent link="base"/><child link="arm"/><axis xyz="1 0 0"/></joint></robot>"""


@pytest.fixture
def load(tmp_path):
    def of(text, *arguments, **options):
        path = tmp_path / "arm.xml"
        path.write_text(text, encoding="utf-8")
        return fh.dynamics.load(path, *arguments, **options)

    return of


@pytest.mark.parametrize("kind", ["urdf", "mjcf"])
@pytest.mark.parametrize("seed", range(12))
def test_inverse_dynamics_and_inertia_are_those_of_mujoco(load, kind, seed):
    rng = np.random.default_rng(seed)
    count = int(rng.integers(1, 8))
    text = getattr(random_arms, kind)(rng, count)
    model, data = random_arms.compiled(text)
    options = {} if kind == "mjcf" else {"gravity": model.opt.gravity}
    arm = load(text, random_arms.names(model), **options)
    q, dq, ddq = rng.normal(size=(3, 4, model.nv))
    wanted = np.array([random_arms.inverse(model, data, *state) for state in zip(q, dq, ddq, strict=True)])
    scale = np.abs(wanted).max()
    assert arm.inverse_dynamics(q, dq, ddq) == pytest.approx(wanted, rel=1e-10, abs=1e-11 * scale)
    assert arm.is_linear == tuple(model.jnt_type == mujoco.mjtJoint.mjJNT_SLIDE)
    for position in q:
        data.qpos[:] = position
        mujoco.mj_forward(model, data)
        matrix = np.zeros((model.nv, model.nv))
        for k in range(model.nv):
            push = np.zeros(model.nv)
            push[k] = 1.0
            column = np.zeros(model.nv)
            mujoco.mj_mulM(model, data, column, push)
            matrix[:, k] = column
        assert arm.inertia_matrix(position) == pytest.approx(matrix, rel=1e-9, abs=1e-11)


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10**6), st.integers(1, 7))
def test_what_holds_for_every_arm(tmp_path_factory, seed, count):
    rng = np.random.default_rng(seed)
    path = tmp_path_factory.getbasetemp() / "any.urdf"
    path.write_text(random_arms.urdf(rng, count))
    names = [f"{each}" for each in fh.dynamics.load(path).joints]
    order = list(rng.permutation(names))
    rotors = dict(zip(order, rng.uniform(0.0, 1.0, count), strict=True))
    signs = rng.choice([-1.0, 1.0], count)
    arm = fh.dynamics.load(path, order, signs=signs, rotor_inertia=rotors)
    q, dq, ddq = rng.normal(size=(3, count))
    tau, none = arm.inverse_dynamics(q, dq, ddq), np.zeros(count)
    size = np.abs(tau).max() + 1.0
    # linear in the acceleration and in the parameters
    matrix = arm.inertia_matrix(q)
    assert matrix == pytest.approx(matrix.T, abs=1e-12 * size)
    assert np.linalg.eigvalsh(matrix)[0] > 0.0
    assert tau - arm.inverse_dynamics(q, dq, none) == pytest.approx(matrix @ ddq, abs=1e-11 * size)
    linear = arm.regressor(q, dq, ddq) @ arm.parameters.ravel() + arm.armatures * ddq
    assert linear == pytest.approx(tau, abs=1e-12 * size)
    # power is the change of kinetic and potential energy: by central differences
    step = 1e-6

    def kinetic(at, speed):
        return 0.5 * speed @ arm.inertia_matrix(at) @ speed

    change = kinetic(q + step * dq, dq + step * ddq) - kinetic(q - step * dq, dq - step * ddq)
    power = (tau - arm.gravity(q)) @ dq
    assert power == pytest.approx(change / (2.0 * step), abs=1e-6 * size * (1.0 + np.abs(dq).max()))
    # the file's order and signs
    plain = fh.dynamics.load(path, names, rotor_inertia=rotors)
    back = [order.index(name) for name in names]
    of_file = plain.inverse_dynamics((signs * q)[back], (signs * dq)[back], (signs * ddq)[back])
    assert of_file == pytest.approx((signs * tau)[back], abs=1e-12 * size)
    assert arm.with_parameters(arm.parameters).inverse_dynamics(q, dq, ddq) == pytest.approx(tau, abs=0.0)


def test_a_pendulum(load):
    arm = load(PENDULUM)
    q = np.linspace(-3.0, 3.0, 7)[:, None]
    assert arm.gravity(q)[:, 0] == pytest.approx(2.0 * 9.81 * 0.3 * np.sin(q[:, 0]))
    assert arm.inertia_matrix([0.3]) == pytest.approx(0.02 + 2.0 * 0.3**2)
    assert arm.inverse_dynamics([0.0], [5.0], [2.0]) == pytest.approx(2.0 * 0.2)


def test_gear_payload_gravity_and_the_result_in_place(load):
    carried = fh.dynamics.Payload(0.5, (0.0, 0.0, -0.4), (0.01, 0.0, 0.0, 0.01, 0.0, 0.01))
    arm = load(PENDULUM, gear={"swing": 50.0}, rotor_inertia={"swing": 1e-5}, payload=carried, gravity=(0.0, 9.81, 0.0))
    assert arm.inertia_matrix([1.0]) == pytest.approx(0.02 + 0.18 + 0.01 + 0.5 * 0.16 + 2500 * 1e-5)
    assert arm.gravity([0.0]) == pytest.approx(-9.81 * (2.0 * 0.3 + 0.5 * 0.4))
    out = np.zeros(1)
    assert arm.gravity([0.0], out=out) is out
    assert out[0] == arm.gravity([0.0])[0]
    assert np.isnan(arm.gravity([math.nan])).all()


def test_the_two_link_arm_of_the_simulated_mechanisms(load):
    links = (
        Link(length=0.4, mass=3.0, center=0.2, inertia=0.04),
        Link(length=0.3, mass=1.5, center=0.1, inertia=0.02),
    )
    mine = planar(TwoLinkArm(kind="two_link_arm", axes=("a", "b"), links=links, payload=0.7)).arm
    bodies = [
        f'<inertial><origin xyz="0 0 -{each.center}"/><mass value="{each.mass}"/>'
        f'<inertia ixx="{each.inertia}" iyy="{each.inertia}" izz="0" ixy="0" ixz="0" iyz="0"/></inertial>'
        for each in links
    ]
    arm = load(
        f"""<robot name="two"><link name="base"/><link name="upper">{bodies[0]}</link>
        <link name="fore">{bodies[1]}</link><link name="tool"/>
        <joint name="a" type="continuous"><parent link="base"/><child link="upper"/><axis xyz="1 0 0"/></joint>
        <joint name="b" type="continuous"><parent link="upper"/><child link="fore"/><axis xyz="1 0 0"/>
        <origin xyz="0 0 -0.4"/></joint><joint name="end" type="fixed"><parent link="fore"/><child link="tool"/>
        <origin xyz="0 0 -0.3"/></joint></robot>""",
        payload=fh.dynamics.Payload(0.7, link="tool"),
    )
    rng = np.random.default_rng(5)
    q, dq, ddq = rng.normal(size=(3, 20, 2))
    assert mine.inverse_dynamics(q, dq, ddq) == pytest.approx(arm.inverse_dynamics(q, dq, ddq))


def test_joints_that_are_left_out_are_locked_where_they_are_told(load):
    text = random_arms.urdf(np.random.default_rng(3), 4, fixed=0.0)
    arm = load(text)
    q, dq, ddq = np.random.default_rng(4).normal(size=(3, 4))
    kept = [0, 2]
    dq[[1, 3]] = ddq[[1, 3]] = 0.0
    locked = {arm.joints[k]: q[k] for k in (1, 3)}
    part = load(text, [arm.joints[k] for k in kept], locked=locked)
    assert part.inverse_dynamics(q[kept], dq[kept], ddq[kept]) == pytest.approx(arm.inverse_dynamics(q, dq, ddq)[kept])


@pytest.mark.parametrize(
    ("call", "word"),
    [
        (lambda arm: arm.inverse_dynamics([1.0, 2.0], [0.0], [0.0]), "(1,)"),
        (lambda arm: arm.inverse_dynamics(np.zeros((3, 1)), np.zeros((2, 1)), np.zeros((3, 1))), "(2, 1)"),
        (lambda arm: arm.gravity(np.zeros((1, 1, 1))), "(1, 1, 1)"),
        (lambda arm: arm.regressor(0.0, 0.0, 0.0), "()"),
        (lambda arm: arm.gravity([0.0], out=np.zeros(2)), "(1,)"),
        (lambda arm: arm.gravity(np.zeros((2, 1)), out=np.zeros((2, 1), np.float32)), "float32"),
        (lambda arm: arm.with_parameters(np.zeros(9)), "(1, 10)"),
        (lambda arm: arm.with_parameters(np.full(10, math.inf)), "finite"),
    ],
)
def test_wrong_shapes_are_refused(load, call, word):
    with pytest.raises(UsageError) as error:
        call(load(PENDULUM))
    assert word in str(error.value)


def test_the_benchmark_of_dynamics_compares_with_mujoco(monkeypatch):
    monkeypatch.setattr(benchmark, "ROUNDS", 2)
    monkeypatch.setattr(benchmark, "CALLS", 100)
    whole, gravity = benchmark.run()
    assert "mj_inverse" in whole.name
    assert gravity.value > 0.0
    assert whole.ratio < 2.0  # on a busy machine; 0.4 on a quiet one
