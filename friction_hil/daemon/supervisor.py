"""The supervisor: one small process that starts all others beside the loop, and starts them again by one rule.

``python -m friction_hil.daemon.supervisor PLAN`` runs at ordinary priority and is started before the loop, which never
forks. Its plan, in memory without a name, says what runs. Standard input is one pipe for all processes, whose hang-up
means that the control process is gone, or has done its work. Standard output carries lines of JSON to that process
(`friction_hil.daemon.companion.job`).

What it starts outlives it. Its *heirs*, which have all its descriptors, start another one when it has died; that one
goes on with the processes that live (`friction_hil.daemon.lives`). They ignore the signals of a terminal, as it does:
the control process decides when a run is over.
"""

import contextlib
import os
import select
import signal
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from friction_hil.daemon.companion.job import say, signal_text, warn
from friction_hil.daemon.lives import MOST_SHORT_LIVES, Lives
from friction_hil.daemon.shared_document import read_document

SUPERVISOR, COMPANION = 0, 1  # places of lives; the process that records is the first of the plan
WRONG_USE = 2  # exit status: another start would fail in the same way
_CANNOT_START = 127
_INPUT, _OUTPUT, _ERRORS = 0, 1, 2
_PATIENCE_S = 2.0  # at the end, for all but the companion
_AGAIN_S = 1.0  # between two starts of a supervisor by an heir
ENVIRONMENT = {  # of all processes beside the loop
    "OPENBLAS_NUM_THREADS": "1",
    # glibc raises this threshold with each large block that is freed; later blocks of that size then leave gaps in the
    # heap, which grows for hours
    "MALLOC_MMAP_THRESHOLD_": "131072",
}


@dataclass(frozen=True, slots=True)
class Beside:
    """A process beside the loop."""

    title: str  # what reports call it
    loss: str  # what reports say is missing when it is not started any more
    words: list[str]  # arguments of the Python interpreter
    descriptors: list[int]  # that it inherits
    severity: str = "warning"  # or notice: of the event that reports its death
    is_heir: bool = False  # it inherits those of the other processes too, and looks after the supervisor
    niceness: int = 0
    oom_score: int | None = None  # above 0: the kernel ends it before the daemon when memory is short


def command(plan: int) -> list[str]:
    """Return the command of a supervisor; ``plan`` is a document with ``processes``, ``lives``, ``descriptors``."""
    # -P: do not import modules from the current directory, which may be the user's
    return [sys.executable, "-P", "-m", "friction_hil.daemon.supervisor", str(plan)]


class Heir:
    """What starts another supervisor; for a process that has all descriptors, and asks now and then."""

    def __init__(self, plan: int) -> None:
        self._plan, self._content = plan, read_document(plan)
        self.lives = Lives(self._content["lives"])
        self._again_s = 0.0
        signal.signal(signal.SIGCHLD, signal.SIG_IGN)  # nobody waits for a supervisor

    def look(self) -> None:
        """Start another supervisor if there is none."""
        if self.lives.holder(0) or time.monotonic() < self._again_s:
            return
        import subprocess  # imported here: most runs do not need it

        self._again_s = time.monotonic() + _AGAIN_S
        try:
            subprocess.Popen(command(self._plan), pass_fds=(self._plan, *self._content["descriptors"]))
        except OSError as error:
            warn(f"the supervisor died, and another one cannot be started ({error.strerror}): it is tried again")


class _Supervisor:
    """The processes of a plan, as far as they live."""

    def __init__(self, plan: int, content: dict[str, Any], lives: Lives) -> None:
        self._plan, self._lives, self._descriptors = plan, lives, content["descriptors"]
        self._processes = {place: Beside(**each) for place, each in enumerate(content["processes"], COMPANION)}
        self._watched: dict[int, tuple[int, int]] = {}  # place and number of each process, by its descriptor
        self._is_ending = False
        self._poll = select.poll()
        self._poll.register(_INPUT, 0)  # no event but the hang-up, which is always reported
        for place in self._processes:
            self._take_over(place)

    def serve(self) -> None:
        """Look after the processes until the control process is gone, and they are."""
        while not self._is_ending:
            self._wait(None)
        end_s = time.monotonic() + _PATIENCE_S
        while self._watched and (left_s := end_s - time.monotonic()) > 0.0:
            self._wait(1e3 * left_s)
        for descriptor, (place, _) in self._watched.items():
            if place != COMPANION:
                signal.pidfd_send_signal(descriptor, signal.SIGKILL)
        while self._watched:
            self._wait(None)

    def _wait(self, timeout_ms: float | None) -> None:
        """Wait until a process or the run ends, and deal with it."""
        for ready, _ in self._poll.poll(timeout_ms):
            self._poll.unregister(ready)
            if ready == _INPUT:
                self._is_ending = True
                continue
            place, pid = self._watched.pop(ready)
            os.close(ready)
            status = None  # of one that an earlier supervisor has started
            with contextlib.suppress(ChildProcessError):
                status = os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
            if self._lives.holder(place):  # the one that was to be started was there already
                self._take_over(place)
            else:
                self._deal_with_end(place, status)

    def _take_over(self, place: int) -> None:
        """Watch a process that lives, or start one."""
        if pid := self._lives.holder(place):
            try:
                self._watch(place, pid)
            except ProcessLookupError:  # it has just ended
                self._deal_with_end(place, None)
        elif self._lives.starts(place):
            self._deal_with_end(place, None)
        else:
            self._start(place)

    def _deal_with_end(self, place: int, status: int | None) -> None:
        """Start a process again, unless its work is done, or it has died too often."""
        if self._lives.is_over(place) or (self._is_ending and place != COMPANION):
            return
        process = self._processes[place]
        how = "" if status is None else f" ({signal_text(-status) if status < 0 else f'exit status {status}'})"
        died = f"{process.title} died{how}"
        if (is_too_often := self._lives.die(place)) or status == WRONG_USE:
            why = f", {MOST_SHORT_LIVES} times at once" if is_too_often else "; what it printed says why"
            self._give_up(place, f"{died}{why}")
            return
        self._tell(place, f"{died}; the next one takes over, and the loop goes on")
        self._start(place)

    def _start(self, place: int) -> None:
        self._lives.begin(place)
        try:
            if not (pid := os.fork()):
                self._become(place)
            self._watch(place, pid)
        except OSError as error:
            self._give_up(place, f"{self._processes[place].title} cannot be started ({error.strerror})")

    def _become(self, place: int) -> None:
        """Become a process of the plan, unless it lives already."""
        process = self._processes[place]
        words = [sys.executable, "-P", *process.words]
        try:
            if not self._lives.take(place):
                os._exit(0)
            if process.is_heir:
                words.append(str(self._plan))
            else:
                os.dup2(_ERRORS, _OUTPUT)  # what it prints is no output of the run
                for each in {self._plan, *self._descriptors} - {self._lives.descriptor, *process.descriptors}:
                    os.set_inheritable(each, False)
            os.nice(process.niceness)
            if process.oom_score is not None:
                with contextlib.suppress(OSError):
                    Path("/proc/self/oom_score_adj").write_text(str(process.oom_score), encoding="ascii")
            os.execv(words[0], words)
        finally:
            os._exit(_CANNOT_START)

    def _watch(self, place: int, pid: int) -> None:
        descriptor = os.pidfd_open(pid)
        self._watched[descriptor] = place, pid
        self._poll.register(descriptor, select.POLLIN)

    def _give_up(self, place: int, why: str) -> None:
        process = self._processes[place]
        self._lives.finish(place)
        self._tell(place, f"{why}: {process.loss}, the loop goes on")
        say(over=process.title)

    def _tell(self, place: int, text: str) -> None:
        if place == COMPANION:
            warn(text)
        else:
            say(severity=self._processes[place].severity, text=text)


def main(plan: int) -> None:
    """Serve a plan until the control process is gone, and all that it started."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)
    content = read_document(plan)
    lives = Lives(content["lives"])
    if not lives.take(SUPERVISOR):  # another heir was quicker
        return
    lives.begin(SUPERVISOR)
    say(supervisor=os.getpid())
    if lives.starts(SUPERVISOR) > 1:
        warn("the supervisor died; the next one takes over, and the loop goes on")
    _Supervisor(plan, content, lives).serve()


if __name__ == "__main__":
    main(int(sys.argv[1]))
