"""One process for the mutants of one module: it imports product and tests once, and forks for each mutant.

The mutated code takes the place of a function's code, in memory alone: no file is written. Only the tests run that call
the function, which the first run, without a change, has found out. That run is in this process: kernels are compiled
once, and not once more in each fork.
"""

import contextlib
import gc
import importlib
import json
import math
import os
import resource
import select
import signal
import sys
import threading
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from types import CodeType, FrameType, FunctionType
from typing import Any

import pytest
from _pytest.main import pytest_runtestloop as run_items

from tools.mutation.changes import Change, changes_of, codes_of
from tools.mutation.modules import name_of

_LEAST_S, _FACTOR = 20.0, 6.0  # a mutant's processor time: at least, and times that of its tests without a change
_WAITING = 6.0  # times that passes at most: other programs may have the processors


class _Worker:
    """Plugin of pytest that takes the place of its loop over the tests."""

    def __init__(self, path: str, requests: int, replies: int) -> None:
        self._path, self._file = path, str(Path(path).resolve())
        self._source = Path(path).read_text()
        self._changes = changes_of(self._source)
        self._requests, self._replies = os.fdopen(requests), os.fdopen(replies, "w")
        self._callers: dict[str, set[str]] = {}  # function as "name line": tests that call it
        self._times: dict[str, float] = {}
        self._functions: list[FunctionType] = []

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtestloop(self, session: pytest.Session) -> bool:
        gc.unfreeze()  # what is frozen is not found
        importlib.import_module(name_of(self._path))
        began_s = time.monotonic()
        is_passed = self._first_run(session)
        self._reply(
            status="passed" if is_passed else "failed", tests=len(session.items), seconds=time.monotonic() - began_s
        )
        self._functions = [each for each in gc.get_objects() if self._is_own(each)]
        gc.freeze()  # a fork that collects what was there before would copy it
        items = list(session.items)
        for line in self._requests:
            number = int(line)
            change, began_s = self._changes[number], time.monotonic()
            names = self._tests(change)
            session.items = [each for each in items if each.nodeid in names]
            limit_s = max(_LEAST_S, _FACTOR * sum(self._times.get(name, 0.0) for name in names))
            status = "not called"
            if session.items:
                status = _forked(partial(self._try, session, number, change), limit_s)
            self._reply(status=status, tests=len(session.items), seconds=time.monotonic() - began_s)
        return True

    def _is_own(self, found: object) -> bool:
        return isinstance(found, FunctionType) and found.__code__.co_filename == self._file

    def _reply(self, **values: Any) -> None:
        self._replies.write(json.dumps(values) + "\n")
        self._replies.flush()

    def _tests(self, change: Change) -> set[str]:
        """Return the tests that call a function, or of a constant all that call the module."""
        if change.function is None:
            return {name for names in self._callers.values() for name in names}
        return set(self._callers.get(f"{change.function[0]} {change.function[1]}", ()))

    def _try(self, session: pytest.Session, number: int, change: Change) -> bool:
        _apply(change, codes_of(self._source, number, self._file), self._functions, name_of(self._path))
        return _passes(session)

    def _first_run(self, session: pytest.Session) -> bool:
        """Run all tests without a change, and note which of them call what, and how long they take."""
        callers, times = self._callers, self._times
        by_file: dict[str, set[str]] = {}
        for item in session.items:
            by_file.setdefault(item.nodeid.partition("::")[0], set()).add(item.nodeid)
        owners = _owners(self._changes)
        present: set[str] = set()

        def note(frame: FrameType, event: str, _: Any) -> None:
            if event == "call" and frame.f_code.co_filename == self._file:
                code = frame.f_code
                callers.setdefault(owners.get(code.co_firstlineno, ""), set()).update(present)

        class Watch:
            @pytest.hookimpl(wrapper=True)
            def pytest_runtest_protocol(self, item: pytest.Item) -> Any:
                began_s = time.process_time()
                present.clear()
                present.add(item.nodeid)
                try:
                    return (yield)
                finally:
                    times[item.nodeid] = time.process_time() - began_s

            @pytest.hookimpl(wrapper=True)
            def pytest_fixture_setup(self, fixturedef: Any, request: Any) -> Any:
                before = set(present)
                if fixturedef.scope != "function":  # for whoever comes first, and all others of its file
                    present.update(by_file[request.node.nodeid.partition("::")[0]] if request.node.nodeid else ())
                try:
                    return (yield)
                finally:
                    present.clear()
                    present.update(before)

        watch = Watch()
        session.config.pluginmanager.register(watch)
        threading.setprofile(note)
        sys.setprofile(note)
        is_passed = _passes(session)
        sys.setprofile(None)
        threading.setprofile(None)
        session.config.pluginmanager.unregister(watch)
        return is_passed


def _owners(changes: list[Change]) -> dict[int, str]:
    """Return for each first line of a function the outermost one, as "name line"."""
    return {change.function[1]: f"{change.function[0]} {change.function[1]}" for change in changes if change.function}


def _passes(session: pytest.Session) -> bool:
    try:
        run_items(session)
    except (session.Failed, session.Interrupted):
        return False
    return not session.testsfailed


def _apply(change: Change, codes: list[CodeType], functions: list[FunctionType], module: str) -> None:
    """Put the changed code in the place of that of the function, or the changed value in that of the constant."""
    if change.function is not None:
        new = next(each for each in codes if (each.co_name, each.co_firstlineno) == change.function)
        for found in functions:
            if (found.__code__.co_name, found.__code__.co_firstlineno) == change.function:
                found.__code__ = new
        return
    own = vars(sys.modules[module])
    before, scratch = own[change.where], dict(own)
    exec(change.after, scratch)  # an assignment of the module itself
    for loaded in list(sys.modules.values()):
        values = getattr(loaded, "__dict__", {})
        if isinstance(values, dict) and values.get(change.where) is before:
            values[change.where] = scratch[change.where]


def _forked(work: Callable[[], bool], limit_s: float) -> str:
    """Do something in a process of its own: ``passed``, ``failed``, or after so much processor time ``timeout``."""
    pid = os.fork()
    if pid == 0:
        status = 2
        try:
            os.setpgid(0, 0)
            resource.setrlimit(resource.RLIMIT_CPU, (math.ceil(limit_s), resource.RLIM_INFINITY))
            status = 0 if work() else 1
        finally:
            os._exit(status)
    ended = os.pidfd_open(pid)
    is_late = not select.select([ended], [], [], _WAITING * limit_s)[0]
    os.close(ended)
    if is_late:
        os.kill(pid, signal.SIGKILL)
    _, status = os.waitpid(pid, 0)
    with contextlib.suppress(ProcessLookupError, PermissionError):
        os.killpg(pid, signal.SIGKILL)  # what it has started
    if is_late or (os.WIFSIGNALED(status) and os.WTERMSIG(status) == signal.SIGXCPU):
        return "timeout"
    return "passed" if status == 0 else "failed"


def main(path: str, tests: list[str]) -> None:
    """Serve the mutants of a module: first comes the answer of a run without a change; a number asks for a mutant."""
    requests, replies = os.dup(0), os.dup(1)
    silence = os.open(os.devnull, os.O_RDWR)
    for descriptor in (0, 1, 2):
        os.dup2(silence, descriptor)
    options = ["-x", "-q", "-p", "no:cacheprovider", "-p", "no:faulthandler", "-n", "0", "--hypothesis-seed=0"]
    pytest.main([*options, *tests], plugins=[_Worker(path, requests, replies)])


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2:])
