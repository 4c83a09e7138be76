"""The processes beside the loop: real processes that are killed, and what is started again."""

import json
import os
import select
import signal
from collections.abc import Iterator
from pathlib import Path

import pytest

from friction_hil.daemon.companion import Companion, Job
from friction_hil.daemon.lives import Lives, make_lives
from friction_hil.daemon.supervisor import Beside

SAY = "import os, sys; os.write(int(sys.argv[1]), b'%d\\n' % os.getpid())"
WAIT = f"{SAY}; os.read(0, 1)"
STATUS = f"{SAY}; sys.exit(int(sys.argv[2]))"
LIST = (
    "import os, sys, json\n"
    "there = [name for name in os.listdir('/proc/self/fd') if os.path.lexists(f'/proc/self/fd/{name}')]\n"
    "found = {name: os.readlink(f'/proc/self/fd/{name}') for name in there if int(name) > 2}\n"
    "os.write(int(sys.argv[1]), json.dumps([found, os.sched_getscheduler(0), os.getpgid(0)]).encode() + b'\\n')\n"
    "os.read(0, 1)"
)
DIED = "the process died (signal SIGKILL); the next one takes over, and the loop goes on"


class Run:
    """A companion without a recording, and one process more, which says its number through a pipe."""

    def __init__(self, code: str, *words: str, is_heir: bool = False) -> None:
        self.told, self.saying = os.pipe()
        arguments = ["-c", code, str(self.saying), *words]
        one = Beside("the process", "nothing happens any more", arguments, [self.saying], "notice", is_heir=is_heir)
        job = Job(["x"], ["time_s", "cycle"], 0, 1e-3, 0)
        self.companion = Companion.start(job, others=[one])

    def line(self) -> str:
        """What the process says next."""
        line = b""
        while not line.endswith(b"\n"):
            assert select.select([self.told], [], [], 60.0)[0]
            line += os.read(self.told, 1)
        return line.decode()

    def pid(self) -> int:
        """Number of the process that says it next."""
        return int(self.line())

    def events(self, count: int = 1) -> list[tuple[str, str]]:
        """The next events of the run."""
        found: list[tuple[str, str]] = []
        while len(found) < count:
            found += self.companion.tend()
            os.sched_yield()
        return found

    def kill_supervisor(self) -> None:
        """Kill the supervisor, and wait until the next one has said that it is there."""
        before = self.companion.supervisor_pid
        os.kill(before, signal.SIGKILL)
        ((name, text),) = self.events()
        assert (name, self.companion.supervisor_pid != before) == ("warning", True)
        assert "the supervisor died; the next one takes over" in text

    def close(self) -> None:
        """End the run; nothing is left of it."""
        group = os.getpgid(self.companion.process.pid)
        self.companion.close()
        while members(group):  # one closes its end of the pipe a moment before it is gone
            os.sched_yield()
        for each in (self.told, self.saying):
            os.close(each)


def members(group: int) -> list[str]:
    """Living processes of a process group."""
    found = []
    for file in Path("/proc").glob("[0-9]*/stat"):
        try:
            state, _, its_group = file.read_text().rpartition(")")[2].split()[:3]
        except OSError:
            continue
        found += [file.parent.name] if state not in "ZX" and int(its_group) == group else []
    return found


@pytest.fixture
def waiting() -> Iterator[Run]:
    run = Run(WAIT)
    yield run
    run.close()


def test_a_process_gets_what_it_was_given_and_nothing_else() -> None:
    run = Run(LIST)
    found, policy, group = json.loads(run.line())
    lives = [name for name, where in found.items() if "friction_hil-lives" in where]
    assert found.keys() == {*lives, str(run.saying)}  # with the lock that says that it lives
    assert len(lives) == 1
    assert policy == os.SCHED_OTHER
    assert group == run.companion.process.pid != os.getpgid(0)  # Ctrl-C is not meant for it
    run.close()


def test_a_killed_process_is_told_and_started_again(waiting: Run) -> None:
    os.kill(waiting.pid(), signal.SIGKILL)
    assert waiting.events() == [("notice", DIED)]
    assert waiting.pid()


@pytest.mark.parametrize(("status", "starts", "why"), [(2, 1, "says why"), (3, 3, "3 times at once")])
def test_what_cannot_run_is_given_up(status: int, starts: int, why: str) -> None:
    run = Run(STATUS, str(status))
    events = run.events(starts)
    assert len({run.pid() for _ in range(starts)}) == starts
    assert why in events[-1][1]
    assert "nothing happens any more" in events[-1][1]
    assert run.companion.over == {"the process"}
    run.kill_supervisor()  # the next one knows it
    assert not select.select([run.told], [], [], 0.0)[0]
    run.close()


def test_processes_outlive_the_supervisor_and_the_next_one_looks_after_them(waiting: Run) -> None:
    first = waiting.pid()
    for _ in range(2):
        waiting.kill_supervisor()
    os.kill(first, signal.SIGKILL)
    assert waiting.events() == [("notice", DIED.replace(" (signal SIGKILL)", ""))]
    os.kill(waiting.pid(), signal.SIGKILL)  # one of its own
    assert waiting.events() == [("notice", DIED)]
    assert waiting.pid()


def test_supervisor_and_process_are_killed_at_once(waiting: Run) -> None:
    first, supervisor = waiting.pid(), waiting.companion.supervisor_pid
    os.kill(supervisor, signal.SIGSTOP)
    for pid in (first, supervisor):
        os.kill(pid, signal.SIGKILL)
    events = waiting.events(2)
    assert [name for name, _ in events] == ["warning", "notice"]
    assert waiting.pid() != first


def test_a_supervisor_that_was_killed_before_it_knew_its_child_leaves_one_process(waiting: Run) -> None:
    """Two supervisors, one after the other, may each start a process: the lock leaves one."""
    first = waiting.pid()
    for _ in range(3):
        waiting.kill_supervisor()
    assert not select.select([waiting.told], [], [], 0.0)[0]
    assert Path(f"/proc/{first}").exists()


def test_an_heir_looks_after_the_supervisor_when_the_companion_is_killed_with_it() -> None:
    heir = "import sys; from friction_hil.daemon.supervisor import Heir; import time, select, os\n"
    heir += f"{SAY}\nheir, end = Heir(int(sys.argv[2])), select.poll(); end.register(0, 0)\n"
    heir += "while not end.poll(10): heir.look()\n"
    run = Run(heir, is_heir=True)
    run.pid()
    for number in (signal.SIGSTOP, signal.SIGKILL):
        for pid in (run.companion.supervisor_pid, run.companion.worker_pid):
            os.kill(pid, number)
    texts = [text for _, text in run.events(2)]
    assert "supervisor died" in texts[0]
    assert "the companion process died" in texts[1]
    run.close()


def test_a_process_that_does_not_end_is_killed_at_the_end() -> None:
    run = Run(f"{SAY}; import time; time.sleep(600)")
    pids = [run.pid(), run.companion.supervisor_pid]
    for pid in pids:
        os.kill(pid, signal.SIGSTOP)
    run.close()
    assert not [pid for pid in pids if os.path.exists(f"/proc/{pid}")]


def test_a_byte_of_the_lives_is_locked_by_one_process() -> None:
    lives = Lives(make_lives(2))
    reading, writing = os.pipe()
    assert lives.holder(1) == 0
    if not (pid := os.fork()):
        os.close(writing)
        os._exit(0 if lives.take(1) and os.read(reading, 1) == b"" else 1)
    while not (holder := lives.holder(1)):
        os.sched_yield()
    assert (holder, lives.take(1), lives.take(0)) == (pid, False, True)
    os.close(writing)
    assert os.waitpid(pid, 0)[1] == 0
    assert lives.holder(1) == 0
    for each in (lives.descriptor, reading):
        os.close(each)
