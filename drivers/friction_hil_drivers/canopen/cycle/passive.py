"""Listening to drives that another master moves: its SYNC, their TPDOs as they are mapped; nothing is sent."""

import time
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

from friction_hil.drive import Clock, Command, Feedback
from friction_hil.errors import DriveError
from friction_hil_drivers.canopen import codes
from friction_hil_drivers.canopen.connect.heard_pdos import HeardPdos
from friction_hil_drivers.canopen.cycle.feedback_set import FeedbackSet
from friction_hil_drivers.canopen.cycle.health import NodeHealth
from friction_hil_drivers.canopen.cycle.listener import Listener
from friction_hil_drivers.cia402.codec import FeedbackDecoder, Measurement

if TYPE_CHECKING:
    from friction_hil_drivers.canopen.connect.configure import ConfiguredDrive
    from friction_hil_drivers.canopen.connect.listening import OtherMasters
    from friction_hil_drivers.canopen.connect.mapping import MappedPdo
    from friction_hil_drivers.canopen.cycle.axis import CanopenAxis
    from friction_hil_drivers.canopen.sdo.client import SdoClient
    from friction_hil_drivers.canopen.wire.frames import FrameBus

_HEAR_S = 1.0  # for every TPDO to come once, where another master decides when
_STEP_S = 0.05
_SYNCS = 50  # by which the rhythm is judged
_RESERVE_FRACTION = 0.25  # of the period, kept for computing


def _listen(
    bus: "FrameBus", others: "OtherMasters", identifiers: Collection[int], clock: Clock, sync_id: int
) -> HeardPdos:
    """Listen until every TPDO came and, where there is SYNC, for some of its periods; at most `_HEAR_S`."""
    heard = HeardPdos(sync_id)
    end = time.monotonic() + _HEAR_S
    while (left := end - time.monotonic()) > 0.0:
        is_enough = len(heard.stamps) > _SYNCS or not (clock.is_real and others.has_sync)
        if is_enough and all(others.has_heard(can_id) for can_id in identifiers):
            break
        if (frame := bus.receive(min(left, _STEP_S))) is not None:
            others.take(frame)
            heard.take(frame[0], len(frame[1]), clock.now_ns())
    return heard


def _rhythm_notes(heard: HeardPdos, name: str, node: int, tpdos: Sequence["MappedPdo"], period_s: float) -> list[str]:
    """Return what is unusual in the rhythm of SYNC and of the TPDOs of an axis.

    Raises `DriveError`: two nodes send a TPDO.
    """
    notes = []
    if problem := heard.wrong_period(period_s):
        text = f"SYNC of the other master {problem}: period_s must be the master's period [{codes.SYNC_UNUSABLE}]"
        notes.append(text)
    for pdo in tpdos:
        if not pdo.is_synchronous:
            continue
        heard.require_one_sender(pdo.cob_id, name, node)
        if (syncs := heard.syncs_between(pdo.cob_id)) > 1:
            text = f"TPDO {pdo.number + 1} ({pdo.cob_id:03X}h) comes with every {syncs}. SYNC only"
            notes.append(f"{text}: the cycles between have no fresh feedback")
    return notes


class PassiveAxis:
    """Feedback of one drive from TPDOs that come when another master wants them. No bus, no clock.

    Where they come with SYNC, a SYNC begins a new set, so that the values of a set are of one instant.
    """

    def __init__(self, drive: "ConfiguredDrive", node: int) -> None:
        self._is_synchronous = any(pdo.is_synchronous for pdo in drive.tpdos)
        self._decoder = FeedbackDecoder(drive.tpdos, drive.units, drive.mode, drive.period_s)
        self._health = NodeHealth(node, drive.error)
        names = [f"TPDO {pdo.number + 1}" for pdo in drive.tpdos]
        self._set = FeedbackSet(drive.tpdos, names, drive.mode, self._health)
        self._waiting: list[bytes] | None = None  # a complete set that was not reported yet
        self._measured = Measurement()
        self._measured_ns = 0  # time of the cycle of the last complete set
        self.handlers = self._set.handlers | self._health.handlers

    @property
    def is_complete(self) -> bool:
        """True once every TPDO of a set came."""
        return self._waiting is not None or self._set.is_complete

    def on_sync(self) -> None:
        """Begin a new set; one that is complete waits until it is reported."""
        if self._is_synchronous:
            self._take_over()
            self._set.begin()

    def _take_over(self) -> None:
        if self._set.is_complete:
            self._waiting = self._set.hand_over()

    def report(self, feedback: Feedback, cycle_ns: int) -> None:
        """Write the drive's feedback of the cycle that belongs to the time ``cycle_ns``."""
        self._take_over()
        frames, self._waiting = self._waiting, None
        feedback.is_fresh, feedback.missing = frames is not None, ""
        if frames is not None:
            elapsed_s = (cycle_ns - self._measured_ns) * 1e-9
            measured = self._measured = self._decoder.decode(frames, self._measured, elapsed_s)
            self._measured_ns = cycle_ns
            feedback.position, feedback.velocity = measured.position, measured.velocity
            feedback.torque, feedback.state = measured.torque, measured.state
        else:
            lost = self._set.wrong or f"{self._set.missing} of node {self._health.node} did not come"
            feedback.missing = f"{lost}: its master has stopped?"
        self._health.report(feedback)


class PassiveExchange(Listener):
    """The cyclic phase of a dry run beside another master; see `exchange.CyclicExchange`. Nothing is sent."""

    def __init__(
        self, bus: "FrameBus", axes: Sequence[PassiveAxis], clock: Clock, *, period_s: float, sync_id: int
    ) -> None:
        super().__init__(bus, clock, [*(axis.handlers for axis in axes), {sync_id: self._on_sync}], axes)
        self._axes = axes
        self._reserve_ns = round(_RESERVE_FRACTION * period_s * 1e9)

    def start(self) -> None:
        """Begin the cyclic phase: nothing is to be done for it."""

    def send(self, commands: Sequence[Command]) -> None:
        """Send nothing."""

    def warm_caches(self) -> None:
        """Do nothing: no deadline of another master is missed by a late listener."""

    def receive(self, feedback: Sequence[Feedback], end_ns: int) -> None:
        """Take what the drives have sent, and what they send until shortly before the end of the cycle.

        In simulated time the cycles are those of the other master.
        """
        self._take_waiting(self._bus.receive(0.0))
        self._collect(end_ns - self._reserve_ns)
        if not self._clock.is_real:
            is_complete = all(axis.is_complete for axis in self._axes)
            text = "not every drive has sent its TPDOs for {:g} s"
            self._require_frames(is_complete, text, codes.NOTHING_TO_HEAR)
        for axis, target in zip(self._axes, feedback, strict=True):
            axis.report(target, end_ns)

    def _on_sync(self, _: bytes) -> None:
        for axis in self._axes:
            axis.on_sync()


def passive_exchange(
    bus: "FrameBus",
    axes: Sequence["CanopenAxis"],
    clients: Mapping[str, "SdoClient"],
    others: "OtherMasters",
    clock: Clock,
    *,
    period_s: float,
    sync_id: int,
) -> PassiveExchange:
    """Return the exchange of a dry run beside another master, and add notes on what it sends to the axes.

    Raises `DriveError`: a TPDO does not come, or two nodes send it.
    """
    wanted = {pdo.cob_id: axis for axis in axes for pdo in axis.drive.tpdos}
    heard = _listen(bus, others, wanted, clock, sync_id)
    if silent := [can_id for can_id in wanted if not others.has_heard(can_id)]:
        listed = ", ".join(f"{can_id:03X}h" for can_id in silent)
        reason = f"no TPDO {listed} came within {_HEAR_S:g} s, as one that is sent only on a change may not"
        raise nothing_to_hear(clients[wanted[silent[0]].facts.name], others, reason)
    for axis in axes if clock.is_real else ():
        notes = _rhythm_notes(heard, axis.facts.name, axis.node, axis.drive.tpdos, period_s)
        axis.facts = replace(axis.facts, notes=(*axis.facts.notes, *notes))
    passive = [PassiveAxis(axis.drive, axis.node) for axis in axes]
    return PassiveExchange(bus, passive, clock, period_s=period_s, sync_id=sync_id)


def nothing_to_hear(client: "SdoClient", others: "OtherMasters", reason: str) -> DriveError:
    """Return why a dry run that must not write gets no feedback."""
    heard = others.words or "its power is on"
    text = (
        f"{client.axis}: {client.where} belongs to another master ({heard}), so nothing is written to it, and its "
        f"TPDOs as they are do not give the feedback: {reason.removeprefix(f'{client.axis}: ')}"
    )
    return DriveError(text, code=codes.NOTHING_TO_HEAR)
