"""Dynamixel on the driver's side: packets, requests, status packets, and what must never be taken for one."""

import contextlib
import itertools
import math
import sys

import pytest
from dynamixel_sdk import PacketHandler
from friction_hil_drivers.dynamixel.description import DynamixelDescription
from friction_hil_drivers.dynamixel.driver import DynamixelLine
from friction_hil_drivers.dynamixel.options import DynamixelOptions
from friction_hil_drivers.dynamixel.packets import HEADER, Packets
from friction_hil_drivers.dynamixel.table import Item
from friction_hil_drivers.serial_line.protocol import CycleSignals, Image, ReplyError
from hypothesis import example, given
from hypothesis import strategies as st

from friction_hil.errors import UsageError

# ROBOTIS e-Manual, DYNAMIXEL Protocol 2.0: the examples of its instructions
PING = "FF FF FD 00 01 03 00 01 19 4E"
READ = "FF FF FD 00 01 07 00 02 84 00 04 00 1D 15"
READ_STATUS = "FF FF FD 00 01 08 00 55 00 A6 00 00 00 8C C0"
READ_STATUS_2 = "FF FF FD 00 02 08 00 55 00 1F 08 00 00 BA BE"
WRITE = "FF FF FD 00 01 09 00 03 74 00 00 02 00 00 CA 89"
WRITE_STATUS = "FF FF FD 00 01 04 00 55 00 A1 0C"
SYNC_READ = "FF FF FD 00 FE 09 00 82 84 00 04 00 01 02 CE FA"
SYNC_WRITE = "FF FF FD 00 FE 11 00 83 74 00 04 00 01 96 00 00 00 02 AA 00 00 00 82 87"
FAST_READ = "FF FF FD 00 FE 0A 00 8A 84 00 04 00 03 07 04 20 F2"
FAST_STATUS = (
    "FF FF FD 00 FE 19 00 55 00 03 A6 00 00 00 84 08  00 07 1F 08 00 00 16 CA  00 04 FF 03 00 00 D1 9E"  # ids 3, 7, 4
)
SIGNALS = {
    "status": {"address": 64, "size": 1, "is_signed": False},
    "error": {"address": 70, "size": 1, "is_signed": False},
    "torque_command": {"address": 102, "size": 2, "unit": "A", "limit": 1193},
    "position_command": {"address": 116, "size": 4, "unit": "turn"},
    "torque": {"address": 126, "size": 2, "unit": "A"},
    "velocity": {"address": 128, "size": 4, "unit": "rpm"},
    "position": {"address": 132, "size": 4, "unit": "turn"},
}
ALL = CycleSignals(("position", "velocity"), ("torque", "status", "error"), ("torque_command",))
FAST = CycleSignals(("position",), (), ())
BYTES = st.sampled_from([0x00, 0x01, 0x55, 0xFD, 0xFE, 0xFF])  # those of which headers and stuffing are made


def described(**keys):
    """A servo with few demands."""
    given_keys: dict[str, object] = {
        "version": 1,
        "name": "servo under test",
        "protocol": "dynamixel",
        "sources": ["this test"],
        "states": [{"state": "operation_enabled", "value": 1}, {"state": "switch_on_disabled", "value": 0}],
        "enable": [{"write": {"status": 1}}],
        "disable": [{"write": {"status": 0}}],
        "modes": {"cst": {"commands": ["torque_command"]}},
        "signals": SIGNALS,
    }
    return DynamixelDescription.model_validate(given_keys | keys)


def on_line(*ids, **keys):
    """A line with servos; an axis is called by its ID."""
    line = {"port": "/dev/ttyUSB0"}
    options = {
        f"{n}": DynamixelOptions.model_validate({"line": line, "description": "x", "id": n}) for n in ids or (1,)
    }
    images = {axis: Image() for axis in options}
    return DynamixelLine(dict.fromkeys(options, described(**keys)), options, images), images


def with_crc(packet):
    """Append a CRC by this test's own arithmetic: polynomial 8005h, bit by bit."""
    crc = 0
    for byte in packet:
        crc ^= byte << 8
        for _ in range(8):
            crc = (crc << 1 ^ 0x8005 if crc & 0x8000 else crc << 1) & 0xFFFF
    return packet + crc.to_bytes(2, "little")


def status(servo, data=b"", error=0):
    """Status packet by this test's own arithmetic: stuffed byte by byte."""
    stuffed = bytearray((0x55,))
    for byte in bytes((error,)) + data:
        stuffed.append(byte)
        if stuffed[-3:] == b"\xff\xff\xfd":
            stuffed.append(0xFD)
    return with_crc(HEADER + bytes((servo,)) + (len(stuffed) + 2).to_bytes(2, "little") + stuffed)


def feedback(torque, velocity, position):
    parts = ((torque, 2), (velocity, 4), (position, 4))
    return b"".join(number.to_bytes(size, "little", signed=True) for number, size in parts)


def poll(line, images, wanted=ALL):
    """The one exchange before the computation, its request made."""
    (exchange,) = line.plan(dict.fromkeys(images, wanted)).poll
    exchange.encode()
    return exchange


def unhex(text):
    return bytes.fromhex(text)


# Known packets


def test_packets_are_those_of_the_manual():
    packets = Packets()
    assert packets.pack(1, 0x01) == unhex(PING)
    line, images = on_line(1, 2)
    assert line.read("1", ("position",)).encode() == unhex(READ)
    images["1"].values["position_command"] = 512.0
    assert line.write("1", ("position_command",)).encode() == unhex(WRITE)
    wanted = CycleSignals(("position",), (), ("position_command",))
    plan = line.plan(dict.fromkeys(images, wanted))
    assert [exchange.encode() for exchange in plan.poll] == [unhex(SYNC_READ)]
    images["1"].values["position_command"], images["2"].values["position_command"] = 150.0, 170.0
    assert [exchange.encode() for exchange in plan.push] == [unhex(SYNC_WRITE)]


def test_replies_of_the_manual_are_understood():
    line, images = on_line(1, 2)
    exchange = poll(line, images, FAST)
    received = bytearray(unhex(READ_STATUS + READ_STATUS_2))
    assert exchange.take(received)
    assert not received
    assert [images[axis].values for axis in "12"] == [{"position": 166.0}, {"position": 2079.0}]
    images["1"].values["position_command"] = 512.0
    write = line.write("1", ("position_command",))
    write.encode()
    assert write.take(bytearray(unhex(WRITE_STATUS)))
    line, images = on_line(3, 7, 4, fast_sync_read=True)
    (exchange,) = line.plan(dict.fromkeys(images, FAST)).poll
    assert exchange.encode() == unhex(FAST_READ)
    reply = unhex(FAST_STATUS)
    assert exchange.reply_size == len(reply)
    assert exchange.take(bytearray(reply))
    assert {axis: image.values["position"] for axis, image in images.items()} == {"3": 166.0, "7": 2079.0, "4": 1023.0}


class Port:
    """What the vendor's SDK takes for a port: ``answer`` gets each request."""

    is_using = False
    baudrate = 57600

    def __init__(self, answer=lambda request: b""):
        self._answer = answer
        self.written = self._reply = b""

    def getBaudRate(self):  # noqa: N802
        return self.baudrate

    def setPacketTimeoutMillis(self, milliseconds): ...  # noqa: N802

    def setPacketTimeout(self, length): ...  # noqa: N802

    def isPacketTimeout(self):  # noqa: N802
        return True

    def clearPort(self):  # noqa: N802
        self._reply = b""

    def writePort(self, packet):  # noqa: N802
        self.written = bytes(packet)
        self._reply = self._answer(self.written) or b""
        return len(packet)

    def readPort(self, length):  # noqa: N802
        data, self._reply = self._reply[:length], self._reply[length:]
        return data


@given(current=st.integers(-1193, 1193), other=st.integers(-1193, 1193), servo=st.integers(2, 252))
def test_requests_are_those_that_the_vendors_sdk_makes(current, other, servo):
    line, images = on_line(1, servo)
    images["1"].values["torque_command"], images[f"{servo}"].values["torque_command"] = current, other
    plan = line.plan(dict.fromkeys(images, ALL))
    sdk, paper = PacketHandler(2.0), Port()
    data = [servo_byte for n, v in ((1, current), (servo, other)) for servo_byte in (n, v & 0xFF, v >> 8 & 0xFF)]
    sdk.syncWriteTxOnly(paper, 102, 2, data, len(data))
    assert plan.push[0].encode() == paper.written
    assert len(paper.written) <= plan.push[0].request_size
    paper.is_using = False
    sdk.syncReadTx(paper, 126, 10, [1, servo], 2, False)
    assert plan.poll[0].encode() == paper.written
    assert len(paper.written) == plan.poll[0].request_size
    paper.is_using = False
    sdk.writeTxOnly(paper, servo, 102, 2, data[-2:])
    assert line.write(f"{servo}", ("torque_command",)).encode() == paper.written


# Numbers


@given(st.data(), st.sampled_from([1, 2, 4]), st.booleans(), st.sampled_from(["torque", "position"]))
def test_every_number_comes_back(data, size, is_signed, name):
    low = -(1 << 8 * size - 1) if is_signed else 0
    number = data.draw(st.integers(low, low + (1 << 8 * size) - 1))
    place = Item(name, 0, size, is_signed)
    packed = place.pack(float(number))
    assert len(packed) == size
    assert place.number(packed) == number


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_commands_stay_within_the_servos_limit_and_positions_wrap(number):
    command = Item("torque_command", 0, 2, True, limit=1193)
    assert command.number(command.pack(number)) == round(min(max(number, -1193.0), 1193.0))
    position = Item("position_command", 0, 4, True)
    packed = position.number(position.pack(number))
    assert -(2**31) <= packed < 2**31
    assert (int(packed) - round(number)) % 2**32 == 0


@pytest.mark.parametrize("number", [math.nan, math.inf, -math.inf])
def test_what_is_not_finite_is_never_sent(number):
    line, images = on_line(1, 2)
    images["1"].values["torque_command"], images["2"].values["torque_command"] = 0.0, number
    (push,) = line.plan(dict.fromkeys(images, ALL)).push
    with pytest.raises(ValueError, match=r"id 2: torque_command"):
        push.encode()


@given(st.lists(BYTES, max_size=30).map(bytes), st.integers(0, 252))
@example(unhex("00 FF FF FD 00 FF FD FD"), 1)  # dynamixel-sdk 4.1.0 takes a byte out of this that was not stuffed
def test_stuffing_comes_and_goes(data, servo):
    packets = Packets()
    packed = packets.pack(servo, 0x55, b"\x00" + data)
    assert packed == status(servo, data)
    assert HEADER not in packed[4:-2]
    received = bytearray(packed)
    packet = packets.cut(received, 1000)
    assert packet is not None
    assert (packet.id, packet.parameters, packet.is_whole) == (servo, b"\x00" + data, True)
    assert not received


# The plan


def test_a_cycle_of_servos_on_a_line():
    line, images = on_line(1, 2, 3)
    plan = line.plan(dict.fromkeys(images, ALL))
    assert [(e.label, e.reads) for e in plan.poll] == [
        ("read 10 bytes at 126 of id 1, 2, 3", ("torque", "velocity", "position"))
    ]
    assert [e.reads for e in plan.background] == [("status",), ("error",)]
    assert [(e.writes, e.reply_size) for e in plan.push] == [(("torque_command",), 0)]
    assert line.plan(dict.fromkeys(images, CycleSignals(ALL.fast, ALL.slow, ()))).push == ()


def test_servos_of_different_tables_are_asked_apart():
    line, images = on_line(1, 2)
    far = {**SIGNALS, "position": {"address": 611, "size": 4, "unit": "turn"}}
    options = {f"{n}": DynamixelOptions(line={"port": "x"}, description="x", id=n) for n in (1, 2)}
    line = DynamixelLine({"1": described(), "2": described(signals=far)}, options, images)
    plan = line.plan(dict.fromkeys(images, ALL))
    assert [e.label for e in plan.poll] == [
        "read 10 bytes at 126 of id 1",
        "read 6 bytes at 126 of id 2",
        "read 4 bytes at 611 of id 2",
    ]
    assert len(plan.push) == 1


def test_what_no_request_can_ask_for_is_refused(monkeypatch):
    line, _ = on_line(1)
    with pytest.raises(ValueError, match="position, status"):
        line.read("1", ("position", "status"))
    monkeypatch.setitem(sys.modules, "dynamixel_sdk.protocol2_packet_handler", None)
    with pytest.raises(UsageError, match=r"pip install 'friction-hil\[dynamixel\]'"):
        on_line(1)


# Replies


WORD, LONG = st.integers(-(2**15), 2**15 - 1), st.integers(-(2**31), 2**31 - 1)


@given(WORD, LONG, LONG, st.binary(max_size=6), st.lists(st.integers(0, 60), max_size=4))
@example(-1, -3, 0, b"", [])  # FF FF FD: stuffed
@example(-1, -515, -3, b"\xff\xff\xfd", [1, 2, 3, 4])
def test_a_reply_in_pieces_behind_noise(torque, velocity, position, noise, cuts):
    line, images = on_line(1, 2)
    exchange = poll(line, images)
    sent = noise + status(1, feedback(torque, velocity, position)) + status(2, feedback(0, 1, 2))
    received = bytearray()
    places = sorted({min(cut, len(sent)) for cut in cuts} | {0, len(sent)})
    results = []
    for start, end in itertools.pairwise(places):
        received += sent[start:end]
        results.append(exchange.take(received))
    assert results == [False] * (len(results) - 1) + [True]
    assert images["1"].values == {"torque": torque, "velocity": velocity, "position": position}
    assert images["2"].values == {"torque": 0.0, "velocity": 1.0, "position": 2.0}
    assert not received
    assert len(sent) - len(noise) <= exchange.reply_size


def test_a_missing_servo_is_named_and_the_others_are_fresh():
    line, images = on_line(1, 2, 3)
    exchange = poll(line, images)
    assert not exchange.take(bytearray())
    assert exchange.label == "read 10 bytes at 126 of id 1, 2, 3"
    received = bytearray(status(1, feedback(1, 2, 3)) + status(3, feedback(4, 5, 6)))
    assert not exchange.take(received)
    assert [axis for axis in images if images[axis].fresh] == ["1", "3"]
    assert exchange.label == "read 10 bytes at 126 of id 1, 2, 3 (2 missing)"
    received += status(2, feedback(7, 8, 9))
    assert exchange.take(received)
    assert exchange.label == "read 10 bytes at 126 of id 1, 2, 3"
    exchange.encode()  # it can be used again
    assert not exchange.take(bytearray(status(1, feedback(1, 2, 3))))
    exchange.encode()
    assert exchange.take(bytearray(b"".join(status(n, feedback(n, n, n)) for n in (1, 2, 3))))
    assert [image.values["position"] for image in images.values()] == [1.0, 2.0, 3.0]


def test_a_missing_servo_ends_a_fast_reply_but_not_those_before_it():
    line, images = on_line(3, 7, 4, fast_sync_read=True)
    exchange = poll(line, images, FAST)
    assert not exchange.take(bytearray(unhex(FAST_STATUS)[:-8]))
    assert [images[axis].fresh for axis in "374"] == [{"position"}, {"position"}, set()]
    assert exchange.label.endswith("(4 missing)")


@pytest.mark.parametrize("place", [2, *range(8, 32)])
def test_a_flipped_bit_in_a_fast_reply_costs_what_comes_from_there(place):
    line, images = on_line(3, 7, 4, fast_sync_read=True)
    exchange = poll(line, images, FAST)
    reply = bytearray(unhex(FAST_STATUS))
    reply[place] ^= 0x10
    with pytest.raises(ReplyError, match="id 3, 7, 4$" if place < 8 else "wrong CRC"):  # without its head it is none
        exchange.take(reply)
    assert [bool(images[axis].fresh) for axis in "374"] == [(place - 8) // 8 > k for k in range(3)]


@pytest.mark.parametrize("servos", [(1,), (1, 2)])
@pytest.mark.parametrize("place", [*range(5), *range(7, 21)])
def test_a_broken_packet_is_not_waited_for(place, servos):
    """Wherever it is broken but in its length; otherwise the line would be blocked until the time-out."""
    line, images = on_line(*servos)
    exchange = poll(line, images)
    broken = bytearray(status(servos[0], feedback(1, 2, 3)))
    broken[place] ^= 0x10
    received = broken + b"".join(status(servo, feedback(1, 2, 3)) for servo in servos[1:])
    with pytest.raises(ReplyError, match=r"CRC|id 1$") as caught:
        exchange.take(received)
    assert not caught.value.is_complete
    assert [bool(image.fresh) for image in images.values()] == [False, True][: len(servos)]


def test_noise_as_long_as_a_reply_does_not_cost_the_reply_that_has_begun():
    line, images = on_line(1)
    exchange = poll(line, images)
    reply = status(1, feedback(1, 2, 3))
    received = bytearray(b"\x07" * 40 + reply[:9])
    assert not exchange.take(received)
    received += reply[9:]
    assert exchange.take(received)


@given(st.integers(0, 20), st.integers(0, 7))
def test_no_flipped_bit_puts_a_value(place, bit):
    line, images = on_line(1, 2)
    exchange = poll(line, images)
    broken = bytearray(status(1, feedback(1, 2, 3)))
    broken[place] ^= 1 << bit
    with contextlib.suppress(ReplyError):
        exchange.take(broken + status(2, feedback(4, 5, 6)))
    assert not images["1"].fresh
    assert images["2"].values["position"] == 6.0  # whatever the broken one says of its length


@given(st.lists(st.one_of(BYTES, st.integers(0, 255)), max_size=80).map(bytes), st.booleans())
def test_random_bytes_never_crash_and_never_put_a_value(noise, is_fast):
    line, images = on_line(1, 2, fast_sync_read=is_fast)
    exchange = poll(line, images)
    received = bytearray(noise)
    with contextlib.suppress(ReplyError):
        assert not exchange.take(received)
    assert not any(image.values for image in images.values())
    assert len(received) <= len(noise)


def test_refusals_are_told_in_words():
    line, images = on_line(1, 2)
    images["1"].values["torque_command"] = 5.0
    write = line.write("1", ("torque_command",))
    write.encode()
    with pytest.raises(ReplyError, match=r"id 1 .*\(error 4\)") as caught:
        write.take(bytearray(status(1, error=0x84)))
    assert caught.value.is_complete
    exchange = poll(line, images)
    with pytest.raises(ReplyError, match=r"id 1 refuses: access") as caught:
        exchange.take(bytearray(status(1, error=7) + status(2, feedback(1, 2, 3))))
    assert caught.value.is_complete
    assert images["2"].values["position"] == 3.0


@pytest.mark.parametrize(("has_echo", "error"), [(False, 0x80), (True, 0)])
def test_an_alert_is_no_refusal_and_an_echo_is_passed_over(has_echo, error):
    line, images = on_line(1)
    (exchange,) = line.plan({"1": ALL}).poll
    request = exchange.encode()
    assert exchange.take(bytearray(request * has_echo + status(1, feedback(1, 2, 3), error=error)))
    assert images["1"].values["position"] == 3.0


@pytest.mark.parametrize(
    ("reply", "message"),
    [
        (status(3, feedback(1, 2, 3)), "by id 3"),
        (status(1), "id 1 answered with 0 bytes .*10"),  # to a write of the cycle before
        (status(1, b"\x01"), "id 1 answered with 1 bytes .*10"),
        (status(1, feedback(1, 2, 3)) + status(1, feedback(4, 5, 6)), "id 1 twice"),
    ],
)
def test_answers_to_something_else_are_no_answers(reply, message):
    line, images = on_line(1, 2)
    exchange = poll(line, images)
    with pytest.raises(ReplyError, match=message) as caught:
        exchange.take(bytearray(reply))
    assert not caught.value.is_complete
    assert images["1"].values.get("position", 3.0) == 3.0
    assert not images["2"].fresh
