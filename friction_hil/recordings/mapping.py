"""Mapping of a file's columns to friction_hil's: names and factors, from the command line or a YAML file.

That is ``bench.csv.columns.yaml`` beside ``bench.csv``, or ``columns.yaml`` for every file of its folder::

    columns:
      time_s: t
      position: encoder*2*pi/4096
      torque: vir*35.1507
      current: raw:int16*range/32768

For a file without time stamps, ``rate_hz: 1000`` beside ``columns`` is its sampling rate.

`friction_hil.recordings.product` describes the products of columns and registers.
"""

import math
import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field
from pathlib import Path, PurePath
from typing import Any, TypeVar

from friction_hil.errors import ConfigurationError, Problem, UsageError
from friction_hil.recordings.columns import TIME
from friction_hil.recordings.matrices import without_blanks
from friction_hil.recordings.product import NUMBER, factor_of, possible_columns, product_of

_FACTORS = re.compile(rf"(?P<source>.*?)(?P<factors>(?:\s*[*/]\s*-?{NUMBER})+)\s*")
_FOR_ALL = "columns.yaml"

AnyPath = TypeVar("AnyPath", bound=PurePath)


def mapping_files(path: AnyPath) -> tuple[AnyPath, AnyPath]:
    """Return the files that may map the columns of a recording: its own one, and that of its folder."""
    return path.parent / f"{path.name}.columns.yaml", path.parent / _FOR_ALL  # `.` and `/` have no name


@dataclass(frozen=True, slots=True)
class Mapped:
    """Sources and factors to SI by friction_hil's names of columns.

    Those in ``optional`` come from a mapping file for the whole folder. They apply only to files that have the source,
    because a folder may hold recordings of several origins.
    """

    columns: dict[str, str] = field(default_factory=dict)
    scale: dict[str, float] = field(default_factory=dict)
    optional: frozenset[str] = frozenset()
    rate_hz: float | None = None

    def fitting(self, there: Collection[str]) -> "Mapped":
        """Return the mapping without optional columns whose source the file lacks."""
        return self.without({name for name in self.optional if product_of(self.columns[name], there).missing(there)})

    def without(self, names: Collection[str]) -> "Mapped":
        """Return the mapping without some columns."""
        return Mapped(
            {name: source for name, source in self.columns.items() if name not in names},
            {name: factor for name, factor in self.scale.items() if name not in names},
            rate_hz=self.rate_hz,
        )

    def sources(self, name: str) -> set[str]:
        """Return the names of all columns of the file that a column may be made of."""
        if name not in self.columns:
            return {name}
        found = possible_columns(self.columns[name])
        return {*found, name} if name in self.optional else found


def parse_source(text: str) -> tuple[str, float]:
    """Split ``SOURCE*FACTOR``, e.g. ``vir*35.1507`` or ``encoder*2*pi/4096``; the factor is 1 by default.

    Raises `UsageError`: the factor is not finite, or zero.
    """
    found = _FACTORS.fullmatch(text)
    if found is None or not found["source"].strip():
        return text.strip(), 1.0
    return found["source"].strip(), factor_of(found["factors"], text)


def split_factors(columns: Mapping[str, str]) -> tuple[dict[str, str], dict[str, float]]:
    """Return the sources of columns without their factors, and the factors by friction_hil's names.

    Raises `UsageError`: a factor is not finite, or zero.
    """
    sources: dict[str, str] = {}
    factors: dict[str, float] = {}
    for name, text in columns.items():
        sources[name], factor = parse_source(text)
        if factor != 1.0 or sources[name] != text.strip():  # a factor of 1 keeps the numbers of the file, too
            factors[name] = factor
    return sources, factors


def mapping_of(
    path: Path, columns: Mapping[str, str], scale: Mapping[str, float], rate_hz: float | None = None
) -> Mapped:
    """Return the mapping of a recording: its mapping file, if it has one, below other columns, factors and rate.

    A new source has no old factor. Raises `ConfigurationError`: the file has mistakes; each is reported with its line;
    `UsageError`: both a source of the time stamps and a sampling rate are given.
    """
    own, for_all = mapping_files(path)
    found, optional = Mapped(), frozenset[str]()
    if own.is_file():
        found = _read(own)
    elif for_all.is_file():
        found = _read(for_all)
        optional = frozenset(found.columns)
    if rate_hz is not None and TIME in columns:
        raise UsageError(f"--rate and --column {TIME}={columns[TIME]}: the time stamps have one source")
    rate_hz = rate_hz if rate_hz is not None or TIME in columns else found.rate_hz
    columns = {name: without_blanks(source) for name, source in columns.items()}
    kept = {name: factor for name, factor in found.scale.items() if name not in columns}
    return Mapped(found.columns | columns, kept | dict(scale), optional - set(columns), rate_hz)


def _read(path: Path) -> Mapped:
    from friction_hil.checked_yaml import text as yaml_text  # imported here: start-up time, and few recordings need it

    document = yaml_text.read(path)
    if document.problems:
        raise ConfigurationError(document.problems)
    content: Any = document.value

    def wrong(field_name: str, message: str, *steps: str) -> ConfigurationError:
        return ConfigurationError([Problem(str(path), document.line(steps), field_name, message)])

    if isinstance(content, dict) and "columns" not in content and "rate_hz" in content:
        content = {**content, "columns": {}}
    if not isinstance(content, dict) or not isinstance(content.get("columns"), dict):
        raise wrong("columns", "is missing; write `columns: {torque: effort*0.5}`")
    for key in content:
        if key not in ("columns", "rate_hz"):
            raise wrong(str(key), "is not known here; there are: columns, rate_hz", str(key))
    rate_hz = content.get("rate_hz")
    if rate_hz is not None and (type(rate_hz) not in (int, float) or not 0.0 < rate_hz < math.inf):
        raise wrong("rate_hz", f"is the sampling rate of a file without time stamps, Hz, not {rate_hz!r}", "rate_hz")
    if rate_hz is not None and TIME in content["columns"]:
        raise wrong("rate_hz", f"is not needed beside columns.{TIME}: the time stamps have one source", "rate_hz")
    columns, scale = {}, {}
    for name, text in content["columns"].items():
        if not isinstance(text, str):
            raise wrong(
                f"columns.{name}", f"is a column's name, with a factor if need be, not {text!r}", "columns", name
            )
        try:
            columns[name], factor = parse_source(without_blanks(text))
        except UsageError as error:
            raise wrong(f"columns.{name}", str(error), "columns", name) from None
        if factor != 1.0:
            scale[name] = factor
    return Mapped(columns, scale, rate_hz=None if rate_hz is None else float(rate_hz))
