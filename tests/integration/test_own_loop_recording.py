"""The recording of a user's loop while it runs, by the real processes: the same bits, whoever dies."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

import friction_hil as fh
from friction_hil import recordings
from friction_hil.daemon.companion import Job, own_rows
from friction_hil.daemon.companion.client import ring_of
from friction_hil.errors import RecordingError, UsageError
from friction_hil.replay.verify import verify
from tests.own_loops import PERIOD_S, STRIBECK, configuration, motion, steps

ROOT = Path(__file__).parents[2]
CYCLES = 3000
LOOP = """
import sys, time
import friction_hil as fh
from tests.own_loops import PERIOD_S, configuration, motion
one, inputs = fh.Compensator(configuration(), record=sys.argv[1]), motion(20000, 3)
for k in range(20000):
    one.step(**{name: values[k] for name, values in inputs.items()}, dt=PERIOD_S)
    if k == 2000:
        print("moving", flush=True)
    if k > 2000:
        time.sleep(PERIOD_S)
"""


def moved(one, inputs, begin, end):
    steps(one, end - begin, **{name: values[begin:end] for name, values in inputs.items()})
    time.sleep(0.1)  # slower than the clock would be, so that no row is lost on a machine without time


def verified(path):
    """Rows of each joint, all of them verified bit for bit from the first state on."""
    found = recordings.read_all(path)
    for recording in found.values():
        result = verify(recording)
        assert (result.reason, result.tolerance) == ("", 0.0)
        assert result.rows == len(recording)
    return next(iter(found.values()))


def is_complete(path):
    """Whether the process that writes it has done its work."""
    try:
        return "cut off" not in " ".join(recordings.read_all(path)["j0"].problems)
    except RecordingError:  # the first second is not there yet
        return False


def test_a_file_is_verified_with_every_change_and_whoever_records_dies(tmp_path):
    path = tmp_path / "run.mcap"
    one = fh.Compensator(configuration(recording={"rotate_s": 3.0}), record=path)
    inputs = motion(CYCLES, 3)
    inputs["dt"] = PERIOD_S * np.where(np.arange(CYCLES) % 101, 1, 4)
    for begin in range(0, CYCLES, 250):
        if begin == 1000:
            one.set("j0", model={"axis": "rotary", "friction": STRIBECK})
        elif begin % 500 == 0:
            one.set(f"j{begin // 500 % 3}", gain=0.9 - 1e-4 * begin)
        if begin == 250 and not (child := os.fork()):
            one.set("j1", gain=0.1)
            moved(one, inputs, 2 * begin, 3 * begin + 7)
            one.close()
            os._exit(not any("forked" in each for each in one.notices))
        if begin == 1500:
            os.kill(one._recorder._companion.worker_pid, signal.SIGKILL)
        if begin == 250:
            assert os.waitpid(child, 0)[1] == 0, "what a forked process computes and sets is no part of it"
        moved(one, inputs, begin, begin + 250)
    one.close()
    assert sum("died" in each for each in one.notices) == 1
    assert not any("lost" in each for each in one.notices)
    assert len(list(tmp_path.glob("run-*.mcap"))) >= 2, "one for the death, one for rotate_s"
    whole = verified(path)
    assert len(whole) == CYCLES
    assert {event.name for event in whole.events} >= {"change", "notice"}
    before = one.notices
    one.set("j0", gain=0.5)  # whose descriptors are closed
    one.step(inputs["q"][0], dt=PERIOD_S)
    one.close()
    assert np.array_equal(whole["position"], inputs["q"][:, 0])
    assert one.notices == before, "a loop goes on without its recording"


def test_a_forked_process_that_lives_on_keeps_nothing_alive(tmp_path):
    one = fh.Compensator(configuration(), record=tmp_path / "run.mcap")
    inside, outside = os.pipe()
    if not (child := os.fork()):
        os.close(outside)
        os.read(inside, 1)
        os._exit(0)
    try:
        one.close()
    finally:
        os.close(outside)
        os.close(inside)
    assert os.waitpid(child, 0)[1] == 0
    assert one._recorder._companion.process.returncode == 0, "it ended by itself, and was not killed"


def test_a_killed_program_leaves_a_file_with_all_its_cycles(tmp_path):
    path = tmp_path / "run.mcap"
    program = subprocess.Popen([sys.executable, "-c", LOOP, path], cwd=ROOT, stdout=subprocess.PIPE)
    try:
        assert program.stdout.readline() == b"moving\n"
        time.sleep(0.3)
    finally:
        program.kill()
        program.wait()
        program.stdout.close()
    end_s = time.monotonic() + 30.0
    while not is_complete(path):
        assert time.monotonic() < end_s
        time.sleep(0.1)
    found = verified(path)
    assert len(found) > 2001
    assert np.array_equal(found["cycle"], np.arange(len(found)))


def test_after_a_loss_the_recording_goes_on_with_a_state():
    job = Job(["a", "b"], list(recordings.columns.NAMES), 2, 1.0, 0, ring_columns=["cycle", "position", "compensation"])
    job = Job(**{name: getattr(job, name) for name in job.__slots__} | {"rows_between_states": 50})
    ring = ring_of(job)
    states, reader = ring.tail.reshape(-1, 2, 2), own_rows.OwnRingReader(ring.descriptor, job)

    def push(begin, end):
        for k in range(begin, end):
            if k % 50 == 0:
                states[k // 50 % len(states)] = k
            ring.push(np.array([k, 0.1, 0.2] * 2))

    def taken():
        rows, has_state = reader.in_full(reader.drain())
        reader.release(len(rows), 0)
        width = len(job.columns) + 2
        begun = rows[has_state]
        assert np.array_equal(begun[:, [width - 1, 2 * width - 2]], np.repeat(begun[:, [1]], 2, axis=1))
        return rows[:, 1].tolist(), np.flatnonzero(has_state).tolist()

    push(0, 70)
    assert taken() == (list(range(70)), [0, 50])
    assert taken() == ([], [])
    push(70, 1205)  # more than there is room for
    first = (1205 - ring.capacity) // 50 * 50 + 50
    assert taken() == (list(range(first, 1205)), list(range(0, 1205 - first, 50)))
    assert reader.lost == first - 70
    push(1205, 1301)
    assert taken() == (list(range(1205, 1301)), [45, 95])


def test_a_name_that_is_taken_and_a_second_copy_are_refused(tmp_path):
    path = tmp_path / "run.mcap"
    path.write_bytes(b"")
    with pytest.raises(RecordingError, match="exists"):
        fh.Compensator(configuration(), record=path)
    with pytest.raises(UsageError, match=r"\.mcap"):
        fh.Compensator(configuration(), record=tmp_path / "run.csv")
    one = fh.Compensator(configuration(), record=tmp_path / "other.mcap")
    with pytest.raises(UsageError, match=r"other\.mcap"):
        one.save(tmp_path / "run2.mcap")
    one.close()
