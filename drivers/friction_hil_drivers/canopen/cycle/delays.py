"""Delays of drives that take set-points at SYNC, in periods; the delays that the driver states are made of them."""

from friction_hil.drive import Mode

ACTUATION_CYCLES = 1.5  # sampled at one SYNC, in force from the next, for one period: by its middle
ACTUATION_ON_ARRIVAL_CYCLES = 1.0  # an RPDO that acts when it arrives comes within the period, and then acts for one
# from sending a set-point until the drive's demand equals it
SETPOINT_CYCLES = {Mode.CSP: 2.5, Mode.CSV: 2.0, Mode.CST: 1.5}
