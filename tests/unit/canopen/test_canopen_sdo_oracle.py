"""The SDO transfer against client and server of the canopen library, over frames in memory."""

import struct
from types import SimpleNamespace

import canopen
from canopen.sdo import SdoClient, SdoServer
from friction_hil_drivers.canopen.sdo.dialogue import Download, Transfer, Upload, abort
from friction_hil_drivers.cia402.access import Abort
from friction_hil_drivers.cia402.objects import DataType, Object
from hypothesis import given
from hypothesis import strategies as st

from tests.canopen_bench import NODE, SlowBus

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
