"""Replay of many recordings: one task per file, on all cores or on a cluster.

The workers of a cluster open the recordings by the same paths as this process would. Pictures come back as bytes and
are written here.
"""

import os
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path

from friction_hil.errors import FrictionHilError
from friction_hil.parallel import run_many
from friction_hil.replay.task import ReplayOutcome, ReplayTask, failed, run

_MANY, _LARGE = 16, 16 << 20  # files, bytes: fewer take less time than starting a pool of processes

_Answer = tuple[list[ReplayOutcome], dict[str, bytes]]


def replay_many(
    tasks: Sequence[ReplayTask],  # one per file
    *,
    # address of a Dask scheduler, `tcp://host:port`, whose workers run the tasks; the results are the same
    scheduler: str | None = None,
    on_done: Callable[[], None] = lambda: None,  # called after each file
    on_note: Callable[[str], None] = lambda _: None,  # called with a sentence if the tasks have to wait for workers
) -> list[list[ReplayOutcome]]:
    """Run tasks on all cores or on a cluster; return their outcomes in the order of the tasks.

    Raises `FrictionHilError`: a worker process of this machine died, or the cluster cannot run the tasks.
    """
    outcomes: list[list[ReplayOutcome]] = [[] for _ in tasks]
    for index, found in _here(tasks) if scheduler is None else _there(tasks, scheduler, on_note):
        outcomes[index] = found
        on_done()
    return outcomes


def _here(tasks: Sequence[ReplayTask]) -> Iterator[tuple[int, list[ReplayOutcome]]]:
    size = sum(os.path.getsize(task.source) for task in tasks if os.path.isfile(task.source))
    return run_many(run, tasks, died=_died, is_large=len(tasks) >= _MANY or size >= _LARGE)


def _there(
    tasks: Sequence[ReplayTask], scheduler: str, on_note: Callable[[str], None]
) -> Iterator[tuple[int, list[ReplayOutcome]]]:
    sent = [replace(task, folder=os.getcwd()) for task in tasks]
    found = run_many(
        answer, sent, died=lambda task, error: (_died(task, error), {}), scheduler=scheduler, on_note=on_note
    )
    for index, (outcomes, pictures) in found:
        yield index, [_with_picture(outcome, tasks[index], pictures) for outcome in outcomes]


def answer(task: ReplayTask) -> _Answer:
    """Run one task in a worker; return its outcomes and pictures."""
    if task.picture is None:
        return run(task), {}
    with tempfile.TemporaryDirectory() as folder:
        outcomes = run(replace(task, picture=str(Path(folder) / Path(task.picture).name)))
        return outcomes, {path.name: path.read_bytes() for path in Path(folder).iterdir()}


def _died(task: ReplayTask, error: FrictionHilError) -> list[ReplayOutcome]:
    return [failed(task.source, task.axis, FrictionHilError(f"{task.source}: {error}"))]


def _with_picture(outcome: ReplayOutcome, task: ReplayTask, pictures: dict[str, bytes]) -> ReplayOutcome:
    """Write the picture of an outcome to the path of its task."""
    if outcome.picture is None or task.picture is None:
        return outcome
    path = Path(task.picture).with_name(Path(outcome.picture).name)
    try:
        path.write_bytes(pictures[path.name])
    except OSError as error:
        unwritten = FrictionHilError(f"{path} cannot be written: {error.strerror}")
        return failed(outcome.facts["path"], outcome.facts["axis"], unwritten)
    return replace(outcome, picture=str(path))
