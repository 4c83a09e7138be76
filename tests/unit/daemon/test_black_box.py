"""Files of faults: the minute before and the seconds after, from memory of a fixed size that outlives a worker."""

import os
import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import friction_hil as fh
from friction_hil.daemon.companion import Job, black_box, memory, state_folder
from friction_hil.daemon.companion.black_box import BlackBox
from friction_hil.daemon.companion.history import History

COLUMNS = ["time_s", "cycle", "position"]
PERIOD_S = 0.05
RATE = round(1.0 / PERIOD_S)
STATE = 2


def make_job(folder, **options):
    given = {"started_unix_ns": 1_700_000_000_000_000_000, "metadata": {"configuration": {"version": 1}}} | options
    return Job(["x", "y"], COLUMNS, STATE, PERIOD_S, black_box=str(folder / "axes.mcap"), **given)


def rows(first, end):
    """Rows of two axes; states are the cycle and the number of the axis."""
    cycle = np.arange(first, end, dtype=float)
    time = cycle * PERIOD_S
    ones = np.ones(len(cycle))
    return np.stack([time, cycle, cycle, cycle, ones, time, cycle, -cycle, cycle, 2 * ones], axis=1)


class Bench:
    """History and files of faults in this process, fed second by second."""

    def __init__(self, folder, memory_of=None, **options):
        self.job = make_job(folder, **options)
        self.memory = memory.allocate(self.job, os.memfd_create("minute")) if memory_of is None else memory_of.memory
        self.history = History(self.job, self.memory)
        self.box = BlackBox(self.job, self.history, -1)
        self.cycle = 0 if memory_of is None else memory_of.cycle

    def run(self, seconds, *events):
        """Take so many seconds of rows, then the events."""
        for second in range(seconds):
            self.history.append(rows(self.cycle, self.cycle + RATE))
            self.cycle += RATE
            is_last = second == seconds - 1
            self.box.take([(self.cycle - 1.0, *each) for each in events] if is_last else [])
            self.box.advance()

    def finish(self, *, was_abandoned=False):
        self.box.finish(was_abandoned=was_abandoned)


def files(folder):
    return sorted(folder.glob("axes-fault-*.mcap"))


def read(path):
    """Cycles of a file, after a check of its values and states."""
    for axis, sign in (("x", 1), ("y", -1)):
        recording = fh.recordings.read(path, axis)
        np.testing.assert_array_equal(recording["position"], sign * recording["cycle"])
        assert recording.restarts[0][0] == 0  # all of it can be verified
        for row, state in recording.restarts:
            assert state.tolist() == [recording["cycle"][row], 1 if axis == "x" else 2]
        gaps = 1 + np.flatnonzero(np.diff(recording["cycle"]) > 1)
        assert {*gaps.tolist()} <= {row for row, _ in recording.restarts}
        assert recording.problems == [] or gaps.size
        assert recording.metadata["configuration"] == {"version": 1}
    return recording["cycle"], recording.events


def test_without_a_fault_and_before_the_first_row_there_is_no_file_and_the_death_of_the_daemon_is_a_fault(tmp_path):
    bench = Bench(tmp_path)
    bench.box.take([(0.0, "fault", "x: no usable feedback [FH-101]")])
    bench.finish()
    assert files(tmp_path) == []
    bench.run(1)
    bench.finish()
    (first,) = files(tmp_path)
    cycle, events = read(first)
    assert (len(cycle), [each.name for each in events]) == (RATE, ["fault"])
    other = Bench(tmp_path)
    other.run(100, ("warning", "late"))
    other.finish()
    assert files(tmp_path) == [first]
    other.finish(was_abandoned=True)
    (path,) = {*files(tmp_path)} - {first}
    cycle, events = read(path)
    assert (len(cycle), events[-1].name) == (60 * RATE, "abandoned")


def test_a_fault_leaves_the_minute_before_and_ten_seconds_after(tmp_path):
    bench = Bench(tmp_path)
    bench.run(90, ("state", "running"))
    bench.run(10, ("fault", "x: following error [FH-109]"))
    bench.run(30)
    (path,) = files(tmp_path)  # complete while the run goes on
    assert re.fullmatch(r"axes-fault-\d{8}-\d{6}\.mcap", path.name)
    cycle, events = read(path)
    assert cycle.tolist() == list(range(40 * RATE, 110 * RATE))
    assert [(each.cycle, each.name) for each in events] == [(90 * RATE - 1, "state"), (100 * RATE - 1, "fault")]
    bench.run(1, ("fault", "y: blocked"))
    bench.finish()  # the run ends with this fault
    assert len(files(tmp_path)) == 2
    cycle, _ = read(next(each for each in files(tmp_path) if each != path))
    assert cycle.tolist() == list(range(71 * RATE, 131 * RATE))


def test_faults_that_follow_each_other_are_in_one_file_of_bounded_length(tmp_path):
    bench = Bench(tmp_path)
    bench.run(70, ("fault", "first"))
    for number in range(12):
        bench.run(5, ("fault", f"number {number}"))
    (path, *_) = files(tmp_path)
    cycle, events = read(path)
    assert cycle[0] == 10 * RATE
    assert cycle[-1] == pytest.approx(130 * RATE - 1, abs=1.0)
    assert len(events) == 13
    bench.finish()


def test_a_file_begins_where_a_replay_can_start_also_with_many_gaps(tmp_path):
    bench = Bench(tmp_path)
    for _ in range(120 * RATE // 2):  # every other row follows a gap: more of them than there is room for states
        bench.history.append(rows(bench.cycle, bench.cycle + 2))
        bench.cycle += 3
    bench.run(1, ("fault", "x"))
    bench.finish()
    (path,) = files(tmp_path)
    cycle, _ = read(path)
    assert 2 * 500 < len(cycle) < 2 * 530


def test_a_worker_that_takes_over_has_the_minute_before_its_own_life(tmp_path):
    first = Bench(tmp_path)
    first.run(30)
    second = Bench(tmp_path, memory_of=first)
    second.cycle -= RATE // 2  # rows that the first one had not released in the ring come again
    second.run(31, ("fault", "x"))
    third = Bench(tmp_path, memory_of=second)  # the second one dies while it writes the file
    third.run(20)
    assert len(files(tmp_path)) == 2
    (whole,) = [path for path in files(tmp_path) if not fh.recordings.read(path, "x").problems]
    cycle, _ = read(whole)
    assert cycle.tolist() == list(range(70 * RATE + RATE // 2))


@pytest.mark.parametrize(("is_full", "said"), [(False, "the minute before"), (True, "No space left on device")])
def test_what_cannot_be_written_is_reported_and_the_run_goes_on(tmp_path, capfd, monkeypatch, is_full, said):
    def refuse(*_, **__):
        raise OSError(28, os.strerror(28))

    (tmp_path / "file").touch()
    if is_full:
        monkeypatch.setattr(black_box.McapWriter, "write", refuse)
    bench = Bench(tmp_path if is_full else tmp_path / "file" / "below")
    bench.run(5, ("fault", "x"))
    bench.run(5)
    bench.finish()
    assert said in capfd.readouterr().err


@given(
    st.lists(st.tuples(st.integers(1, 700), st.integers(1, 3)), min_size=1, max_size=12),
    st.integers(0, 2000),
    st.integers(0, 900),
)
def test_the_history_keeps_the_newest_rows_as_they_were(pieces, first, length):
    """Against a list of all rows: any pieces, with gaps between them, and any part of what is kept."""
    job = make_job(state_folder())
    history, everything, cycle = History(job, bytearray(memory.size_bytes(job))), [], 0
    for size, gap in pieces:
        block = rows(cycle, cycle + size)
        history.append(block)
        everything.append(block)
        cycle += size + gap - 1
    whole = np.concatenate(everything)
    assert history.count == len(whole)
    assert history.last_cycle == whole[-1, 1]
    assert history.count - history.oldest == min(len(whole), memory.rows_kept(job))
    first = max(first, history.oldest)
    found, has_state = history.read(first, first + length)
    expected = whole[first : first + length]
    is_state = np.tile([False] * 3 + [True] * 2, 2)
    np.testing.assert_array_equal(found[:, ~is_state], expected[:, ~is_state])
    np.testing.assert_array_equal(found[has_state], expected[has_state])
    assert np.isnan(found[~has_state][:, is_state]).all()
    gaps = np.flatnonzero(np.diff(expected[:, 1]) != 1.0) + 1
    assert has_state[gaps].all()
    assert not len(expected) or np.diff(np.flatnonzero(has_state), prepend=-1, append=len(expected)).max() <= RATE + 1


def test_memory_is_bounded_at_any_period():
    for axes, period_s in ((2, 1e-3), (64, 1e-4), (256, 1e-4)):
        job = Job([f"x{k}" for k in range(axes)], COLUMNS * 9, 100, period_s, 0)
        assert memory.size_bytes(job) < (256 << 20) + 512 * 8 * (1 + 100 * axes) + 4097
    job = Job(["x", "y"], COLUMNS * 9, 100, 1e-3, 0)
    assert memory.rows_kept(job) == 80_000  # the minute before, and a third for a slow disk


def test_the_folder_of_state_is_that_of_the_service_or_the_user(monkeypatch):
    monkeypatch.setenv("STATE_DIRECTORY", "/var/lib/friction-hil:/var/lib/other")
    assert str(state_folder()) == "/var/lib/friction-hil"
    monkeypatch.delenv("STATE_DIRECTORY")
    monkeypatch.setenv("XDG_STATE_HOME", "/state")
    assert str(state_folder()) == "/state/friction-hil"
    monkeypatch.setenv("XDG_STATE_HOME", "relative is invalid by the specification")
    monkeypatch.setenv("HOME", "/home/user")
    assert str(state_folder()) == "/home/user/.local/state/friction-hil"
