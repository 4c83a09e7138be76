"""Time of the simulated servo: rigid against plain C (``servo.c``); all parts, and two coupled axes, against rigid.

gcc compiles the C code at each run with -O3 -march=native. Figures are processor time of one integration step.
"""

import ctypes
import math
from collections.abc import Callable
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

from friction_hil.friction import describe
from friction_hil.numerics.jit import Array
from friction_hil.servo.config import ServoConfig
from friction_hil.servo.coupled_servos import CoupledServos
from friction_hil.servo.mechanisms import Link, TwoLinkArm
from friction_hil.servo.servo import Servo
from tools.benchmarks.c_library import COMMAND, load
from tools.benchmarks.models import Work, in_turns
from tools.benchmarks.report import Row, against, compare, note

SOURCE = Path(__file__).with_suffix(".c")
STEPS = 200_000
TORQUE = 0.2
CSP, CST = 8, 10
AXES = 8
PARTS_TARGET, CORE_TARGET = 3.0, 1.0

LUGRE: dict[str, Any] = {"model": "lugre", "parameters": dict(describe("lugre").example)}
HARMONICS = [{"order": 6, "cosine": 1e-3, "sine": 1e-3}]
TWO_MASSES: dict[str, Any] = {
    "mechanics": {
        "inertia": 1e-4,
        "load": {"inertia": 1e-4, "stiffness": 50.0, "damping": 5e-3, "backlash": 2e-3, "friction": LUGRE},
    }
}
ALL_PARTS: dict[str, Any] = {
    "mechanics": TWO_MASSES["mechanics"] | {"gravity": {"sine": 0.02}},
    "gear": {"forward_efficiency": 0.8, "backward_efficiency": 0.7, "hysteresis": {"torque": 0.01, "stiffness": 500.0}},
    "encoder": {"at": "both", "noise": 1e-6, "latency_s": 1e-4, "periodic_error": HARMONICS},
    "torque_feedback": {"noise": 1e-3},
    "motor": {"no_load_speed": 500.0, "torque_constant_error": 0.05},
    "loops": {"notch": {"frequency_hz": 160.0, "width_hz": 50.0}, "dead_time_s": 1.25e-4},
    "thermal": {
        "winding": {"capacity": 20.0, "resistance": 0.8, "loss": 12.0},
        "motor": {"capacity": 150.0, "resistance": 2.0},
    },
}
ARM = TwoLinkArm(
    kind="two_link_arm",
    axes=("shoulder", "elbow"),
    links=(Link(length=0.3, mass=0.01, center=0.15), Link(length=0.2, mass=0.005, center=0.1)),
)


class CServo:
    """The loop of ``servo.c`` for the default servo, compiled when it is created.

    Raises
    ------
    FrictionHilError
        gcc is not installed, or it failed.
    """

    def __init__(self) -> None:
        self._function = load(SOURCE).servo
        array = np.ctypeslib.ndpointer(np.float64, ndim=1, flags="C")
        self._function.argtypes = (array, ctypes.c_double, ctypes.c_long, array)
        self._function.restype = None
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
        self.state: Array = np.zeros(6)

    def advance(self, torque: float, steps: int) -> None:
        """Simulate; the first element of ``state`` is the position."""
        self._function(self._parameters, torque, steps, self.state)


def run() -> list[Row]:
    """Measure everything in turns.

    Raises
    ------
    FrictionHilError
        gcc is not installed, or it failed.
    """
    note(f"{' '.join(COMMAND)}; ns of processor time an integration step")
    plain = CServo()
    rigid = _servo({})

    def in_torque_mode() -> None:
        rigid.command(CST, TORQUE)
        rigid.advance(STEPS)

    work: dict[str, Work] = {
        "C": (STEPS, lambda: plain.advance(TORQUE, STEPS)),
        "torque": (STEPS, in_torque_mode),
        "rigid": (STEPS, _following({})),
        "two masses": (STEPS, _following(TWO_MASSES)),
        "all parts": (STEPS, _following(ALL_PARTS)),
        "arm": (STEPS, _moving(*_arm())),
    }
    times = in_turns(work, "servo")
    two_rigid = [2.0 * time for time in times["rigid"]]
    busy = AXES * ServoConfig().integration_hz * median(times["all parts"]) * 1e-9
    return [
        compare("rigid servo, torque mode (C)", "ns", times["torque"], times["C"]),
        compare(
            f"two masses, friction at both (rigid; target {PARTS_TARGET:g})", "ns", times["two masses"], times["rigid"]
        ),
        compare(f"all parts (rigid; target {PARTS_TARGET:g})", "ns", times["all parts"], times["rigid"]),
        compare(f"two-link arm, both axes (two rigid servos; target {PARTS_TARGET:g})", "ns", times["arm"], two_rigid),
        against(CORE_TARGET, f"{AXES} axes with all parts: share of one core in real time (target)", "1", busy),
    ]


def _servo(parts: dict[str, Any]) -> Servo:
    return Servo(ServoConfig.model_validate({"friction": LUGRE, **parts}))


def _arm() -> tuple[Servo, ...]:
    config = ServoConfig.model_validate({"friction": LUGRE})
    return CoupledServos(ARM, (config, config)).servos


def _following(parts: dict[str, Any]) -> Callable[[], None]:
    return _moving(_servo(parts))


def _moving(*servos: Servo) -> Callable[[], None]:
    """Return a function that lets servos follow a sine of positions over `STEPS` steps."""
    period = servos[0].steps_per_second // 1000
    targets = (0.3 * np.sin(np.arange(STEPS // period) * 6e-3)).tolist()

    def move() -> None:
        for target in targets:
            for servo in servos:
                servo.command(CSP, target)
            for servo in servos:
                servo.advance(period)

    return move
