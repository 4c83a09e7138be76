"""The process that starts others for the loop: real processes, whose ends and descriptors are seen."""

import contextlib
import os
import signal
import subprocess
from collections.abc import Iterator

import pytest

from friction_hil.daemon.spawner.client import Spawner, spawn_directly

ECHO = "import os, sys; os.write(1, os.read(0, 100) + os.read(int(sys.argv[1]), 100)); sys.exit(3)"
WAIT = "import os; os.write(1, b'here'); os.read(0, 1)"


@pytest.fixture
def spawner() -> Iterator[Spawner]:
    with contextlib.closing(Spawner()) as started:
        yield started


def test_a_process_has_its_pipes_and_the_descriptors_of_the_one_that_asked(spawner: Spawner) -> None:
    for spawn in (spawner.spawn, spawn_directly):
        reading, writing = os.pipe()
        high = os.dup2(reading, 77)
        os.write(writing, b"inherited")
        process = spawn(["-c", ECHO, str(high)], [high], None)
        assert process.stdin is not None
        assert process.stdout is not None
        process.stdin.write(b"asked, ")
        process.stdin.close()
        assert process.stdout.read() == b"asked, inherited"
        assert process.wait(20.0) == 3
        assert process.poll() == 3
        for each in (reading, writing, high):
            os.close(each)


def test_a_process_gets_nothing_that_it_was_not_given(spawner: Spawner) -> None:
    listing = "import os; print(*os.listdir('/proc/self/fd'))"
    others = [spawner.spawn(["-c", WAIT], [], None) for _ in range(2)]
    process = spawner.spawn(["-c", listing], [], None)
    assert process.stdout is not None
    assert set(process.stdout.read().split()) == {b"0", b"1", b"2", b"3"}  # 3 is that of the listing
    for other in others:
        assert other.stdin is not None
        other.stdin.close()  # no other process holds it open
        assert other.wait(20.0) == 0


def test_a_killed_process_is_seen_and_one_that_ends_by_the_end_of_its_input(spawner: Spawner) -> None:
    process = spawner.spawn(["-c", WAIT], [], None)
    assert process.stdout is not None
    assert process.stdout.read(4) == b"here"
    assert process.poll() is None
    with pytest.raises(subprocess.TimeoutExpired):
        process.wait(0.05)
    assert os.getpgid(process.pid) == process.pid != os.getpgid(0)
    process.send_signal(signal.SIGUSR1)
    assert process.wait(20.0) == -signal.SIGUSR1
    at_once = spawner.spawn(["-c", WAIT], [], subprocess.DEVNULL)
    at_once.kill()
    assert at_once.wait(20.0) == -signal.SIGKILL


def test_without_the_spawner_processes_go_on_and_no_other_is_started(spawner: Spawner) -> None:
    process = spawner.spawn(["-c", WAIT], [], None)
    assert process.stdout is not None
    assert process.stdout.read(4) == b"here"
    assert process.pid
    spawner.process.kill()
    spawner.process.wait()
    assert process.poll() is None
    with pytest.raises(OSError, match="the process that starts others has died"):
        spawner.spawn(["-c", WAIT], [], None)
    assert process.stdin is not None
    process.stdin.close()
    assert process.wait(20.0) < 0  # nobody has seen how


def test_a_control_process_that_is_gone_ends_the_spawner(spawner: Spawner) -> None:
    process = spawner.spawn(["-c", WAIT], [], None)
    assert process.stdout is not None
    assert process.stdout.read(4) == b"here"
    spawner._connection.shutdown(2)
    assert spawner.process.wait(20.0) == 0
    assert process.stdin is not None
    process.stdin.close()
    assert process.stdout.read() == b""
