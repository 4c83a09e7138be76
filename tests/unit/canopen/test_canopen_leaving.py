"""Connecting looks before it touches, and a drive is left as it was found."""

import json
import struct
import tempfile
import time

import can
import pytest
from friction_hil_drivers.cia402 import objects

from friction_hil.drive import Command, DriveState, Feedback, Request
from friction_hil.errors import DriveError
from tests.canopen_bench import NODE, Bench, BenchBus, Driven, kill

SDO_REQUEST, SDO_ANSWER = 0x600 + NODE, 0x580 + NODE
SETTINGS = [
    *((0x1400 + k, subindex) for k in range(4) for subindex in (1, 2, 5)),
    *((0x1800 + k, subindex) for k in range(4) for subindex in (1, 2, 5)),
    *((0x1600 + k, position) for k in range(4) for position in range(9)),
    *((0x1A00 + k, position) for k in range(4) for position in range(9)),
    *((index, 0) for index in (0x1017, 0x6007, 0x605A, 0x6060)),
    *((0x1016, subindex) for subindex in (1, 2)),
    *((0x60C2, subindex) for subindex in (1, 2)),
]


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    """Locks and journals of these tests are not those of others."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    return tmp_path


class Others(BenchBus):
    """A bus on which other masters may be heard."""

    def hear(self, can_id, data=b""):
        self.answers.put(can.Message(arbitration_id=can_id, data=data, is_extended_id=False))


@pytest.fixture
def bench():
    """A drive whose settings are not those that the daemon would write."""
    one = Bench()
    one.map(0x1400, 0x1600, 0x205, 255, [0x60400010, 0x60600008])
    one.map(0x1401, 0x1601, 0x305, 1, [0x60400010, 0x607A0020])
    one.map(0x1800, 0x1A00, 0x185, 254, [0x60410010])
    one.map(0x1801, 0x1A01, 0x285, 255, [0x60410010, 0x60640020])
    one.write(0x1017, 0, "H", 700)
    one.write(0x605A, 0, "h", 2)
    one.write(0x6060, 0, "b", 9)
    one.write(0x60C2, 1, "B", 4)
    return one


def settings(bench):
    """What a drive holds, by index and sub-index; abort codes as negative numbers."""
    values = {}
    for index, subindex in SETTINGS:
        [(_, answer)] = bench.sdo(struct.pack("<BHB4x", 0x40, index, subindex))
        value = struct.unpack_from("<I", answer, 4)[0]
        if answer[0] == 0x80:
            value = -value
        is_unused = index in range(0x1600, 0x1C00) and subindex > values.get((index, 0), 0) and index & 0x200
        values[index, subindex] = None if is_unused and subindex else value
    return values


def make(bus, *, mode="cst", dry_run=False):
    return Driven(mode, bus=bus, dry_run=dry_run).drives


def run(drives, count=10):
    feedback = Feedback()
    drives.start()
    for request in (Request.ENABLE, Request.DISABLE):
        for _ in range(count):
            drives.receive([feedback], 0)
            drives.send([Command(request)])
    return feedback


def writes(bus):
    """Frames that change something: SDO downloads, NMT, SYNC, PDOs."""
    return [
        (f"{can_id:03X}", data.hex())
        for can_id, data in bus.sent
        if not (can_id == SDO_REQUEST and data[0] >> 5 in (2, 3))
    ]


# --- looking before touching


@pytest.mark.parametrize("dry_run", [False, True])
def test_a_powered_drive_is_not_touched(bench, dry_run):
    bench.nmt(0x01)
    bench.enable(9)
    bus = Others(bench)
    drives = make(bus, dry_run=dry_run)
    if dry_run:
        with pytest.raises(DriveError, match=r"FH-221"):
            drives.connect()  # they come only on a change
    else:
        with pytest.raises(DriveError, match=r"friction-hil stop.*FH-215"):
            drives.connect()
    drives.close()
    assert writes(bus) == []
    assert bench.statusword & 0x6F == 0x27


HEARD = {
    "SYNC (080h)": (0x080, b""),
    "RPDO 1 (205h) to node 5": (0x205, b"\x0f\0"),
    "RPDO 3 (405h) to node 5": (0x405, b"\x0f\0"),
    "an RPDO (345h) to node 5": (0x345, b"\x0f\0"),
    "SDO requests to node 5": (SDO_REQUEST, bytes.fromhex("4041600000000000")),
    "NMT start to all nodes": (0x000, b"\x01\x00"),
    "NMT stop to node 5": (0x000, b"\x02\x05"),
    "heartbeat of node 126, which is the daemon's own number": (0x77E, b"\x05"),
    "heartbeat of node 9, which node 5 watches as its master's": (0x709, b"\x05"),
}


@pytest.mark.parametrize("what", HEARD)
def test_another_master_is_heard_before_anything_is_sent(bench, what):
    bench.write(0x1401, 1, "I", 0x80000345)
    bench.write(0x1401, 1, "I", 0x345)
    bench.write(0x1016, 1, "I", 9 << 16 | 500)
    bus = Others(bench)
    bus.hear(*HEARD[what])
    drives = make(bus)
    with pytest.raises(DriveError) as caught:
        drives.connect()
    assert "another master is at work on virtual" in str(caught.value)
    assert what in str(caught.value)
    assert "FH-203" in str(caught.value)
    drives.close()
    assert writes(bus) == []


@pytest.mark.parametrize(
    "frame", [(0x709, b"\x05"), (0x206, b"\0\0"), (0x000, b"\x01\x06"), (0x186, b""), (0x606, b"")]
)
def test_what_concerns_other_nodes_is_not_a_master_of_ours(bench, frame):
    bus = Others(bench)
    bus.hear(*frame)
    drives = make(bus)
    assert [facts.name for facts in drives.connect()] == ["x"]
    drives.close()


def test_a_node_that_is_pre_operational_is_not_told_so(bench):
    bus = Others(bench)
    bus.hear(0x700 + NODE, b"\x7f")
    drives = make(bus)
    drives.connect()
    assert [frame for frame in writes(bus) if frame[0] == "000"] == []
    drives.close()


def test_a_master_that_appears_in_mid_run_is_a_fault_of_the_run(bench):
    bus = Others(bench)
    drives = make(bus)
    drives.connect()
    drives.start()
    feedback = Feedback()
    for _ in range(5):
        drives.receive([feedback], 0)
        drives.send([Command(Request.ENABLE)])
        assert feedback.message == ""
    bus.hear(0x080)
    drives.receive([feedback], 0)
    assert feedback.message.endswith("SYNC (080h) [FH-220]")
    drives.close()


def test_a_master_that_restarts_a_node_is_told_beside_the_restart(bench):
    bus = Others(bench)
    drives = make(bus)
    drives.connect()
    drives.start()
    feedback = Feedback()
    for _ in range(5):
        drives.receive([feedback], 0)
        drives.send([Command(Request.ENABLE)])
    bus.hear(0x000, bytes([0x81, NODE]))
    bus.hear(0x700 + NODE, b"\0")
    drives.receive([feedback], 0)
    assert feedback.message == f"node {NODE} restarted (boot-up message) [FH-231]"
    told = f"another master has appeared on the bus: NMT reset node to node {NODE} [FH-220]"
    assert feedback.notices == [told]
    feedback.notices.clear()
    drives.receive([feedback], 0)
    assert feedback.notices == []
    drives.close()


def test_frames_that_come_back_are_not_another_masters(bench):
    """As on udp_multicast; one more of a kind than was sent is."""

    class Echoing(Others):
        def send(self, msg, timeout=None):
            self.answers.put(msg)
            super().send(msg)

    bus = Echoing(bench)

    class OnMulticast(Driven):
        def changed(self, config):
            bus = config.bus.model_copy(update={"interface": "udp_multicast", "channel": "239.74.163.9"})
            return config.model_copy(update={"bus": bus})

    drives = OnMulticast("cst", bus=bus).drives
    drives.connect()
    feedback = run(drives, 20)
    assert feedback.message == ""
    bus.hear(0x205, bytes(4))
    for _ in range(2):
        drives.receive([feedback], 0)
    assert "RPDO 1 (205h) to node 5 [FH-220]" in feedback.message
    drives.close()


class Streaming(Others):
    """Another master sends SYNC and an RPDO whenever the listener waits for a frame."""

    def _recv_internal(self, timeout):
        if self.answers.empty() and timeout:
            for can_id, data in ((0x205, b"\x0f\0\x09"), (0x080, b"")):
                self.hear(can_id, data)
                for answer in self.bench.send(can_id, data):
                    self.hear(*answer)
            time.sleep(0.001)
        return super()._recv_internal(timeout)


@pytest.mark.parametrize("kind", [1, 255])
def test_a_dry_run_beside_another_master_shows_the_feedback_and_touches_nothing(bench, kind, folder):
    words = [0x60410010, 0x60640020]
    bench.map(0x1800, 0x1A00, 0x185, 1, [0x60770010, *words])
    bench.map(0x1801, 0x1A01, 0x285, kind, [0x606C0020])
    bench.nmt(0x01)
    bench.enable(9)
    bench.write(0x60FF, 0, "i", 100_000)
    before = settings(bench)
    bus = Streaming(bench)
    drives = make(bus, mode="csv", dry_run=True)
    if kind == 255:
        bench.write(0x1801, 5, "H", 1)
        before = settings(bench)
    (facts,) = drives.connect()
    (note,) = [note for note in facts.notes if "another master drives it" in note]
    assert "SYNC (080h)" in note
    assert "RPDO 1 (205h) to node 5" in note
    drives.start()
    feedback, positions = Feedback(), []
    for _ in range(30):
        drives.receive([feedback], 0)
        drives.send([Command(Request.ENABLE, velocity=5.0)])
        assert feedback.is_fresh
        assert feedback.message == ""
        positions.append(feedback.position)
    assert feedback.state is DriveState.OPERATION_ENABLED
    assert feedback.velocity == pytest.approx(0.6, rel=0.2)
    assert positions == sorted(positions)
    drives.close()
    assert writes(bus) == []
    assert settings(bench) == before
    assert list(folder.iterdir()) == []


def test_a_dry_run_beside_another_master_needs_position_and_state(bench):
    """TPDOs 1 and 2 of this drive carry no torque, velocity or mode: these are done without."""
    bench.map(0x1801, 0x1A01, 0x285, 1, [0x60410010])
    bench.nmt(0x01)
    drives = make(Streaming(bench), dry_run=True)
    with pytest.raises(DriveError, match=r"6064h.*FH-221"):
        drives.connect()
    drives.close()


# --- as it was found


@pytest.mark.parametrize("mode", ["csp", "csv", "cst"])
def test_a_run_leaves_the_drive_as_it_was_found(bench, mode, folder):
    before = settings(bench)
    drives = make(Others(bench), mode=mode)
    drives.connect()
    assert settings(bench) != before
    run(drives)
    assert drives.close() == [DriveState.SWITCH_ON_DISABLED]
    assert drives.leftovers == []
    assert settings(bench) == before
    assert list(folder.iterdir()) == []


def test_a_dry_run_on_a_quiet_bus_leaves_the_drive_as_it_was_found(bench, folder):
    before = settings(bench)
    drives = make(Others(bench), dry_run=True)
    drives.connect()
    run(drives)
    drives.close()
    assert settings(bench) == before
    assert list(folder.iterdir()) == []


def test_a_refusal_leaves_the_drive_as_it_was_found(bench, folder):
    """Found out in the middle of the configuration, after the RPDOs: the TPDOs are fixed and do not come with SYNC."""
    before = settings(bench)

    class Refusing(Others):
        def send(self, msg, timeout=None):
            data = bytes(msg.data)
            is_of_tpdo = data[2:3] in (b"\x18", b"\x1a") and data[0] >> 5 == 1
            if msg.arbitration_id == SDO_REQUEST and is_of_tpdo:
                self.hear(SDO_ANSWER, b"\x80" + data[1:4] + struct.pack("<I", 0x06010002))
                return
            super().send(msg)

    drives = make(Refusing(bench))
    with pytest.raises(DriveError, match=r"FH-227"):
        drives.connect()
    drives.close()
    assert settings(bench) == before
    assert list(folder.iterdir()) == []


@pytest.mark.parametrize("cycles", [0, 10])
def test_after_a_kill_the_next_run_restores_what_the_first_one_found(bench, folder, cycles):
    before = settings(bench)
    killed = make(Others(bench))
    killed.connect()
    if cycles:
        run(killed, cycles)
    kill(killed)
    assert settings(bench) != before
    drives = make(Others(bench), mode="csp")
    (facts,) = drives.connect()
    assert any("ended without restoring" in note for note in facts.notes)
    run(drives)
    drives.close()
    assert drives.leftovers == []
    assert settings(bench) == before
    assert list(folder.iterdir()) == []


def test_a_value_that_somebody_changed_after_a_kill_is_his(bench, folder):
    killed = make(Others(bench))
    killed.connect()
    kill(killed)
    bench.write(0x605A, 0, "h", 5)
    drives = make(Others(bench))
    drives.connect()
    drives.close()
    assert bench.read(0x605A, 0, "h") == 5
    assert bench.read(0x6060, 0, "b") == 9


def test_a_drive_in_the_nmt_state_stopped_is_disabled_all_the_same(folder):
    """A stopped node has no SDO; without a heartbeat nothing says so, and many drives go on with their set-point."""
    bench = Bench(missing=(0x1016, 0x1017, 0x100C, 0x100D), manners={"nmt_stops_drive": False})
    drives = make(BenchBus(bench))
    drives.connect()
    drives.start()
    feedback, command = Feedback(), Command(Request.ENABLE)
    for _ in range(10):
        drives.receive([feedback], 0)
        drives.send([command])
    assert feedback.state is DriveState.OPERATION_ENABLED
    bench.nmt(0x02)
    assert drives.close() == [DriveState.SWITCH_ON_DISABLED]
    assert bench.read(0x6041, 0, "H") & 0x6F == 0x40
    assert not [text for text in drives.leftovers if "FH-222" in text]


def test_what_cannot_be_restored_is_told_one_by_one(bench, folder):
    class Stubborn(Others):
        is_stubborn = False

        def send(self, msg, timeout=None):
            data = bytes(msg.data)
            if self.is_stubborn and data[1:3] in (b"\x5a\x60", b"\x60\x60") and data[0] >> 5 == 1:
                self.hear(SDO_ANSWER, b"\x80" + data[1:4] + struct.pack("<I", 0x08000022))
                return
            super().send(msg)

    bus = Stubborn(bench)
    drives = make(bus)
    drives.connect()
    bus.is_stubborn = True
    drives.close()
    assert [text.partition(": ")[2].partition(": ")[2] for text in drives.leftovers] == [
        "6060h modes of operation was 09h and stays 0Ah [FH-222]",
        "605Ah quick stop option code was 0002h and stays 0006h [FH-222]",
    ]
    [path] = folder.iterdir()  # for the next time
    assert {entry["index"] for entry in json.loads(path.read_text())["entries"]} == {0x605A, 0x6060}
    assert path.stat().st_mode & 0o777 == 0o600


def test_a_drive_that_keeps_its_power_is_not_restored(bench):
    bus = Others(bench)
    drives = make(bus)
    drives.connect()
    run(drives)
    bench.write(0x6007, 0, "h", 0)  # it does not react to leaving Operational
    before = settings(bench)
    bench.enable(10)
    bus.loses = lambda can_id, data: can_id == SDO_REQUEST and data[1:3] == b"\x40\x60"
    assert drives.close() == [DriveState.OPERATION_ENABLED]
    assert settings(bench) == before
    (text,) = drives.leftovers
    assert text.startswith("x: not restored in node 5 on virtual")
    assert "6060h modes of operation was 09h" in text
    assert text.endswith("is operation enabled [FH-222]")


def test_a_drive_that_is_gone_is_told_and_does_not_take_long(bench):
    bus = Others(bench)
    drives = make(bus)
    drives.connect()
    drives.start()
    bus.loses = lambda can_id, data: True
    assert drives.close() == [DriveState.UNKNOWN]
    (text,) = drives.leftovers
    assert "6060h modes of operation was 09h" in text
    assert text.endswith("not answer [FH-222]")


def test_a_damaged_journal_is_told(bench, folder):
    killed = make(Others(bench))
    killed.connect()
    kill(killed)
    [path] = folder.iterdir()
    path.write_text('{"version": 1, "ent')
    drives = make(Others(bench))
    (facts,) = drives.connect()
    assert any("is not used: it is damaged" in note for note in facts.notes)
    drives.close()


def test_commands_and_set_points_are_no_settings(bench):
    """A target written back would be a target nobody asked for."""
    bus = Others(bench)
    drives = make(bus, mode="csp")
    drives.connect()
    before = len(bus.sent)
    drives.close()
    downloads = [data for can_id, data in bus.sent[before:] if can_id == SDO_REQUEST and data[0] >> 5 == 1]
    indices = {struct.unpack_from("<H", data, 1)[0] for data in downloads}
    assert indices
    assert not indices & {0x6040, 0x6071, 0x607A, 0x60B2, 0x60FF, objects.DEVICE_TYPE.index}
