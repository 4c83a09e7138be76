"""LuGre against MuJoCo's: an implementation by other people, from the same equations.

MuJoCo (4.0) has LuGre friction in its actuator ``dcmotor``: ``lugre="stiffness damping coulomb static stribeck"``,
with the bristle deflection as activation. Without inputs and with a motor constant of zero nothing but friction
is left of the motor. It takes the torque of a step from the state *before* the step.
"""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

import friction_hil as fh

mujoco = pytest.importorskip("mujoco", minversion="4.0", reason="MuJoCo 4, with its LuGre friction, is not installed")
checked = settings(max_examples=60, deadline=None)

PLANT = """
<mujoco>
  <option timestep="{dt!r}" gravity="0 0 0"/>
  <worldbody>
    <body>
      <joint name="axis" type="hinge" axis="0 0 1"/>
      <inertial pos="0 0 0" mass="1" diaginertia="1 1 1"/>
    </body>
  </worldbody>
  <actuator>
    <dcmotor joint="axis" input="none" motorconst="0" resistance="1"
             lugre="{sigma0!r} {sigma1!r} {coulomb!r} {static!r} {stribeck_velocity!r}"/>
  </actuator>
</mujoco>
"""


def torque_before_each_step(parameters, velocity, dt):
    """Friction torque of MuJoCo at the beginning of every step, (n + 1,); the velocity is held over each."""
    model = mujoco.MjModel.from_xml_string(PLANT.format(dt=dt, **{"sigma1": 0.0} | parameters))
    assert (model.na, model.nu) == (1, 0)  # the bristle is the only state of the motor; it has no input
    data = mujoco.MjData(model)
    torque = np.empty(velocity.size + 1)
    for k, v in enumerate([*velocity, velocity[-1]]):
        data.qvel[0] = v
        mujoco.mj_step(model, data)
        torque[k] = -data.actuator_force[0]
    return torque


@st.composite
def parameters(draw):
    coulomb = draw(st.floats(1e-3, 1e3))
    return {
        "sigma0": coulomb * draw(st.floats(1e2, 1e6)),
        "coulomb": coulomb,
        "static": coulomb * draw(st.floats(1.0, 3.0)),
        "stribeck_velocity": draw(st.floats(1e-3, 10.0)),
    }


speeds = st.one_of(st.just(0.0), st.floats(-1e3, 1e3, allow_subnormal=False), st.floats(-0.01, 0.01))


@checked
@given(parameters(), arrays(float, st.integers(1, 40), elements=speeds), st.floats(1e-6, 0.1))
def test_the_bristle_torque_is_that_of_mujoco_while_the_velocity_is_held(p, v, dt):
    expected = torque_before_each_step(p, v, dt)
    assert expected[0] == 0.0  # both start undeflected
    torque = fh.models.create("lugre", **p).simulate(v, dt)
    np.testing.assert_allclose(torque, expected[1:], rtol=0.0, atol=1e-9 * p["static"])


@pytest.mark.parametrize("dt", [1e-4, 1e-3])
def test_a_long_rough_history_stays_with_mujoco(dt):
    """Reversals, dwells and presliding, servo-like: no difference builds up."""
    random = np.random.default_rng(3)
    p = {"sigma0": 2000.0, "coulomb": 0.08, "static": 0.12, "stribeck_velocity": 0.2}
    v = np.cumsum(random.normal(scale=0.02, size=4000))
    v[random.integers(0, 40, size=v.size // 100)[:, None] * 100 + np.arange(30)] = 0.0
    v[2000:3000] *= 1e-3
    torque = fh.models.create("lugre", **p).simulate(v, dt)
    expected = torque_before_each_step(p, v, dt)[1:]
    assert np.ptp(expected) > 0.1  # it did slip both ways
    np.testing.assert_allclose(torque, expected, rtol=0.0, atol=1e-9 * p["static"])


def test_bristle_damping_approaches_that_of_mujoco_at_first_order():
    """MuJoCo takes the bristle's rate at the beginning of a step, we its mean over the step: dt apart."""
    p = {"sigma0": 2000.0, "sigma1": 1.0, "coulomb": 0.08, "static": 0.12, "stribeck_velocity": 0.2}

    def difference(dt):
        v = 0.02 * np.sin(2.0 * math.pi * 5.0 * dt * np.arange(round(0.2 / dt)))
        ours = fh.models.create("lugre", **p).simulate(v, dt)
        return np.abs(ours - torque_before_each_step(p, v, dt)[:-1])[10:].max()

    coarse, fine = difference(1e-4), difference(5e-5)
    assert fine < 0.02 * p["static"]
    assert coarse / fine == pytest.approx(2.0, rel=0.1)
