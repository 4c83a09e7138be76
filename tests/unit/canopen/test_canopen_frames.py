"""Frames on the bus's own socket: SocketCAN's struct and udp_multicast's map, over a pair of local sockets."""

import contextlib
import socket
import struct
import threading
import time
from collections.abc import Iterator

import msgpack
import pytest
from friction_hil_drivers.canopen.wire.frames import FrameBus, frame_bus
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

    def __init__(self) -> None:
        self.own, self.other = socket.socketpair(socket.AF_UNIX, socket.SOCK_DGRAM)

    def fileno(self) -> int:
        return self.own.fileno()

    def shutdown(self) -> None:
        self.own.close()


@pytest.fixture
def pair() -> Iterator[SocketPair]:
    one = SocketPair()
    yield one
    one.own.close()
    one.other.close()


def bus_on(pair: SocketPair, interface: str) -> FrameBus:
    return frame_bus(pair, CONFIGS[interface], f"{interface} x")  # type: ignore[arg-type]


def datagram(interface: str, can_id: int, data: bytes, **flags: bool) -> bytes:
    if interface == "socketcan":
        bits = {"is_extended_id": EXTENDED, "is_remote_frame": REMOTE, "is_error_frame": ERROR}
        return CAN_FRAME.pack(can_id | sum(bits[name] for name in flags), len(data), data)
    return bytes(msgpack.packb({**dict.fromkeys(FLAGS, False), **flags, "arbitration_id": can_id, "data": data}))


@pytest.mark.parametrize("interface", CONFIGS)
def test_frames_are_received_in_order_and_without_waiting(pair: SocketPair, interface: str) -> None:
    bus = bus_on(pair, interface)
    assert bus.receive(0.0) is None
    for can_id, data in ((0x181, b"\x01\x02"), (0x7FF, bytes(8)), (0x080, b"")):
        pair.other.send(datagram(interface, can_id, data))
    assert [bus.receive(1.0) for _ in range(3)] == [(0x181, b"\x01\x02"), (0x7FF, bytes(8)), (0x080, b"")]
    assert bus.receive(0.0) is None
    bus.close()


@pytest.mark.parametrize("interface", CONFIGS)
@pytest.mark.parametrize("flag", FLAGS[:3])
def test_frames_of_other_kinds_are_passed_over(pair: SocketPair, interface: str, flag: str) -> None:
    bus = bus_on(pair, interface)
    foreign = datagram(interface, 0x181, b"", **{flag: True})
    for data in (foreign, b"no frame", datagram(interface, 0x181, b"\x01"), foreign):
        pair.other.send(data)
    # None means that nothing more is waiting: a caller that drains the bus stops there
    assert bus.receive(0.0) == (0x181, b"\x01")
    assert bus.receive(0.0) is None
    pair.other.send(foreign)
    pair.other.send(datagram(interface, 0x182, b"\x02"))
    assert bus.receive(1.0) == (0x182, b"\x02")
    bus.close()


def test_a_flood_of_foreign_frames_does_not_extend_the_wait(pair: SocketPair) -> None:
    bus = bus_on(pair, "udp_multicast")
    foreign = datagram("udp_multicast", 0x181, b"", is_extended_id=True)
    ended = threading.Event()

    def flood() -> None:
        while not ended.is_set():
            with contextlib.suppress(OSError):
                pair.other.send(foreign)

    thread = threading.Thread(target=flood)
    thread.start()
    try:
        begin = time.monotonic()
        assert [bus.receive(0.0), bus.receive(0.05)] == [None, None]
        assert time.monotonic() - begin < 5.0
    finally:
        ended.set()
        pair.own.setblocking(False)
        with contextlib.suppress(OSError):
            while pair.own.recv(4096):
                pass
        thread.join(10.0)
    bus.close()


@pytest.mark.parametrize("interface", CONFIGS)
def test_remote_frames_are_sent_and_handed_over(pair: SocketPair, interface: str) -> None:
    bus, asked = bus_on(pair, interface), []
    bus.on_remote = lambda can_id, length: asked.append((can_id, length))
    if interface == "socketcan":
        bus.send_remote(0x705, 1)
        assert pair.other.recv(64) == CAN_FRAME.pack(0x705 | REMOTE, 1, b"")
        pair.other.send(CAN_FRAME.pack(0x705 | REMOTE, 1, b""))
    else:
        fields = {
            **dict.fromkeys(FLAGS, False),
            "is_remote_frame": True,
            "arbitration_id": 0x705,
            "dlc": 1,
            "data": b"",
        }
        pair.other.send(msgpack.packb(fields))
    assert bus.receive(0.0) is None
    assert asked == [(0x705, 1)]
    bus.close()


def test_a_full_send_queue_is_an_error_of_its_own(pair: SocketPair) -> None:
    bus = bus_on(pair, "socketcan")

    def fill() -> None:
        for _ in range(100_000):  # nobody reads the other end
            bus.send(0x205, bytes(8))

    with pytest.raises(QueueFullError, match=r"\[FH-202\]"):
        fill()
    assert pair.other.recv(64)
    bus.send(0x205, bytes(8))  # there is room again
    bus.close()


def test_a_socketcan_frame_is_sent_as_the_kernel_reads_it(pair: SocketPair) -> None:
    bus = bus_on(pair, "socketcan")
    bus.send(0x205, b"\x0f\x00\x10\x27")
    assert pair.other.recv(64) == CAN_FRAME.pack(0x205, 4, b"\x0f\x00\x10\x27")
    bus.close()


def test_a_bus_that_is_gone_is_an_error_with_a_code(pair: SocketPair) -> None:
    bus = bus_on(pair, "socketcan")
    pair.other.close()
    with pytest.raises(BusError, match=r"\[FH-202\]"):
        bus.send(0x080, b"")
    bus.close()
