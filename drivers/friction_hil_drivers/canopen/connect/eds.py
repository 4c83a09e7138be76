"""Reading EDS and DCF files, including those with faulty comments."""

import configparser
import io
import re
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from friction_hil.errors import UsageError
from friction_hil_drivers.cia402.objects import Object

if TYPE_CHECKING:
    from canopen import ObjectDictionary

FOLDER = Path(__file__).parents[2] / "eds"
SIMULATED_SERVO = FOLDER / "friction_hil_servo.eds"

_MOST_COMPACT, _MOST_SUBINDEX = 254, 255  # CiA 301: sub-index 255 is the structure of the object
_MOST_BYTES = 8 << 20  # the largest files of vendors have some hundred kilobytes
# Many vendors number their comments wrongly, and canopen fails on that; the comments are not needed.
_COMMENTS = re.compile(r"^\[Comments\][^\[]*", re.MULTILINE | re.IGNORECASE)
_NOT_NEEDED = ("comments", "deviceinfo", "fileinfo")  # canopen fails on numbers in them such as VendorNumber=001
_OBJECT = re.compile(r"([0-9A-Fa-f]{4})(?:[Ss]ub[0-9A-Fa-f]{1,2})?")
_INDEX = re.compile(r"[0-9A-Fa-f]{4}")
_ENTRY = re.compile(r"([0-9A-Fa-f]{4})[S|s]ub([0-9A-Fa-f]+)")
_NAMES = re.compile(r"[0-9A-Fa-f]{4}Name")
_LEADING_ZEROS = re.compile(r"0+([0-7])")  # other numbers with a zero in front are octal to some and decimal to others


def load_eds(path: Path, node: int) -> "ObjectDictionary":
    """Read an EDS or DCF file for the node ``node``; raises `UsageError` for one that cannot be read, or is none."""
    # imported here: canopen takes 0.5 s, and only an axis with an EDS needs it to check a configuration
    import canopen

    if path.suffix.lower() not in (".eds", ".dcf"):
        raise UsageError(f"{path} is not an EDS: its name should end in .eds or .dcf")
    source = io.StringIO()
    source.name = path.name
    try:
        file = _parsed(path)
        file.write(source, space_around_delimiters=False)
        source.seek(0)
        dictionary = canopen.import_od(source, node)
    except (configparser.Error, ValueError, KeyError, TypeError, OverflowError) as error:
        reason = str(error).partition("\n")[0]  # the lines after it quote the file, which may be anything
        raise UsageError(f"{path} is no valid EDS: {reason}") from error
    if len(dictionary) == 0:
        raise UsageError(f"{path} is not an EDS: it has no object")
    return dictionary


class EdsObjects:
    """Objects of one axis of a node, as its file describes them."""

    def __init__(self, dictionary: "ObjectDictionary", axis: int = 0) -> None:
        self._dictionary, self._axis = dictionary, axis

    def variable(self, entry: Object) -> Any:
        """Return the canopen library's variable, None where the file has no such object."""
        try:
            return self._dictionary.get_variable(*entry.of_axis(self._axis).address)
        except KeyError:
            return None

    def has(self, entry: Object) -> bool:
        """Return True for an object that is in the file."""
        return self.variable(entry) is not None

    def width(self, entry: Object) -> int | None:
        """Return the width of an object in bits, None where the file has no such object."""
        variable = self.variable(entry)
        return None if variable is None else len(variable)

    def value(self, entry: Object) -> int | None:
        """Return the value of an integer; None where the file gives none, as many do."""
        variable = self.variable(entry)
        value = None if variable is None else variable.default if variable.value is None else variable.value
        return value if isinstance(value, int) else None


def compact_arrays(path: Path) -> dict[int, int]:
    """Return the numbers of entries, by index, of the arrays that a file describes once for all entries (CiA 306)."""
    file = _parsed(path)
    return {
        int(section, 16): count
        for section in file.sections()
        if _INDEX.fullmatch(section)
        if (count := int(file.get(section, "CompactSubObj", fallback="0"), 0))
    }


def _parsed(path: Path) -> configparser.RawConfigParser:
    """Return the sections on objects, with numbers of which canopen makes no more work than the file has lines.

    Raises `UsageError`: the file cannot be read, or a number in it is none. `configparser.Error`: it has no sections.
    """
    try:
        if not path.is_file():
            raise UsageError(
                f"the EDS {path} cannot be read: " + ("it is no file" if path.exists() else "No such file")
            )
        if (size := path.stat().st_size) > _MOST_BYTES:
            raise UsageError(f"the EDS {path} has {size / 1e6:.3g} MB; {_MOST_BYTES / 1e6:.3g} MB are the most")
        text = path.read_text(encoding="utf-8-sig", errors="replace")  # Windows tools begin files with a mark
    except OSError as error:
        raise UsageError(f"the EDS {path} cannot be read: {error.strerror or error}") from error
    file = configparser.RawConfigParser(inline_comment_prefixes=(";",))
    file.optionxform = str  # type: ignore[assignment, method-assign]
    file.read_string(_COMMENTS.sub("", text), source=path.name)
    objects = {int(section, 16) for section in file.sections() if _INDEX.fullmatch(section)}
    for section in file.sections():
        if section.lower() in _NOT_NEEDED:
            file.remove_section(section)
            continue
        for key, most in _numbers(section):
            if file.has_option(section, key):
                file.set(section, key, _checked(path, section, key, file.get(section, key), most))
        entry = _ENTRY.fullmatch(section)
        if entry and (int(entry[2], 16) > _MOST_SUBINDEX or int(entry[1], 16) not in objects):
            raise UsageError(f"{path} is no valid EDS: [{section}] belongs to no object that the file describes")
        if section.lower() == "dummyusage":
            for key in (f"Dummy{k:04d}" for k in range(1, 8)):
                file.set(section, key, _checked(path, section, key, file.get(section, key, fallback="0"), 1))
    file.add_section("DeviceInfo")  # canopen complains of a file without
    return file


def _numbers(section: str) -> Iterator[tuple[str, int]]:
    """Yield keys of a section that have a number, and the largest one."""
    if _OBJECT.fullmatch(section):
        yield from (("ObjectType", 0xFF), ("DataType", 0xFFFF), ("PDOMapping", 0xFF), ("CompactSubObj", _MOST_COMPACT))
    elif _NAMES.match(section):
        yield "NrOfEntries", _MOST_COMPACT


def _checked(path: Path, section: str, key: str, text: str, most: int) -> str:
    """Return a number without zeros in front; raises `UsageError` if it is none, or too large."""
    found = _LEADING_ZEROS.fullmatch(text)
    try:
        number = int(found[1] if found else text, 0)
    except ValueError:
        number = -1
    if not 0 <= number <= most:
        raise UsageError(f"{path} is no valid EDS: [{section}] {key}={text[:40]}: must be a number from 0 to {most}")
    return str(number)
