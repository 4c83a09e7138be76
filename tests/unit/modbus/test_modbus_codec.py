"""Modbus on the driver's side: numbers in registers, requests, replies, and what must never be taken for a reply."""

import contextlib
import itertools
import math
import struct

import pytest
from friction_hil_drivers.modbus.codec import ModbusExchange
from friction_hil_drivers.modbus.description import ModbusDescription
from friction_hil_drivers.modbus.driver import ModbusLine
from friction_hil_drivers.modbus.framing import RtuFraming, TcpFraming
from friction_hil_drivers.modbus.options import ModbusOptions
from friction_hil_drivers.modbus.registers import RegisterBlock, RegisterField
from friction_hil_drivers.serial_line.protocol import Image, ReplyError
from hypothesis import assume, example, given, settings
from hypothesis import strategies as st

RTU, TCP = "/dev/ttyUSB0", "tcp://127.0.0.1:502"
RANGES = {"int16": (-(2**15), 2**15 - 1), "uint16": (0, 2**16 - 1)}
RANGES |= {"int32": (-(2**31), 2**31 - 1), "uint32": (0, 2**32 - 1), "bool": (0, 1)}
SIGNALS = {
    "status": {"address": 0x10, "type": "uint16"},
    "torque": {"address": 0x11, "unit": "per_mille"},
    "position": {"address": 0x12, "type": "int32", "unit": "count"},
    "velocity": {"address": 0x14, "type": "int32", "unit": "count/s"},
    "error": {"address": 0x18, "type": "uint16"},
    "control": {"address": 0x20, "type": "uint16"},
    "torque_command": {"address": 0x30, "unit": "per_mille"},
    "position_command": {"address": 0x31, "type": "int32", "unit": "count"},
}
KEYS = {
    "version": 1,
    "name": "drive under test",
    "protocol": "modbus",
    "sources": ["this test"],
    "state_machine": "cia402",
    "word_order": "big",
    "modes": {"cst": {"commands": ["torque_command"]}},
}
VALUES = {"s0": 555.0, "s1": 0.0, "s2": 100.0, "torque_command": 7.0}
CSP, CST = ("torque_command", "position_command"), ("torque_command",)


def described(changed=None, *, is_whole=False, **keys):
    """The map above with some signals changed, None for one that is left out, or with others (``is_whole``)."""
    signals = {**({} if is_whole else SIGNALS), **(changed or {})}
    present = {name: signal for name, signal in signals.items() if signal is not None}
    return ModbusDescription.model_validate(KEYS | {"signals": present} | keys)


def on_line(description, port=RTU, unit=1, **line):
    """A line with one axis, a."""
    options = ModbusOptions.model_validate({"line": {"port": port} | line, "description": "x", "unit": unit})
    image = Image()
    return ModbusLine({"a": description}, {"a": options}, {"a": image}), image


def with_crc(text):
    """Frame of a PDU with its unit, by a CRC of this test's own: bit by bit, as the specification draws it."""
    frame = bytes.fromhex(text) if isinstance(text, str) else text
    crc = 0xFFFF
    for byte in frame:
        crc ^= byte
        for _ in range(8):
            crc = (crc >> 1) ^ 0xA001 if crc & 1 else crc >> 1
    return frame + struct.pack("<H", crc)


def reader(count=3, *, unit=1):
    """Exchange of function 3 that reads 16-bit signals s0, s1, ... from 006Bh on, its request sent."""
    image = Image({"torque_command": 7.0})
    fields = tuple(RegisterField(f"s{k}", "holding", 0x6B + k, "int16") for k in range(count))
    request = ModbusExchange(RtuFraming(), unit, image, read=RegisterBlock("holding", 0x6B, count, fields))
    assert request.encode() == with_crc(bytes((unit, 3, 0, 0x6B, 0, count)))
    return request, image


class TestRegisterField:
    @pytest.mark.parametrize("word_order", ["big", "little"])
    @pytest.mark.parametrize("byte_order", ["big", "little"])
    @pytest.mark.parametrize("kind", [*RANGES, "float32"])
    @settings(deadline=None)
    @given(data=st.data())
    def test_every_number_comes_back(self, kind, byte_order, word_order, data):
        floats = st.floats(width=32, allow_nan=False, allow_infinity=False)
        number = data.draw(floats if kind == "float32" else st.integers(*RANGES[kind]))
        field = RegisterField("torque", "holding", 0, kind, word_order, byte_order)
        words = field.words(float(number))
        assert all(0 <= word < 2**16 for word in words)
        assert field.number(words) == number

    @pytest.mark.parametrize(
        ("word_order", "byte_order", "words"),
        [
            ("big", "big", [0x1234, 0x5678]),
            ("little", "big", [0x5678, 0x1234]),
            ("big", "little", [0x3412, 0x7856]),
            ("little", "little", [0x7856, 0x3412]),
        ],
    )
    def test_orders_of_32_bits(self, word_order, byte_order, words):
        field = RegisterField("x", "holding", 0, "uint32", word_order, byte_order)
        assert field.words(float(0x12345678)) == words

    @pytest.mark.parametrize("kind", RANGES)
    @settings(deadline=None)
    @given(number=st.floats(allow_nan=False, allow_infinity=False), position=st.integers(-(2**50), 2**50))
    def test_what_does_not_fit_saturates_and_positions_wrap(self, kind, number, position):
        low, high = RANGES[kind]
        field = RegisterField("torque_command", "holding", 0, kind)
        assert field.number(field.words(number)) == min(max(round(number), low), high)
        if kind != "bool":
            field = RegisterField("position_command", "holding", 0, kind)
            sent = field.number(field.words(float(position)))
            assert low <= sent <= high
            assert (sent - position) % (high - low + 1) == 0

    def test_floats_stay_finite(self):
        field = RegisterField("torque_command", "holding", 0, "float32")
        assert field.number(field.words(1e300)) == pytest.approx(3.4028235e38)

    @pytest.mark.parametrize("name", ["torque_command", "position_command"])
    @pytest.mark.parametrize("kind", ["int16", "float32", "int32"])
    @pytest.mark.parametrize("number", [math.nan, math.inf, -math.inf])
    def test_refuses_what_is_not_finite(self, kind, name, number):
        with pytest.raises(ValueError, match="cannot be sent"):
            RegisterField(name, "holding", 0, kind).words(number)
        line, image = on_line(described())
        image.values["torque_command"] = number
        with pytest.raises(ValueError, match="unit 1: torque_command"):
            line.write("a", CST).encode()


class TestKnownFrames:
    """Frames printed in the specification (Modbus Application Protocol V1.1b3, section 6) and in manuals of drives."""

    @pytest.mark.parametrize(
        ("signal", "frame", "reply", "value"),
        [
            ({"address": 0x6B}, "11 03 00 6B 00 01", "11 03 02 02 2B", 555.0),
            ({"address": 8, "function": "input"}, "11 04 00 08 00 01", "11 04 02 00 0A", 10.0),
            ({"address": 0x13, "function": "coil", "type": "bool"}, "11 01 00 13 00 01", "11 01 01 CD", 1.0),
            ({"address": 0xC4, "function": "discrete", "type": "bool"}, "11 02 00 C4 00 01", "11 02 01 AC", 0.0),
        ],
    )
    def test_reading(self, signal, frame, reply, value):
        line, image = on_line(described({"extra": signal}), unit=0x11)
        request = line.read("a", ("extra",))
        assert request.encode() == with_crc(frame)
        assert request.take(bytearray(with_crc(reply)))
        assert image.values == {"extra": value}
        assert (request.request_size, request.reply_size) == (8, len(with_crc(reply)))

    @pytest.mark.parametrize(
        ("signal", "number", "functions", "frame"),
        [
            ({"address": 1}, 3.0, (6, 16), "11 06 00 01 00 03"),
            ({"address": 1}, 3.0, (16,), "11 10 00 01 00 01 02 00 03"),
            ({"address": 1, "type": "int32"}, 0xA0102, (6, 16), "11 10 00 01 00 02 04 00 0A 01 02"),
            ({"address": 0xAC, "function": "coil", "type": "bool"}, 1.0, (5, 16), "11 05 00 AC FF 00"),
            ({"address": 0xAC, "function": "coil", "type": "bool"}, 1.0, (15, 16), "11 0F 00 AC 00 01 01 01"),
        ],
    )
    def test_writing(self, signal, number, functions, frame):
        line, image = on_line(described({"extra": signal}, write_functions=functions), unit=0x11)
        image.values["extra"] = number
        request = line.write("a", ("extra",))
        sent = request.encode()
        assert sent == with_crc(frame)
        assert request.request_size == len(sent)
        reply = bytearray(with_crc(sent[:6]))
        assert request.reply_size == len(reply)
        assert request.take(reply)
        assert not reply

    def test_writing_and_reading_at_once(self):
        signals = {f"s{k}": {"address": 3 + k, "type": "uint16"} for k in range(6)}
        signals |= {f"w{k}": {"address": 0xE + k, "type": "uint16"} for k in range(3)}
        image = Image({f"w{k}": 255.0 for k in range(3)})
        description = described(signals)
        request = ModbusExchange(
            RtuFraming(),
            0x11,
            image,
            read=description.read_blocks(tuple(f"s{k}" for k in range(6)))[0],
            write=description.write_blocks(tuple(f"w{k}" for k in range(3)))[0],
        )
        assert request.encode() == with_crc("11 17 00 03 00 06 00 0E 00 03 06 00 FF 00 FF 00 FF")
        assert request.take(bytearray(with_crc("11 17 0C 00 FE 0A CD 00 01 00 03 00 0D 00 FF")))
        assert [image.values[f"s{k}"] for k in range(6)] == [0xFE, 0xACD, 1, 3, 0xD, 0xFF]
        assert (request.request_size, request.reply_size) == (19, 17)

    def test_those_of_kinco_with_their_crc(self):
        signals = {
            "status": {"address": 0x3200, "type": "uint32"},
            "control": {"address": 0x3100, "type": "uint16"},
            "velocity_command": {"address": 0x6F00, "type": "int32", "unit": "count/s", "word_order": "little"},
        }
        line, image = on_line(described(signals))
        assert line.read("a", ("status",)).encode().hex(" ") == "01 03 32 00 00 02 ca b3"
        image.values.update(control=15.0, velocity_command=float(0x85555))
        assert line.write("a", ("control",)).encode().hex(" ") == "01 06 31 00 00 0f c7 32"
        written = line.write("a", ("velocity_command",)).encode()
        assert written.hex(" ") == "01 10 6f 00 00 02 04 55 55 00 08 1a 47"

    def test_that_of_delta_with_its_crc(self):
        line, image = on_line(described({"extra": {"address": 0x112, "type": "uint32", "word_order": "little"}}))
        image.values["extra"] = 0x0BB8
        request = line.write("a", ("extra",))
        assert request.encode().hex(" ") == "01 10 01 12 00 02 04 0b b8 00 00 fc eb"
        assert request.take(bytearray.fromhex("01 10 01 12 00 02 E0 31"))


class TestReplies:
    REPLY = with_crc("01 03 06 02 2B 00 00 00 64")

    @settings(deadline=None)
    @given(noise=st.binary(max_size=6), at=st.integers(0, 16))
    @example(b"\x01", 16)  # noise that looks like the beginning
    @example(b"\x01\xff", 16)
    @example(b"\x01\x03", 16)
    @example(b"\x01\x03\x01", 16)
    @example(b"\x00\x01\x80", 16)
    def test_in_two_pieces_behind_noise_is_found(self, noise, at):
        assume(b"\x01" not in noise or at == 16)
        request, image = reader()
        whole = noise + self.REPLY
        received = bytearray(whole[:at])
        if at < len(whole):
            assert not request.take(received)
            assert not image.fresh
            received += whole[at:]
        assert request.take(received)
        assert image.values == VALUES
        assert not received

    @settings(deadline=None)
    @given(flipped=st.integers(0, 8 * len(REPLY) - 1))
    def test_a_flipped_bit_puts_nothing(self, flipped):
        request, image = reader()
        frame = bytearray(self.REPLY)
        frame[flipped // 8] ^= 1 << flipped % 8
        with contextlib.suppress(ReplyError):
            assert not request.take(frame)
        assert image.values == {"torque_command": 7.0}
        assert not image.fresh

    @settings(max_examples=200, deadline=None)
    @given(pieces=st.lists(st.binary(max_size=40), max_size=4))
    def test_random_bytes_never_become_a_value(self, pieces):
        request, image = reader()
        received = bytearray()
        for piece in pieces:
            received += piece
            try:
                assert not request.take(received)
            except ReplyError:
                break
        assert image.values == {"torque_command": 7.0}
        assert not image.fresh

    @settings(max_examples=200, deadline=None)
    @given(
        body=st.binary(min_size=2, max_size=20), unit=st.integers(1, 3), function=st.sampled_from([3, 6, 0x83, 0x81])
    )
    def test_with_a_right_crc_only_the_reply_asked_for_counts(self, body, unit, function):
        request, image = reader()
        frame = with_crc(bytes((unit, function)) + body)
        assume(not (unit == 1 and function == 3 and body[0] == 6 and len(body) == 7))
        with contextlib.suppress(ReplyError):
            assert not request.take(bytearray(frame))
        assert not image.fresh

    @pytest.mark.parametrize(
        ("frame", "text"),
        [
            ("03 03 06 02 2B 00 00 00 64", "unit 3 .*unit 1: 03 03 06"),
            ("01 04 06 02 2B 00 00 00 64", "function 4 .*3"),
            ("01 03 04 02 2B 00 00", "number or the address"),
            ("01 03 00 6B 00 03", "echo"),
        ],
    )
    def test_of_somebody_else_are_told(self, frame, text):
        request, image = reader()
        received = bytearray(with_crc(frame))
        with pytest.raises(ReplyError, match=text) as caught:
            request.take(received)
        assert not caught.value.is_complete
        assert not received
        assert not image.fresh

    def test_with_a_wrong_crc_are_told(self):
        request, _ = reader()
        with pytest.raises(ReplyError, match="CRC is wrong: 01 03 06"):
            request.take(bytearray(self.REPLY[:-1] + b"\x00"))

    @pytest.mark.parametrize("code", [1, 2, 3, 4, 5, 6, 8, 10, 11, 99])
    @pytest.mark.parametrize("function", [0x83, 0x81])  # another function than that of the request: so does Kinco
    def test_exceptions_are_told(self, code, function):
        request, image = reader()
        received = bytearray(with_crc(bytes((1, function, code))))
        with pytest.raises(ReplyError, match=rf"unit 1 .* .exception {code}.") as caught:
            request.take(received)
        assert caught.value.is_complete
        assert not received
        assert not image.fresh

    def test_another_value_written_than_sent_is_told(self):
        line, image = on_line(described())
        image.values["torque_command"] = 300.0
        request = line.write("a", CST)
        request.encode()
        with pytest.raises(ReplyError):
            request.take(bytearray(with_crc("01 06 00 30 00 64")))

    def test_not_a_number_is_refused(self):
        line, image = on_line(described({"velocity": {"address": 0x14, "type": "float32", "unit": "rad/s"}}))
        request = line.read("a", ("velocity",))
        request.encode()
        with pytest.raises(ReplyError, match="velocity is nan"):
            request.take(bytearray(with_crc(b"\x01\x03\x04" + struct.pack(">f", math.nan))))
        assert not image.fresh


class TestTcp:
    def reader(self):
        line, image = on_line(described(), TCP)
        return line.read("a", ("torque",)), image

    @staticmethod
    def reply(request, body="03 02 00 05", *, unit=1, later=0):
        """Reply to a request, or to one ``later`` requests after it."""
        transaction = int.from_bytes(request[:2], "big") + later
        pdu = bytes.fromhex(body)
        return struct.pack(">HHHB", transaction, 0, len(pdu) + 1, unit) + pdu

    def test_sizes_and_frame(self):
        request, image = self.reader()
        sent = request.encode()
        assert sent[2:] == bytes.fromhex("00 00 00 06 01 03 00 11 00 01")
        reply = self.reply(sent)
        assert (request.request_size, request.reply_size) == (len(sent), len(reply))
        assert request.take(bytearray(reply))
        assert image.values == {"torque": 5.0}

    def test_each_request_of_a_line_has_its_number(self):
        framing = TcpFraming()
        numbers = [int.from_bytes(framing.frame(1, b"\x03")[:2], "big") for _ in range(70_000)]
        assert all(following == before % 0xFFFF + 1 for before, following in itertools.pairwise(numbers))
        line, _ = on_line(described(), TCP)
        frames = [line.read("a", (name,)).encode() for name in ("torque", "position", "torque")]
        assert len({frame[:2] for frame in frames}) == 3

    @pytest.mark.parametrize("at", range(11))
    def test_a_late_reply_is_dropped_and_the_present_one_may_come_in_two_pieces(self, at):
        request, image = self.reader()
        late = self.reply(request.encode(), "03 02 00 63")
        whole = late + self.reply(request.encode())
        received = bytearray(whole[: len(late) + at])
        assert not request.take(received)
        assert at or not received
        received += whole[len(late) + at :]
        assert request.take(received)
        assert image.values == {"torque": 5.0}

    @pytest.mark.parametrize(
        ("body", "unit", "text"),
        [
            ("03 02 00 05", 3, "unit 3 .*unit 1"),
            ("04 02 00 05", 1, "function 3"),
            ("03 04 00 05 00 05", 1, "function 3"),
            ("83 06", 1, "exception 6"),
        ],
    )
    def test_no_reply_to_this_request(self, body, unit, text):
        request, image = self.reader()
        received = bytearray(self.reply(request.encode(), body, unit=unit))
        with pytest.raises(ReplyError, match=text) as caught:
            request.take(received)
        assert caught.value.is_complete
        assert not image.fresh

    @settings(max_examples=200, deadline=None)
    @given(data=st.binary(max_size=60))
    def test_random_bytes_never_become_a_value(self, data):
        request, image = self.reader()
        request.encode()
        assume(data[:2] != b"\x00\x01")
        with contextlib.suppress(ReplyError):
            assert not request.take(bytearray(data))
        assert not image.fresh
