"""Torque that depends on the position (cogging, eccentric gears) as large as friction: found over all of the travel.

The sweeps of an experiment stay near its middle. Over a fraction of a revolution, orders look alike, and low ones look
like an offset, so that what is extrapolated to the rest of the travel has another phase there. The run of the trial
without compensation goes through the positions of the own motion. Where the harmonics that stand out of a plain fit to
both are large, every model is fitted to both, with these orders. Pure.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from friction_hil import friction as models
from friction_hil.identification import IdentificationSettings, identify
from friction_hil.identification.data import Data
from friction_hil.identification.modifiers import ripple_orders
from friction_hil.recordings import Recording
from friction_hil.tuning import thresholds as th


@dataclass(frozen=True, slots=True, eq=False)
class PositionTorque:
    """Orders of the torque that depends on the position, and the recordings that show all positions."""

    orders: tuple[float, ...]  # per revolution or per metre, largest first
    recordings: tuple[Recording, ...]  # without compensation, beside those of the experiment

    @property
    def text(self) -> str:
        """What was found."""
        orders = ", ".join(f"{each:g}" for each in self.orders)
        return f"torque of orders {orders} over the position is as large as friction: identified over all of the motion"


def large_position_torque(
    slow: Sequence[Recording],  # slow sweeps of the experiment
    settings: IdentificationSettings,  # for models without presliding
    own: Recording,  # motion of the axis without compensation, with a torque
) -> PositionTorque | None:
    """Return the harmonics of the position if they are comparable with the friction, else None.

    Raises `RecordingError`: the axis hardly slides.
    """
    plain = replace(settings, families=("coulomb",), has_modifiers=False, refine=False)
    found = identify([*slow, own], plain)
    orders = ripple_orders(Data(list(found.records)), found.best.estimate, found.best.structure)
    if not orders:
        return None
    values = identify([*slow, own], replace(plain, orders=tuple(orders))).best.values
    squares = (values.get(f"ripple[{i}].{part}", 0.0) ** 2 for i in range(len(orders)) for part in ("cosine", "sine"))
    levels = [value for name, value in values.items() if name.endswith("coulomb")]
    is_large = math.sqrt(0.5 * math.fsum(squares)) >= th.AS_LARGE * sum(levels) / len(levels)
    return PositionTorque(tuple(orders), (own,)) if is_large else None


@dataclass(frozen=True, slots=True)
class PositionShare:
    """What of a model depends on the position."""

    orders: tuple[float, ...]  # per revolution or per metre
    rms: float  # over the positions, N m or N
    level: float  # of the friction, N m or N

    def text(self, unit: str) -> str:
        """What it is, and what its phase needs."""
        orders = ", ".join(f"{each:g}" for each in self.orders)
        share = 100.0 * self.rms / self.level
        return (
            f"torque over the position, orders {orders}: {self.rms:.3g} {unit} RMS, {share:.2g} % of friction; "
            "its phase is that of the positions of the drive: with an incremental encoder, home the axis after each "
            "power-on, or take 'ripple' out of the model"
        )


def position_share(model: Mapping[str, Any]) -> PositionShare | None:
    """Return what of a model file, as plain values, depends on the position; None if nothing does."""
    friction = model["friction"]
    harmonics = friction.get("modifiers", {}).get("ripple", [])
    squares = math.fsum(each.get(part, 0.0) ** 2 for each in harmonics for part in ("cosine", "sine"))
    if not squares:
        return None
    level = models.create(
        friction["model"], modifiers=friction["modifiers"], axis=model["axis"], **friction["parameters"]
    ).level
    return PositionShare(tuple(each["order"] for each in harmonics), math.sqrt(0.5 * squares), level)
