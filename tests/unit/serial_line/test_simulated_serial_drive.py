"""A simulated serial drive behind its signals: device control, commands, watchdog, units."""

import math

import pytest
from friction_hil_drivers.ascii import DESCRIPTIONS
from friction_hil_drivers.ascii.description import AsciiDescription
from friction_hil_drivers.serial_line.description import load_description
from friction_hil_drivers.serial_line.sequences import Sequencer, state_of
from friction_hil_drivers.serial_line.simulated import RefusedError, SimulatedDrive
from friction_hil_drivers.serial_line.units import AxisUnits
from hypothesis import given, settings
from hypothesis import strategies as st

from friction_hil.drive import DriveState, Mode, Request
from friction_hil.errors import UsageError
from friction_hil.servo.config import ServoConfig
from friction_hil.servo.servo import Servo
from tests.serial_bench import CIA402, COUNTS, OWN, PLAIN, RATED, STEPS_PER_MS, make_drive

DISABLED, ENABLED, READY = DriveState.SWITCH_ON_DISABLED, DriveState.OPERATION_ENABLED, DriveState.READY_TO_SWITCH_ON
STOPPING, FAULT = DriveState.QUICK_STOP_ACTIVE, DriveState.FAULT
ENABLE = {
    "cia402": [("control", 0x06), ("control", 0x07), ("control", 0x0F)],
    "own": [("request", 2), ("key", 1), ("request", 3)],
}


def shown_state(drive):
    """Return the state that the drive's numbers show to the driver."""
    return state_of(drive.description, {name: drive.read(name) for name in drive.description.units()})


def sample(drive, count=1):
    for _ in range(count):
        drive.sample()


def enabled(*args, **options):
    drive = make_drive(*args, **options)
    enable(drive)
    return drive


def enable(drive):
    for name, number in ENABLE[drive.description.state_machine]:
        drive.write(name, number)
    assert shown_state(drive) is ENABLED


MOVING = {"velocity_command": 20.0 * COUNTS, "torque_command": 0}


@pytest.mark.parametrize(
    ("description", "mode", "push", "stop", "repeated"),
    [
        (CIA402, Mode.CSV, MOVING, ("control", 0x02), ("control", 0x0F)),
        (OWN, Mode.CST, {"torque_command": 0.1}, ("request", 5), ("request", 5)),
    ],
    ids=["cia402", "own"],
)
def test_a_quick_stop_ramps_down_to_rest_and_ends_without_power(description, mode, push, stop, repeated):
    drive = enabled(description, mode)
    for _ in range(60):
        for name, number in push.items():
            drive.write(name, number)
        sample(drive)
    speed = drive.servo.true_velocity
    assert speed > 1.0
    drive.write(*stop)
    for _ in range(3):
        assert shown_state(drive) is STOPPING
        drive.write(*repeated)  # neither enables it again nor begins the ramp anew
        assert shown_state(drive) is STOPPING
        sample(drive)
    assert 0.0 < drive.servo.true_velocity < speed - 0.5  # without power 0.15 would be lost
    sample(drive, 700)
    assert shown_state(drive) is DISABLED
    assert abs(drive.servo.true_velocity) < 0.05


def test_a_fault_is_left_by_its_own_steps_alone():
    drive = enabled(OWN)
    drive.fail()
    for number in (2, 3, 1, 5, 0, 9):  # 0 is the second step of the reset, without the first one
        drive.write("request", number)
        assert (shown_state(drive), drive.read("error")) == (FAULT, 4)
    drive.write("request", 0)
    assert (shown_state(drive), drive.read("error")) == (DISABLED, 0)
    drive.fail()
    drive.write("request", 0)  # what was done about the last fault does not help against this one
    assert shown_state(drive) is FAULT


NUMBERS = {
    "cia402": [("control", word) for word in (0x00, 0x02, 0x06, 0x07, 0x0F, 0x80, 0x8F)] + [("torque_command", 100.0)],
    "own": [("request", n) for n in (0, 1, 2, 3, 5, 9)] + [("key", 1.0), ("torque_command", 0.1), ("lifetime", 0.005)],
}


@pytest.mark.deep
@pytest.mark.parametrize("kind", ["cia402", "own"])
@settings(max_examples=60, deadline=None)
@given(events=st.lists(st.integers(0, 12), max_size=40))
def test_whatever_is_written_the_numbers_tell_the_state_and_torque_needs_power(kind, events):
    drive = make_drive(CIA402 if kind == "cia402" else OWN)
    numbers = NUMBERS[kind]
    for event in events:
        before = drive.state
        if event < len(numbers):
            drive.write(*numbers[event])
        elif event == 11:
            drive.fail()
        else:
            sample(drive, 3)
            assert drive.state.is_powered or drive.servo.torque_demand == 0.0
        assert shown_state(drive) is drive.state
        assert not (before is FAULT and drive.state is ENABLED)
    sample(drive)
    assert drive.state.is_powered or drive.servo.torque_demand == 0.0
    # from wherever it is, the driver's own way leads to an enabled drive
    sequencer, cycles = Sequencer(drive.description), 0
    for request in (Request.RESET_FAULT, Request.DISABLE, Request.ENABLE):
        for _ in range(700):
            cycles += 1
            step = sequencer.next_write(request, shown_state(drive), cycles * 1e-3)
            if not step and drive.state is not STOPPING:
                break
            for name, number in step.items():
                drive.write(name, number)
            sequencer.acknowledge()
            drive.fed()
            sample(drive)
    assert shown_state(drive) is ENABLED


def test_torque_is_an_offset_in_csp_and_commands_may_come_one_by_one():
    apart, together = enabled(mode=Mode.CSP), Servo(ServoConfig.model_validate(PLAIN))
    together.command(Mode.CSP, 0.0)
    for k in range(50):
        position = 1e-4 * k * k
        apart.write("position_command", position * COUNTS)
        apart.write("torque_command", 30)
        together.command(Mode.CSP, position, 0.0, 0.030 * RATED)
        sample(apart)
        together.advance(80)
    assert apart.servo.true_position == pytest.approx(together.true_position, abs=1e-9)
    assert apart.servo.true_position == pytest.approx(1e-4 * 48**2, abs=0.02)


@pytest.mark.parametrize(
    ("name", "number"),
    [("position", 0.0), ("nonsense", 0.0), ("mode", 3.0), ("torque_command", math.nan), ("lifetime", -1.0)],
)
def test_what_cannot_be_written_is_refused(name, number):
    drive = make_drive()
    drive.write("mode", 9)
    with pytest.raises(RefusedError, match=f"^{name} cannot be (written|{number:g})"):
        drive.write(name, number)
    assert (drive.read("mode"), drive.read("torque_command"), drive.read("lifetime")) == (9, 0, 0)


IN_AMPERES = {**CIA402, "signals": {**CIA402["signals"], "torque": {"unit": "A"}}}
UNTOLD = {**OWN, "states": [rule for rule in OWN["states"] if rule["state"] != "switched_on"]}


@pytest.mark.parametrize(
    ("description", "mode", "words"),
    [
        (UNTOLD, Mode.CST, "tiny own.*switched_on"),
        (OWN, Mode.CSP, "tiny own has no mode csp"),
        (IN_AMPERES, Mode.CST, "tiny 402.*torque_constant"),
    ],
)
def test_a_description_that_no_drive_can_have_is_refused(description, mode, words):
    with pytest.raises(UsageError, match=words):
        make_drive(description, mode)


def with_watchdog(**options):
    drive = make_drive(**options)
    drive.write("lifetime", 20)  # ms
    drive.write("lifetime_on", 1)
    enable(drive)
    return drive


def test_silence_ends_the_torque_within_a_period_and_is_a_fault():
    drive = with_watchdog(is_synchronous=False)
    drive.write("torque_command", 100)
    drive.advance_to(19_900_000)
    assert shown_state(drive) is ENABLED
    drive.advance_to(500_000_000)
    assert (shown_state(drive), drive.read("error")) == (FAULT, 42)
    drive.write("torque_command", 100)
    assert drive.servo.torque_demand == 0.0
    # all that time but 20 ms it coasted: the Coulomb friction needs 20 (0.064 - 0.01) / 0.01 = 108 ms to stop it
    assert drive.servo.true_velocity == 0.0


def test_without_supply_nothing_is_taken_and_then_all_is_as_at_first():
    drive = with_watchdog()
    drive.write("torque_command", 200)
    sample(drive, 10)
    position, speed = drive.servo.true_position, drive.servo.true_velocity
    drive.switch_off()
    drive.write("control", 0x06)
    sample(drive)
    assert drive.servo.torque_demand == 0.0
    assert drive.servo.true_position > position  # mechanics goes on
    assert drive.servo.true_velocity < speed + 1.0
    drive.switch_on()
    assert (shown_state(drive), drive.read("control"), drive.read("lifetime")) == (DISABLED, 0, 0)
    enable(drive)
    sample(drive, 100)
    assert shown_state(drive) is ENABLED  # the watchdog is off


def odrive():
    description = load_description("odrive", None, DESCRIPTIONS, AsciiDescription)
    servo = Servo(ServoConfig.model_validate(PLAIN))
    return SimulatedDrive("x", description, servo, Mode.CST, AxisUnits(torque_constant=0.1), STEPS_PER_MS)


@pytest.mark.parametrize("is_switched_on", [True, False])
def test_a_watchdog_with_a_switch_works_only_when_it_is_on_and_then_in_idle_too(is_switched_on):
    """As the description of the ODrive says, which therefore switches it off where there is no power."""
    drive = odrive()
    drive.write("watchdog", 0.02)
    drive.write("watchdog_enabled", float(is_switched_on))
    sample(drive, 19)
    assert shown_state(drive) is READY
    sample(drive, 2)
    assert shown_state(drive) is (FAULT if is_switched_on else READY)
    drive = odrive()
    for step in (*drive.description.enable, *drive.description.disable):
        for name, number in {"watchdog": 0.02, **step.write}.items():
            drive.write(name, number)
    sample(drive, 100)
    assert shown_state(drive) is READY
