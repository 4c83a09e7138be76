"""A node number that another simulation, or a drive, has on the bus already: two nodes would answer each request."""

import socket
import time
from collections.abc import Iterable
from typing import TYPE_CHECKING

from friction_hil.errors import BusError
from friction_hil_drivers.canopen import codes
from friction_hil_drivers.canopen.sdo.dialogue import Upload
from friction_hil_drivers.canopen.wire import cia301
from friction_hil_drivers.canopen.wire.interfaces import bus_name
from friction_hil_drivers.cia402 import objects
from friction_hil_drivers.simulated_name import claim

if TYPE_CHECKING:
    from friction_hil.config import BusConfig
    from friction_hil_drivers.canopen.wire.frames import FrameBus

_ANSWER_S = {"udp_multicast": 0.05}  # on this machine; simulations of friction_hil are found by their names
_ANSWER_ELSEWHERE_S = 0.3
_FIX = "end it, or give the axis another node"


class Presence:
    """Node numbers of one simulation on a bus, which no other process of this machine may simulate meanwhile.

    Raises `BusError`: another process simulates one of the nodes.
    """

    def __init__(self, config: "BusConfig", nodes: Iterable[int]) -> None:
        self._config = config
        self._nodes = tuple(nodes)
        self._asked_s = 0.0
        self._owners: list[socket.socket] = []
        for node in self._nodes:
            try:
                self._owners.append(claim(f"{bus_name(config)} node {node}".encode()))
            except OSError as error:
                self.release()
                text = f"node {node} on {bus_name(config)} is simulated by another process already"
                raise BusError(text, _FIX, codes.NODE_TAKEN) from error

    def ask(self, bus: "FrameBus") -> None:
        """Ask all nodes for their device type, which none of them is to answer."""
        for node in self._nodes:
            bus.send(cia301.SDO_REQUEST_BASE + node, Upload(objects.DEVICE_TYPE).first())
        self._asked_s = time.monotonic()

    def require_silence(self, bus: "FrameBus") -> None:
        """Wait for answers to `ask`; raises a `BusError` if a node answers."""
        end = self._asked_s + _ANSWER_S.get(self._config.interface, _ANSWER_ELSEWHERE_S)
        answers = {cia301.SDO_RESPONSE_BASE + node: node for node in self._nodes}
        while (frame := bus.receive(max(0.0, end - time.monotonic()))) is not None or time.monotonic() < end:
            if frame is not None and frame[0] in answers:
                text = f"node {answers[frame[0]]} on {bus_name(self._config)} answers already"
                raise BusError(f"{text}: a drive or another simulation has this number", _FIX, codes.NODE_TAKEN)

    def release(self) -> None:
        """Give the numbers back. Safe to call twice."""
        for owner in self._owners:
            owner.close()
        self._owners.clear()
