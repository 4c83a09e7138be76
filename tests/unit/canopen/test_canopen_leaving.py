"""Connecting looks before it touches, and a drive is left as it was found."""

import json
import struct
import time

import pytest

from friction_hil.drive import DriveState, Request
from friction_hil.errors import DriveError
from tests.canopen_bench import NODE, SDO_REQUEST, Bench, BenchBus, Driven, kill

SETTINGS = [
    *((base + k, subindex) for base in (0x1400, 0x1800) for k in range(4) for subindex in (1, 2, 5)),
    *((base + k, position) for base in (0x1600, 0x1A00) for k in range(4) for position in range(9)),
    *((index, 0) for index in (0x1017, 0x6007, 0x605A, 0x6060)),
    *((index, subindex) for index in (0x1016, 0x60C2) for subindex in (1, 2)),
]
MODES, QUICK_STOP_OPTION = 0x6060, 0x605A


@pytest.fixture
def bench():
    """A drive whose settings are not those that the daemon would write."""
    one = Bench()
    one.map(0x1400, 0x1600, 0x205, 255, [0x60400010, 0x60600008])
    one.map(0x1401, 0x1601, 0x305, 1, [0x60400010, 0x607A0020])
    one.map(0x1800, 0x1A00, 0x185, 254, [0x60410010])
    one.map(0x1801, 0x1A01, 0x285, 255, [0x60410010, 0x60640020])
    for index, subindex, code, value in (
        (0x1017, 0, "H", 700),
        (QUICK_STOP_OPTION, 0, "h", 2),
        (MODES, 0, "b", 9),
        (0x60C2, 1, "B", 4),
    ):
        one.write(index, subindex, code, value)
    return one


def settings(bench):
    """What a drive holds, by index and sub-index; abort codes as negative numbers."""
    values = {}
    for index, subindex in SETTINGS:
        [(_, answer)] = bench.sdo(struct.pack("<BHB4x", 0x40, index, subindex))
        value = struct.unpack_from("<I", answer, 4)[0]
        is_unused = index in range(0x1600, 0x1C00) and subindex > values.get((index, 0), 0) and index & 0x200
        values[index, subindex] = None if is_unused and subindex else -value if answer[0] == 0x80 else value
    return values


def make(bench, mode="cst", **options):
    return Driven(mode, bus=BenchBus(bench), **options)


def writes(bus):
    """Frames that change something: SDO downloads, NMT, SYNC, PDOs."""
    return [frame for frame in bus.sent if not (frame[0] == SDO_REQUEST and frame[1][0] >> 5 in (2, 3))]


def run(driven):
    driven.drives.start()
    driven.cycle(count=10)
    driven.cycle(Request.DISABLE, count=10)


# --- looking before touching


@pytest.mark.parametrize(("dry_run", "code"), [(False, "friction-hil stop.*FH-215"), (True, "FH-221")])
def test_a_powered_drive_is_not_touched(bench, dry_run, code):
    """In a dry run, TPDOs that come only on a change are missed."""
    bench.nmt(0x01)
    bench.enable(9)
    driven = make(bench, dry_run=dry_run)
    with pytest.raises(DriveError, match=code), driven:
        pass
    assert writes(driven.bus) == []
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
    driven = make(bench)
    driven.bus.hear(*HEARD[what])
    with pytest.raises(DriveError, match="FH-203") as caught, driven:
        pass
    assert what in str(caught.value)
    assert writes(driven.bus) == []


@pytest.mark.parametrize(
    "frame", [(0x709, b"\x05"), (0x206, b"\0\0"), (0x000, b"\x01\x06"), (0x186, b""), (0x606, b""), (0x705, b"\x7f")]
)
def test_what_concerns_other_nodes_is_not_a_master_of_ours(bench, frame):
    driven = make(bench)
    driven.bus.hear(*frame)
    assert [facts.name for facts in driven.drives.connect()] == ["x"]
    is_told = any(can_id == 0 for can_id, _ in driven.bus.sent)
    assert is_told is (frame[0] != 0x705), "it is pre-operational already"
    driven.close()


def test_a_master_that_appears_in_mid_run_is_a_fault_and_told_beside_a_restart(bench):
    with make(bench) as driven:
        assert driven.cycle(count=5).message == ""
        driven.bus.hear(0x080)
        assert driven.cycle().message.endswith("SYNC (080h) [FH-220]")
    with make(bench) as driven:
        driven.cycle(count=5)
        driven.bus.hear(0x000, bytes([0x81, NODE]))
        driven.bus.hear(0x700 + NODE, b"\0")
        assert driven.cycle(count=3).message.endswith("[FH-231]")
        [told] = [notice for notice in driven.feedback.notices if "FH-220" in notice]
        assert told.endswith(f"NMT reset node to node {NODE} [FH-220]")


def test_frames_that_come_back_are_not_another_masters(bench):
    """As on udp_multicast; one more of a kind than was sent is."""

    class Echoing(BenchBus):
        def send(self, msg, timeout=None):
            self.answers.put(msg)
            super().send(msg)

    class OnMulticast(Driven):
        def changed(self, config):
            bus = config.bus.model_copy(update={"interface": "udp_multicast", "channel": "239.74.163.9"})
            return config.model_copy(update={"bus": bus})

    with OnMulticast("cst", bus=Echoing(bench)) as driven:
        assert driven.cycle(count=20).message == ""
        driven.bus.hear(0x205, bytes(4))
        driven.cycle(Request.DISABLE, count=2)
        assert "RPDO 1 (205h) to node 5 [FH-220]" in driven.feedback.message


class Streaming(BenchBus):
    """Another master sends SYNC and an RPDO whenever the listener waits for a frame."""

    def _recv_internal(self, timeout):
        if self.answers.empty() and timeout:
            for frame in ((0x205, b"\x0f\0\x09"), (0x080, b"")):
                self.hear(*frame)
                for answer in self.bench.send(*frame):
                    self.hear(*answer)
            time.sleep(0.001)
        return super()._recv_internal(timeout)


@pytest.mark.parametrize("kind", [1, 255])
def test_a_dry_run_beside_another_master_shows_the_feedback_and_touches_nothing(bench, kind, folder):
    bench.map(0x1800, 0x1A00, 0x185, 1, [0x60770010, 0x60410010, 0x60640020])
    bench.map(0x1801, 0x1A01, 0x285, kind, [0x606C0020])
    bench.nmt(0x01)
    bench.enable(9)
    bench.write(0x60FF, 0, "i", 100_000)
    if kind == 255:
        bench.write(0x1801, 5, "H", 1)
    before = settings(bench)
    with Driven("csv", bus=Streaming(bench), dry_run=True) as driven:
        (note,) = [note for note in driven.facts.notes if "another master drives it" in note]
        assert "SYNC (080h)" in note
        assert "RPDO 1 (205h) to node 5" in note
        positions = []
        for _ in range(30):
            feedback = driven.cycle(velocity=5.0)
            assert (feedback.is_fresh, feedback.message) == (True, "")
            positions.append(feedback.position)
        assert feedback.state is DriveState.OPERATION_ENABLED
        assert feedback.velocity == pytest.approx(0.6, rel=0.2)
        assert positions == sorted(positions)
    assert writes(driven.bus) == []
    assert settings(bench) == before
    assert list(folder.iterdir()) == []


def test_a_dry_run_beside_another_master_needs_position_and_state(bench):
    """TPDOs 1 and 2 of this drive carry no torque, velocity or mode: these are done without."""
    bench.map(0x1801, 0x1A01, 0x285, 1, [0x60410010])
    bench.nmt(0x01)
    with pytest.raises(DriveError, match=r"6064h.*FH-221"), Driven("cst", bus=Streaming(bench), dry_run=True):
        pass


# --- as it was found


@pytest.mark.parametrize("how", [{"mode": "csp"}, {"mode": "csv"}, {"mode": "cst"}, {"dry_run": True}], ids=str)
def test_a_run_leaves_the_drive_as_it_was_found(bench, how, folder):
    before = settings(bench)
    driven = make(bench, **how)
    driven.drives.connect()
    assert settings(bench) != before
    run(driven)
    assert driven.drives.close() == [DriveState.UNKNOWN if "dry_run" in how else DriveState.SWITCH_ON_DISABLED]
    assert driven.drives.leftovers == []
    assert settings(bench) == before
    assert list(folder.iterdir()) == []


def test_a_refusal_leaves_the_drive_as_it_was_found(bench, folder):
    """Found out in the middle of the configuration, after the RPDOs: the TPDOs are fixed and do not come with SYNC."""
    before = settings(bench)
    driven = make(bench)
    driven.bus.refused = {(base + k, 1): 0x06010002 for base in (0x1800, 0x1A00) for k in range(4)}
    with pytest.raises(DriveError, match=r"FH-227"), driven:
        pass
    assert settings(bench) == before
    assert list(folder.iterdir()) == []


@pytest.mark.parametrize("is_run", [False, True])
def test_after_a_kill_the_next_run_restores_what_the_first_one_found(bench, folder, is_run):
    before = settings(bench)
    killed = make(bench)
    killed.drives.connect()
    if is_run:
        run(killed)
    kill(killed.drives)
    assert settings(bench) != before
    driven = make(bench, "csp")
    (facts,) = driven.drives.connect()
    assert any("ended without restoring" in note for note in facts.notes)
    run(driven)
    driven.close()
    assert driven.drives.leftovers == []
    assert settings(bench) == before
    assert list(folder.iterdir()) == []


@pytest.mark.parametrize("is_damaged", [False, True])
def test_a_value_that_somebody_changed_after_a_kill_is_his_and_a_damaged_journal_is_told(bench, folder, is_damaged):
    killed = make(bench)
    killed.drives.connect()
    kill(killed.drives)
    if is_damaged:
        [path] = folder.iterdir()
        path.write_text('{"version": 1, "ent')
    bench.write(QUICK_STOP_OPTION, 0, "h", 5)
    with make(bench) as driven:
        assert any("it is damaged" in note for note in driven.facts.notes) is is_damaged
    assert bench.read(QUICK_STOP_OPTION, 0, "h") == 5
    assert (bench.read(MODES, 0, "b") == 9) is not is_damaged


def test_a_drive_in_the_nmt_state_stopped_is_disabled_all_the_same():
    """A stopped node has no SDO; without a heartbeat nothing says so, and many drives go on with their set-point."""
    bench = Bench(missing=(0x1016, 0x1017, 0x100C, 0x100D), manners={"nmt_stops_drive": False})
    driven = make(bench).start()
    assert driven.cycle(count=10).state is DriveState.OPERATION_ENABLED
    bench.nmt(0x02)
    assert driven.drives.close() == [DriveState.SWITCH_ON_DISABLED]
    assert bench.statusword & 0x6F == 0x40
    assert not [text for text in driven.drives.leftovers if "FH-222" in text]


def test_what_cannot_be_restored_is_told_one_by_one(bench, folder):
    driven = make(bench)
    driven.drives.connect()
    driven.bus.refused = {(index, 1): 0x08000022 for index in (QUICK_STOP_OPTION, MODES)}
    driven.drives.close()
    assert [text.partition(": ")[2].partition(": ")[2] for text in driven.drives.leftovers] == [
        "6060h modes of operation was 09h and stays 0Ah [FH-222]",
        "605Ah quick stop option code was 0002h and stays 0006h [FH-222]",
    ]
    [path] = folder.iterdir()  # for the next time
    assert {entry["index"] for entry in json.loads(path.read_text())["entries"]} == {QUICK_STOP_OPTION, MODES}
    assert path.stat().st_mode & 0o777 == 0o600


def test_a_drive_that_keeps_its_power_is_not_restored(bench):
    driven = make(bench)
    driven.drives.connect()
    run(driven)
    bench.write(0x6007, 0, "h", 0)  # it does not react to leaving Operational
    before = settings(bench)
    bench.enable(10)
    driven.bus.loses = lambda can_id, data: can_id == SDO_REQUEST and data[1:3] == b"\x40\x60"
    assert driven.drives.close() == [DriveState.OPERATION_ENABLED]
    assert settings(bench) == before
    (text,) = driven.drives.leftovers
    assert text.startswith("x: not restored in node 5 on virtual")
    assert "6060h modes of operation was 09h" in text
    assert text.endswith("is operation enabled [FH-222]")


def test_a_drive_that_is_gone_is_told_and_does_not_take_long(bench):
    driven = make(bench).start()
    driven.bus.loses = lambda can_id, data: True
    assert driven.drives.close() == [DriveState.UNKNOWN]
    (text,) = driven.drives.leftovers
    assert "6060h modes of operation was 09h" in text
    assert text.endswith("not answer [FH-222]")


def test_commands_and_set_points_are_no_settings(bench):
    """A target written back would be a target nobody asked for."""
    driven = make(bench, "csp")
    driven.drives.connect()
    driven.bus.sent.clear()
    driven.drives.close()
    assert driven.bus.downloads
    assert not {0x6040, 0x6071, 0x607A, 0x60B2, 0x60FF, 0x1000} & set(driven.bus.downloads)
