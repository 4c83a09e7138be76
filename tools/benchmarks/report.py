"""What benchmarks have in common: the rows of their results, how they are shown, and rounds with progress."""

import math
import os
import platform
import sys
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from statistics import median

import click

from friction_hil.cli.output import console, print_json
from friction_hil.recordings.fingerprint import fingerprint


@dataclass(frozen=True, slots=True)
class Row:
    """One measured quantity.

    Attributes
    ----------
    name : str
        What was measured, and in brackets what the reference is.
    value : float
        In ``unit``.
    unit : str
    reference : float or None
        What it is compared with, in the same unit: another program measured in the same run, or a target.
    ratio : float or None
        Value over reference; where both were measured, the median of the ratios of the single rounds.
    """

    name: str
    value: float
    unit: str
    reference: float | None = None
    ratio: float | None = None


def compare(name: str, unit: str, values: Sequence[float], references: Sequence[float]) -> Row:
    """Compare two series measured in turns: medians, and the median of the ratios round by round."""
    ratios = [value / reference for value, reference in zip(values, references, strict=True)]
    return Row(name, median(values), unit, median(references), median(ratios))


def against(target: float, name: str, unit: str, value: float) -> Row:
    """Compare a value with its target."""
    return Row(name, value, unit, target, value / target)


def percentile(ascending: Sequence[float], share: float) -> float:
    """Smallest sample that at least ``share`` of them do not exceed."""
    return ascending[math.ceil(share * len(ascending)) - 1]


def rounds(count: int, label: str) -> Iterator[int]:
    """Count the rounds of a measurement, with a progress bar on a terminal."""
    # click's bar has no thread of its own, which would spoil what is measured
    with click.progressbar(range(count), label=label, file=sys.stderr) as bar:
        yield from bar


def note(text: str) -> None:
    """Say on stderr under which conditions a measurement was made."""
    click.echo(text, err=True)


def machine() -> str:
    """Say in one line on what a measurement was made."""
    facts = fingerprint()
    cpus = len(os.sched_getaffinity(0))
    return f"{facts['cpu']}, {cpus} CPUs, {platform.system()} {platform.release()}, Python {facts['python']}"


def show(rows: Sequence[Row], *, as_json: bool) -> None:
    """Print the rows for people, or as one JSON object."""
    if as_json:
        print_json({"machine": machine(), "rows": [asdict(row) for row in rows]})
        return
    from rich.table import Table

    table = Table(caption=machine(), caption_justify="left")
    table.add_column("measured")
    for heading in ("value", "reference", "ratio"):
        table.add_column(heading, justify="right")
    for row in rows:
        reference = "" if row.reference is None else f"{row.reference:.3g} {row.unit}"
        ratio = "" if row.ratio is None else f"{row.ratio:.2f}"
        table.add_row(row.name, f"{row.value:.3g} {row.unit}", reference, ratio)
    console().print(table)
