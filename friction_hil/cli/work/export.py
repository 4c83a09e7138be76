"""The work of ``friction-hil export``."""

import math
import os
from collections.abc import Mapping
from pathlib import Path

import click

from friction_hil import export as exports
from friction_hil.cli.output import print_json
from friction_hil.cli.work.given_model import given_model
from friction_hil.cli.work.model_text import value_text
from friction_hil.compensator import Compensator
from friction_hil.config import AxisConfig, Configuration, load
from friction_hil.config.axis import compensation_mistakes
from friction_hil.daemon.assembly import make_compensator
from friction_hil.drive import AxisFacts
from friction_hil.errors import UsageError, choices
from friction_hil.models.model_file import ModelFile
from friction_hil.numerics.readable import POSITION_UNITS

_FINEST = 1e-15  # rad or m: no encoder resolves this; what is finer is a mistake


def export(
    *,
    model: str | None,
    to: str,
    output: str | None,
    config: Path | None,
    axis: str | None,
    resolution: float | None,
    delay_s: float | None,
    recording: Path | None,
    speed: float | None,
    force: bool,
    as_json: bool,
) -> None:
    """Write the files of an export and say what they hold."""
    if model is None:
        others = {"--resolution": resolution, "--delay": delay_s, "--recording": recording, "--speed": speed}
        _export_joints(to, output, config, axis, others, force=force, as_json=as_json)
        return
    file = given_model(model)
    if to in exports.LOSSY:
        for option, is_given in (
            ("--config", config is not None),
            ("--resolution", resolution is not None),
            ("--delay", delay_s is not None),
        ):
            if is_given:
                raise click.UsageError(f"{option} belongs to the compensator, which the format {to} does not hold")
        if axis is not None and recording is None:
            raise click.UsageError("--axis belongs to --recording FILE")
        _export_lossy(file, to, output, recording, axis, speed, force=force, as_json=as_json)
        return
    for option, is_given in (("--recording", recording is not None), ("--speed", speed is not None)):
        if is_given:
            raise click.UsageError(f"{option} belongs to formats that lose torque; {to} loses none")
    if config is None:
        for option, value in (("--axis", axis), ("--resolution", resolution), ("--delay", delay_s)):
            if value is not None:
                raise click.UsageError(f"{option} belongs to the compensator, which needs --config CONFIG")
        compensator = None
    else:
        compensator = _compensator(file, load(config), axis, resolution, delay_s)
    folder, name = _place(output)
    paths = exports.write(file, to, folder, name=name, compensator=compensator, overwrite=force)
    if as_json:
        print_json({"written": [str(path) for path in paths], "has_compensator": compensator is not None})
        return
    for path in paths:
        click.echo(f"{path}: {path.stat().st_size} bytes")
    if compensator is None:
        click.echo("The model alone; --config CONFIG exports its compensator, too.")
    else:
        given, lag_s = compensator.settings, file.mechanics.torque_lag_s
        begin_s = round(given.lead_s - 0.5 * given.period_s - lag_s, 9) + 0.0  # no minus before a zero
        lag = f" and {lag_s:g} s (torque_lag_s of the model file)" if lag_s > 0.0 else ""
        click.echo(
            f"Model and compensator, period {given.period_s:g} s. Its torque is computed for {given.lead_s:.6g} s "
            f"after the position was sampled: {begin_s:g} s (--delay), half a period{lag}."
        )


def _export_joints(
    to: str,
    output: str | None,
    config: Path | None,
    axis: str | None,
    given: Mapping[str, object],
    *,
    force: bool,
    as_json: bool,
) -> None:
    """Write the compensators of all axes of a configuration, with their own models."""
    if config is None or to != "c":
        raise click.UsageError("MODEL is missing; only --to c with --config CONFIG exports all axes with their models")
    for option, value in given.items():
        if value is not None:
            raise click.UsageError(f"{option} belongs to a MODEL; the axes of CONFIG have their own")
    folder, name = _place(output)
    paths = exports.save(
        exports.joint_files(config, name=name, joints=None if axis is None else [axis]), folder, overwrite=force
    )
    if as_json:
        print_json({"written": [str(path) for path in paths], "has_compensator": True})
        return
    for path in paths:
        click.echo(f"{path}: {path.stat().st_size} bytes")
    if load(config).arm is not None:
        click.echo("The arm is not in it: give the load of each joint in `load`, else its friction knows no weight.")


def _export_lossy(
    file: ModelFile,
    to: str,
    output: str | None,
    recording: Path | None,
    axis: str | None,
    speed: float | None,
    *,
    force: bool,
    as_json: bool,
) -> None:
    """Write an export that loses torque, and say what it holds and what it loses."""
    folder, name = _place(output)
    converted = exports.convert(file, to, name=name, recording=recording, axis=axis, speed=speed)
    paths = exports.save(converted.files, folder, overwrite=force)
    if as_json:
        print_json(
            {
                "written": [str(path) for path in paths],
                "parameters": converted.parameters,
                "loss": converted.loss.as_json(),
            }
        )
        return
    for path in paths:
        click.echo(f"{path}: {path.stat().st_size} bytes")
    for parameter, value in converted.parameters.items():
        inner = value if isinstance(value, dict) else {}
        text = ", ".join(f"{name} {value_text(each)}" for name, each in inner.items()) or value_text(value)
        click.echo(f"{parameter}: {text}")
    for line in converted.loss.lines():
        click.echo(line)


def _place(output: str | None) -> tuple[Path, str]:
    """Return the folder and the name of the files, empty for that of the model."""
    if output is None:
        return Path(), ""
    path = Path(output)
    if path.is_dir() or output.endswith(("/", os.sep)):
        return path, ""
    return path.parent, path.stem


def _compensator(
    file: ModelFile, configuration: Configuration, axis: str | None, resolution: float | None, delay_s: float | None
) -> Compensator:
    own = _axis(configuration, axis)
    if resolution is None or not _FINEST <= resolution < math.inf:
        given = "R" if resolution is None else f"{resolution:g}"
        unit = POSITION_UNITS[file.axis]
        raise click.UsageError(
            f"--resolution {given}: the compensator needs the smallest step of the position, {unit}, such as 4.8e-5"
        )
    if own.model.axis != file.axis:
        raise UsageError(
            f"the model is for a {file.axis} axis, and the configuration for a {own.model.axis} one: its limits and "
            "settings have other units"
        )
    without_learning = own.compensation.model_copy(update={"learning": "off"})  # which is not exported
    adapted = own.model_copy(update={"model": file, "compensation": without_learning})
    for steps, mistake in compensation_mistakes(adapted):
        raise UsageError(f"the model does not suit the configuration: {'.'.join(map(str, steps))}: {mistake}")
    period_s = configuration.period_s
    if delay_s is not None:
        if not 0.0 <= delay_s < 1.0:
            raise click.UsageError(f"--delay {delay_s:g}: a time below 1 s, zero or above")
        file = file.model_copy(update={"mechanics": file.mechanics.model_copy(update={"delay_s": 0.0})})
    facts = AxisFacts(
        name=axis or "",
        identity="",
        position_resolution=resolution,
        torque_resolution=0.0,
        setpoint_delay_s=period_s,
        actuation_delay_s=(period_s if delay_s is None else delay_s) + 0.5 * period_s,
    )
    return make_compensator(own, file, facts, period_s)


def _axis(configuration: Configuration, name: str | None) -> AxisConfig:
    axes = configuration.axes
    if name is None:
        if len(axes) > 1:
            raise click.UsageError(f"--axis NAME: the configuration has the axes {', '.join(axes)}")
        return next(iter(axes.values()))
    if name not in axes:
        raise UsageError(f"--axis {name}: the configuration has no such axis; {choices(name, axes)}")
    return axes[name]
