"""Friction health: what changes in the friction of an axis over hours and months, without a claim why.

Each recording gives observations: Coulomb, viscous and break-away friction of each direction, asymmetry, lost motion,
ripple, and friction over the travel, with standard errors (`observe`). The first ones are the baseline; the effect of
temperature is removed, and CUSUM charts with a stated rate of false alarms show what has changed since (`judge`).

>>> import numpy as np
>>> import friction_hil as fh
>>> from friction_hil.health import Layout, Motion, Observation, Quantity
>>> rng = np.random.default_rng(1)
>>> levels = 0.2 + 0.01 * rng.normal(size=60) + 0.05 * (np.arange(60) >= 45)       # N m; a step after 45 days
>>> days = [Observation("x.mcap", 86400.0 * k, 60.0, 30.0, Motion(1.0, 2.0), {"coulomb.positive": Quantity(y, 0.01)})
...         for k, y in enumerate(levels)]
>>> health = fh.health.judge("x", days, Layout("rotary", (-1.0, 0.0, 1.0), ()))
>>> [(each.label, each.since_s / 86400.0) for each in health.changed]
[('Coulomb friction, positive direction', 45.0)]
"""

from friction_hil.health.judge import Health, Verdict, judge
from friction_hil.health.observation import Layout, Motion, Observation, Quantity, layout_of
from friction_hil.health.observe import observe
from friction_hil.health.thresholds import BASELINE, FALSE_ALARMS

__all__ = [
    "BASELINE",
    "FALSE_ALARMS",
    "Health",
    "Layout",
    "Motion",
    "Observation",
    "Quantity",
    "Verdict",
    "judge",
    "layout_of",
    "observe",
]
