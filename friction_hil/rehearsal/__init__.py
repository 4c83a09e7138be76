"""Rehearsal: the closed loop of daemon, compensator and a simulated servo, without a bus, in milliseconds."""

from friction_hil.rehearsal.rehearsal import Motion, Outcome, Rehearsal
from friction_hil.rehearsal.simulated_axes import SimulatedAxis, simulated_axes

__all__ = ["Motion", "Outcome", "Rehearsal", "SimulatedAxis", "simulated_axes"]
