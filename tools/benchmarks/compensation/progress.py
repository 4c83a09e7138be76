"""Work in threads, with a progress bar on a terminal."""

import os
import sys
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

import click

Item = TypeVar("Item")
Result = TypeVar("Result")


def with_progress(work: Callable[[Item], Result], items: Iterable[Item], label: str) -> Iterator[Result]:
    """Do ``work`` on all ``items`` in threads, and yield the results in order; compiled code runs in parallel."""
    items = list(items)
    with (
        ThreadPoolExecutor(len(os.sched_getaffinity(0))) as pool,
        click.progressbar(pool.map(work, items), len(items), label, file=sys.stderr) as results,
    ):
        yield from results
