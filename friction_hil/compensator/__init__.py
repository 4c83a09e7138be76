"""Friction compensator: measured and demanded motion, friction model, gain, limits, torque.

Pure: one compiled step over one state record, the same in the daemon and in replay.

`kernel` is the step, `records` its settings and state, `reference` the velocities that the model is given, `load` and
`temperature` the load torque and temperature that it is given, `transmission` the offset of the motor across gap and
twist, `prediction` how far the axis will deviate from its demand, `velocity` the velocity estimators, `limit_cycle` and
`adaptation` what changes the gain, `limiter` the bounds on torque and slew. `Compensator` holds all of it as an object.
`velocity_offset` gives the torque through the velocity loop of a drive that takes none.
README.md of this folder explains formulas and settings.
"""

from friction_hil.compensator.compensator import (
    INPUTS,
    Compensator,
    CompensatorInputs,
    CompensatorSettings,
    ThermalObserver,
)
from friction_hil.compensator.kernel import RESULTS, whole_step
from friction_hil.compensator.records import STATE
from friction_hil.compensator.reference import SOURCES

__all__ = [
    "INPUTS",
    "RESULTS",
    "SOURCES",
    "STATE",
    "Compensator",
    "CompensatorInputs",
    "CompensatorSettings",
    "ThermalObserver",
    "whole_step",
]
