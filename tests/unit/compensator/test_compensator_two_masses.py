"""Compensation at the motor of two masses: it follows better at motor and load, whatever the coupling is like."""

import math
from dataclasses import dataclass

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

import friction_hil as fh
from friction_hil.compensator import Compensator, CompensatorSettings
from friction_hil.motion.trajectory import PathTime, Trajectory, sine_path
from friction_hil.servo.config import Loops, Motor, ServoConfig, ServoMechanics, TrueFriction
from friction_hil.servo.parts import Load
from friction_hil.servo.servo import Servo

T = 1e-3
LEAD_S, SETPOINT_S = 1.8e-3, 2.5e-3
COUNT = 2.0 * math.pi / 2**20
J = 2e-4  # of both masses
LEVEL = 0.06  # of both frictions
CSP = 8


def friction(level, stiffness=2000.0):
    """LuGre with a falling part."""
    levels = {"coulomb": level, "static": 1.3 * level, "stribeck_velocity": 0.1, "damping_velocity": 0.1}
    bristles = {"sigma0": stiffness * level, "sigma1": 0.3 * math.sqrt(stiffness * level * J), "sigma2": 0.02 * level}
    return levels | bristles


@dataclass(frozen=True)
class Machine:
    """Two masses: resonance, ratio of load to motor, and the load's part of the friction."""

    hz: float
    damping: float
    ratio: float
    gap: float
    share: float

    @property
    def load_inertia(self):
        return J * self.ratio / (1.0 + self.ratio)

    @property
    def stiffness(self):
        reduced = self.load_inertia * (J - self.load_inertia) / J
        return reduced * (2.0 * math.pi * self.hz) ** 2

    def servo(self):
        """With loops as fast as the resonance allows."""
        bandwidth = min(2.0 * math.pi * self.hz / 4.0, 200.0)
        coupling = {
            "inertia": self.load_inertia,
            "stiffness": self.stiffness,
            "damping": 2.0 * self.damping * self.stiffness / (2.0 * math.pi * self.hz),
            "backlash": self.gap,
        }
        load = {"model": "lugre", "parameters": friction(LEVEL * self.share)}
        return ServoConfig(
            mechanics=ServoMechanics(
                inertia=J - self.load_inertia, load=Load(**coupling, friction=TrueFriction(**load))
            ),
            friction=TrueFriction(model="lugre", parameters=friction(LEVEL * (1.0 - self.share))),
            motor=Motor(rated_torque=10.0, peak_torque=30.0),
            loops=Loops(
                velocity_gain=bandwidth * J, position_gain=0.3 * bandwidth, integral_hz=0.05 * bandwidth / 6.28
            ),
            integration_hz=160_000,
        )


def errors(machine, motion, *, gain=0.9, believed=1.0, is_enabled=True, **known):
    """RMS of the error of motor and load, rad, over the second and the third period."""
    servo = Servo(machine.servo())
    servo.set_period(T)
    model = fh.models.create("lugre", **friction(believed * LEVEL))
    base = {"period_s": T, "position_resolution": COUNT, "torque_limit": 10.0, "lead_s": LEAD_S, "inertia": J}
    base |= {"setpoint_delay_s": SETPOINT_S, "fade_s": 0.1, "gain": gain, "velocity_limit": 100.0}
    unit = Compensator(model, CompensatorSettings(**base | known))
    time = PathTime(0.25)
    time.start(0.0)
    amplitude, hz = motion
    path = Trajectory(sine_path(amplitude, hz, 0.0), time)
    pending, rows = (0.0, 0.0), []
    servo.command(CSP, 0.0)
    for k in range(round(3.25 / hz / T)):
        now, ahead = path.at(k * T), path.at(k * T + LEAD_S)
        rows.append((now.position - servo.true_position, now.position - servo.load_position))
        feedback = (float(k), servo.position, servo.velocity, servo.torque)
        torque = unit.step(*feedback, now.position, now.velocity, ahead.velocity, True, is_enabled, ahead.acceleration)
        servo.command(CSP, pending[0], 0.0, pending[1])
        pending = (path.at(k * T + SETPOINT_S).position + unit.offset_sent[0], torque)
        servo.advance(round(T * servo.steps_per_second))
    scored = np.array(rows)[round(1.25 / hz / T) :]
    return np.sqrt(np.mean(scored**2, axis=0))


def coupling(machine, stiffness=1.0, share=1.0, gap=1.0):
    """What the model file says of a coupling, wrong by these factors."""
    return {
        "load_inertia": machine.load_inertia,
        "load_friction": share * machine.share * LEVEL,
        "stiffness": stiffness * machine.stiffness,
        "backlash": gap * machine.gap,
    }


machines = st.builds(
    Machine,
    hz=st.floats(30.0, 300.0),
    damping=st.floats(0.01, 0.1),
    ratio=st.floats(0.2, 10.0),
    gap=st.sampled_from([0.0, 1e-3, 3e-3]),
    share=st.floats(0.05, 0.8),
)
motions = st.tuples(st.floats(0.1, 0.4), st.sampled_from([0.5, 1.0, 2.0]))


@settings(max_examples=6, deadline=None, derandomize=True)
@given(machines, motions, st.floats(0.7, 1.1), st.booleans(), st.floats(0.5, 2.0))
def test_compensation_at_the_motor_makes_neither_motor_nor_load_worse(machine, motion, believed, is_known, stiffness):
    known = coupling(machine, stiffness) if is_known else {}
    without = errors(machine, motion, is_enabled=False)
    motor, load = errors(machine, motion, believed=believed, **known) / without
    assert motor < 1.0
    assert load < 1.0


@settings(max_examples=4, deadline=None, derandomize=True)
@given(machines, motions, st.floats(0.55, 1.5), st.floats(0.5, 1.5), st.floats(0.5, 1.5))
def test_the_offset_of_the_motor_makes_no_load_worse(machine, motion, stiffness, share, gap):
    """Each factor for itself: together, both wrong, they tell a twist of three times the true one."""
    wrong = ({"stiffness": stiffness}, {"share": share}, {"gap": gap})[round(10.0 * share) % 3]
    without = errors(machine, motion, is_enabled=False)
    offset = {"offset_acceleration": 300.0, "offset_limit": 0.1}
    _, load = errors(machine, motion, **coupling(machine, **wrong), **offset) / without
    assert load < 1.0


@pytest.mark.parametrize("share", [0.3, 0.7])
def test_a_known_coupling_lets_the_motor_follow_better(share):
    """The motor feels the friction of the load as it winds up the spring, and not at once."""
    machine = Machine(40.0, 0.03, 1.0, 0.0, share)
    rigid, _ = errors(machine, (0.2, 0.5), gain=1.0)
    wound_up, _ = errors(machine, (0.2, 0.5), gain=1.0, **coupling(machine))
    assert wound_up < 0.6 * rigid
