"""What a drive held before the daemon wrote to it, in memory and on disk, to leave the drive as it was found.

The file is written before the drive is: after a kill the next start finds it, takes its values for those found, and
restores them at its end. A value that is neither the one found nor one that was written belongs to somebody else, who
has changed the drive since; it is left alone.

Set-points that act as soon as somebody enables the drive are no settings: they are left at zero, whatever was found.
"""

import contextlib
import json
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from friction_hil.errors import DriveError
from friction_hil_drivers.cia402 import codes, objects
from friction_hil_drivers.cia402.access import RefusedError, hexadecimal
from friction_hil_drivers.cia402.objects import Address, DataType, Object

if TYPE_CHECKING:
    from friction_hil_drivers.cia402.client import ObjectClient

_VERSION = 1
_IDENTITY = (objects.VENDOR_ID, objects.PRODUCT_CODE, objects.SERIAL_NUMBER)

# Commands and set-points are no settings; 1010h and 1011h are orders
_NOT_KEPT = frozenset({0x1010, 0x1011, 0x6040, 0x6071, 0x607A, 0x60B0, 0x60B1, 0x60B2, 0x60FF})

_MODES = [objects.axis_index(objects.MODE.index, axis) for axis in range(8)]


@dataclass(slots=True)
class Found:
    """One object: what it held, and what was written to it since."""

    entry: Object
    found: bytes | None  # None: the drive did not show it
    written: list[bytes] = field(default_factory=list)
    is_taken: bool = False  # the drive has taken the last one

    def is_ours(self, present: bytes | None) -> bool:
        """Return True if ``present`` is what was found or written, or is not shown, so that nobody else changed it."""
        return present is None or present == self.found or present in self.written

    @property
    def wish(self) -> str:
        """What the object is to hold, in words."""
        return f"{self.entry} {f'was {hexadecimal(self.found)}' if is_kept(self.entry) else 'is to be 0'}"


def is_kept(entry: Object) -> bool:
    """Return True for a setting, False for a command or a set-point."""
    index = entry.index
    if 0x6000 <= index < 0xA000:  # each further axis of a node has its objects 800h higher
        index = 0x6000 + (index - 0x6000) % 0x800
    return index not in _NOT_KEPT


Step = tuple[Object, bytes]


def number_of(data: bytes | None) -> int:
    """Return an unsigned integer, 0 for an object that is not shown."""
    return int.from_bytes(data or b"", "little")


class Journal:
    """Values found in one drive; each bus adds what belongs together on it.

    ``path_of``: returns the path of the file, given the identity of the drive in hexadecimal numbers, and the user's
    number.
    """

    names: Mapping[Address, Object] = objects.TABLE  # what is known of objects that a file has

    def __init__(self, access: "ObjectClient", path_of: Callable[[str], Path]) -> None:
        self._access = access
        self._path_of = path_of
        self._path: Path | None = None
        self._found: dict[Address, Found] = {}
        self.notes: list[str] = []

    def __bool__(self) -> bool:
        return bool(self._found)

    def leave_at_zero(self, entry: Object, size: int) -> None:
        """Keep that a set-point of so many bytes is to be zero once the drive is left; raises as `before`."""
        self._open()
        self._found[entry.address] = Found(entry, bytes(size))
        self._save()

    def before(self, entry: Object, data: bytes) -> None:
        """Keep what the drive holds, before ``data`` is written; raises a `DriveError` if the disk does not take it."""
        if not is_kept(entry):
            return
        self._open()
        for one in self._concerned(entry):
            if one.address not in self._found:
                self._found[one.address] = Found(one, self._peek(one))
        kept = self._found[entry.address]
        if data not in kept.written:
            kept.written.append(data)
        self._save()

    def after(self, entry: Object) -> None:
        """Note that the drive has taken what was written to an object."""
        if (kept := self._found.get(entry.address)) is not None:
            kept.is_taken = True

    def _peek(self, entry: Object) -> bytes | None:
        """Return the content of an object; that of a mode which the drive does not show is its display."""
        found = self._access.peek(entry)
        if found is None and entry.index in _MODES:
            found = self._access.peek(replace(entry, index=entry.index + 1))
        return found

    def _open(self) -> None:
        """Find the file of this drive, once, and take over what it has."""
        if self._path is not None:
            return
        parts = [self._access.peek(entry) for entry in _IDENTITY]
        identity = "-".join(f"{number_of(part):x}" for part in parts)
        self._path = self._path_of(f"{identity}-{os.geteuid()}")
        kept, problem = _load(self._path, self.names)
        if problem:
            self.notes.append(f"{self._path} is not used: {problem}")
        for one in kept:
            if not is_kept(one.entry) or one.is_ours(self._access.peek(one.entry)):
                self._found[one.entry.address] = one
        if self._found:
            self.notes.append(
                f"a run before this one ended without restoring the drive's settings ({len(self._found)} objects, kept "
                f"in {self._path}): they are restored at the end of this one"
            )
        # what killed runs of other users have kept is told alone: who believes it, lets them write to the drive
        pattern = self._path_of(f"{identity}-*")
        self.notes += [
            f"a run of another user ended without restoring the drive's settings ({path}): they are not restored by "
            "this run, but by the next one of that user"
            for path in sorted(pattern.parent.glob(pattern.name))
            if path != self._path
        ]

    def _concerned(self, entry: Object) -> Iterator[Object]:
        """Yield what has to be known to undo a write."""
        yield entry

    def _restoration(self) -> list[list[Step]]:
        """Return what is to be written, in groups that belong together: the last one that was changed first."""
        return [[(one.entry, one.found)] for one in reversed(self._found.values()) if one.found is not None]

    # Restoring

    def restore(self) -> list[str]:
        """Write back what was found; return what could not be restored, in words.

        The caller has made sure that the drive has no power. The file stays as long as something is to be restored.

        Raises `DriveError`: the drive does not answer any more; then everything stays in the file.
        """
        refused = [group for group in self._restoration() if not self._restore_group(group)]
        for group in refused:  # e.g. a value of 60C2h that is too short a time with the exponent of this run
            self._restore_group(group)
        left: dict[Address, Found] = {}
        words = []
        for one in self._found.values():
            present = self._peek(one.entry)
            is_unused = self._is_unused(one.entry)
            if one.found is None and one.is_taken and not is_unused:
                words.append(f"{one.entry} stays {hexadecimal(one.written[-1])}: what it held before is not known")
            elif one.found is not None and present != one.found and (not is_unused or any(one.found)):
                left[one.entry.address] = one
                words.append(f"{one.wish} and stays {hexadecimal(present)}")
        self._found = left
        if left:
            self._save()
        elif self._path is not None:
            with contextlib.suppress(OSError):
                self._path.unlink(missing_ok=True)
        return words

    def _is_unused(self, entry: Object) -> bool:
        """Return True for an object whose content means nothing, given what the others hold again."""
        return False

    def _restore_group(self, group: Sequence[Step]) -> bool:
        """Write a group; return False if the drive refused a part of it."""
        wanted = dict(group)  # the last value of each object
        if all(self._peek(entry) == data for entry, data in wanted.items()):
            return True
        is_taken = True
        for entry, data in group:
            try:
                self._access.download(entry, data)
            except RefusedError:
                is_taken = False  # reported by the comparison afterwards, if it stays so
        return is_taken

    def what_is_left(self) -> list[str]:
        """Return what has not been restored, in words."""
        return [one.wish for one in self._found.values() if one.found is not None]

    # The file

    def _save(self) -> None:
        assert self._path is not None
        entries = [
            {
                "index": one.entry.index,
                "subindex": one.entry.subindex,
                "found": None if one.found is None else one.found.hex(),
                "written": [data.hex() for data in one.written],
            }
            for one in self._found.values()
        ]
        text = json.dumps({"version": _VERSION, "entries": entries})
        new = self._path.with_suffix(".new")
        try:
            with contextlib.suppress(FileNotFoundError):
                new.unlink()
            flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC | os.O_NOFOLLOW
            with os.fdopen(os.open(new, flags, 0o600), "w") as file:
                file.write(text)
            new.replace(self._path)
        except OSError as error:
            text = (
                f"{self._access.axis}: what the drive held before cannot be kept in {self._path}: "
                f"{error.strerror or error}; nothing more is written to the drive"
            )
            raise DriveError(text, code=codes.JOURNAL_FILE) from error


def _load(path: Path, names: Mapping[Address, Object]) -> tuple[list[Found], str]:
    """Return the content of a file that this user wrote, and why it cannot be used, "" where it can."""
    try:
        descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NOFOLLOW)
    except FileNotFoundError:
        return [], ""
    except OSError as error:
        return [], error.strerror or str(error)
    with os.fdopen(descriptor) as file:
        if os.fstat(file.fileno()).st_uid not in (os.geteuid(), 0):
            return [], "it belongs to another user"
        try:
            content = json.load(file)
            if content["version"] != _VERSION:
                return [], "it has another version"
            return [_entry(one, names) for one in content["entries"]], ""
        except (ValueError, KeyError, TypeError) as error:
            return [], f"it is damaged ({error})"


def _entry(one: dict[str, Any], names: Mapping[Address, Object]) -> Found:
    address = int(one["index"]), int(one["subindex"])
    found = None if one["found"] is None else bytes.fromhex(one["found"])
    written = [bytes.fromhex(data) for data in one["written"]]
    entry = names.get(address) or Object(address[0], "(kept)", DataType.UNSIGNED32, address[1])
    return Found(entry, found, written)
