"""The recorder of the companion: files of bounded duration and size, within a disk space, on a disk that fails."""

import itertools
import os
import resource
import shutil
import signal
import socket
import stat

import numpy as np
import pytest

import friction_hil as fh
from friction_hil.cli import main
from friction_hil.daemon.companion import Job, free_path
from friction_hil.daemon.companion import recorder as recorder_module
from friction_hil.daemon.companion.recorder import Recorder
from friction_hil.daemon.ring import RingReader, RingWriter
from friction_hil.doctor import disk
from friction_hil.recordings.parts import first_files

COLUMNS = ["time_s", "cycle", "position"]
PERIOD_S = 0.01
RATE = round(1.0 / PERIOD_S)


class Bench:
    """A recorder in this process, fed by a ring; ``now_s`` is its monotonic clock."""

    def __init__(self, path, period_s=PERIOD_S, **options):
        given = {"started_unix_ns": NEW, "metadata": {"configuration": {"version": 1}}} | options
        self.job = Job(["x"], COLUMNS, 1, period_s, path=str(path), **given)
        self.writer = RingWriter(self.job.row_width, 4096)
        self.ring = RingReader(self.writer.descriptor)
        self.now_s = 0.0
        self.recorder = Recorder(self.job, self.ring, -1, lambda: self.now_s)
        self.recorder.open(1)
        self.cycle = 0

    def push(self, count, *events):
        """Record ``count`` more rows; random positions, which no compression makes small."""
        for cycle in range(self.cycle, self.cycle + count):
            self.writer.push(np.array([cycle * self.job.period_s, cycle, np.random.default_rng(cycle).random(), cycle]))
        self.cycle += count
        for name in events:
            self.writer.push_event(self.cycle, name, "text")
        self.recorder.take(self.ring.drain(), self.ring.drain_events())

    def close(self):
        self.recorder.close(was_abandoned=False)


@pytest.fixture
def bench(tmp_path):
    """Make a bench whose files are in ``tmp_path``."""
    made = []

    def make(name="run.mcap", **options):
        made.append(Bench(tmp_path / name, **options))
        return made[-1]

    yield make
    for each in made:
        each.close()
        os.close(each.ring.descriptor)


OLD = 1_600_000_000_000_000_000
NEW = 1_700_000_000_000_000_000


def names_in(folder):
    return {path.name for path in folder.iterdir()}


def cycles(path, **options):
    return fh.recordings.read(path, **options)["cycle"].tolist()


def test_a_file_ends_after_its_time_and_all_files_are_read_as_one(bench, tmp_path):
    recorder = bench(rotate_s=2.0)
    for _ in range(11):
        recorder.push(50, "state")
    recorder.close()
    names = ["run.mcap", "run-2.mcap", "run-3.mcap"]
    assert names_in(tmp_path) == set(names)
    alone = [fh.recordings.read(tmp_path / name, is_alone=True) for name in names]
    assert [len(each) for each in alone] == [200, 200, 150]
    for each in alone:  # each stands alone
        assert (each.metadata["configuration"], each.problems) == ({"version": 1}, [])
        assert each.restarts[0] == (0, each["cycle"][0])
    whole = fh.recordings.read(tmp_path / "run.mcap")
    assert whole["cycle"].tolist() == list(range(550))
    assert [(row, float(state[0])) for row, state in whole.restarts] == [(row, row) for row in range(0, 550, 100)]
    assert [event.cycle for event in whole.events] == list(range(50, 600, 50))
    (problem,) = whole.problems
    assert "2 files" in problem
    assert problem.endswith("run-3.mcap")
    assert cycles(tmp_path / "run-2.mcap") == list(range(200, 400))


def test_a_file_stays_below_its_size(bench, tmp_path):
    recorder = bench(rotate_bytes=12_000)
    for _ in range(40):
        recorder.push(50)
    recorder.close()
    files = list(tmp_path.iterdir())
    assert len(files) > 3
    assert max(path.stat().st_size for path in files) < 12_000 + 3_000  # a table of contents follows the last chunk
    assert cycles(tmp_path / "run.mcap") == list(range(2000))


def test_the_oldest_files_go_and_those_of_faults_and_of_others_stay(bench, tmp_path):
    bench(rotate_s=2.0, started_unix_ns=OLD).push(600)
    kept = {"run-fault-20200101-000000.mcap": 9_000, "run-2 of May.mcap": 9_000, "other.mcap": 9_000, "run-9.mcap": 9}
    for name, size in kept.items():
        (tmp_path / name).write_bytes(bytes(size))
    path = free_path(tmp_path / "run.mcap", NEW)
    recorder = bench(path.name, rotate_s=2.0, budget_bytes=40_000)
    for _ in range(20):
        recorder.push(100)
        own = names_in(tmp_path) - {"other.mcap", "run-2 of May.mcap"}
        # rows of two seconds are not yet flushed
        assert sum((tmp_path / name).stat().st_size for name in own) < 40_000 + 8_000
    recorder.close()
    assert kept.keys() <= names_in(tmp_path)
    assert not {"run.mcap", "run-2.mcap", "run-3.mcap", path.name} & names_in(tmp_path)  # those of the older run, too
    (first,) = (each for each in first_files(tmp_path) if each.name.startswith(path.stem))
    assert cycles(first) == list(range(2000 - len(cycles(first)), 2000))  # the newest are there, without a gap


def test_what_is_not_a_part_of_this_daemons_own_recording_by_its_content_stays(bench, tmp_path):
    """The name alone proves nothing: other daemons, files that were renamed, and what nobody can read."""
    ours = "mill/mill.mcap"
    for name, series in (
        ("mill-2", "mill-2/mill-2.mcap"),  # another daemon, whose path looks like a part
        ("mill-20260101-120000", "mill-20260101-120000/mill-20260101-120000.mcap"),
        ("mill-20260101-120001", "press/mill.mcap"),  # the same path in another configuration
        ("mill-20260101-120002", None),  # an earlier version, which did not say whose it was
        ("copy", ours),
        ("mill-20260101-120003", ours),
    ):
        other = bench(f"{name}.mcap", series=series, started_unix_ns=OLD)
        other.push(300)
        other.close()
    (tmp_path / "copy.mcap").rename(tmp_path / "mill-7.mcap")  # part 1 by its content
    (tmp_path / "mill-8.mcap").write_bytes((tmp_path / "mill-20260101-120003.mcap").read_bytes()[:60])
    outside = tmp_path / "outside/mill-20260101-120004.mcap"
    outside.parent.mkdir()
    shutil.copy(tmp_path / "mill-20260101-120003.mcap", outside)
    for name, target in ((outside.name, outside), ("mill-9.mcap", tmp_path / "gone"), ("mill-10.mcap", "/dev/zero")):
        (tmp_path / name).symlink_to(target)
    os.mkfifo(tmp_path / "mill-11.mcap")
    (tmp_path / "mill-12.mcap").mkdir()
    with socket.socket(socket.AF_UNIX) as listening:
        listening.bind(str(tmp_path / "mill-13.mcap"))
        before = names_in(tmp_path)
        path = free_path(tmp_path / "mill.mcap", NEW)
        recorder = bench(path.name, rotate_s=1.0, budget_bytes=1_000, series=ours)
        recorder.push(300)
        recorder.close()
        after = names_in(tmp_path)
    assert before - after == {"mill-20260101-120003.mcap"}
    assert outside.exists()
    assert after - before == {path.with_stem(f"{path.stem}-3").name}
    assert disk.recording_folder(tmp_path / "mill.mcap", 1.0, 10**9, ours).result == "pass"


@pytest.mark.parametrize("kind", ["pipe", "dangling link", "folder", "socket"])
def test_a_path_that_something_else_has_is_not_used(bench, tmp_path, kind):
    path = tmp_path / "mill.mcap"
    make = {"pipe": os.mkfifo, "folder": os.mkdir, "socket": lambda each: os.mknod(each, stat.S_IFSOCK | 0o600)}
    make.get(kind, lambda each: os.symlink("away", each))(path)
    first = free_path(path, NEW)
    os.symlink("away", first)
    second = free_path(path, NEW)
    assert not os.path.lexists(second)
    recorder = bench(second.name, budget_bytes=10_000)
    recorder.push(10)
    recorder.close()
    assert cycles(second) == list(range(10))
    assert not (tmp_path / "away").exists()
    assert first_files(tmp_path) == [second]


def test_a_budget_that_files_of_faults_exceed_is_reported_once(bench, tmp_path, capfd):
    (tmp_path / "run-fault-20200101-000000.mcap").write_bytes(bytes(100_000))
    recorder = bench(rotate_s=1.0, budget_bytes=50_000)
    for _ in range(5):
        recorder.push(100)
    recorder.close()
    assert capfd.readouterr().err.count("0.1 MB in") == 1
    assert cycles(tmp_path / "run-5.mcap")  # the file that is being written is never removed


def test_a_disk_that_is_full_loses_rows_until_there_is_room(bench, tmp_path, capfd, monkeypatch):
    recorder = bench()
    recorder.push(250)
    assert recorder.ring.rows_kept == 200
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    try:
        resource.setrlimit(resource.RLIMIT_FSIZE, ((tmp_path / "run.mcap").stat().st_size + 100, before[1]))
        recorder.push(200)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
        signal.signal(signal.SIGXFSZ, handler)
    assert "File too large" in capfd.readouterr().err
    # too soon to try again, no room yet, and too soon after that
    for recorder.now_s, free in ((0.0, None), (6.0, 1000), (6.0, None)):
        with monkeypatch.context() as patched:
            if free is not None:
                patched.setattr(recorder_module, "_free_bytes", lambda _, free=free: free)
            recorder.push(100)
    assert names_in(tmp_path) == {"run.mcap"}
    recorder.now_s = 12.0
    recorder.push(100)
    assert f"goes on in {tmp_path / 'run-2.mcap'}" in capfd.readouterr().err
    recorder.close()
    whole = fh.recordings.read(tmp_path / "run.mcap")
    assert whole["cycle"].tolist() == [*range(200), *range(750, 850)]
    assert any("550 cycles" in problem for problem in whole.problems)
    assert (recorder.ring.rows_kept, recorder.ring.rows_lost) == (300, 550)


def test_what_waits_for_a_row_is_flushed_all_the_same_except_in_simulated_time(bench, tmp_path):
    recorder, simulated = bench(), bench("simulated.mcap", started_unix_ns=0)
    recorder.push(10, "fault")
    simulated.push(10)
    for recorder.now_s, kept in ((0.5, 0), (1.4, 0), (1.6, 10)):
        recorder.push(0)
        assert recorder.ring.rows_kept == kept
    assert cycles(tmp_path / "run.mcap") == list(range(10))
    simulated.now_s = 100.0
    simulated.push(0)
    assert simulated.ring.rows_kept == 0


@pytest.mark.parametrize("command", [("replay", "--verify"), ("convert", "--info"), ("plot",)])
def test_a_folder_of_several_recordings_is_refused_by_name_or_read_one_by_one(bench, tmp_path, capsys, command):
    for name in ("a.mcap", "b.mcap"):
        other = bench(name, rotate_s=1.0)
        other.push(200)
        other.close()
    status = main([*command[:1], str(tmp_path), *command[1:]])
    error = capsys.readouterr().err
    if command[0] == "replay":  # takes several; these have no inputs of a compensator
        assert (status, error.count("only the daemon's own")) == (1, 2)
    else:
        assert (status, "2 recordings; name one of them: a.mcap, b.mcap" in error) == (2, True)


@pytest.mark.deep
def test_after_a_power_cut_all_that_was_forced_to_the_disk_is_read(bench, tmp_path, monkeypatch):
    """The file is cut at every byte: it holds at least the rows that were released before it had that size."""
    sizes, force = [], os.fsync

    def spy(descriptor):
        force(descriptor)
        sizes.append(os.fstat(descriptor).st_size)

    monkeypatch.setattr(os, "fsync", spy)
    recorder = bench(metadata={}, period_s=0.2)
    kept = []
    for _ in range(8):
        recorder.push(2)
        kept.append((recorder.ring.rows_kept, (tmp_path / "run.mcap").stat().st_size))
        assert kept[-1][1] in sizes  # nothing is released that was not forced
    recorder.close()
    path, whole = tmp_path / "run.mcap", (tmp_path / "run.mcap").stat().st_size
    assert whole in sizes
    steps = sorted(dict(reversed(kept)).items())
    assert [rows for rows, _ in steps] == [0, 5, 10, 15]
    first = steps[1][1]
    for size in range(whole, first - 1, -1):
        os.truncate(path, size)
        found = cycles(path)
        assert found == list(range(len(found)))
        assert len(found) >= max(rows for rows, at in steps if at <= size)
    assert len(found) == 5
    for command in (["convert", "--info", path], ["plot", path]):
        assert main(list(map(str, command))) == 0


def test_numbers_of_files_are_never_used_again(bench, tmp_path):
    recorder = bench(rotate_s=1.0)
    recorder.push(300)
    (tmp_path / "run-2.mcap").unlink()
    recorder.push(100)
    recorder.close()
    assert names_in(tmp_path) == {"run.mcap", "run-3.mcap", "run-4.mcap"}
    (tmp_path / "run.mcap").unlink()
    assert cycles(tmp_path / "run-3.mcap") == list(range(200, 400))  # the first one that is left
    assert free_path(tmp_path / "run.mcap", 1) != tmp_path / "run.mcap"


def test_files_of_two_runs_of_one_name_are_not_mixed(bench, tmp_path):
    for started, count in ((OLD, 300), (NEW, 200)):
        recorder = bench(rotate_s=1.0, started_unix_ns=started, overwrite=True)
        recorder.push(count)
        recorder.close()
    assert names_in(tmp_path) == {"run.mcap", "run-2.mcap", "run-3.mcap", "run-4.mcap"}
    whole = fh.recordings.read(tmp_path / "run.mcap")
    assert whole["cycle"].tolist() == list(range(200))
    assert whole.problems[0].endswith("run-4.mcap")


def test_a_part_without_rows_is_left_out_and_reported(bench, tmp_path):
    recorder = bench(rotate_s=1.0)
    recorder.push(300)
    recorder.close()
    data = (tmp_path / "run-2.mcap").read_bytes()
    start = data.index(b"\x06", 1500)  # of the first chunk
    for size in itertools.takewhile(lambda size: size < start + 400, itertools.count(start - 200, 40)):
        (tmp_path / "run-2.mcap").write_bytes(data[:size])
        whole = fh.recordings.read(tmp_path / "run.mcap")
        assert whole["cycle"].tolist() == [*range(100), *range(200, 300)]
        assert any("run-2.mcap" in problem for problem in whole.problems[1:])
