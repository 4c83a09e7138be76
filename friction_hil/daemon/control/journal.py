"""The one memory of the changes of a run: written by the process of the control socket, read by all others.

An entry has a number, JSON for those who record, show or learn, and a packed block for the loop. A start, a stop and a
notice have no JSON: no row is computed with them. The memory has no name: it ends with its users.

| part | |
|---|---|
| first page | number of the last entry, and where the JSON is |
| pages of the loop | the block of the last entry, and the loop's answer; of fixed size, mapped before the loop starts |
| behind them | the JSON of the entries that somebody may still need, so that a daemon may be changed for years |

The loop compares one number a cycle, never waits, and writes nothing but its answer. A block counts only as a whole:
its sequence number is odd while it is written and the same before and after it was read, and the digest fits. The
memory cannot be cut off (F_SEAL_SHRINK), which would end the loop. Whoever gets a descriptor for reading cannot write.
"""

import hashlib
import json
import mmap
import os
import struct
import time
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

KEPT_S = 180.0  # of rows: more than a file of a fault and the rows in the ring reach back together
PROVEN = "proven"  # key of an entry: what to go back to, by axis, while something else is on trial

_MAGIC_NUMBER = 0x314C524E4A4C4946  # changes with the layout
_PAGE = mmap.ALLOCATIONGRANULARITY
_HEAD = struct.Struct("<7q")
_SEQUENCE, _LENGTH, _ANSWERED, _STATUS, _CYCLE = range(5)  # words of the loop's pages, each 8 bytes
_DIGEST_AT, _DIGEST_BYTES = 64, 16
_REASON_AT, _REASON_BYTES = 128, 384
_BLOCK_AT = 512
_ACCEPTED, _REFUSED = 1, 2
_LARGEST = 2**62 - 1  # sequence number, whatever garbage is found in its place
_REST_CYCLES = 100  # after garbage, so that a memory full of it costs the loop nothing
_LOOK_S = 2e-3
_MOST_PENDING = 10  # entries that the loop has not taken, or refused


class _Head(NamedTuple):
    """The first page."""

    magic: int
    begin: int  # end of the loop's pages, byte
    number: int  # of the last entry; 0 before the first
    stop: int  # number of the last stop
    removals: int  # how often entries were removed
    place: int  # first byte of the JSON
    length: int  # of what is complete of it, bytes


class Present(NamedTuple):
    """What is in force after a change."""

    configuration: dict[str, Any]
    models_of: dict[str, int]  # number of the change that brought the model of each axis; 0: the start
    files: dict[str, str | None]  # model file of each axis
    on_trial: dict[str, dict[str, Any]]  # gain and model to go back to, of the axes with something on trial


def make_journal(capacity: int = 0) -> int:
    """Return the descriptor of an empty journal; ``capacity``: longest block, bytes."""
    import fcntl  # imported here: Windows lacks it, and what reads this module there makes no journal

    begin = _PAGE * (2 + (_BLOCK_AT + capacity - 1) // _PAGE)
    descriptor = os.memfd_create("friction_hil-journal", os.MFD_CLOEXEC | os.MFD_ALLOW_SEALING)
    os.ftruncate(descriptor, begin)
    fcntl.fcntl(descriptor, fcntl.F_ADD_SEALS, fcntl.F_SEAL_SHRINK)
    os.fchmod(descriptor, 0o400)  # whoever gets a descriptor for reading cannot open it again for writing
    _write_head(descriptor, _Head(_MAGIC_NUMBER, begin, 0, 0, 0, begin, 0))
    return descriptor


def read_only(descriptor: int) -> int:
    """Return another descriptor of the same memory, which is open for reading only and can be given to others."""
    return os.open(f"/proc/self/fd/{descriptor}", os.O_RDONLY)


def loop_pages(descriptor: int) -> tuple[int, int]:
    """Return first byte and length of the pages of the loop."""
    return _PAGE, _head(descriptor).begin - _PAGE


class _LoopPages:
    """The pages of the loop, with a view of their words."""

    def __init__(self, descriptor: int) -> None:
        self.descriptor = descriptor
        first, length = loop_pages(descriptor)
        # populated at once: a page fault in the loop could cost a period
        self._memory = mmap.mmap(descriptor, length, flags=mmap.MAP_SHARED | mmap.MAP_POPULATE, offset=first)
        self._words = memoryview(self._memory)[:_DIGEST_AT].cast("q")
        self.capacity = length - _BLOCK_AT


class JournalReader(_LoopPages):
    """End of the loop."""

    def __init__(self, descriptor: int) -> None:
        super().__init__(descriptor)
        self._seen = 0
        self._rests_until = 0

    @property
    def has_news(self) -> bool:
        """True if something has been written since the last block that was taken."""
        return self._words[_SEQUENCE] != self._seen

    def take(self, cycle: int) -> bytes | None:
        """Return the new block, None if there is no whole one.

        Raises `ValueError`: there is garbage; the reader rests for some cycles after it.
        """
        sequence = self._words[_SEQUENCE]
        if sequence & 1 or cycle < self._rests_until:
            return None
        length, problem = self._words[_LENGTH], "its length is wrong"
        if 0 < length <= self.capacity:
            block = self._memory[_BLOCK_AT : _BLOCK_AT + length]
            digest = self._memory[_DIGEST_AT : _DIGEST_AT + _DIGEST_BYTES]
            if self._words[_SEQUENCE] != sequence:
                return None
            if _digest(sequence, block) == digest:
                self._seen = sequence
                return block
            problem = "its checksum is wrong"
        self._seen = sequence
        self._rests_until = cycle + _REST_CYCLES
        raise ValueError(problem)

    def answer(self, number: int, cycle: int, refusal: str = "") -> None:
        """Answer an entry: it is applied in ``cycle``, or refused for a reason."""
        reason = refusal.encode()[:_REASON_BYTES].ljust(_REASON_BYTES, b"\0")
        self._memory[_REASON_AT : _REASON_AT + _REASON_BYTES] = reason
        self._words[_STATUS] = _REFUSED if refusal else _ACCEPTED
        self._words[_CYCLE] = cycle
        self._words[_ANSWERED] = number


class JournalWriter(_LoopPages):
    """End of the process that serves the control socket; a `ValueError`: the memory is no journal of this version."""

    def __init__(self, descriptor: int) -> None:
        if _head(descriptor).magic != _MAGIC_NUMBER:
            raise ValueError("the shared memory is not a journal of this version")
        super().__init__(descriptor)

    @property
    def next_number(self) -> int:
        """Number of the next entry: a number is not used twice, whether its entry was taken or not."""
        return _head(self.descriptor).number + 1

    @property
    def is_stop_waiting(self) -> bool:
        """True if the loop has not answered the last stop, whoever wrote it."""
        return _head(self.descriptor).stop > self._words[_ANSWERED]

    def post(self, number: int, block: bytes, entry: Mapping[str, Any] | None = None, *, is_stop: bool = False) -> None:
        """Append an entry; the loop sees it last. A `ValueError`: its block is too long.

        ``entry``: its JSON, with what `needed` looks at; None if no row is computed with it.
        """
        if not 0 < len(block) <= self.capacity:
            raise ValueError(f"a block of {len(block)} bytes does not fit into {self.capacity}")
        head = _head(self.descriptor)
        _write_head(self.descriptor, head._replace(number=number, stop=number if is_stop else head.stop))
        if entry is not None:
            known = entries(self.descriptor)
            kept = needed(known, entry["before"], entry["time_s"])
            if len(kept) < len(known):
                keep(self.descriptor, kept)
            append(self.descriptor, entry)
        sequence = self.withdraw() + 1
        self._memory[_BLOCK_AT : _BLOCK_AT + len(block)] = block
        self._words[_LENGTH] = len(block)
        self._memory[_DIGEST_AT : _DIGEST_AT + _DIGEST_BYTES] = _digest(sequence, block)
        self._words[_SEQUENCE] = sequence

    def withdraw(self) -> int:
        """Take back the block; the loop does not take it any more, unless it is doing so at this moment.

        Returns the sequence number, which is odd from then on.
        """
        self._words[_SEQUENCE] = sequence = (self._words[_SEQUENCE] | 1) & _LARGEST
        return int(sequence)

    def wait(self, number: int, timeout_s: float) -> tuple[int, str] | None:
        """Wait for the answer to an entry.

        Returns the cycle in which it was applied, and the reason if it was refused; None if no answer came in time.
        """
        end_s = time.monotonic() + timeout_s
        while self._words[_ANSWERED] != number:
            if time.monotonic() > end_s:
                return None
            time.sleep(_LOOK_S)
        reason = self._memory[_REASON_AT : _REASON_AT + _REASON_BYTES].rstrip(b"\0").decode("utf-8", "replace")
        return int(self._words[_CYCLE]), reason if self._words[_STATUS] != _ACCEPTED else ""


def append(descriptor: int, entry: Mapping[str, Any]) -> None:
    """Append the JSON of an entry; a reader sees all of it, or nothing."""
    head, line = _head(descriptor), _line(entry)
    _write(descriptor, line, head.place + head.length)
    _write_head(descriptor, head._replace(length=head.length + len(line)))


def keep(descriptor: int, kept: Sequence[Mapping[str, Any]]) -> None:
    """Remove the JSON of all entries but these; a reader sees all entries as before, or these.

    They are written beside the former ones, which a reader may be reading, at the beginning where there is room.
    """
    head, data = _head(descriptor), b"".join(map(_line, kept))
    place = head.begin if head.place - head.begin >= len(data) else head.place + head.length
    _write(descriptor, data, place)
    _write_head(descriptor, head._replace(removals=head.removals + 1, place=place, length=len(data)))


def entries(descriptor: int) -> list[dict[str, Any]]:
    """Return all entries, each with its ``number``, in their order."""
    while True:
        head = _head(descriptor)
        data = b""
        while len(data) < head.length and (
            part := os.pread(descriptor, head.length - len(data), head.place + len(data))
        ):
            data += part
        if _head(descriptor).removals == head.removals:  # else the memory may have been used for something else
            return [json.loads(line) for line in data.splitlines()]


def present(descriptor: int, configuration: Mapping[str, Any], files: Mapping[str, str], number: int) -> Present:
    """Return what is in force after a change.

    ``configuration``: at the start of the run, as returned by `friction_hil.config.self_contained`; that which is
    returned shares with it what has not changed. ``files``: model file of each axis at the start; axes whose model was
    given inline have none. ``number``: of the change; 0 before the first.
    """
    known = {entry["number"]: entry for entry in entries(descriptor)}
    axes = {name: dict(axis) for name, axis in configuration["axes"].items()}
    models_of = dict.fromkeys(axes, 0)
    found: dict[str, str | None] = {name: files.get(name) for name in axes}
    for name, axis in known[number]["axes"].items() if number in known else ():
        axes[name]["compensation"] = axis["compensation"]
        if origin := axis["model_of"]:
            models_of[name] = origin
            axes[name]["model"] = known[origin]["axes"][name]["model"]
            found[name] = known[origin]["files"].get(name)
    return Present({**configuration, "axes": axes}, models_of, found, known.get(number, {}).get(PROVEN, {}))


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


def models_of(entry: Mapping[str, Any]) -> set[int]:
    """Return the numbers of the changes that brought the models of an entry; 0: the configuration of the run."""
    return {axis.get("model_of", 0) for axis in entry["axes"].values()}


def _digest(sequence: int, block: bytes) -> bytes:
    return hashlib.blake2b(struct.pack("<q", sequence) + block, digest_size=_DIGEST_BYTES).digest()


def _line(entry: Mapping[str, Any]) -> bytes:
    return json.dumps(entry).encode() + b"\n"


def _head(descriptor: int) -> _Head:
    return _Head(*_HEAD.unpack(os.pread(descriptor, _HEAD.size, 0)))


def _write_head(descriptor: int, head: _Head) -> None:
    os.pwrite(descriptor, _HEAD.pack(*head), 0)


def _write(descriptor: int, data: bytes, at: int) -> None:
    while data:
        written = os.pwrite(descriptor, data, at)
        data, at = data[written:], at + written
