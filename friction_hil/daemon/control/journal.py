"""Journal of the changes of a run, in shared memory: what the compensators were changed to, by number.

The process of the control socket appends; the companion copies the entries to the recording, and a successor of either
finds there what the former one knew. The memory has no name.
"""

import json
import os
import struct
from collections.abc import Mapping
from typing import Any

_LENGTH = struct.Struct("<q")  # of what is complete, at the beginning


def make_journal() -> int:
    """Return the descriptor of an empty journal."""
    descriptor = os.memfd_create("friction_hil-journal")
    os.fchmod(descriptor, 0o400)  # whoever gets a descriptor for reading cannot open it again for writing
    os.pwrite(descriptor, _LENGTH.pack(0), 0)
    return descriptor


def append(descriptor: int, entry: dict[str, Any]) -> None:
    """Append an entry; a reader sees all of it, or nothing."""
    (length,) = _LENGTH.unpack(os.pread(descriptor, _LENGTH.size, 0))
    line = json.dumps(entry).encode() + b"\n"
    at = _LENGTH.size + length
    while line:
        written = os.pwrite(descriptor, line, at)
        line, at = line[written:], at + written
    os.pwrite(descriptor, _LENGTH.pack(at - _LENGTH.size), 0)


def entries(descriptor: int) -> list[dict[str, Any]]:
    """Return all entries, each with its ``number``, in their order."""
    (length,) = _LENGTH.unpack(os.pread(descriptor, _LENGTH.size, 0))
    data = b""
    while len(data) < length and (part := os.pread(descriptor, length - len(data), _LENGTH.size + len(data))):
        data += part
    return [json.loads(line) for line in data.splitlines()]


def present(
    descriptor: int, configuration: Mapping[str, Any], files: Mapping[str, str], number: int
) -> tuple[dict[str, Any], dict[str, int], dict[str, str | None]]:
    """Return what is in force after a change.

    Parameters
    ----------
    descriptor : int
    configuration : dict
        At the start of the run, as returned by `friction_hil.config.self_contained`.
    files : dict of str
        Model file of each axis at the start; axes whose model was given inline have none.
    number : int
        Of the change; 0 before the first.

    Returns
    -------
    configuration : dict
        A copy, with the settings and models of the change.
    models_of : dict of int
        Number of the change that brought the model of each axis; 0 for that of the start.
    files : dict of str or None
        Model file of each axis.
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
