"""udp_multicast that hears its own group alone and, where that is meant, this machine alone.

python-can binds the port on every address. So a datagram arrives that was sent to the host's own address from anywhere,
or to another group with the same port; and its reader raises for a datagram that is no CAN frame.
"""

import contextlib
import ctypes
import os
import socket
import struct
import time
from typing import Any

import can
from can.interfaces.udp_multicast import UdpMulticastBus
from can.interfaces.udp_multicast.utils import unpack_message

_IP_MULTICAST_ALL, _IPV6_MULTICAST_ALL, _SO_ATTACH_FILTER = 49, 29, 26  # Linux; `socket` has no names for them
_MOST_SOURCES = 256  # addresses remembered

# Instructions of a classic BPF program (linux/filter.h): code, jump if true, jump if false, operand
_INSTRUCTION = struct.Struct("=HBBI")
_LOAD_WORD, _LOAD_HALF, _JUMP_IF_EQUAL, _RETURN = 0x20, 0x28, 0x15, 0x06
_SOURCE_PORT = 0  # offset in the UDP header, where a filter of a UDP socket begins to count
_NETWORK_HEADER = 0xFFF00000  # offset from which the IP header is read
_DESTINATION = {socket.AF_INET: (16,), socket.AF_INET6: (24, 28, 32, 36)}  # offsets of its words in the IP header
_WHOLE = 0xFFFFFFFF


def connected_to(group: str, port: int) -> socket.socket:
    """Return a socket that sends to a group alone; raises an `OSError` where multicast has no route."""
    family, _, _, _, address = socket.getaddrinfo(group, port, type=socket.SOCK_DGRAM)[0]
    sender = socket.socket(family, socket.SOCK_DGRAM)
    try:
        sender.connect(address)
    except OSError:
        sender.close()
        raise
    return sender


class LocalSources:
    """Addresses from which datagrams of this machine come to a multicast group."""

    def __init__(self, group: str, port: int) -> None:
        self._destination = group, port
        self._known: dict[str, bool] = {}

    def accepts(self, address: str) -> bool:
        """True for the address that this machine's sockets send to the group from, and for the loopback's."""
        is_local = self._known.get(address)
        if is_local is None:
            is_local = address.startswith("127.") or address == "::1" or address == self._own_address()
            if len(self._known) < _MOST_SOURCES:
                self._known[address] = is_local
        return is_local

    def _own_address(self) -> str | None:
        """Return the address that the routing table gives to datagrams for the group, None without a route."""
        try:
            with connected_to(*self._destination) as probe:
                return str(probe.getsockname()[0])
        except OSError:
            return None


class MulticastBus(UdpMulticastBus):
    """python-can's udp_multicast bus, for which a datagram that is no CAN frame, or comes from elsewhere, is nothing.

    Parameters are those of ``UdpMulticastBus``; with ``hop_limit`` 0 only this machine is heard.
    """

    def __init__(self, channel: str, port: int = 43113, hop_limit: int = 0, **further: Any) -> None:
        super().__init__(channel, port=port, hop_limit=hop_limit, **further)
        self._sources = LocalSources(channel, port) if hop_limit == 0 else None
        keep_to_group(self.fileno(), channel)

    def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
        end = None if timeout is None else time.monotonic() + timeout
        while (received := self._multicast.recv(timeout)) is not None:
            data, source, timestamp = received
            if self._sources is None or self._sources.accepts(str(source[0])):
                # a datagram that is no CAN frame: msgpack and python-can raise whatever its content leads to
                with contextlib.suppress(Exception):
                    message = unpack_message(data, replace={"timestamp": timestamp}, check=True)
                    if not message.is_fd and not message.is_extended_id:  # CANopen's identifiers have 11 bits
                        return message, False
            if end is not None:
                timeout = max(0.0, end - time.monotonic())
        return None, False


def deaf_sender(descriptor: int, group: str, port: int) -> socket.socket | None:
    """Return a socket that sends to a group on this machine, and let another one not hear what it sends.

    Without it, each frame of a process comes back to it and has to be read: a third of all that it reads. The kernel
    tells these by the port that they come from, which on one machine no other process has. None where it cannot.
    """
    try:
        sender = connected_to(group, port)
    except OSError:  # no route: sending reports it
        return None
    if sender.family == socket.AF_INET:
        sender.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, 0)
    else:
        sender.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_MULTICAST_HOPS, 0)
    sender.setblocking(False)
    if not keep_to_group(descriptor, group, without_port=sender.getsockname()[1]):
        sender.close()
        return None
    return sender


def keep_to_group(descriptor: int, group: str, without_port: int | None = None) -> bool:
    """Let a socket receive only what was sent to the group, where the operating system can do that.

    A filter in the kernel compares the destination of each datagram: it costs the reader nothing. It drops those from
    ``without_port``, too. Return True if it is in force.
    """
    is_filtered = False
    with socket.socket(fileno=os.dup(descriptor)) as sock:
        is_ipv4 = sock.family == socket.AF_INET
        program = _filter(socket.AddressFamily(sock.family), group, without_port)
        instructions = ctypes.create_string_buffer(program, len(program))
        # struct sock_fprog: number of instructions, and their address
        argument = struct.pack("@HP", len(program) // _INSTRUCTION.size, ctypes.addressof(instructions))
        with contextlib.suppress(OSError):  # other systems than Linux
            sock.setsockopt(socket.SOL_SOCKET, _SO_ATTACH_FILTER, argument)
            is_filtered = True
        with contextlib.suppress(OSError):
            if is_ipv4:
                sock.setsockopt(socket.IPPROTO_IP, _IP_MULTICAST_ALL, 0)
            else:
                sock.setsockopt(socket.IPPROTO_IPV6, _IPV6_MULTICAST_ALL, 0)
        with contextlib.suppress(OSError):  # what came for another group since the socket was bound
            while sock.recv(1, socket.MSG_DONTWAIT):
                pass
    return is_filtered


def _filter(family: socket.AddressFamily, group: str, without_port: int | None) -> bytes:
    """Return a BPF program that keeps the datagrams whose destination is ``group``, but none from a port."""
    offsets = _DESTINATION[family]
    words = struct.unpack(f"!{len(offsets)}I", socket.inet_pton(family, group))
    program = b""
    for left, (offset, word) in enumerate(zip(reversed(offsets), reversed(words), strict=True)):
        # a word that differs jumps over the pairs that follow and over "keep", to "drop"
        compare = _INSTRUCTION.pack(_JUMP_IF_EQUAL, 0, 2 * left + 1, word)
        program = _INSTRUCTION.pack(_LOAD_WORD, 0, 0, _NETWORK_HEADER + offset) + compare + program
    if without_port is not None:
        compare = _INSTRUCTION.pack(_JUMP_IF_EQUAL, len(program) // _INSTRUCTION.size + 1, 0, without_port)
        program = _INSTRUCTION.pack(_LOAD_HALF, 0, 0, _SOURCE_PORT) + compare + program
    keep, drop = _INSTRUCTION.pack(_RETURN, 0, 0, _WHOLE), _INSTRUCTION.pack(_RETURN, 0, 0, 0)
    return program + keep + drop
