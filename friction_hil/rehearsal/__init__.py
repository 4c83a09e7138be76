"""Rehearsal: the closed loop of daemon, compensator and a simulated servo, without a bus, in milliseconds."""

from friction_hil.rehearsal.rehearsal import Motion, Outcome, Rehearsal

__all__ = ["Motion", "Outcome", "Rehearsal"]
