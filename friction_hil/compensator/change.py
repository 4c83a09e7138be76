"""Change of the settings of a compensator between two cycles; the loop and replay make it in the same way."""

import numpy as np

from friction_hil.compensator import adaptation
from friction_hil.compensator.bridge import BEGINNING
from friction_hil.numerics.jit import Array, StructuredArray


def carry_over(old: StructuredArray, new: StructuredArray, state: StructuredArray, friction: Array | None) -> None:
    """Adapt the state of a compensator to new settings.

    The estimate of the motion and the fades go on. What adaptation has learned goes on as long as it belongs to the
    model and adaptation stays on. With another model, its own state takes the place of the former model's, and the gain
    that limit cycles have lowered is whole again. The temperature goes on where both models depend on it.

    ``old`` and ``new`` are settings, ``state`` is changed. ``friction``, (n,): state in which another model begins;
    None: the model stays.
    """
    r, before, after = state[0], old[0], new[0]
    r["bridge"]["left"] = BEGINNING
    if friction is not None or after["adaptation_s"] == 0.0:
        adaptation.begin(r["adaptation"], after["level"])
    if friction is None:
        return
    r["friction"] = 0.0
    r["friction"][: friction.size] = friction
    r["limit_cycle"]["gain_factor"] = 1.0
    r["limit_cycle"]["alternations"] = 0.0
    if not (np.isfinite(r["temperature"]["given"]) and np.isfinite(after["reference_temperature"])):
        r["temperature"]["given"] = after["reference_temperature"]
    if not before["heat_capacity"] > 0.0:
        r["temperature"]["body"] = after["first_temperature"]
