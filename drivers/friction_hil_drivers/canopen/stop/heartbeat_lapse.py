"""Lapse of the daemon's heartbeat, by which drives that nothing else reaches stop themselves. No bus, no clock."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from friction_hil.drive import DriveState

if TYPE_CHECKING:
    from friction_hil_drivers.canopen.cycle.axis import CanopenAxis

_SDO_NS = 200_000_000  # for the stop by SDO to be answered, before the heartbeat ends
_LAPSE_NS = 3_000_000_000  # after which the heartbeat ends in any case


class HeartbeatLapse:
    """Lapse of the daemon's heartbeat, the last means for a drive that may have power and that nothing else stops.

    All drives watch the same heartbeat: those in reach lose their power first, and a drive that answers SDO is left the
    time for its quick stop. After 3 s the heartbeat ends in any case.
    """

    __slots__ = ("_since_ns",)

    def __init__(self) -> None:
        self._since_ns: int | None = None  # a drive that may have power is out of reach since then

    def is_due(self, axes: "Sequence[CanopenAxis]", now_ns: int) -> bool:
        """Return True if the heartbeat is not to be sent."""
        lost = [axis for axis in axes if not axis.is_reachable and not axis.is_proved_unpowered]
        if not lost:
            self._since_ns = None
            return False
        if self._since_ns is None:
            self._since_ns = now_ns
        elapsed_ns = now_ns - self._since_ns
        if elapsed_ns <= _SDO_NS or elapsed_ns > _LAPSE_NS:
            return elapsed_ns > _LAPSE_NS
        is_answered = all(axis.state is not DriveState.UNKNOWN for axis in lost)
        return not is_answered and all(axis.is_proved_unpowered for axis in axes if axis.is_reachable)
