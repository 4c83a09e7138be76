"""``friction-hil models``: what friction models there are, what each is, and what it looks like."""

import os
import re
import textwrap
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from friction_hil.cli.output import console, option_json, print_json
from friction_hil.errors import ConfigurationError, UsageError

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

    from friction_hil.friction.parameters import Parameter
    from friction_hil.models import Family, FrictionModel
    from friction_hil.models.model_file import ModelFile

_PIPED_WIDTH = 100  # columns, where no terminal has a width
_OPTION = "--model "  # how the messages about a model argument begin
_GLUE = "\ue000"  # a blank at which no line is broken


@click.command("models")
@click.argument("name", required=False)
@click.option(
    "--draw",
    "picture",
    type=click.Path(path_type=Path),
    metavar="PICTURE",
    help="Draw torque over velocity, and over position in a slow cycle, into PICTURE (.png, .svg).",
)
@option_json
def command(name: str | None, picture: Path | None, as_json: bool) -> None:
    """List the friction models, or describe the model NAME: formula, parameters, source, example.

    NAME may also carry values, as lugre:sigma0=2000,coulomb=0.08,static=0.12,stribeck_velocity=0.2, or be a model
    file: then its values are shown, and --draw draws them with their modifiers. Without values the example is
    drawn.
    """
    if name is None:
        if picture is not None:
            raise UsageError(f"--draw needs a model: friction-hil models lugre --draw {picture}")
        _list(as_json)
        return
    family, own = _find(name)
    if picture is not None:
        _draw(family, own, name, picture)
    if as_json:
        print_json(_described(family, own))
        return
    _print(family, own, name)
    if picture is not None:
        click.echo(f"\npicture: {picture}")


def _find(name: str) -> "tuple[Family, ModelFile | None]":
    """Find what NAME stands for: a family, or a model with values."""
    from friction_hil import models
    from friction_hil.models.files import model_from_argument

    if name in models.names() or name == models.NETWORK_ALONE.name:
        return models.describe(name), None
    try:
        own = model_from_argument(name)
    except ConfigurationError as error:
        problems = [replace(each, path=each.path.removeprefix(_OPTION)) for each in error.problems]
        raise ConfigurationError(problems) from None
    except UsageError as error:
        raise UsageError(str(error).removeprefix(_OPTION)) from None
    return own.friction_model.family, own


def _draw(family: "Family", own: "ModelFile | None", name: str, picture: Path) -> None:
    from friction_hil import models
    from friction_hil.reports.model_picture import draw

    if own is None:
        draw(models.create(family.name, **family.example), picture, f"{family.name}: {family.summary}")
    else:
        title = f"{family.name} of {own.source_path.name}" if own.source_path else f"{family.name}: {family.summary}"
        draw(own.friction_model, picture, title)


# --- the list


def _list(as_json: bool) -> None:
    from friction_hil import models
    from friction_hil.friction.modifiers import NAMES

    families = [models.describe(name) for name in models.names()]
    modifiers = [_modifier(name) for name in NAMES]
    if as_json:
        print_json({"models": [_described(family) for family in families], "modifiers": modifiers})
        return
    out = _console()
    room = out.width - 14 - 2 * 2
    widths = 14, max(room * 2 // 5, 16), max(room - room * 2 // 5, 16)
    for title, is_static in (
        ("Static maps: friction is a function of the velocity", True),
        ("Dynamic models: friction has a memory", False),
    ):
        table = _table("model", "what it is", "parameters (=default)", widths=widths)
        for family in families:
            if family.is_static == is_static:
                brief = [f"{each.name}{_equals(each.default)}" for each in family.parameters]
                table.add_row(family.name, family.summary, ", ".join(brief))
        click.echo(f"{title}\n")
        _print_table(out, table)
        click.echo()
    click.echo("Modifiers: they change the friction of any model, in the model file\n")
    table = _table("modifier", "what it is", "keys (=default) [unit]", widths=widths)
    for modifier in modifiers:
        keys = [
            f"{key['name']}{_equals(key['default'])}: {key['meaning']}{_in_unit(key['unit'])}"
            for key in modifier["parameters"]
        ]
        table.add_row(modifier["name"], modifier["summary"], "\n".join(keys))
    _print_table(out, table)
    click.echo("\nFor example, under 'friction:' beside 'parameters:'\n")
    example = {modifier["name"]: modifier["example"] for modifier in modifiers}
    click.echo(textwrap.indent(_yaml({"modifiers": example}, out.width - 2), "  "))
    click.echo()
    _say(out, "'friction-hil models NAME' has formula, units and an example; with --draw PICTURE also the curves.")


def _equals(default: object) -> str:
    return "" if default is None else f"{_GLUE}(={_value(default)})"


def _in_unit(unit: str) -> str:
    return f" [{unit.replace(' ', _GLUE)}]" if unit not in ("", "1") else ""


def _modifier(name: str) -> dict[str, Any]:
    """Everything about a modifier, as in JSON."""
    from friction_hil.friction.modifiers import HARMONIC, LOAD, SIDES, TEMPERATURE, VISCOUS

    if name == "direction":
        sides = [
            {"name": side, "symbol": "", "unit": "", "bounds": "parameters of the model", "default": None}
            | {"is_required": False, "meaning": f"the model's parameters that differ in {side} motion"}
            for side in SIDES
        ]
        example: Any = {"positive": {"coulomb": 0.09}, "negative": {"coulomb": 0.07}}
        summary = "parameters of their own for each direction of motion"
        return {"name": name, "summary": summary, "parameters": sides, "is_list": False, "example": example}
    modifier = {each.name: each for each in (VISCOUS, LOAD, TEMPERATURE, HARMONIC)}[name]
    examples: dict[str, Any] = {
        "viscous": {"quadratic": 1e-5, "cubic": 0.0},
        "load": {"motoring": 0.1, "driven": 0.05},
        "temperature": {"reference": 40.0, "coefficient": -0.004},
        "ripple": [{"order": 7.0, "cosine": 0.001, "sine": 0.002}],
    }
    return {
        "name": name,
        "summary": f"{modifier.summary}{'; a list of harmonics' if modifier is HARMONIC else ''}",
        "parameters": [_parameter(each) for each in modifier.parameters],
        "is_list": modifier is HARMONIC,
        "example": examples[name],
    }


# --- one model


def _described(family: "Family", own: "ModelFile | None" = None) -> dict[str, Any]:
    """Everything about a model, as in JSON."""
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


def _parameter(parameter: "Parameter") -> dict[str, Any]:
    return {
        "name": parameter.name,
        "symbol": parameter.symbol,
        "unit": parameter.unit,
        "bounds": parameter.bounds,
        "default": parameter.default,
        "is_required": parameter.default is None,
        "meaning": parameter.meaning,
    }


def _print(family: "Family", own: "ModelFile | None", name: str) -> None:
    from friction_hil.friction.modifiers import NAMES

    out = _console()
    model = None if own is None else own.friction_model
    _say(out, f"{family.name}: {family.summary}")
    click.echo()
    for line in family.formula.split(";  "):
        _say(out, line, indent=2)
    click.echo()
    if family.parameters:
        _print_table(out, _parameter_table(family, model))
        click.echo()
    if model is not None and model.network is not None:
        network, speed = model.network, _unit("[rad/s]", model).strip("[]")
        _say(
            out,
            f"Network: {network}, trained at {network.period_s:g} s up to {network.speed_limit:g} {speed}; beyond, "
            f"{network.beyond}.",
        )
    if model is None and family.parameters:
        _say(out, "What has no default must be given. On a linear axis N m is N, and rad is m.")
    if family.states:
        _say(out, f"State: {'; '.join(_unit(each, model) for each in family.states)}")
    if family.note:
        _say(out, f"Note: {family.note}")
    for note in () if model is None else model.notes:
        _say(out, f"Note: {note}")
    _say(out, f"Source: {family.source}")

    if not family.parameters or (model is not None and model.network is not None):
        return  # weights are nothing to read
    content: dict[str, Any] = {"model": family.name, "parameters": dict(family.example)}
    if own is not None:  # as it was given: a default may be that of a direction
        content["parameters"] = own.friction.parameters
        content |= {"modifiers": own.friction.modifiers} if own.friction.modifiers else {}
    click.echo(f"\n{'Example' if own is None else name}, as a model file has it:\n")
    click.echo(_yaml({"friction": content}, out.width))
    if own is None:
        known = ", ".join(NAMES)
        click.echo()
        _say(out, f"It may have modifiers beside its parameters: {known}; 'friction-hil models' explains them.")


def _parameter_table(family: "Family", model: "FrictionModel | None") -> "Table":
    headings = ["parameter", "symbol", "unit", "bounds", "default", "meaning"]
    table = _table(*headings[:4], *(["default"] if model is None else ["value"]), headings[5])
    for column in (0, 1, 2):
        table.columns[column].no_wrap = True
    for p in family.parameters:
        bounds = p.bounds.removeprefix("a list of ").replace(", .inf allowed", " or .inf")
        shown = _value(p.default) if model is None else _value(model.parameters[p.name])
        table.add_row(p.name, p.symbol, _unit(p.unit, model), bounds, shown, p.meaning)
    return table


def _value(value: Any) -> str:
    """Write a value or default for people."""
    if value is None:
        return ""
    if isinstance(value, float):
        return f"{value:.6g}".replace("inf", ".inf")
    if isinstance(value, list):
        if not isinstance(value[0], list):
            return ", ".join(map(_value, value))
        return f"{len(value)} pair{'' if len(value) == 1 else 's'}"
    return str(value)


def _unit(text: str, model: "FrictionModel | None") -> str:
    """Unit, or text with units, of a rotary axis as it is on the model's own."""
    if model is None or model.axis == "rotary":
        return text
    return text.replace("N m", "N").replace("rad", "m")


def _yaml(content: dict[str, Any], width: int) -> str:
    """YAML that can be pasted: no line is broken but between the elements of a collection."""
    from friction_hil.checked_yaml.text import dump

    lines: list[str] = []
    for line in re.sub(r",\n +", ", ", dump(content)).splitlines():
        indent = " " * (len(line) - len(line.lstrip()) + 2)
        glued = line.replace(": ", f":{_GLUE}")
        lines += textwrap.wrap(
            glued, width, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False, tabsize=1
        )
    return "\n".join(lines).replace(_GLUE, " ")


# --- text


def _console() -> "Console":
    out = console()
    if not out.is_terminal and "COLUMNS" not in os.environ:
        out.width = _PIPED_WIDTH
    return out


def _say(out: "Console", text: str, indent: int = 0) -> None:
    first = " " * indent
    click.echo(
        textwrap.fill(text, out.width, initial_indent=first, subsequent_indent=first + "  ", break_on_hyphens=False)
    )


def _table(*headings: str, widths: tuple[int, ...] | None = None) -> "Table":
    from rich.table import Table

    table = Table(box=None, header_style="bold", pad_edge=False)
    for i, heading in enumerate(headings):
        table.add_column(heading, width=widths[i] if widths else None)
    return table


def _print_table(out: "Console", table: "Table") -> None:
    """Print a table without the blanks that fill its lines."""
    with out.capture() as text:
        out.print(table)
    for line in text.get().splitlines():
        click.echo(line.replace(_GLUE, " ").rstrip())
