"""The compensator: measured and demanded motion -> friction model -> gain, fading, limits -> torque.

Pure: one compiled step over one flat state record, the same in the daemon and in replay. `intent` says which
velocities feed the model and why, `limit_cycle` and `adaptation` what changes the gain, `kernel` is the step.
"""

from friction_hil.compensator.compensator import INPUTS, Compensator, CompensatorSettings, input_checksum
from friction_hil.compensator.intent import SOURCES
from friction_hil.compensator.kernel import STATE, step

__all__ = [
    "INPUTS",
    "SOURCES",
    "STATE",
    "Compensator",
    "CompensatorSettings",
    "input_checksum",
    "step",
]
