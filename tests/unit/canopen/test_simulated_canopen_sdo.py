"""The SDO server of a simulated drive, byte by byte as CiA 301 has it."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.canopen_bench import NODE, Bench


@pytest.fixture(scope="module")
def bench() -> Bench:
    return Bench()


def ask(bench: Bench, request: str) -> str:
    [(can_id, data)] = bench.sdo(bytes.fromhex(request))
    assert can_id == 0x580 + NODE
    return data.hex(" ")


@pytest.mark.parametrize(
    ("request_", "answer"),
    [
        ("40 00 10 00 00 00 00 00", "43 00 10 00 92 01 02 00"),  # 1000h, four bytes
        ("40 41 60 00 00 00 00 00", "4b 41 60 00 50 02 00 00"),  # 6041h, two bytes
        ("40 61 60 00 00 00 00 00", "4f 61 60 00 00 00 00 00"),  # 6061h, one byte
        ("40 16 10 00 00 00 00 00", "4f 16 10 00 02 00 00 00"),  # number of entries
        ("23 84 60 00 40 42 0f 00", "60 84 60 00 00 00 00 00"),  # download four bytes
        ("22 84 60 00 40 42 0f 00", "60 84 60 00 00 00 00 00"),  # the same, size not indicated
        ("2b 71 60 00 9c ff 00 00", "60 71 60 00 00 00 00 00"),  # download two bytes, negative
        ("22 71 60 00 9c ff 00 00", "60 71 60 00 00 00 00 00"),
        ("40 34 12 00 00 00 00 00", "80 34 12 00 00 00 02 06"),  # unknown object
        ("40 18 10 09 00 00 00 00", "80 18 10 09 11 00 09 06"),  # unknown sub-index
        ("40 41 60 01 00 00 00 00", "80 41 60 01 11 00 09 06"),
        ("2b 41 60 00 00 00 00 00", "80 41 60 00 02 00 01 06"),  # read-only
        ("23 18 10 01 00 00 00 00", "80 18 10 01 02 00 01 06"),  # constant
        ("23 71 60 00 00 00 00 00", "80 71 60 00 10 00 07 06"),  # too long
        ("2f 71 60 00 00 00 00 00", "80 71 60 00 10 00 07 06"),  # too short
        ("2b 5a 60 00 07 00 00 00", "80 5a 60 00 31 00 09 06"),  # too high
        ("2b 5a 60 00 ff ff 00 00", "80 5a 60 00 32 00 09 06"),  # too low
        ("2b 5a 60 00 03 00 00 00", "80 5a 60 00 30 00 09 06"),  # in range, not supported
        ("2f 60 60 00 01 00 00 00", "80 60 60 00 30 00 09 06"),  # mode that the drive lacks
        ("a0 08 10 00 00 00 00 00", "80 08 10 00 01 00 04 05"),  # block upload is not supported
        ("c2 08 10 00 00 00 00 00", "80 08 10 00 01 00 04 05"),
        ("60 00 00 00 00 00 00 00", "80 00 00 00 01 00 04 05"),  # segment without transfer
        ("00 00 00 00 00 00 00 00", "80 00 00 00 01 00 04 05"),
    ],
)
def test_expedited_transfer(bench: Bench, request_: str, answer: str) -> None:
    assert ask(bench, request_) == answer


def test_segmented_download(bench: Bench) -> None:
    assert ask(bench, "21 85 60 00 04 00 00 00") == "60 85 60 00 00 00 00 00"
    assert ask(bench, "0a 78 56 00 00 00 00 00") == "20 00 00 00 00 00 00 00"
    assert ask(bench, "1b 34 12 00 00 00 00 00") == "30 00 00 00 00 00 00 00"
    assert bench.read(0x6085) == 0x12345678


@pytest.mark.parametrize(
    ("requests", "abort"),
    [
        (["21 71 60 00 04 00 00 00"], "80 71 60 00 10 00 07 06"),  # announces four bytes for two
        (["21 71 60 00 02 00 00 00", "09 01 02 03 00 00 00 00"], "80 71 60 00 10 00 07 06"),  # sends three
        (["20 71 60 00 00 00 00 00", "09 01 02 03 00 00 00 00"], "80 71 60 00 10 00 07 06"),  # unannounced
        (["21 41 60 00 02 00 00 00"], "80 41 60 00 02 00 01 06"),  # read-only, refused at once
        (["21 71 60 00 02 00 00 00", "1b 01 02 00 00 00 00 00"], "80 71 60 00 00 00 03 05"),  # toggle bit
        (["40 08 10 00 00 00 00 00", "70 00 00 00 00 00 00 00"], "80 08 10 00 00 00 03 05"),
        (["40 08 10 00 00 00 00 00", "00 00 00 00 00 00 00 00"], "80 08 10 00 01 00 04 05"),  # wrong direction
    ],
)
def test_broken_segmented_transfer(bench: Bench, requests: list[str], abort: str) -> None:
    answers = [ask(bench, request) for request in requests]
    assert answers[-1] == abort
    assert not any(answer.startswith("80") for answer in answers[:-1])
    assert ask(bench, "60 00 00 00 00 00 00 00").startswith("80"), "the transfer is over"


def test_endless_download_is_stopped(bench: Bench) -> None:
    assert ask(bench, "20 84 60 00 00 00 00 00").startswith("60")
    answers = [ask(bench, f"{toggle:02x} 00 00 00 00 00 00 00") for toggle in (0x00, 0x10) * 400]
    assert "80 84 60 00 05 00 04 05" in answers


@given(st.lists(st.binary(min_size=8, max_size=8), max_size=8))
def test_every_request_gets_one_answer_or_none(bench: Bench, requests: list[bytes]) -> None:
    for request in requests:
        answers = bench.sdo(request)
        assert len(answers) == (0 if request[0] >> 5 == 4 else 1)
        assert all(len(data) == 8 for _, data in answers)


def test_history_is_read_and_cleared_and_a_stopped_node_serves_no_sdo() -> None:
    bench = Bench()
    none, entry, clear = "40 03 10 00 00 00 00 00", "40 03 10 01 00 00 00 00", "2f 03 10 00 00 00 00 00"
    assert ask(bench, none) == "4f 03 10 00 00 00 00 00"
    assert ask(bench, entry) == "80 03 10 01 24 00 00 08"
    bench.nmt(0x01)
    bench.send(0x205, b"\x06")  # a short RPDO
    assert ask(bench, none) == "4f 03 10 00 01 00 00 00"
    assert ask(bench, entry) == "43 03 10 01 10 82 00 00"
    assert ask(bench, "2f 03 10 00 01 00 00 00") == "80 03 10 00 30 00 09 06"
    assert ask(bench, clear) == "60 03 10 00 00 00 00 00"
    assert ask(bench, none) == "4f 03 10 00 00 00 00 00"
    bench.nmt(0x02)
    assert bench.sdo(bytes.fromhex(none)) == []


def test_interpolation_period_that_the_servo_cannot_do() -> None:
    bench = Bench()
    assert bench.try_write(0x60C2, 2, "b", -5) == 0  # 10 us, for the moment: the exponent may come first
    assert bench.try_write(0x60C2, 1, "B", 1) == 0x06090030
    assert bench.try_write(0x60C2, 1, "B", 25) == 0  # 250 us
    assert bench.try_write(0x60C2, 1, "B", 0) == 0x06090032
    assert bench.try_write(0x60C2, 2, "b", 1) == 0x06090031
