"""The shared-memory ring: order, losses, a reader that takes over; the columns of a row; and that memory stays flat."""

import math
import os
import subprocess
import sys
import tracemalloc
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from friction_hil.compensator import CompensatorInputs
from friction_hil.daemon.companion.job import Job
from friction_hil.daemon.companion.memory import allocate
from friction_hil.daemon.companion.worker import _Outputs
from friction_hil.daemon.ring import EVENT_SLOTS, RingReader, RingWriter
from friction_hil.daemon.row import AxisRow, row_width
from friction_hil.recordings import columns, read
from friction_hil.recordings.columns import CYCLE, NAMES, TIME, input_checksum
from tests.loop_run import Drives, axis
from tests.servo_drives import configuration, make_loop

WIDTH, CAPACITY = 3, 8


@pytest.fixture
def ring() -> Iterator[RingWriter]:
    writer = RingWriter(WIDTH, CAPACITY)
    yield writer
    os.close(writer.descriptor)


@pytest.fixture
def reader(ring: RingWriter) -> RingReader:
    return RingReader(ring.descriptor)


def push(ring: RingWriter, count: int) -> None:
    for _ in range(count):
        ring.push(np.full(WIDTH, float(ring.rows_pushed)))


def test_rows_arrive_in_order_and_once_and_every_bit_of_them(ring: RingWriter, reader: RingReader) -> None:
    assert reader.drain().shape == (0, WIDTH)
    push(ring, 5)
    assert not reader.is_drained
    np.testing.assert_array_equal(reader.drain(), np.tile(np.arange(5.0)[:, None], WIDTH))
    assert reader.is_drained
    push(ring, 2)
    np.testing.assert_array_equal(reader.drain()[:, 0], [5.0, 6.0])
    assert reader.lost == 0
    odd = np.array([0x7FF0000000000001, -1, 1], np.int64).view(np.float64)  # signalling NaN, NaN, denormal
    ring.push(odd)
    assert reader.drain().tobytes() == odd.tobytes()


def test_slow_reader_loses_the_oldest_rows_and_knows_how_many(ring: RingWriter, reader: RingReader) -> None:
    push(ring, CAPACITY + 3)
    np.testing.assert_array_equal(reader.drain()[:, 0], np.arange(3.0, 11.0))
    assert reader.lost == 3
    reader.release(CAPACITY, 0)
    assert RingReader(ring.descriptor).lost == 3


@given(st.lists(st.one_of(st.integers(0, 20), st.just("drain"), st.just("release"), st.just("replace"))))
def test_nothing_is_seen_twice_or_uncounted(steps: list[int | str]) -> None:
    """Against a model: what is released never comes again, what is not comes again after a change of reader."""
    ring = RingWriter(WIDTH, CAPACITY)
    reader = RingReader(ring.descriptor)
    held: list[float] = []
    safe: list[float] = []
    for step in [*steps, "drain", "release all"]:
        if isinstance(step, int):
            push(ring, step)
        elif step == "drain":
            held += reader.drain()[:, 0].tolist()
        elif step == "replace":
            reader, held = RingReader(ring.descriptor), []
        else:
            count = len(held) if step == "release all" else (len(held) + 1) // 2
            reader.release(count, 0)
            safe, held = safe + held[:count], held[count:]
        assert safe + held == sorted(set(safe + held))
    assert len(safe) + reader.lost == ring.rows_pushed
    assert ring.free_slots() == CAPACITY
    os.close(ring.descriptor)


def test_free_slots_count_what_the_reader_still_needs(ring: RingWriter, reader: RingReader) -> None:
    push(ring, 6)
    assert ring.free_slots() == 2
    reader.drain()
    assert ring.free_slots() == 2
    reader.release(4, 0)
    assert ring.free_slots() == 6
    push(ring, 20)
    assert ring.free_slots() == 0


def test_a_row_being_written_is_not_taken(ring: RingWriter, reader: RingReader) -> None:
    push(ring, 3)
    ring._numbers[1, 0] = 99  # the writer has begun to overwrite row 1 ...
    np.testing.assert_array_equal(reader.drain()[:, 0], [0.0, 2.0])
    ring._numbers[2, -1] = 99  # ... and a row whose end belongs to another lap
    other = RingReader(ring.descriptor)
    assert other.drain()[:, 0].tolist() == [0.0]
    assert (reader.lost, other.lost) == (1, 2)


def test_events(ring: RingWriter, reader: RingReader) -> None:
    ring.push_event(3.0, "fault", "zu heiß")
    ring.push_event(4.0, "ü" * 100, "é" * 500)
    assert reader.drain_events() == [(3.0, "fault", "zu heiß"), (4.0, "ü" * 20, "é" * 94)]
    for number in range(EVENT_SLOTS + 5):
        ring.push_event(number, "set", str(number))
    assert [cycle for cycle, _, _ in reader.drain_events()] == list(range(5, EVENT_SLOTS + 5))
    assert reader.events_lost == 5
    assert not reader.is_closed
    ring.close_writing()
    assert reader.is_closed


def test_memory_that_is_no_ring() -> None:
    descriptor = os.memfd_create("other")
    os.ftruncate(descriptor, 1 << 17)
    with pytest.raises(ValueError, match="not a ring"):
        RingReader(descriptor)
    os.close(descriptor)
    with pytest.raises(ValueError, match="at least one row"):
        RingWriter(0, 8)


READER = """
import sys
import numpy as np
from friction_hil.daemon.ring import RingReader
reader = RingReader(int(sys.argv[1]))
seen = 0
print("ready", flush=True)
while not (reader.is_closed and reader.is_drained):
    rows = reader.drain()
    assert np.all(rows == rows[:, :1]), rows
    assert np.all(np.diff(rows[:, 0]) > 0)
    seen += len(rows)
    reader.release(len(rows), 0)
print(seen, reader.lost)
"""


def test_another_process_sees_only_whole_rows_while_it_is_overtaken() -> None:
    """The writer laps a small ring as fast as it can; every row taken is whole, every other is counted."""
    ring = RingWriter(64, 4)
    command = [sys.executable, "-c", READER, str(ring.descriptor)]
    with subprocess.Popen(command, pass_fds=[ring.descriptor], stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        assert process.stdout.readline() == "ready\n"
        for number in range(100_000):
            ring.push(np.full(64, float(number)))
        ring.close_writing()
        seen, lost = map(int, process.stdout.read().split())
    assert process.returncode == 0
    assert seen + lost == 100_000
    os.close(ring.descriptor)


DEMANDS = {"position_demand": 4.5, "velocity_demand": 5.5, "velocity_demand_ahead": 6.5}
INPUTS = CompensatorInputs(
    **{"cycle": 7.0, "position": 1.5, "velocity": 2.5, "torque": 3.5, **DEMANDS, "is_fresh": True, "is_enabled": False},
    **{"acceleration_demand_ahead": 14.5, "temperature": 15.5, "load_torque": 21.5},
)
OTHERS = {"velocity_estimate": 7.5, "compensation": 8.5, "command": 9.5, "state": 2, "drive_state": 5}


def row(shadows=(), state_size=0):
    return AxisRow(np.full(row_width(shadows) + state_size, math.nan), shadows)


def test_every_value_stands_in_the_column_of_its_name():
    one = row()
    one.write_cycle(0.007, INPUTS, **OTHERS)
    one.write_timing(11.5, 12.5, 13.5, 19.0)
    one.write_estimates(16.5, 17.5, 18.5)
    one.write_velocity_offset(20.5)
    one.write_feedforward(22.5)
    expected = INPUTS._asdict() | OTHERS | {"time_s": 0.007, "late_us": 11.5, "exchange_us": 12.5, "path_lag_s": 13.5}
    expected |= {"change": 19.0, "load_estimate": 16.5, "temperature_estimate": 17.5, "motor_offset": 18.5}
    expected |= {"velocity_offset": 20.5, "feedforward": 22.5}
    expected |= {"checksum": input_checksum(*INPUTS)}
    unknown = dict.fromkeys(("torque_demand", "load_position", "compensation_uncertainty"), math.nan)
    written = dict(zip(columns.NAMES, one.values.tolist(), strict=True))
    np.testing.assert_equal(written, {name: float(value) for name, value in (expected | unknown).items()})


def test_shadows_follow_the_columns_and_states_follow_the_shadows():
    one = row(["a", "b"], 5)
    one.write_shadow("b", 0.25)
    one.write_states([np.array([1.0, 2.0]), np.array([3.0])])
    np.testing.assert_equal(one.values[len(columns.NAMES) :], [math.nan, 0.25, 1.0, 2.0, 3.0, math.nan, math.nan])


def test_a_cleared_row_keeps_time_and_cycle_alone():
    one = row(["a"], 2)
    one.write_cycle(0.007, INPUTS, **OTHERS)
    one.clear(0.008, 8)
    written = one.values.tolist()
    assert written[:2] == [0.008, 8.0]
    assert np.isnan(written[2:]).all()


PERIOD_S = 1e-3
ROWS_PER_S = 1000
WARM_S, COUNTED_S = 2, 4
INDEX_BYTES = 2000  # of a chunk of a second, in the index that the file gets at its end
NOISE_BYTES = 20_000


def test_the_loop_keeps_nothing_of_a_cycle():
    taken = []

    def before(drives):
        for kept in (*drives.commands, *drives.sent):  # by the drives of the test
            kept.clear()
        if drives.cycle in (WARM_S * ROWS_PER_S, (WARM_S + COUNTED_S) * ROWS_PER_S):
            taken.append(tracemalloc.get_traced_memory()[0])
        if drives.cycle == (WARM_S - 1) * ROWS_PER_S:  # the lists above have their size by now
            tracemalloc.start()

    config = configuration(x=axis())
    discard = SimpleNamespace(push=lambda row: None, event=lambda cycle, name, text: None)
    loop, *_ = make_loop(config, Drives(config, before), sink=discard, duration_s=WARM_S + COUNTED_S + 0.2)
    try:
        result = loop.run()
    finally:
        tracemalloc.stop()
    first, last = taken
    assert last - first < NOISE_BYTES
    assert result.faults == []


def test_the_process_that_records_keeps_no_more_than_an_entry_of_a_chunk(tmp_path: Path):
    paths = dict.fromkeys(("path", "black_box"), str(tmp_path / "run.mcap"))
    job = Job(["x", "y"], list(NAMES), 6, PERIOD_S, 1_700_000_000_000_000_000, **paths)
    ring = RingWriter(job.row_width, ROWS_PER_S)
    reader = RingReader(ring.descriptor)
    outputs = _Outputs(job, reader, allocate(job, os.memfd_create("minute")), -1)
    assert outputs.recorder is not None
    outputs.recorder.open(1)
    row = np.random.default_rng(1).normal(size=(2, len(NAMES) + 6))
    taken = []
    for cycle in range((WARM_S + COUNTED_S) * ROWS_PER_S + 1):
        if cycle == WARM_S * ROWS_PER_S:
            tracemalloc.start()
        if cycle >= WARM_S * ROWS_PER_S and cycle % ROWS_PER_S == 500:
            taken.append(tracemalloc.get_traced_memory()[0])
        row[:, NAMES.index(TIME)], row[:, NAMES.index(CYCLE)] = cycle * PERIOD_S, cycle
        ring.push(row.ravel())
        if cycle % 20 == 0:
            outputs.take(reader.drain(), reader.drain_events())
    tracemalloc.stop()
    outputs.close(was_abandoned=False)
    growth = np.diff(taken[1:])
    assert len(growth) == COUNTED_S - 2
    assert np.median(growth) < INDEX_BYTES
    assert taken[-1] - taken[1] < INDEX_BYTES * len(growth) + NOISE_BYTES
    assert len(read(tmp_path / "run.mcap", "x")["cycle"]) == cycle + 1
