"""Drives on a CAN bus, found and stopped without a configuration of axes.

Nothing here sends NMT, SYNC or a PDO, and nothing enables. `scan` and `show` only read; `stop` writes controlwords.
Reading makes the SDO transfers of another master with the same node fail, so a node is not read where they were heard.
Stopping does not wait for that.
"""

import contextlib
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from friction_hil.drive import DriveState
from friction_hil.drive.inventory import DriveEntry, Scan, Stop, StopReport
from friction_hil.errors import DriveError
from friction_hil_drivers.canopen import codes
from friction_hil_drivers.canopen.commands.description import describe, mode_name, mode_names
from friction_hil_drivers.canopen.connect import listening
from friction_hil_drivers.canopen.connect.twins import IDENTITY, SETTLE_S, SURE_REQUESTS, ask
from friction_hil_drivers.canopen.sdo.conversation import (
    FIRST_ANSWER_S,
    NODES,
    PATIENCE_S,
    Conversation,
    Pause,
    Script,
    device_types,
)
from friction_hil_drivers.canopen.sdo.dialogue import Upload
from friction_hil_drivers.canopen.stop.by_sdo import reset_axes, stop_axes, stop_drive
from friction_hil_drivers.canopen.wire import cia301
from friction_hil_drivers.canopen.wire.exclusive import AxisLock
from friction_hil_drivers.canopen.wire.interfaces import bus_name
from friction_hil_drivers.cia402 import objects, profile

if TYPE_CHECKING:
    from friction_hil.config import BusConfig
    from friction_hil_drivers.canopen.wire.frames import FrameBus

_ANSWER_S = 0.5
_ATTEMPTS = 2
_NO_MASTER = 0  # no heartbeat is ours


class CanopenInventory:
    """Nodes of one open bus, which `close` closes; see `friction_hil.drive.inventory.Inventory`.

    ``may_disturb``: read nodes of which another master uses the SDO server too.
    """

    def __init__(self, config: "BusConfig", bus: "FrameBus", *, may_disturb: bool = False) -> None:
        self._config = config
        self._bus = bus
        self._may_disturb = may_disturb
        self._others = listening.OtherMasters(NODES, _NO_MASTER, config.sync_cob_id)
        if bus.is_echoing:
            listening.count_sent(bus, self._others)
        listening.heard_by(bus, self._others, time.monotonic() + listening.LISTEN_S, time.monotonic)
        heard = self._others.words
        self.notes: tuple[str, ...] = (
            (f"another master is at work: {heard}; it may enable a drive again that is stopped",) if heard else ()
        )
        used = [str(node) for node in NODES if self._others.uses_sdo_of(node)]
        if used:
            text = f"its SDO transfers with node {', '.join(used)} may fail while nodes are asked here"
            self.notes = (*self.notes, f"{text}: each has one SDO server")

    def close(self) -> None:
        """See `friction_hil.drive.inventory.Inventory`."""
        self._bus.close()

    def scan(self) -> Scan:
        """Read identity, state and modes of every node; see `friction_hil.drive.inventory.Inventory`."""
        self._require_free_sdo(NODES)
        found = self._find(NODES, asking=self._before_reading)
        asked = self._talk(asking=self._before_reading).hold(
            {node: _identify(node, device, self._nmt_of(node)) for node, device in found.items()}
        )
        twins = self._twins(list(found))
        entries = [replace(entry, problem=str(twins.get(node, ""))) for node, entry in asked.items()]
        entries += [
            DriveEntry(node, answers=False, nmt=self._nmt_of(node))
            for node in self._others.heard_nodes
            if node not in found
        ]
        return Scan(tuple(sorted(entries, key=lambda entry: entry.node)), self.notes)

    def show(self, node: int) -> dict[str, Any]:
        """Read all that a drive says, unless two nodes answer; see `friction_hil.drive.inventory.Inventory`."""
        self._require_free_sdo([node])
        found = self._find([node], asking=self._before_reading)
        if node not in found:
            others = listening.those_that_answer(sorted(self._find(NODES, asking=self._before_reading)))
            heard = f", though its heartbeat says {nmt}" if (nmt := self._nmt_of(node)) else ""
            text = f"node {node} on {bus_name(self._config)} answers no SDO request{heard}; {others}"
            raise DriveError(text, code=codes.NODE_SILENT)
        self._refuse_twins([node])
        return self._talk(asking=self._before_reading).hold({node: describe(node, self._nmt_of(node))})[node]

    def meet(self, nodes: Sequence[int]) -> dict[int, DriveError | None]:
        """Ask nodes who they are, unless another master is at work.

        Return for each one that answers the refusal where two nodes have its number, else None.
        """
        if self._others.words:
            return {}
        found = self._find(nodes)
        self._talk().hold({node: ask(IDENTITY) for node in found})
        twins = self._twins(list(found))
        return {node: twins.get(node) for node in found}

    def stop(self, nodes: Sequence[int]) -> list[Stop]:
        """Stop drives, without numbers all that answer, side by side; see `friction_hil.drive.inventory.Inventory`."""
        asked = list(dict.fromkeys(nodes)) or sorted(self._find(NODES))
        if not asked:
            text = f"no node answers on {bus_name(self._config)}: it is not known whether a drive has power"
            raise DriveError(text, "check supply, wires and bit rate", codes.NODE_SILENT)
        owners = [text for node in asked if (text := self._owner(node))]
        self.notes = (*self.notes, *owners)
        stops = self._talk(PATIENCE_S / _ATTEMPTS).hold({node: stop_drive(node) for node in asked})
        return self._doubted([stop for each in stops.values() for stop in each])

    def stop_axes(self, axes: Mapping[str, tuple[int, int]]) -> StopReport:
        """Stop the drives of axes at once and side by side; ``axes``: node, and number of the axis in it, by name."""
        owners = [text for node in _nodes_of(axes) if (text := self._owner(node))]
        return StopReport(self._carry_out(axes, stop_axes), (*self.notes, *owners))

    def reset_axes(self, axes: Mapping[str, tuple[int, int]]) -> StopReport:
        """Reset the faults of the drives of axes, given as to `stop_axes`.

        Raises `DriveError`: a daemon of this machine, or another master, is at work, which could enable the drive as
        soon as it has no fault any more; or two nodes have one number.
        """
        with contextlib.ExitStack() as locks:  # until the end: no daemon may begin meanwhile
            for node in _nodes_of(axes):
                locks.callback(AxisLock(self._config, node, f"node {node}").release)
            if self._others.words:
                text = f"another master is at work on {bus_name(self._config)}: {self._others.words}"
                raise DriveError(text, "let it reset the fault, or stop it first", codes.SECOND_MASTER)
            self._refuse_twins(_nodes_of(axes))
            return StopReport(self._carry_out(axes, reset_axes), self.notes)

    def _carry_out(
        self, axes: Mapping[str, tuple[int, int]], script: "Callable[[int, Sequence[int]], Script[list[Stop]]]"
    ) -> tuple[Stop, ...]:
        """Run a script with each node; return its results in the order of the axes."""
        names: dict[int, dict[int, str]] = {}
        for name, (node, number) in axes.items():
            names.setdefault(node, {})[number] = name
        answers = self._talk(PATIENCE_S / _ATTEMPTS).hold(
            {node: script(node, list(numbers)) for node, numbers in names.items()}
        )
        found = {}
        for node, stops in answers.items():
            for (number, name), stop in zip(names[node].items(), stops, strict=True):
                which = f", axis {number + 1}" if number else ""
                found[name] = replace(stop, axis=name, address=f"node {node}{which} on {bus_name(self._config)}")
        return tuple(self._doubted([found[name] for name in axes]))

    def _talk(
        self,
        answer_s: float = _ANSWER_S,
        attempts: int = _ATTEMPTS,
        asking: "Callable[[int, bytes], None] | None" = None,
    ) -> Conversation:
        """Return a conversation, if not said otherwise with nodes that are known to answer."""
        asking = asking or self._others.requested
        return Conversation(self._bus, answer_s=answer_s, attempts=attempts, heard=self._others.take, asking=asking)

    def _require_free_sdo(self, nodes: Sequence[int]) -> None:
        """Raise a `DriveError` for a node whose only SDO server another master was heard to use."""
        used = [node for node in nodes if self._others.uses_sdo_of(node)]
        if used and not self._may_disturb:
            raise listening.would_disturb(used, bus_name(self._config), "or let it fail: --may-disturb")

    def _before_reading(self, can_id: int, data: bytes) -> None:
        """Note a request; stop reading a node as soon as another master is heard to ask it."""
        self._require_free_sdo([can_id - cia301.SDO_REQUEST_BASE])
        self._others.requested(can_id, data)

    def _twins(self, nodes: Sequence[int]) -> dict[int, DriveError]:
        """Return the refusal for each number that two nodes have, by their answers so far and further ones."""
        doubtful = [node for node in nodes if self._others.answers_of(node).is_doubtful]
        for node in doubtful:
            self._others.answers_of(node).begin()
        self._talk().hold({node: ask(SURE_REQUESTS) for node in doubtful})
        refusals = {node: self._others.answers_of(node).refusal(node, bus_name(self._config)) for node in doubtful}
        return {node: refusal for node, refusal in refusals.items() if refusal is not None}

    def _refuse_twins(self, nodes: Sequence[int]) -> None:
        """Ask nodes who they are, and raise a `DriveError` for a number that two of them have."""
        self._talk(asking=self._before_reading).hold({node: ask(IDENTITY) for node in nodes})
        for refusal in self._twins(nodes).values():
            raise refusal

    def _doubted(self, stops: Sequence[Stop]) -> list[Stop]:
        """Return the results of stops; which of two nodes with one number was read back is not known."""
        twins = self._twins(sorted({stop.node for stop in stops if stop.node is not None}))
        return [
            replace(stop, result="unknown", detail=twins[stop.node].detail) if stop.node in twins else stop
            for stop in stops
        ]

    def _nmt_of(self, node: int) -> str:
        """Return the state of a node in words, "" where no heartbeat was heard."""
        state = self._others.state_of(node)
        return "" if state is None else cia301.NMT_WORDS.get(state, str(state))

    def _find(
        self, nodes: Sequence[int], *, asking: "Callable[[int, bytes], None] | None" = None
    ) -> dict[int, int | None]:
        """Return the device type (None: it has none) of each node that answers."""
        return device_types(self._talk(FIRST_ANSWER_S, 1, asking), nodes)

    def _owner(self, node: int) -> str:
        """Return a text about the daemon of this machine that drives a node, "" for none."""
        try:
            AxisLock(self._config, node, f"node {node}").release()
        except DriveError as error:
            if error.code == codes.NODE_LOCKED:
                return f"{error.detail}: that daemon may enable it again; stop it too"
            return error.detail
        return ""


def _nodes_of(axes: Mapping[str, tuple[int, int]]) -> list[int]:
    return list(dict.fromkeys(node for node, _ in axes.values()))


def _identify(node: int, device: int | None, nmt: str) -> "Script[DriveEntry]":
    """Read what a scan shows of a node."""
    entries = (
        objects.DEVICE_NAME,
        objects.VENDOR_ID,
        objects.PRODUCT_CODE,
        objects.REVISION_NUMBER,
        objects.SERIAL_NUMBER,
        objects.STATUSWORD,
        objects.MODE_DISPLAY,
        objects.SUPPORTED_MODES,
    )
    name, vendor, product, revision, serial, status, mode, modes = uploads = [Upload(entry) for entry in entries]
    yield from uploads
    yield Pause(SETTLE_S)
    word = status.value
    state = DriveState.UNKNOWN if status.is_silent else None if word is None else profile.drive_state(word)
    return DriveEntry(
        node,
        answers=True,
        name=(name.data or b"").decode("latin-1").rstrip("\0 "),
        profile=None if device is None else device & 0xFFFF,
        vendor_id=vendor.value,
        product_code=product.value,
        revision=revision.value,
        serial=serial.value,
        nmt=nmt,
        state=state,
        mode="" if mode.value is None else mode_name(mode.value),
        modes=tuple(mode_names(modes.value or 0)),
    )
