"""The result of ./tools/bench tune as tables, or as JSON."""

import math
from collections.abc import Sequence
from dataclasses import asdict
from typing import Any

import click

from friction_hil.cli.work.tables import new_table, number, print_table, prose
from tools.benchmarks.report import machine
from tools.benchmarks.tune.judge import ENOUGH, OTHERS, OWN, AxisResult


def summary(results: Sequence[AxisResult], motions: Sequence[str] = (OWN, *OTHERS)) -> dict[str, Any]:
    """Return counts and geometric means over all axes."""
    tuned = [each for each in results if each.tuned]
    runs = [run for each in tuned for run in each.tuned.values()]
    return {
        "axes": len(results),
        "without_model": len(results) - len(tuned),
        "enough_of_truth": sum(min(each.ratio(OWN)) >= ENOUGH for each in results),
        "tuned_over_true": {
            motion: {
                "rms": _mean(each.ratio(motion)[0] for each in tuned),
                "peak": _mean(each.ratio(motion)[1] for each in tuned),
            }
            for motion in motions
        },
        "true": {motion: _mean(each.true[motion].rms for each in results) for motion in motions},
        "runs": len(runs),
        "worse_than_none": sum(run.rms < 1.0 for run in runs),
        "gain_cut": sum(run.gain_factor < 1.0 for run in runs),
    }


def _mean(values: Any) -> float:
    """Return the geometric mean; NaN of nothing."""
    logs = [math.log(value) for value in values]
    return math.exp(sum(logs) / len(logs)) if logs else math.nan


def as_json(results: Sequence[AxisResult]) -> dict[str, Any]:
    """Return all figures as plain values."""
    return {"machine": machine(), "summary": summary(results), "axes": [asdict(each) for each in results]}


def show(results: Sequence[AxisResult], *, is_truth_alone: bool) -> None:
    """Print a row for each axis, and the figures over all axes."""
    table = new_table(prose("axis"), prose("model"), *map(number, (OWN, *OTHERS, "tune s", "motion s")))
    for each in results:
        cells = [_cell(each, motion) for motion in (OWN, *OTHERS)]
        table.add_row(each.name, each.model or "none", *cells, f"{each.tune_s:.0f}", f"{each.motion_s:.0f}")
    print_table(table)
    click.echo("times lower, RMS/peak, with the tuned model; in brackets with the true one; ! the guard cut the gain")
    found = summary(results)
    if is_truth_alone:
        click.echo("geometric means of the RMS: " + ", ".join(f"{k} {v:.1f}" for k, v in found["true"].items()))
    else:
        _show_tuned(results, found)
    click.echo(machine())


def _show_tuned(results: Sequence[AxisResult], found: dict[str, Any]) -> None:
    for each in results:
        if each.problem:
            click.echo(f"{each.name}: {each.problem}")
    click.echo(
        f"{found['enough_of_truth']} of {found['axes']} axes reach {ENOUGH:.0%} of the truth in RMS and peak on their "
        f"own motion; {found['without_model']} got no model"
    )
    for motion, mean in found["tuned_over_true"].items():
        click.echo(
            f"{motion}: tuned over true {mean['rms']:.2f} (RMS), {mean['peak']:.2f} (peak); "
            f"true {found['true'][motion]:.1f}"
        )
    click.echo(
        f"{found['worse_than_none']} of {found['runs']} runs are worse than none, the guard cut the gain in "
        f"{found['gain_cut']}"
    )


def _cell(result: AxisResult, motion: str) -> str:
    true = result.true[motion]
    if motion not in result.tuned:
        return f"- ({true.rms:.1f}/{true.peak:.1f})"
    tuned = result.tuned[motion]
    mark = "!" if tuned.gain_factor < 1.0 else ""
    return f"{tuned.rms:.1f}/{tuned.peak:.1f}{mark} ({true.rms:.1f}/{true.peak:.1f})"
