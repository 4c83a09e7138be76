"""Products of columns of a file, reinterpreted registers and factors. Pure.

``load:int16*input_volts/885`` is the column ``load``, reinterpreted as a signed register of 16 bits, times the column
``input_volts``, divided by 885.
"""

import math
import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from friction_hil.errors import UsageError, choices

Array = NDArray[np.float64]

NUMBER = r"(?:pi|(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][-+]?[0-9]+)?)"
_LARGEST_ROUNDING = 0.25  # of a step, of a register that was multiplied and rounded before it was logged
_REGISTERS = ("int8", "int16", "int32", "uint8", "uint16", "uint32")
_FACTOR = re.compile(rf"([*/])\s*(-?)({NUMBER})")
_NUMBERS = re.compile(rf"-?{NUMBER}(?:\s*/\s*-?{NUMBER})*")
_SCALED = re.compile(rf"\s*/\s*({NUMBER})\s*$")
_TERM = re.compile(
    rf"(?P<column>.*?)\s*(?::\s*(?P<register>{'|'.join(_REGISTERS)}))?\s*(?P<factors>(?:/\s*-?{NUMBER}\s*)*)", re.DOTALL
)


@dataclass(frozen=True, slots=True)
class Term:
    """A column of the file, and the type of ``register`` as which it is reinterpreted; empty: unchanged.

    ``divisor`` is what the register had been multiplied by before it was logged.
    """

    column: str
    register: str = ""
    divisor: float = 1.0


@dataclass(frozen=True, slots=True)
class Product:
    """Columns of the file to be multiplied, and a factor."""

    terms: tuple[Term, ...]
    factor: float = 1.0

    @property
    def is_plain(self) -> bool:
        """True if it is one unchanged column."""
        return len(self.terms) == 1 and not self.terms[0].register and self.factor == 1.0

    def missing(self, there: Collection[str]) -> str:
        """Return the name of the first column that is not there; empty if all are."""
        return next((term.column for term in self.terms if term.column not in there), "")

    def values(self, there: Mapping[str, Array]) -> Array:
        """Compute the product (n,) of columns (n,) of the file; NaN where one of the columns is NaN.

        Raises `UsageError`: a column has a value that no such register can have, or the product overflows.
        """
        values = [_reinterpreted(there[term.column], term) for term in self.terms]
        with np.errstate(over="ignore", invalid="ignore"):
            product: Array = np.prod(values, axis=0) * self.factor
        if np.isinf(product[np.isfinite(values).all(axis=0)]).any():
            raise UsageError("what results is too large for a number")
        return product


def product_of(source: str, there: Collection[str]) -> Product:
    """Parse a source of columns, which need not exist: ``load``, ``load:int16``, ``load:int16*input_volts/885``.

    Columns and numbers are separated by ``*``; only numbers may follow ``/``. Names may contain any character: an
    existing column takes precedence over every other meaning, the longest name first.

    ``there``: columns of the file. Raises `UsageError`: a ``*`` lacks an operand, or a factor is zero or not finite.
    """
    if source in there:
        return Product((Term(source),))
    terms, factor = [], 1.0
    pieces = source.split("*")
    begin = 0
    while begin < len(pieces):
        spans = {end: "*".join(pieces[begin:end]).strip() for end in range(len(pieces), begin, -1)}
        known = (end for end, text in spans.items() if text in there or _split(text, there)[0].column in there)
        end = next(known, begin + 1)
        text, begin = spans[end], end
        if not text:
            raise UsageError(f"{source!r}: a column or a number is missing beside a *")
        if _NUMBERS.fullmatch(text):
            factor *= factor_of(f"*{text}", source)
            continue
        term, factors = (Term(text), "") if text in there else _split(text, there)
        terms.append(term)
        factor *= factor_of(factors, source)
    return Product(tuple(terms), factor) if terms else Product((Term(source),))


def possible_columns(source: str) -> set[str]:
    """Return the names of all columns that a source may refer to, existing or not."""
    pieces = source.split("*")
    ends = range(1, len(pieces) + 1)
    texts = {"*".join(pieces[begin:end]).strip() for end in ends for begin in range(end)}
    columns = {_split(text)[0].column for text in texts}
    return {source, *texts, *columns, *(_SCALED.sub("", column) for column in columns)}


def columns_of(source: str) -> list[str]:
    """Return the names of the columns of a product whose names have no ``*``."""
    pieces = [piece.strip() for piece in source.split("*")]
    return [_split(piece)[0].column for piece in pieces if piece and not _NUMBERS.fullmatch(piece)]


def absent(column: str, there: Collection[str]) -> str:
    """Return a sentence with the existing choices for a column that does not exist."""
    name, colon, register = column.rpartition(":")
    if colon and name.strip() in there:
        return f"{register.strip()!r} is no type of register; there are {', '.join(_REGISTERS)}"
    return choices(column, there)


def factor_of(factors: str, text: str) -> float:
    """Compute the value of ``*2*pi/4096``; 1 if the text is empty.

    Raises `UsageError`: the factor or a number in it is zero or not finite; the message begins with the whole ``text``.
    """
    factor = 1.0
    for operator, sign, number in _FACTOR.findall(factors):
        value = math.pi if number == "pi" else float(number)
        value = -value if sign else value
        if value == 0.0 or not math.isfinite(value):
            raise UsageError(f"{text!r}: a factor is finite and not zero")
        factor = factor * value if operator == "*" else factor / value
    if factor == 0.0 or not math.isfinite(factor):
        raise UsageError(f"{text!r}: a factor is finite and not zero")
    return factor


def _split(text: str, there: Collection[str] | None = None) -> tuple[Term, str]:
    """Split ``load:int16/885`` into the column with its register and the factors; ``load/2.69:int16`` as well."""
    found = _TERM.fullmatch(text)
    assert found is not None  # any text is a name
    column, register = found["column"].strip(), found["register"] or ""
    scaled = _SCALED.search(column) if register else None
    if scaled is None or (there is not None and (column in there or column[: scaled.start()].strip() not in there)):
        return Term(column, register), found["factors"]
    return Term(column[: scaled.start()].strip(), register, factor_of(f"*{scaled[1]}", text)), found["factors"]


def _reinterpreted(values: Array, term: Term) -> Array:
    """Return the values of a column as its register, whether they were recorded as signed or unsigned."""
    if not term.register:
        return values
    kind, bits = term.register.split("int")
    top = 2.0 ** int(bits)
    if term.divisor != 1.0:
        scaled = values / term.divisor
        values = np.round(scaled)
        off = scaled[np.abs(scaled - values) > _LARGEST_ROUNDING]
        if off.size:
            raise UsageError(f"{term.column}/{term.divisor:g} is no register: it holds {off[0]:.10g}")
    known = values[~np.isnan(values)]
    wrong = known[(known < -top / 2.0) | (known >= top) | (known != np.floor(known))]
    if wrong.size:
        raise UsageError(f"{term.column} is no register of {bits} bits: it holds {wrong[0]:.10g}")
    lowest = 0.0 if kind == "u" else -top / 2.0
    again: Array = np.mod(values - lowest, top) + lowest
    return again
