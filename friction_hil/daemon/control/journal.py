"""Journal of the changes of a run, in shared memory: what the compensators were changed to, by number.

The process of the control socket appends; the companion copies the entries to the recording, and a successor of either
finds there what the former one knew. The memory has no name. Entries that nobody can need any more are removed, so that
a daemon may be changed for years.
"""

import json
import os
import struct
from collections.abc import Mapping, Sequence
from typing import Any

KEPT_S = 180.0  # of rows: more than a file of a fault and the rows in the ring reach back together
_HEAD = struct.Struct("<qqq")  # at the beginning: number of removals, place and length of what is complete
_MOST_PENDING = 10  # entries that the loop has not taken, or refused


def make_journal() -> int:
    """Return the descriptor of an empty journal."""
    descriptor = os.memfd_create("friction_hil-journal")
    os.fchmod(descriptor, 0o400)  # whoever gets a descriptor for reading cannot open it again for writing
    os.pwrite(descriptor, _HEAD.pack(0, _HEAD.size, 0), 0)
    return descriptor


def append(descriptor: int, entry: dict[str, Any]) -> None:
    """Append an entry; a reader sees all of it, or nothing."""
    removals, place, length = _head(descriptor)
    line = _line(entry)
    _write(descriptor, line, place + length)
    os.pwrite(descriptor, _HEAD.pack(removals, place, length + len(line)), 0)


def keep(descriptor: int, kept: Sequence[dict[str, Any]]) -> None:
    """Remove all entries but these; a reader sees all entries as before, or these.

    They are written beside the former ones, which a reader may be reading, at the beginning where there is room.
    """
    removals, place, length = _head(descriptor)
    data = b"".join(map(_line, kept))
    is_first = place - _HEAD.size >= len(data)
    place = _HEAD.size if is_first else place + length
    _write(descriptor, data, place)
    os.pwrite(descriptor, _HEAD.pack(removals + 1, place, len(data)), 0)
    if is_first:
        os.ftruncate(descriptor, place + len(data))


def entries(descriptor: int) -> list[dict[str, Any]]:
    """Return all entries, each with its ``number``, in their order."""
    while True:
        head = _head(descriptor)
        removals, place, length = head
        data = b""
        while len(data) < length and (part := os.pread(descriptor, length - len(data), place + len(data))):
            data += part
        if _head(descriptor)[0] == removals:  # else the memory may have been used for something else meanwhile
            return [json.loads(line) for line in data.splitlines()]


def present(
    descriptor: int, configuration: Mapping[str, Any], files: Mapping[str, str], number: int
) -> tuple[dict[str, Any], dict[str, int], dict[str, str | None]]:
    """Return what is in force after a change: configuration, numbers of the models, model files.

    ``configuration``: at the start of the run, as returned by `friction_hil.config.self_contained`; a copy of it is
    returned, with the settings and models of the change. ``files``: model file of each axis at the start; axes whose
    model was given inline have none. ``number``: of the change; 0 before the first. The number of a model is that of
    the change that brought it; 0 for that of the start.
    """
    now: dict[str, Any] = json.loads(json.dumps(configuration))
    known = {entry["number"]: entry for entry in entries(descriptor)}
    models_of = dict.fromkeys(now["axes"], 0)
    found: dict[str, str | None] = {name: files.get(name) for name in now["axes"]}
    for name, axis in known[number]["axes"].items() if number in known else ():
        now["axes"][name]["compensation"] = axis["compensation"]
        if origin := axis["model_of"]:
            models_of[name] = origin
            now["axes"][name]["model"] = known[origin]["axes"][name]["model"]
            found[name] = known[origin]["files"].get(name)
    return now, models_of, found


def needed(known: Sequence[dict[str, Any]], in_force: int, now_s: float) -> list[dict[str, Any]]:
    """Return the entries that the rows of the last `KEPT_S` need, with those that brought their models.

    An entry has ``number``, ``axes``, ``before`` (number of the one in force when it was made) and ``time_s`` (of the
    latest row then). ``in_force``: number of the one in force; 0 for none. ``now_s``: time of the latest row.
    """
    by_number = {entry["number"]: entry for entry in known}
    wanted = set(sorted(number for number in by_number if number > in_force)[-_MOST_PENDING:])
    number = in_force
    while number in by_number:
        wanted.add(number)
        entry = by_number[number]
        number = entry["before"] if entry["time_s"] >= now_s - KEPT_S else 0  # before that, it was in force already
    wanted |= {model for number in wanted for model in models_of(by_number[number])}
    return [entry for entry in known if entry["number"] in wanted]


def models_of(entry: dict[str, Any]) -> set[int]:
    """Return the numbers of the changes that brought the models of an entry; 0: the configuration of the run."""
    return {axis.get("model_of", 0) for axis in entry["axes"].values()}


def _line(entry: dict[str, Any]) -> bytes:
    return json.dumps(entry).encode() + b"\n"


def _head(descriptor: int) -> tuple[int, int, int]:
    removals, place, length = _HEAD.unpack(os.pread(descriptor, _HEAD.size, 0))
    return removals, place, length


def _write(descriptor: int, data: bytes, at: int) -> None:
    while data:
        written = os.pwrite(descriptor, data, at)
        data, at = data[written:], at + written
