"""One drive that another controller moves: what was heard of it last, and its torque offset. No bus, no clock."""

import math
from collections.abc import Mapping
from functools import partial
from typing import NamedTuple

from friction_hil.drive import AxisFacts, DriveState, Feedback, Mode
from friction_hil.drive.codes import coded
from friction_hil.drive.encoder import derived_velocity, unwrap
from friction_hil_drivers.canopen import codes
from friction_hil_drivers.canopen.connect.mapping import MappedPdo
from friction_hil_drivers.canopen.connect.twins import TwinWatch
from friction_hil_drivers.canopen.cycle.axis import Handler
from friction_hil_drivers.canopen.sidecar.options import SidecarOptions, mapped
from friction_hil_drivers.canopen.wire import cia301
from friction_hil_drivers.canopen.wire.cia301 import Frame, NmtState, decode_heartbeat
from friction_hil_drivers.cia402 import objects, profile
from friction_hil_drivers.cia402.objects import Object
from friction_hil_drivers.cia402.profile import emergency_code, emergency_text
from friction_hil_drivers.cia402.units import COUNTER_BITS, DriveUnits

_MOST_ECHOES = 64  # under way; the others were lost
_ENABLE_MASK = 0x0F  # of the controlword: all four bits are set while the master wants Operation enabled


class _Heard(NamedTuple):
    """A PDO that is listened to."""

    pdo: MappedPdo
    size: int
    is_awaited: bool  # with every SYNC


class SidecarAxis:
    """State of one drive from cycle to cycle.

    A cycle is `begin_cycle`, the frames through `handlers`, `report`, `encode`, in this order. Frames between `report`
    and the next `begin_cycle` are those of the same cycle: the master's set-points, mostly.

    Parameters
    ----------
    facts : AxisFacts
    node : int
    mode : Mode
        Mode in which the master moves the drive.
    units : DriveUnits
    period_s : float
    options : SidecarOptions

    Attributes
    ----------
    handlers : mapping of int to callable
        By identifier: takes the data of a frame.
    is_complete : bool
        Every TPDO of this cycle that comes with SYNC has arrived.
    """

    def __init__(
        self, facts: AxisFacts, node: int, mode: Mode, units: DriveUnits, period_s: float, options: SidecarOptions
    ) -> None:
        self.facts, self.node = facts, node
        self._arguments = facts, node, mode, units, period_s, options
        self._mode, self._units, self._period_s = mode, units, period_s
        self._tpdos = [_heard(mapped(pdo), pdo.is_synchronous) for pdo in options.tpdos]
        self._rpdos = [_heard(mapped(pdo), is_awaited=False) for pdo in options.rpdos]
        self._offset = mapped(options.offset)
        self._awaited = frozenset(one.pdo.cob_id for one in self._tpdos if one.is_awaited)
        self._position_id = next(one.pdo.cob_id for one in self._tpdos if objects.POSITION_ACTUAL in one.pdo.entries)
        self._missing = set(self._awaited)
        self._early: set[int] = set()
        self._values: dict[Object, int] = {}  # raw, the latest of each object
        self._wrong = ""
        self._error = ""
        self._notices: list[str] = []
        self._echoes = 0  # of offsets that were sent, which the bus will deliver
        self._fault = ""
        self._twin = TwinWatch(node)
        self._counts: int | None = None
        self._velocity = 0.0
        self._cycle = 0  # of the last position
        self._stale = 0  # cycles since then in which somebody was there to hear it
        self._nmt_state: int | None = None  # as the last heartbeat has it
        self._demand: int | None = None  # of this cycle; None where none was heard
        self._demand_object = demand_object(options)
        self.is_complete = False
        self.handlers = self._make_handlers()

    def _make_handlers(self) -> Mapping[int, Handler]:
        handlers: dict[int, Handler] = {
            cia301.EMERGENCY_BASE + self.node: self._on_emergency,
            cia301.HEARTBEAT_BASE + self.node: self._on_heartbeat,
            self._offset.cob_id: self._on_offset,
        }
        handlers |= {one.pdo.cob_id: partial(self._on_tpdo, one) for one in self._tpdos}
        handlers |= {one.pdo.cob_id: partial(self._on_rpdo, one) for one in self._rpdos}
        return handlers

    @property
    def sizes(self) -> dict[int, int]:
        """Bytes of each PDO that is listened to, by identifier."""
        return {one.pdo.cob_id: one.size for one in (*self._tpdos, *self._rpdos)}

    @property
    def awaited(self) -> frozenset[int]:
        """Identifiers of the TPDOs that come with every SYNC."""
        return self._awaited

    @property
    def offset_id(self) -> int:
        """Identifier of the torque offset's RPDO."""
        return self._offset.cob_id

    @property
    def pdos(self) -> tuple[MappedPdo, ...]:
        """All PDOs of a cycle."""
        return (*(one.pdo for one in (*self._tpdos, *self._rpdos)), self._offset)

    def copy(self) -> "SidecarAxis":
        """Return another axis for the same drive, as it was before its first cycle."""
        return SidecarAxis(*self._arguments)

    def why_out_of_reach(self, most_missed: int) -> str:
        """Return why the drive cannot be expected to take an RPDO now, "" if it can."""
        if self._nmt_state not in (None, NmtState.OPERATIONAL):
            return f"node {self.node} is not Operational"
        if self._stale > most_missed:
            return f"node {self.node} has not been heard for {self._stale} periods"
        return ""

    def begin_cycle(self, *, has_early: bool = False) -> None:
        """Take the set-point heard so far as that of the cycle before, and wait for this cycle's TPDOs.

        Parameters
        ----------
        has_early : bool
            A second TPDO since the last call is the answer to this SYNC: in simulated time nobody sends two, but
            several processes on udp_multicast may be heard in another order than they sent.
        """
        # one that is not heard again is lost, or late: repeated, it would look like an axis that rests
        self._demand = self._values.pop(objects.TARGET_POSITION, None)
        if self._twin.is_suspected and (fault := self._twin.judge()):
            self._fault = self._fault or fault
        self._missing = set(self._awaited - self._early if has_early else self._awaited)
        self._early.clear()
        self.is_complete = not self._missing
        self._wrong = ""

    def report(self, feedback: Feedback, cycle: int) -> None:
        """Write what was heard of the drive; without this cycle's TPDOs the values stay as they were.

        ``cycle`` counts the SYNCs that were expected, those that nobody was there to hear too.
        """
        values = self._values
        is_fresh = self.is_complete
        self._stale = 0 if is_fresh else self._stale + 1
        if is_fresh:
            self._take_position(values[objects.POSITION_ACTUAL], cycle)
        counts = 0 if self._counts is None else self._counts
        feedback.position = counts / self._units.counts_per_unit
        feedback.velocity = self._velocity
        feedback.torque = self._units.torque(values.get(objects.TORQUE_ACTUAL, 0))
        statusword = values.get(objects.STATUSWORD)
        feedback.state = DriveState.UNKNOWN if statusword is None else profile.drive_state(statusword)
        feedback.is_fresh = is_fresh
        feedback.error, feedback.message = self._error, self._fault
        feedback.missing = "" if is_fresh else self._reason()
        feedback.position_demand = self._position_demand()
        feedback.is_offset_wanted = self._is_offset_wanted()
        if self._notices:
            feedback.notices.extend(self._notices)
            self._notices.clear()

    def encode(self, torque: float) -> Frame:
        """Encode a torque offset.

        Raises
        ------
        ValueError
            It is not finite.
        """
        return self._offset.cob_id, self._offset.layout.pack(self._units.torque_per_mille(torque))

    def sent(self) -> None:
        """Note that an offset was sent on a bus that will deliver it back."""
        self._echoes = min(self._echoes + 1, _MOST_ECHOES)

    # Frames

    def _on_offset(self, _: bytes) -> None:
        """Take a torque offset: the daemon's own, or a fault."""
        if self._echoes:
            self._echoes -= 1
        elif not self._fault:
            text = f"somebody else sends {self._offset.cob_id:03X}h, the torque offset of node {self.node}"
            self._fault = coded(text, codes.PDO_NOT_AS_STATED)

    def _on_rpdo(self, heard: _Heard, data: bytes) -> None:
        self._take_values(heard, data)

    def _take_values(self, heard: _Heard, data: bytes) -> bool:
        if len(data) != heard.size:
            text = f"{heard.pdo.cob_id:03X}h has {len(data)} bytes, but its entries {heard.size}"
            if not self._wrong:
                self._wrong = text
            return False
        self._values.update(zip(heard.pdo.entries, heard.pdo.layout.unpack(data), strict=True))
        return True

    def _on_tpdo(self, heard: _Heard, data: bytes) -> None:
        if self._take_values(heard, data):
            cob_id = heard.pdo.cob_id
            if cob_id in self._missing:
                self._missing.discard(cob_id)
            else:
                if heard.is_awaited:
                    self._twin.take(f"{cob_id:03X}h")
                self._early.add(cob_id)
            self.is_complete = not self._missing

    def _on_emergency(self, data: bytes) -> None:
        self._notices.append(f"node {self.node}: {emergency_text(data)}")
        if code := emergency_code(data):  # 0000h does not say why the drive was in fault
            self._error = profile.error_text(code)

    def _on_heartbeat(self, data: bytes) -> None:
        self._nmt_state = decode_heartbeat(data)
        if self._nmt_state == NmtState.BOOT_UP:
            self._notices.append(f"node {self.node} restarted (boot-up message)")

    # Values

    def _take_position(self, raw: int, cycle: int) -> None:
        """Follow the counter; the velocity is its difference, because the unit of 606Ch would have to be asked for."""
        before = self._counts
        self._counts = raw if before is None else unwrap(before, raw, COUNTER_BITS)
        if before is not None:
            way = (self._counts - before) / self._units.counts_per_unit
            elapsed_s = (cycle - self._cycle) * self._period_s
            self._velocity = derived_velocity(way, elapsed_s, self._velocity, self._period_s)
        self._cycle = cycle

    def _position_demand(self) -> float:
        """Return this cycle's set-point, near the position modulo the counter's range; NaN where none was heard."""
        demand = self._demand
        if self._demand_object is objects.POSITION_DEMAND:
            demand = self._values.pop(objects.POSITION_DEMAND, None)
        if self._demand_object is None or demand is None or self._counts is None:
            return math.nan
        return unwrap(self._counts, demand, COUNTER_BITS) / self._units.counts_per_unit

    def _is_offset_wanted(self) -> bool:
        """True if the mode is the configured one and the master wants the drive enabled, as far as either is heard."""
        mode = self._values.get(objects.MODE_DISPLAY, self._mode)
        controlword = self._values.get(objects.CONTROLWORD, _ENABLE_MASK)
        return mode == self._mode and controlword & _ENABLE_MASK == _ENABLE_MASK

    def _reason(self) -> str:
        """Return why the feedback of this cycle is not complete."""
        lost = " and ".join(f"{cob_id:03X}h" for cob_id in sorted(self._missing))
        return self._wrong or f"TPDO {lost} of node {self.node} did not come in time after SYNC"


def _heard(pdo: MappedPdo, is_awaited: bool) -> _Heard:
    return _Heard(pdo, pdo.layout.size, is_awaited)


def demand_object(options: SidecarOptions) -> Object | None:
    """Return the object from which the demand is taken: the master's set-point, else the drive's own demand."""
    if any(objects.TARGET_POSITION in mapped(pdo).entries for pdo in options.rpdos):
        return objects.TARGET_POSITION
    if any(objects.POSITION_DEMAND in mapped(pdo).entries for pdo in options.tpdos):
        return objects.POSITION_DEMAND
    return None
