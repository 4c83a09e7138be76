"""The rigid servo against a machine of no other parts, and against one in plain C (``plain_servo.c``)."""

import ctypes
import math
import shutil
from pathlib import Path

import numpy as np
import pytest

from friction_hil.friction import describe
from friction_hil.servo.config import ServoConfig
from friction_hil.servo.servo import Servo
from tests.unit.servo.test_servo_machine import coulomb
from tools.benchmarks.c_library import load

CSP, CST = 8, 10
LUGRE = {"model": "lugre", "parameters": dict(describe("lugre").example)}


class PlainServo:
    """The C loop for the default servo."""

    def __init__(self):
        self._advance = load(Path(__file__).with_name("plain_servo.c")).servo
        array = np.ctypeslib.ndpointer(np.float64, ndim=1, flags="C")
        self._advance.argtypes = (array, ctypes.c_double, ctypes.c_long, array)
        self._advance.restype = None
        config = ServoConfig()
        loops, dt = config.loops, 1.0 / config.integration_hz
        names = ("sigma0", "sigma1", "sigma2", "coulomb", "static", "stribeck_velocity", "damping_velocity")
        self._parameters = np.array(
            [
                config.mechanics.inertia,
                dt,
                -math.expm1(-dt / config.motor.torque_lag_s),
                config.encoder.counts / math.tau,
                config.integration_hz / loops.rate_hz,
                -math.expm1(-math.tau * loops.velocity_filter_hz / loops.rate_hz),
                *(LUGRE["parameters"][name] for name in names),
            ]
        )
        self.state = np.zeros(6)  # position first

    def advance(self, torque, steps):
        self._advance(self._parameters, torque, steps, self.state)


@pytest.mark.skipif(shutil.which("gcc") is None, reason="there is no gcc here to compile the C loop")
def test_the_rigid_servo_moves_as_the_c_loop():
    plain, ours = PlainServo(), Servo(ServoConfig.model_validate({"friction": LUGRE}))
    for torque in (0.1, 0.2, -0.15, 0.02, -0.3):
        plain.advance(torque, 8000)
        ours.command(CST, torque)
        ours.advance(8000)
        assert ours.true_position == pytest.approx(plain.state[0], rel=1e-6, abs=1e-9)
        assert ours.true_velocity == pytest.approx(plain.state[1], rel=1e-6, abs=1e-9)
        assert ours.velocity == pytest.approx(plain.state[5], rel=1e-6, abs=1e-2)


@pytest.mark.parametrize("friction", [LUGRE, coulomb(0.08, 0.12, 2e-3)])
def test_a_machine_with_a_part_of_no_effect_moves_as_the_rigid_servo(friction):
    rigid = Servo(ServoConfig.model_validate({"friction": friction}))
    other = Servo(ServoConfig.model_validate({"friction": friction, "mechanics": {"spring": {"stiffness": 1e-12}}}))
    for k in range(1500):
        for one in (rigid, other):
            one.command(CSP, 0.3 * math.sin(2e-3 * math.pi * k))
            one.advance(80)
        # half a step apart: semi-implicit Euler moves with the velocity at the end of the step
        assert other.true_position == pytest.approx(rigid.true_position, abs=1.5e-5)
        assert other.load_position == other.true_position
