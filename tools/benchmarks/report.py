"""Parts that benchmarks have in common: rows of results, their table, and rounds with progress."""

import math
import os
import platform
import sys
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from statistics import median

import click

from friction_hil.cli.output import print_json
from friction_hil.cli.work.tables import new_table, number, print_table, prose
from friction_hil.recordings.fingerprint import fingerprint


@dataclass(frozen=True, slots=True)
class Row:
    """One measured quantity.

    Attributes
    ----------
    name : str
        Name of the quantity, with that of its reference in brackets.
    value : float
        Value in ``unit``.
    unit : str
    reference : float or None
        Reference in the same unit: another program measured in the same run, or a target.
    ratio : float or None
        Value divided by reference; if both were measured, the median of the ratios of the single rounds.
    """

    name: str
    value: float
    unit: str
    reference: float | None = None
    ratio: float | None = None


def compare(name: str, unit: str, values: Sequence[float], references: Sequence[float]) -> Row:
    """Return the row of two series measured alternately: their medians, and the median ratio of the rounds."""
    ratios = [value / reference for value, reference in zip(values, references, strict=True)]
    return Row(name, median(values), unit, median(references), median(ratios))


def against(target: float, name: str, unit: str, value: float) -> Row:
    """Return the row of a value and its target."""
    return Row(name, value, unit, target, value / target)


def percentile(ascending: Sequence[float], quantile: float) -> float:
    """Return the smallest sample that at least the fraction ``quantile`` of the samples do not exceed."""
    return ascending[math.ceil(quantile * len(ascending)) - 1]


def rounds(count: int, label: str) -> Iterator[int]:
    """Yield the numbers of the rounds of a measurement, with a progress bar on a terminal."""
    # click's bar has no thread, which would disturb the measurement
    with click.progressbar(range(count), label=label, file=sys.stderr) as bar:
        yield from bar


def note(text: str) -> None:
    """Print on stderr a condition of the measurement."""
    click.echo(text, err=True)


def machine() -> str:
    """Return one line that describes the machine."""
    facts = fingerprint()
    cpus = len(os.sched_getaffinity(0))
    return f"{facts['cpu']}, {cpus} CPUs, {platform.system()} {platform.release()}, Python {facts['python']}"


def show(rows: Sequence[Row], *, as_json: bool) -> None:
    """Print the rows as a table, or as one JSON object."""
    if as_json:
        print_json({"machine": machine(), "rows": [asdict(row) for row in rows]})
        return
    table = new_table(prose("measured"), *map(number, ("value", "reference", "ratio")))
    for row in rows:
        unit = "µs" if row.unit == "us" else row.unit
        reference = "" if row.reference is None else f"{row.reference:.3g} {unit}"
        ratio = "" if row.ratio is None else f"{row.ratio:.2f}"
        table.add_row(row.name, f"{row.value:.3g} {unit}", reference, ratio)
    print_table(table)
    click.echo(machine())
