"""The compensator of n joints for a loop of the user's own: the daemon's kernel, limits and recording without its bus.

`compensator` is the object that the loop calls, `joints` what it makes of a configuration, `kernel` a cycle of all
joints, `faults` what is said of what goes wrong, `memory` and `recorder` the recording. README.md of this
folder says how it is used.
"""

from friction_hil.own_loop.compensator import Compensator

__all__ = ["Compensator"]
