"""Tasks on the workers of an existing Dask cluster.

If a worker dies, Dask runs its tasks again on another one.
"""

import asyncio
import importlib
import logging
import pickle
from collections.abc import Callable, Iterator, Sequence
from typing import Any, TypeVar

from friction_hil import __version__
from friction_hil.errors import FrictionHilError, UsageError

Task = TypeVar("Task")
Result = TypeVar("Result")

PATIENCE_S = 10.0
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
            for index, future in _futures(distributed, client, function, tasks, address, on_note):
                yield index, _result(distributed, future, tasks[index], address, died)
    except (distributed.CancelledError, distributed.comm.CommClosedError):
        raise FrictionHilError(
            f"the connection to the scheduler at {address} was lost, or the tasks were cancelled"
        ) from None


def _futures(
    distributed: Any,
    client: Any,
    function: Callable[[Task], Result],
    tasks: Sequence[Task],
    address: str,
    on_note: Callable[[str], None],
) -> Iterator[tuple[int, Any]]:
    requests = [pickle.dumps((function, task)) for task in tasks]
    # not pure: a file may have changed since Dask last read one of this name
    futures = client.map(_request_runner(__version__), requests, pure=False, retries=RETRIES)
    indices = {future: index for index, future in enumerate(futures)}
    del futures  # the worker frees a result once no future refers to it
    try:
        if not _has_worker(client):
            on_note(f"no worker yet at {address}; waiting for one (dask worker {address})")
        for future in distributed.as_completed(list(indices), loop=client.loop):
            yield indices.pop(future), future
    finally:
        if indices and client.status == "running":
            client.cancel(list(indices))


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
    """Run one pickled task in a worker; return its result, pickled."""
    function, task = pickle.loads(request)
    return pickle.dumps(function(task))


def _result(
    distributed: Any, future: Any, task: Task, address: str, died: Callable[[Task, FrictionHilError], Result]
) -> Result:
    try:
        version, content = future.result()
    except distributed.KilledWorker as error:
        return died(
            task, FrictionHilError(f"workers died while they computed it, the last of them {error.last_worker.address}")
        )
    if version != __version__:
        raise UsageError(
            f"a worker of {address} has {f'friction-hil {version}' if version else 'no friction-hil'}, here is "
            f"{__version__}: results could differ; install the same version on both sides"
        )
    found: Result = pickle.loads(content)
    return found
