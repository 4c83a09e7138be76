"""udp_multicast hears frames of its own group from its own machine, and nothing else."""

import contextlib
import queue
import random
import socket
from collections.abc import Iterator

import can
import msgpack
import pytest
from friction_hil_drivers.canopen.wire.bus import open_bus, open_frame_bus
from friction_hil_drivers.canopen.wire.multicast import LocalSources

from friction_hil.config import BusConfig

GROUP, OTHER_GROUP = "239.74.163.40", "239.74.163.41"
NMT_STOP = {
    "arbitration_id": 0x000,
    "data": b"\x02\x01",
    "dlc": 2,
    **dict.fromkeys(("is_extended_id", "is_remote_frame", "is_error_frame", "is_fd"), False),
}


@pytest.fixture
def config() -> BusConfig:
    port = random.SystemRandom().randrange(20000, 60000)
    return BusConfig(interface="udp_multicast", channel=GROUP, port=port, hop_limit=0)


@pytest.fixture
def sender() -> Iterator[socket.socket]:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        sock.setsockopt(socket.IPPROTO_IP, socket.IP_MULTICAST_TTL, 0)
        yield sock


def own_address(config: BusConfig) -> str:
    """Address of this machine as the others know it."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.connect((config.channel, config.port or 0))
        return str(probe.getsockname()[0])


@pytest.mark.parametrize("target", ["loopback", "own", OTHER_GROUP])
def test_a_frame_that_was_not_sent_to_the_group_is_not_heard(
    config: BusConfig, sender: socket.socket, target: str
) -> None:
    with contextlib.closing(open_frame_bus(config)) as bus, contextlib.closing(open_frame_bus(config)) as other:
        # a member of the other group on this machine: without it nothing would arrive for that group
        group = BusConfig(interface="udp_multicast", channel=OTHER_GROUP, port=config.port, hop_limit=0)
        with contextlib.closing(open_frame_bus(group)):
            address = {"loopback": "127.0.0.1", "own": own_address(config)}.get(target, target)
            sender.sendto(msgpack.packb(NMT_STOP), (address, config.port or 0))
            other.send(0x181, b"\x01")
            assert bus.receive(5.0) == (0x181, b"\x01")
            # python-can's own reader, which serves SDO
            message = bus.bus.recv(0.0)
            assert message is None


def test_sources_of_other_machines_are_not_local(config: BusConfig) -> None:
    sources = LocalSources(GROUP, config.port or 0)
    assert sources.accepts("127.0.0.1")
    assert sources.accepts(own_address(config))
    for address in ("203.0.113.9", "8.8.8.8", "0.0.0.0"):
        assert not sources.accepts(address)


@pytest.mark.parametrize("garbage", [b"", b"no frame", msgpack.packb({"data": 7}), msgpack.packb([1, 2]), b"\xc1" * 50])
def test_python_cans_reader_survives_what_is_no_frame(config: BusConfig, sender: socket.socket, garbage: bytes) -> None:
    """While connecting and closing, a thread of python-can reads: an exception there would end it."""
    heard: queue.Queue[can.Message] = queue.Queue()
    with contextlib.closing(open_frame_bus(config)) as other:
        bus = open_bus(config)
        notifier = can.Notifier(bus, [heard.put], 0.02)
        sender.sendto(garbage, (GROUP, config.port or 0))
        other.send(0x585, bytes(8))
        assert heard.get(timeout=5.0).arbitration_id == 0x585
        notifier.stop()
        bus.shutdown()
    assert notifier.exception is None
    assert heard.empty()


@pytest.mark.parametrize("hop_limit", [0, 1])
def test_a_process_hears_itself_only_where_frames_leave_this_machine(config: BusConfig, hop_limit: int) -> None:
    """Another machine may send from the same port: then nothing may be dropped for it."""
    with (
        contextlib.closing(open_frame_bus(config.model_copy(update={"hop_limit": hop_limit}))) as bus,
        contextlib.closing(open_frame_bus(config)) as other,
    ):
        assert bus.is_echoing is bool(hop_limit)
        bus.send(0x181, b"\x01")
        if hop_limit:
            assert bus.receive(5.0) == (0x181, b"\x01")
            return
        bus.send_remote(0x701, 1)
        assert other.receive(5.0) == (0x181, b"\x01")
        other.send(0x182, b"\x02")
        assert bus.receive(5.0) == (0x182, b"\x02")
        assert bus.receive(0.0) is None
