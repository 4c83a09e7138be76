"""Other axes of the same machine that move in the recording of an axis: does its torque follow their motion? Pure.

An axis of a robot arm feels the acceleration, the weight and the position of the others, which a model of one axis does
not know. Methods that look for masses behind the motor take that torque for springs, gaps and losses.
"""

from collections.abc import Mapping

import numpy as np

from friction_hil.identification import coupling
from friction_hil.identification import thresholds as th
from friction_hil.identification.identify import Identification
from friction_hil.numerics.jit import Array
from friction_hil.recordings import Recording


def moving_beside(result: Identification, beside: Mapping[str, Mapping[str, Recording]]) -> str:
    """Return which other axes move the torque of this one, and what to do; empty if none does.

    What the chosen model leaves is regressed on the motion of this axis, and on that of the others too; what they
    explain more on blocks held out counts. ``beside``: recordings of the other axes, by the path of the recording and
    the name of the axis.
    """
    records = result.records
    residual = result.best.curves.residual
    is_rotary = result.settings.axis == "rotary"
    names = sorted(set.intersection(*(set(beside.get(each.path, {})) for each in records)))
    terms: dict[str, Array] = {}
    for name in names:
        parts = [coupling.terms(each, beside[each.path][name], "position", 1.0, is_rotary) for each in records]
        if all(part is not None for part in parts):
            terms[name] = np.concatenate([part for part in parts if part is not None])
    if not terms or any(len(each) != len(residual) for each in terms.values()):
        return ""
    curves = result.best.curves
    own = [curves.acceleration, curves.velocity, np.sign(curves.velocity)]
    own += [np.sin(curves.position), np.cos(curves.position)] if is_rotary else [curves.position]
    alone = np.column_stack(own)
    known = max(coupling.explained(alone, residual), 0.0)
    shares = {name: coupling.explained(np.hstack([alone, each]), residual) - known for name, each in terms.items()}
    together = coupling.explained(np.hstack([alone, *terms.values()]), residual) - known
    share = max(together, *shares.values())
    if share < th.BESIDE_TOLD:
        return ""
    named = sorted((name for name in shares if shares[name] >= th.BESIDE_TOLD), key=lambda name: -shares[name])
    moving = coupling.listed(named or list(terms))
    return (
        f"the motion of {moving} explains {100.0 * share:.0f} % of what the model leaves, on blocks held out, and may "
        f"be in its parameters too: hold {moving} still while this axis moves, as 'friction-hil tune' does"
    )
