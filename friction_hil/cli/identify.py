"""``friction-hil identify``: friction, inertia, offset and gravity of an axis from its recordings."""

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from friction_hil.cli.fit_options import check_files, option_validate, result_options
from friction_hil.cli.output import console, noticed_compilation, option_json, print_json
from friction_hil.cli.recording_options import read_recordings, recording_options
from friction_hil.errors import UsageError

if TYPE_CHECKING:
    from friction_hil.identification import Identification

_SHOWN = 12  # candidates in the table, and the simplest; JSON has all
_WIDE = 1000


def _pairs(context: click.Context, parameter: click.Parameter, words: tuple[str, ...]) -> dict[str, float]:
    values: dict[str, float] = {}
    for word in words:
        name, sign, text = word.partition("=")
        try:
            number = float(text)
        except ValueError:
            number = math.nan
        if not (name and sign) or math.isnan(number):
            raise click.BadParameter(f"{word!r} has not the form 'name=1.5'")
        if name in values:
            raise click.BadParameter(f"{name!r} is given twice")
        values[name] = number
    return values


@click.command("identify")
@click.argument("sources", metavar="RECORDING...", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option("--models", default="all", metavar="all|NAME,NAME", help="Families of friction models to try.")
@option_validate
@click.option(
    "--fix", "held", multiple=True, callback=_pairs, metavar="NAME=VALUE", help="Hold a parameter. May be repeated."
)
@click.option("--linear", "is_linear", is_flag=True, help="The axis is a linear one: m, N, kg. Else rad, N m, kg m^2.")
@click.option(
    "--gravity",
    type=click.Choice(["auto", "none", "constant", "pendulum"]),
    default="auto",
    show_default=True,
    help="constant: a vertical axis; pendulum: sine and cosine of the position; auto: a pendulum where it shows.",
)
@click.option(
    "--unknown-gain",
    "has_unknown_gain",
    is_flag=True,
    help="The column torque is a signal of unknown gain (volts, amperes, duty): find gain and back-EMF, the scale "
    "being that of what --fix holds, e.g. gravity.sine=MASS*9.81*LENGTH worked out, or inertia.",
)
@click.option(
    "--min-speed",
    "least_speed",
    type=click.FloatRange(min=0.0),
    default=0.0,
    metavar="SPEED",
    help="Rows at which the axis is slower do not count, rad/s or m/s: at rest friction is whatever holds it.",
)
@click.option(
    "--group-by",
    metavar="ENTRY",
    help="Hold recordings out together whose metadata have the same ENTRY, e.g. trajectory.",
)
@click.option(
    "--torque-is",
    "torque",
    type=click.Choice(["mean", "instant"]),
    default="mean",
    show_default=True,
    help="What the drive reports in a cycle: the mean since the last one, or the torque of the instant.",
)
@click.option(
    "--refine/--no-refine",
    "is_refined",
    default=None,
    help="Fit a chosen dynamic model once more, with all that the encoder tells; by default where presliding shows.",
)
@recording_options
@click.option(
    "--lowpass", "lowpass_hz", type=float, metavar="HZ", help="Derive velocity from the position below HZ, no delay."
)
@click.option(
    "--decimate",
    type=click.IntRange(min=1),
    metavar="N",
    help="Compare each N-th sample, behind a filter; 10, or less in a short recording. Models run at the full rate.",
)
@click.option(
    "--loss",
    type=click.Choice(["squares", "huber"]),
    default="squares",
    show_default=True,
    help="huber: what is far off counts less.",
)
@click.option(
    "--controller",
    callback=_pairs,
    multiple=True,
    metavar="NAME=VALUE",
    help="position_gain (1/s) and velocity_gain (torque per velocity) of the loop that made the motion: "
    "simulate it free, from position_demand.",
)
@result_options
@option_json
def command(
    sources: tuple[Path, ...],
    models: str,
    kept_apart: tuple[Path, ...],
    held: dict[str, float],
    is_linear: bool,
    gravity: Any,
    has_unknown_gain: bool,
    least_speed: float,
    group_by: str | None,
    torque: Any,
    is_refined: bool | None,
    axis: str | None,
    columns: dict[str, str],
    scale: dict[str, float],
    where: str | None,
    lowpass_hz: float | None,
    decimate: int | None,
    loss: str,
    controller: dict[str, float],
    seed: int,
    output: Path | None,
    report: Path | None,
    as_json: bool,
) -> int:
    """Find the friction model of an axis, its parameters with errors, inertia, offset and gravity.

    Every family of models is fitted, plain and with parameters for each direction, and the best ones with further
    modifiers. Each candidate is judged by data it was not fitted to: the recordings of --validate, or else strokes
    of some speeds, or blocks of time, held out in turn. The simplest one within a standard error of the best is chosen.
    """
    from friction_hil.identification import IdentificationSettings, identify

    names = () if models == "all" else tuple(name.strip() for name in models.split(","))
    settings = IdentificationSettings(
        families=names,
        axis="linear" if is_linear else "rotary",
        gravity=gravity,
        held=held,
        is_robust=loss == "huber",
        has_unknown_gain=has_unknown_gain,
        least_speed=least_speed,
        group_by=group_by,
        torque=torque,
        refine=is_refined,
        seed=seed,
        lowpass_hz=lowpass_hz,
        decimation=decimate,
    )
    check_files(output, report)
    if has_unknown_gain and controller:
        raise click.UsageError("--controller takes a measured torque: not with --unknown-gain")
    options: dict[str, Any] = {"columns": columns, "scale": scale, "where": where}
    recordings = read_recordings(sources, axis, **options)
    validation = read_recordings(kept_apart, axis, **options)
    with console(stderr=True).status("reading") as line:
        now = "reading"

        def show(name: str) -> None:
            nonlocal now
            now = f"fitting {name}"
            line.update(now)

        with noticed_compilation(lambda note: line.update(f"{now}: {note}")):
            result = identify(recordings, settings, validation=validation, progress=show)
    free = _free_run(result, controller)
    if output is not None:
        _write(result, output)
    if report is not None:
        from friction_hil.reports.identification_report import write_report

        write_report(report, result, free)
    if as_json:
        from friction_hil.identification import export

        print_json({**export.as_json(result), "free_run": free, "output": output, "report": report})
    else:
        _print(result, free, {"model file": output, "report": report})
    return 0


def _free_run(result: "Identification", controller: dict[str, float]) -> dict[str, Any]:
    """Error of a free simulation of the chosen model, or why there is none."""
    known = {"position_gain", "velocity_gain"}
    if set(controller) - known:
        raise UsageError(
            f"--controller takes position_gain and velocity_gain, not {', '.join(set(controller) - known)}"
        )
    if not controller:
        return {"relative_error": None, "reason": "nothing is known of the controller: give --controller"}
    if set(controller) != known:
        raise UsageError(f"--controller needs {', '.join(sorted(known - set(controller)))}, too")
    from friction_hil.identification import free_run
    from friction_hil.identification.export import model_file

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


def _write(result: "Identification", output: Path) -> None:
    from friction_hil.checked_yaml.text import dump
    from friction_hil.identification.export import as_model_file, model_file

    model_file(result)  # what is written can be read
    output.write_text(dump(as_model_file(result)), encoding="utf-8")


def _print(result: "Identification", free: dict[str, Any], files: dict[str, Path | None]) -> None:
    from rich.table import Table
    from rich.text import Text

    out, errors = console(), console(stderr=True)
    for problem in dict.fromkeys(each for record in result.records for each in record.problems):
        errors.print(problem, markup=False, soft_wrap=True)
    for note in result.notes:
        errors.print(note, markup=False, soft_wrap=True)
    if not out.is_terminal:
        out.width = _WIDE  # into a file or a pipe: no number is cut short
    table = Table(box=None, header_style="bold", pad_edge=False)
    is_grouped = len({record.group for record in result.records}) > 1
    table.add_column("model", overflow="fold")
    for head in ("free", "error", "groups" if is_grouped else "blocks", "speeds", "others"):
        table.add_column(head, no_wrap=True)
    shown = list(result.fits[:_SHOWN])
    plain = [each for each in result.fits if not each.structure.modifiers]
    if plain:  # the simplest one is what the others are compared with
        shown += [each for each in (min(plain, key=lambda each: each.count),) if each not in shown]
    for each in shown:
        given = (each.train, each.cross_validation, each.across_speeds, each.validation)
        shares = ["-" if error is None else f"{100.0 * error.relative_error:.3f} %" for error in given]
        table.add_row(Text(each.label), str(each.count), *shares)
    parts = f"the recordings of each {result.settings.group_by}" if is_grouped else "blocks of it"
    out.print(
        f"Relative error of the torque: on the data, on {parts} held out, on speeds held out, on other data.",
        markup=False,
        soft_wrap=True,
    )
    out.print(table)
    out.print()
    best = result.best
    values = Table("parameter", "value", "standard error", box=None, header_style="bold", pad_edge=False)
    for name, value in best.values.items():
        error = best.inference.standard_errors.get(name, math.nan)
        values.add_row(Text(name), f"{value:.6g}", f"{error:.2g}" if math.isfinite(error) else "-")
    out.print(values)
    out.print()
    out.print(f"Chosen: {best.label}. {result.reason[0].upper()}{result.reason[1:]}.", markup=False, soft_wrap=True)
    for flag in best.flags:
        out.print(f"- {flag}", markup=False, soft_wrap=True)
    if free["relative_error"] is None:
        out.print(f"No free simulation: {free['reason']}.", markup=False, soft_wrap=True)
    else:
        out.print(
            f"Free simulation: relative error of the torque {100.0 * free['relative_error']:.2f} %.", markup=False
        )
    for what, path in files.items():
        if path is not None:
            out.print(f"{what}: {path}", markup=False, soft_wrap=True)
