"""The work of ``friction-hil identify``."""

import math
from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import click

from friction_hil import __version__
from friction_hil.checked_yaml.text import dump
from friction_hil.cli.output import print_json
from friction_hil.cli.work.progress import status_line
from friction_hil.cli.work.read import expanded, kind_of, read_recordings
from friction_hil.cli.work.result_files import check_result_files
from friction_hil.cli.work.tables import new_table, number, print_files, print_table, prose, say
from friction_hil.errors import UsageError
from friction_hil.identification import Fit, Identification, IdentificationSettings, free_run, identify
from friction_hil.identification.export import add_mechanics, as_model_file, mechanics_as_json, model_file
from friction_hil.identification.export import as_json as result_as_json
from friction_hil.identification.mechanics import Mechanics, find_mechanics
from friction_hil.identification.moving_beside import moving_beside
from friction_hil.identification.plausibility import Finding, check_result
from friction_hil.identification.prediction_errors import PredictionError
from friction_hil.identification.static_map import StaticFit, StaticMap, fit_map
from friction_hil.numerics.readable import brief
from friction_hil.recordings import Recording, read_all
from friction_hil.recordings.segments import with_position
from friction_hil.reports.identification_report import write_report
from friction_hil.tuning.simulated import recorded_loops

_SHOWN = 12  # candidates in the table, besides the simplest; JSON has all
_REMARKS = 2  # in the summary; -v has all
_CONTROLLER = {"position_gain", "velocity_gain"}


def identify_axis(
    *,
    sources: tuple[Path, ...],
    kept_apart: tuple[Path, ...],
    axis: str | None,
    columns: dict[str, str],
    scale: dict[str, float],
    where: str | None,
    rate_hz: float | None,
    controller: dict[str, float],
    is_linear: bool,
    output: Path | None,
    report: Path | None,
    as_json: bool,
    verbose: bool = False,
    is_static: bool = False,
    **options: Any,
) -> int:
    """Identify an axis, write model file and report, and print the result; ``options`` become settings.

    Returns 1, and writes no model file, if the result explains nothing.
    """
    reading: dict[str, Any] = {"columns": columns, "scale": scale, "where": where, "rate_hz": rate_hz}
    if is_static:
        shown: dict[str, Any] = {"output": output, "as_json": as_json, "is_linear": is_linear}
        shown |= {"families": options["models"], "held": options["held"]}
        return identify_map(sources=sources, axis=axis, **shown, **reading)
    settings = _settings(**options)
    check_result_files(output, report)
    _check_controller(controller)
    if settings.has_unknown_gain and controller:
        raise click.UsageError("--controller needs a measured torque: not with --unknown-gain")
    recordings = list(map(with_position, read_recordings(sources, axis, **reading)))
    validation = list(map(with_position, read_recordings(kept_apart, axis, **reading)))
    settings = replace(settings, axis=kind_of([*recordings, *validation], is_linear=is_linear))
    with status_line("reading") as show:
        result = identify(
            recordings,
            settings,
            validation=validation,
            progress=lambda step: show(f"{step.stage}: {step.label}", step.number, step.count),
        )
        disturbed = moving_beside(result, _beside(recordings))
        findings = [*check_result(result, recordings), *([Finding(disturbed)] if disturbed else [])]
        is_worthless = any(each.is_fatal for each in findings)
        mechanics = (
            None
            if is_worthless
            else find_mechanics(recordings, result, disturbed=disturbed, report=lambda step: show(f"mechanics: {step}"))
        )
    loops, unknown = recorded_loops(recordings)
    free: dict[str, Any] = {"relative_error": None, "reason": "no usable model"}
    if not is_worthless:
        free = _free_run(result, controller)
    if output is not None and not is_worthless:
        signal = recordings[0].sources.get("torque", "torque")
        model_file(result, signal=signal)  # raises before a file that could not be read again is written
        content = as_model_file(result, signal=signal)
        content["fit"]["flags"] += [each.text for each in findings]
        if mechanics is not None:
            add_mechanics(content, mechanics)
        output.write_text(dump(content), encoding="utf-8")
    if report is not None:
        write_report(report, result, free, [each.text for each in findings], mechanics)
    written = None if is_worthless else output
    if as_json:
        told = {"is_usable": not is_worthless, "findings": [each.text for each in findings]}
        found = {
            "mechanics": None if mechanics is None else mechanics_as_json(mechanics),
            "drive_loops": None if loops is None else asdict(loops),
        }
        print_json({**result_as_json(result), **found, **told, "free_run": free, "output": written, "report": report})
    else:
        if verbose:
            _print_details(result, free, findings, mechanics)
        _print_summary(result, findings, mechanics, written, report)
        if free["relative_error"] is not None:
            click.echo(f"Closed-loop simulation: relative_error of the torque {100.0 * free['relative_error']:.2f} %.")
        if loops is not None:
            say(
                f"loops of the drive: velocity_gain {brief(loops.velocity_gain, 3)}, integral_hz "
                f"{brief(loops.integral_hz, 3)}, position_gain {brief(loops.position_gain, 3)} "
                f"({loops.explained:.1%} of the torque explained)",
                stderr=False,
            )
        elif unknown and verbose:
            say(f"loops of the drive: not found: {unknown}")
        if is_worthless and output is not None:
            say(f"{output} is not written.")
    return int(is_worthless)


def _beside(recordings: Sequence[Recording]) -> dict[str, dict[str, Recording]]:
    """Return the motion of the other axes that the daemon recorded in the same files, by path and name."""
    found = {}
    for each in recordings:
        if len(each.metadata.get("facts", ())) > 1:
            there = read_all(each.path, only=("time_s", "position"))
            found[each.path] = {name: other for name, other in there.items() if name != each.axis}
    return found


def _settings(
    models: tuple[str, ...],
    loss: str,
    is_refined: bool | None,
    decimate: int | None,
    **options: Any,
) -> IdentificationSettings:
    return IdentificationSettings(
        families=models,
        is_robust=loss == "huber",
        refine=is_refined,
        decimation=decimate,
        **options,
    )


def _check_controller(controller: dict[str, float]) -> None:
    if unknown := set(controller) - _CONTROLLER:
        raise UsageError(f"--controller takes position_gain and velocity_gain, not {', '.join(sorted(unknown))}")
    if controller and set(controller) != _CONTROLLER:
        raise UsageError(f"--controller also needs {', '.join(sorted(_CONTROLLER - set(controller)))}")


def _free_run(result: Identification, controller: dict[str, float]) -> dict[str, Any]:
    """Simulate the chosen model in closed loop; return its relative error, or the reason why there is none."""
    if not controller:
        return {"relative_error": None, "reason": "the controller is not known: give --controller"}
    record = result.records[0]
    if record.demand is None:
        return {"relative_error": None, "reason": f"{record.path} has no position_demand"}
    loop = free_run.cascade(record.demand, controller["position_gain"], controller["velocity_gain"])
    run = free_run.simulate_axis(
        model_file(result),
        loop,
        len(record.demand),
        record.dt,
        position=float(record.position[0]),
        velocity=float(record.velocity[0]),
    )
    return {"relative_error": run.relative_error(record.torque, record.begin), "reason": None}


def _print_summary(
    result: Identification,
    findings: Sequence[Finding],
    mechanics: Mechanics | None,
    written: Path | None,
    report: Path | None,
) -> None:
    """Print what was found, what it is worth, what is uncertain and what to do next: ten lines at most."""
    problems = list(dict.fromkeys(each for record in result.records for each in record.problems))
    for problem in _first(problems):
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
    for text in _first([f"! {_capital(each)}." for each in texts] + [f"- {each}" for each in best.flags]):
        say(text, stderr=False)
    if mechanics is not None:
        known = [f"{each.label} {brief(each.value, 4)} {each.unit}" for each in mechanics.quantities if each.value]
        unknown = [line.partition(":")[0] for line in mechanics.missing]
        more = f"; not determined: {', '.join(unknown)} (-v names the motion that shows each)" if unknown else ""
        say(f"mechanics: {', '.join(known) or 'nothing behind the motor'}{more}", stderr=False)
        for text in _first([f"! {_capital(flag)}." for flag in mechanics.flags]):
            say(text, stderr=False)
    print_files({"model file": written, "report": report})
    if written is not None:
        say(f"next: friction-hil replay ANOTHER_RECORDING --model {written}", stderr=False)
    elif not any(each.is_fatal for each in findings):
        say("next: the same with --output MODEL.yaml, which writes the model file", stderr=False)


def _first(texts: Sequence[str]) -> list[str]:
    """Return the first few texts, and how many more there are."""
    if len(texts) <= _REMARKS + 1:
        return list(texts)
    return [*texts[:_REMARKS], f"- {len(texts) - _REMARKS} more remarks: -v"]


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
