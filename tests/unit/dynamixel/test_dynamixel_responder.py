"""Simulated Dynamixel servos on bytes: what they answer, what they refuse, what they pass over."""

import pytest
from dynamixel_sdk import COMM_SUCCESS, PacketHandler
from friction_hil_drivers.dynamixel.description import DESCRIPTIONS, DynamixelDescription
from friction_hil_drivers.dynamixel.driver import DynamixelLine
from friction_hil_drivers.dynamixel.options import DynamixelOptions
from friction_hil_drivers.dynamixel.packets import Packets
from friction_hil_drivers.dynamixel.simulated import DynamixelResponder
from friction_hil_drivers.serial_line.description import load_description
from friction_hil_drivers.serial_line.protocol import CycleSignals, Image, ReplyError
from friction_hil_drivers.serial_line.sequences import state_of
from friction_hil_drivers.serial_line.simulated import SimulatedDrive
from friction_hil_drivers.serial_line.units import AxisUnits
from hypothesis import given
from hypothesis import strategies as st

from friction_hil.drive import DriveState, Mode
from friction_hil.servo.config import ServoConfig
from friction_hil.servo.servo import Servo
from tests.serial_bench import PLAIN, STEPS_PER_MS

WANTED = CycleSignals(("position", "velocity"), ("torque", "status", "error", "watchdog"), ("torque_command",))
READ_POSITION = "FF FF FD 00 01 07 00 02 84 00 04 00 1D 15"  # ROBOTIS e-Manual, DYNAMIXEL Protocol 2.0


class Bench:
    """Servos on a line; an axis is called by its ID."""

    def __init__(self, *ids, name="xm430", is_fast=False, pace=STEPS_PER_MS, **changes):
        loaded = load_description(name, None, DESCRIPTIONS, DynamixelDescription)
        description = loaded.model_copy(update={"fast_sync_read": is_fast, **changes})
        axes = [f"{n}" for n in ids]
        self.drives = {
            axis: SimulatedDrive(
                axis,
                description,
                Servo(ServoConfig.model_validate(PLAIN)),
                Mode.CST,
                AxisUnits(torque_constant=1.78),
                pace,
            )
            for axis in axes
        }
        options = {
            axis: DynamixelOptions.model_validate({"line": {"port": "x"}, "description": "xm430", "id": int(axis)})
            for axis in axes
        }
        self.images = {axis: Image() for axis in axes}
        descriptions = dict.fromkeys(axes, description)
        self.line = DynamixelLine(descriptions, options, self.images)
        self.responder = DynamixelResponder(self.drives, descriptions, options)
        self.plan = self.line.plan(dict.fromkeys(axes, WANTED))

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


class _Port:
    """The line as the vendor's SDK sees it."""

    is_using = False
    baudrate = 57600

    def getBaudRate(self):  # noqa: N802
        return self.baudrate

    def setPacketTimeoutMillis(self, milliseconds): ...  # noqa: N802

    def __init__(self, bench):
        self._bench = bench
        self._reply = b""

    def clearPort(self):  # noqa: N802
        self._reply = b""

    def writePort(self, packet):  # noqa: N802
        self._reply = self._bench.ask(bytes(packet)) or b""
        return len(packet)

    def readPort(self, length):  # noqa: N802
        data, self._reply = self._reply[:length], self._reply[length:]
        return data

    def setPacketTimeout(self, length): ...  # noqa: N802

    def isPacketTimeout(self):  # noqa: N802
        return True


@pytest.mark.parametrize("is_fast", [False, True])
def test_a_servo_that_is_not_there_is_missing_alone(is_fast):
    bench, there = Bench(1, 2, 3, is_fast=is_fast), Bench(1, 2, is_fast=is_fast)
    (poll,) = bench.plan.poll
    reply = there.ask(poll.encode())
    assert reply
    assert not poll.take(bytearray(reply))
    assert [bool(image.fresh) for image in bench.images.values()] == [True, True, False]
    assert poll.label.endswith("(3 missing)")


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
    sdk, port = PacketHandler(2.0), _Port(bench)
    assert sdk.ping(port, 2) == (1020, COMM_SUCCESS, 0)
    assert sdk.write1ByteTxRx(port, 1, 64, 1) == (COMM_SUCCESS, 0)
    assert sdk.read1ByteTxRx(port, 1, 64) == (1, COMM_SUCCESS, 0)
    assert sdk.write2ByteTxRx(port, 1, 102, 100) == (COMM_SUCCESS, 0)
    position, result, error = sdk.read4ByteTxRx(port, 1, 132)
    assert (result, error) == (COMM_SUCCESS, 0)
    assert position == round(bench.drives["1"].read("position"))
    assert bench.drives["1"].read("torque_command") == 100.0
    across = sdk.read4ByteTxRx(port, 1, 130)[0]  # the high half of velocity, the low half of position
    drive = bench.drives["1"]
    assert across == (round(drive.read("velocity")) >> 16) | (round(drive.read("position")) & 0xFFFF) << 16
    assert across != 0


@pytest.mark.parametrize(
    ("call", "error"),
    [
        (lambda sdk, port: sdk.read2ByteTxRx(port, 1, 2)[2], 7),  # no signal there
        (lambda sdk, port: sdk.read4ByteTxRx(port, 1, 130)[2], 0),  # the end of one and the beginning of another
        (lambda sdk, port: sdk.write2ByteTxRx(port, 1, 2, 1)[1], 7),
        (lambda sdk, port: sdk.write1ByteTxRx(port, 1, 102, 1)[1], 5),
        (lambda sdk, port: sdk.write1ByteTxRx(port, 1, 64, 2)[1], 4),
        (lambda sdk, port: sdk.write4ByteTxRx(port, 1, 132, 0)[1], 4),  # present position is not to be written
        (lambda sdk, port: sdk.write2ByteTxRx(port, 1, 0, 1)[1], 4),  # nor is the model number
        (lambda sdk, port: sdk.factoryReset(port, 1, 0xFF)[1], 2),
    ],
)
def test_refusals(call, error):
    assert call(PacketHandler(2.0), _Port(Bench(1))) == error


def test_requests_for_others_and_broken_ones_are_passed_over():
    bench = Bench(1)
    packets = Packets()
    assert bench.ask(packets.pack(7, 0x01)) == b""
    request = bytes.fromhex(READ_POSITION)
    broken = bytearray(request)
    broken[9] ^= 1
    assert bench.ask(bytes(broken)) is None
    assert bench.drives["1"].samples == 0
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
    before = anything.drives["1"].samples
    assert anything.responder.take(bytearray(data)) is None
    assert anything.drives["1"].samples == before


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
        assert bench.state("1") is DriveState.OPERATION_ENABLED
    assert bench.state("2") is DriveState.OPERATION_ENABLED
    drive = bench.drives["1"]
    for _ in range(101):
        drive.sample()
    assert bench.state("1") is DriveState.FAULT
    assert bench.images["1"].values["watchdog"] == -1.0
    for step in drive.description.reset_fault:
        bench.write("1", **step.write)
    assert bench.state("1") is DriveState.SWITCH_ON_DISABLED


@pytest.mark.parametrize("name", ["xl330", "xm430", "xm540"])
def test_a_goal_beyond_the_limit_is_refused_and_the_last_one_stays(name):
    """As the descriptions say: a status with an error for a write, and nothing at all for a Sync Write."""
    bench = Bench(1, name=name)
    sdk, port = PacketHandler(2.0), _Port(bench)
    limit = bench.drives["1"].description.signals["torque_command"].limit
    bench.write("1", status=1)
    assert sdk.write2ByteTxRx(port, 1, 102, 80) == (COMM_SUCCESS, 0)
    for goal in (limit + 1, 0x10000 - limit - 1, 0x8000):
        assert sdk.write2ByteTxRx(port, 1, 102, goal) == (COMM_SUCCESS, 6)
        assert sdk.syncWriteTxOnly(port, 102, 2, [1, *goal.to_bytes(2, "little")], 3) == COMM_SUCCESS
        assert sdk.read2ByteTxRx(port, 1, 102) == (80, COMM_SUCCESS, 0)
    assert sdk.write2ByteTxRx(port, 1, 102, 0x10000 - limit) == (COMM_SUCCESS, 0)


def test_no_goal_is_taken_while_the_bus_watchdog_has_tripped():
    bench = Bench(1)
    sdk, port = PacketHandler(2.0), _Port(bench)
    bench.write("1", watchdog=5)
    bench.write("1", status=1)
    for _ in range(101):
        bench.drives["1"].sample()
    assert sdk.write2ByteTxRx(port, 1, 102, 50) == (COMM_SUCCESS, 4)
    assert sdk.read2ByteTxRx(port, 1, 102)[0] == 0
    assert sdk.write1ByteTxRx(port, 1, 98, 0) == (COMM_SUCCESS, 0)
    assert sdk.write2ByteTxRx(port, 1, 102, 50) == (COMM_SUCCESS, 0)


def test_what_lies_below_64_is_written_without_torque_alone():
    bench = Bench(1)
    sdk, port = PacketHandler(2.0), _Port(bench)
    assert sdk.write1ByteTxRx(port, 1, 11, 0) == (COMM_SUCCESS, 0)
    assert sdk.write1ByteTxRx(port, 1, 64, 1) == (COMM_SUCCESS, 0)
    assert sdk.write1ByteTxRx(port, 1, 11, 0) == (COMM_SUCCESS, 7)


def test_the_last_goal_acts_when_the_torque_is_enabled():
    """For this the descriptions write a goal of zero before."""
    moved = []
    for goal in (60, 0):
        bench = Bench(1)
        sdk, port = PacketHandler(2.0), _Port(bench)
        sdk.write2ByteTxRx(port, 1, 102, goal)
        before = sdk.read4ByteTxRx(port, 1, 132)[0]
        bench.write("1", status=1)
        for _ in range(50):
            after = sdk.read4ByteTxRx(port, 1, 132)[0]
        moved.append(after - before)
    assert moved[0] > 10
    assert moved[1] == 0


def test_after_a_reboot_the_position_lies_within_one_turn():
    bench = Bench(1)
    sdk, port = PacketHandler(2.0), _Port(bench)
    bench.write("1", status=1)
    bench.drives["1"].write("torque_command", 100.0)
    while (position := sdk.read4ByteTxRx(port, 1, 132)[0]) < 5000:
        pass
    sdk.reboot(port, 1)
    assert sdk.read4ByteTxRx(port, 1, 132)[0] in range(position % 4096, position % 4096 + 1000)


def test_an_error_shows_as_an_alert():
    by_error = Bench(1).drives["1"].description.states[1:]  # no rule looks at the watchdog
    bench = Bench(1, states=by_error)
    request = bytes.fromhex(READ_POSITION)
    replies = [bench.ask(request)]
    bench.drives["1"].fail()
    replies.append(bench.ask(request))
    assert [reply[8] for reply in replies if reply] == [0, 0x80]


def test_what_the_servo_does_not_take_is_told():
    bench = Bench(1)
    bench.images["1"].values["operating_mode"] = 5.0
    with pytest.raises(ReplyError, match=r"id 1 refuses: data range error"):
        bench.talk(bench.line.write("1", ("operating_mode",)))


def test_the_vendors_sdk_finds_identity_and_temperature():
    bench = Bench(1, 2)
    sdk, port = PacketHandler(2.0), _Port(bench)
    servos, result = sdk.broadcastPing(port)
    assert result == COMM_SUCCESS
    assert {servo: list(found) for servo, found in servos.items()} == {1: [1020, 44], 2: [1020, 44]}
    assert sdk.read2ByteTxRx(port, 1, 0) == (1020, COMM_SUCCESS, 0)
    assert sdk.read1ByteTxRx(port, 1, 6) == (44, COMM_SUCCESS, 0)
    celsius, result, error = sdk.read1ByteTxRx(port, 1, 146)
    assert (result, error) == (COMM_SUCCESS, 0)
    assert 0 < celsius < 80


def test_a_reboot_ends_torque_and_errors_and_keeps_what_has_no_need_of_supply():
    bench = Bench(1, 2)
    sdk, port = PacketHandler(2.0), _Port(bench)
    bench.write("1", return_delay=0)
    bench.write("1", watchdog=100)
    bench.write("1", status=1)
    bench.write("2", status=1)
    bench.drives["1"].fail()
    assert bench.state("1") is DriveState.FAULT
    assert sdk.reboot(port, 1)[0] == COMM_SUCCESS
    assert bench.state("1") is DriveState.SWITCH_ON_DISABLED
    assert bench.images["1"].values["watchdog"] == 0.0
    assert bench.state("2") is DriveState.OPERATION_ENABLED
    bench.drives["1"].write("operating_mode", 0.0)


def test_a_servo_that_reboots_in_real_time_answers_nothing_until_it_is_up():
    bench = Bench(1, 2, pace=None)
    sdk, port = PacketHandler(2.0), _Port(bench)
    assert sdk.reboot(port, 1)[0] == COMM_SUCCESS
    for now_s, is_there in ((0.0, False), (0.2, False), (0.4, True)):
        for drive in bench.drives.values():
            drive.advance_to(round(now_s * 1e9))
        assert (sdk.ping(port, 1)[1] == COMM_SUCCESS) is is_there
        assert sdk.ping(port, 2)[1] == COMM_SUCCESS
