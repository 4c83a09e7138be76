"""What is done with one recording of a fleet, or for health with those of one machine, in whatever process.

Tasks and answers hold plain values. What goes wrong with a recording is its answer, so that no other one suffers.
"""

import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from friction_hil import recordings
from friction_hil.api.identification import identify
from friction_hil.errors import FrictionHilError, internal_error
from friction_hil.fleets.storage import fetched
from friction_hil.health import Layout, Observation, judge, observe
from friction_hil.health.observe import COLUMNS, by_axis
from friction_hil.numerics.json_values import to_json
from friction_hil.recordings import Recording
from friction_hil.recordings.parts import started_s
from friction_hil.replay.verify import verify

Row = dict[str, Any]


@dataclass(frozen=True, slots=True)
class Task:
    """One recording, or the recordings of one machine."""

    work: str  # of `WORKS`
    name: str  # of the recording, or the folder of the machine
    sources: tuple[str, ...]
    reading: Mapping[str, Any] = field(default_factory=dict)  # options of `friction_hil.recordings.read_all`
    options: Mapping[str, Any] = field(default_factory=dict)  # of the work


@dataclass(frozen=True, slots=True)
class Answer:
    """What became of a task."""

    rows: tuple[Row, ...]  # one an axis, for health one a quantity; or a single one with `error`
    files: Mapping[str, bytes] = field(default_factory=dict)  # to be written by their names


def run(task: Task) -> Answer:
    """Do the work of a task."""
    try:
        return WORKS[task.work](task)
    except FrictionHilError as error:
        return failed(task, error)
    except Exception as error:  # noqa: BLE001  one recording must not cost the others
        return failed(task, FrictionHilError(internal_error(error)))


def failed(task: Task, error: FrictionHilError) -> Answer:
    """Return the answer of a task that could not be done."""
    return Answer(({"source": task.name, "axis": None, "error": str(error)},))


def _read(task: Task) -> Iterator[tuple[Recording, Row]]:
    """Yield the axes of a recording with the row of each to be filled in."""
    with fetched(task.sources[0]) as path:
        for axis, recording in recordings.read_all(path, **task.reading).items():
            recording.path = task.name
            yield recording, {"source": task.name, "axis": axis, "error": None, "rows": len(recording)}


def _identify(task: Task) -> Answer:
    from friction_hil.checked_yaml.text import dump  # imported here: start-up time

    rows, files = [], {}
    for recording, row in _read(task):
        found = identify(recording, **task.options)
        content = found.content or {}
        friction, mechanics = content.get("friction", {}), content.get("mechanics", {})
        row |= {"model": found.label, "is_usable": found.is_usable, "flags": "; ".join(found.flags)}
        row |= {"relative_error": _error_of(found.to_dict())}
        row |= {f"friction.{name}": value for name, value in _numbers(friction.get("parameters", {}))}
        row |= {f"mechanics.{name}": value for name, value in _numbers(mechanics)}
        row |= {f"standard_error.{name}": value for name, value in _numbers(found.standard_errors)}
        rows.append(row)
        if found.is_usable:
            files[f"{row['axis']}.yaml"] = dump(dict(content)).encode()
    return Answer(tuple(to_json(row) for row in rows), files)


def _error_of(facts: Mapping[str, Any]) -> float | None:
    """Return the relative error of the best fit, on data that were held out from it where there are such."""
    for fit in facts.get("fits", ())[:1]:
        for kind in ("validation", "cross_validation", "train"):
            if fit.get(kind) is not None and fit[kind].get("relative_error") is not None:
                error: float = fit[kind]["relative_error"]
                return error
    return None


def _numbers(values: Mapping[str, Any]) -> Iterator[tuple[str, float]]:
    for name, value in values.items():
        if isinstance(value, int | float):
            yield name, float(value)


def _verify(task: Task) -> Answer:
    rows = []
    for recording, row in _read(task):
        found = verify(recording)
        differences = "; ".join(found.differences)
        rows.append({**row, "is_verified": found.is_verified, "reason": found.reason, "differences": differences})
    return Answer(tuple(rows))


def _convert(task: Task) -> Answer:
    rows, files = [], {}
    with tempfile.TemporaryDirectory(prefix="friction_hil_fleet_") as folder:
        for recording, row in _read(task):
            path = Path(folder) / f"{row['axis']}{task.options['to']}"
            recordings.write(path, recording)
            files[path.name] = path.read_bytes()
            rows.append(row)
    return Answer(tuple(rows), files)


def _health(task: Task) -> Answer:
    layouts: dict[str, Layout] = {}
    observed: dict[str, list[Observation]] = {}
    problems: list[str] = []
    with ExitStack() as stack:
        paths = [stack.enter_context(fetched(source)) for source in task.sources]
        for path in sorted(paths, key=lambda each: started_s(each)[0]):
            try:
                axes = recordings.read_all(path, is_alone=True, only=COLUMNS, **task.reading)
            except FrictionHilError as error:
                problems.append(str(error))
                continue
            for axis, recording in by_axis(path, axes).items():
                found, layouts[axis], why_not = observe(
                    recording, started_s=started_s(path)[0], layout=layouts.get(axis), **task.options
                )
                observed.setdefault(axis, []).extend(found)
                problems += why_not
    if not observed:
        raise FrictionHilError("; ".join(problems[:3]) or "there is nothing to observe")
    rows = []
    for axis, observations in observed.items():
        health = judge(axis, observations, layouts[axis])
        row: Row = {"source": task.name, "axis": axis, "error": None, "observations": health.count}
        row["problems"] = "; ".join((*health.notes, *problems[:3]))
        for each in health.verdicts:
            if each.state == "not shown":
                continue
            judged = {"quantity": each.label, "unit": each.unit, "state": each.state, "baseline": each.baseline}
            rows.append({**row, **judged, "change": each.change, "since_s": each.since_s, "level": each.level})
        if not any(one["axis"] == axis for one in rows):
            rows.append(row)
    return Answer(tuple(to_json(row) for row in rows))


WORKS: Mapping[str, Callable[[Task], Answer]] = {
    "identify": _identify,
    "health": _health,
    "convert": _convert,
    "verify": _verify,
}


def worst(work: str, rows: Sequence[Row]) -> list[Row]:
    """Return the rows with what a reader should look at first; not those with nothing to look at."""

    def badness(row: Row) -> float:
        if row.get("error"):
            return 1e9
        if work == "verify":
            return 1.0 - bool(row["is_verified"])
        if work == "health":
            if "state" not in row:  # nothing could be judged
                return 1e-6
            return float(row["level"] or 0.0) if row["state"] == "changed" else 0.0
        if work == "identify":
            error = row["relative_error"]
            return (10.0 if not row["is_usable"] else 0.0) + (1e3 if error is None else float(error))
        return 0.0

    order = sorted(rows, key=lambda row: (-badness(row), row["source"], str(row["axis"])))
    return [row for row in order if badness(row) > 0.0]
