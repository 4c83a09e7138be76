"""SDO transfers of ``friction-hil drives``: bytes of CiA 301, written here by hand."""

import pytest
from friction_hil_drivers.canopen.sdo.dialogue import Download, Transfer, Upload, describe
from friction_hil_drivers.cia402 import objects
from friction_hil_drivers.cia402.access import Abort


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
