"""Results of a grid: geometric means and worst cases, as JSON and as tables."""

from collections.abc import Sequence
from itertools import product
from typing import Any

import click

from friction_hil.cli.work.tables import new_table, number, print_table
from tools.benchmarks.compensation.grid import Grid
from tools.benchmarks.compensation.methods import METHODS, OURS
from tools.benchmarks.compensation.numbers import brief, geometric_mean
from tools.benchmarks.compensation.simulation import CaseResult

_WORST_SHOWN = 10


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
    """Return the figures of the plants of a grid, for ``tools/bench compensation --json``."""
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
    return {"grid": source, "cases": cases, "summary": by_condition}


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
        means, worst = (f"{brief(rms[each])}/{brief(peak[each])}" for each in ("geomean", "worst"))
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
            brief(ours.rms),
            brief(ours.peak),
            f"{brief(late.rms)}/{brief(late.peak)}",
        )
    print_table(table)
    click.echo()
