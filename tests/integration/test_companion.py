"""The companion as a real process: what it records, and what happens when something dies."""

import contextlib
import errno
import os
import resource
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import friction_hil as fh
from friction_hil.daemon.companion import Companion, CompanionReport, Job, client, free_path
from friction_hil.daemon.stop import stop_on_signals
from friction_hil.errors import RecordingError, UsageError
from friction_hil.interrupts import Interrupted
from friction_hil.recordings.columns import NAMES

COLUMNS = ["time_s", "cycle", "position"]
STATE = 2
PERIOD_S = 1e-3


@pytest.fixture
def job(tmp_path: Path) -> Job:
    return Job(
        axes=["x", "y"],
        columns=COLUMNS,
        state_width=STATE,
        period_s=PERIOD_S,
        started_unix_ns=1_700_000_000_000_000_000,
        path=str(tmp_path / "run.mcap"),
        metadata={"configuration": {"period_s": PERIOD_S, "level": float("inf")}},
    )


@pytest.fixture
def companion(job: Job) -> Iterator[Companion]:
    with Companion.start(job) as started:
        yield started


def row(cycle: int) -> np.ndarray:
    """One cycle of both axes: the position of x is its cycle, that of y the negative; states follow."""
    return np.array([cycle * PERIOD_S, cycle, cycle, 1, -1, cycle * PERIOD_S, cycle, -cycle, 2, -2], dtype=float)


def push(companion: Companion, first: int, end: int) -> None:
    for cycle in range(first, end):
        while companion.free_slots() == 0:  # the ring is in shared memory: this ends when the reader is there
            os.sched_yield()
        companion.push(row(cycle))


def cycles(paths: tuple[str, ...], axis: str = "x") -> list[float]:
    """Cycles of all segments, in order; every row is checked."""
    found: list[float] = []
    for path in paths:
        recording = fh.recordings.read(path, axis, is_alone=True)
        cycle = recording["cycle"]
        np.testing.assert_array_equal(recording["position"], cycle if axis == "x" else -cycle)
        assert recording.metadata["configuration"] == {"period_s": PERIOD_S, "level": float("inf")}
        assert recording.restarts[0][0] == 0
        np.testing.assert_array_equal(recording.restarts[0][1], [1, -1] if axis == "x" else [2, -2])
        found += cycle.tolist()
    return found


def test_every_row_and_event_is_recorded(companion: Companion, job: Job) -> None:
    push(companion, 0, 2500)
    companion.push_event(2499, "fault", "x: following error")
    report = companion.close()
    assert report == CompanionReport((str(job.path),), 2500, 0, ())
    assert companion.close() is report
    assert companion.process.poll() == 0
    for axis in ("x", "y"):
        assert cycles(report.recording, axis) == list(range(2500))
    read = fh.recordings.read(str(job.path), "x")
    assert [(event.cycle, event.name, event.text) for event in read.events] == [(2499.0, "fault", "x: following error")]
    assert read.problems == []


def test_without_a_path_rows_are_taken_and_dropped(job: Job, tmp_path: Path) -> None:
    with Companion.start(replace(job, path=None)) as companion:
        push(companion, 0, 20_000)
        assert companion.close() == CompanionReport((), 20_000, 0, ())
    assert list(tmp_path.iterdir()) == []


def test_a_killed_worker_is_replaced_and_nothing_is_lost(companion: Companion, job: Job, tmp_path: Path) -> None:
    push(companion, 0, 9500)
    while companion.free_slots() < 8000 - 500:  # until nine chunks are on disk and half a one is not
        os.sched_yield()
    first = companion.worker_pid
    os.kill(first, signal.SIGKILL)
    assert "died (signal SIGKILL)" in str(companion.next_message())
    assert companion.next_message() == {"opened": str(tmp_path / "run-2.mcap"), "pid": companion.worker_pid}
    assert companion.worker_pid != first
    push(companion, 9500, 12_000)
    report = companion.close()
    assert report.recording == (job.path, str(tmp_path / "run-2.mcap"))
    assert (report.rows, report.lost) == (12_000, 0)
    assert cycles(report.recording, "y") == list(range(12_000))
    assert len(report.problems) == 1
    whole = fh.recordings.read(report.recording[0], "x")
    np.testing.assert_array_equal(whole["position"], np.arange(12_000))


def test_rows_that_come_while_nobody_reads_are_counted_when_the_ring_is_full(companion: Companion) -> None:
    os.kill(companion.worker_pid, signal.SIGSTOP)
    while Path(f"/proc/{companion.worker_pid}/stat").read_text().rpartition(")")[2].split()[0] != "T":
        os.sched_yield()
    for cycle in range(10_000):  # 8000 fit
        companion.push(row(cycle))
    assert companion.free_slots() == 0
    os.kill(companion.worker_pid, signal.SIGCONT)
    report = companion.close()
    assert report.rows + report.lost == 10_000
    assert report.lost >= 1000
    found = cycles(report.recording)
    assert len(found) == report.rows
    assert found[-1] == 9999.0
    read = fh.recordings.read(report.recording[0], "x")
    assert [row for row, _ in read.restarts][:1] == [0]


def test_a_worker_that_dies_again_and_again_is_given_up(companion: Companion) -> None:
    for _ in range(3):
        os.kill(companion.worker_pid, signal.SIGKILL)
        companion.next_message()
        companion.next_message()
    companion.push(row(0))
    report = companion.close()
    assert (report.rows, report.lost) == (0, 1)
    assert "3 times at once: nothing more is recorded" in report.problems[-1]


def kill_supervisor(companion: Companion) -> None:
    """Kill the supervisor, and wait for the next one."""
    before = companion.supervisor_pid
    os.kill(before, signal.SIGKILL)
    while companion.supervisor_pid == before:
        assert companion.next_message()


def test_the_death_of_the_supervisor_stops_nothing_and_the_companion_starts_another_one(companion: Companion) -> None:
    push(companion, 0, 100)
    kill_supervisor(companion)
    push(companion, 100, 200)
    assert "supervisor died" in str(companion.next_message())
    kill_supervisor(companion)  # one that the companion has started
    push(companion, 200, 300)
    report = companion.close()
    assert len(report.recording) == 1
    assert cycles(report.recording) == list(range(300))
    assert len(report.problems) == 2


def test_the_next_supervisor_starts_the_companion_that_was_there_before_it(companion: Companion) -> None:
    push(companion, 0, 100)
    kill_supervisor(companion)
    os.kill(first := companion.worker_pid, signal.SIGKILL)
    while companion.worker_pid == first:
        assert companion.next_message()
    push(companion, 100, 200)
    report = companion.close()
    assert (report.rows, report.lost) == (200, 0)
    assert cycles(report.recording[1:]) == list(range(200))


def kill_both(companion: Companion) -> None:
    """Kill supervisor and companion, with no time for one to start the other."""
    for pid in (companion.worker_pid, companion.supervisor_pid):
        os.kill(pid, signal.SIGSTOP)
    for pid in (companion.worker_pid, companion.supervisor_pid):
        os.kill(pid, signal.SIGKILL)


def tend(companion: Companion) -> list[tuple[str, str]]:
    """Look after the companion until it has something to say."""
    while not (events := companion.tend()):
        os.sched_yield()
    return events


def test_a_killed_companion_is_told_at_once_and_started_again(
    job: Job, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    told = "the companion process died (signal SIGKILL); the next one takes over, and the loop goes on"
    with Companion.start(job) as companion:  # in the test itself: it inherits where the output goes now
        push(companion, 0, 9500)
        os.kill(companion.worker_pid, signal.SIGKILL)
        assert tend(companion) == [("warning", f"recording: {told}")]
        push(companion, 9500, 12_000)
        report = companion.close()
    assert told in capfd.readouterr().err
    assert report.recording == (str(tmp_path / "run.mcap"), str(tmp_path / "run-2.mcap"))
    assert (report.rows, report.lost, report.pending, report.problems) == (12_000, 0, 0, (told,))
    assert sorted(set(cycles(report.recording))) == list(range(12_000))


def test_when_all_processes_are_killed_what_the_ring_has_is_recorded_at_the_end(companion: Companion) -> None:
    push(companion, 0, 100)
    kill_both(companion)
    ((name, text),) = tend(companion)
    assert name == "warning"
    assert "nothing more is recorded until the run ends" in text
    for cycle in range(100, 200):
        companion.push(row(cycle))
        assert companion.tend() == []
    report = companion.close()
    assert (report.rows, report.lost) == (200, 0)
    assert cycles(report.recording[1:]) == list(range(200))


def test_processes_that_die_at_the_end_are_started_once_more(companion: Companion) -> None:
    kill_both(companion)
    companion.push(row(0))
    report = companion.close()
    assert (report.rows, report.lost) == (1, 0)
    assert cycles(report.recording[1:]) == [0.0]


def test_a_system_without_processes_for_the_companion_is_told(job: Job, monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: object, **__: object) -> None:
        raise OSError(errno.ENOMEM, os.strerror(errno.ENOMEM))

    monkeypatch.setattr(subprocess, "Popen", refuse)
    with pytest.raises(RecordingError, match="the companion process cannot be started: Cannot allocate memory"):
        Companion.start(job)


def test_the_death_by_a_signal_without_a_name_is_told_too(companion: Companion) -> None:
    os.kill(companion.worker_pid, signal.SIGRTMIN + 3)
    assert f"died (signal {signal.SIGRTMIN + 3})" in tend(companion)[0][1]


def stop(companion: Companion) -> None:
    """Stop supervisor and worker (SIGSTOP)."""
    for pid in (companion.process.pid, companion.worker_pid):
        os.kill(pid, signal.SIGSTOP)
        while Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "T":
            os.sched_yield()


def test_a_stopped_companion_neither_holds_the_end_nor_loses_rows(companion: Companion) -> None:
    push(companion, 0, 1500)
    stop(companion)
    for cycle in range(1500, 3000):
        companion.push(row(cycle))
    report = companion.close()
    assert (report.rows, report.lost, report.pending, report.problems) == (3000, 0, 0, ())
    assert cycles(report.recording) == list(range(3000))


def test_a_companion_stopped_during_the_run_is_continued_before_rows_are_lost(companion: Companion) -> None:
    stop(companion)
    for cycle in range(5000):  # 8000 fit
        companion.push(row(cycle))
    companion.tend()
    push(companion, 5000, 20_000)
    report = companion.close()
    assert (report.rows, report.lost) == (20_000, 0)


def test_rows_that_are_still_to_be_written_are_neither_safe_nor_lost(
    companion: Companion, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(companion, "_wake", lambda: None)  # as if it waited for a disk that does not answer
    worker = companion.worker_pid
    push(companion, 0, 100)
    stop(companion)
    companion.push(row(100))
    report = companion.close(patience_s=0.2)
    assert (report.rows + report.pending, report.lost) == (101, 0)
    assert report.pending >= 1
    assert report.problems[-1].startswith(f"the recording is not finished: process {worker} made no progress for 0.2 s")
    for pid in (worker, companion.process.pid):
        os.kill(pid, signal.SIGCONT)
    companion.process.wait()
    assert cycles(report.recording) == list(range(101))


def members(group: int) -> list[str]:
    """Living processes of a process group."""
    found = []
    for file in Path("/proc").glob("[0-9]*/stat"):
        with contextlib.suppress(OSError):
            state, _, its_group = file.read_text().rpartition(")")[2].split()[:3]
            found += [file.parent.name] if state not in "ZX" and int(its_group) == group else []
    return found


def test_a_signal_ends_the_wait_for_a_file_that_does_not_open(job: Job, monkeypatch: pytest.MonkeyPatch) -> None:
    path = Path(str(job.path))
    os.mkfifo(path)
    with pytest.raises(UsageError, match=r"run\.mcap is a pipe: a recording needs a file"):
        Companion.start(job)
    monkeypatch.setattr(client, "prepare", lambda *_, **__: None)  # as if the server of the folder did not answer
    started: list[Companion] = []
    monkeypatch.setattr(Companion, "_begin", lambda self, begin=Companion._begin: (started.append(self), begin(self)))

    def end() -> None:
        while not (started and len(members(started[0].process.pid)) == 2):
            os.sched_yield()
        os.kill(os.getpid(), signal.SIGTERM)

    with stop_on_signals() as request, request.raised():
        threading.Thread(target=end).start()
        with pytest.raises(Interrupted, match="SIGTERM"):
            Companion.start(replace(job, overwrite=True))
    while members(started[0].process.pid):  # nothing is left behind
        os.sched_yield()


def test_signals_of_the_terminal_are_left_to_the_control_process(companion: Companion) -> None:
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        os.kill(companion.worker_pid, number)
        companion.process.send_signal(number)
    push(companion, 0, 1200)
    report = companion.close()
    assert report.problems == ()
    assert cycles(report.recording) == list(range(1200))


CONTROL = """
import json, os, sys
sys.path.insert(0, sys.argv[2])
from friction_hil.daemon.companion import Companion, Job
from test_companion import push
companion = Companion.start(Job(**json.loads(sys.argv[1])))
push(companion, 0, 1500)
print("pushed", flush=True)
sys.stdin.read()
"""


def test_a_killed_control_process_leaves_a_whole_file(job: Job) -> None:
    import json
    from dataclasses import asdict

    job = replace(job, black_box=str(Path(str(job.path)).parent / "axes.mcap"))
    with subprocess.Popen(
        [sys.executable, "-c", CONTROL, json.dumps(asdict(job)), str(Path(__file__).parent)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
    ) as control:
        assert control.stdout is not None
        assert control.stderr is not None
        assert control.stdout.readline() == b"pushed\n"
        control.kill()
        assert control.stderr.read() == b""  # its end: the companion, which has the other end, has gone too
    assert cycles((str(job.path),)) == list(range(1500))
    read = fh.recordings.read(str(job.path), "x")
    assert read.problems == []
    assert [(event.cycle, event.name) for event in read.events] == [(1499.0, "abandoned")]
    (fault,) = Path(str(job.path)).parent.glob("axes-fault-*.mcap")  # the death of the daemon is one
    assert cycles((str(fault),)) == list(range(1500))


def test_a_full_disk_stops_the_recording_and_not_the_run(job: Job, capfd: pytest.CaptureFixture[str]) -> None:
    companion = Companion.start(job)
    resource.prlimit(companion.worker_pid, resource.RLIMIT_FSIZE, (100_000, 100_000))
    push(companion, 0, 20_000)
    report = companion.close()
    (problem,) = report.problems
    assert problem.startswith("the recording stops: File too large; it goes on in another file")
    assert problem in capfd.readouterr().err
    assert 0 < report.rows < 20_000
    assert report.rows + report.lost == 20_000
    assert cycles(report.recording) == list(range(report.rows))


def test_a_file_that_cannot_be_made_is_told_before_anything_moves(job: Job, tmp_path: Path) -> None:
    (tmp_path / "full.mcap").symlink_to("/dev/full")
    (tmp_path / "folder.mcap").mkdir()
    (tmp_path / "file").touch()
    for path, overwrite, message in (
        ("full.mcap", True, "full.mcap cannot be written: No space left on device"),
        ("file/run.mcap", False, "file cannot be made: there is a file of that name"),
        ("file/a/run.mcap", False, "file/a cannot be made: there is a file of that name"),
    ):
        with pytest.raises(RecordingError, match=message):
            Companion.start(replace(job, path=str(tmp_path / path), overwrite=overwrite))
    with pytest.raises(UsageError, match=r"written as \.mcap"):
        Companion.start(replace(job, path=str(tmp_path / "run.csv")))
    with pytest.raises(UsageError, match=r"folder\.mcap is a folder"):
        Companion.start(replace(job, path=str(tmp_path / "folder.mcap")))


def test_missing_folders_are_made_and_existing_files_kept(job: Job, tmp_path: Path) -> None:
    path = tmp_path / "a" / "b" / "run.mcap"
    job = replace(job, path=str(path))
    assert free_path(path, 0) == path
    Companion.start(job).close()
    before = path.read_bytes()
    with pytest.raises(RecordingError, match="exists already; --force replaces it"):
        Companion.start(job)
    assert path.read_bytes() == before
    other = free_path(path, job.started_unix_ns)
    assert other.parent == path.parent
    assert other.name.startswith("run-2023111")
    with Companion.start(replace(job, overwrite=True)) as companion:
        companion.push(row(0))
    assert cycles((str(path),)) == [0.0]


def test_the_status_line_tells_how_it_goes(job: Job, capfd: pytest.CaptureFixture[str]) -> None:
    job = replace(job, columns=list(NAMES), axes=["x", "z"], kinds=["rotary", "linear"], status_line=True, path=None)
    values = dict.fromkeys(NAMES, np.nan) | {"position": 0.0, "position_demand": 3e-3, "compensation": 0.05, "state": 2}
    with Companion.start(job) as companion:
        for cycle in (*range(50), *range(52, 1000)):
            late = 10.0 if cycle < 970 else 500.0
            now = values | {"time_s": cycle * PERIOD_S, "cycle": cycle, "late_us": late}
            companion.push(np.tile([*now.values(), *[0.0] * STATE], 2))
    first, *_, last = capfd.readouterr().err.replace("\x1b[K", "").split("\r")
    assert first == ""
    loop, x, z = last.removeprefix("\x1b[2A").splitlines()
    assert loop == "1.0 s  RUNNING  missed 2  late p99 500 µs  lost 0"
    assert x == "x  error 3.00 mrad rms  comp  50.0 mN m  velocity           -"
    assert z == "z  error   3.00 mm rms  comp    50.0 mN  velocity           -"


def test_the_companion_needs_no_compiler() -> None:
    code = (
        "import sys, friction_hil.daemon.companion.__main__, friction_hil.daemon.supervisor\n"
        "assert 'numpy' not in sys.modules\n"
        "import friction_hil.daemon.companion.worker\n"
        "assert 'numba' not in sys.modules\n"
        "assert 'scipy' not in sys.modules\n"
    )
    done = subprocess.run([sys.executable, "-P", "-c", code], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")


def test_a_fault_leaves_a_file_with_the_minute_before_also_after_a_worker_died(job: Job, tmp_path: Path) -> None:
    companion = Companion.start(replace(job, path=None, black_box=str(tmp_path / "axes.mcap")))
    push(companion, 0, 3000)
    while companion.free_slots() < 8000:
        os.sched_yield()
    os.kill(companion.worker_pid, signal.SIGKILL)
    assert "died (signal SIGKILL)" in str(companion.next_message())
    assert companion.next_message() == {"opened": None, "pid": companion.worker_pid}
    companion.push_event(2999, "fault", "x: following error [FH-109]")
    push(companion, 3000, 3500)
    report = companion.close()
    assert (report.recording, report.rows, report.lost) == ((), 3500, 0)
    (path,) = report.black_boxes
    assert [path] == [str(each) for each in tmp_path.iterdir()]
    assert cycles((path,)) == list(range(3500))
    assert [event.name for event in fh.recordings.read(path, "y").events] == ["fault"]


def test_a_run_without_a_fault_leaves_no_file_of_one(job: Job, tmp_path: Path) -> None:
    with Companion.start(replace(job, black_box=str(tmp_path / "axes.mcap"), rotate_s=1.0)) as companion:
        push(companion, 0, 2500)
        companion.push_event(2499, "warning", "periods are missed")
        report = companion.close()
    assert report.black_boxes == ()
    assert [Path(each).name for each in report.recording] == ["run.mcap", "run-2.mcap", "run-3.mcap"]
    assert {each.name for each in tmp_path.iterdir()} == {Path(each).name for each in report.recording}


def test_room_is_made_for_the_file_of_a_fault(job: Job, tmp_path: Path) -> None:
    """The last thing of a run is the minute before a fault: nobody begins a file after it that would make room."""
    budget = 1_800_000
    job = replace(job, rotate_s=1.0, budget_bytes=budget, black_box=str(tmp_path / "run.mcap"))
    with Companion.start(job) as companion:
        push(companion, 0, 20_000)
        companion.push_event(19_999, "fault", "x: following error")
        report = companion.close()
    sizes = {each.name: each.stat().st_size for each in tmp_path.iterdir()}
    (black_box,) = report.black_boxes
    assert cycles((black_box,)) == list(range(20_000))
    assert sizes[Path(black_box).name] > budget / 3
    assert sum(sizes.values()) < budget + 80_000  # chunks that were not complete yet
    assert 2 < len(sizes) < 21
    assert {Path(each).name for each in (*report.recording, black_box)} == sizes.keys()


def test_a_killed_companion_and_its_successor_number_their_files_on(job: Job, tmp_path: Path) -> None:
    job = replace(job, rotate_s=1.0, budget_bytes=10_000_000, black_box=str(tmp_path / "axes.mcap"))
    with Companion.start(job) as companion:
        push(companion, 0, 2500)
        while companion.free_slots() < 8000 - 500:
            os.sched_yield()
        os.kill(companion.worker_pid, signal.SIGKILL)
        tend(companion)
        push(companion, 2500, 4600)
        report = companion.close()
    assert (report.rows, report.lost) == (4600, 0)
    numbers = [int(Path(path).stem.partition("-")[2] or 1) for path in report.recording]
    assert numbers == sorted(set(numbers))  # one that was killed while it began a file leaves its number out
    assert len(numbers) >= 4
    whole = fh.recordings.read(job.path or "", "x")
    np.testing.assert_array_equal(whole["cycle"], np.arange(4600))
    assert all(state.tolist() == [1, -1] for _, state in whole.restarts)
