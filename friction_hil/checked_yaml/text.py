"""Conversion of YAML text to plain values by the core schema of YAML 1.2, with the line of each key and value.

PyYAML does the parsing. The scalars are interpreted here, because PyYAML follows YAML 1.1, which reads ``1:30`` as 90,
``on`` as true, ``012`` as 10 and ``1e-3`` as text. Duplicate keys, tags and further documents are mistakes. Anchors
and merge keys (``<<``) work; their expansion is limited.
"""

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

from friction_hil.errors import ConfigurationError, Problem

FieldPath = tuple[str | int, ...]  # keys and list indices from the root to a value

_PARSER = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
_LARGEST_FILE = 16 * 2**20  # bytes
_MOST_VALUES = 200_000  # with anchors expanded
_DEEPEST = 50
_TOO_DEEP = f"more than {_DEEPEST} nested levels are not allowed"
_TEXT = "tag:yaml.org,2002:str"

# YAML 1.2.2, section 10.3.2, except for leading zeros: 012 is 10 in YAML 1.1 and 12 in 1.2, hence it is text here.
_NULL = re.compile(r"null|Null|NULL|~|")
_BOOL = re.compile(r"true|True|TRUE|false|False|FALSE")
_INT = re.compile(r"[-+]?(?:0|[1-9][0-9]*)|0o[0-7]+|0x[0-9a-fA-F]+")
_FLOAT = re.compile(r"[-+]?(?:\.[0-9]+|[0-9]+(?:\.[0-9]*)?)(?:[eE][-+]?[0-9]+)?")
_INF = re.compile(r"[-+]?\.(?:inf|Inf|INF)")
_NAN = re.compile(r"\.(?:nan|NaN|NAN)")


def resolve(text: str) -> bool | int | float | str | None:
    """Return the value of the plain scalar ``text``; an `OverflowError`: the number is too large for a double."""
    if _NULL.fullmatch(text):
        return None
    if _BOOL.fullmatch(text):
        return text.lower() == "true"
    if _INT.fullmatch(text):
        if len(text) > 400:
            raise OverflowError
        number = int(text, 0)
        float(number)
        return number
    if _FLOAT.fullmatch(text) and not re.fullmatch(r"[-+]?0[0-9]+", text):
        value = float(text)
        if math.isinf(value):
            raise OverflowError
        return value
    if _INF.fullmatch(text):
        return -math.inf if text[0] == "-" else math.inf
    if _NAN.fullmatch(text):
        return math.nan
    return text


@dataclass(slots=True)
class YamlNode:
    """A value with its line: a scalar, a list of nodes, or a dict of (line of the key, node).

    ``size`` is the number of values in it, ``depth`` the number of levels.
    """

    value: Any
    line: int
    size: int = 1
    depth: int = 1


@dataclass(slots=True)
class Document:
    """One file: its plain ``value``, and the line of each part of it."""

    path: str
    value: Any
    root: YamlNode | None = None
    problems: list[Problem] = field(default_factory=list)

    def line(self, steps: FieldPath) -> int | None:
        """Return the line of the deepest existing part of the field path ``steps``; None if there is no text."""
        if self.root is None:
            return None
        node, line = self.root, self.root.line
        for step in steps:
            if isinstance(node.value, dict) and step in node.value:
                line, node = node.value[step]
            elif isinstance(node.value, list) and isinstance(step, int) and step < len(node.value):
                node = node.value[step]
                line = node.line
            else:
                break
        return line


def read(path: str | Path) -> Document:
    """Read a YAML file.

    Raises `ConfigurationError`: the file cannot be read, or is not YAML. Other mistakes are in ``problems`` of the
    returned document.
    """
    where = str(path)
    try:
        with open(path, "rb") as file:
            data = file.read(_LARGEST_FILE + 1)
    except OSError as error:
        raise _error(where, None, f"cannot be read: {error.strerror}") from None
    if len(data) > _LARGEST_FILE:
        raise _error(where, None, f"is larger than {_LARGEST_FILE >> 20} MiB")
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        message = f"byte {data[error.start]:#04x} is not UTF-8: save the file in the encoding UTF-8"
        raise _error(where, line, message) from None
    return parse(text, where)


def parse(text: str, path: str) -> Document:
    """Parse YAML ``text``; ``path`` is the file name for messages.

    Raises `ConfigurationError`: the text is not YAML. Other mistakes are in ``problems`` of the returned document.
    """
    try:
        root, problems = _Builder(yaml.parse(text, Loader=_PARSER), path).build()
    except UnicodeEncodeError as error:
        raise _error(path, text.count("\n", 0, error.start) + 1, "contains an invalid character") from None
    except yaml.reader.ReaderError as error:
        line = text.encode().count(b"\n", 0, error.position) + 1
        raise _error(path, line, f"the character U+{error.character:04X} is not allowed") from None
    except yaml.MarkedYAMLError as error:
        raise _error(path, *_explain(error, text)) from None
    return Document(path, _plain(root), root, problems)


def dump(value: Any) -> str:
    """Write plain values as YAML that `parse` reads back as the same values."""
    return yaml.dump(value, Dumper=_Dumper, sort_keys=False, allow_unicode=True, width=100, default_flow_style=None)


class _Builder:
    """Builder of nodes from the parser's events; its work is proportional to the text, not to expanded anchors."""

    def __init__(self, events: Iterator[Any], path: str) -> None:
        self._events = events
        self._path = path
        self._anchors: dict[str, YamlNode | None] = {}
        self._problems: list[Problem] = []

    def build(self) -> tuple[YamlNode, list[Problem]]:
        next(self._events)  # start of the stream
        if isinstance(next(self._events), yaml.StreamEndEvent):
            raise _error(self._path, None, "is empty")
        root = self._node(next(self._events), 1)
        next(self._events)  # end of the document
        after = next(self._events)
        if not isinstance(after, yaml.StreamEndEvent):
            raise _error(self._path, _line(after), "a second document begins here ('---'); only one is allowed")
        return root, self._problems

    def _node(self, event: Any, depth: int) -> YamlNode:
        line = _line(event)
        if depth > _DEEPEST:
            raise _error(self._path, line, _TOO_DEEP)
        if isinstance(event, yaml.AliasEvent):
            return self._alias(event, line)
        if event.tag not in (None, "!"):
            tag = event.tag.replace("tag:yaml.org,2002:", "!!")
            self._report(line, f"tags such as {tag} are not allowed; remove it")
        if event.anchor is not None:
            self._anchors[event.anchor] = None  # defined, but not complete
        node = YamlNode(None, line)
        if isinstance(event, yaml.ScalarEvent):
            node.value = self._scalar(event, line)
        elif isinstance(event, yaml.SequenceStartEvent):
            node.value = self._sequence(node, depth)
        else:
            node.value = self._mapping(node, depth)
        if node.size > _MOST_VALUES or node.depth > _DEEPEST:
            raise _error(self._path, line, f"contains more than {_MOST_VALUES} values or {_DEEPEST} levels")
        if event.anchor is not None:
            self._anchors[event.anchor] = node
        return node

    def _alias(self, event: Any, line: int) -> YamlNode:
        if event.anchor not in self._anchors:
            raise _error(self._path, line, f"*{event.anchor} refers to an anchor that is not defined above")
        node = self._anchors[event.anchor]
        if node is None:
            raise _error(self._path, line, f"*{event.anchor} refers to a value that it is part of")
        return node

    def _scalar(self, event: Any, line: int) -> bool | int | float | str | None:
        if not event.implicit[0] or event.tag == "!":
            return str(event.value)
        try:
            return resolve(event.value)
        except OverflowError:
            self._report(line, f"{event.value[:40]} is too large for a number; write .inf for infinity")
            return 0

    def _sequence(self, node: YamlNode, depth: int) -> list[YamlNode]:
        items: list[YamlNode] = []
        while not isinstance(event := next(self._events), yaml.SequenceEndEvent):
            items.append(self._node(event, depth + 1))
            _grow(node, items[-1])
        return items

    def _mapping(self, node: YamlNode, depth: int) -> dict[str, tuple[int, YamlNode]]:
        entries: dict[str, tuple[int, YamlNode]] = {}
        merged: dict[str, tuple[int, YamlNode]] = {}
        while not isinstance(event := next(self._events), yaml.MappingEndEvent):
            line = _line(event)
            if not isinstance(event, yaml.ScalarEvent):
                raise _error(self._path, line, "a key must be a text on one line")
            value = self._node(next(self._events), depth + 1)
            _grow(node, value)
            if event.value == "<<" and event.implicit[0]:
                merged = {**self._merged(value, line), **merged}
            elif event.value in entries:
                first = entries[event.value][0]
                self._report(line, f"is given twice (first in line {first})", event.value)
            else:
                entries[event.value] = (line, value)
        return {**merged, **entries}

    def _merged(self, value: YamlNode, line: int) -> dict[str, tuple[int, YamlNode]]:
        sources = value.value if isinstance(value.value, list) else [value]
        merged: dict[str, tuple[int, YamlNode]] = {}
        for source in reversed(sources):  # the first of several has priority
            if isinstance(source.value, dict):
                merged |= source.value
            else:
                self._report(line, "can only merge groups of keys, e.g. <<: *anchor", "<<")
        return merged

    def _report(self, line: int, message: str, name: str = "") -> None:
        self._problems.append(Problem(self._path, line, name, message))


def _grow(node: YamlNode, child: YamlNode) -> None:
    node.size += child.size
    node.depth = max(node.depth, child.depth + 1)


def _plain(node: YamlNode) -> Any:
    if isinstance(node.value, dict):
        return {key: _plain(child) for key, (_, child) in node.value.items()}
    if isinstance(node.value, list):
        return [_plain(child) for child in node.value]
    return node.value


def _line(event: Any) -> int:
    return int(event.start_mark.line) + 1


def _error(path: str, line: int | None, message: str) -> ConfigurationError:
    return ConfigurationError([Problem(path, line, "", message)])


def _explain(error: yaml.MarkedYAMLError, text: str) -> tuple[int | None, str]:
    """Return line and message of a syntax error."""
    mark = error.problem_mark or error.context_mark
    if mark is None:
        return None, f"is not YAML: {error.problem}"
    lines = text.splitlines()
    row = lines[mark.line] if mark.line < len(lines) else ""
    character = row[mark.column : mark.column + 1]
    problem = str(error.problem)
    if character == "\t" or "\t" in row[: len(row) - len(row.lstrip())]:
        return mark.line + 1, "a tab is not allowed as indentation in YAML; use spaces"
    if "nesting depth" in problem:  # a limit of libyaml's own, since PyYAML 6.0.4
        return mark.line + 1, _TOO_DEEP
    if "cannot start any token" in problem:
        return mark.line + 1, f"a text that begins with {character!r} needs quotes"
    if "mapping values are not allowed" in problem:
        message = "a ':' is not allowed here; check the indentation, and quote texts that contain ': '"
        return mark.line + 1, message
    context = f" {error.context}" if error.context else ""
    if error.context_mark is not None and error.context_mark.line != mark.line:
        context += f" that begins in line {error.context_mark.line + 1}"
    return mark.line + 1, f"is not YAML: {problem}{context}"


class _Dumper(yaml.SafeDumper):
    """YAML writer that quotes every text that would otherwise be read as another type."""

    def ignore_aliases(self, data: Any) -> bool:
        return True


def _represent_text(dumper: yaml.SafeDumper, text: str) -> yaml.ScalarNode:
    if not text.isprintable():
        return dumper.represent_scalar(_TEXT, text, style='"')  # PyYAML breaks U+0085 in any other style
    try:
        is_plain = isinstance(resolve(text), str) and text != "<<"
    except OverflowError:
        is_plain = False
    return dumper.represent_scalar(_TEXT, text, style=None if is_plain else "'")


_Dumper.add_representer(str, _represent_text)
