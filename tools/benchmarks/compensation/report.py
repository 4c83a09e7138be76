"""Results of a grid: geometric means and worst cases, as JSON and as tables."""

import math
from collections.abc import Iterable, Sequence
from itertools import product
from typing import Any

import click

from friction_hil.cli.work.tables import new_table, number, print_table
from tools.benchmarks.compensation.grid import Grid
from tools.benchmarks.compensation.methods import METHODS, OURS
from tools.benchmarks.compensation.simulation import CaseResult
from tools.benchmarks.report import machine

_WORST_SHOWN = 10


def geometric_mean(values: Iterable[float]) -> float:
    """Return the geometric mean of numbers that are not negative; 0 if one of them is 0."""
    logarithms = [math.log(value) if value > 0.0 else -math.inf for value in values]
    if -math.inf in logarithms:
        return 0.0
    return math.exp(math.fsum(logarithms) / len(logarithms))


def summary(results: Sequence[CaseResult]) -> dict[str, dict[str, dict[str, float]]]:
    """Return geometric mean and worst reduction: ``{method: {"rms": {"geomean", "worst"}, "peak": {..}}}``."""
    found: dict[str, dict[str, dict[str, float]]] = {}
    for method in METHODS:
        found[method] = {}
        for index, figure in enumerate(("rms", "peak")):
            values = [result.reduction[method][index] for result in results]
            found[method][figure] = {"geomean": geometric_mean(values), "worst": min(values)}
    return found


def as_json(grid: Grid, source: str, results: Sequence[CaseResult]) -> dict[str, Any]:
    """Return the JSON object of ``tools/bench compensation --json``."""
    cases = [
        {
            "plant": result.case.plant,
            "drive": result.case.drive,
            "motion": grid.motions[result.case.motion].name,
            "condition": result.case.condition,
            "reduction": {method: error._asdict() for method, error in result.reduction.items()},
        }
        for result in results
    ]
    by_condition = {
        name: summary([each for each in results if each.case.condition == name]) for name in grid.conditions
    }
    return {"machine": machine(), "grid": source, "cases": cases, "summary": by_condition}


def show(grid: Grid, source: str, results: Sequence[CaseResult]) -> None:
    """Print the tables."""
    click.echo(
        f"{source}: factor by which compensation reduces the following error,\n"
        "geometric mean of RMS/peak and [worst case]\n"
    )
    _print_groups(("condition", "drive"), results)
    if len(grid.plants) > 1:
        _print_groups(("plant", "drive"), results)
    _print_worst(grid, results)
    click.echo(machine())


def _print_groups(headings: tuple[str, str], results: Sequence[CaseResult]) -> None:
    """Print a row for each combination of two fields of the cases, and one for all."""
    table = new_table(*headings, *(number(method.replace("_", "\n")) for method in METHODS), keys=2)
    values = [list(dict.fromkeys(getattr(each.case, name) for each in results)) for name in headings]
    for group in product(*values):
        members = [each for each in results if tuple(getattr(each.case, name) for name in headings) == group]
        if members:
            table.add_row(*group, *_cells(members))
    table.add_row("all", "", *_cells(results))
    print_table(table)
    click.echo()


def _cells(results: Sequence[CaseResult]) -> list[str]:
    cells = []
    for figures in summary(results).values():
        rms, peak = figures["rms"], figures["peak"]
        means, worst = (f"{_brief(rms[each])}/{_brief(peak[each])}" for each in ("geomean", "worst"))
        cells.append(f"{means}\n[{worst}]")
    return cells


def _print_worst(grid: Grid, results: Sequence[CaseResult]) -> None:
    click.echo(f"worst cases of {OURS}:\n")
    table = new_table("plant", "drive", "motion", "condition", *map(number, ("RMS", "peak", "true late")), keys=4)
    for result in sorted(results, key=lambda each: min(each.reduction[OURS]))[:_WORST_SHOWN]:
        case, ours, late = result.case, result.reduction[OURS], result.reduction["true_late"]
        table.add_row(
            case.plant,
            case.drive,
            grid.motions[case.motion].name,
            case.condition,
            _brief(ours.rms),
            _brief(ours.peak),
            f"{_brief(late.rms)}/{_brief(late.peak)}",
        )
    print_table(table)
    click.echo()


def _brief(value: float) -> str:
    return f"{value:.2f}" if value < 3.0 else f"{value:.1f}" if value < 100.0 else f"{value:.0f}"
