"""``friction-hil models``: what friction models there are, and what each is."""

import click

from friction_hil.cli.output import console, option_json, print_json


@click.command("models")
@click.argument("name", required=False)
@option_json
def command(name: str | None, as_json: bool) -> None:
    """List the friction models, or describe the model NAME: formula, parameters, source."""
    from friction_hil import models

    families = [models.describe(name)] if name else [models.describe(each) for each in models.names()]
    if as_json:
        described = [_as_dict(family) for family in families]
        print_json(described[0] if name else {"models": described})
        return
    from rich.table import Table

    out = console()
    if name is None:
        table = Table("model", "what it is", "parameters", box=None, header_style="bold", pad_edge=False)
        for family in families:
            table.add_row(family.name, family.summary, ", ".join(map(models.describe_brief, family.parameters)))
        out.print(table)
        return
    family = families[0]
    out.print(f"{family.name}: {family.summary}\n", markup=False)
    for line in family.formula.split(";  "):
        out.print(f"  {line}", markup=False, soft_wrap=True)
    out.print()
    table = Table(
        "parameter", "symbol", "unit", "bounds", "default", "meaning", box=None, header_style="bold", pad_edge=False
    )
    table.columns[0].no_wrap = True
    for p in family.parameters:
        default = "" if p.default is None else str(p.default)
        table.add_row(p.name, p.symbol, p.unit, p.bounds.replace(", .inf allowed", ""), default, p.meaning)
    out.print(table)
    out.print("\nOn a linear axis N m becomes N, and rad becomes m.")
    if family.states:
        out.print(f"State: {', '.join(family.states)}", markup=False)
    if family.note:
        out.print(f"Note: {family.note}", markup=False)
    out.print(f"Source: {family.source}", markup=False)


def _as_dict(family: object) -> dict[str, object]:
    from dataclasses import asdict

    from friction_hil.models import Family

    assert isinstance(family, Family)
    return asdict(family)
