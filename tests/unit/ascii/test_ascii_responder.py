"""Simulated drives that speak text: what they answer, byte by byte, and driver and drive talking to each other."""

import math

import pytest
from friction_hil_drivers.ascii.description import AsciiDescription
from friction_hil_drivers.ascii.options import AsciiOptions
from friction_hil_drivers.ascii.simulated import AsciiResponder
from friction_hil_drivers.serial_line.simulated.drive import SimulatedDrive
from friction_hil_drivers.serial_line.units import AxisUnits
from hypothesis import given
from hypothesis import strategies as st

from friction_hil.drive import DriveState, Mode, Request
from friction_hil.servo.config import ServoConfig
from friction_hil.servo.servo import Servo
from tests.serial_bench import STEPS_PER_MS
from tests.serial_rig import Rig
from tests.unit.ascii.test_ascii_codec import COPLEY, ODRIVE, READY

SERVO = ServoConfig.model_validate(
    {"friction": {"model": "coulomb", "parameters": {"coulomb": 0.01}}, "mechanics": {"inertia": 2e-4}}
)
PLAIN_ODRIVE = ODRIVE.model_copy(update={"checksum": None})
COUNTERS = {name: {"unit": "count", "bits": 16} for name in ("position", "position_command")}
COUNTING = {
    "feedback": {"request": "f {axis}", "reply": "{position:int} {velocity:float}"},
    "command_position": {"request": "p {axis} {position_command:hex} 0 {torque_command:float}"},
}


def options(axis):
    return AsciiOptions.model_validate({"line": {"port": "/dev/ttyS0"}, "description": "any", "axis": axis})


def simulated(description, mode=Mode.CST):
    units = AxisUnits(torque_constant=0.1)
    return SimulatedDrive("x", description, Servo(SERVO), mode, units, STEPS_PER_MS)


def on_line(description, *axes, mode=Mode.CST):
    drives = {axis: simulated(description, mode) for axis in axes}
    descriptions = dict.fromkeys(axes, description)
    return AsciiResponder(drives, descriptions, {axis: options(axis) for axis in axes}), drives


def answers(responder, data):
    """All replies to what comes in one piece."""
    received, replies = bytearray(data), []
    while (reply := responder.take(received)) is not None:
        replies.append(reply)
    return replies


def test_feedback_is_two_numbers_with_six_digits_in_turns():
    responder, drives = on_line(PLAIN_ODRIVE, "0")
    (reply,) = answers(responder, b"f 0\n")
    turns = drives["0"].servo.position / (2.0 * math.pi)
    assert reply == b"%.6f %.6f\r\n" % (turns, 0.0)
    assert drives["0"].samples == 1


def test_set_points_and_settings_get_no_reply_and_numbers_are_read_as_by_sscanf():
    responder, drives = on_line(PLAIN_ODRIVE, "0")
    lines = b"c 0 0.25\nw axis0.controller.config.control_mode 1\nu 0\nsc\n"
    assert answers(responder, lines) == [b""] * 4
    assert (drives["0"].read("torque_command"), drives["0"].read("control_mode")) == (0.25, 1.0)
    assert answers(responder, b"c  0   -2.5e-1 \n\r\nr axis0.current_state\n") == [b"", b"1\r\n"]
    assert drives["0"].read("torque_command") == -0.25
    assert drives["0"].samples == 0


@pytest.mark.parametrize(
    "line",
    [
        *(b"x", b"r axis0.nonsense", b"w axis0.requested_state", b"c 0", b"f", b"\xff\xfe", b"f 0 1"),
        b"w axis0.requested_state 99",
    ],
)
def test_what_it_does_not_know_or_would_not_take_it_says_and_changes_nothing(line):
    responder, drives = on_line(PLAIN_ODRIVE, "0")
    assert answers(responder, line + b"\n") == [b"unknown command\r\n"]
    drive = drives["0"]
    assert (drive.samples, drive.read("requested_state")) == (0, 0.0)
    assert drive.state is DriveState.READY_TO_SWITCH_ON


def test_two_axes_have_what_is_meant_for_them_and_a_third_is_silent():
    responder, drives = on_line(PLAIN_ODRIVE, "0", "1")
    assert answers(responder, b"c 0 0.1\nc 1 0.2\nc 2 0.3\nf 2\n") == [b""] * 4
    assert [drive.read("torque_command") for drive in drives.values()] == [0.1, 0.2]
    assert [drive.samples for drive in drives.values()] == [0, 0]
    assert len(answers(responder, b"f 1\n")[0]) > 2
    assert [drive.samples for drive in drives.values()] == [0, 1]
    answers(responder, b"sc\n")
    assert [drive.read("clear_errors") for drive in drives.values()] == [1.0, 1.0]


def test_a_checksum_is_asked_for_and_given():
    responder, drives = on_line(ODRIVE, "0")
    assert answers(responder, b"r axis0.current_state*14\n") == [b"1*49\r\n"]  # 31h is 49
    assert answers(responder, b"r axis0.current_state*15\nr axis0.current_state\nc 0 0.5*1\n") == [b""] * 3
    assert drives["0"].read("torque_command") == 0.0


def test_an_overlong_line_is_dropped_with_all_that_belongs_to_it():
    responder, drives = on_line(PLAIN_ODRIVE, "0")
    received = bytearray(b"c 0 0." + b"1" * 300)
    assert responder.take(received) is None
    received += b"c 0 0.5\nr axis0.current_state\n"
    assert [responder.take(received), responder.take(received)] == [b"", b"1\r\n"]
    assert drives["0"].read("torque_command") == 0.0
    assert responder.take(bytearray(b"9" * 300)) is None
    responder.forget()
    assert answers(responder, b"r axis0.current_state\n") == [b"1\r\n"]


@pytest.mark.parametrize("has_echo", [False, True])
def test_a_copley_drive_acknowledges_and_tells_integers(has_echo):
    responder, drives = on_line(COPLEY.model_copy(update={"echo": has_echo}), "")
    drive = drives[""]
    position = round(drive.servo.position * drive.servo.counts_per_unit)
    for request, reply in (
        *((b"s r0x02 -150\r", b"ok\r"), (b"g r0xa0\r", b"v 4096\r"), (b"g r0xa4\r", b"v 0\r")),
        (b"g r0x32\r", b"v %d\r" % position),
        *((line, b"e 33\r") for line in (b"s r0x24 77\r", b"s r0x02 40000\r", b"g r0x99\r", b"hello\r")),
        *((b"s r0x24 1\r", b"ok\r"), (b"g r0xa0\r", b"v 0\r")),
    ):
        assert answers(responder, request) == [request * has_echo + reply]
    assert drive.read("torque_command") == -150.0
    assert drive.state is DriveState.OPERATION_ENABLED


def test_a_counter_wraps_on_the_line_and_not_in_the_drive():
    plain = PLAIN_ODRIVE.model_dump()
    changes = {"signals": plain["signals"] | COUNTERS, "messages": plain["messages"] | COUNTING}
    responder, drives = on_line(AsciiDescription.model_validate(plain | changes), "0", mode=Mode.CSP)
    drive = drives["0"]
    for number, expected in ((0x7FF0, 32752.0), (0x8010, 32784.0 - 65536.0)):
        answers(responder, b"p 0 %04X 0 0.0\n" % number)
        assert drive.read("position_command") == expected  # nearest to where it is: at zero
    answers(responder, b"u 0\nw axis0.config.enable_watchdog 1\nw axis0.requested_state 8\n")
    for target in range(0, 40000, 40):
        answers(responder, b"p 0 %04X 0 0.0\nf 0\n" % target)
    assert drive.read("position_command") == 39960.0
    (reply,) = answers(responder, b"f 0\n")
    assert abs(drive.read("position") - 39960.0) < 2000.0
    assert int(reply.split()[0]) == round(drive.read("position")) - 65536


@pytest.mark.parametrize(("name", "mode"), [(name, mode) for name, each in READY.items() for mode in each.modes])
def test_a_drive_is_led_up_down_and_out_of_a_fault(name, mode, tmp_path):
    keys = {"controller": None} if mode != "cst" else {}
    keys |= {"description": name, "mode": mode, "counts_per_unit": 1e4}
    with Rig("odrive", tmp_path, **keys).begin() as rig:

        def until(request, wanted):
            rig.cycle(request, count=30)
            assert rig.feedback.state is wanted, rig.feedback

        for _ in range(2):
            until(Request.ENABLE, DriveState.OPERATION_ENABLED)
            until(Request.DISABLE, DriveState.READY_TO_SWITCH_ON)
        until(Request.ENABLE, DriveState.OPERATION_ENABLED)
        rig.there.fail()
        until(Request.DISABLE, DriveState.FAULT)
        assert any(text in rig.feedback.error for text in READY[name].errors.values())
        until(Request.ENABLE, DriveState.FAULT)
        until(Request.RESET_FAULT, DriveState.READY_TO_SWITCH_ON)


noise = st.one_of(
    st.binary(max_size=40),
    st.text("fcrwu 01.-+*eaxis\r\n", max_size=40).map(str.encode),
    st.sampled_from([b"c 0 ", b"p 0 1 0 ", b"w axis0.requested_state ", b"*77", b"\n", b"nan\n", b"1e999\n"]),
)
DRIVES = {name: simulated(READY[name]) for name in ("odrive", "copley_ascii")}


@given(st.sampled_from(sorted(DRIVES)), st.lists(noise, max_size=8))
def test_random_bytes_neither_crash_a_drive_nor_stop_it_from_answering(name, chunks):
    axis = "0" if name == "odrive" else ""
    responder = AsciiResponder({"x": DRIVES[name]}, {"x": READY[name]}, {"x": options(axis)})
    received = bytearray()
    for chunk in chunks:
        received += chunk
        while responder.take(received) is not None:
            pass
    received.clear()
    responder.forget()
    request = b"r axis0.current_state*14\n" if name == "odrive" else b"g r0xa0\r"
    (reply,) = answers(responder, request)
    assert reply.endswith(b"\r") is (name != "odrive")
