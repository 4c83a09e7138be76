"""However a run ends, no torque or velocity is left in a drive for whoever enables it next, or it is said."""

import pytest
from friction_hil_drivers.canopen.commands.inventory import CanopenInventory
from friction_hil_drivers.canopen.wire.frames import FrameBus

from friction_hil.drive import DriveState, Request
from tests.canopen_bench import NODE, Bench, BenchBus, Driven, kill
from tests.servo_drives import axis_dict, configuration

# where the torque goes, by the mode; the last two give it as a velocity offset
TARGET = {"csp": 0x60B2, "csv": 0x60B2, "cst": 0x6071, "csp by velocity": 0x60B1, "csv by velocity": 0x60B1}
CODES = {0x60B2: "h", 0x60B1: "i", 0x6071: "h", 0x60FF: "i"}
LOOP = {"velocity_gain": 0.1, "integral_hz": 10.0, "limit": 5.0, "slew": 1e4}
NOTHING = dict.fromkeys(CODES, 0)
RPDOS = range(0x200, 0x580)
CANNOT_BE_STORED = 0x08000022
in_each_mode = pytest.mark.parametrize("mode", TARGET)


def started(bus, mode="csp", *, dry_run=False):
    mode, _, is_by_velocity = mode.partition(" ")
    keys = {"compensation": {"velocity_offset": LOOP}} if is_by_velocity else {}
    return Driven(mode, bus=bus, dry_run=dry_run, **keys).start()


def moving(mode, bus=None):
    """A run in which the drive holds a torque, and a velocity in csv."""
    one = started(bus or BenchBus(), mode)
    one.cycle(count=10, torque=0.05, velocity=1.0, velocity_offset=0.5)
    assert one.feedback.state is DriveState.OPERATION_ENABLED
    assert one.bench.read(TARGET[mode], 0, CODES[TARGET[mode]]) != 0
    assert one.facts.takes_velocity_offset is (TARGET[mode] == 0x60B1)
    assert mode[:3] != "csv" or one.bench.read(0x60FF, 0, "i") != 0
    return one


def killed(mode, *, is_powered=False):
    """The drive of a run that was killed; it may have lost its power since then."""
    one = moving(mode)
    kill(one.drives)
    if not is_powered:
        one.bench.write(0x6040, 0, "H", 0)
    assert left(one.bench) != NOTHING
    return one.bench


def left(bench):
    return {index: bench.read(index, 0, code) for index, code in CODES.items()}


def inventory(bus):
    return CanopenInventory(configuration(x=axis_dict(node=NODE)).bus, FrameBus(bus, "of the bench"))


@in_each_mode
def test_rpdos_that_do_not_arrive_any_more_leave_nothing(mode):
    one = moving(mode)
    one.bus.loses = lambda can_id, data: can_id in RPDOS
    one.cycle(Request.QUICK_STOP, count=10)
    assert left(one.bench) != NOTHING
    [state] = one.drives.close()
    assert not state.is_powered
    assert left(one.bench) == NOTHING
    assert one.drives.leftovers == []


@in_each_mode
def test_after_a_kill_the_next_run_clears_what_was_left(mode):
    bench = killed(mode)
    bench.write(TARGET[mode], 0, CODES[TARGET[mode]], 77)  # not what was written: it would act all the same
    started(BenchBus(bench), dry_run=True).drives.close()  # which writes nothing
    assert left(bench) != NOTHING
    drives = started(BenchBus(bench)).drives
    drives.close()
    assert left(bench) == NOTHING
    assert drives.leftovers == []


@in_each_mode
@pytest.mark.parametrize("is_powered", [True, False])
def test_a_stop_clears_what_a_killed_run_left(mode, is_powered):
    bench = killed(mode, is_powered=is_powered)
    [stop] = inventory(BenchBus(bench)).stop([NODE])
    assert (stop.result, stop.is_proved) == ("stopped" if is_powered else "unpowered", True)
    assert left(bench) == NOTHING


@pytest.mark.parametrize("is_in_fault", [True, False])
def test_a_reset_clears_what_a_killed_run_left(is_in_fault):
    bench = killed("csp")
    if is_in_fault:
        bench.node.drive.fault(0x2310, bench.node.now_ns)
        bench.sync(100)
    report = inventory(BenchBus(bench)).reset_axes({"x": (NODE, 0)})
    assert [stop.is_proved for stop in report.stops] == [True]
    assert left(bench) == NOTHING


def test_a_drive_that_keeps_its_offset_is_told_by_the_run_and_by_the_stop():
    one = moving("csp")
    one.bus.loses = lambda can_id, data: can_id in RPDOS
    one.bus.refused = {(0x60B2, 1): CANNOT_BE_STORED}
    value = one.bench.read(0x60B2, 0, "h")
    one.drives.close()
    [text] = one.drives.leftovers
    assert text.endswith(f"60B2h torque offset is to be 0 and stays {value & 0xFFFF:04X}h [FH-222]")
    [stop] = inventory(one.bus).stop([NODE])
    assert not stop.is_proved
    assert stop.reason.startswith(f"60B2h torque offset stays {value} (writing 0: refused, SDO abort 08000022h")
    started(BenchBus(one.bench)).drives.close()
    assert left(one.bench) == NOTHING, "the next run tries again"


def test_a_set_point_that_cannot_be_read_is_written_and_called_unknown():
    one = moving("csp", BenchBus(refused={(0x6071, 2): CANNOT_BE_STORED}))
    one.bench.write(0x6071, 0, "h", 50)
    one.drives.close()
    assert left(one.bench) == NOTHING
    [text] = one.drives.leftovers
    assert "6071h" in text
    assert text.endswith("not shown [FH-222]")
    one.bench.write(0x6071, 0, "h", 50)
    [stop] = inventory(one.bus).stop([NODE])
    assert left(one.bench) == NOTHING
    assert not stop.is_proved
    assert stop.reason.startswith("6071h")
    assert stop.reason.endswith("[FH-222]")


def test_objects_that_a_drive_does_not_have_are_not_asked_for_a_value():
    one = started(BenchBus(Bench(missing=(0x60FF, 0x6071))))
    one.cycle(count=10, torque=0.05)
    one.drives.close()
    assert not [text for text in one.drives.leftovers if "to be 0" in text]
    [stop] = inventory(one.bus).stop([NODE])
    assert (stop.is_proved, stop.reason) == (True, "")
    assert not {0x60FF, 0x6071} & set(one.bus.downloads)


def test_a_dry_run_writes_no_set_point():
    """Whose it is, is not known: a drive that was found with one keeps it."""
    bench = Bench()
    bench.write(0x60B2, 0, "h", 33)
    one = started(BenchBus(bench), dry_run=True)
    one.cycle(count=10, torque=0.05)
    one.drives.close()
    assert left(bench)[0x60B2] == 33
