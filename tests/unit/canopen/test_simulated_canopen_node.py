"""A simulated node's life on the bus: boot-up, NMT, heartbeats, SYNC, emergencies, lost connections."""

import math
import struct
from collections.abc import Iterator
from typing import Any

import canopen
import pytest
from canopen.profiles.p402 import BaseNode402
from friction_hil_drivers.canopen.connect.eds import SIMULATED_SERVO
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from friction_hil.drive import DriveState
from tests.canopen_bench import NODE, PLAIN, Bench, BenchBus, Frame

MASTER = 0x77E  # heartbeat of node 126
BOOT_UP: list[Frame] = [(0x705, b"\x00")]
OFF = "SWITCH_ON_DISABLED"


def heartbeats(frames: list[Frame]) -> list[int]:
    return [data[0] for can_id, data in frames if can_id == 0x705]


def test_boot_up_then_nmt() -> None:
    bench = Bench()
    assert bench.sent == BOOT_UP
    bench.write(0x1017, 0, "H", 10)
    bench.map(0x1800, 0x1A00, 0x185, 1, [0x60410010])
    for frame in (b"", b"\x01", b"\x01\x06", b"\x03\x05", b"\x00\x05"):
        bench.send(0x000, frame)
        assert bench.sync() == [], "no command for this node"
    bench.sync(5)
    for command, state in {0x01: 0x05, 0x80: 0x7F, 0x02: 0x04}.items():
        bench.nmt(command)
        assert heartbeats(bench.sync(10)) == [state]
    assert BOOT_UP[0] in bench.nmt(0x81)
    assert BOOT_UP[0] in bench.nmt(0x82, node=0)
    assert heartbeats(bench.sync(100)) == [], "1017h is back at zero"


def test_identifiers_of_sync_and_emergencies_are_settings() -> None:
    bench = Bench()
    bench.map(0x1800, 0x1A00, 0x185, 1, [0x60410010])
    bench.nmt(0x01)
    bench.write(0x1005, 0, "I", 0x90)
    assert bench.sync() == []
    assert len(bench.send(0x090)) == 1
    assert bench.try_write(0x1005, 0, "I", 0x40000080) == 0x06090030, "it produces no SYNC"
    bench.write(0x1014, 0, "I", 0x99)
    assert bench.send(0x205, b"")[0][0] == 0x099
    bench.write(0x1014, 0, "I", 0x80000099)
    assert all(can_id != 0x099 for can_id, _ in bench.send(0x205, b"\0\0"))


# Lost connections


def watch_heartbeat(bench: Bench, time_ms: int) -> None:
    bench.write(0x1016, 1, "I", 126 << 16 | time_ms)


def torque_on(bench: Bench) -> None:
    """In CST, pushing."""
    bench.stream(10)
    bench.move(50, 5)
    assert bench.servo.torque_demand > 0.0


def test_heartbeat_is_watched_from_the_first_on() -> None:
    bench = Bench(is_paced_by_sync=False)
    watch_heartbeat(bench, 50)
    assert bench.at(1000) == []
    bench.send(MASTER, b"\x05")
    assert bench.at(1049) == []
    assert bench.at(1050) == [(0x085, bytes.fromhex("30 81 11 00 00 00 00 00"))]
    assert bench.at(5000) == [], "reported once"
    assert bench.send(MASTER, b"\x05") == [(0x085, bytes(8))]


@pytest.mark.parametrize(("option", "state"), [(0, "OPERATION_ENABLED"), (1, "FAULT"), (2, OFF), (3, OFF)])  # 3: a ramp
def test_lost_heartbeat_does_what_6007h_says(option: int, state: str) -> None:
    bench = Bench(PLAIN)
    bench.write(0x6007, 0, "h", option)
    bench.write(0x1029, 1, "B", 1)
    watch_heartbeat(bench, 20)
    bench.send(MASTER, b"\x05")
    torque_on(bench)
    bench.sync(100)
    assert bench.emergencies == ["8130"]
    assert bench.node.drive.state.name == state
    assert (bench.servo.torque_demand == 0.0) == (option != 0)
    bench.send(MASTER, b"\x05")
    assert (bench.emergencies == ["8130"]) == (option == 1), "a fault stays until it is reset"


@pytest.mark.parametrize(("behaviour", "state"), [(0, 0x7F), (1, 0x05), (2, 0x04)])
def test_lost_heartbeat_does_what_1029h_says(behaviour: int, state: int) -> None:
    bench = Bench()
    bench.write(0x1029, 1, "B", behaviour)
    bench.write(0x1017, 0, "H", 100)
    watch_heartbeat(bench, 20)
    bench.nmt(0x01)
    bench.send(MASTER, b"\x05")
    bench.sync(99)
    assert heartbeats(bench.sync()) == [state]


def test_one_of_two_masters_is_missed() -> None:
    bench = Bench()
    watch_heartbeat(bench, 20)
    bench.write(0x1016, 2, "I", 125 << 16 | 20)
    bench.send(MASTER, b"\x05")
    for _ in range(100):
        bench.send(0x77D, b"\x05")
        bench.sync()
    assert bench.emergencies == ["8130"]
    bench.send(MASTER, b"\x05")
    assert bench.emergencies == ["8130", "0000"]


@pytest.mark.parametrize("option", [1, 2, 3])
def test_rpdo_deadline_stops_the_drive_and_a_stream_that_comes_back_enables_nothing(option: int) -> None:
    bench = Bench(PLAIN)
    bench.write(0x6007, 0, "h", option)
    bench.write(0x605A, 0, "h", 6)
    bench.write(0x1400, 5, "H", 20)
    torque_on(bench)
    bench.sync(18)  # the last RPDO came before a SYNC
    assert bench.emergencies == []
    bench.sync(1)
    assert bench.emergencies == ["8250"]
    bench.sync(100)
    assert abs(bench.servo.velocity) < (0.1 if option != 2 else math.inf)
    assert abs(bench.servo.torque_demand) < 0.02
    bench.move(500, 50)
    assert bench.node.drive.state.name == {1: "FAULT", 2: OFF, 3: "QUICK_STOP_ACTIVE"}[option]
    assert abs(bench.servo.torque_demand) < 0.02


@pytest.mark.parametrize("guarded", [False, True], ids=["SYNC", "life guarding"])
def test_late_sync_and_life_guarding_stop_the_drive(guarded: bool) -> None:
    """Life guarding begins with the first remote frame; the time of a SYNC is ten periods."""
    bench = Bench(PLAIN, is_paced_by_sync=False)
    for index, subindex, code, value in ((0x1029, 1, "B", 1), (0x100C, 0, "H", 20), (0x100D, 0, "B", 3)):
        bench.write(index, subindex, code, value)
    bench.stream(10)
    if guarded:
        bench.at(1000)
        assert [bench.guard() for _ in range(3)] == [[(0x705, b"\x05")], [(0x705, b"\x85")], [(0x705, b"\x05")]]
        bench.at(1040)
        assert bench.guard() == [(0x705, b"\x85")]
        last, code = 1099, "8130"
    else:
        bench.write(0x1006, 0, "I", 1000)
        for time in (4, 5):
            bench.at(time)
            bench.sync()
        last, code = 14, "8700"
    bench.at(last)
    assert bench.emergencies == []
    bench.at(last + 1)
    assert bench.emergencies == [code]
    bench.at(last + 6)
    assert bench.node.drive.state is DriveState.FAULT


@pytest.mark.parametrize("command", [0x02, 0x80, 0x81, 0x82])
def test_leaving_operational_takes_the_torque_away(command: int) -> None:
    bench = Bench(PLAIN)
    torque_on(bench)
    bench.nmt(command)
    bench.sync(100)
    assert bench.servo.torque_demand == 0.0
    assert bench.node.drive.state.name == (OFF if command == 0x81 else "FAULT")


# The clock of the drive in real time


def test_locked_clock_makes_nothing_of_late_syncs() -> None:
    def run(factor: int, *, prepares: bool) -> list[Frame]:
        bench = Bench(PLAIN, is_paced_by_sync=False, is_locked=True)
        bench.stream(10)
        for cycle in range(1, 61):
            if prepares:
                bench.at(cycle - 0.2)
                bench.node.prepare()
                bench.node.prepare()
            bench.at(cycle + 1e-3 * (factor * (cycle - 1) % 300))
            bench.move(50)
        return [frame for frame in bench.sent if frame[0] == 0x185][1:]

    punctual = run(0, prepares=False)
    assert len(punctual) == 59
    assert run(37, prepares=False) == run(53, prepares=True) == punctual


def test_clock_runs_free_again_when_syncs_stay_away() -> None:
    bench = Bench(PLAIN, is_paced_by_sync=False, is_locked=True)
    bench.stream(10)
    for time in range(1, 6):
        bench.at(time)
        bench.move(50)
    bench.node.prepare()
    bench.at(14)
    speed = bench.servo.true_velocity
    bench.at(25)
    acceleration = (0.05 * 0.64 - 0.01) / 2e-4
    assert bench.servo.true_velocity == pytest.approx(acceleration * 24e-3, rel=0.03)
    assert bench.servo.true_velocity > 2.0 * speed


# Robustness

NODE_IDS = (0x000, 0x080, 0x085, 0x185, 0x205, 0x305, 0x405, 0x505, 0x585, 0x605, 0x705, MASTER)
WRITES: st.SearchStrategy[Frame] = st.builds(
    lambda index, subindex, size, data: (
        0x605,
        struct.pack("<BHB", 0x23 | (4 - size) << 2, index, subindex) + data[:size].ljust(4, b"\0"),
    ),
    st.sampled_from([0x1005, 0x1014, 0x1016, 0x1400, 0x1600, 0x1800, 0x1A00, 0x6040, 0x6060, 0x605A, 0x60C2, 0x6080]),
    st.integers(0, 8),
    st.integers(1, 4),
    st.binary(min_size=4, max_size=4),
)
FRAMES = st.lists(st.one_of(st.tuples(st.sampled_from(NODE_IDS), st.binary(max_size=8)), WRITES), max_size=40)


def enables(frame: Frame) -> bool:
    """Whether a frame may take part in enabling a drive: NMT start, or SDO access to the controlword."""
    can_id, data = frame
    return (can_id == 0x000 and data[:1] == b"\x01") or (can_id == 0x605 and data[1:3] == b"\x40\x60")


@settings(deadline=None, max_examples=60)
@given(FRAMES)
def test_random_frames_neither_stop_a_node_nor_enable_its_drive(frames: list[Frame]) -> None:
    bench = Bench(PLAIN)
    for frame in frames:
        if not enables(frame):
            bench.send(*frame)
        assert not bench.node.drive.state.is_powered
    assert bench.servo.torque_demand == 0.0
    bench.nmt(0x82)
    assert bench.read(0x1000) == 0x20192, "it still answers"


@settings(deadline=None, max_examples=30, suppress_health_check=[HealthCheck.too_slow])
@given(FRAMES)
def test_random_frames_to_an_enabled_drive_break_nothing(frames: list[Frame]) -> None:
    bench = Bench(PLAIN)
    bench.stream(8)
    for frame in frames:
        bench.send(*frame)
        bench.send(0x080)
        drive = bench.node.drive
        assert drive.state.is_powered or bench.servo.torque_demand == 0.0
        assert abs(bench.servo.torque_demand) <= bench.servo.config.motor.peak_torque


# --- a master that is not ours: the canopen library, wired to the node without thread or clock


class Wire(BenchBus):
    """Hands every frame of the master to the node, and every frame of the node to the master."""

    def __init__(self, network: canopen.Network, bench: Bench) -> None:
        super().__init__(bench)
        self.network = network

    def hear(self, can_id: int, data: bytes = b"") -> None:
        self.network.notify(can_id, bytearray(data), 0.0)


@pytest.fixture
def master() -> Iterator[Any]:
    network = canopen.Network()
    bench = Bench(PLAIN)
    network.bus = Wire(network, bench)
    node = BaseNode402(NODE, str(SIMULATED_SERVO))
    network.add_node(node)
    node.sdo.RESPONSE_TIMEOUT = 60.0
    node.bench = bench
    yield node
    network.bus.shutdown()


def test_library_reads_the_whole_dictionary(master: Any) -> None:
    count = 0
    for index, known in master.object_dictionary.items():
        if index < 0x1000:
            continue
        item = master.sdo[index]
        for entry in [item] if isinstance(item, canopen.sdo.SdoVariable) else [item[s] for s in known]:
            if index == 0x1003 and entry.od.subindex:
                with pytest.raises(canopen.SdoAbortedError) as info:
                    _ = entry.raw
                assert info.value.code == 0x08000024
                continue
            value = entry.raw
            count += 1
            if entry.od.access_type == "const" and entry.od.default is not None:
                assert value == entry.od.default
            if entry.od.writable and not 0x1400 <= index < 0x1C00:
                entry.raw = value
    assert count > 150


def test_library_maps_and_the_drive_obeys(master: Any) -> None:
    master.nmt.state = "PRE-OPERATIONAL"
    master.tpdo.read()
    master.rpdo.read()
    for pdo, names in ((master.rpdo[1], (0x6040, 0x607A, 0x60B2)), (master.tpdo[1], (0x6041, 0x6064, 0x6077))):
        pdo.clear()
        for name in names:
            pdo.add_variable(name)
        pdo.trans_type = 1
        pdo.enabled = True
        pdo.save()
    master.nmt.state = "OPERATIONAL"
    master.sdo[0x6060].raw = 8
    start = master.sdo[0x6064].raw
    for word, target in [(0x06, 0), (0x07, 0), *((0x0F, 50 * cycle) for cycle in range(200))]:
        master.rpdo[1][0x6040].raw = word
        master.rpdo[1][0x607A].raw = start + target
        master.rpdo[1].transmit()
        master.network.sync.transmit()
    assert master.tpdo[1][0x6041].raw & 0x6F == 0x27
    assert master.tpdo[1][0x6064].raw == pytest.approx(start + 50 * 199, abs=200)


def test_library_s_state_machine_enables_and_resets(master: Any) -> None:
    master.nmt.state = "PRE-OPERATIONAL"
    master.setup_402_state_machine()
    master.nmt.state = "OPERATIONAL"
    master.op_mode = "CYCLIC SYNCHRONOUS TORQUE"
    master.state = "OPERATION ENABLED"
    assert master.bench.node.drive.state is DriveState.OPERATION_ENABLED
    assert master.op_mode == "CYCLIC SYNCHRONOUS TORQUE"
    master.state = "SWITCHED ON"
    assert master.bench.node.drive.state is DriveState.SWITCHED_ON
    master.state = "OPERATION ENABLED"
    emergencies: list[Any] = []
    master.emcy.add_callback(emergencies.append)
    master.rpdo[1].stop()
    master.nmt.state = "PRE-OPERATIONAL"
    assert [error.code for error in emergencies] == [0x8100]
    master.nmt.state = "OPERATIONAL"
    master.network.sync.transmit()
    assert master.state == "FAULT"
    master.controlword = 0x80
    assert master.state == "SWITCH ON DISABLED"
