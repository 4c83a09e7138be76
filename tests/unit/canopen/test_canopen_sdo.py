"""SDO client against a server that answers late, twice or wrongly, in simulated time."""

import struct

import pytest
from friction_hil_drivers.canopen.sdo.client import PATIENCE_S
from friction_hil_drivers.canopen.sdo.dialogue import Download, Upload
from friction_hil_drivers.canopen.wire import cia301
from friction_hil_drivers.cia402 import objects

from friction_hil.errors import DriveError
from tests.canopen_bench import SDO_ANSWER, SDO_REQUEST, Bench, SlowBus


class Server(SlowBus):
    """A drive on the bench; ``change`` may make something else of its answers."""

    def __init__(self, **settings):
        self.bench = Bench(**settings)
        self.change = lambda request, answer: answer
        self.requests, self.aborts = [], []
        super().__init__(self.answered, lambda request: 0.0)

    def send(self, can_id, data):
        (self.aborts if data[0] == 0x80 else self.requests).append(bytes(data))
        super().send(can_id, data)

    def answered(self, data):
        return [(can_id, self.change(data, answer)) for can_id, answer in self.bench.send(SDO_REQUEST, data)]


def asks(request, index, subindex=0):
    return struct.unpack_from("<HB", request, 1) == (index, subindex)


def abort(index, subindex, code):
    return struct.pack("<BHBI", 0x80, index, subindex, code)


@pytest.mark.parametrize("delay_s", [0.7, 0.9, 1.7, 2.9])
def test_a_late_abort_is_not_taken_for_the_next_answer(delay_s):
    """A drive that was slow once was believed to have no 60A9h, and turned at three times its limit."""
    bus = Server(missing=[0x60C2])
    bus.delay = lambda request: delay_s if asks(request, 0x60C2, 1) else 0.0
    assert bus.client.find(objects.INTERPOLATION_PERIOD) is None
    assert bus.client.find(objects.VELOCITY_UNIT) == bus.bench.read(0x60A9)
    assert bus.client.find(objects.RATED_TORQUE) == bus.bench.read(0x6076)


def test_an_answer_that_comes_after_the_request_was_given_up_is_dropped_and_told():
    bus = Server()
    bus.delay = lambda request: PATIENCE_S + 0.2 if asks(request, 0x608F, 1) else 0.0
    with pytest.raises(DriveError, match=r"608Fh:01.*FH-206"):
        bus.client.find(objects.ENCODER_INCREMENTS)
    bus.delay = lambda request: 0.0
    assert bus.client.find(objects.VELOCITY_UNIT) == bus.bench.read(0x60A9)
    assert any("the value of 608Fh:01 when nothing waited for it" in note for note in bus.client.notes)


def test_a_lost_request_for_an_object_only_costs_time():
    bus = Server()
    bus.delay = lambda request: None if len(bus.requests) == 1 else 0.0
    assert [bus.client.read(objects.STATUSWORD) for _ in range(2)] == [bus.bench.statusword] * 2
    assert bus.now_s < 1.5 * PATIENCE_S


@pytest.mark.parametrize("code", [0x06020000, 0x06090011, 0x08000000, 0x06010001, 0x08000022])
def test_an_optional_object_that_is_refused_is_absent(code):
    bus = Server(missing=[0x60A9])
    bus.change = lambda request, answer: abort(0x60A9, 0, code) if asks(request, 0x60A9) else answer
    assert bus.client.find(objects.VELOCITY_UNIT) is None
    is_plain = code in (0x06020000, 0x06090011)
    assert any("60A9h" in note and f"{code:08X}" in note.upper() for note in bus.client.notes) is not is_plain
    with pytest.raises(DriveError, match="lacks" if is_plain else f"does not show .*0x{code:08X}"):
        bus.client.read(objects.VELOCITY_UNIT)


def test_a_drive_that_stops_answering_has_no_absent_object():
    bus = Server()
    bus.client.read(objects.STATUSWORD)
    bus.delay = lambda request: None
    for ask in (bus.client.find, bus.client.width, lambda entry: bus.client.try_write(entry, 0)):
        with pytest.raises(DriveError, match=r"FH-207"):
            ask(objects.VELOCITY_UNIT)


def test_writing_may_take_seconds():
    bus = Server()
    bus.delay = lambda request: 2.5
    bus.client.write(cia301.PRODUCER_HEARTBEAT, 50)
    assert len(bus.requests) == 1  # and is asked for once
    bus.delay = lambda request: 0.0
    assert bus.client.read(cia301.PRODUCER_HEARTBEAT) == 50


def test_the_abort_after_a_time_out_names_the_object():
    bus = Server()
    bus.delay = lambda request: None
    with pytest.raises(DriveError, match="no drive answers"):
        bus.client.read(objects.VELOCITY_UNIT)
    assert bus.now_s == pytest.approx(PATIENCE_S)
    assert bus.aborts == [abort(0x60A9, 0, 0x05040000)]


@pytest.mark.parametrize(
    ("request_hex", "answer_hex", "belongs"),
    [
        ("40a96000 00000000", "43a96000 00034700", True),
        ("40a96000 00000000", "43a96001 00034700", False),
        ("40a96000 00000000", "60a96000 00000000", False),  # of a write
        ("40a96000 00000000", "80a96000 00000206", True),
        ("40a96000 00000000", "80000000 00000206", False),
        ("2ba96000 00000000", "60a96000 00000000", True),
        ("2ba96000 00000000", "4ba96000 00000000", False),
        ("60000000 00000000", "00616263 64656667", True),
        ("70000000 00000000", "00616263 64656667", False),  # toggle
        ("70000000 00000000", "10616263 64656667", True),
        ("70000000 00000000", "80081000 00000305", True),
        ("70000000 00000000", "80000000 00000305", True),
        ("70000000 00000000", "80a96000 00000305", False),
        ("00616263 64656667", "20000000 00000000", True),
        ("00616263 64656667", "30000000 00000000", False),
    ],
)
def test_answers_and_their_requests(request_hex, answer_hex, belongs):
    transfer = {
        0x40: Upload(objects.VELOCITY_UNIT),
        0x2B: Download(objects.VELOCITY_UNIT, bytes(2)),
        0x60: Upload(objects.DEVICE_NAME),
        0x70: Upload(objects.DEVICE_NAME),
        0x00: Download(objects.DEVICE_NAME, b"abcdefghi"),
    }[bytes.fromhex(request_hex)[0]]
    sent = transfer.first()
    for before in ("41081000 10000000", "60081000 00000000", "00414141 41414141"):  # up to the request under way
        if sent != bytes.fromhex(request_hex):
            sent = transfer.take(bytes.fromhex(before)) or sent
    assert sent == bytes.fromhex(request_hex)
    assert transfer.accepts(bytes.fromhex(answer_hex)) is belongs


def test_a_late_answer_is_not_taken_for_that_to_the_same_object():
    """Read slowly, written, read back: the read-back must be what the drive holds now."""
    bus = Server()
    bus.delay = lambda request: 1.4 if request[0] == 0x40 else 0.0
    before = bus.client.read(cia301.PRODUCER_HEARTBEAT)  # asked again after a second: two answers come
    assert len(bus.requests) == 2
    bus.delay = lambda request: 0.0
    bus.client.write(cia301.PRODUCER_HEARTBEAT, before + 7)
    assert bus.client.read(cia301.PRODUCER_HEARTBEAT) == before + 7


def test_a_segmented_transfer_takes_the_segment_with_its_toggle_bit():
    bus = Server()
    name = bus.client.bytes_of(objects.DEVICE_NAME)
    assert len(name) > 14
    repeated = []

    def repeat_first_segment(request, answer):
        if request[0] >> 5 == 3 and not repeated:
            repeated.append(answer)
            bus.waiting.append((bus.now_s, (SDO_ANSWER, answer)))
        return answer

    bus.change = repeat_first_segment
    assert bus.client.bytes_of(objects.DEVICE_NAME) == name
    assert repeated
