"""Simulated Dynamixel servos on bytes: what they answer, what they refuse, what they pass over."""

import pytest
from dynamixel_sdk import COMM_SUCCESS, PacketHandler
from friction_hil_drivers.dynamixel.description import DESCRIPTIONS, DynamixelDescription
from friction_hil_drivers.dynamixel.driver import DynamixelLine
from friction_hil_drivers.dynamixel.options import DynamixelOptions
from friction_hil_drivers.dynamixel.packets import Packets
from friction_hil_drivers.dynamixel.simulated import DynamixelResponder
from friction_hil_drivers.serial_line.description import load_description
from friction_hil_drivers.serial_line.protocol import CycleSignals, Image
from friction_hil_drivers.serial_line.sequences import state_of
from friction_hil_drivers.serial_line.simulated import SimulatedDrive
from friction_hil_drivers.serial_line.units import AxisUnits
from hypothesis import example, given
from hypothesis import strategies as st

from friction_hil.drive import DriveState, Mode
from friction_hil.servo.config import ServoConfig
from friction_hil.servo.servo import Servo
from tests.serial_bench import PLAIN, STEPS_PER_MS
from tests.unit.dynamixel.test_dynamixel_codec import Port

WANTED = CycleSignals(("position", "velocity"), ("torque", "status", "error", "watchdog"), ("torque_command",))
READ_POSITION = "FF FF FD 00 01 07 00 02 84 00 04 00 1D 15"  # ROBOTIS e-Manual, DYNAMIXEL Protocol 2.0


class Bench:
    """Servos on a line, and the vendor's SDK; an axis is called by its ID."""

    def __init__(self, *ids, name="xm430", is_fast=False, pace=STEPS_PER_MS, **changes):
        loaded = load_description(name, None, DESCRIPTIONS, DynamixelDescription)
        description = loaded.model_copy(update={"fast_sync_read": is_fast, **changes})
        self.images = {f"{n}": Image() for n in ids or (1,)}
        servo, units = ServoConfig.model_validate(PLAIN), AxisUnits(torque_constant=1.78)
        self.drives = {
            axis: SimulatedDrive(axis, description, Servo(servo), Mode.CST, units, pace) for axis in self.images
        }
        given = {"line": {"port": "x"}, "description": "xm430"}
        options = {axis: DynamixelOptions.model_validate({**given, "id": int(axis)}) for axis in self.images}
        descriptions = dict.fromkeys(self.images, description)
        self.line = DynamixelLine(descriptions, options, self.images)
        self.responder = DynamixelResponder(self.drives, descriptions, options)
        self.plan = self.line.plan(dict.fromkeys(self.images, WANTED))
        self.sdk, self.port = PacketHandler(2.0), Port(self.ask)

    @property
    def drive(self):
        return self.drives["1"]

    def sdk_write(self, address, size, number, servo=1):
        """Result and error of a write of the vendor's SDK."""
        return getattr(self.sdk, f"write{size}ByteTxRx")(self.port, servo, address, number)

    def sdk_read(self, address, size, servo=1):
        """Number of a read of the vendor's SDK, its result and error."""
        return getattr(self.sdk, f"read{size}ByteTxRx")(self.port, servo, address)

    def ask(self, request):
        received = bytearray(request)
        reply = self.responder.take(received)
        assert reply is None or not received
        return reply

    def talk(self, exchange):
        """One exchange; whether it is complete."""
        reply = self.ask(exchange.encode())
        assert reply is not None
        assert len(reply) <= exchange.reply_size
        return not exchange.reply_size or exchange.take(bytearray(reply))

    def write(self, axis, **values):
        self.images[axis].values.update(values)
        assert self.talk(self.line.write(axis, tuple(values)))

    def state(self, axis):
        for name in ("status", "error", "watchdog"):
            assert self.talk(self.line.read(axis, (name,)))
        return state_of(self.drives[axis].description, self.images[axis].values)


OK = (COMM_SUCCESS, 0)
STATUS, GOAL_CURRENT, POSITION = 64, 102, 132


def test_fast_and_slow_reads_say_the_same():
    slow, fast = Bench(5, 1, 9), Bench(5, 1, 9, is_fast=True)
    for bench in (slow, fast):
        for axis in bench.drives:
            bench.write(axis, status=1)
            bench.drives[axis].write("torque_command", 20.0 * int(axis))
        (poll,) = bench.plan.poll
        assert bench.talk(poll)
        assert bench.talk(poll)
    assert fast.plan.poll[0].encode()[7] == 0x8A
    values = [{axis: image.values for axis, image in bench.images.items()} for bench in (slow, fast)]
    assert values[0] == values[1]
    assert values[0]["5"]["velocity"] != 0.0


def test_the_vendors_sdk_understands_the_answers():
    bench = Bench(1, 2)
    servos, result = bench.sdk.broadcastPing(bench.port)
    assert result == COMM_SUCCESS
    assert {servo: list(found) for servo, found in servos.items()} == {1: [1020, 44], 2: [1020, 44]}
    assert bench.sdk_read(0, 2) == (1020, *OK)
    assert bench.sdk_read(6, 1) == (44, *OK)
    assert 0 < bench.sdk_read(146, 1)[0] < 80  # °C
    assert bench.sdk_write(11, 1, 0) == OK
    assert bench.sdk_write(STATUS, 1, 1) == OK
    assert bench.sdk_read(STATUS, 1) == (1, *OK)
    assert bench.sdk_write(11, 1, 0) == (COMM_SUCCESS, 7), "what lies below 64 is written without torque alone"
    assert bench.sdk_write(GOAL_CURRENT, 2, 100) == OK
    assert bench.drive.read("torque_command") == 100.0
    assert bench.sdk_read(POSITION, 4) == (round(bench.drive.read("position")), *OK)
    across = bench.sdk_read(130, 4)[0]  # the high half of velocity, the low half of position
    velocity, position = round(bench.drive.read("velocity")), round(bench.drive.read("position"))
    assert across == (velocity >> 16) | (position & 0xFFFF) << 16
    assert across != 0


@pytest.mark.parametrize(
    ("call", "error"),
    [
        (lambda bench: bench.sdk_read(2, 2)[2], 7),  # no signal there
        (lambda bench: bench.sdk_read(130, 4)[2], 0),  # the end of one and the beginning of another
        (lambda bench: bench.sdk_write(2, 2, 1)[1], 7),
        (lambda bench: bench.sdk_write(GOAL_CURRENT, 1, 1)[1], 5),
        (lambda bench: bench.sdk_write(STATUS, 1, 2)[1], 4),
        (lambda bench: bench.sdk_write(POSITION, 4, 0)[1], 4),  # present position is not to be written
        (lambda bench: bench.sdk_write(0, 2, 1)[1], 4),  # nor is the model number
        (lambda bench: bench.sdk.factoryReset(bench.port, 1, 0xFF)[1], 2),
    ],
)
def test_refusals(call, error):
    assert call(Bench()) == error


def test_requests_for_others_and_broken_ones_are_passed_over():
    bench = Bench()
    assert bench.ask(Packets().pack(7, 0x01)) == b""
    request = bytes.fromhex(READ_POSITION)
    broken = bytearray(request)
    broken[9] ^= 1
    assert bench.ask(bytes(broken)) is None
    assert bench.drive.samples == 0
    whole = bench.ask(request)
    assert whole
    # a request that broke off, or whose length came wrong, costs no other
    assert bench.ask(request[:-3] + request) == whole
    assert bench.ask(request[:5] + b"\xf0\x03" + request[7:] + request) == whole


@pytest.fixture(scope="module")
def anything():
    """Servos that whatever request may come to."""
    return Bench(1, 2, is_fast=True)


@given(st.lists(st.one_of(st.sampled_from([0x00, 0x01, 0x03, 0xFD, 0xFE, 0xFF]), st.integers(0, 255)), max_size=60))
def test_random_bytes_are_no_requests(anything, data):
    before = anything.drive.samples
    assert anything.responder.take(bytearray(data)) is None
    assert anything.drive.samples == before


PARAMETERS = st.one_of(
    st.binary(max_size=20),
    st.builds(
        lambda address, size, rest: bytes((address, 0, size, 0)) + rest,
        st.sampled_from([0, 9, 11, 64, 70, 98, 102, 104, 125, 126, 128, 132, 136]),
        st.sampled_from([0, 1, 2, 4, 10]),
        st.lists(st.sampled_from([0, 1, 2, 127, 255]), max_size=12).map(bytes),
    ),
)


@given(st.sampled_from([0x01, 0x02, 0x03, 0x08, 0x82, 0x83, 0x8A]), st.sampled_from([1, 254]), PARAMETERS)
@example(0x03, 1, b"\x40")
@example(0x03, 254, b"\x40\x00\x01")
@example(0x08, 254, b"")
@example(0x83, 254, b"\x40\x00\x01\x00\x07\x01")
def test_whole_packets_with_any_content_never_crash(anything, instruction, servo, parameters):
    packets = Packets()
    reply = anything.ask(packets.pack(servo, instruction, parameters))
    assert reply is not None
    if servo == 1:
        answer = packets.cut(bytearray(reply), 100)
        assert answer is not None
        assert (answer.id, answer.instruction, answer.is_whole) == (1, 0x55, True)


def test_the_bus_watchdog_trips_without_requests_and_is_cleared():
    bench = Bench(1, 2)
    for axis in bench.drives:
        bench.write(axis, watchdog=5)  # 100 ms
        bench.write(axis, status=1)
    for exchange in (bench.line.read("1", ("position",)), bench.plan.poll[0]):
        for _ in range(150):
            assert bench.talk(exchange)  # a read feeds it, and 150 ms pass
        assert [bench.state(axis) for axis in bench.drives] == [DriveState.OPERATION_ENABLED] * 2
    for _ in range(101):
        bench.drive.sample()
    assert bench.state("1") is DriveState.FAULT
    assert bench.images["1"].values["watchdog"] == -1.0
    assert bench.sdk_write(GOAL_CURRENT, 2, 50) == (COMM_SUCCESS, 4), "no goal is taken then"
    assert bench.sdk_read(GOAL_CURRENT, 2)[0] == 0
    for step in bench.drive.description.reset_fault:
        bench.write("1", **step.write)
    assert bench.state("1") is DriveState.SWITCH_ON_DISABLED
    assert bench.sdk_write(GOAL_CURRENT, 2, 50) == OK


@pytest.mark.parametrize("name", ["xl330", "xm430", "xm540"])
def test_a_goal_beyond_the_limit_is_refused_and_the_last_one_stays(name):
    """As the descriptions say: a status with an error for a write, and nothing at all for a Sync Write."""
    bench = Bench(name=name)
    limit = bench.drive.description.signals["torque_command"].limit
    bench.write("1", status=1)
    assert bench.sdk_write(GOAL_CURRENT, 2, 80) == OK
    for goal in (limit + 1, 0x10000 - limit - 1, 0x8000):
        assert bench.sdk_write(GOAL_CURRENT, 2, goal) == (COMM_SUCCESS, 6)
        data = [1, *goal.to_bytes(2, "little")]
        assert bench.sdk.syncWriteTxOnly(bench.port, GOAL_CURRENT, 2, data, 3) == COMM_SUCCESS
        assert bench.sdk_read(GOAL_CURRENT, 2) == (80, *OK)
    assert bench.sdk_write(GOAL_CURRENT, 2, 0x10000 - limit) == OK


def test_the_last_goal_acts_when_the_torque_is_enabled():
    """For this the descriptions write a goal of zero before."""
    moved = []
    for goal in (60, 0):
        bench = Bench()
        bench.sdk_write(GOAL_CURRENT, 2, goal)
        before = bench.sdk_read(POSITION, 4)[0]
        bench.write("1", status=1)
        for _ in range(50):
            after = bench.sdk_read(POSITION, 4)[0]
        moved.append(after - before)
    assert moved[0] > 10
    assert moved[1] == 0


def test_an_error_shows_as_an_alert():
    by_error = Bench().drive.description.states[1:]  # no rule looks at the watchdog
    bench = Bench(states=by_error)
    request = bytes.fromhex(READ_POSITION)
    replies = [bench.ask(request)]
    bench.drive.fail()
    replies.append(bench.ask(request))
    assert [reply[8] for reply in replies if reply] == [0, 0x80]


def test_after_a_reboot_the_position_lies_within_one_turn():
    bench = Bench()
    bench.write("1", status=1)
    bench.drive.write("torque_command", 100.0)
    while (position := bench.sdk_read(POSITION, 4)[0]) < 5000:
        pass
    bench.sdk.reboot(bench.port, 1)
    assert bench.sdk_read(POSITION, 4)[0] in range(position % 4096, position % 4096 + 1000)


def test_a_reboot_ends_torque_and_errors_and_keeps_what_has_no_need_of_supply():
    bench = Bench(1, 2)
    for name, number in (("return_delay", 0), ("watchdog", 100), ("status", 1)):
        bench.write("1", **{name: number})
    bench.write("2", status=1)
    bench.drive.fail()
    assert bench.state("1") is DriveState.FAULT
    assert bench.sdk.reboot(bench.port, 1)[0] == COMM_SUCCESS
    assert bench.state("1") is DriveState.SWITCH_ON_DISABLED
    assert bench.images["1"].values["watchdog"] == 0.0
    assert bench.state("2") is DriveState.OPERATION_ENABLED
    bench.drive.write("operating_mode", 0.0)


def test_a_servo_that_reboots_in_real_time_answers_nothing_until_it_is_up():
    bench = Bench(1, 2, pace=None)
    assert bench.sdk.reboot(bench.port, 1)[0] == COMM_SUCCESS
    for now_s, is_there in ((0.0, False), (0.2, False), (0.4, True)):
        for drive in bench.drives.values():
            drive.advance_to(round(now_s * 1e9))
        assert (bench.sdk.ping(bench.port, 1)[1] == COMM_SUCCESS) is is_there
        assert bench.sdk.ping(bench.port, 2) == (1020, *OK)
