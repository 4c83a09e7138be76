"""Replay of many recordings: one task per file, on all cores or on a cluster."""

import multiprocessing
import os
import signal
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool

from friction_hil.errors import FrictionHilError
from friction_hil.replay.cluster import run_on_cluster
from friction_hil.replay.task import ReplayOutcome, ReplayTask, run

_MANY, _LARGE = 16, 16 << 20  # files, bytes: fewer take less time than starting a pool of processes


def replay_many(
    tasks: Sequence[ReplayTask],  # one per file
    *,
    # address of a Dask scheduler, `tcp://host:port`, whose workers run the tasks; the results are the same
    scheduler: str | None = None,
    on_done: Callable[[], None] = lambda: None,  # called after each file
    on_note: Callable[[str], None] = lambda _: None,  # called with a sentence if the tasks have to wait for workers
) -> list[list[ReplayOutcome]]:
    """Run tasks on all cores or on a cluster; return their outcomes in the order of the tasks.

    Raises `FrictionHilError`: a worker process of this machine died, or the cluster cannot run the tasks; see
    `run_on_cluster`.
    """
    outcomes: list[list[ReplayOutcome]] = [[] for _ in tasks]
    results = _map(tasks) if scheduler is None else run_on_cluster(tasks, scheduler, on_note=on_note)
    for index, found in results:
        outcomes[index] = found
        on_done()
    return outcomes


def processors() -> int:
    """Return the number of processors that this process may use; where the system does not say that, of all."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def _map(tasks: Sequence[ReplayTask]) -> Iterator[tuple[int, list[ReplayOutcome]]]:
    workers = min(len(tasks), processors())
    size = sum(os.path.getsize(task.source) for task in tasks if os.path.isfile(task.source))
    if workers < 2 or (len(tasks) < _MANY and size < _LARGE):
        for index, task in enumerate(tasks):
            yield index, run(task)
        return
    # not fork: numerical libraries may have started threads, whose locks a forked process would copy
    methods = multiprocessing.get_all_start_methods()
    context = multiprocessing.get_context("forkserver" if "forkserver" in methods else "spawn")  # Windows has no fork
    context.set_forkserver_preload(["friction_hil.replay.task"])
    # Ctrl-C ends the workers without a word: this process says what is to be said
    with ProcessPoolExecutor(workers, context, signal.signal, (signal.SIGINT, signal.SIG_DFL)) as pool:
        indices = {pool.submit(run, task): index for index, task in enumerate(tasks)}
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
