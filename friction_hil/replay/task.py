"""Replay of one file: reading, comparison with models, verification.

Tasks and outcomes hold plain values, so that the same function runs in this process, in a pool or on a cluster.
"""

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from friction_hil import recordings
from friction_hil.config import Configuration, from_dict, load
from friction_hil.errors import FrictionHilError, UsageError
from friction_hil.models.files import model_from_argument
from friction_hil.models.model_file import ModelFile
from friction_hil.recordings import Recording
from friction_hil.replay.comparison import Replay, replay
from friction_hil.replay.verify import Verification, verify

NEEDED = ("time_s", "cycle", "position", "velocity", "torque", "load_torque", "temperature")  # columns


@dataclass(frozen=True, slots=True)
class ReplayTask:
    """One file to replay; the options are those of ``friction-hil replay``."""

    source: str
    models: tuple[str, ...] = ()  # arguments of `--model`; without any, the model in the recording is used
    is_verifying: bool = False
    config: str | None = None
    axis: str | None = None
    columns: Mapping[str, str] = field(default_factory=dict)
    scale: Mapping[str, float] = field(default_factory=dict)
    where: str | None = None
    rate_hz: float | None = None
    lowpass_hz: float | None = None
    decimate: int | None = None
    # picture to draw; `name` and the axis are added to its name unless the file `is_only` and has one axis
    picture: str | None = None
    # draws a replay into `picture`; at module level, so that other processes can import it
    draw: Callable[[Replay, Path], None] | None = None
    name: str = ""
    is_only: bool = True
    folder: str = ""  # that relative paths of input files start from; empty: the current one


@dataclass(frozen=True, slots=True)
class ReplayOutcome:
    """Result of replaying one axis of a file, or the error if the file could not be read."""

    facts: dict[str, Any]  # entry of the JSON of `replay`; if it failed, with `error` and without models
    exit_status: int = 0  # 0; 1 if a verification failed; else that of the error
    picture: str | None = None  # that was drawn


def run(task: ReplayTask) -> list[ReplayOutcome]:
    """Replay one file; an error becomes its outcome, so that the other files are not affected."""
    try:
        found = _read(task)
        return [_replay(task, recording, is_only=task.is_only and len(found) == 1) for recording in found]
    except FrictionHilError as error:
        return [failed(task.source, task.axis, error)]


def failed(path: str, axis: str | None, error: FrictionHilError) -> ReplayOutcome:
    """Return the outcome of a file, or of an axis, that could not be replayed."""
    facts: dict[str, Any] = {
        "path": path,
        "axis": axis,
        "rows": None,
        "duration_s": None,
        "problems": [],
        "verified": None,
        "models": [],
    }
    return ReplayOutcome(facts | {"error": str(error)}, error.exit_status)


def _read(task: ReplayTask) -> list[Recording]:
    options: dict[str, Any] = {
        "columns": task.columns,
        "scale": task.scale,
        "where": task.where,
        "rate_hz": task.rate_hz,
        "only": None if task.is_verifying else NEEDED,
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


def _replay(task: ReplayTask, recording: Recording, *, is_only: bool) -> ReplayOutcome:
    drawn = None
    try:
        configuration = None if task.config is None else load(os.path.join(task.folder, task.config))
        verification = verify(recording, configuration) if task.is_verifying else None
        compared: Replay | None = None
        if task.models or not task.is_verifying:
            models = {argument: model_from_argument(_model_argument(task, argument)) for argument in task.models}
            models = models or own_model(recording, configuration)
            compared = replay(recording, models, lowpass_hz=task.lowpass_hz, decimate=task.decimate)
            if task.picture is not None and task.draw is not None:
                picture = Path(task.picture)
                if not is_only:
                    picture = picture.with_stem(f"{picture.stem}_{task.name}_{recording.axis}")
                task.draw(compared, picture)
                drawn = str(picture)
    except FrictionHilError as error:
        return failed(recording.path, recording.axis, error)
    is_bad = verification is not None and not verification.is_verified
    return ReplayOutcome(facts(recording, compared, verification), int(is_bad), drawn)


def _model_argument(task: ReplayTask, argument: str) -> str:
    path = os.path.join(task.folder, argument)
    return path if os.path.isfile(path) else argument  # an argument may also be NAME:coulomb=0.08


def own_model(recording: Recording, configuration: Configuration | None) -> dict[str, ModelFile]:
    """Return the model that the daemon ran with, from the configuration in its recording."""
    if configuration is None and "configuration" in recording.metadata:
        inside = f"{recording.path} (configuration inside)"
        configuration = from_dict(recording.metadata["configuration"], inside, reads_files=False)
    if configuration is None or recording.axis not in configuration.axes:
        raise UsageError(f"{recording.path}: no model is known for axis {recording.axis!r}; give --model FILE_OR_NAME")
    model = configuration.axes[recording.axis].model
    return {f"{model.friction.model} (as recorded)": model}


def facts(recording: Recording, compared: Replay | None, verification: Verification | None) -> dict[str, Any]:
    """Return the entry of a recording in the JSON of ``replay``."""
    found: dict[str, Any] = {
        "path": recording.path,
        "axis": recording.axis,
        "rows": len(recording),
        "duration_s": recording.duration_s,
        "problems": list(compared.problems if compared else recording.problems),
        "verified": verification and verification.is_verified,
        "models": [],
    }
    if verification:
        found["verification"] = {
            "rows": verification.rows,
            "tolerance": verification.tolerance,
            "differences": verification.differences,
            "reason": verification.reason,
        }
    if compared:
        found["segments"] = len(compared.segments)
        found["models"] = [
            {"model": each.model, "rmse": each.rmse, "relative_error": each.relative_error, "unit": each.unit}
            for each in compared.predictions
        ]
    return found
