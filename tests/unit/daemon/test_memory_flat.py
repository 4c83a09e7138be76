"""A daemon runs for months: neither its loop nor the process that records keeps anything of a cycle that is over.

What Python allocates is counted, to the byte; `tools/bench loop memory` measures the memory of whole processes.
"""

import os
import tracemalloc
from pathlib import Path
from types import SimpleNamespace

import numpy as np

from friction_hil.daemon.companion.job import Job
from friction_hil.daemon.companion.memory import allocate
from friction_hil.daemon.companion.worker import _Outputs
from friction_hil.daemon.ring import RingReader, RingWriter
from friction_hil.recordings import read
from friction_hil.recordings.columns import CYCLE, NAMES, TIME
from tests.loop_run import Drives, axis
from tests.servo_drives import configuration, make_loop

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
