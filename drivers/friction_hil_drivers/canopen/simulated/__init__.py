"""Simulated CiA 402 drives: real CANopen nodes around simulated servos."""

from friction_hil_drivers.canopen.simulated.drives import SimulatedCanopenDrives

__all__ = ["SimulatedCanopenDrives"]
