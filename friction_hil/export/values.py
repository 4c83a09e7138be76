"""What a Python expression stands for while a kernel is translated: a number, or something known about the program."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from friction_hil.errors import FrictionHilError
from friction_hil.export.arithmetic import binary
from friction_hil.export.ir import Bounds, Constant, Element, Expression, Load, Type
from friction_hil.numerics.jit import Array


class TranslationError(FrictionHilError):
    """A kernel contains something that has no translation; the message names file and line."""


@dataclass(frozen=True, slots=True)
class Known:
    """A Python object that is no number: a function, a module, a list of functions."""

    value: Any


@dataclass(frozen=True, slots=True)
class Several:
    """A tuple."""

    values: tuple[Any, ...]


@dataclass(frozen=True, slots=True)
class Settings:
    """A record of constants."""

    record: Any


@dataclass(frozen=True, slots=True)
class StateRecord:
    """The state, or a record inside it; ``path`` begins with its fields."""

    path: str = ""


@dataclass(frozen=True, slots=True)
class StateArray:
    """An array of the state from ``begin`` on."""

    path: str
    begin: Expression


@dataclass(frozen=True, slots=True)
class Choice:
    """One of two things that are both known, by a condition that is not."""

    test: Expression
    then: Any
    other: Any


@dataclass(slots=True, eq=False)
class Table:
    """A constant array."""

    name: str
    values: Array
    names: Sequence[str] = ()  # of the parameter in each element; empty for an element without one
    # indices between which the program reads; empty if it reads no element by a variable index
    used: list[int] = field(default_factory=list)

    def name_of(self, k: int) -> str:
        """Return the name of the parameter in an element; empty if it has none."""
        return self.names[k] if k < len(self.names) else ""

    def at(self, index: Expression) -> Expression:
        """Return an element: a constant if its index is one, or if all that it may be are the same."""
        if isinstance(index, Constant):
            k = int(index.value)
            if not 0 <= k < self.values.size:
                raise IndexError(f"{self.name}[{k}] does not exist")
            return Constant("real", float(self.values[k]), name=self.name_of(k))
        low, high = _within(self.name, index, self.values.size)
        first = Constant("real", float(self.values[low]))
        if all(first.is_same(Constant("real", float(each))) for each in self.values[low : high + 1]):
            return first
        self.used = [min([low, *self.used]), max([high, *self.used])]
        return Element("real", self.name, index)


@dataclass(frozen=True, slots=True)
class TableArray:
    """A constant array from ``begin`` on."""

    table: Table
    begin: Expression


@dataclass(slots=True)
class Field:
    """A field of the flat state: its type, what it is at the start, and what the program does with it.

    Until a translation is found to write it, a field is a constant. ``extent`` is the number of elements that are used.
    """

    type: Type
    initial: Array
    is_array: bool
    is_changed: bool = False
    is_used: bool = False
    extent: int = 0


class State:
    """The flat state of a program."""

    def __init__(
        self,
        # record (1,) at the start, as the compiled step takes it; the names of a field inside a record are joined
        initial: Any,
        wide: Sequence[str] = (),  # fields in double precision
        # arrays that hold several things, each a field of its own: name, begin, end
        pieces: dict[str, list[tuple[str, int, int]]] | None = None,
    ) -> None:
        self.fields: dict[str, Field] = {}
        self._pieces = pieces or {}
        self._add(initial[0], "", wide)

    def _add(self, record: Any, prefix: str, wide: Sequence[str]) -> None:
        for name in record.dtype.names:
            path = prefix + name
            if record.dtype[name].names:
                self._add(record[name], f"{path}_", wide)
                continue
            values = np.atleast_1d(np.array(record[name], dtype=np.float64))
            is_array = bool(record.dtype[name].shape)
            parts = self._pieces.get(path, [(path, 0, values.size)])
            for part, begin, end in parts:
                kind: Type = "wide" if path in wide else "real"
                self.fields[part] = Field(kind, values[begin:end], is_array and end - begin > 1)

    def is_array(self, path: str) -> bool:
        """Return True for an array, whether whole or in pieces."""
        return path in self._pieces or (path in self.fields and self.fields[path].is_array)

    def is_scalar(self, path: str) -> bool:
        """Return True for a field that is a single number."""
        return path in self.fields and not self.fields[path].is_array

    def _locate(self, path: str, index: Expression | None) -> tuple[str, Expression | None]:
        """Return the field of an element, and its index there."""
        if index is None or path not in self._pieces:
            return path, index
        low, high = (index.value, index.value) if isinstance(index, Constant) else index.bounds or (None, None)
        for name, begin, end in self._pieces[path]:
            if low is not None and high is not None and begin <= low and high < end:
                return name, shifted(index, -begin)
        raise IndexError(f"{path}: it is not known which part of it is used")

    def load(self, path: str, index: Expression | None) -> Expression:
        """Return the value of a field or of an element."""
        path, index = self._locate(path, index)
        one = self.fields[path]
        low, high = self._range(path, one, index)
        if not one.is_changed:
            first = Constant(one.type, float(one.initial[low]))
            if all(first.is_same(Constant(one.type, float(each))) for each in one.initial[low : high + 1]):
                return first
        one.is_used = True
        one.extent = max(one.extent, high + 1)
        return Load(one.type, path, index if one.is_array else None)

    def target(self, path: str, index: Expression | None, value: Expression) -> Load | None:
        """Return what is to be assigned; None if the field is a constant and stays so."""
        path, index = self._locate(path, index)
        one = self.fields[path]
        low, high = self._range(path, one, index)
        if not one.is_changed and isinstance(value, Constant):
            stays = Constant(one.type, float(value.value))
            if all(stays.is_same(Constant(one.type, float(each))) for each in one.initial[low : high + 1]):
                return None
        one.is_changed = one.is_used = True
        one.extent = max(one.extent, high + 1)
        return Load(one.type, path, index if one.is_array else None)

    @staticmethod
    def _range(path: str, one: Field, index: Expression | None) -> Bounds:
        if index is None:
            return 0, 0
        if isinstance(index, Constant):
            if not 0 <= index.value < one.initial.size:
                raise IndexError(f"{path}[{index.value}] does not exist")
            return int(index.value), int(index.value)
        return _within(path, index, one.initial.size)

    def forget_use(self) -> None:
        """Forget which fields are used, before the next translation."""
        for one in self.fields.values():
            one.is_used, one.extent = False, 0


def _within(name: str, index: Expression, size: int) -> Bounds:
    """Return the indices that an index can be, as far as its bounds tell; those of the array bound it, too."""
    low, high = index.bounds or (0, size - 1)
    low, high = max(low, 0), min(high, size - 1)
    if low > high:
        raise IndexError(f"{name} has no such element")
    return low, high


def shifted(index: Expression, by: int) -> Expression:
    """Return an index plus a number."""
    return binary("+", index, Constant("int", by))


Intrinsic = Callable[..., Any]
