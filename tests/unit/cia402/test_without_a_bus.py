"""The objects of a drive without a bus: a simulated drive, its dictionary in memory, and a process image of bytes."""

import struct
from dataclasses import dataclass, field
from pathlib import Path

import pytest
from friction_hil_drivers.cia402 import objects, profile
from friction_hil_drivers.cia402.access import Abort, AbortError, RefusedError
from friction_hil_drivers.cia402.client import ObjectClient
from friction_hil_drivers.cia402.codec import (
    COMMANDS,
    FEEDBACK,
    CommandEncoder,
    FeedbackDecoder,
    Measurement,
    block_layout,
)
from friction_hil_drivers.cia402.journal import Journal
from friction_hil_drivers.cia402.load_encoder import LoadEncoderOptions, require_object, with_scale
from friction_hil_drivers.cia402.objects import INTERPOLATION_EXPONENT, INTERPOLATION_PERIOD, DataType, Object
from friction_hil_drivers.cia402.options import DriveOptions, Identity
from friction_hil_drivers.cia402.preparation import (
    check_mode,
    command_objects,
    feedback_objects,
    identify,
    prepare_mode,
)
from friction_hil_drivers.cia402.scales import read_units
from friction_hil_drivers.cia402.simulated.dictionary import Dictionary, Entry
from friction_hil_drivers.cia402.simulated.drive import SimulatedCia402Drive
from friction_hil_drivers.cia402.simulated.emergency import Emergencies
from friction_hil_drivers.cia402.temperature import TemperatureOptions, read_first

from friction_hil.drive import Command, DriveState, Mode, Request
from friction_hil.errors import DriveError
from friction_hil.servo.config import ServoConfig
from friction_hil.servo.servo import Servo

PERIOD_S = 1e-3
SETTINGS = {
    objects.VENDOR_ID: 0x123,
    objects.SERIAL_NUMBER: 7,
    objects.ABORT_CONNECTION_OPTION: 3,
    objects.QUICK_STOP_OPTION: 2,
    objects.FAULT_REACTION_OPTION: 2,
    objects.INTERPOLATION_PERIOD: 1,
    objects.INTERPOLATION_EXPONENT: -3,
    objects.MAX_MOTOR_SPEED: 6000,
}
READ_ONLY = (objects.STATUSWORD, objects.POSITION_ACTUAL, objects.VELOCITY_ACTUAL, objects.TORQUE_ACTUAL)


def dictionary_in_memory() -> Dictionary:
    """Return every object of the profile, with the types of the standard."""
    history = [Object(0x1003, "error", DataType.UNSIGNED32, age) for age in range(1, 9)]
    entries = [
        Entry(known.index, known.subindex, known.name, known.type, "ro" if known in READ_ONLY else "rw")
        for known in (*objects.TABLE.values(), *history)
    ]
    dictionary = Dictionary(entries)
    for known, value in SETTINGS.items():
        dictionary.set_default(known, value)
    return dictionary


@dataclass
class Part:
    """Part of a process image."""

    entries: tuple[Object, ...]
    offset: int = 0
    carried: dict[Object, bytes] = field(default_factory=dict)

    @property
    def layout(self) -> struct.Struct:
        return block_layout(self.entries, [entry.type.bits for entry in self.entries])


class InMemory(ObjectClient):
    """A drive whose objects and process image are reached in memory."""

    def __init__(self, mode: Mode = Mode.CST) -> None:
        super().__init__("x", "a drive in memory")
        self.mode = mode
        self.emergencies: list[bytes] = []
        self.dictionary = dictionary_in_memory()
        self.servo = Servo(ServoConfig())
        errors = Emergencies(self.dictionary, self.emergencies.append)
        self.device = SimulatedCia402Drive(self.servo, self.dictionary, errors, None)
        self.ms = 0
        self.sent = 0
        self.measured = Measurement()

    def read_object(self, entry: Object) -> bytes:
        return self.dictionary.find(*entry.address).upload()

    def write_object(self, entry: Object, data: bytes) -> None:
        self.dictionary.find(*entry.address).download(data)
        self.device.update(self.ms * 1_000_000)

    def begin_cycle(self) -> None:
        """Prepare the drive, read its scales and lay out its process image: two parts in each direction."""
        assert identify(self, Identity(vendor_id=0x123)) == "vendor 0x123, product 0x0, serial number 7"
        assert check_mode(self, self.mode, is_required=True) == []
        assert feedback_objects(self) == ([entry for group in FEEDBACK for entry in group], [])
        assert command_objects(self, self.mode, is_compensated=True) == (list(COMMANDS[self.mode]), [])
        assert prepare_mode(self, self.mode, PERIOD_S) == []
        units = read_units(self, DriveOptions(), "rotary")
        self.inputs = [Part(group) for group in FEEDBACK]
        first, *rest = COMMANDS[self.mode]
        self.outputs = [Part((first,), 0), Part(tuple(rest), 2)]
        self.encoder = CommandEncoder({part.offset: part for part in self.outputs}, self.mode, units)
        self.decoder = FeedbackDecoder(self.inputs, units, self.mode, PERIOD_S)

    def cycle(self, request: Request, torque: float = 0.0) -> DriveState:
        """Pass a period: commands out, time, feedback in."""
        self.sent = profile.next_controlword(self.measured.state, request, self.sent)
        position = self.measured.position
        image = bytearray(16)
        for offset, data in self.encoder.encode(self.sent, Command(request, position, 0.0, torque)):
            image[offset : offset + len(data)] = data
        for part in self.outputs:
            for entry, value in zip(part.entries, part.layout.unpack_from(image, part.offset), strict=True):
                self.dictionary.find(*entry.address).write(value)
        self.device.update(self.ms * 1_000_000)
        self.device.advance(self.servo.steps_per_second // 1000)
        self.ms += 1
        data = [b"".join(map(self.read_object, part.entries)) for part in self.inputs]
        self.measured = self.decoder.decode(data, self.measured, PERIOD_S)
        return self.measured.state

    def until(self, request: Request, state: DriveState, most_ms: int) -> list[DriveState]:
        """Return the states that were passed on the way to ``state``, each once."""
        passed = [self.measured.state]
        for _ in range(most_ms):
            if self.cycle(request) is not passed[-1]:
                passed.append(self.measured.state)
            if passed[-1] is state:
                return passed
        raise AssertionError(f"{state.name} was not reached: {passed}")


@pytest.mark.parametrize("mode", Mode)
def test_a_drive_is_enabled_pushed_and_stopped_through_a_process_image(mode: Mode) -> None:
    drive = InMemory(mode)
    drive.begin_cycle()
    assert drive.until(Request.DISABLE, DriveState.SWITCH_ON_DISABLED, 5)[-1] is DriveState.SWITCH_ON_DISABLED
    assert drive.until(Request.ENABLE, DriveState.OPERATION_ENABLED, 10) == [
        DriveState.SWITCH_ON_DISABLED,
        DriveState.READY_TO_SWITCH_ON,
        DriveState.SWITCHED_ON,
        DriveState.OPERATION_ENABLED,
    ]
    per_mille = drive.read(objects.RATED_TORQUE) * 1e-6  # N m
    for _ in range(20 if mode is Mode.CST else 2):  # then the loops of csp and csv work against an offset
        drive.cycle(Request.ENABLE, 200 * per_mille)
    assert drive.servo.torque == pytest.approx(200 * per_mille, rel=1e-6 if mode is Mode.CST else 0.5)
    assert drive.measured.torque == pytest.approx(drive.servo.torque, abs=per_mille)
    assert drive.measured.mode == mode
    if mode is Mode.CST:
        assert drive.measured.position > 0.0
        assert drive.measured.velocity > 0.0
    assert drive.until(Request.QUICK_STOP, DriveState.QUICK_STOP_ACTIVE, 2)
    for _ in range(500):
        assert drive.cycle(Request.QUICK_STOP) is DriveState.QUICK_STOP_ACTIVE  # 605Ah: it holds its position
    assert drive.servo.is_at_rest
    assert drive.until(Request.DISABLE, DriveState.SWITCH_ON_DISABLED, 2)
    assert drive.emergencies == []


def test_a_fault_is_told_by_an_emergency_and_reset_by_a_rising_edge() -> None:
    drive = InMemory()
    drive.begin_cycle()
    drive.until(Request.ENABLE, DriveState.OPERATION_ENABLED, 10)
    drive.device.fault(0x2310, drive.ms * 1_000_000)
    drive.until(Request.DISABLE, DriveState.FAULT, 2000)
    assert profile.emergency_text(drive.emergencies[0]).startswith("emergency 2310h continuous over-current")
    assert drive.read(objects.ERROR_CODE) == 0x2310
    drive.until(Request.RESET_FAULT, DriveState.SWITCH_ON_DISABLED, 3)
    assert profile.emergency_code(drive.emergencies[-1]) == 0


def test_settings_are_restored_by_the_run_after_one_that_was_killed(tmp_path: Path) -> None:
    drive = InMemory()
    path = tmp_path / "kept.json"
    for option in (5, 6):  # each run is killed once it has written
        drive.journal = Journal(drive, lambda _: path)
        drive.write(objects.QUICK_STOP_OPTION, option)
    drive.write(objects.TARGET_TORQUE, 100)  # no setting
    assert drive.journal is not None
    assert path.exists()
    assert drive.journal.restore() == []
    assert drive.read(objects.QUICK_STOP_OPTION) == SETTINGS[objects.QUICK_STOP_OPTION]
    assert drive.read(objects.TARGET_TORQUE) == 100
    assert not path.exists()


def test_what_a_drive_lacks_hides_or_refuses_is_told_apart() -> None:
    drive = InMemory()
    absent = Object(0x2000, "nothing", DataType.UNSIGNED16)
    assert (drive.find(absent), drive.notes) == (None, [])
    drive.dictionary.of(objects.POLARITY).access = "wo"
    assert drive.find(objects.POLARITY) is None
    assert drive.hidden_width(objects.POLARITY) == 8
    assert drive.try_write(objects.POLARITY, 0x80) is False
    with pytest.raises(DriveError, match="2000h nothing"):
        drive.read(absent)
    with pytest.raises(RefusedError, match=f"6041h statusword of a drive in memory: {Abort.READ_ONLY:08X}h"):
        drive.write(objects.STATUSWORD, 1)
    with pytest.raises(AbortError) as refusal:
        drive.write_object(objects.CONTROLWORD, b"\0")
    assert refusal.value.code == Abort.LENGTH
    drive.is_read_only = True
    with pytest.raises(RefusedError, match="is not written"):
        drive.write(objects.CONTROLWORD, 0)


def test_a_second_encoder_and_a_temperature_are_objects_like_others() -> None:
    drive = InMemory()
    options, note = with_scale(drive, LoadEncoderOptions(), "rotary")
    assert require_object(drive, options).address == objects.ADDITIONAL_POSITION.address
    assert note.endswith("counts per rad (60E6h)")
    drive.dictionary.of(objects.SIMULATED_MOTOR_TEMPERATURE).value = 456
    assert read_first(drive, TemperatureOptions(index=0x5FF0, scale=0.1)) == pytest.approx(45.6)


# --- an order of restoring that the drive accepts


class Interpolator:
    """Access to a drive that refuses a value of 60C2h by which it would interpolate over less than 0.1 ms."""

    axis, where = "x", "node 5 on can0"

    def __init__(self) -> None:
        self.values = {INTERPOLATION_PERIOD.address: b"\x01", INTERPOLATION_EXPONENT.address: b"\xfd"}  # 1 ms

    def peek(self, entry):
        return self.values.get(entry.address, b"\x07\0\0\0")

    def download(self, entry, data):
        values = {**self.values, entry.address: data}
        period, exponent = (
            int.from_bytes(values[each.address], "little", signed=True)
            for each in (INTERPOLATION_PERIOD, INTERPOLATION_EXPONENT)
        )
        if entry == INTERPOLATION_PERIOD and period * 10.0**exponent < 0.99e-4:
            raise RefusedError("refused")
        self.values = values


def test_a_setting_that_needs_another_one_first_is_restored_after_it(tmp_path) -> None:
    drive = Interpolator()
    before = dict(drive.values)
    journal = Journal(drive, lambda identity: tmp_path / f"{identity}.json")
    for entry, data in ((INTERPOLATION_EXPONENT, b"\xfb"), (INTERPOLATION_PERIOD, b"\x19")):  # 0.25 ms
        journal.before(entry, data)
        drive.download(entry, data)

    assert journal.restore() == []
    assert drive.values == before
