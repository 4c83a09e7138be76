"""One work on many recordings: what is done is kept, so that the same call goes on where it was interrupted."""

import hashlib
import importlib
import inspect
import json
import os
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from friction_hil import __version__, recordings
from friction_hil.api.identification import identify
from friction_hil.errors import FrictionHilError, UsageError, choices
from friction_hil.fleets import storage
from friction_hil.fleets.work import WORKS, Answer, Row, Task, failed, run, worst
from friction_hil.health import observe
from friction_hil.parallel import run_many
from friction_hil.recordings import json_lines
from friction_hil.reports.fleet_report import write_report

_JOURNAL, TABLE, REPORT = "done.jsonl", "table.parquet", "report.html"
_FIRST = ("source", "axis", "error")  # columns of every table
_FUNCTIONS: Mapping[str, Callable[..., Any]] = {"identify": identify, "health": observe}  # that have the options
_OWN = {"progress", "column", "scale", "rate", "where", "axis", "started_s", "layout"}  # not options of a work


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Fleet:
    """Result of `fleet`.

    Attributes
    ----------
    work : str
    rows : tuple of dict
        One for each axis of each recording, for health one for each quantity; sorted by source and axis. ``error`` says
        why one was not done; it is None in the others.
    folder : Path
        With the table, the report, and the files of the axes (models, converted recordings) in ``files``.
    known : int
        Recordings that had been done before.
    """

    work: str
    rows: tuple[Row, ...]
    folder: Path
    known: int

    @property
    def failures(self) -> tuple[Row, ...]:
        """Rows of what was not done."""
        return tuple(row for row in self.rows if row["error"])

    @property
    def worst(self) -> tuple[Row, ...]:
        """Rows to look at first: failures, then what is not verified, has changed, or has the largest error."""
        return tuple(worst(self.work, self.rows))

    @property
    def table(self) -> Path:
        """The Parquet file with all rows."""
        return self.folder / TABLE

    @property
    def report(self) -> Path:
        """The HTML page that names the worst axes."""
        return self.folder / REPORT

    def __repr__(self) -> str:
        """Return how much was done."""
        return f"Fleet({self.work}: {len(self.rows)} rows, {len(self.failures)} failures, in {self.folder})"


def fleet(
    work: str,
    recording: str | Path | Sequence[str | Path],
    *,
    output: str | Path,
    scheduler: str | None = None,
    column: Mapping[str, str] | None = None,
    scale: Mapping[str, float] | None = None,
    rate: float | None = None,
    where: str | None = None,
    progress: Callable[[str, float | None], object] | None = None,
    **options: Any,
) -> Fleet:
    """Identify, judge, verify or convert the recordings of a fleet; return one table of them all.

    Each recording that is done is noted in ``output`` at once. If the call ends early, for whatever reason, the same
    call goes on with the others; recordings that have changed since, and those that failed, are done again.

    Parameters
    ----------
    work : str
        ``identify``, ``verify`` (recordings of the daemon), ``convert``, or ``health``, which takes the recordings of
        one folder as those of one machine.
    recording : path or sequence of paths
        Files, patterns and folders; addresses of fsspec such as ``s3://bucket/logs/*.mcap``, ``gs://`` or ``https://``.
    output : path
        Folder for the table, the report and the files; it is made if it does not exist.
    scheduler : str, optional
        Address of a Dask scheduler, ``tcp://host:port``, whose workers do the work; by default all cores of this
        machine. The workers reach the recordings by the same paths or addresses.
    column, scale, rate, where
        As of `friction_hil.identify`.
    progress : callable, optional
        Called with the name of a recording that is done, and the done share.
    **options
        Of the work: those of `friction_hil.identify`; ``to`` of ``convert``, the suffix of the new files (.parquet);
        ``kind`` and ``orders`` of `friction_hil.health.observe`.

    Returns
    -------
    Fleet

    Raises
    ------
    UsageError
        A pattern matches nothing, an argument is not known, or a package is not installed.
    FrictionHilError
        The cluster cannot be reached or was lost, or a process died: what was done is kept.

    Examples
    --------
    >>> import tempfile, numpy as np, friction_hil as fh
    >>> folder = tempfile.mkdtemp()
    >>> t = np.arange(0.0, 4.0, 0.002)
    >>> for k in range(3):
    ...     motion = {"time_s": t, "position": np.sin(2.0 * t), "torque": 0.1 * (k + 1) * np.sign(np.cos(2.0 * t))}
    ...     fh.recordings.write(f"{folder}/axis{k}.parquet", fh.recordings.from_table(motion, f"axis{k}"))
    >>> done = fh.fleet("identify", f"{folder}/*.parquet", output=f"{folder}/out", models="coulomb")
    >>> [round(row["friction.coulomb"], 2) for row in done.rows]
    [0.1, 0.2, 0.3]
    """
    if work not in WORKS:
        raise UsageError(f"work={work!r} is not known; {choices(work, WORKS)}")
    folder = Path(output)
    reading = {"columns": dict(column or {}), "scale": dict(scale or {}), "rate_hz": rate, "where": where}
    options = _checked(work, options)
    sources = storage.sources([recording] if isinstance(recording, str | Path) else recording)
    machines = _machines(sources) if work == "health" else {each: [each] for each in sources}
    tasks = [Task(work, name, tuple(several), reading, options) for name, several in machines.items()]
    _parquet()
    journal = folder / _JOURNAL
    known = _known(journal)
    keys = {task.name: _key(task) for task in tasks}
    rows: dict[str, list[Row]] = {
        task.name: known[key] for task in tasks if (key := keys[task.name]) is not None and key in known
    }
    left = [task for task in tasks if task.name not in rows]
    count, before = len(tasks), len(rows)
    for index, answer in run_many(run, left, died=failed, scheduler=scheduler):
        task = left[index]
        rows[task.name] = list(answer.rows)
        _write_files(folder, task, answer)
        if keys[task.name] is not None and not any(row["error"] for row in answer.rows):
            json_lines.append(journal, [{"key": keys[task.name], "rows": rows[task.name]}])
        if progress is not None:
            progress(task.name, len(rows) / count)
    found = Fleet(work, tuple(row for task in tasks for row in rows[task.name]), folder, before)
    folder.mkdir(parents=True, exist_ok=True)
    _write_table(found)
    write_report(found.report, work, found.rows, found.worst)
    return found


def _machines(sources: Sequence[str]) -> dict[str, list[str]]:
    """Return recordings by their folder."""
    found: dict[str, list[str]] = {}
    for source in sources:
        found.setdefault(os.path.dirname(source), []).append(source)
    return found


def _checked(work: str, options: Mapping[str, Any]) -> dict[str, Any]:
    """Return the options of a work; raises UsageError for one that it does not have."""
    if work == "convert":
        to = options.get("to", ".parquet")
        known = recordings.formats(to_write=True)
        if to not in known:
            raise UsageError(f"to={to!r}: this format cannot be written; {choices(str(to), known)}")
        options = {"to": to, **options}
    allowed = {"to"} if work == "convert" else set()
    if work in _FUNCTIONS:
        parameters = inspect.signature(_FUNCTIONS[work]).parameters.values()
        allowed = {each.name for each in parameters if each.kind is each.KEYWORD_ONLY} - _OWN
    for name in options:
        if name not in allowed:
            raise UsageError(f"{work} has no option {name!r}; {choices(name, sorted(allowed))}")
    return dict(options)


def _key(task: Task) -> str | None:
    """Return what identifies a task with the content of its recordings; None if these cannot be looked at."""
    try:
        states = [storage.state_of(source) for source in task.sources]
    except FrictionHilError:
        return None  # doing it says why
    parts = [__version__, task.work, task.name, task.sources, states, task.reading, task.options]
    return hashlib.sha256(json.dumps(parts, sort_keys=True, default=str).encode()).hexdigest()


def _known(journal: Path) -> dict[str, list[Row]]:
    """Return the rows of what has been done, by their keys; a line that was cut off while it was written is none."""
    try:
        lines = journal.read_text(encoding="utf-8").splitlines()
    except FileNotFoundError:
        return {}
    except (OSError, UnicodeDecodeError) as error:
        raise FrictionHilError(f"{journal} cannot be read: {error}; name another folder with --output") from None
    found = {}
    for number, line in enumerate(lines, 1):
        try:
            entry = json.loads(line)
            found[entry["key"]] = entry["rows"]
        except (ValueError, KeyError, TypeError):
            if number < len(lines):
                raise FrictionHilError(
                    f"{journal}, line {number}: is no line of such a file; name another folder with --output"
                ) from None
    return found


def _write_files(folder: Path, task: Task, answer: Answer) -> None:
    """Write the files of an answer below ``files``, under a name that no other recording has."""
    if not answer.files:
        return
    stem = os.path.basename(task.name)
    mark = hashlib.sha256(task.name.encode()).hexdigest()[:8]
    target = folder / "files" / f"{re.sub(r'[^A-Za-z0-9._-]', '_', stem)}-{mark}"
    try:
        target.mkdir(parents=True, exist_ok=True)
        for name, content in answer.files.items():
            (target / re.sub(r"[^A-Za-z0-9._-]", "_", name)).write_bytes(content)
    except OSError as error:
        raise FrictionHilError(f"{target} cannot be written: {error.strerror}") from None


def _parquet() -> tuple[Any, Any]:
    # imported here and by name: an optional package
    try:
        return importlib.import_module("pyarrow"), importlib.import_module("pyarrow.parquet")
    except ImportError:
        raise UsageError('the table of a fleet needs pyarrow: pip install "friction-hil[formats]"') from None


def _write_table(found: Fleet) -> None:
    arrow, parquet = _parquet()
    names = [*_FIRST, *sorted({name for row in found.rows for name in row} - set(_FIRST))]
    columns = {name: [row.get(name) for row in found.rows] for name in names}
    try:
        parquet.write_table(arrow.table(columns), found.table)
    except OSError as error:
        raise FrictionHilError(f"{found.table} cannot be written: {error}") from None
