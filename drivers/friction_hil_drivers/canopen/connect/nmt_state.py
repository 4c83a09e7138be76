"""The NMT state in which a node is found, so that it can be left in it."""

import time
from collections.abc import Callable
from typing import TYPE_CHECKING

from friction_hil.drive.codes import coded
from friction_hil_drivers.canopen import codes
from friction_hil_drivers.canopen.connect.listening import OtherMasters, heard_by
from friction_hil_drivers.canopen.wire import cia301

if TYPE_CHECKING:
    from friction_hil_drivers.canopen.sdo.client import SdoClient
    from friction_hil_drivers.canopen.wire.frames import FrameBus

_PERIOD_MS = 10
_PATIENCE_S = 0.1
_STEP_S = 0.005


def ask_nmt_state(
    client: "SdoClient", bus: "FrameBus", others: OtherMasters, node: int, now: Callable[[], float] = time.monotonic
) -> None:
    """Let a node of which no heartbeat was heard send some (1017h), until ``others`` knows its state.

    Nothing is raised where the node has no heartbeat, or refuses: its state stays unknown then.
    """
    found = client.find(cia301.PRODUCER_HEARTBEAT)
    if found is None or not client.try_write(cia301.PRODUCER_HEARTBEAT, _PERIOD_MS):
        return
    end = now() + _PATIENCE_S
    while others.state_of(node) is None and (left := end - now()) > 0.0:
        heard_by(bus, others, now() + min(_STEP_S, left), now)
    client.try_write(cia301.PRODUCER_HEARTBEAT, found)


def unknown_nmt_state(node: int) -> str:
    """Return the message for a node whose NMT state could not be restored."""
    text = (
        f"node {node} is in Pre-operational now; whether it was Operational before is not known, because it sends no "
        "heartbeat: if its master expects it Operational, send NMT start"
    )
    return coded(text, codes.NMT_STATE_UNKNOWN)


def kept_out_of_operational(node: int) -> str:
    """Return the message for a node that is not started again, because it was not read back without power."""
    text = f"node {node} was Operational and stays Pre-operational: it was not read back without power"
    return coded(text, codes.NOT_RESTORED)
