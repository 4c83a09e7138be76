"""Experiments 7, stick-slip, and 8, hunting: a closed loop without and with compensation."""

from dataclasses import replace

import numpy as np

from friction_hil.friction import FrictionModel
from friction_hil.study.mass import PERIOD_S, ClosedLoop, run
from friction_hil.study.result import ExperimentResult, thin
from friction_hil.study.subjects import DEFAULT, StudySettings, matched, without_viscous

STICK_SLIP = ClosedLoop(mass=1.0, duration_s=40.0, spring=2.0, pull=0.1, demand=0.1)
HUNTING = ClosedLoop(mass=1.0, duration_s=100.0, pid=(3.0, 4.0, 6.0), target=1.0, demand=0.0)
STICK_SLIP_FROM_S = 20.0
HUNTING_FROM_S = 60.0
_STUCK = 1e-2  # of the pull
_MEAN = 50  # periods per mean velocity; a mean is used because a sticking mass may tremble


def stick_slip(name: str, assumed: str | None, given: StudySettings = DEFAULT) -> ExperimentResult:
    """Pull 1 kg at constant speed by a spring."""
    loop = replace(STICK_SLIP, mass=given.mass, spring=given.spring, pull=given.pull, demand=given.pull)
    position, velocity, *_ = run(matched(name, given.friction), loop, _assumed_model(assumed, given))
    time = PERIOD_S * np.arange(1, position.size + 1)
    late = slice(round(STICK_SLIP_FROM_S / PERIOD_S), None)
    mean = np.diff(position[late][::_MEAN]) / (_MEAN * PERIOD_S)
    facts = {
        "stuck_percent": 100.0 * float(np.mean(np.abs(mean) < _STUCK * given.pull)),
        "swing_mm_s": 1e3 * float(np.ptp(velocity[late])),
    }
    return ExperimentResult(facts, {"velocity": thin(time, velocity, 1200)})


def hunting(name: str, assumed: str | None, given: StudySettings = DEFAULT) -> ExperimentResult:
    """Move 1 kg to 1 m and hold it there by a PID controller."""
    loop = replace(HUNTING, mass=given.mass)
    position = run(matched(name, given.friction), loop, _assumed_model(assumed, given))[0]
    time = PERIOD_S * np.arange(1, position.size + 1)
    late = position[round(HUNTING_FROM_S / PERIOD_S) :]
    facts = {"swing_mm": 1e3 * float(np.ptp(late))}
    return ExperimentResult(facts, {"position": thin(time, position, 1200)})


def _assumed_model(name: str | None, given: StudySettings) -> FrictionModel | None:
    """Return the compensator's model: the same levels without viscous friction, which stays as damping of the mass."""
    return None if name is None else matched(name, without_viscous(given.friction))
