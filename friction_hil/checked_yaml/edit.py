"""Values of a YAML file changed in its text, so that comments, order and the other lines stay as they are."""

import contextlib
import os
import re
import shutil
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import yaml

from friction_hil.checked_yaml.text import FieldPath, dump, parse, read
from friction_hil.errors import ConfigurationError, FrictionHilError

_BOM = "\ufeff"


def edit(path: Path, changes: Mapping[FieldPath, Any]) -> None:
    """Set values of a YAML file; a link stays a link, and a file that cannot be written stays whole.

    Raises `FrictionHilError`: the file cannot be written, or a value cannot be changed by itself.
    """
    read(path)  # refuses what is no YAML, with its line
    path = path.resolve()
    old = path.read_bytes().decode("utf-8")
    new = old.removeprefix(_BOM)
    for steps, value in changes.items():
        new = with_value(new, steps, value, str(path))
    partial = ""
    try:
        with tempfile.NamedTemporaryFile("w", dir=path.parent, delete=False, encoding="utf-8", newline="") as file:
            partial = file.name
            file.write(_BOM + new if old.startswith(_BOM) else new)
            file.flush()
            os.fsync(file.fileno())
        shutil.copymode(path, partial)
        os.replace(partial, path)
    except OSError as error:
        with contextlib.suppress(OSError):
            os.unlink(partial)
        raise FrictionHilError(f"{path} cannot be written: {error.strerror}") from None


def with_value(text: str, steps: FieldPath, value: Any, path: str = "") -> str:
    """Return YAML ``text`` with one value of its groups of keys set or added.

    Raises `FrictionHilError`: other values would change with it, e.g. because the value stands behind an anchor.
    """
    wanted = parse(text, path).value
    group = wanted
    for step in steps[:-1]:
        if not isinstance(group.get(step), dict):
            group[step] = {}
        group = group[step]
    group[steps[-1]] = value
    try:
        new = _changed(text, steps, value)
        if parse(new, path).value == wanted:
            return new
    except ConfigurationError:
        pass
    where = ".".join(map(str, steps))
    raise FrictionHilError(
        f"{path}: {where} cannot be changed without changing more, e.g. because of an anchor (&name) or a merge (<<): "
        f"write {where}: {_flow(value)} by hand"
    )


def _changed(text: str, steps: FieldPath, value: Any) -> str:
    node: Any = yaml.compose(text, Loader=yaml.SafeLoader)  # its marks count characters
    after_key = 0
    for k, step in enumerate(steps):
        entries = node.value if isinstance(node, yaml.MappingNode) else []
        found = next((entry for entry in entries if entry[0].value == step), None)
        if found is None and entries:
            return _added(text, node, steps[k:], value)
        if found is None:
            for each in reversed(steps[k:]):
                value = {each: value}
            break
        after_key, node = text.index(":", found[0].end_mark.index) + 1, found[1]
    is_below = isinstance(node, yaml.CollectionNode) and not node.flow_style  # its key, where comments may stand too
    begin, end = after_key if is_below else node.start_mark.index, _end(node)
    new = f"{'' if text[begin - 1 : begin].isspace() else ' '}{_flow(value)}"
    after = text[end:]
    if is_below and (comment := re.match(r"[ \t]*#[^\r\n]*", after)):  # on the last line of what goes
        after = after[comment.end() :]
    elif comment := re.match(r" +(?=#)", after):  # comments stay in their column
        after = " " * max(comment.end() + end - begin - len(new), 1) + after[comment.end() :]
    return text[:begin] + new + after


def _added(text: str, group: yaml.MappingNode, steps: FieldPath, value: Any) -> str:
    """Add a key to a group that has others, behind the last of them."""
    for step in reversed(steps[1:]):
        value = {step: value}
    last = _end(group.value[-1][1])
    if group.flow_style:
        return f"{text[:last]}, {steps[0]}: {_flow(value)}{text[last:]}"
    end = text.find("\n", last)
    if text[last - 1] == "\n":  # a text of several lines
        end = last - 1
    line_end = "\r\n" if "\r\n" in text else "\n"
    before, after = (text, "") if end < 0 else (text[:end].removesuffix("\r"), text[end + 1 :])
    indent = " " * group.value[0][0].start_mark.column
    return f"{before}{line_end}{indent}{steps[0]}: {_flow(value)}{line_end}{after}"


def _end(node: yaml.Node) -> int:
    """Return where the text of a value ends; that of a group, below which comments may stand, with its last value."""
    if isinstance(node, yaml.CollectionNode) and not node.flow_style and node.value:
        last = node.value[-1]
        return _end(last[1] if isinstance(last, tuple) else last)
    return int(node.end_mark.index)


def _flow(value: Any) -> str:
    """Return a value in one line."""
    if isinstance(value, dict):
        return "{" + ", ".join(f"{key}: {_flow(each)}" for key, each in value.items()) + "}"
    return dump([value]).strip()[1:-1]
