"""Recordings on disks and in object stores: patterns of them, and each of them as a local file while it is read.

Addresses such as ``s3://bucket/logs/*.mcap`` are those of fsspec, which finds credentials where the tools of the store
do.
"""

import contextlib
import importlib
import os
import re
import tempfile
from collections.abc import Iterable, Iterator
from datetime import datetime
from pathlib import Path, PurePosixPath
from typing import Any

from friction_hil.errors import RecordingError, UsageError
from friction_hil.health import history
from friction_hil.recordings.given import expanded
from friction_hil.recordings.mapping import mapping_files
from friction_hil.recordings.parts import SUFFIX

_ADDRESS = re.compile(r"[a-z][a-z0-9+.-]+://", re.IGNORECASE)
_LATER_PART = re.compile(rf"(?P<stem>.+)-\d+(?={re.escape(SUFFIX)}$)")
_CHANGED = ("mtime", "LastModified", "last_modified", "updated")  # by which stores name the time of the last change
_VERSION = ("ETag", "etag", "md5Hash", "content_md5", *_CHANGED)


def is_remote(source: str) -> bool:
    """True if a recording is in an object store."""
    return _ADDRESS.match(source) is not None


def sources(words: Iterable[str | Path]) -> list[str]:
    """Replace each pattern, on a disk or in a store, by the recordings that it matches, each once and sorted by name.

    Local paths are absolute, so that every process finds them. Raises `UsageError`: a pattern matches nothing, or the
    package for a store is not installed; `RecordingError`: a store does not answer.
    """
    found: list[str] = []
    for word in map(str, words):
        if not is_remote(word):
            found += [os.path.abspath(each) for each in expanded([word])]
            continue
        fs, path = _store(word)
        with _reported(word):
            matches = [path] if not re.search(r"[*?\[]", path) else [each for each in fs.glob(path) if fs.isfile(each)]
        if not matches:
            raise UsageError(f"{word}: nothing there matches")
        scheme = word.partition("://")[0]
        found += [each if is_remote(each) else f"{scheme}://{each}" for each in without_later_parts(sorted(matches))]
    return list(dict.fromkeys(found))


def without_later_parts(names: list[str]) -> list[str]:
    """Leave out files that continue another one of the list, by their names: they are read with it."""
    known = set(names)
    return [
        each for each in names if (later := _LATER_PART.match(each)) is None or f"{later['stem']}{SUFFIX}" not in known
    ]


def state_of(source: str) -> str:
    """Return what changes with the content of a recording: its size and the version or time that the store states.

    Raises `RecordingError`: there is no such recording, or its store does not answer.
    """
    if not is_remote(source):
        try:
            return history.state_of(Path(source))
        except OSError as error:
            raise RecordingError(f"{source} cannot be read: {error.strerror}") from None
    fs, path = _store(source)
    with _reported(source):
        facts = fs.info(path)
    return f"{facts.get('size')} {next((facts[name] for name in _VERSION if facts.get(name)), '')}"


@contextlib.contextmanager
def fetched(source: str) -> Iterator[Path]:
    """Give a recording as a local file, with the files that continue it and those that map its columns.

    Raises `RecordingError`: it cannot be read.
    """
    if not is_remote(source):
        yield Path(source)
        return
    fs, path = _store(source)
    name = PurePosixPath(path)
    beside = map(str, mapping_files(name))
    with tempfile.TemporaryDirectory(prefix="friction_hil_fleet_") as folder:
        with _reported(source):
            later = fs.glob(f"{name.with_suffix('')}-*{SUFFIX}") if name.suffix.lower() == SUFFIX else []
            for each in (path, *later, *(one for one in beside if fs.exists(one))):
                target = Path(folder) / PurePosixPath(each).name
                fs.get_file(each, str(target))
                changed = next((time for key in _CHANGED if (time := fs.info(each).get(key))), None)
                if isinstance(changed, datetime):
                    os.utime(target, (changed.timestamp(), changed.timestamp()))
        yield Path(folder) / name.name


def _store(source: str) -> tuple[Any, str]:
    # imported here and by name: an optional package
    try:
        core = importlib.import_module("fsspec.core")
    except ImportError:
        raise UsageError(f'{source}: object stores need fsspec: pip install "friction-hil[cluster]"') from None
    try:
        fs, path = core.url_to_fs(source)
    except ImportError as error:
        raise UsageError(f"{source}: {error}") from None
    except ValueError as error:
        raise UsageError(f"{source}: {error}") from None
    return fs, str(path)


@contextlib.contextmanager
def _reported(source: str) -> Iterator[None]:
    """Report what a store answers, whichever of its libraries raises it, as one sentence about the recording."""
    try:
        yield
    except (UsageError, RecordingError):
        raise
    except FileNotFoundError:
        raise RecordingError(f"{source}: there is no such recording") from None
    except Exception as error:  # noqa: BLE001  each store has errors of its own
        raise RecordingError(f"{source} cannot be read: {type(error).__name__}: {error}") from None
