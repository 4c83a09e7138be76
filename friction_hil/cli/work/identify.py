"""The work of ``friction-hil identify``."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import click

from friction_hil.api.identification import Identified, identified
from friction_hil.cli.output import print_json
from friction_hil.cli.work.progress import status_line
from friction_hil.cli.work.result_files import check_result_files
from friction_hil.cli.work.tables import new_table, number, print_files, print_table, prose, say
from friction_hil.identification import Fit, Identification
from friction_hil.identification.mechanics import Mechanics
from friction_hil.identification.plausibility import Finding
from friction_hil.identification.prediction_errors import PredictionError
from friction_hil.identification.static_map import StaticMap
from friction_hil.numerics.readable import brief
from friction_hil.reports.identification_report import write_report

_SHOWN = 12  # candidates in the table, besides the simplest; JSON has all
_REMARKS = 2  # in the summary; -v has all


def identify_axis(
    *,
    sources: tuple[Path, ...],
    columns: dict[str, str],
    rate_hz: float | None,
    axis: str | None,
    scale: dict[str, float],
    where: str | None,
    output: Path | None,
    report: Path | None,
    as_json: bool,
    verbose: bool = False,
    **options: Any,
) -> int:
    """Identify an axis, write model file and report, and print the result; ``options`` are those of `identify`.

    Returns 1, and writes no model file, if the result explains nothing.
    """
    check_result_files(output, None if options["static"] else report)
    reading = {"axis": axis, "column": columns, "scale": scale, "rate": rate_hz, "where": where}
    with status_line("reading") as show:
        found = identified(sources, show, reading=reading, **options)
    written = output if found.is_usable else None
    if written is not None:
        found.save(written)
    if isinstance(found.found, StaticMap):
        _tell_map(found, found.found, written, as_json=as_json)
        return 0
    result, findings, mechanics = found.found, found.findings, found.mechanics
    if report is not None:
        write_report(report, result, found.facts["free_run"], [each.text for each in findings], mechanics)
    if as_json:
        print_json({**found.facts, "output": written, "report": report})
    else:
        print_result(found, written, report, verbose=verbose)
        if found.loops is not None:
            loops = found.loops
            say(
                f"loops of the drive: velocity_gain {brief(loops.velocity_gain, 3)}, integral_hz "
                f"{brief(loops.integral_hz, 3)}, position_gain {brief(loops.position_gain, 3)} "
                f"({loops.explained:.1%} of the torque explained)",
                stderr=False,
            )
        elif found.no_loops and verbose:
            say(f"loops of the drive: not found: {found.no_loops}")
        if not found.is_usable and output is not None:
            say(f"{output} is not written.")
    return int(not found.is_usable)


def print_result(
    found: Identified, written: Path | None, report: Path | None, *, verbose: bool, is_last: bool = True
) -> None:
    """Print the summary of an axis; with ``verbose`` all candidates before it, with ``is_last`` what to do next."""
    result, free = found.found, found.facts["free_run"]
    assert isinstance(result, Identification)
    if verbose:
        _print_details(result, free, found.findings, found.mechanics)
    _print_summary(result, found.findings, found.mechanics)
    if is_last:
        print_files({"model file": written, "report": report})
        if written is not None:
            say(f"next: friction-hil replay ANOTHER_RECORDING --model {written}", stderr=False)
        elif found.is_usable:
            say("next: the same with --output MODEL.yaml, which writes the model file", stderr=False)
    if free["relative_error"] is not None:
        click.echo(f"Closed-loop simulation: relative_error of the torque {100.0 * free['relative_error']:.2f} %.")


def _print_summary(
    result: Identification,
    findings: Sequence[Finding],
    mechanics: Mechanics | None,
) -> None:
    """Print what was found, what it is worth and what is uncertain: ten lines at most, with what to do next."""
    problems = list(dict.fromkeys(each for record in result.records for each in record.problems))
    for problem in first(problems):
        say(problem)
    best = result.best
    texts = [each.text for each in sorted(findings, key=lambda each: not each.is_fatal)]
    if any(each.is_fatal for each in findings):
        say(f"No usable model; the best candidate is {best.label}.", stderr=False)
    else:
        say(f"Chosen: {best.label}. {_capital(result.reason)}.", stderr=False)
        held = "" if best.held_out is best.train else f", {_percent(best.held_out)} on held-out data"
        say(f"relative_error of the torque: {_percent(best.train)} on the fitted data{held}", stderr=False)
        errors = best.inference.standard_errors
        named = (f"{name} {_with_error(value, errors.get(name))}" for name, value in best.values.items())
        say(f"parameters (standard error): {', '.join(named)}", stderr=False)
    for text in first([f"! {_capital(each)}." for each in texts] + [f"- {each}" for each in best.flags]):
        say(text, stderr=False)
    if mechanics is not None:
        known = [f"{each.label} {brief(each.value, 4)} {each.unit}" for each in mechanics.quantities if each.value]
        unknown = [line.partition(":")[0] for line in mechanics.missing]
        more = f"; not determined: {', '.join(unknown)} (-v names the motion that shows each)" if unknown else ""
        say(f"mechanics: {', '.join(known) or 'nothing behind the motor'}{more}", stderr=False)
        for text in first([f"! {_capital(flag)}." for flag in mechanics.flags]):
            say(text, stderr=False)


def first(texts: Sequence[str], count: int = _REMARKS) -> list[str]:
    """Return the first few texts, and how many more there are."""
    if len(texts) <= count + 1:
        return list(texts)
    return [*texts[:count], f"- {len(texts) - count} more remarks: -v"]


def _capital(text: str) -> str:
    return f"{text[0].upper()}{text[1:]}"


def _percent(error: PredictionError) -> str:
    return f"{100.0 * error.relative_error:.2f} %"


def _with_error(value: float, error: float | None) -> str:
    return brief(value, 4) if error is None else f"{brief(value, 4)} ({brief(error, 2)})"


def _print_details(
    result: Identification, free: dict[str, Any], findings: Sequence[Finding], mechanics: Mechanics | None
) -> None:
    """Print all candidates, parameters and notes."""
    for note in result.notes:
        say(note)
    print_candidates(result)
    click.echo()
    print_parameters(result.best)
    click.echo()
    for text in (*(f"! {_capital(each.text)}." for each in findings), *(f"- {flag}" for flag in result.best.flags)):
        say(text, stderr=False)
    if free["relative_error"] is None:
        say(f"No closed-loop simulation: {free['reason']}.", stderr=False)
    if mechanics is not None:
        _print_mechanics(mechanics)
    click.echo()


def _print_mechanics(found: Mechanics) -> None:
    """Print what was found behind the motor, and what was not with the motion that would show it."""
    known = [each for each in found.quantities if each.value is not None]
    table = new_table("mechanics", number("value"), number("standard error"), "unit", "from")
    for each in known:
        table.add_row(each.label, brief(each.value or 0.0, 4), brief(_or_nan(each.error), 2), each.unit, each.source)
    print_table(table)
    for line in (*found.missing, *found.notes):
        say(f"- {line}", stderr=False)


def _or_nan(value: float | None) -> float:
    return math.nan if value is None else value


def print_candidates(result: Identification) -> None:
    """Print the models that were tried, the best one first."""
    is_grouped = len({record.group for record in result.records}) > 1
    groups = f"the recordings of each {result.settings.group_by}" if is_grouped else "blocks of time"
    say(
        "Number of free parameters; relative_error of the torque on the fitted data, on "
        f"{groups} held out, on speeds held out, on other recordings.",
        stderr=False,
    )
    for heading, fits in result.groups:
        if heading:
            click.echo(f"\n{heading}:")
        columns = ("free", "error", "groups" if is_grouped else "blocks", "speeds", "others")
        table = new_table(prose("model"), *map(number, columns))
        for each in _shown(fits):
            given = (each.train, each.cross_validation, each.across_speeds, each.validation)
            errors = ["-" if error is None else f"{100.0 * error.relative_error:.3f} %" for error in given]
            table.add_row(each.label, str(each.count), *errors)
        print_table(table)


def _shown(fits: Sequence[Fit]) -> list[Fit]:
    """Return the best candidates and the simplest one, with which the others are compared."""
    shown = list(fits[:_SHOWN])
    plain = [each for each in fits if not each.structure.modifiers]
    if plain:
        shown += [each for each in (min(plain, key=lambda each: each.count),) if each not in shown]
    return shown


def print_parameters(best: Fit) -> None:
    """Print the parameters of a model with their standard errors."""
    table = new_table("parameter", number("value"), number("standard error"))
    for name, value in best.values.items():
        error = best.inference.standard_errors.get(name, math.nan)
        table.add_row(name, brief(value, 6), brief(error, 2))
    print_table(table)


def _tell_map(found: Identified, result: StaticMap, written: Path | None, *, as_json: bool) -> None:
    """Print static friction that was fitted to points of speed and torque."""
    best = result.fits[0]
    if as_json:
        print_json({**found.facts, "output": written})
        return
    for text in (*found.facts["problems"], *found.facts["notes"]):
        say(text)
    table = new_table("model", number("free"), number("error"), number("AICc"))
    for each in result.fits:
        free = len(each.standard_errors)
        table.add_row(each.family, str(free), f"{100.0 * each.relative_error:.3g} %", brief(each.score, 4))
    print_table(table)
    click.echo()
    values = new_table("parameter", number("value"), number("standard error"))
    for name, error in best.standard_errors.items():
        value = best.offset if name == "offset" else best.parameters[name]
        values.add_row(name, brief(value, 6), brief(error, 2))
    print_table(values)
    click.echo(f"\nChosen: {best.family}, of {len(result.velocity)} points.")
    print_files({"model file": written})
