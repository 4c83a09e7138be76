"""Frames on the bus's own socket: SocketCAN's struct and udp_multicast's map, over a pair of local sockets."""

import contextlib
import socket
import struct
import threading
import time
from collections.abc import Iterator
from typing import Any

import msgpack
import pytest
from friction_hil_drivers.canopen.wire.frames import frame_bus
from friction_hil_drivers.canopen.wire.queue_full import QueueFullError

from friction_hil.config import BusConfig
from friction_hil.errors import BusError

CONFIGS = {
    "socketcan": BusConfig(interface="socketcan", channel="can0"),
    "udp_multicast": BusConfig(interface="udp_multicast", channel="239.74.163.2", port=43113),
}
CAN_FRAME = struct.Struct("=IB3x8s")  # struct can_frame of linux/can.h
EXTENDED, REMOTE, ERROR = 1 << 31, 1 << 30, 1 << 29
FLAGS = ("is_extended_id", "is_remote_frame", "is_error_frame", "is_fd")


class SocketPair:
    """A bus on one end of a pair of sockets; the other end is the test's."""

    def __init__(self, interface: str) -> None:
        self.interface = interface
        self.own, self.other = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)
        self.bus = frame_bus(self, CONFIGS[interface], f"{interface} x")  # type: ignore[arg-type]

    def fileno(self) -> int:
        return self.own.fileno()

    def shutdown(self) -> None:
        self.own.close()

    def come(self, can_id: int, data: bytes = b"", **flags: bool) -> None:
        """Let a frame come, of another kind where a flag says so."""
        if self.interface == "socketcan":
            bits = {"is_extended_id": EXTENDED, "is_remote_frame": REMOTE, "is_error_frame": ERROR}
            size = 1 if "is_remote_frame" in flags else len(data)
            self.other.send(CAN_FRAME.pack(can_id | sum(bits[name] for name in flags), size, data))
        else:
            fields = {**dict.fromkeys(FLAGS, False), **flags, "arbitration_id": can_id, "data": data, "dlc": 1}
            self.other.send(msgpack.packb(fields))


@pytest.fixture(params=CONFIGS)
def pair(request: Any) -> Iterator[SocketPair]:
    one = SocketPair(request.param)
    yield one
    one.bus.close()
    one.own.close()
    one.other.close()


on_socketcan = pytest.mark.parametrize("pair", ["socketcan"], indirect=True)


def test_frames_are_received_in_order_and_without_waiting(pair: SocketPair) -> None:
    assert pair.bus.receive(0.0) is None
    frames = [(0x181, b"\x01\x02"), (0x7FF, bytes(8)), (0x080, b"")]
    for frame in frames:
        pair.come(*frame)
    assert [pair.bus.receive(1.0) for _ in range(3)] == frames
    assert pair.bus.receive(0.0) is None


@pytest.mark.parametrize("flag", FLAGS[:3])
def test_frames_of_other_kinds_are_passed_over(pair: SocketPair, flag: str) -> None:
    pair.come(0x181, **{flag: True})
    pair.other.send(b"no frame")
    pair.come(0x181, b"\x01")
    pair.come(0x181, **{flag: True})
    # None means that nothing more is waiting: a caller that drains the bus stops there
    assert pair.bus.receive(0.0) == (0x181, b"\x01")
    assert pair.bus.receive(0.0) is None
    pair.come(0x181, **{flag: True})
    pair.come(0x182, b"\x02")
    assert pair.bus.receive(1.0) == (0x182, b"\x02")


@pytest.mark.parametrize("pair", ["udp_multicast"], indirect=True)
def test_a_flood_of_foreign_frames_does_not_extend_the_wait(pair: SocketPair) -> None:
    ended = threading.Event()

    def flood() -> None:
        while not ended.is_set():
            with contextlib.suppress(OSError):
                pair.come(0x181, is_extended_id=True)

    thread = threading.Thread(target=flood)
    thread.start()
    try:
        begin = time.monotonic()
        assert [pair.bus.receive(0.0), pair.bus.receive(0.05)] == [None, None]
        assert time.monotonic() - begin < 5.0
    finally:
        ended.set()
        pair.own.setblocking(False)
        with contextlib.suppress(OSError):
            while pair.own.recv(4096):
                pass
        thread.join(10.0)


def test_remote_frames_are_sent_and_handed_over(pair: SocketPair) -> None:
    asked: list[tuple[int, int]] = []
    pair.bus.on_remote = lambda can_id, length: asked.append((can_id, length))
    if pair.interface == "socketcan":
        pair.bus.send_remote(0x705, 1)
        assert pair.other.recv(64) == CAN_FRAME.pack(0x705 | REMOTE, 1, b"")
    pair.come(0x705, is_remote_frame=True)
    assert pair.bus.receive(0.0) is None
    assert asked == [(0x705, 1)]


@on_socketcan
def test_a_frame_is_sent_as_the_kernel_reads_it_and_a_full_queue_or_a_bus_that_is_gone_is_an_error(
    pair: SocketPair,
) -> None:
    pair.bus.send(0x205, b"\x0f\x00\x10\x27")
    assert pair.other.recv(64) == CAN_FRAME.pack(0x205, 4, b"\x0f\x00\x10\x27")

    def fill() -> None:
        for _ in range(100_000):  # nobody reads the other end
            pair.bus.send(0x205, bytes(8))

    with pytest.raises(QueueFullError, match=r"\[FH-202\]"):
        fill()
    assert pair.other.recv(64)
    pair.bus.send(0x205, bytes(8))  # there is room again
    pair.other.close()
    with pytest.raises(BusError, match=r"\[FH-202\]"):
        pair.bus.send(0x080, b"")
