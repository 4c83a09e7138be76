"""Rehearsal: the closed loop of daemon, compensator and simulated servos, without a bus, in milliseconds."""

from friction_hil.rehearsal.rehearsal import Motion, Outcome, Rehearsal
from friction_hil.rehearsal.simulated_axes import SimulatedAxis, SimulatedMachine, simulated_machines
from friction_hil.rehearsal.together import AxisRun, rehearse

__all__ = [
    "AxisRun",
    "Motion",
    "Outcome",
    "Rehearsal",
    "SimulatedAxis",
    "SimulatedMachine",
    "rehearse",
    "simulated_machines",
]
