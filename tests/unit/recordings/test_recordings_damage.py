"""Damaged MCAP files: whatever the bytes, rows and a sentence, or an error; never a traceback, never wrong rows."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from mcap.opcode import Opcode
from mcap.records import Chunk
from mcap.stream_reader import StreamReader

import friction_hil as fh
from friction_hil.errors import RecordingError
from friction_hil.recordings.mcap_writer import McapWriter
from friction_hil.recordings.recording import Recording

COLUMNS = ("time_s", "cycle", "position")
CHUNKS, ROWS = 4, 10


class Whole(bytes):
    """Bytes that hypothesis does not print."""

    def __repr__(self) -> str:
        return f"{len(self)} bytes"


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Whole:
    """A file of two axes and four chunks, with events and states."""
    path = tmp_path_factory.mktemp("whole") / "run.mcap"
    cycles = np.arange(float(CHUNKS * ROWS))
    row = np.stack([cycles * 0.1, cycles, np.sin(cycles), cycles + 0.5], axis=1)
    writer = McapWriter(path, ["x", "y"], COLUMNS, state_width=1, metadata={"configuration": {"version": 1}})
    for start in range(0, len(row), ROWS):
        writer.write(np.tile(row[start : start + ROWS], 2))
        writer.write_event(float(start), "set", "gain 0.9")
    writer.close()
    return Whole(path.read_bytes())


@pytest.fixture(scope="module")
def scratch(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("scratch") / "run.mcap"


def read(path: Path, data: bytes) -> Recording | None:
    """What is read, checked against the truth; None where the file is refused."""
    path.write_bytes(data)
    try:
        recording = fh.recordings.read(path, "x")
    except RecordingError:
        return None
    cycle = recording["cycle"]
    np.testing.assert_array_equal(recording["position"], np.sin(cycle))
    for row, state in recording.restarts:
        np.testing.assert_array_equal(state, [cycle[row] + 0.5])
    return recording


def chunk_ends(data: bytes, path: Path) -> list[int]:
    """Byte after each chunk record, as the library reports it."""
    path.write_bytes(data)
    with path.open("rb") as file:
        records = StreamReader(file, emit_chunks=True).records
        return [file.tell() for record in records if isinstance(record, Chunk)]


@given(st.data())
def test_cut_anywhere_is_read_up_to_the_last_whole_chunk(whole: bytes, scratch: Path, data: st.DataObject) -> None:
    cut = data.draw(st.integers(0, len(whole) - 1))
    ends = chunk_ends(whole, scratch)
    chunks = sum(end <= cut for end in ends)
    recording = read(scratch, whole[:cut])
    assert len(ends) == CHUNKS
    if chunks == 0:
        assert recording is None
    else:
        assert len(recording) == chunks * ROWS
        assert recording.metadata["configuration"] == {"version": 1}
        assert len(recording.events) == chunks
        assert "cut off" in recording.problems[0]
        is_complete = cut >= first_record(whole, Opcode.DATA_END) + 13
        assert ("all its rows are there" in recording.problems[0]) == is_complete


def test_a_cut_chunk_says_which_rows_are_lost(whole: bytes, scratch: Path) -> None:
    (problem,) = read(scratch, whole[: chunk_ends(whole, scratch)[2] - 5]).problems
    assert "the file was cut off in the record at byte" in problem
    assert "the rows from 2.000 s to 2.900 s and what followed are lost" in problem


@given(position=st.floats(0.0, 1.0, exclude_max=True), bit=st.integers(0, 7))
@example(position=0.0, bit=0)
def test_a_flipped_bit_is_refused_or_reported(whole: bytes, scratch: Path, position: float, bit: int) -> None:
    data = bytearray(whole)
    at = int(position * len(data))
    data[at] ^= 1 << bit
    recording = read(scratch, bytes(data))
    if recording is not None and at < first_record(whole, Opcode.DATA_END):
        assert recording.problems


@pytest.mark.parametrize("chunk", range(CHUNKS))
def test_one_damaged_chunk_costs_only_itself(whole: bytes, scratch: Path, chunk: int) -> None:
    data = bytearray(whole)
    data[chunk_ends(whole, scratch)[chunk] - 20] ^= 0xFF
    recording = read(scratch, bytes(data))
    assert len(recording) == (CHUNKS - 1) * ROWS
    assert f"chunk {chunk + 1} is damaged" in recording.problems[0]
    assert f"the rows from {chunk:.3f} s to {chunk + 0.9:.3f} s are lost" in recording.problems[0]


def test_a_claim_of_a_huge_chunk_is_only_damage_and_allocates_nothing(whole: bytes, scratch: Path) -> None:
    """The length of a chunk's data lies behind its times, sizes and compression; its last byte is the highest."""
    at = first_record(whole, Opcode.CHUNK) + 9
    data = bytearray(whole)
    data[at + 16 : at + 24] = (1 << 60).to_bytes(8, "little")
    assert "it claims 1152921504606846976 bytes" in read(scratch, bytes(data)).problems[0]
    data = bytearray(whole)
    data[at + 32 + int.from_bytes(whole[at + 28 : at + 32], "little") + 7] = 0x80
    recording = read(scratch, bytes(data))
    assert len(recording) == (CHUNKS - 1) * ROWS
    assert "a chunk record is damaged" in recording.problems[0]


def first_record(data: bytes, opcode: Opcode) -> int:
    """Byte at which the first record of a kind begins."""
    at = 8
    while data[at] != opcode:
        at += 9 + int.from_bytes(data[at + 1 : at + 9], "little")
    return at
