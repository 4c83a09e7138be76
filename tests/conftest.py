"""What all tests need before they start."""

import contextlib
import gc
import importlib
import os
import signal
import sys
import tempfile

import pytest
from hypothesis import HealthCheck, settings

from tests.examples import EXAMPLES, PROFILES

# As the program does: threads of several workers wait for each other by spinning. Read when numpy is imported.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# A shell that runs the tests in the background has them ignore Ctrl-C, and with them every process they start.
signal.signal(signal.SIGINT, signal.default_int_handler)

# Runs that end in a fault leave a file there.
_STATE = tempfile.TemporaryDirectory(prefix="friction_hil-state-")
os.environ["XDG_STATE_HOME"] = _STATE.name
# Daemons of one name exclude each other; those of parallel workers are to be strangers. A short path: it names sockets.
_runtime = tempfile.TemporaryDirectory(prefix="fh")
os.environ["XDG_RUNTIME_DIR"] = _runtime.name


def _refuse_locked_memory(event: str, arguments: tuple[object, ...]) -> None:
    """Fail a test that would lock the memory of the tests themselves: the kernel would then load all they map."""
    if event == "ctypes.dlsym" and arguments[1] == "mlockall":
        raise AssertionError("this locks the memory of pytest, 1.6 GB: do it in a process of its own")


sys.addaudithook(_refuse_locked_memory)

# A busy machine and the first call of a kernel, which compiles it, are no failures.
for name in PROFILES:
    settings.register_profile(name, deadline=None, max_examples=EXAMPLES, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("short")


def pytest_sessionstart(session: pytest.Session) -> None:
    """Before several workers start, compile what many of them need."""
    if workers := getattr(session.config.option, "numprocesses", None):
        from tests.kernels import compile_kernels

        compile_kernels(workers)


@pytest.hookimpl(tryfirst=True)
def pytest_collection(session: pytest.Session) -> None:
    """Rewrite the assertions of a fresh checkout once: each worker begins with its part, then finds the others' files.

    Otherwise all workers rewrite them all at the same time; that takes most of a fresh checkout's collection.
    """
    if (worker := getattr(session.config, "workerinput", None)) is None or sys.dont_write_bytecode:
        return
    root = session.config.rootpath
    paths = sorted(path for each in session.config.args for path in (root / each).rglob("test_*.py"))
    for path in paths[int(worker["workerid"].removeprefix("gw")) :: worker["workercount"]]:
        with contextlib.suppress(Exception, pytest.skip.Exception):  # collection reports it
            importlib.import_module(".".join(path.relative_to(root).with_suffix("").parts))


def pytest_collection_finish() -> None:
    """Spare the garbage collector what was imported: some hundred thousand objects that stay until the end."""
    gc.collect()
    gc.freeze()
