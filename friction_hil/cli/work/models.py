"""The work of ``friction-hil models``."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import click
import numpy as np

from friction_hil import models, recordings
from friction_hil.checked_yaml.output import check_writable
from friction_hil.cli.output import print_json
from friction_hil.cli.work.given_model import given_model
from friction_hil.cli.work.model_text import Page, default_text, in_units_of, unit_text, value_text
from friction_hil.cli.work.tables import Table, new_table, number, print_files, print_table, prose, say
from friction_hil.config.examples import example_models
from friction_hil.errors import UsageError
from friction_hil.export import identifier
from friction_hil.friction.modifiers import CURVES, HARMONIC, LOAD, NAMES, SIDES, TEMPERATURE, VISCOUS
from friction_hil.friction.parameters import Parameter
from friction_hil.models import Family, FrictionModel
from friction_hil.models.files import load_model_file
from friction_hil.models.model_file import ModelFile
from friction_hil.numerics.readable import FORCE_UNITS, POSITION_UNITS, brief
from friction_hil.reports.export_gallery import INDEX, write_gallery
from friction_hil.reports.model_motion import Motion, draw_motion, draw_steady, keys_of, make_motion
from friction_hil.reports.model_picture import draw


def show_models(
    *,
    name: str | None,
    picture: Path | None,
    motion: str | None,
    beside: tuple[str, ...],
    gallery: Path | None,
    is_library: bool,
    as_json: bool,
) -> None:
    """Print the list of models, describe one model and draw it, or export models to every format."""
    if is_library:
        _list_library(as_json)
        return
    if picture is None and (motion is not None or beside):
        raise UsageError("--motion and --beside belong to --draw PICTURE")
    if picture is not None:
        check_writable(picture, "--draw ")
    if gallery is not None:
        if picture is not None:
            raise UsageError("--draw and --export-all: the gallery of --export-all has pictures of its own; give one")
        _export_all(name, gallery, as_json)
        return
    if name is None:
        if picture is not None:
            raise UsageError(f"--draw needs a model: friction-hil models lugre --draw {picture}")
        _list(as_json)
        return
    family, own = _find(name)
    if picture is not None and (motion is not None or beside):
        left = _draw_beside((name, *beside), motion, picture)
        if as_json:
            print_json({"picture": picture, "differences": left})
            return
        for other, share in left.items():
            click.echo(f"{other} differs from {name} by {100.0 * share:.3g} % of its RMS torque")
        print_files({"picture": picture})
        return
    if picture is not None:
        _draw(family, own, picture)
    if as_json:
        print_json(describe_model(family, own))
        return
    _print(family, own, name)
    if picture is not None:
        click.echo(f"\npicture: {picture}")


def _list_library(as_json: bool) -> None:
    actuators = list(map(models.library.describe, models.library.names()))
    if as_json:
        print_json({"actuators": [asdict(each) for each in actuators]})
        return
    table = new_table("actuator", prose("model"), number("level"), *map(number, ("error", "held out", "speeds")))
    for each in actuators:
        unit = FORCE_UNITS[each.axis], f"{POSITION_UNITS[each.axis]}/s"
        table.add_row(
            each.name,
            each.model,
            f"{brief(each.level, 3)} {unit[0]}",
            f"{100.0 * each.relative_error:.3g} %",
            f"{100.0 * each.held_out:.3g} %",
            f"{brief(each.velocity[0], 2)} to {brief(each.velocity[1], 2)} {unit[1]}",
        )
    print_table(table)
    for each in actuators:
        say(f"\n{each.name}: {each.what}. From {each.source} ({each.licence}).", stderr=False)
        for flag in each.flags:
            say(f"- {flag}", stderr=False)
    say(
        "\nYours has a friction of its own: 'friction-hil config new --like NAME' begins with one of these.",
        stderr=False,
    )


def _export_all(name: str | None, folder: Path, as_json: bool) -> None:
    """Write the gallery of one model, or of the examples."""
    chosen: dict[str, ModelFile] = {}
    if name is not None:
        family, own = _find(name)
        chosen[identifier(Path(name.partition(":")[0]).stem) or family.name] = own or _example(family)
    else:
        chosen |= {key: load_model_file(path) for key, path in example_models().items()}
        chosen |= {each: _example(models.describe(each)) for each in models.names()}
    follow = (lambda text: None) if as_json else (lambda text: click.echo(f"{text} ..."))
    outcome = write_gallery(folder, chosen, follow)
    page = folder / INDEX
    if as_json:
        print_json({"page": str(page), "models": outcome})
        return
    for model, formats in outcome.items():
        for to, why in formats.items():
            if why:
                click.echo(f"{model}: not to {to}: {why}")
    click.echo(str(page))


def _example(family: Family) -> ModelFile:
    content = {"model": family.name, "parameters": dict(family.example)}
    return ModelFile.model_validate({"axis": "rotary", "friction": content})


def _find(name: str) -> tuple[Family, ModelFile | None]:
    """Return the family that NAME stands for, and the model if NAME has values or is a file."""
    if name in models.names() or name == models.NETWORK_ALONE.name:
        return models.describe(name), None
    own = given_model(name)
    return own.friction_model.family, own


def _draw(family: Family, own: ModelFile | None, picture: Path) -> None:
    title = f"{family.name}: {family.summary}"
    if own is None:
        draw(models.create(family.name, **family.example), picture, title)
    else:
        draw(own.friction_model, picture, f"{family.name} of {own.source_path.name}" if own.source_path else title)


def _draw_beside(names: Sequence[str], motion: str | None, picture: Path) -> dict[str, float]:
    """Draw models into one picture, at constant velocity or along a motion; return how far the others differ."""
    chosen = {name: _model_of(*_find(name)) for name in names}
    if motion is None:
        draw_steady(chosen, picture)
        return {}
    made = _recorded_motion(Path(motion)) if Path(motion).is_file() else _described_motion(motion, chosen)
    return draw_motion(chosen, made, picture, f"Friction along a motion: {motion}")


def _model_of(family: Family, own: ModelFile | None) -> FrictionModel:
    return models.create(family.name, **family.example) if own is None else own.friction_model


def _described_motion(text: str, chosen: Mapping[str, FrictionModel]) -> Motion:
    kind, _, rest = text.partition(":")
    keys_of(kind)
    given: dict[str, float] = {}
    for part in rest.split(",") if rest else ():
        key, _, value = part.partition("=")
        try:
            given[key.strip()] = float(value)
        except ValueError:
            raise UsageError(f"--motion {text}: {part!r} is not KEY=NUMBER") from None
    return make_motion(kind, given, chosen)


def _recorded_motion(path: Path) -> Motion:
    recording = recordings.read(path)
    if recording.period_s <= 0.0 or not {"velocity", "position"} & set(recording.columns):
        raise UsageError(f"--motion {path}: a motion needs time_s that rises, and velocity or position")
    time, dt = recording["time_s"], recording.period_s
    even = np.arange(time[0], time[-1] + 0.5 * dt, dt)
    if "velocity" in recording:
        velocity = np.interp(even, time, recording["velocity"])
        position = np.interp(even, time, recording["position"]) if "position" in recording else np.cumsum(velocity) * dt
        return Motion(dt, velocity, position)
    position = np.interp(even, time, recording["position"])
    return Motion(dt, np.diff(position) / dt, position[1:])


def _list(as_json: bool) -> None:
    families = [models.describe(name) for name in models.names()]
    modifiers = [describe_modifier(name) for name in NAMES]
    if as_json:
        print_json({"models": [describe_model(family) for family in families], "modifiers": modifiers})
        return
    page = Page()
    for title, is_static in (
        ("Static maps: friction is a function of the velocity", True),
        ("Dynamic models: friction has a memory", False),
    ):
        click.echo(f"{title}\n")
        page.write_table(_family_table([each for each in families if each.is_static == is_static]))
        click.echo()
    click.echo("Modifiers: they change the friction of any model, in the model file\n")
    page.write_table(_modifier_table(modifiers))
    click.echo("\nFor example, under 'friction:' beside 'parameters:'\n")
    page.write_yaml({"modifiers": {modifier["name"]: modifier["example"] for modifier in modifiers}}, indent=2)
    click.echo()
    page.write(
        "'friction-hil models NAME' prints formula, units and an example; with --draw PICTURE it also draws the curves."
    )


def _family_table(families: list[Family]) -> Table:
    table = new_table("model", prose("description"), prose("parameters (=default)"))
    for family in families:
        brief = [f"{each.name}{default_text(each.default)}" for each in family.parameters]
        table.add_row(family.name, family.summary, ", ".join(brief))
    return table


def _modifier_table(modifiers: list[dict[str, Any]]) -> Table:
    table = new_table("modifier", prose("description"), prose("keys (=default) [unit]"))
    for modifier in modifiers:
        keys = [
            f"{key['name']}{default_text(key['default'])}: {key['meaning']}{unit_text(key['unit'])}"
            for key in modifier["parameters"]
        ]
        table.add_row(modifier["name"], modifier["summary"], "\n".join(keys))
    return table


def _print(family: Family, own: ModelFile | None, name: str) -> None:
    page = Page()
    model = None if own is None else own.friction_model
    page.write(f"{family.name}: {family.summary}")
    click.echo()
    for line in family.formula.split(";  "):
        page.write(line, indent=2)
    click.echo()
    if family.parameters:
        page.write_table(_parameter_table(family, model))
        click.echo()
    _print_remarks(page, family, model)
    if not family.parameters or (model is not None and model.network is not None):
        return  # the weights of a network are not for reading
    friction: dict[str, Any] = {"model": family.name, "parameters": dict(family.example)}
    content: dict[str, Any] = {"version": 1, "axis": "rotary", "friction": friction}
    if own is not None:  # the values as they were given: a default may be that of a direction
        friction["parameters"] = own.friction.parameters
        friction |= {"modifiers": own.friction.modifiers} if own.friction.modifiers else {}
        content["axis"] = own.axis
    mechanics = {} if own is None else own.mechanics.model_dump(exclude_defaults=True)
    content |= {"mechanics": mechanics} if mechanics else {}
    click.echo("\nExample of a model file:\n" if own is None else f"\n{name}, as a model file:\n")
    page.write_yaml(content)
    if own is None:
        click.echo()
        page.write(f"Modifiers may follow the parameters: {', '.join(NAMES)}; 'friction-hil models' describes them.")


def _print_remarks(page: Page, family: Family, model: FrictionModel | None) -> None:
    if model is not None and model.network is not None:
        network, speed = model.network, in_units_of(model, "rad/s")
        page.write(
            f"Network: {network}, trained at {network.period_s:g} s up to {network.speed_limit:g} {speed}; beyond, "
            f"{network.beyond}."
        )
    if model is None and family.parameters:
        page.write("Parameters without default must be given. On a linear axis read N for N m, and m for rad.")
    if family.states:
        page.write(f"State: {'; '.join(in_units_of(model, each) for each in family.states)}")
    for note in ((family.note,) if family.note else ()) + (() if model is None else model.notes):
        page.write(f"Note: {note}")
    page.write(f"Source: {family.source}")


def _parameter_table(family: Family, model: FrictionModel | None) -> Table:
    values = number("default" if model is None else "value")
    table = new_table("parameter", "symbol", "unit", "bounds", values, prose("meaning"))
    for p in family.parameters:
        bounds = p.bounds.removeprefix("a list of ").replace(", .inf allowed", " or .inf")
        shown = value_text(p.default if model is None else model.parameters[p.name])
        table.add_row(p.name, p.symbol, in_units_of(model, p.unit), bounds, shown, p.meaning)
    return table


def describe_model(family: Family, own: ModelFile | None = None) -> dict[str, Any]:
    """Return all facts about a family of models, with the values of ``own`` if given, as in JSON."""
    model = None if own is None else own.friction_model
    parameters = [_parameter(each) for each in family.parameters]
    described: dict[str, Any] = {
        "name": family.name,
        "summary": family.summary,
        "is_static": family.is_static,
        "formula": family.formula.split(";  "),
        "parameters": parameters,
        "states": list(family.states),
        "note": family.note,
        "source": family.source,
        "example": dict(family.example),
    }
    if own is None or model is None:
        return described
    for parameter in parameters:
        parameter["value"] = model.parameters[parameter["name"]]
    return described | {
        "file": own.source_path,
        "axis": own.axis,
        "modifiers": model.modifiers,
        "network": None if model.network is None else model.network.as_dict(),
        "notes": list(model.notes),
    }


def describe_modifier(name: str) -> dict[str, Any]:
    """Return all facts about a modifier, as in JSON."""
    if name == "direction":
        sides = [
            {"name": side, "symbol": "", "unit": "", "bounds": "parameters of the model", "default": None}
            | {"is_required": False, "meaning": f"the model's parameters that differ in {side} motion"}
            for side in SIDES
        ]
        example: Any = {"positive": {"coulomb": 0.09}, "negative": {"coulomb": 0.07}}
        summary = "parameters of their own for each direction of motion"
        return {"name": name, "summary": summary, "parameters": sides, "is_list": False, "example": example}
    modifier = {each.name: each for each in (VISCOUS, LOAD, TEMPERATURE, HARMONIC, *CURVES)}[name]
    examples: dict[str, Any] = {
        "viscous": {"quadratic": 1e-5, "cubic": 0.0},
        "load": {"motoring": 0.1, "driven": 0.05},
        "temperature": {"reference": 40.0, "coefficient": -0.004},
        "ripple": [{"order": 7.0, "cosine": 0.001, "sine": 0.002}],
        "reversal": {"distance": [1e-5, 1e-4, 1e-3], "positive": [0.002, 0.001, 0.0]},
        "speed": {"velocity": [0.1, 1.0], "positive": [0.0, 0.002]},
    }
    return {
        "name": name,
        "summary": f"{modifier.summary}{'; a list of harmonics' if modifier is HARMONIC else ''}",
        "parameters": [_parameter(each) for each in modifier.parameters],
        "is_list": modifier is HARMONIC,
        "example": examples[name],
    }


def _parameter(parameter: Parameter) -> dict[str, Any]:
    return {
        "name": parameter.name,
        "symbol": parameter.symbol,
        "unit": parameter.unit,
        "bounds": parameter.bounds,
        "default": parameter.default,
        "is_required": parameter.default is None,
        "meaning": parameter.meaning,
    }
