"""Independent jobs on all processors, in threads: the compiled models release Python's global lock."""

from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

from friction_hil.parallel.pool import processors

Result = TypeVar("Result")


def in_parallel(jobs: Sequence[Callable[[], Result]], begin: Callable[[int], None] = lambda _: None) -> list[Result]:
    """Run jobs that do not depend on each other; return their results in the order of the jobs.

    The results must not depend on the order in which the jobs run. ``begin`` is called in the calling thread with the
    index of each job in turn, before its result is awaited. What the first of the jobs that failed has raised is
    raised.
    """
    count = min(processors(), len(jobs))
    if count < 2:
        results = []
        for number, job in enumerate(jobs):
            begin(number)
            results.append(job())
        return results
    pool = ThreadPoolExecutor(count, thread_name_prefix="fit")
    try:
        futures = [pool.submit(job) for job in jobs]
        found = []
        for number, future in enumerate(futures):
            begin(number)
            found.append(future.result())
        return found
    finally:
        pool.shutdown(wait=True, cancel_futures=True)
