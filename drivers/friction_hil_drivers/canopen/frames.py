"""Raw exchange of CAN frames: identifier and data, nothing else.

python-can opens the bus and serves every interface. A cycle of two axes moves some ten frames, and building a
``Message`` for each takes a third of a 1 ms period; so on the two interfaces whose frames have a documented
form, SocketCAN (``struct can_frame``) and udp_multicast (a msgpack map), they are read and written directly on
the bus's own socket.
"""

import os
import select
import socket
import struct
from typing import TYPE_CHECKING, Any

import can
import msgpack

from friction_hil.errors import BusError
from friction_hil_drivers.canopen import codes
from friction_hil_drivers.canopen.codec import Frame

if TYPE_CHECKING:
    from friction_hil.config import BusConfig

_SOCKETCAN_FRAME = struct.Struct("=IB3x8s")
_NO_DATA_FRAME = 0xE0000000  # extended, remote or error frame
_LONGEST_DATAGRAM = 2048


class FrameBus:
    """Data frames with 11-bit identifiers on an open python-can bus.

    Frames of other kinds are ignored. udp_multicast delivers a process's own frames to it as well.

    Parameters
    ----------
    bus : can.BusABC
        Open; `close` shuts it down.
    name : str
        For messages.
    """

    def __init__(self, bus: can.BusABC, name: str) -> None:
        self.bus = bus
        self._name = name

    def send(self, can_id: int, data: bytes | bytearray) -> None:
        """Send one frame.

        Raises
        ------
        BusError
            The bus cannot send.
        """
        try:
            self.bus.send(can.Message(arbitration_id=can_id, data=data, is_extended_id=False))
        except (can.CanError, OSError) as error:
            raise self._error("send", error) from error

    def receive(self, timeout: float) -> Frame | None:
        """Return the next frame, None after ``timeout`` seconds (or earlier, where something else arrived).

        Raises
        ------
        BusError
            The bus is gone.
        """
        try:
            message = self.bus.recv(timeout)
        except can.CanOperationError as error:
            if isinstance(error.__cause__, OSError):
                raise self._error("be read any more", error) from error
            return None  # a datagram that is no CAN frame
        if message is None or message.is_extended_id or message.is_remote_frame or message.is_error_frame:
            return None
        return message.arbitration_id, bytes(message.data)

    def close(self) -> None:
        """Shut the bus down."""
        self.bus.shutdown()

    def _error(self, verb: str, error: Exception) -> BusError:
        return BusError(f"the bus {self._name} cannot {verb}: {error}", code=codes.BUS_FAILED)


class _SocketBus(FrameBus):
    """A bus whose frames are read and written on its own socket."""

    def __init__(self, bus: can.BusABC, name: str) -> None:
        super().__init__(bus, name)
        # a second descriptor of the same socket: python-can keeps its own for configuration
        self._socket = socket.socket(fileno=os.dup(bus.fileno()))
        self._socket.setblocking(False)

    def receive(self, timeout: float) -> Frame | None:
        data = self._read()
        if data is None and timeout > 0.0 and select.select((self._socket,), (), (), timeout)[0]:
            data = self._read()
        return None if data is None else self._decode(data)

    def close(self) -> None:
        self._socket.close()
        super().close()

    def _read(self) -> bytes | None:
        """Return a datagram that has arrived, if any."""
        try:
            return self._socket.recv(_LONGEST_DATAGRAM)
        except BlockingIOError:
            return None
        except OSError as error:
            raise self._error("be read any more", error) from error

    def _decode(self, data: bytes) -> Frame | None:
        raise AssertionError("each kind of socket has its own")


class _SocketCan(_SocketBus):
    """Linux SocketCAN: ``struct can_frame`` of linux/can.h."""

    def send(self, can_id: int, data: bytes | bytearray) -> None:
        try:
            self._socket.send(_SOCKETCAN_FRAME.pack(can_id, len(data), data))
        except OSError as error:
            raise self._error("send", error) from error

    def _decode(self, data: bytes) -> Frame | None:
        if len(data) != _SOCKETCAN_FRAME.size:
            return None
        can_id, length, payload = _SOCKETCAN_FRAME.unpack(data)
        return None if can_id & _NO_DATA_FRAME else (can_id, payload[:length])


class _UdpMulticast(_SocketBus):
    """python-can's udp_multicast: each datagram a msgpack map with the fields of a message."""

    _UNREADABLE: Any = (ValueError, TypeError, KeyError, msgpack.exceptions.UnpackException)

    def __init__(self, bus: can.BusABC, name: str, destination: tuple[str, int]) -> None:
        super().__init__(bus, name)
        self._destination = destination
        self._pack = msgpack.Packer(use_bin_type=True, autoreset=True).pack
        self._unpack = msgpack.unpackb
        self._fields: dict[str, Any] = {
            "timestamp": 0.0,
            "arbitration_id": 0,
            "is_extended_id": False,
            "is_remote_frame": False,
            "is_error_frame": False,
            "channel": None,
            "dlc": 0,
            "data": b"",
            "is_fd": False,
            "bitrate_switch": False,
            "error_state_indicator": False,
        }

    def send(self, can_id: int, data: bytes | bytearray) -> None:
        fields = self._fields
        fields["arbitration_id"], fields["dlc"], fields["data"] = can_id, len(data), data
        try:
            self._socket.sendto(self._pack(fields), self._destination)
        except OSError as error:
            raise self._error("send", error) from error

    def _decode(self, data: bytes) -> Frame | None:
        try:
            fields = self._unpack(data)
            if fields["is_extended_id"] or fields["is_remote_frame"] or fields["is_error_frame"] or fields["is_fd"]:
                return None
            can_id, payload = fields["arbitration_id"], fields["data"]
        except self._UNREADABLE:
            return None  # a datagram that is no CAN frame
        is_frame = type(can_id) is int and 0 <= can_id <= 0x7FF and type(payload) is bytes and len(payload) <= 8
        return (can_id, payload) if is_frame else None


def frame_bus(bus: can.BusABC, config: "BusConfig", name: str) -> FrameBus:
    """Return the fastest `FrameBus` for an open bus."""
    if config.interface == "socketcan":
        return _SocketCan(bus, name)
    if config.interface == "udp_multicast" and config.port:  # python-can's own default port is not known here
        return _UdpMulticast(bus, name, (str(config.channel), config.port))
    return FrameBus(bus, name)
