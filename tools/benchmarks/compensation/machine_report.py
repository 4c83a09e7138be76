"""Results of machine files: geometric means and worst cases at motor and load, as JSON and as tables."""

from collections.abc import Sequence
from typing import Any

import click

from friction_hil.cli.work.tables import new_table, number, print_table
from friction_hil.study.machine import LOAD, MOTOR, SIDES
from tools.benchmarks.compensation.machines import MachineResult
from tools.benchmarks.compensation.numbers import brief, geometric_mean

CAN_HELP = 2.0  # least bound of the RMS at which a case counts as one that a feed-forward can help
_WORST_SHOWN = 10


def summary(results: Sequence[MachineResult], side: str) -> dict[str, dict[str, float]]:
    """Return geometric mean and worst reduction of RMS and peak at a side, of all cases."""
    found = {}
    for figure in ("rms", "peak"):
        values = [getattr(each.reduction[side], figure) for each in results]
        found[figure] = {"geomean": geometric_mean(values), "worst": min(values)}
    return found


def helped(results: Sequence[MachineResult], side: str) -> list[MachineResult]:
    """Return the cases that a feed-forward can help: whose bound is above `CAN_HELP`."""
    return [each for each in results if each.bound[side] >= CAN_HELP]


def as_json(results: Sequence[MachineResult]) -> dict[str, Any]:
    """Return the value of ``machines`` in the JSON object of the benchmark."""
    cases = [
        {
            "machine": each.case.machine,
            "drive": each.case.drive,
            "motion": each.case.motion,
            "condition": each.case.condition,
            "reduction": {side: errors._asdict() for side, errors in each.reduction.items()},
            "bound": each.bound,
            "gain_factor": each.gain_factor,
        }
        for each in results
    ]
    by_condition: dict[str, Any] = {}
    for name in _conditions(results):
        members = [each for each in results if each.case.condition == name]
        by_condition[name] = {side: {"all": summary(members, side), "helped": _helped(members, side)} for side in SIDES}
    return {"cases": cases, "summary": by_condition}


def _helped(results: Sequence[MachineResult], side: str) -> dict[str, dict[str, float]] | None:
    members = helped(results, side)
    return summary(members, side) if members else None


def show_machines(results: Sequence[MachineResult]) -> None:
    """Print the tables."""
    for side, what in ((MOTOR, "motor, by the encoder of its position loop"), (LOAD, "load, by its true position")):
        click.echo(
            f"machines: factor by which compensation reduces the following error of the {what},\n"
            "geometric mean of RMS/peak and [worst case]\n"
        )
        _print_table(results, side)
    _print_worst(results)


def _print_table(results: Sequence[MachineResult], side: str) -> None:
    conditions = _conditions(results)
    table = new_table("machine", "drive", *(number(name.replace("_", "\n")) for name in (*conditions, "bound")), keys=2)
    groups = list(dict.fromkeys((each.case.machine, each.case.drive) for each in results))
    rows = [(*group, [each for each in results if (each.case.machine, each.case.drive) == group]) for group in groups]
    for machine, drive, members in (
        *rows,
        ("all", "", list(results)),
        (f"bound above {CAN_HELP:g}", "", helped(results, side)),
    ):
        if members:
            cells = [_cell([each for each in members if each.case.condition == name], side) for name in conditions]
            bound = geometric_mean(each.bound[side] for each in members)
            table.add_row(machine, drive, *cells, brief(bound))
    print_table(table)
    click.echo()


def _cell(results: Sequence[MachineResult], side: str) -> str:
    if not results:
        return "-"
    found = summary(results, side)
    means, worst = (f"{brief(found['rms'][each])}/{brief(found['peak'][each])}" for each in ("geomean", "worst"))
    return f"{means}\n[{worst}]"


def _print_worst(results: Sequence[MachineResult]) -> None:
    click.echo("worst cases of the machines, RMS/peak (bound of the RMS):\n")
    table = new_table("machine", "drive", "motion", "condition", *map(number, (*SIDES, "gain left")), keys=4)
    for each in sorted(results, key=lambda each: min(each.reduction[MOTOR]))[:_WORST_SHOWN]:
        case = each.case
        cells = [
            f"{brief(each.reduction[side].rms)}/{brief(each.reduction[side].peak)} ({brief(each.bound[side])})"
            for side in SIDES
        ]
        table.add_row(case.machine, case.drive, case.motion, case.condition, *cells, f"{each.gain_factor:.2f}")
    print_table(table)
    click.echo()


def _conditions(results: Sequence[MachineResult]) -> list[str]:
    return list(dict.fromkeys(each.case.condition for each in results))
