"""Tasks on the workers of an existing Dask cluster.

If a worker dies, Dask runs its tasks again on another one. Scheduling costs some milliseconds a request, more than
short tasks take: a request has several of many tasks, and the worker gives back those that it has no time for.
"""

import asyncio
import importlib
import logging
import pickle
import time
from collections.abc import Callable, Iterator, Sequence
from typing import Any, TypeVar

from friction_hil import __version__
from friction_hil.errors import FrictionHilError, UsageError

Task = TypeVar("Task")
Result = TypeVar("Result")

PATIENCE_S = 10.0
_MOST_TASKS = 32  # of a request
_LEAST_REQUESTS = 64  # so that all workers have some; of fewer tasks, each is a request
_REQUEST_S = 0.25  # after which a worker begins no other task of a request
RETRIES = 2  # of a task that raised: a bad file gives an outcome, so it was memory, a disk or the network


def run_on_cluster(
    function: Callable[[Task], Result],  # of a module of this package
    tasks: Sequence[Task],
    address: str,  # of the scheduler, ``tcp://host:port``
    *,
    # result of a task at which workers died repeatedly (Dask's ``distributed.scheduler.allowed-failures``)
    died: Callable[[Task, FrictionHilError], Result],
    on_note: Callable[[str], None] = lambda _: None,  # called with a sentence if there is no worker yet
) -> Iterator[tuple[int, Result]]:
    """Run a function on tasks by the workers of a cluster; yield index and result of each when it is done.

    Tasks that have not begun are cancelled if the caller stops early.

    Raises `UsageError`: distributed is not installed, the address is not valid, or a worker has another version of
    friction_hil or none; `FrictionHilError`: no scheduler answers, or the connection to it was lost.
    """
    distributed = _library()
    for name in ("distributed", "distributed.client"):
        logging.getLogger(name).setLevel(
            logging.CRITICAL
        )  # it logs pages about errors that are reported here in one sentence
    _check_scheduler(distributed, address)
    try:
        with distributed.Client(address, timeout=PATIENCE_S, set_as_default=False) as client:
            yield from _answers(distributed, client, function, tasks, address, died, on_note)
    except (distributed.CancelledError, distributed.comm.CommClosedError):
        raise FrictionHilError(
            f"the connection to the scheduler at {address} was lost, or the tasks were cancelled"
        ) from None


def _answers(
    distributed: Any,
    client: Any,
    function: Callable[[Task], Result],
    tasks: Sequence[Task],
    address: str,
    died: Callable[[Task, FrictionHilError], Result],
    on_note: Callable[[str], None],
) -> Iterator[tuple[int, Result]]:
    runner = _request_runner(__version__)

    def submit(indices: Sequence[int], size: int) -> dict[Any, Sequence[int]]:
        pieces = [indices[first : first + size] for first in range(0, len(indices), size)]
        requests = [pickle.dumps((function, [tasks[index] for index in piece])) for piece in pieces]
        # not pure: a file may have changed since Dask last read one of this name
        return dict(zip(client.map(runner, requests, pure=False, retries=RETRIES), pieces, strict=True))

    # the worker frees a result once no future refers to it
    waiting = submit(range(len(tasks)), max(1, min(_MOST_TASKS, len(tasks) // _LEAST_REQUESTS)))
    try:
        if not _has_worker(client):
            on_note(f"no worker yet at {address}; waiting for one (dask worker {address})")
        completed = distributed.as_completed(list(waiting), loop=client.loop)
        for future in completed:
            piece, size = waiting.pop(future), 1
            try:
                found = _results(future, address)
                size = max(1, len(found))
            except distributed.KilledWorker as error:
                found = []
                if len(piece) == 1:
                    text = f"workers died while they computed it, the last of them {error.last_worker.address}"
                    found = [died(tasks[piece[0]], FrictionHilError(text))]
            left = submit(piece[len(found) :], size)
            waiting |= left
            completed.update(list(left))
            del future
            yield from zip(piece, found, strict=False)
    finally:
        if waiting and client.status == "running":
            client.cancel(list(waiting))


def _library() -> Any:
    # imported here and by name: an optional package, whose partial type hints would mislead mypy
    try:
        return importlib.import_module("distributed")
    except ImportError:
        raise UsageError('--scheduler needs distributed: pip install "friction-hil[cluster]"') from None


def _check_scheduler(distributed: Any, address: str) -> None:
    """Refuse an address where no scheduler answers; Dask's client would wait there for ever."""

    async def connect() -> None:
        security = distributed.Security().get_connection_args("client")
        opening = distributed.core.connect(address, timeout=PATIENCE_S, **security)
        comm = await asyncio.wait_for(opening, PATIENCE_S)
        await comm.close()

    try:
        asyncio.run(connect())
    except ValueError as error:
        raise UsageError(f"--scheduler {address}: {error}; write tcp://HOST:PORT") from None
    except OSError:
        raise FrictionHilError(
            f"no Dask scheduler answers at {address} within {PATIENCE_S:g} s; `dask scheduler` starts one and prints "
            "its address"
        ) from None


def _has_worker(client: Any) -> bool:
    try:
        client.wait_for_workers(1, timeout=PATIENCE_S)
    except TimeoutError:
        return False
    return True


def _request_runner(version: str) -> Callable[[bytes], tuple[str, bytes]]:
    """Return the function that the workers run: from a pickled task to their version and a pickled answer."""

    # Dask sends an inner function by value, and bytes unchanged: the scheduler needs no friction_hil, and a worker
    # without it, or with another version, can report that.
    def run_request(request: bytes) -> tuple[str, bytes]:
        try:
            import friction_hil  # imported here: the function runs in a worker
        except ImportError:
            return "", b""
        if friction_hil.__version__ != version:
            return friction_hil.__version__, b""
        from friction_hil.parallel.cluster import answer  # imported here: the function runs in a worker

        return version, answer(request)

    return run_request


def answer(request: bytes) -> bytes:
    """Run the tasks of a request in a worker, at least one and others while there is time; return results, pickled."""
    function, tasks = pickle.loads(request)
    results, end_s = [], time.monotonic() + _REQUEST_S
    for task in tasks:
        results.append(function(task))
        if time.monotonic() > end_s:
            break
    return pickle.dumps(results)


def _results(future: Any, address: str) -> list[Any]:
    version, content = future.result()
    if version != __version__:
        raise UsageError(
            f"a worker of {address} has {f'friction-hil {version}' if version else 'no friction-hil'}, here is "
            f"{__version__}: results could differ; install the same version on both sides"
        )
    found: list[Any] = pickle.loads(content)
    return found
