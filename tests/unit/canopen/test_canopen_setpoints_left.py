"""However a run ends, no torque or velocity is left in a drive for whoever enables it next, or it is said."""

import struct
import tempfile

import can
import pytest
from friction_hil_drivers.canopen.commands.inventory import CanopenInventory
from friction_hil_drivers.canopen.wire.frames import FrameBus

from friction_hil.drive import Command, DriveState, Feedback, Request
from tests.canopen_bench import NODE, Bench, BenchBus, Driven, kill
from tests.servo_drives import axis_dict, configuration

MODES = ("csp", "csv", "cst")
TARGET = {"csp": 0x60B2, "csv": 0x60B2, "cst": 0x6071}  # where the torque goes
CODES = {0x60B2: "h", 0x6071: "h", 0x60FF: "i"}
RPDOS = range(0x200, 0x580)
SDO_REQUEST, SDO_ANSWER = 0x600 + NODE, 0x580 + NODE
CANNOT_BE_STORED = 0x08000022


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    """Locks and journals of these tests are not those of others."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    return tmp_path


class Refusing(BenchBus):
    """A drive that aborts some SDO requests: (index, client's command specifier)."""

    def __init__(self, bench, refused=()):
        super().__init__(bench)
        self.refused = set(refused)

    def send(self, msg, timeout=None):
        data = bytes(msg.data)
        if msg.arbitration_id == SDO_REQUEST and (struct.unpack_from("<H", data, 1)[0], data[0] >> 5) in self.refused:
            answer = b"\x80" + data[1:4] + struct.pack("<I", CANNOT_BE_STORED)
            self.answers.put(can.Message(arbitration_id=SDO_ANSWER, data=answer, is_extended_id=False))
            return
        super().send(msg, timeout)


def started(bus, mode="csp", *, dry_run=False):
    return Driven(mode, bus=bus, dry_run=dry_run).start().drives


def cycles(drives, request, torque=0.05, velocity=1.0):
    feedback = Feedback()
    for _ in range(10):
        drives.receive([feedback], 0)
        drives.send([Command(request, torque=torque, velocity=velocity)])
    return feedback


def moving(bus, mode):
    """A run in which the drive holds a torque, and a velocity in csv."""
    drives = started(bus, mode)
    assert cycles(drives, Request.ENABLE).state is DriveState.OPERATION_ENABLED
    assert bus.bench.read(TARGET[mode], 0, "h") != 0
    if mode == "csv":
        assert bus.bench.read(0x60FF, 0, "i") != 0
    return drives


def left(bench):
    return {index: bench.read(index, 0, code) for index, code in CODES.items()}


NOTHING = dict.fromkeys(CODES, 0)


def inventory(bus):
    return CanopenInventory(configuration(x=axis_dict(node=NODE)).bus, FrameBus(bus, "of the bench"))


@pytest.mark.parametrize("mode", MODES)
def test_rpdos_that_do_not_arrive_any_more_leave_nothing(mode):
    bus = BenchBus(Bench())
    drives = moving(bus, mode)
    bus.loses = lambda can_id, data: can_id in RPDOS
    cycles(drives, Request.QUICK_STOP, torque=0.0, velocity=0.0)
    assert left(bus.bench) != NOTHING
    [state] = drives.close()
    assert not state.is_powered
    assert left(bus.bench) == NOTHING
    assert drives.leftovers == []


@pytest.mark.parametrize("mode", MODES)
def test_after_a_kill_the_next_run_clears_what_was_left(mode):
    bus = BenchBus(Bench())
    kill(moving(bus, mode))
    bus.bench.write(0x6040, 0, "H", 0)
    assert left(bus.bench) != NOTHING
    bus.bench.write(TARGET[mode], 0, "h", 77)  # not what was written: it would act all the same
    started(BenchBus(bus.bench), "csp", dry_run=True).close()  # which writes nothing
    drives = started(BenchBus(bus.bench), "csp")
    drives.close()
    assert left(bus.bench) == NOTHING
    assert drives.leftovers == []


@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize("is_powered", [True, False])
def test_a_stop_clears_what_a_killed_run_left(mode, is_powered):
    bus = BenchBus(Bench())
    kill(moving(bus, mode))
    if not is_powered:
        bus.bench.write(0x6040, 0, "H", 0)
    [stop] = inventory(BenchBus(bus.bench)).stop([NODE])
    assert (stop.result, stop.is_proved) == ("stopped" if is_powered else "unpowered", True)
    assert left(bus.bench) == NOTHING


@pytest.mark.parametrize("is_in_fault", [True, False])
def test_a_reset_clears_what_a_killed_run_left(is_in_fault):
    bus = BenchBus(Bench())
    kill(moving(bus, "csp"))
    bus.bench.write(0x6040, 0, "H", 0)
    if is_in_fault:
        bus.bench.node.drive.fault(0x2310, bus.bench.node.now_ns)
        bus.bench.sync(100)
    report = inventory(BenchBus(bus.bench)).reset_axes({"x": (NODE, 0)})
    assert [stop.is_proved for stop in report.stops] == [True]
    assert left(bus.bench) == NOTHING


def test_a_drive_that_keeps_its_offset_is_told_by_the_run_and_by_the_stop():
    bus = Refusing(Bench())
    drives = moving(bus, "csp")
    bus.loses = lambda can_id, data: can_id in RPDOS
    bus.refused = {(0x60B2, 1)}
    value = bus.bench.read(0x60B2, 0, "h")
    drives.close()
    [text] = drives.leftovers
    assert text.endswith(f"60B2h torque offset is to be 0 and stays {value & 0xFFFF:04X}h [FH-222]")
    [stop] = inventory(bus).stop([NODE])
    assert not stop.is_proved
    assert stop.reason.startswith(f"60B2h torque offset stays {value} (writing 0: refused, SDO abort 08000022h")
    drives = started(BenchBus(bus.bench))
    drives.close()
    assert left(bus.bench) == NOTHING, "the next run tries again"


def test_a_set_point_that_cannot_be_read_is_written_and_called_unknown():
    bus = Refusing(Bench())
    bus.refused = {(0x6071, 2)}
    drives = moving(bus, "csp")
    bus.bench.write(0x6071, 0, "h", 50)
    drives.close()
    assert left(bus.bench) == NOTHING
    [text] = drives.leftovers
    assert text.endswith("stays not shown [FH-222]")
    bus.bench.write(0x6071, 0, "h", 50)
    [stop] = inventory(bus).stop([NODE])
    assert left(bus.bench) == NOTHING
    assert (stop.is_proved, stop.reason) == (False, "6071h target torque cannot be read back [FH-222]")


def test_objects_that_a_drive_does_not_have_are_not_asked_for_a_value():
    bench = Bench(missing=(0x60FF, 0x6071))
    bus = BenchBus(bench)
    drives = started(bus)
    cycles(drives, Request.ENABLE)
    drives.close()
    assert not [text for text in drives.leftovers if "to be 0" in text]
    [stop] = inventory(bus).stop([NODE])
    assert (stop.is_proved, stop.reason) == (True, "")
    written = {
        struct.unpack_from("<H", data, 1)[0] for can_id, data in bus.sent if can_id == SDO_REQUEST and data[0] >> 5 == 1
    }
    assert not written & {0x60FF, 0x6071}


def test_a_dry_run_writes_no_set_point():
    """Whose it is, is not known: a drive that was found with one keeps it."""
    bench = Bench()
    bench.write(0x60B2, 0, "h", 33)
    drives = started(BenchBus(bench), dry_run=True)
    cycles(drives, Request.ENABLE)
    drives.close()
    assert left(bench)[0x60B2] == 33
