"""udp_multicast of python-can alone, which otherwise also hears the other groups on its port."""

import os
import socket

import can

_IP_MULTICAST_ALL = 49  # Linux; `socket` has no name for it


def keep_to_own_group(bus: can.BusABC) -> None:
    """Let a bus on IPv4 receive only what was sent to its own group."""
    with socket.socket(fileno=os.dup(bus.fileno())) as shared:
        shared.setsockopt(socket.IPPROTO_IP, _IP_MULTICAST_ALL, 0)
