"""Tasks in processes, one for each core."""

import contextlib
import multiprocessing
import os
import signal
import sys
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from typing import Any, TypeVar

from friction_hil.errors import FrictionHilError
from friction_hil.parallel.cluster import run_on_cluster

Task = TypeVar("Task")
Result = TypeVar("Result")


def processors() -> int:
    """Return the number of processors that this process may use; where the system does not say that, of all."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def run_many(
    function: Callable[[Task], Result],  # of a module, so that other processes can import it
    tasks: Sequence[Task],
    *,
    died: Callable[[Task, FrictionHilError], Result],  # result of a task at which workers of a cluster died
    scheduler: str | None = None,  # address of a Dask scheduler, `tcp://host:port`
    is_large: bool = True,  # False: the tasks take less time than starting a pool of processes
    on_note: Callable[[str], None] = lambda _: None,  # called with a sentence if the tasks have to wait for workers
) -> Iterator[tuple[int, Result]]:
    """Run a function on tasks, on a cluster or on all cores; yield index and result of each as soon as it is done.

    Raises `FrictionHilError`: a process of this machine died, or the cluster cannot run the tasks; see
    `run_on_cluster`.
    """
    if scheduler is not None:
        yield from run_on_cluster(function, tasks, scheduler, died=died, on_note=on_note)
    elif is_large and min(len(tasks), processors()) > 1:
        yield from _in_pool(function, tasks)
    else:
        yield from enumerate(map(function, tasks))


@contextlib.contextmanager
def _without_main() -> Iterator[None]:
    """Start processes that do not import the main script: it may have no ``if __name__ == "__main__"``."""
    main = sys.modules["__main__"]
    hidden: dict[str, Any] = {name: vars(main).pop(name) for name in ("__file__", "__spec__") if name in vars(main)}
    try:
        main.__spec__ = None
        yield
    finally:
        vars(main).update(hidden)


def _in_pool(function: Callable[[Task], Result], tasks: Sequence[Task]) -> Iterator[tuple[int, Result]]:
    # not fork: numerical libraries may have started threads, whose locks a forked process would copy
    methods = multiprocessing.get_all_start_methods()
    context = multiprocessing.get_context("forkserver" if "forkserver" in methods else "spawn")  # Windows has no fork
    context.set_forkserver_preload([function.__module__])
    workers = min(len(tasks), processors())
    # Ctrl-C ends the workers without a word: this process says what is to be said
    with ProcessPoolExecutor(workers, context, signal.signal, (signal.SIGINT, signal.SIG_DFL)) as pool:
        with _without_main():  # all processes start here
            indices = {pool.submit(function, task): index for index, task in enumerate(tasks)}
        try:
            for future in as_completed(indices):
                yield indices[future], future.result()
        except BrokenProcessPool:
            left = sum(not future.done() or future.exception() is not None for future in indices)
            raise FrictionHilError(
                f"a worker process died, perhaps because memory ran out; {left} of {len(tasks)} recordings are not done"
            ) from None
        finally:
            for future in indices:
                future.cancel()
