"""The drives' end of Modbus in the simulation, on bytes: known frames, pymodbus' own requests, the driver's codec."""

import struct

import pytest
from friction_hil_drivers.modbus.options import ModbusOptions
from friction_hil_drivers.modbus.simulated import ModbusResponder
from friction_hil_drivers.serial_line.simulated.drive import RefusedError
from hypothesis import given, settings
from hypothesis import strategies as st
from pymodbus.framer import FramerRTU, FramerSocket
from pymodbus.pdu import DecodePDU

from tests.unit.modbus.test_modbus_codec import RTU, TCP
from tests.unit.modbus.test_modbus_codec import described as described_as

SIGNALS = {
    "status": {"address": 0, "type": "uint16"},
    "torque": {"address": 1, "unit": "per_mille"},
    "position": {"address": 2, "type": "int32", "unit": "count"},
    "velocity": {"address": 4, "type": "int32", "unit": "count/s"},
    "error": {"address": 8, "type": "uint16", "function": "input"},
    "ready": {"address": 0x13, "type": "bool", "function": "discrete"},
    "moving": {"address": 0x14, "type": "bool", "function": "discrete"},
    "control": {"address": 0x100, "type": "uint16"},
    "torque_command": {"address": 0x101, "unit": "per_mille"},
    "position_command": {"address": 0x102, "type": "int32", "unit": "count"},
    "brake": {"address": 0xAC, "type": "bool", "function": "coil"},
    "light": {"address": 0xAD, "type": "bool", "function": "coil"},
}


class Drive:
    """Stands for a simulated drive: keeps what is written, in order, and lets position follow samples."""

    def __init__(self):
        self.numbers: dict[str, float] = {"position": 1000.0}
        self.written: list[tuple[str, float]] = []
        self.events: list[str] = []

    def read(self, name):
        self.events.append(f"read {name}")
        return self.numbers.get(name, 0.0)

    def write(self, name, number):
        self.events.append(f"write {name}")
        if name in ("status", "torque", "position", "velocity") or (name == "torque_command" and number == 666.0):
            raise RefusedError(name)
        self.written.append((name, number))
        self.numbers[name] = number

    def sample(self):
        self.events.append("sample")


def described(signals=SIGNALS, **keys):
    csp = {"csp": {"commands": ["torque_command", "position_command"]}}
    given_keys = {"write_functions": [5, 6, 15, 16], "read_write_multiple": True, "modes": csp, **keys}
    return described_as(signals, is_whole=True, **given_keys)


class Bench:
    """A responder with one drive at unit 1, and another at unit 2."""

    def __init__(self, port=RTU, **keys):
        self.drive, self.other = Drive(), Drive()
        description = described(**keys)
        options = {
            axis: ModbusOptions.model_validate({"line": {"port": port}, "description": "x", "unit": unit})
            for axis, unit in (("a", 1), ("b", 2))
        }
        self.responder = ModbusResponder(
            {"a": self.drive, "b": self.other}, dict.fromkeys(options, description), options
        )
        self.framer = (FramerSocket if port == TCP else FramerRTU)(DecodePDU(False))

    def answer(self, pdu, unit=1):
        """PDU that answers one in hexadecimal; empty: no reply."""
        received = bytearray(self.framer.encode(bytes.fromhex(pdu), unit, 7))
        reply = self.responder.take(received)
        assert reply is not None
        assert not received
        if not reply:
            return ""
        used, replying, transaction, data = self.framer.decode(reply)
        assert (used, replying) == (len(reply), unit)
        assert transaction in (0, 7)
        return data.hex(" ")


@pytest.fixture(params=[RTU, TCP])
def bench(request):
    return Bench(request.param)


class TestKnownFrames:
    """The examples of the Modbus Application Protocol Specification V1.1b3, at the addresses of this map."""

    def test_read(self, bench):
        bench.drive.numbers |= {"status": 0x022B, "torque": 100.0, "error": 10.0, "ready": 1.0, "brake": 1.0}
        assert bench.answer("03 00 00 00 02") == "03 04 02 2b 00 64"
        assert bench.answer("04 00 08 00 01") == "04 02 00 0a"
        assert bench.answer("02 00 13 00 02") == "02 01 01"
        assert bench.answer("01 00 AC 00 02") == "01 01 01"
        assert bench.answer("03 00 02 00 04") == "03 08 00 00 03 e8 00 00 00 00"

    def test_write(self, bench):
        assert bench.answer("06 01 00 00 03") == "06 01 00 00 03"
        assert bench.answer("10 01 02 00 02 04 00 0A 01 02") == "10 01 02 00 02"
        assert bench.answer("05 00 AC FF 00") == "05 00 ac ff 00"
        assert bench.answer("0F 00 AC 00 02 01 02") == "0f 00 ac 00 02"
        wanted = [("control", 3.0), ("position_command", float(0xA0102))]
        assert bench.drive.written == [*wanted, ("brake", 1.0), ("brake", 0.0), ("light", 1.0)]

    def test_function_23_passes_a_period_then_writes_then_reads(self, bench):
        assert bench.answer("17 00 02 00 04 01 01 00 01 02 00 2A").startswith("17 08")
        assert bench.drive.events[0] == "sample"
        writing = bench.drive.events.index("write torque_command")
        assert writing < bench.drive.events.index("read position")
        assert bench.drive.written == [("torque_command", 42.0)]

    @pytest.mark.parametrize(
        ("pdu", "reply"),
        [
            *(("2B 0E 01 00", "ab 01"), ("07", "87 01"), ("05 00 AC 12 34", "85 03"), ("05 00 00 FF 00", "85 02")),
            *((pdu, "83 02") for pdu in ("03 00 06 00 01", "03 00 00 00 07", "03 FF FF 00 02")),
            *((pdu, "83 03") for pdu in ("03 00 00 00 00", "03 00 00 00 7E")),
            *(("06 00 06 00 01", "86 02"), ("06 00 00 00 01", "86 03"), ("06 01 01 02 9A", "86 03")),
            *((pdu, "90 03") for pdu in ("10 01 01 00 02 02 00 01", "10 01 01 00 01 03 00 01 00")),
            *(("10 01 03 00 02 04 00 01 00 01", "90 02"), ("0F 00 AC 00 02 02 02 00", "8f 03")),
            ("17 00 06 00 01 01 01 00 01 02 00 01", "97 02"),
        ],
    )
    def test_exceptions(self, bench, pdu, reply):
        assert bench.answer(pdu) == reply
        assert not bench.drive.written

    def test_functions_that_the_drive_has_not(self):
        bench = Bench(read_write_multiple=False, write_functions=[5, 16])
        assert bench.answer("17 00 02 00 02 01 01 00 01 02 00 01") == "97 01"
        assert bench.answer("06 01 01 00 01") == "86 01"
        assert bench.answer("0F 00 AC 00 02 01 02") == "8f 01"

    def test_reading_over_what_is_unused(self):
        assert Bench(max_gap_registers=2).answer("03 00 05 00 02") == "03 04 00 00 00 00"
        assert Bench(max_gap_registers=2).answer("03 00 06 00 01") == "83 02"

    def test_aligned_access(self):
        signals = SIGNALS | {"torque_command": {"address": 0x104, "unit": "per_mille"}}
        bench = Bench(alignment=2, write_functions=[5, 15, 16], signals=signals | {"light": SIGNALS["ready"]})
        assert bench.answer("10 01 04 00 02 04 00 07 00 00") == "10 01 04 00 02"
        assert bench.drive.written == [("torque_command", 7.0)]
        assert bench.answer("10 01 04 00 01 02 00 07") == "90 02"
        assert bench.answer("03 00 01 00 02") == "83 02"


class TestNumbers:
    def test_a_half_written_command_waits_for_its_other_half(self):
        bench = Bench(write_functions=[5, 6, 15, 16])
        bench.drive.numbers["position_command"] = float(0x1111_2222)
        assert bench.answer("06 01 02 00 01") == "06 01 02 00 01"
        assert bench.drive.written == []
        assert bench.answer("06 01 03 00 05") == "06 01 03 00 05"
        assert bench.drive.written == [("position_command", float(0x1_0005))]
        assert bench.answer("06 01 03 00 06") == "06 01 03 00 06"  # the high word stays
        assert bench.drive.written[-1] == ("position_command", float(0x1_0006))

    @settings(deadline=None)
    @given(position=st.integers(-(2**45), 2**45), ahead=st.integers(-(2**30), 2**30))
    def test_positions_wrap_on_the_line_and_unwrap_in_the_drive(self, position, ahead):
        bench = Bench()
        bench.drive.numbers["position"] = float(position)
        seen = struct.unpack(">i", bytes.fromhex(bench.answer("03 00 02 00 02"))[2:])[0]
        assert (seen - position) % 2**32 == 0
        target = struct.pack(">I", (position + ahead) % 2**32).hex()
        assert bench.answer(f"10 01 02 00 02 04 {target}") == "10 01 02 00 02"
        assert bench.drive.written == [("position_command", float(position + ahead))]

    def test_what_is_not_finite_is_refused(self):
        signals = SIGNALS | {"position_command": {"address": 0x102, "type": "float32", "unit": "rad"}}
        bench = Bench(signals=signals)
        assert bench.answer("10 01 02 00 02 04 7F C0 00 00") == "90 03"
        assert bench.drive.written == []


class TestLine:
    def test_only_who_is_meant_answers_and_a_broadcast_is_obeyed_in_silence(self, bench):
        assert bench.answer("03 00 00 00 01", unit=3) == ""
        assert bench.answer("06 01 01 00 09", unit=2) == "06 01 01 00 09"
        assert bench.drive.events == []
        assert bench.other.written == [("torque_command", 9.0)]
        rtu = Bench()
        assert rtu.answer("06 01 01 00 09", unit=0) == ""
        assert rtu.drive.written == rtu.other.written == [("torque_command", 9.0)]

    def test_a_wrong_crc_gets_no_reply(self):
        bench = Bench()
        frame = bytearray(bench.framer.encode(bytes.fromhex("06 01 01 00 09"), 1, 0))
        frame[-1] ^= 1
        assert bench.responder.take(frame) == b""
        assert not frame
        assert not bench.drive.events

    @pytest.mark.parametrize(
        "pdu", ["03 00 00 00 02", "17 00 02 00 04 01 01 00 01 02 00 2A", "10 01 01 00 01 02 00 07"]
    )
    def test_requests_may_come_in_two_pieces_and_are_taken_one_at_a_time(self, bench, pdu):
        frame = bench.framer.encode(bytes.fromhex(pdu), 1, 7)
        received = bytearray(2 * frame)
        whole = bench.responder.take(received)
        assert whole
        assert received == frame
        for at in range(1, len(frame)):
            received = bytearray(frame[:at])
            assert bench.responder.take(received) is None
            assert received == frame[:at]
            received += frame[at:]
            assert bench.responder.take(received) == whole

    @settings(max_examples=300, deadline=None)
    @given(data=st.binary(max_size=80), port=st.sampled_from([RTU, TCP]))
    def test_random_bytes_do_no_harm(self, data, port):
        bench = Bench(port)
        received = bytearray(data)
        while received and bench.responder.take(received) is not None:
            pass
        if port == RTU:
            assert not bench.drive.written

    @settings(max_examples=300, deadline=None)
    @given(
        function=st.sampled_from([1, 2, 3, 4, 5, 6, 15, 16, 23, 43]),
        body=st.binary(max_size=40),
        unit=st.integers(0, 2),
    )
    def test_any_pdu_gets_an_answer(self, function, body, unit):
        bench = Bench(TCP)
        frame = bench.framer.encode(bytes((function,)) + body, unit, 7)
        reply = bench.responder.take(bytearray(frame))
        assert reply is not None
        assert bool(reply) == (unit != 0)
        if reply:
            assert reply[7] in (function, function | 0x80)
