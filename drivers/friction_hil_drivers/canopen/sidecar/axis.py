"""One drive that another controller moves: what was heard of it last, and its torque offset. No bus, no clock."""

import math
from dataclasses import replace
from functools import partial

from friction_hil.drive import AxisFacts, Feedback, Mode
from friction_hil.drive.codes import coded
from friction_hil.drive.encoder import unwrap
from friction_hil_drivers.canopen import codes
from friction_hil_drivers.canopen.connect.mapping import MappedPdo
from friction_hil_drivers.canopen.cycle.feedback_set import FeedbackSet
from friction_hil_drivers.canopen.cycle.health import Handler, NodeHealth
from friction_hil_drivers.canopen.sidecar.options import SidecarOptions, mapped
from friction_hil_drivers.canopen.wire.cia301 import Frame, NmtState
from friction_hil_drivers.cia402 import objects
from friction_hil_drivers.cia402.codec import FeedbackDecoder, Measurement
from friction_hil_drivers.cia402.objects import Object
from friction_hil_drivers.cia402.units import COUNTER_BITS, DriveUnits

_MOST_ECHOES = 64  # under way; the others were lost
_ENABLE_MASK = 0x0F  # of the controlword: all four bits are set while the master wants Operation enabled


class SidecarAxis:
    """State of one drive from cycle to cycle.

    A cycle is `begin_cycle`, the frames through `handlers`, `report`, `encode`, in this order. Frames between `report`
    and the next `begin_cycle` are those of the same cycle: the master's set-points, mostly. ``mode``: in which the
    master moves the drive.
    """

    def __init__(
        self, facts: AxisFacts, node: int, mode: Mode, units: DriveUnits, period_s: float, options: SidecarOptions
    ) -> None:
        self.facts, self.node = facts, node
        self._arguments = facts, node, mode, units, period_s, options
        self._mode, self._units, self._period_s = mode, units, period_s
        self._tpdos = [replace(mapped(pdo), is_synchronous=pdo.is_synchronous) for pdo in options.tpdos]
        self._rpdos = [mapped(pdo) for pdo in options.rpdos]
        self._offset = mapped(options.offset)
        self._health = NodeHealth(node)
        self.feedback = FeedbackSet(self._tpdos, [f"{pdo.cob_id:03X}h" for pdo in self._tpdos], mode, self._health)
        self._decoder = FeedbackDecoder(self._tpdos, units, mode, period_s)
        self._measured = Measurement()
        self._cycle = 0  # of the last position
        self._stale = 0  # cycles since then in which somebody was there to hear it
        self._echoes = 0  # of offsets that were sent, which the bus will deliver
        self._commanded: dict[Object, int] = {}  # by the master: raw, the latest of each object
        self._demand: int | None = None  # of this cycle; None where none was heard
        self._demand_object = demand_object(options)
        self.handlers = self._make_handlers()

    def _make_handlers(self) -> dict[int, Handler]:
        handlers = self._health.handlers | self.feedback.handlers | {self._offset.cob_id: self._on_offset}
        return handlers | {pdo.cob_id: partial(self._on_rpdo, pdo) for pdo in self._rpdos}

    @property
    def sizes(self) -> dict[int, int]:
        """Bytes of each PDO that is listened to, by identifier."""
        return {pdo.cob_id: pdo.layout.size for pdo in (*self._tpdos, *self._rpdos)}

    @property
    def awaited(self) -> frozenset[int]:
        """Identifiers of the TPDOs that come with every SYNC."""
        return frozenset(pdo.cob_id for pdo in self._tpdos if pdo.is_synchronous)

    @property
    def offset_id(self) -> int:
        """Identifier of the torque offset's RPDO."""
        return self._offset.cob_id

    @property
    def pdos(self) -> tuple[MappedPdo, ...]:
        """All PDOs of a cycle."""
        return (*self._tpdos, *self._rpdos, self._offset)

    def copy(self) -> "SidecarAxis":
        """Return another axis for the same drive, as it was before its first cycle."""
        return SidecarAxis(*self._arguments)

    def why_out_of_reach(self, most_missed: int) -> str:
        """Return why the drive cannot be expected to take an RPDO now, "" if it can."""
        if self._health.nmt_state not in (None, NmtState.OPERATIONAL):
            return f"node {self.node} is not Operational"
        if self._stale > most_missed:
            return f"node {self.node} has not been heard for {self._stale} periods"
        return ""

    def begin_cycle(self, *, has_early: bool = False) -> None:
        """Take the set-point heard so far as that of the cycle before, and wait for this cycle's TPDOs.

        ``has_early``: a second TPDO since the last call is the answer to this SYNC: in simulated time nobody sends two,
        but several processes on udp_multicast may be heard in another order than they sent.
        """
        # one that is not heard again is lost, or late: repeated, it would look like an axis that rests
        self._demand = self._commanded.pop(objects.TARGET_POSITION, None)
        self.feedback.begin(has_early=has_early)

    def report(self, feedback: Feedback, cycle: int) -> None:
        """Write what was heard of the drive; without this cycle's TPDOs position and velocity stay as they were.

        ``cycle`` counts the SYNCs that were expected, those that nobody was there to hear too. The velocity is derived
        from the position, because the unit of 606Ch would have to be asked for.
        """
        is_fresh, before = self.feedback.is_complete, self._measured
        elapsed_s = (cycle - self._cycle) * self._period_s
        measured = self._decoder.decode(self.feedback.frames, before, elapsed_s)
        if is_fresh:
            self._stale, self._cycle = 0, cycle
        else:
            self._stale += 1
            measured = measured._replace(counts=before.counts, position=before.position, velocity=before.velocity)
        self._measured = measured
        feedback.position, feedback.velocity = measured.position, measured.velocity
        feedback.torque, feedback.state = measured.torque, measured.state
        feedback.is_fresh = is_fresh
        feedback.missing = "" if is_fresh else self._why_missing()
        feedback.position_demand = self._position_demand()
        is_enable = self._commanded.get(objects.CONTROLWORD, _ENABLE_MASK) & _ENABLE_MASK == _ENABLE_MASK
        feedback.is_offset_wanted = is_enable and measured.mode == self._mode  # as far as either is heard
        self._health.report(feedback)

    def encode(self, torque: float) -> Frame:
        """Encode a torque offset. Raises `ValueError`: it is not finite."""
        return self._offset.cob_id, self._offset.layout.pack(self._units.torque_per_mille(torque))

    def sent(self) -> None:
        """Note that an offset was sent on a bus that will deliver it back."""
        self._echoes = min(self._echoes + 1, _MOST_ECHOES)

    def _on_offset(self, _: bytes) -> None:
        """Take a torque offset: the daemon's own, or a fault."""
        if self._echoes:
            self._echoes -= 1
            return
        text = f"somebody else sends {self._offset.cob_id:03X}h, the torque offset of node {self.node}"
        self._health.note_fault(coded(text, codes.PDO_NOT_AS_STATED))

    def _on_rpdo(self, pdo: MappedPdo, data: bytes) -> None:
        if len(data) == pdo.layout.size:
            self._commanded.update(zip(pdo.entries, pdo.layout.unpack(data), strict=True))
        else:
            self.feedback.note_wrong(f"{pdo.cob_id:03X}h", len(data), pdo.layout.size)

    def _position_demand(self) -> float:
        """Return this cycle's set-point, near the position modulo the counter's range; NaN where none was heard."""
        demand, counts = self._demand, self._measured.counts
        if self._demand_object is objects.POSITION_DEMAND:
            demand = self.feedback.value(objects.POSITION_DEMAND)
        if self._demand_object is None or demand is None or counts is None:
            return math.nan
        return unwrap(counts, demand, COUNTER_BITS) / self._units.counts_per_unit

    def _why_missing(self) -> str:
        """Return why the feedback of this cycle is not complete."""
        lost = f"TPDO {self.feedback.missing} of node {self.node} did not come in time after SYNC"
        return self.feedback.wrong or lost


def demand_object(options: SidecarOptions) -> Object | None:
    """Return the object from which the demand is taken: the master's set-point, else the drive's own demand."""
    if any(objects.TARGET_POSITION in mapped(pdo).entries for pdo in options.rpdos):
        return objects.TARGET_POSITION
    if any(objects.POSITION_DEMAND in mapped(pdo).entries for pdo in options.tpdos):
        return objects.POSITION_DEMAND
    return None
