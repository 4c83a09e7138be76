"""Experiments with a closed loop, without and with compensation: 7 stick-slip, 8 hunting."""

import numpy as np

from friction_hil.friction import FrictionModel
from friction_hil.study.mass import PERIOD_S, Loop, run
from friction_hil.study.outcome import Outcome, thin
from friction_hil.study.subjects import REFERENCE, matched, without_viscous

STICK_SLIP = Loop(mass=1.0, duration_s=40.0, spring=2.0, pull=0.1, demand=0.1)
HUNTING = Loop(mass=1.0, duration_s=100.0, pid=(3.0, 4.0, 6.0), target=1.0, demand=0.0)
STICK_SLIP_FROM_S = 20.0
HUNTING_FROM_S = 60.0
_STUCK = 1e-3  # m/s: a hundredth of the pull
_MEAN = 50  # periods of which the mean velocity is taken: a stuck mass may tremble


def stick_slip(name: str, believed: str | None) -> Outcome:
    """1 kg at the end of a spring that is pulled steadily."""
    position, velocity, *_ = run(matched(name, REFERENCE), STICK_SLIP, _believed(believed))
    time = PERIOD_S * np.arange(1, position.size + 1)
    late = slice(round(STICK_SLIP_FROM_S / PERIOD_S), None)
    mean = np.diff(position[late][::_MEAN]) / (_MEAN * PERIOD_S)
    facts = {
        "stuck_percent": 100.0 * float(np.mean(np.abs(mean) < _STUCK)),
        "swing_mm_s": 1e3 * float(np.ptp(velocity[late])),
    }
    return Outcome(facts, {"velocity": thin(time, velocity, 1200)})


def hunting(name: str, believed: str | None) -> Outcome:
    """1 kg that a PID controller with integral action brings to 1 m, and is to keep there."""
    position = run(matched(name, REFERENCE), HUNTING, _believed(believed))[0]
    time = PERIOD_S * np.arange(1, position.size + 1)
    late = position[round(HUNTING_FROM_S / PERIOD_S) :]
    facts = {"swing_mm": 1e3 * float(np.ptp(late))}
    return Outcome(facts, {"position": thin(time, position, 1200)})


def _believed(name: str | None) -> FrictionModel | None:
    """What the compensator believes: the same levels, but the viscous damping is left to the mass."""
    return None if name is None else matched(name, without_viscous(REFERENCE))
