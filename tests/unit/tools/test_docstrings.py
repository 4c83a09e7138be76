"""Sections (Parameters, Raises ...) stand in the public interface; inside, a line and comments at the fields say it."""

import ast
import inspect
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path

import friction_hil as fh

PROJECT = Path(__file__).parents[3]
PORT = {"friction_hil/drive/driver.py", "friction_hil/drive/port.py", "friction_hil/errors.py"}
SECTIONS = {"Parameters", "Attributes", "Returns", "Yields", "Raises"}


def exported() -> set[tuple[str, str]]:
    """File and name of everything that the public modules export."""
    public: list[object] = []
    for each in (getattr(fh, name) for name in fh.__all__):
        public += (
            [value for name, value in vars(each).items() if not name.startswith("_")]
            if inspect.ismodule(each)
            else inspect.getmro(each)
            if inspect.isclass(each)
            else [each]
        )
    found = set()
    for each in public:
        if inspect.isfunction(each) or (inspect.isclass(each) and each is not object):
            source = Path(inspect.getsourcefile(each) or "")
            if source.is_relative_to(PROJECT):
                found.add((str(source.relative_to(PROJECT)), each.__qualname__))
    return found


def sectioned(path: Path) -> Iterator[str]:
    """Names of the top level of a file in whose docstrings, or those of their methods, sections stand."""
    for node in ast.parse(path.read_text(encoding="utf-8")).body:
        if not isinstance(node, ast.ClassDef | ast.FunctionDef):
            continue
        for each in ast.walk(node):
            if isinstance(each, ast.ClassDef | ast.FunctionDef):
                lines = [line.strip() for line in (ast.get_docstring(each) or "").splitlines()]
                if any(a in SECTIONS and b and set(b) == {"-"} for a, b in pairwise(lines)):
                    yield node.name
                    break


def test_sections_stand_in_the_public_interface_alone() -> None:
    public = exported()
    inside = []
    for path in sorted([*(PROJECT / "friction_hil").rglob("*.py"), *(PROJECT / "drivers").rglob("*.py")]):
        file = str(path.relative_to(PROJECT))
        inside += [f"{file}: {name}" for name in sectioned(path) if file not in PORT and (file, name) not in public]
    assert inside == [], "say it in a line, and at the field or parameter"
