"""Axes without a driver: those of a loop of the user's own, in which `friction_hil.Compensator` computes the torque.

They are written as axes of the driver `OWN_LOOP`, whose keys take the place of what a driver finds of its drive.
"""

from collections.abc import Iterable, Mapping
from typing import TYPE_CHECKING, Any, ClassVar

from pydantic import BaseModel

from friction_hil.checked_yaml.section import POSITION, Section, key
from friction_hil.drive.driver import Driver, OptionChecks

if TYPE_CHECKING:
    from friction_hil.config.axis import AxisConfig
    from friction_hil.config.bus import BusConfig

OWN_LOOP = "own_loop"
NOMINAL_PERIOD_S = 1e-3  # of a file without a period, which the program then gives: for checks of the file alone
# what an axis without a driver need not say: the loop's owner moves it, as a master would
DEFAULTS: Mapping[str, Any] = {"driver": OWN_LOOP, "mode": "csp", "trajectory": {"kind": "master"}}
REFUSAL = (
    "has no driver: its axes belong to a loop of your own, which calls friction_hil.Compensator; for this command give "
    "each axis a driver, and a bus where that needs one"
)


class OwnLoopOptions(OptionChecks, Section):
    """Keys of an axis without a driver."""

    position_resolution: float = key("smallest step of the measured position", POSITION, gt=0, le=1)
    delay_s: float | None = key(
        "time from reading the position until the torque of the same cycle acts; by default half a period",
        "s",
        default=None,
        ge=0,
        le=1,
    )
    has_torque: bool = key("the loop knows the torque of its motors: adaptation and kalman need it", default=True)

    @classmethod
    def check(cls, axes: "Mapping[str, AxisConfig]", bus: "BusConfig | None") -> Iterable[tuple[str, str, str]]:
        """Refuse a bus beside axes that have no driver for it."""
        return (
            (name, "driver", "is missing: there is a bus, on which a driver finds the drive") for name in axes if bus
        )


class OwnLoop(Driver):
    """Stand-in for a driver, of which nothing but its keys is used: it cannot be made."""

    Options: ClassVar[type[BaseModel]] = OwnLoopOptions


def without_driver(axis: Mapping[str, Any]) -> dict[str, Any]:
    """Return the plain values of an axis with the defaults of one that has no driver, if it has none."""
    return dict(axis) if axis.get("driver", OWN_LOOP) != OWN_LOOP else {**DEFAULTS, **axis}


def is_own_loop(document: Any) -> bool:
    """True for the plain values of a configuration none of whose axes has a driver."""
    axes = document.get("axes") if isinstance(document, dict) else None
    if not isinstance(axes, dict) or not axes:
        return False
    return all(isinstance(axis, dict) and axis.get("driver", OWN_LOOP) == OWN_LOOP for axis in axes.values())
