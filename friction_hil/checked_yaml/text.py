"""YAML text to plain values, with the line of each key and value, by the core schema of YAML 1.2.

PyYAML parses; what a scalar means is decided here, because YAML 1.1, which PyYAML follows, reads ``1:30`` as
90, ``on`` as true, ``012`` as 10 and ``1e-3`` as text. Duplicate keys, tags and further documents are
mistakes. Anchors and merge keys (``<<``) work; how far they may expand is bounded.
"""

import math
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

from friction_hil.errors import ConfigurationError, Problem

Steps = tuple[str | int, ...]  # the way to a value: keys and list indices

_PARSER = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
_LARGEST_FILE = 16 * 2**20  # bytes
_MOST_VALUES = 200_000  # with anchors expanded
_DEEPEST = 50
_TEXT = "tag:yaml.org,2002:str"

# YAML 1.2.2, section 10.3.2, but for leading zeros: 012 is 10 to YAML 1.1 and 12 to 1.2, hence text here.
_NULL = re.compile(r"null|Null|NULL|~|")
_BOOL = re.compile(r"true|True|TRUE|false|False|FALSE")
_INT = re.compile(r"[-+]?(?:0|[1-9][0-9]*)|0o[0-7]+|0x[0-9a-fA-F]+")
_FLOAT = re.compile(r"[-+]?(?:\.[0-9]+|[0-9]+(?:\.[0-9]*)?)(?:[eE][-+]?[0-9]+)?")
_INF = re.compile(r"[-+]?\.(?:inf|Inf|INF)")
_NAN = re.compile(r"\.(?:nan|NaN|NAN)")


def resolve(text: str) -> bool | int | float | str | None:
    """Return what the plain scalar ``text`` means.

    Raises
    ------
    OverflowError
        It is a number too large for a double.
    """
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
class Node:
    """A value with its line: a scalar, a list of nodes, or a dict of (line of the key, node)."""

    value: Any
    line: int
    size: int = 1
    depth: int = 1


@dataclass(slots=True)
class Document:
    """One file: its ``value``, free of marks, and where each part of it stands."""

    path: str
    value: Any
    root: Node | None = None
    problems: list[Problem] = field(default_factory=list)

    def line(self, steps: Steps) -> int | None:
        """Line of the deepest part of the way ``steps`` that exists; None where the text is not known."""
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

    Raises
    ------
    ConfigurationError
        It cannot be read, or is no YAML. Lesser mistakes are in ``problems`` of what is returned.
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
    """Parse YAML ``text``; ``path`` is what its mistakes are reported under.

    Raises
    ------
    ConfigurationError
        The text is no YAML. Lesser mistakes are in ``problems`` of what is returned.
    """
    try:
        root, problems = _Builder(yaml.parse(text, Loader=_PARSER), path).build()
    except UnicodeEncodeError as error:
        raise _error(path, text.count("\n", 0, error.start) + 1, "holds what is no character") from None
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
    """Makes nodes of the parser's events; the size of the text bounds its work, not what anchors expand to."""

    def __init__(self, events: Iterator[Any], path: str) -> None:
        self._events = events
        self._path = path
        self._anchors: dict[str, Node | None] = {}
        self._problems: list[Problem] = []

    def build(self) -> tuple[Node, list[Problem]]:
        next(self._events)  # start of the stream
        if isinstance(next(self._events), yaml.StreamEndEvent):
            raise _error(self._path, None, "is empty")
        root = self._node(next(self._events), 1)
        next(self._events)  # end of the document
        after = next(self._events)
        if not isinstance(after, yaml.StreamEndEvent):
            raise _error(self._path, _line(after), "a second document begins here ('---'): one is enough")
        return root, self._problems

    def _node(self, event: Any, depth: int) -> Node:
        line = _line(event)
        if depth > _DEEPEST:
            raise _error(self._path, line, f"more than {_DEEPEST} levels are nested here")
        if isinstance(event, yaml.AliasEvent):
            return self._alias(event, line)
        if event.tag not in (None, "!"):
            tag = event.tag.replace("tag:yaml.org,2002:", "!!")
            self._report(line, f"tags such as {tag} have no use here: remove it")
        if event.anchor is not None:
            self._anchors[event.anchor] = None  # known, but not complete
        node = Node(None, line)
        if isinstance(event, yaml.ScalarEvent):
            node.value = self._scalar(event, line)
        elif isinstance(event, yaml.SequenceStartEvent):
            node.value = self._sequence(node, depth)
        else:
            node.value = self._mapping(node, depth)
        if node.size > _MOST_VALUES or node.depth > _DEEPEST:
            raise _error(self._path, line, f"holds more than {_MOST_VALUES} values or {_DEEPEST} levels")
        if event.anchor is not None:
            self._anchors[event.anchor] = node
        return node

    def _alias(self, event: Any, line: int) -> Node:
        if event.anchor not in self._anchors:
            raise _error(self._path, line, f"*{event.anchor} refers to an anchor that is not defined above")
        node = self._anchors[event.anchor]
        if node is None:
            raise _error(self._path, line, f"*{event.anchor} refers to what it is part of")
        return node

    def _scalar(self, event: Any, line: int) -> bool | int | float | str | None:
        if not event.implicit[0] or event.tag == "!":
            return str(event.value)
        try:
            return resolve(event.value)
        except OverflowError:
            self._report(line, f"{event.value[:40]} is too large for a number; write .inf where infinity is meant")
            return 0

    def _sequence(self, node: Node, depth: int) -> list[Node]:
        items: list[Node] = []
        while not isinstance(event := next(self._events), yaml.SequenceEndEvent):
            items.append(self._node(event, depth + 1))
            _grow(node, items[-1])
        return items

    def _mapping(self, node: Node, depth: int) -> dict[str, tuple[int, Node]]:
        entries: dict[str, tuple[int, Node]] = {}
        merged: dict[str, tuple[int, Node]] = {}
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

    def _merged(self, value: Node, line: int) -> dict[str, tuple[int, Node]]:
        sources = value.value if isinstance(value.value, list) else [value]
        merged: dict[str, tuple[int, Node]] = {}
        for source in reversed(sources):  # of several, the first counts
            if isinstance(source.value, dict):
                merged |= source.value
            else:
                self._report(line, "can only merge groups of keys, e.g. <<: *anchor", "<<")
        return merged

    def _report(self, line: int, message: str, name: str = "") -> None:
        self._problems.append(Problem(self._path, line, name, message))


def _grow(node: Node, child: Node) -> None:
    node.size += child.size
    node.depth = max(node.depth, child.depth + 1)


def _plain(node: Node) -> Any:
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
    """Line and message of what the parser did not understand."""
    mark = error.problem_mark or error.context_mark
    if mark is None:
        return None, f"is no YAML: {error.problem}"
    lines = text.splitlines()
    row = lines[mark.line] if mark.line < len(lines) else ""
    character = row[mark.column : mark.column + 1]
    problem = str(error.problem)
    if character == "\t" or "\t" in row[: len(row) - len(row.lstrip())]:
        return mark.line + 1, "a tab stands where YAML wants spaces: indent with spaces"
    if "cannot start any token" in problem:
        return mark.line + 1, f"a text that begins with {character!r} needs quotes"
    if "mapping values are not allowed" in problem:
        message = "a ':' stands where no key can be; check the indentation, and quote texts that contain ': '"
        return mark.line + 1, message
    context = f" {error.context}" if error.context else ""
    if error.context_mark is not None and error.context_mark.line != mark.line:
        context += f" that begins in line {error.context_mark.line + 1}"
    return mark.line + 1, f"is no YAML: {problem}{context}"


class _Dumper(yaml.SafeDumper):
    """Quotes every text that would otherwise be read as something else."""

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
