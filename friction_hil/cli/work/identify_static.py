"""The work of ``friction-hil identify --static``."""

import math
from pathlib import Path
from typing import Any

import click

from friction_hil import __version__
from friction_hil.checked_yaml.text import dump
from friction_hil.cli.output import print_json
from friction_hil.cli.work.read import expanded
from friction_hil.cli.work.result_files import check_result_files
from friction_hil.cli.work.tables import new_table, number, print_files, print_table, say
from friction_hil.errors import UsageError
from friction_hil.identification.static_map import StaticFit, StaticMap, fit_map
from friction_hil.numerics.readable import brief
from friction_hil.recordings import Recording, read_all


def identify_map(
    *,
    sources: tuple[Path, ...],
    axis: str | None,
    families: tuple[str, ...],
    held: dict[str, float],
    is_linear: bool,
    output: Path | None,
    as_json: bool,
    **reading: Any,
) -> int:
    """Fit static friction to points of speed and torque, write the model file, and print the result."""
    check_result_files(output, None)
    if set(held) - {"inertia"}:
        raise click.UsageError("--static takes --fix inertia=VALUE alone, which a map does not show")
    recordings = [_only(source, axis, reading) for source in expanded(sources)]
    result = fit_map(recordings, families)
    best = result.fits[0]
    if output is not None:
        output.write_text(dump(_model_file(result, recordings, held, is_linear=is_linear)), encoding="utf-8")
    notes = list(result.notes)
    if "inertia" not in held:
        notes.append("a map shows no inertia: --fix inertia=VALUE writes it into the model file")
    problems = list(dict.fromkeys(problem for each in recordings for problem in each.problems))
    if as_json:
        fits = [_as_json(each) for each in result.fits]
        told = {"problems": problems, "notes": notes, "is_usable": True, "findings": [], "report": None}
        named = [{"path": each.path, "rows": len(each)} for each in recordings]
        reason = "lowest information criterion (AICc)"
        print_json({"best": best.family, "reason": reason, "recordings": named, "fits": fits, "output": output, **told})
        return 0
    for text in (*problems, *notes):
        say(text)
    table = new_table("model", number("free"), number("error"), number("AICc"))
    for each in result.fits:
        free = len(each.standard_errors)
        table.add_row(each.family, str(free), f"{100.0 * each.relative_error:.3g} %", brief(each.score, 4))
    print_table(table)
    click.echo()
    values = new_table("parameter", number("value"), number("standard error"))
    for name, error in best.standard_errors.items():
        values.add_row(name, brief(_value(best, name), 6), brief(error, 2))
    print_table(values)
    click.echo(f"\nChosen: {best.family}, of {len(result.velocity)} points.")
    print_files({"model file": output})
    return 0


def _only(source: str, axis: str | None, reading: dict[str, Any]) -> Recording:
    found = read_all(source, is_preview=True, **reading)
    if axis in found:
        return found[axis]
    if len(found) > 1:
        raise UsageError(f"{source}: has the axes {', '.join(found)}; choose one with --axis")
    return next(iter(found.values()))


def _value(fit: StaticFit, name: str) -> float:
    return fit.offset if name == "offset" else fit.parameters[name]


def _model_file(
    result: StaticMap, recordings: list[Recording], held: dict[str, float], *, is_linear: bool
) -> dict[str, Any]:
    best = result.fits[0]
    errors = {name: error for name, error in best.standard_errors.items() if math.isfinite(error)}
    return {
        "version": 1,
        "axis": "linear" if is_linear else "rotary",
        "friction": {"model": best.family, "parameters": best.parameters},
        "mechanics": {"inertia": held.get("inertia", 0.0), "offset": best.offset},
        "fit": {
            "software": f"friction_hil {__version__}",
            "recordings": [{"path": each.path, "rows": len(each)} for each in recordings],
            "chosen": "static map of speeds and torques, lowest AICc",
            "train": {"rmse": best.rmse, "relative_error": best.relative_error},
            "standard_errors": errors,
            "range": {"velocity": [float(result.velocity.min()), float(result.velocity.max())]},
        },
    }


def _as_json(fit: StaticFit) -> dict[str, Any]:
    return {
        "model": fit.family,
        "label": fit.family,
        "parameters": fit.parameters,
        "modifiers": {},
        "standard_errors": fit.standard_errors,
        "mechanics": {"offset": fit.offset},
        "train": {"rmse": fit.rmse, "relative_error": fit.relative_error},
    }
