"""``friction-hil replay``: recordings through friction models, and the compensator run again."""

import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from friction_hil.cli.output import console, option_json, print_json
from friction_hil.cli.recording_options import recording_options
from friction_hil.errors import UsageError

if TYPE_CHECKING:
    from friction_hil.config import Configuration, ModelFile
    from friction_hil.recordings import Recording
    from friction_hil.replay import Replay
    from friction_hil.verify import Verification


@click.command("replay")
@click.argument("sources", metavar="RECORDING...", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option(
    "--model",
    "model_arguments",
    multiple=True,
    metavar="FILE_OR_NAME",
    help="Model file, or NAME:coulomb=0.08,viscous=2e-3. May be repeated.",
)
@click.option("--verify", "is_verifying", is_flag=True, help="Run the daemon's compensator again; compare every bit.")
@click.option("--config", type=click.Path(path_type=Path), help="Configuration in place of the one in the recording.")
@recording_options
@click.option("--lowpass", "lowpass_hz", type=float, metavar="HZ", help="Low-pass everything, without delay.")
@click.option("--decimate", type=click.IntRange(min=1), default=1, metavar="N", help="Keep each N-th sample.")
@click.option("--output", type=click.Path(path_type=Path), metavar="PICTURE", help="Draw into PICTURE (.png, .svg).")
@option_json
def command(
    sources: tuple[Path, ...],
    model_arguments: tuple[str, ...],
    is_verifying: bool,
    config: Path | None,
    axis: str | None,
    columns: dict[str, str],
    scale: dict[str, float],
    lowpass_hz: float | None,
    decimate: int,
    output: Path | None,
    as_json: bool,
) -> int:
    """Predict the torque of each RECORDING with each model, and compare it with the measured torque.

    Without --model the daemon's own recording is compared with the model that it ran with. Velocity and
    acceleration are derived from the position where there is no velocity, or with --lowpass. relative error =
    norm(measured - predicted) / norm(measured).

    --verify feeds the recording through the whole compensator, which must give the recorded compensation again:
    exit status 1 and the first cycle that differs otherwise.
    """
    from friction_hil import recordings
    from friction_hil.config import load, model_from_argument

    configuration = None if config is None else load(config)
    models = {argument: model_from_argument(argument) for argument in model_arguments}
    results = []
    for source in sources:
        if axis is None:
            found = list(recordings.read_all(source, columns=columns, scale=scale).values())
        else:
            found = [recordings.read(source, axis, columns=columns, scale=scale)]
        for recording in found:
            verification = _verify(recording, configuration) if is_verifying else None
            replay = None
            if models or not is_verifying:
                from friction_hil.replay import replay as run

                ours = models or _own_model(recording, configuration)
                replay = run(recording, ours, lowpass_hz=lowpass_hz, decimate=decimate)
            results.append((recording, replay, verification))
    pictures = _draw([replay for _, replay, _ in results if replay is not None], output)
    if as_json:
        print_json({"recordings": [_as_dict(*result) for result in results]})
    else:
        _print(results)
        for picture in pictures:
            click.echo(f"picture: {picture}")
    return 1 if any(verification and not verification.is_verified for *_, verification in results) else 0


def _verify(recording: "Recording", configuration: "Configuration | None") -> "Verification":
    from friction_hil.verify import verify

    return verify(recording, configuration)


def _own_model(recording: "Recording", configuration: "Configuration | None") -> "dict[str, ModelFile]":
    """The model that the daemon ran with, from the configuration inside its recording."""
    from friction_hil.config import from_dict

    if configuration is None and "configuration" in recording.metadata:
        inside = f"{recording.path} (configuration inside)"
        configuration = from_dict(recording.metadata["configuration"], inside)
    if configuration is None or recording.axis not in configuration.axes:
        raise UsageError(f"{recording.path}: no model is known for axis {recording.axis!r}; give --model FILE_OR_NAME")
    model = configuration.axes[recording.axis].model
    return {f"{model.friction.model} (as recorded)": model}


def _draw(replays: "list[Replay]", output: Path | None) -> list[Path]:
    """One picture a recording and axis; their names follow where there are several."""
    if output is None:
        return []
    if not replays:
        raise click.UsageError("--output draws models: give --model")
    from friction_hil.reports.replay_picture import draw

    pictures = []
    for replay in replays:
        names = f"{output.stem}_{Path(replay.path).stem}_{replay.axis}"
        picture = output if len(replays) == 1 else output.with_stem(names)
        draw(replay, picture)
        pictures.append(picture)
    return pictures


def _as_dict(recording: "Recording", replay: "Replay | None", verification: "Verification | None") -> dict[str, Any]:
    result: dict[str, Any] = {
        "path": recording.path,
        "axis": recording.axis,
        "rows": len(recording),
        "duration_s": recording.duration_s,
        "problems": replay.problems if replay else recording.problems,
        "verified": verification and verification.is_verified,
        "models": [],
    }
    if verification:
        result["verification"] = {
            "rows": verification.rows,
            "tolerance": verification.tolerance,
            "differences": verification.differences,
            "reason": verification.reason,
        }
    if replay:
        result["models"] = [
            {"model": each.model, "rmse": each.rmse, "relative_error": each.relative_error, "unit": each.unit}
            for each in replay.predictions
        ]
    return result


def _print(results: "list[tuple[Recording, Replay | None, Verification | None]]") -> None:
    from rich.table import Table
    from rich.text import Text

    out, errors = console(), console(stderr=True)
    table = Table("recording", "axis", "model", "rmse", "relative error", box=None, header_style="bold", pad_edge=False)
    for recording, replay, verification in results:
        name = Path(recording.path).name
        for problem in replay.problems if replay else recording.problems:
            errors.print(f"{name}: {recording.axis}: {problem}", markup=False, soft_wrap=True)
        for each in replay.predictions if replay else ():
            rmse, share = f"{each.rmse:.4g} {each.unit}", each.relative_error
            relative = f"{100.0 * share:.3f} %" if math.isfinite(share) else "undefined: measured torque is 0"
            table.add_row(Text(name), recording.axis, Text(each.model), rmse, relative)
        if verification:
            out.print(_verdict(name, verification), markup=False, soft_wrap=True)
    if table.row_count:
        out.print(table)


def _verdict(name: str, verification: "Verification") -> str:
    where = f"{name}: {verification.axis}"
    how = "bit for bit" if verification.tolerance == 0.0 else f"to {verification.tolerance:.3g}"
    if verification.differences:
        how += f" (recorded elsewhere: {'; '.join(verification.differences)})"
    if verification.is_verified:
        return f"{where}: verified: {verification.rows} rows come out again {how}"
    return f"{where}: NOT verified {how}: {verification.reason}"
