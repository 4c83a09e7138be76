"""PDO mapping against a simulated drive's SDO server, and what a cycle costs on the wire."""

import pytest
from friction_hil_drivers.canopen.connect.mapping import PdoRecord, check_bus_load, frame_bits, switch_off, wire_time_s
from friction_hil_drivers.canopen.connect.negotiation import PdoNegotiator
from friction_hil_drivers.canopen.sdo.client import SdoNetwork
from friction_hil_drivers.canopen.wire import cia301
from friction_hil_drivers.cia402 import objects
from friction_hil_drivers.cia402.codec import COMMANDS, FEEDBACK

from friction_hil.drive import Mode
from friction_hil.errors import DriveError
from tests.canopen_bench import NODE, Bench, BenchBus
from tests.vendor_drives import INTEGER32, VendorDrive


class Wire(BenchBus):
    """``garble`` may change the answers of the drive."""

    def __init__(self, bench):
        super().__init__(bench)
        self.garble = lambda data: data

    def answers_of(self, can_id, data):
        return [(answer_id, self.garble(answer)) for answer_id, answer in super().answers_of(can_id, data)]


class Drive:
    """A simulated drive and the SDO access to it."""

    def __init__(self, **settings):
        self.bench = Bench(**settings)
        self.wire = Wire(self.bench)
        self.access = SdoNetwork(self.wire).client(NODE, "x", f"node {NODE} on a wire")

    def negotiate(self, entries, *, is_receive=False, taken=None, **how):
        return PdoNegotiator(self.access, is_receive=is_receive, node=NODE, taken=taken).negotiate(entries, **how).pdos

    def map(self, entries, *, is_receive=False):
        [pdo] = self.negotiate(entries, is_receive=is_receive)
        return pdo

    def mapped(self, index):
        return [self.bench.read(index, position) for position in range(1, self.bench.read(index, 0, "B") + 1)]

    def switch_off(self, number):
        """Switch TPDO off; return the requests."""
        self.wire.sent.clear()
        switch_off(self.access, PdoRecord(False, number, NODE))
        return [data[:4].hex() for _, data in self.wire.sent]


@pytest.fixture
def make():
    drives = []

    def one(**settings):
        drives.append(Drive(**settings))
        return drives[-1]

    yield one
    for drive in drives:
        drive.wire.shutdown()


@pytest.fixture
def drive(make):
    return make()


def test_feedback_is_mapped_and_comes_with_every_sync(drive):
    pdos = drive.negotiate([*FEEDBACK[0], *FEEDBACK[1]])
    assert [(pdo.cob_id, pdo.layout.format) for pdo in pdos] == [(0x185, "<Hih"), (0x285, "<ib")]
    assert drive.mapped(0x1A00) == [0x60410010, 0x60640020, 0x60770010]
    assert drive.bench.read(0x1800, 2, "B") == 1
    drive.bench.nmt(0x01)
    frames = dict(drive.bench.sync())
    assert {can_id: len(data) for can_id, data in frames.items()} == {0x185: 8, 0x285: 5}
    word, counts, _ = pdos[0].layout.unpack(frames[0x185])
    assert word & 0x6F == 0x40
    assert counts == drive.bench.read(0x6064, 0, "i")


@pytest.mark.parametrize("mode", Mode)
def test_commands_are_mapped_and_take_effect(drive, mode):
    pdo = drive.map(COMMANDS[mode], is_receive=True)
    assert pdo.cob_id == 0x205
    drive.bench.nmt(0x01)
    drive.bench.send(pdo.cob_id, pdo.layout.pack(0x06, *range(5, 5 + len(COMMANDS[mode]) - 1)))
    drive.bench.sync()
    assert drive.bench.statusword & 0x6F == 0x21
    assert drive.bench.read(COMMANDS[mode][1].index, 0, "i" if mode is not Mode.CST else "h") == 5


def test_mapping_again_replaces_what_was_there_while_the_pdo_is_switched_off(drive):
    """As CiA 301 prescribes; a drive refuses it otherwise. Bit 30, no RTR, stays as it was."""
    drive.map(FEEDBACK[0])
    drive.wire.sent.clear()
    pdo = drive.map(FEEDBACK[1])
    assert len(drive.mapped(0x1A00)) == len(pdo.entries) == 2
    downloads = [data for _, data in drive.wire.sent if data[0] & 0xE0 == 0x20]
    assert drive.wire.downloads[0] == drive.wire.downloads[-1] == 0x1800
    assert [int.from_bytes(downloads[k][4:8], "little") for k in (0, -1)] == [0xC0000185, 0x40000185]
    assert drive.bench.read(0x1800, 1) == 0x40000185


def test_the_width_is_the_drives_own(tmp_path, make):
    """60B2h has 32 bits in some drives: mapped with 16 every later field would be plausible garbage."""
    drive = make(eds=VendorDrive(values={("60B2", "DataType"): INTEGER32}).write(tmp_path / "wide.eds"))
    pdo = drive.map(COMMANDS[Mode.CSV][::2], is_receive=True)  # controlword and torque offset
    assert pdo.layout.format == "<Hi"
    assert drive.bench.read(0x1600, 2) == 0x60B20020
    csp = drive.negotiate(COMMANDS[Mode.CSP], is_receive=True)  # ten bytes
    assert [(pdo.cob_id, pdo.entries, pdo.layout.format) for pdo in csp] == [
        (0x205, COMMANDS[Mode.CSP][:2], "<Hi"),
        (0x305, COMMANDS[Mode.CSP][2:], "<i"),
    ]


def test_a_missing_object_is_named(make):
    drive = make(missing=[0x60B2])
    with pytest.raises(DriveError, match=r"x: node 5 on a wire .*60B2h torque offset"):
        drive.map(COMMANDS[Mode.CSP], is_receive=True)


def test_a_drive_that_keeps_another_mapping_is_refused(drive):
    other = bytes.fromhex("20006c60")
    drive.wire.garble = lambda data: data[:4] + other if data[:4] == bytes.fromhex("43001a02") else data
    assert [pdo.cob_id for pdo in drive.negotiate(FEEDBACK[0])] == [0x285]  # the next one takes it
    drive.wire.garble = lambda data: data[:4] + other if data[3] == 2 and data[0] == 0x43 else data
    with pytest.raises(DriveError, match=r"TPDO 1 of node 5 on a wire .*606C0020h at position 2 after 60640020h"):
        drive.negotiate([*FEEDBACK[0], *FEEDBACK[1], objects.FOLLOWING_ERROR, objects.POSITION_DEMAND])


def test_unused_pdos_are_switched_off_once_and_not_where_there_are_none(drive, make):
    drive.bench.map(0x1802, 0x1A02, 0x385, 1, [0x60640020])
    drive.switch_off(2)
    assert drive.bench.read(0x1802, 1) & cia301.PDO_INVALID
    assert {request[:2] for request in drive.switch_off(2)} == {"40"}  # it only looked
    assert make(missing=[0x1803, 0x1A03]).switch_off(3) == ["40031801"]


# --- time on the wire: figures of CAN at 1 Mbit/s with worst-case stuffing


@pytest.mark.parametrize(("axes", "microseconds"), [(1, 285), (2, 515), (3, 745), (4, 975)])
def test_a_cycle_takes_its_known_time(drive, axes, microseconds):
    feedback = drive.map(FEEDBACK[0])  # 8 bytes
    command = drive.map(COMMANDS[Mode.CST], is_receive=True)  # 4 bytes
    assert {size: frame_bits(size) for size in (0, 4, 8)} == {0: 55, 4: 95, 8: 135}
    assert wire_time_s(1_000_000, [feedback, command] * axes) == pytest.approx(microseconds * 1e-6)


def test_a_cycle_that_does_not_fit_is_refused_with_the_arithmetic(drive):
    pdos = [*drive.negotiate([*FEEDBACK[0], *FEEDBACK[1]]), drive.map(COMMANDS[Mode.CSP], is_receive=True)]
    bits = 55 + 135 + frame_bits(5) + 135
    two, three = (55 + axes * (bits - 55) for axes in (2, 3))
    assert check_bus_load(1_000_000, 1e-3, pdos * 2) == f"a cycle needs {two} µs of 1000 µs on the bus at 1000000 bit/s"
    assert f"needs {2 * bits} µs of {4 * bits} µs" in check_bus_load(500_000, 2.0 * bits / 500_000, pdos)
    told = rf"needs {three} µs on the bus at 1000000 bit/s \(SYNC 55 \+ PDOs 135 \+.*90 % of the period of 1000 µs"
    with pytest.raises(DriveError, match=told):
        check_bus_load(1_000_000, 1e-3, pdos * 3)
