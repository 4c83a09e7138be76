"""Raw exchange of CAN frames: identifier and data, nothing else.

python-can opens the bus and serves every interface. A cycle of two axes moves some ten frames, and building a
``Message`` for each takes a third of a 1 ms period; so on the two interfaces whose frames have a documented
form, SocketCAN (``struct can_frame``) and udp_multicast (a msgpack map), they are read and written directly on
the bus's own socket.
"""

import errno
import os
import select
import socket
import struct
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import can
import msgpack

from friction_hil.errors import BusError
from friction_hil_drivers.canopen import codes
from friction_hil_drivers.canopen.wire.cia301 import Frame
from friction_hil_drivers.canopen.wire.multicast import LocalSources, MulticastBus, deaf_sender
from friction_hil_drivers.canopen.wire.queue_full import QueueFullError

if TYPE_CHECKING:
    from friction_hil.config import BusConfig

_SOCKETCAN_FRAME = struct.Struct("=IB3x8s")
_NO_DATA_FRAME = 0xE0000000  # extended, remote or error frame
_REMOTE_FLAG, _IDENTIFIER = 0x40000000, 0x7FF
_LONGEST_DATAGRAM = 2048
_LONGEST_DRAIN_S = 0.1  # spent on frames of other kinds before `receive` returns
_NOTHING = b""  # in place of a datagram that is not for this bus: no frame
_QUEUE_FULL = (errno.ENOBUFS, errno.EAGAIN)


class FrameBus:
    """Data frames with 11-bit identifiers on an open python-can bus, which `close` shuts down.

    Frames of other kinds are passed over. ``name`` is for messages.
    """

    def __init__(self, bus: can.BusABC, name: str) -> None:
        self.bus = bus
        self._name = name
        # called by `receive` with identifier and length of each remote frame; None: these are passed over too
        self.on_remote: Callable[[int, int], None] | None = None
        self.is_echoing = False  # the bus delivers the frames of this process to it as well

    def send(self, can_id: int, data: bytes | bytearray) -> None:
        """Send one data frame; raises a `QueueFullError`, or a `BusError` if the bus cannot send at all."""
        self._send_message(can.Message(arbitration_id=can_id, data=data, is_extended_id=False))

    def send_remote(self, can_id: int, length: int) -> None:
        """Send one remote frame, which asks for a data frame of ``length`` bytes; raises as `send`."""
        message = can.Message(arbitration_id=can_id, is_extended_id=False, is_remote_frame=True, dlc=length)
        self._send_message(message)

    def _send_message(self, message: can.Message) -> None:
        try:
            self.bus.send(message)
        except (can.CanError, OSError) as error:
            raise self._send_error(error) from error

    def receive(self, timeout: float) -> Frame | None:
        """Return the next data frame, None if none is waiting after ``timeout`` s; a `BusError`: the bus is gone."""
        now = time.monotonic()
        end, give_up = now + timeout, now + max(timeout, _LONGEST_DRAIN_S)
        while True:
            try:
                message = self.bus.recv(timeout)
            except can.CanOperationError as error:
                if isinstance(error.__cause__, OSError):
                    raise self._error("be read any more", error) from error
                message = can.Message(is_error_frame=True)  # a datagram that is no CAN frame
            if message is None:
                return None
            if not (message.is_extended_id or message.is_error_frame or message.is_fd):
                if not message.is_remote_frame:
                    return message.arbitration_id, bytes(message.data)
                self._on_remote_frame(message.arbitration_id, message.dlc)
            now = time.monotonic()
            if now > give_up:
                return None
            timeout = max(0.0, end - now)

    def close(self) -> None:
        """Shut the bus down."""
        self.bus.shutdown()

    def _on_remote_frame(self, can_id: int, length: int) -> None:
        if self.on_remote is not None:
            self.on_remote(can_id, length)

    def _send_error(self, error: Exception) -> BusError:
        cause = error if isinstance(error, OSError) else error.__cause__
        number = cause.errno if isinstance(cause, OSError) else getattr(error, "error_code", None)
        kind = QueueFullError if number in _QUEUE_FULL else BusError
        return self._error("send", error, kind)

    def _error(self, verb: str, error: Exception, kind: type[BusError] = BusError) -> BusError:
        return kind(f"the bus {self._name} cannot {verb}: {error}", code=codes.BUS_FAILED)


class _SocketBus(FrameBus):
    """A bus whose frames are read and written on its own socket."""

    def __init__(self, bus: can.BusABC, name: str) -> None:
        super().__init__(bus, name)
        # a second descriptor of the same socket: python-can keeps its own for configuration
        self._socket = socket.socket(fileno=os.dup(bus.fileno()))
        self._socket.setblocking(False)

    def receive(self, timeout: float) -> Frame | None:
        data = self._read()
        if data is None:
            return self._wait(timeout) if timeout > 0.0 else None
        frame = self._decode(data)
        return self._wait(timeout) if frame is None else frame  # a frame of another kind: more may be waiting

    def _wait(self, timeout: float) -> Frame | None:
        """Return the next data frame, None after ``timeout`` with nothing more waiting."""
        now = time.monotonic()
        end, give_up = now + timeout, now + max(timeout, _LONGEST_DRAIN_S)
        while select.select((self._socket,), (), (), max(0.0, end - now))[0]:
            data = self._read()
            frame = None if data is None else self._decode(data)
            if frame is not None:
                return frame
            now = time.monotonic()
            if now > give_up:
                break
        return None

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
            raise self._send_error(error) from error

    def send_remote(self, can_id: int, length: int) -> None:
        try:
            self._socket.send(_SOCKETCAN_FRAME.pack(can_id | _REMOTE_FLAG, length, b""))
        except OSError as error:
            raise self._send_error(error) from error

    def _decode(self, data: bytes) -> Frame | None:
        if len(data) != _SOCKETCAN_FRAME.size:
            return None
        can_id, length, payload = _SOCKETCAN_FRAME.unpack(data)
        if not can_id & _NO_DATA_FRAME:
            return can_id, payload[:length]
        if can_id & _NO_DATA_FRAME == _REMOTE_FLAG:
            self._on_remote_frame(can_id & _IDENTIFIER, length)
        return None


class _UdpMulticast(_SocketBus):
    """python-can's udp_multicast: each datagram a msgpack map with the fields of a message."""

    _UNREADABLE: Any = (ValueError, TypeError, KeyError, msgpack.exceptions.UnpackException)

    def __init__(self, bus: can.BusABC, name: str, destination: tuple[str, int], *, is_local: bool) -> None:
        super().__init__(bus, name)
        self._sources = LocalSources(*destination) if is_local else None
        self._sender = None
        if is_local and isinstance(bus, MulticastBus):  # ports of other machines say nothing
            self._sender = deaf_sender(bus.fileno(), *destination)
        self.is_echoing = self._sender is None
        self._transmit: Callable[[bytes], int] = lambda data: self._socket.sendto(data, destination)
        if self._sender is not None:
            self._transmit = self._sender.send
        self._source: object = None  # of the last datagram that was accepted
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
        self._send(fields)

    def send_remote(self, can_id: int, length: int) -> None:
        self._send({**self._fields, "arbitration_id": can_id, "dlc": length, "data": b"", "is_remote_frame": True})

    def _send(self, fields: dict[str, Any]) -> None:
        try:
            self._transmit(self._pack(fields))
        except OSError as error:
            raise self._send_error(error) from error

    def close(self) -> None:
        if self._sender is not None:
            self._sender.close()
        super().close()

    def _read(self) -> bytes | None:
        try:
            data, source = self._socket.recvfrom(_LONGEST_DATAGRAM)
        except BlockingIOError:
            return None
        except OSError as error:
            raise self._error("be read any more", error) from error
        if source != self._source and self._sources is not None:
            if not self._sources.accepts(str(source[0])):
                return _NOTHING
            self._source = source
        return data

    def _decode(self, data: bytes) -> Frame | None:
        try:
            fields = self._unpack(data)
            if fields["is_extended_id"] or fields["is_error_frame"] or fields["is_fd"]:
                return None
            can_id, payload = fields["arbitration_id"], fields["data"]
            is_remote = fields["is_remote_frame"]
        except self._UNREADABLE:
            return None  # a datagram that is no CAN frame
        if not (type(can_id) is int and 0 <= can_id <= _IDENTIFIER):
            return None
        if is_remote:
            length = fields.get("dlc", 0)
            if type(length) is int and 0 <= length <= 8:
                self._on_remote_frame(can_id, length)
            return None
        return (can_id, payload) if type(payload) is bytes and len(payload) <= 8 else None


def frame_bus(bus: can.BusABC, config: "BusConfig", name: str) -> FrameBus:
    """Return the fastest `FrameBus` for an open bus."""
    if config.interface == "socketcan":
        frames: FrameBus = _SocketCan(bus, name)
        frames.is_echoing = bool(config.further.get("receive_own_messages"))
        return frames
    if config.interface == "udp_multicast" and config.port:  # python-can's own default port is not known here
        destination = str(config.channel), config.port
        return _UdpMulticast(bus, name, destination, is_local=config.hop_limit == 0)
    frames = FrameBus(bus, name)
    frames.is_echoing = config.interface == "udp_multicast" or bool(config.further.get("receive_own_messages"))
    return frames
