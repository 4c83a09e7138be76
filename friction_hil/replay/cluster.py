"""Recordings through models on a Dask cluster that is there already: the tasks of `replay_many`, elsewhere.

The workers open the recordings, by the same paths as this process would. Pictures come back as bytes and are
written here. Dask repeats what a worker lost when it died, so that its death costs time and nothing else.
"""

import asyncio
import importlib
import logging
import os
import pickle
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from friction_hil import __version__
from friction_hil.errors import FrictionHilError, UsageError
from friction_hil.replay.task import Outcome, Task, failed, run

PATIENCE_S = 10.0
RETRIES = 2  # of a task that raised: what is wrong with a file is an outcome, so this was memory, a disk, a network


def run_on_cluster(
    tasks: Sequence[Task], address: str, *, on_note: Callable[[str], None] = lambda _: None
) -> Iterator[tuple[int, list[Outcome]]]:
    """Run tasks on the workers of a cluster; give place and outcomes of each as it is done.

    What has not begun is cancelled where the caller stops early. A file at which workers died again and again
    (Dask's ``distributed.scheduler.allowed-failures``) becomes an outcome with an error.

    Parameters
    ----------
    tasks : sequence of Task
        One a file; relative paths start from the current directory of this process, on the workers too.
    address : str
        The scheduler's, ``tcp://host:port``.
    on_note : callable
        Called with a sentence where there is nobody yet to do the work.

    Raises
    ------
    UsageError
        distributed is not installed, the address is none, or a worker has another version of friction_hil or none.
    FrictionHilError
        No scheduler answers, or it has gone.
    """
    distributed = _library()
    for name in ("distributed", "distributed.client"):
        logging.getLogger(name).setLevel(logging.CRITICAL)  # it prints pages where a sentence is said here
    _knock(distributed, address)
    try:
        with distributed.Client(address, timeout=PATIENCE_S, set_as_default=False) as client:
            yield from _run(distributed, client, tasks, address, on_note)
    except (distributed.CancelledError, distributed.comm.CommClosedError):
        raise FrictionHilError(f"the scheduler at {address} has gone, or somebody cancelled the work") from None


def _run(
    distributed: Any, client: Any, tasks: Sequence[Task], address: str, on_note: Callable[[str], None]
) -> Iterator[tuple[int, list[Outcome]]]:
    folder = os.getcwd()
    parcels = [pickle.dumps(replace(task, folder=folder)) for task in tasks]
    # not pure: a file of the same name may have changed since Dask saw it
    futures = client.map(_parcel_opener(__version__), parcels, pure=False, retries=RETRIES)
    places = {future: place for place, future in enumerate(futures)}
    del futures  # a future that nobody holds sets its result free on the worker
    try:
        if not _has_worker(client):
            on_note(f"no worker yet at {address}; waiting for one (dask worker {address})")
        for future in distributed.as_completed(list(places), loop=client.loop):
            place = places.pop(future)
            yield place, _outcomes(distributed, future, tasks[place], address)
    finally:
        if places and client.status == "running":
            client.cancel(list(places))


def _library() -> Any:
    # not a plain import: types that are only partly there help nobody
    try:
        return importlib.import_module("distributed")
    except ImportError:
        raise UsageError('--scheduler needs distributed: pip install "friction-hil[cluster]"') from None


def _knock(distributed: Any, address: str) -> None:
    """See whether a scheduler answers; a client of Dask would wait for ever where something else listens."""

    async def knock() -> None:
        security = distributed.Security().get_connection_args("client")
        opening = distributed.core.connect(address, timeout=PATIENCE_S, **security)
        comm = await asyncio.wait_for(opening, PATIENCE_S)
        await comm.close()

    try:
        asyncio.run(knock())
    except ValueError as error:
        raise UsageError(f"--scheduler {address}: {error}; write tcp://HOST:PORT") from None
    except OSError:
        raise FrictionHilError(
            f"no Dask scheduler answers at {address} within {PATIENCE_S:g} s; `dask scheduler` starts one and tells "
            "its address"
        ) from None


def _has_worker(client: Any) -> bool:
    try:
        client.wait_for_workers(1, timeout=PATIENCE_S)
    except TimeoutError:
        return False
    return True


def _parcel_opener(version: str) -> Callable[[bytes], tuple[str, bytes]]:
    """Make the function that goes to the workers: from a pickled task to their version and a pickled answer."""

    # Dask sends an inner function by value, and bytes as they are: the scheduler needs no friction_hil, and a
    # worker without it, or with another one, can say so.
    def open_parcel(parcel: bytes) -> tuple[str, bytes]:
        try:
            import friction_hil
        except ImportError:
            return "", b""
        if friction_hil.__version__ != version:
            return friction_hil.__version__, b""
        from friction_hil.replay.cluster import answer

        return version, answer(parcel)

    return open_parcel


def answer(parcel: bytes) -> bytes:
    """Run one task in a worker; pickled, the task and what comes of it."""
    task: Task = pickle.loads(parcel)
    if task.picture is None:
        return pickle.dumps((run(task), {}))
    with tempfile.TemporaryDirectory() as folder:
        outcomes = run(replace(task, picture=str(Path(folder) / Path(task.picture).name)))
        return pickle.dumps((outcomes, {path.name: path.read_bytes() for path in Path(folder).iterdir()}))


def _outcomes(distributed: Any, future: Any, task: Task, address: str) -> list[Outcome]:
    try:
        version, content = future.result()
    except distributed.KilledWorker as error:
        death = FrictionHilError(f"{task.source}: workers died at it, the last of them {error.last_worker.address}")
        return [failed(task.source, task.axis, death)]
    if version != __version__:
        raise UsageError(
            f"a worker of {address} has {f'friction-hil {version}' if version else 'no friction-hil'}, here is "
            f"{__version__}: results could differ; install the same version on both sides"
        )
    outcomes, pictures = pickle.loads(content)
    return [_with_picture(outcome, task, pictures) for outcome in outcomes]


def _with_picture(outcome: Outcome, task: Task, pictures: dict[str, bytes]) -> Outcome:
    """Write the picture of an outcome where the task wants it."""
    if outcome.picture is None or task.picture is None:
        return outcome
    path = Path(task.picture).with_name(Path(outcome.picture).name)
    try:
        path.write_bytes(pictures[path.name])
    except OSError as error:
        unwritten = FrictionHilError(f"{path} cannot be written: {error.strerror}")
        return failed(outcome.facts["path"], outcome.facts["axis"], unwritten)
    return replace(outcome, picture=str(path))
