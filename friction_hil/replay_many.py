"""Many recordings through many models: one task a file, on all cores or on a cluster.

A task is plain values, and so is its outcome: the same map runs in this process, in a pool, or elsewhere.
"""

import multiprocessing
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from friction_hil.errors import FrictionHilError, UsageError

if TYPE_CHECKING:
    from friction_hil.config import Configuration, ModelFile
    from friction_hil.recordings import Recording
    from friction_hil.replay import Replay
    from friction_hil.verify import Verification

_NEEDED = ("time_s", "cycle", "position", "velocity", "torque", "load_torque", "temperature")

_MANY, _LARGE = 16, 16 << 20  # files, bytes: less is done before a pool of processes has started


@dataclass(frozen=True, slots=True)
class Task:
    """One file to be replayed; see ``friction-hil replay`` for the options.

    ``models`` are arguments of ``--model``: where there are none, the recording's own is taken. ``picture`` is
    where to draw; ``name`` and the axis are added to it unless the file ``is_only`` and has one axis. ``folder`` is
    where relative paths of files start that are read; the current directory when empty.
    """

    source: str
    models: tuple[str, ...] = ()
    is_verifying: bool = False
    config: str | None = None
    axis: str | None = None
    columns: Mapping[str, str] = field(default_factory=dict)
    scale: Mapping[str, float] = field(default_factory=dict)
    where: str | None = None
    lowpass_hz: float | None = None
    decimate: int = 1
    picture: str | None = None
    name: str = ""
    is_only: bool = True
    folder: str = ""


@dataclass(frozen=True, slots=True)
class Outcome:
    """What became of one axis of a file, or of the whole file where it could not be read.

    Attributes
    ----------
    facts : dict
        As in the JSON of ``replay``; with ``error`` in place of the models where it failed.
    exit_status : int
        0, 1 where a verification failed, else that of the error.
    picture : str or None
        What was drawn.
    """

    facts: dict[str, Any]
    exit_status: int = 0
    picture: str | None = None


def replay_many(
    tasks: Sequence[Task],
    *,
    scheduler: str | None = None,
    on_done: Callable[[], None] = lambda: None,
    on_note: Callable[[str], None] = lambda _: None,
) -> list[list[Outcome]]:
    """Run tasks on all cores or on a cluster, and give their outcomes in the order of the tasks.

    Parameters
    ----------
    tasks : sequence of Task
        One a file.
    scheduler : str, optional
        Address of a Dask scheduler, ``tcp://host:port``, whose workers do the work; the results are the same.
    on_done : callable
        Called when a file is done.
    on_note : callable
        Called with a sentence where the work has to wait for workers.

    Raises
    ------
    FrictionHilError
        A worker process of this machine died, or the cluster cannot do the work; see `run_on_cluster`.
    """
    outcomes: list[list[Outcome]] = [[] for _ in tasks]
    if scheduler is None:
        results = _map(tasks)
    else:
        from friction_hil.cluster import run_on_cluster

        results = run_on_cluster(tasks, scheduler, on_note=on_note)
    for place, found in results:
        outcomes[place] = found
        on_done()
    return outcomes


def _map(tasks: Sequence[Task]) -> Iterator[tuple[int, list[Outcome]]]:
    workers = min(len(tasks), len(os.sched_getaffinity(0)))
    size = sum(os.path.getsize(task.source) for task in tasks if os.path.isfile(task.source))
    if workers < 2 or (len(tasks) < _MANY and size < _LARGE):
        for place, task in enumerate(tasks):
            yield place, run(task)
        return
    # a fork would copy whatever threads numerical libraries have started here
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(["friction_hil.replay", "friction_hil.models"])
    with ProcessPoolExecutor(workers, mp_context=context) as pool:
        places = {pool.submit(run, task): place for place, task in enumerate(tasks)}
        try:
            for future in as_completed(places):
                yield places[future], future.result()
        except BrokenProcessPool:
            left = sum(not future.done() or future.exception() is not None for future in places)
            raise FrictionHilError(
                f"a worker process died, perhaps for want of memory; {left} of {len(tasks)} recordings are not done"
            ) from None
        finally:
            for future in places:
                future.cancel()


def run(task: Task) -> list[Outcome]:
    """Replay one file; a mistake becomes an outcome, so that it costs only this file."""
    try:
        found = _read(task)
        return [_replay(task, recording, is_only=task.is_only and len(found) == 1) for recording in found]
    except FrictionHilError as error:
        return [failed(task.source, task.axis, error)]


def failed(path: str, axis: str | None, error: FrictionHilError) -> Outcome:
    """Make the outcome of a file, or an axis of it, that could not be replayed."""
    facts: dict[str, Any] = {
        "path": path,
        "axis": axis,
        "rows": None,
        "duration_s": None,
        "problems": [],
        "verified": None,
        "models": [],
    }
    return Outcome(facts | {"error": str(error)}, error.exit_status)


def _read(task: Task) -> "list[Recording]":
    from friction_hil import recordings
    from friction_hil.config import load

    options: dict[str, Any] = {
        "columns": task.columns,
        "scale": task.scale,
        "where": task.where,
        "only": None if task.is_verifying else _NEEDED,
        "configuration": None if task.config is None else load(os.path.join(task.folder, task.config)),
    }
    path = os.path.join(task.folder, task.source)
    if task.axis is None:
        found = list(recordings.read_all(path, **options).values())
    else:
        found = [recordings.read(path, task.axis, **options)]
    for recording in found:
        recording.path = str(Path(task.source))  # as the user wrote it, wherever this process runs
    return found


def _replay(task: Task, recording: "Recording", *, is_only: bool) -> Outcome:
    from friction_hil.config import load, model_from_argument

    verification = replay = None
    drawn = None
    try:
        configuration = None if task.config is None else load(os.path.join(task.folder, task.config))
        if task.is_verifying:
            from friction_hil.verify import verify

            verification = verify(recording, configuration)
        if task.models or not task.is_verifying:
            from friction_hil.replay import replay as predict

            models = {argument: model_from_argument(_model_place(task, argument)) for argument in task.models}
            models = models or _own_model(recording, configuration)
            replay = predict(recording, models, lowpass_hz=task.lowpass_hz, decimate=task.decimate)
            if task.picture is not None:
                from friction_hil.reports.replay_picture import draw

                picture = Path(task.picture)
                if not is_only:
                    picture = picture.with_stem(f"{picture.stem}_{task.name}_{recording.axis}")
                draw(replay, picture)
                drawn = str(picture)
    except FrictionHilError as error:
        return failed(recording.path, recording.axis, error)
    is_bad = verification is not None and not verification.is_verified
    return Outcome(_facts(recording, replay, verification), int(is_bad), drawn)


def _model_place(task: Task, argument: str) -> str:
    path = os.path.join(task.folder, argument)
    return path if os.path.isfile(path) else argument  # an argument may also be NAME:coulomb=0.08


def _own_model(recording: "Recording", configuration: "Configuration | None") -> "dict[str, ModelFile]":
    """The model that the daemon ran with, from the configuration inside its recording."""
    from friction_hil.config import from_dict

    if configuration is None and "configuration" in recording.metadata:
        inside = f"{recording.path} (configuration inside)"
        configuration = from_dict(recording.metadata["configuration"], inside)
    if configuration is None or recording.axis not in configuration.axes:
        raise UsageError(f"{recording.path}: no model is known for axis {recording.axis!r}; give --model FILE_OR_NAME")
    model = configuration.axes[recording.axis].model
    return {f"{model.friction.model} (as recorded)": model}


def _facts(recording: "Recording", replay: "Replay | None", verification: "Verification | None") -> dict[str, Any]:
    facts: dict[str, Any] = {
        "path": recording.path,
        "axis": recording.axis,
        "rows": len(recording),
        "duration_s": recording.duration_s,
        "problems": list(replay.problems if replay else recording.problems),
        "verified": verification and verification.is_verified,
        "models": [],
    }
    if verification:
        facts["verification"] = {
            "rows": verification.rows,
            "tolerance": verification.tolerance,
            "differences": verification.differences,
            "reason": verification.reason,
        }
    if replay:
        facts["segments"] = len(replay.segments)
        facts["models"] = [
            {"model": each.model, "rmse": each.rmse, "relative_error": each.relative_error, "unit": each.unit}
            for each in replay.predictions
        ]
    return facts
