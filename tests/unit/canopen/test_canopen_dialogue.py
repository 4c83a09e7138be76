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


def test_an_expedited_upload_has_sign_and_width() -> None:
    upload = Upload(objects.MODE_DISPLAY)
    assert give(upload, "4f616000f8000000") == ["4061600000000000"]
    assert upload.is_accepted
    assert upload.value == -8


def test_a_text_comes_in_segments_with_alternating_toggle() -> None:
    upload = Upload(objects.DEVICE_NAME)
    requests = give(upload, "410810000c000000", "00" + b"durand ".hex(), "10" + b"servoXX".hex()[:14])
    assert requests == ["4008100000000000", "6000000000000000", "7000000000000000", "6000000000000000"]
    assert not upload.is_done, "the last segment says that more follow"
    upload = Upload(objects.DEVICE_NAME)
    give(upload, "410810000c000000", "00" + b"durand ".hex(), "15" + b"servo".hex() + "0000")
    assert upload.data == b"durand servo"


@pytest.mark.parametrize(
    "answer",
    [
        "4b40600037020000",  # another index
        "4b41600137020000",  # another sub-index
        "8040600000000206",  # the abort of another object
        "6041600000000000",  # a download's answer
        "4b416000",  # too short
    ],
)
def test_what_does_not_belong_to_the_request_is_passed_over(answer: str) -> None:
    upload = Upload(objects.STATUSWORD)
    give(upload, answer)
    assert not upload.is_done
    give(upload, answer, "4b41600037020000")
    assert upload.value == 0x0237


def test_a_segment_with_the_old_toggle_is_passed_over() -> None:
    upload = Upload(objects.DEVICE_NAME)
    give(upload, "4108100008000000", "00" + b"abcdefg".hex(), "00" + b"abcdefg".hex(), "1d" + b"h".hex() + "00" * 6)
    assert upload.data == b"abcdefgh"


def test_a_download_and_its_abort() -> None:
    download = Download(objects.CONTROLWORD, 2)
    assert give(download, "6040600000000000") == ["2b40600002000000"]
    assert download.is_accepted
    download = Download(objects.MODE, -3)
    assert give(download, "8060600022000008") == ["2f606000fd000000"]
    assert download.is_done
    assert not download.is_accepted
    assert download.abort_code == 0x08000022


def test_what_does_not_fit_into_one_frame_is_written_in_segments() -> None:
    download = Download(objects.DEVICE_NAME, b"durand servo")
    answers = ("6008100000000000", "2000000000000000", "2000000000000000", "3000000000000000")  # the first one twice
    assert give(download, *answers) == ["210810000c000000", "00" + b"durand ".hex(), "15" + b"servo".hex() + "0000"]
    assert download.is_accepted


def test_an_answer_without_a_size_has_that_of_its_type() -> None:
    upload = Upload(objects.TORQUE_OFFSET)
    give(upload, "42b26000fbff0000")
    assert (upload.data, upload.value) == (b"\xfb\xff", -5)


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
    count = 0
    while request is not None:
        request = upload.take(bytes([request[0] & 0x10]) + b"abcdefg")
        count += 1
        assert count < 20_000
    assert upload.is_done
    assert not upload.is_accepted
    assert upload.abort_code == Abort.OUT_OF_MEMORY
