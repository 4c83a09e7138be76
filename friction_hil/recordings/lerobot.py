"""Axes from the data of LeRobot: a joint each, of the frames that a Parquet file holds, with its episodes in turn.

A frame has lists over the joints: ``observation.state`` and ``action``, and where the robot gives them also
``observation.velocity`` and ``observation.effort``. Their names are in ``meta/info.json`` of the data set, as those of
motors (``elbow_flex``), or with what they are (``joint_1.pos``, ``joint_1.vel``, ``joint_1.torque``). Source: the
formats 2.0 to 3.0 of LeRobot (huggingface.co/docs/lerobot); a file holds one episode until 2.1, several from 3.0.
"""

import itertools
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from friction_hil.errors import RecordingError
from friction_hil.recordings import json_text
from friction_hil.recordings.bounds import MOST_AXES
from friction_hil.recordings.columns import TIME
from friction_hil.recordings.quality import GAP_PERIODS
from friction_hil.recordings.recording import Array, Recording
from friction_hil.recordings.source import Source, as_column

_STATE, _ACTION, _STAMP, _EPISODE = "observation.state", "action", "timestamp", "episode_index"
_KINDS = {"pos": "position", "vel": "velocity", "torque": "torque", "effort": "torque"}  # behind the joint's name
_DEMANDS = {"pos": "position_demand", "vel": "velocity_demand", "torque": "torque_demand", "effort": "torque_demand"}
_OTHERS = ("current", "load", "pwm", "temp", "temperature", "voltage")
_FEATURES = {  # what they hold where no name says it
    _STATE: "position",
    _ACTION: "position_demand",
    "observation.velocity": "velocity",
    "observation.effort": "torque",
    "observation.torque": "torque",
}
_ANGLES = ("position", "velocity", "position_demand", "velocity_demand")
_UNIT = "LeRobot's unit (degrees, percent of the travel or rad, as the robot was set up)"
_LARGEST_INFO = 1 << 24  # bytes


def is_frames(lists: Iterable[str]) -> bool:
    """True if the lists in a file are those of LeRobot's frames."""
    return _STATE in lists


def data_files(folder: Path) -> list[Path]:
    """Return the files of a data set of LeRobot, by name; none if the folder is no such."""
    return sorted((folder / "data").glob("*/*.parquet")) if _info_of(folder).is_file() else []


def joints(source: Source, frames: Recording, matrices: Mapping[str, Array]) -> list[Recording]:
    """Return the joints of a file that are wanted, each as an axis, with its episodes one after the other.

    ``frames``: the columns that have one value in each row. ``matrices``: (n, k) lists by their names. Raises
    `RecordingError`: there are no times, or no joint.
    """
    info = _info(source.path)
    features = info.get("features")
    axes: dict[str, dict[str, Array]] = {}
    order = _names(features, _STATE, matrices[_STATE].shape[1])
    bare = list(dict.fromkeys(_split(name)[0] for name in order))
    for feature in sorted(matrices, key=lambda name: name != _STATE):
        values = matrices[feature]
        width = values.shape[1]
        names = _names(features, feature, width) or (bare if width == len(bare) else [])
        for name, column in zip(names, values.T, strict=False):
            joint, kind = _split(name)
            if joint in bare:
                known = _DEMANDS if feature == _ACTION else _KINDS
                own = known.get(kind, kind) if kind else _FEATURES.get(feature, feature)
                axes.setdefault(joint, {}).setdefault(own, column)
    if not axes or len(axes) > MOST_AXES:
        told = "; ".join(["", *frames.problems])
        raise RecordingError(f"{source.path}: {_STATE} is read with 1 to {MOST_AXES} joints in each row{told}")
    rows = dict(frames.columns)
    if _STAMP in rows:
        rows = {TIME: _in_turn(rows.pop(_STAMP), rows.get(_EPISODE)), **rows}
    found = []
    for name in source.select(list(axes)):
        columns = {TIME: rows[TIME]} if TIME in rows else {}
        columns |= {own: as_column(values) for own, values in axes[name].items()}
        columns |= {own: values for own, values in rows.items() if own not in columns}
        units = dict.fromkeys((own for own in _ANGLES if own in columns), _UNIT)
        recording = Recording(str(source.path), name, columns, units=units, problems=list(frames.problems))
        recording.metadata |= {key: info[key] for key in ("codebase_version", "robot_type") if key in info}
        if _EPISODE in rows and len(set(rows[_EPISODE].tolist())) == 1:
            recording.metadata[_EPISODE] = int(rows[_EPISODE][0])
        found.append(recording)
    return found


def _in_turn(stamps: Array, episode: Array | None) -> Array:
    """Return times (n,), s, in which each episode begins after the one before, with a gap that separates them."""
    if len(stamps) < 2 or not np.isfinite(stamps).all():
        return stamps
    is_new = np.diff(stamps) <= 0.0 if episode is None else np.diff(episode) != 0.0
    begins = [0, *(np.flatnonzero(is_new) + 1).tolist(), len(stamps)]
    steps = np.diff(stamps)[~is_new]
    gap = (GAP_PERIODS + 1.0) * float(np.median(steps)) if steps.size else 1.0
    time, end = stamps.copy(), stamps[0] - gap
    for begin, stop in itertools.pairwise(begins):
        time[begin:stop] += end + gap - stamps[begin]
        end = time[stop - 1]
    return time


def _names(features: Any, feature: str, width: int) -> list[str]:
    """Return the names of the elements of a list, ``joint_0`` and on for a state without; empty if none are known."""
    found = features.get(feature) if isinstance(features, dict) else None
    names = found.get("names") if isinstance(found, dict) else None
    if isinstance(names, dict):
        names = next(iter(names.values()), None)
    if isinstance(names, list) and len(names) == 1 and isinstance(names[0], list):
        names = names[0]
    if isinstance(names, list) and len(names) == width and all(isinstance(each, str) for each in names):
        return names
    return [f"joint_{i}" for i in range(width)] if feature == _STATE else []


def _split(name: str) -> tuple[str, str]:
    """Split ``joint_1.pos`` into the joint and what it is; that is empty where the name does not say it."""
    joint, _, kind = name.rpartition(".")
    return (joint, kind) if joint and kind in (*_KINDS, *_OTHERS) else (name, "")


def _info_of(folder: Path) -> Path:
    return folder / "meta" / "info.json"


def _info(path: Path) -> dict[str, Any]:
    """Return what the data set says of itself, beside ``data/chunk-000/FILE``; empty if there is nothing to be read."""
    for folder in path.resolve().parents[:3]:
        file = _info_of(folder)
        if file.is_file() and file.stat().st_size <= _LARGEST_INFO:
            try:
                found = json_text.parse(file.read_text(encoding="utf-8"))
            except (OSError, ValueError):
                return {}
            return found if isinstance(found, dict) else {}
    return {}
