"""SDO client against a server that answers late, twice or wrongly, in simulated time."""

import struct
from types import SimpleNamespace

import canopen
import pytest
from canopen.sdo import SdoClient, SdoServer
from friction_hil_drivers.canopen.sdo.client import PATIENCE_S
from friction_hil_drivers.canopen.sdo.dialogue import Download, Transfer, Upload, abort, describe
from friction_hil_drivers.canopen.wire import cia301
from friction_hil_drivers.cia402 import objects
from friction_hil_drivers.cia402.access import Abort
from friction_hil_drivers.cia402.objects import DataType, Object
from hypothesis import given
from hypothesis import strategies as st

from friction_hil.errors import DriveError
from tests.canopen_bench import NODE, SDO_ANSWER, SDO_REQUEST, Bench, SlowBus


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
    bus.change = lambda request, answer: abort((0x60A9, 0), code) if asks(request, 0x60A9) else answer
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
    assert bus.aborts == [abort((0x60A9, 0), 0x05040000)]


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


# --- transfers of ``friction-hil drives``: bytes of CiA 301, written here by hand


def give(transfer: Transfer, *answers: str) -> list[str]:
    """Give answers; return all requests."""
    requests = [transfer.first().hex()]
    for answer in answers:
        following = transfer.take(bytes.fromhex(answer))
        if following is not None:
            requests.append(following.hex())
    return requests


@pytest.mark.parametrize(
    ("entry", "request_", "answer", "data", "value"),
    [
        (objects.MODE_DISPLAY, "4061600000000000", "4f616000f8000000", b"\xf8", -8),
        (objects.TORQUE_OFFSET, "40b2600000000000", "42b26000fbff0000", b"\xfb\xff", -5),  # no size: that of its type
    ],
)
def test_an_expedited_upload_has_sign_and_width(entry, request_, answer, data, value) -> None:
    upload = Upload(entry)
    assert give(upload, answer) == [request_]
    assert (upload.is_accepted, upload.data, upload.value) == (True, data, value)


@pytest.mark.parametrize(
    ("download", "request_", "answer", "abort"),
    [
        (Download(objects.CONTROLWORD, 2), "2b40600002000000", "6040600000000000", None),
        (Download(objects.MODE, -3), "2f606000fd000000", "8060600022000008", 0x08000022),
    ],
)
def test_a_download_and_its_abort(download, request_, answer, abort) -> None:
    assert give(download, answer) == [request_]
    assert (download.is_done, download.is_accepted) == (True, abort is None)
    assert download.abort_code == abort or abort is None


def test_a_server_that_lost_a_transfer_ends_it_without_its_object() -> None:
    upload = Upload(objects.DEVICE_NAME)
    give(upload, "410810000c000000", "8000000001000405")
    assert (upload.is_done, upload.is_accepted, upload.abort_code) == (True, False, Abort.COMMAND)
    upload = Upload(objects.DEVICE_NAME)
    give(upload, "8000000001000405")
    assert not upload.is_done, "it ends the transfer of another client"


@pytest.mark.parametrize(
    ("answer", "words"),
    [
        ("80a9600000000206", "abort 06020000h for 60A9h:00"),
        ("43a96001b4470300", "the value of 60A9h:01"),
        ("60a9600000000000", "the confirmation of a write to 60A9h:00"),
        ("0041414141414141", "a segment"),
        ("43a960", "a frame of 3 bytes"),
    ],
)
def test_an_answer_in_words(answer: str, words: str) -> None:
    assert describe(bytes.fromhex(answer)) == words


def test_a_server_that_sends_segments_without_end_is_given_up() -> None:
    upload = Upload(objects.DEVICE_NAME)
    upload.first()
    request = upload.take(bytes.fromhex("4008100000000000"))  # no size announced
    for _ in range(20_000):
        if request is not None:
            request = upload.take(bytes([request[0] & 0x10]) + b"abcdefg")
    assert (upload.is_done, upload.is_accepted, upload.abort_code) == (True, False, Abort.OUT_OF_MEMORY)


# --- against client and server of the canopen library, over frames in memory


OBJECTS = [Object(0x2000 + n, f"object {n}", DataType.VISIBLE_STRING, n) for n in range(3)]
contents = st.binary(min_size=1, max_size=200)


class Library:
    """Server of the canopen library with `OBJECTS`, and its client."""

    def __init__(self):
        dictionary = canopen.ObjectDictionary()
        for entry in OBJECTS:
            record = canopen.objectdictionary.ODRecord(entry.name, entry.index)
            variable = canopen.objectdictionary.ODVariable(entry.name, entry.index, entry.subindex)
            variable.data_type = canopen.objectdictionary.DOMAIN
            record.add_member(variable)
            dictionary.add_object(record)
        self.server = SdoServer(0x600 + NODE, 0x580 + NODE, canopen.LocalNode(NODE, dictionary))
        self.client = SdoClient(0x600 + NODE, 0x580 + NODE, canopen.ObjectDictionary())
        self.server.network = SimpleNamespace(send_message=lambda can_id, data: self.answers.append(bytes(data)))
        self.client.network = SimpleNamespace(send_message=self.request_of_client)
        self.answers, self.requests = [], []

    def answers_to(self, request):
        self.answers = []
        self.server.on_request(0x600 + NODE, bytearray(request), 0.0)
        return self.answers

    def request_of_client(self, can_id, request):
        self.requests.append(bytes(request))
        for answer in self.answers_to(request):
            self.client.on_response(0x580 + NODE, answer, 0.0)


def carry_out(transfer: Transfer, library: Library, disturbed=list) -> list[bytes]:
    """Give a transfer the answers of the server, with what disturbs; return its requests."""
    requests, request = [], transfer.first()
    while request is not None:
        requests.append(request)
        request = None
        for answer in disturbed(library.answers_to(requests[-1])):
            request = transfer.take(answer) or request
    return requests


@given(st.binary(max_size=200))
def test_the_frames_are_those_of_the_library(content):
    library, entry = Library(), OBJECTS[1]
    library.client.download(entry.index, entry.subindex, content)
    assert carry_out(Download(entry, content), Library()) == library.requests
    if content:
        library.requests = []
        assert library.client.upload(entry.index, entry.subindex) == content
        upload = Upload(entry)
        assert carry_out(upload, library) == library.requests
        assert upload.data == content


@given(st.data(), contents, contents)
def test_strays_and_doubled_and_late_answers_never_give_a_wrong_value(data, content, other):
    """Before and after each answer comes what belongs to no request under way, in any order."""
    library, (entry, another, _) = Library(), OBJECTS
    carry_out(Download(another, other), library)
    names = struct.pack("<HB", *another.address)
    strays = [
        b"\x43" + names + b"abcd",
        b"\x41" + names + struct.pack("<I", 9),
        b"\x60" + names + bytes(4),
        abort(another.address, Abort.NO_OBJECT),
        b"\x43" + struct.pack("<HB", *entry.address),  # too short
        b"",
        *library.answers_to(Upload(another).first()),  # late
    ]

    def disturbed(answers):
        some = st.lists(st.sampled_from(strays), max_size=4)
        return [*data.draw(some), *answers, *answers, *data.draw(some)]

    download = Download(entry, content)
    carry_out(download, library, disturbed)
    assert download.is_accepted
    upload = Upload(entry)
    carry_out(upload, library, disturbed)
    assert upload.data == content
    upload = Upload(another)
    carry_out(upload, library)
    assert upload.data == other


@given(st.data())
def test_a_blocking_client_reads_what_was_written_last_however_late_answers_come(data):
    """Requests are repeated, and answers come to those that were answered already; the patience is kept."""
    library, held = Library(), {}
    bus = SlowBus(
        lambda request: [(0x580 + NODE, answer) for answer in library.answers_to(request)],
        lambda _: data.draw(st.sampled_from((0.0, 0.0, 0.3, 1.1, 1.9, 2.9))),
    )
    for _ in range(data.draw(st.integers(2, 8))):
        entry = data.draw(st.sampled_from(OBJECTS))
        if entry not in held or data.draw(st.booleans()):
            held[entry] = data.draw(contents)
            bus.client.download(entry, held[entry])
        assert bus.client.peek(entry) == held[entry]
