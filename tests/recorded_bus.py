"""All frames on a udp_multicast bus, in the order in which the kernel got them, for the frame recorder."""

import contextlib
import socket
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import can

from tests.processes import listening
from tools.campaigns.frame_recorder import Frame

_RECEIVE_BUFFER = 8 << 20  # a whole run, while the processor is busy elsewhere
_SO_RCVBUFFORCE = 33  # Linux; beyond the limit of the system, for root
_SETTLE_S = 0.1


@contextlib.contextmanager
def recorded(configuration: Path) -> Iterator[list[Frame]]:
    """Record beside the processes; the list is complete, and sorted, when the context ends."""
    frames: list[Frame] = []
    is_over = threading.Event()
    with listening(configuration) as bus:
        _enlarge(bus)

        def read() -> None:
            end = None
            while end is None or time.monotonic() < end:
                if end is None and is_over.is_set():
                    end = time.monotonic() + _SETTLE_S  # others may go on sending for ever
                if (message := bus.recv(_SETTLE_S)) is not None:
                    data = bytes(message.data)
                    frames.append(Frame(message.timestamp, message.arbitration_id, data, message.is_remote_frame))

        thread = threading.Thread(target=read)
        thread.start()
        try:
            yield frames
        finally:
            is_over.set()
            thread.join()
    # the kernel stamps a datagram once, before it copies it to the sockets one after the other
    frames.sort(key=lambda frame: frame.time_s)


def _enlarge(bus: can.BusABC) -> None:
    with contextlib.suppress(PermissionError), socket.socket(fileno=bus.fileno()) as shared:
        try:
            shared.setsockopt(socket.SOL_SOCKET, _SO_RCVBUFFORCE, _RECEIVE_BUFFER)
        finally:
            shared.detach()
